"""cnc_interp: a 5-axis CNC interpolator whose every emitted setpoint is proven."""

__version__ = '0.1.0'
