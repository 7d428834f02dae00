"""A machine with the workpiece clamped elsewhere: its file with another workpiece offset."""

from __future__ import annotations

from copy import deepcopy
from math import cos, radians, sin
from pathlib import Path

import yaml

from cnc_interp.core.errors import MachineError
from cnc_interp.core.small_files import read_yaml, write_whole
from cnc_interp.machine_model.machine import Machine, find_machine_file

#: Digits after the point of the new offset [mm].
DIGITS = 9


def placed_machine(
    name: str, shift: tuple[float, float, float], turn: float, file: Path
) -> Machine:
    """
    Write the file of a machine whose workpiece is shifted, and turned about its zero; read it.

    With the C axis next to the workpiece, a turn by an angle w needs no turned program:

        R_C(C) (R_z(w) p + m) = R_C(C + w) (p + R_z(-w) m)

    So C counts from the turned workpiece, and only the offset m is another one.

    ``shift``: how far the workpiece zero moves, in the directions of the table at rest [mm];
    ``turn``: angle by which the workpiece is turned on the table [deg]; ``file``: the file that is
    written; its folder is made. Returns the machine; it names the file, so that `check` and
    `report` find it. Raises MachineError if no table of the machine turns about Z, so that a turn
    would need another program.
    """
    machine = Machine.load(name)
    if turn and not _has_turntable(machine):
        raise MachineError(
            f'no rotary axis of {machine.name} turns the workpiece about Z; leave out --turn, and '
            'turn the program instead'
        )
    content = deepcopy(read_yaml(find_machine_file(name)))
    x, y, z = (1e3 * old + more for old, more in zip(machine.offsets[0], shift, strict=True))
    c, s = cos(radians(turn)), sin(radians(turn))
    offset = [round(float(v), DIGITS) for v in (c * x + s * y, c * y - s * x, z)]
    if machine.has_rotary:
        content['rotary']['workpiece_offset_mm'] = offset
    else:
        content['workpiece_zero_mm'] = offset
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, yaml.safe_dump(content, sort_keys=False))
    return Machine.load(file)


def _has_turntable(machine: Machine) -> bool:
    """Tell whether the rotary axis next to the workpiece carries it and turns about Z."""
    x, y, _ = machine.rotary_direction[1]
    return machine.has_rotary and not machine.rotary_on_head[1] and x == y == 0.0
