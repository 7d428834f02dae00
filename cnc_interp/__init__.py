"""cnc_interp: a 5-axis CNC interpolator whose every emitted setpoint is proven."""

import os

from cnc_interp.core import kernel_cache

__version__ = '0.1.0'

kernel_cache.register(os.environ)
