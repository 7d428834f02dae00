"""Run `cnc-interp` as `python -m cnc_interp`."""

import sys

from cnc_interp.cli import main

sys.exit(main())
