"""A node as a process of its own: ``python -m cnc_interp.nodes NODE --ros-args ...``."""

import sys
from importlib import import_module

sys.exit(import_module(f'{__package__}.{sys.argv[1]}').main())
