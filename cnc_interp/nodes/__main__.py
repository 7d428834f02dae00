"""Run one node in its own process: ``python -m cnc_interp.nodes NODE --ros-args ...``."""

import sys
from importlib import import_module

from cnc_interp.processes.one_thread import use_one_thread

use_one_thread()
sys.exit(import_module(f'{__package__}.{sys.argv[1]}').main())
