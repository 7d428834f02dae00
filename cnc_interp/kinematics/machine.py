"""Machine: axes, geometry and limits, read from a YAML file."""

from __future__ import annotations

from dataclasses import dataclass

from cnc_interp.program.blocks import FloatArray


@dataclass(frozen=True)
class Machine:
    """
    A machine tool: linear axes X Y Z, then the rotary axes, primary first.

    Parameters
    ----------
    name : str
        Name of the machine.
    axis_names : tuple of str
        ('X', 'Y', 'Z', 'A', 'C') or ('X', 'Y', 'Z').
    max_velocity, max_acceleration, max_jerk : ndarray, shape (n_axes,)
        Limits [m/s or rad/s, per s, per s2].
    travel : ndarray, shape (n_axes, 2)
        Lowest and highest position, infinite for endless axes [m or rad].

    """

    name: str
    axis_names: tuple[str, ...]
    max_velocity: FloatArray
    max_acceleration: FloatArray
    max_jerk: FloatArray
    travel: FloatArray
