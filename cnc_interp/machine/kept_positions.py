"""Save axis positions in a file while the machine is off, so that it needs no new homing.

The file exists only after the axes rested at a power failure or at the end of the machine node.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from cnc_interp.core import FloatArray, InterpError
from cnc_interp.core.small_files import UnreadableError, is_number, read_yaml, write_whole

if TYPE_CHECKING:
    from cnc_interp.machine_model.machine import Machine


def kept_positions(file: str, machine: Machine) -> FloatArray:
    """Return the axis positions saved in a file, (n_axes,) [m, rad]; NaN if not saved."""
    found = np.full(len(machine.axis_names), np.nan)
    if not (file and Path(file).exists()):
        return found
    try:
        given = read_yaml(Path(file))
    except (OSError, UnreadableError) as problem:
        raise InterpError(f'{file}: {problem}; delete it and home the axes') from None
    names = machine.axis_names
    if not (
        isinstance(given, dict) and all(map(is_number, given.values())) and {*given} <= {*names}
    ):
        raise InterpError(f'{file}: needs a number for each axis; delete it and home the axes')
    for name, value in given.items():
        found[names.index(name)] = value * machine.axis(name).shown_size
    return found


def keep_positions(
    file: str, machine: Machine, position: FloatArray, known: Sequence[bool]
) -> None:
    """Save the positions (n_axes,) [m, rad] of those resting axes that are ``known``."""
    rows = zip(machine.axes, position.tolist(), known, strict=True)
    found = {axis.name: value / axis.shown_size for axis, value, is_known in rows if is_known}
    write_whole(Path(file), yaml.safe_dump(found, sort_keys=False))
