"""What a page shares with who started it."""

from collections.abc import Callable

#: Environment variable with the process of the run; the page ends when that process ends.
PARENT = 'CNC_INTERP_PARENT'
Revive = Callable[[], dict[str, str]]  #: Starts lost nodes again; returns why, by name.
