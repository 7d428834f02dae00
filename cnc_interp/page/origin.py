"""Definitions shared by the page and the process that started it."""

from collections.abc import Callable

#: Environment variable with the process id of the run; the page ends with that process.
PARENT = 'CNC_INTERP_PARENT'
Revive = Callable[[], dict[str, str]]  #: Restarts lost nodes; returns the reasons by node name.
