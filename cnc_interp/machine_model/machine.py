"""Machine: axes, geometry, limits and drives of a machine tool, read from a YAML file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import cos, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from cnc_interp.core import DEG, MINUTE, MM, UM, BoolArray, FloatArray, MachineError
from cnc_interp.core.axis_limits import AxisLimits, DriveLoad, Limits
from cnc_interp.core.small_files import UnreadableError, config_directory, read_yaml, write_whole
from cnc_interp.machine_model import machine_entries as entries
from cnc_interp.machine_model.arm_entries import TOPIC, Arm, arm, without_files
from cnc_interp.machine_model.axis_drives import (
    IDEAL,
    AxisDrive,
    axis_drives,
    drive_loads,
)
from cnc_interp.machine_model.demands import Mistakes, demand
from cnc_interp.machine_model.geometric_errors import GeometricErrors, geometric_errors, table_of
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.machine_entries import Macro, control, homing, macros, standstill
from cnc_interp.machine_model.signals import Signals, signals

#: Likely range of the largest velocity of linear and of rotary axes [mm/min, deg/min]; likely
#: range of the times to the largest velocity and to the largest acceleration [s].
LIKELY = {True: (200.0, 240e3), False: (100.0, 1e6)}
QUICKEST, LONGEST = 1e-4, 20.0
USUAL_SIZE = 1.0  #: Size of a machine for which the default lengths are chosen [m].
LOCKED = 1e-6  #: Travel of a locked axis [rad].


@dataclass(frozen=True, kw_only=True)
class Axis(AxisLimits):
    name: str  #: Letter or name of the axis.
    linear: bool  #: True for a linear axis, False for a rotary one.

    @property
    def endless(self) -> bool:
        return not np.isfinite(self.travel).all()

    @property
    def locked(self) -> bool:
        return not self.linear and np.ptp(self.travel) <= LOCKED

    @property
    def unit(self) -> str:
        return 'm' if self.linear else 'rad'

    @property
    def shown_unit(self) -> str:
        return 'mm' if self.linear else 'deg'

    @property
    def shown_size(self) -> float:
        return MM if self.linear else DEG

    def position_text(self, position: float) -> str:
        """Return a position [m or rad] as a text in mm or deg, without the unit."""
        return f'{position / MM:z.3f}' if self.linear else f'{position / DEG:z.4f}'


def place_text(axes: Sequence[Axis], position: Iterable[float]) -> str:
    """Return the positions of all axes [m or rad] as one text, with names and units."""
    return '  '.join(
        f'{axis.name} {axis.position_text(q)} {axis.shown_unit}'
        for axis, q in zip(axes, position, strict=True)
    )


def error_text(error: float, unit: str) -> str:
    return f'{error / UM:.1f} um' if unit == 'm' else f'{error / DEG:.4f} deg'


@dataclass(frozen=True)
class Machine:
    """A machine tool: linear axes X Y Z, then the rotary axes, primary first, then extra axes.

    An extra axis is a linear axis U, V or W that carries the tool besides X Y Z, such as the quill
    W of a boring mill along Z. The tool is at X Y Z plus the sum of w_k d_k: w_k is the position
    of an extra axis, d_k its direction. The rail U and the positioner E1 of an arm are extra axes,
    too; the six joints of the arm follow from the pose of the tool.

    The tool axis at rest is machine +Z. A rotary axis carries either the workpiece (``table``) or
    the tool (``head``); the primary carries the secondary. R_i is the rotation of axis i about its
    direction. On a table-table machine

        p_M = R_1 (R_2 (p_W + workpiece_offset) + secondary_offset) + primary_offset
        R_1 R_2 o_W = +Z

    ``five_axis.py`` has the general formula, heads included.
    """

    name: str  #: Name of the machine.
    #: X Y Z, the rotary axes if any, then extra axes: ('X', 'Y', 'Z', 'A', 'C', 'W').
    axis_names: tuple[str, ...]
    limits: Limits  #: Limits of the axes.
    rotary_direction: FloatArray  #: (2, 3): Directions of primary and secondary axis in M [-].
    #: Whether each rotary axis carries the tool (True) or the workpiece (False).
    rotary_on_head: tuple[bool, bool]
    offsets: FloatArray  #: (3, 3): Offsets of workpiece, secondary and primary axis [m].
    tool_offset: FloatArray  #: (2, 3): Heads: from tip to secondary, then to primary pivot [m].
    singular_cone: float  #: Least angle of a turning tool axis to the pole [rad].
    #: (k, 3): Unit vectors in M along which the extra axes move the tool [-]; 0 for an arm.
    extra_direction: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    #: Index of an axis -> its drive, if it is not ideal.
    drives: dict[int, AxisDrive] = field(default_factory=dict)
    #: Index of an axis -> its own limit of the following error [m or rad].
    following_errors: dict[int, float] = field(default_factory=dict)
    #: Reference switches, and the order in which axes are homed.
    homing: entries.ReferenceSwitches = field(default_factory=entries.ReferenceSwitches)
    #: Speed of the control on short blocks, if it is slower than the axes.
    pace: entries.BlockPace | None = None
    #: Times at rest for tool changes and for the spindle.
    standstill: entries.Standstill = field(default_factory=entries.Standstill)
    #: Options of the program reader for the control of this machine, by name.
    control: dict[str, Any] = field(default_factory=dict)
    macros: tuple[Macro, ...] = ()  #: Lines of G-code, each with a key on the page.
    tool_change_macro: str = ''  #: Subprogram that M6 calls; empty if there is none.
    #: Its outputs and inputs, and the functions of a program that switch them.
    signals: Signals = field(default_factory=Signals)
    #: Geometric errors of X Y Z, which are compensated in the commanded axes.
    errors: GeometricErrors | None = None
    arm: Arm | None = None  #: Its joints, if it is an arm; an arm has no linear axes.
    #: File from which it was read; empty for a bundled machine.
    file: str = ''

    @cached_property
    def is_linear(self) -> BoolArray:
        linear = np.full(len(self.axis_names), self.arm is None)
        linear[3 : len(linear) - len(self.extra_direction)] = False
        if self.arm is not None and self.arm.further:
            slides = [letter in entries.EXTRA_LETTERS for letter in self.arm.further]
            linear[-len(slides) :] = slides
        linear.flags.writeable = False
        return linear

    @property
    def max_velocity(self) -> FloatArray:
        """(n_axes,): Velocity limit of each axis where it is largest; see ``limits``."""
        return self.limits.max_velocity

    @property
    def max_acceleration(self) -> FloatArray:
        return self.limits.max_acceleration

    @property
    def max_jerk(self) -> FloatArray:
        return self.limits.max_jerk

    @property
    def travel(self) -> FloatArray:
        return self.limits.travel

    def having(self, **columns: Sequence[Any] | FloatArray | Mapping[int, Any]) -> Machine:
        """Return this machine with other limits, see ``Limits.having``."""
        return replace(self, limits=self.limits.having(**columns))

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        columns = zip(self.axis_names, self.is_linear.tolist(), self.limits.axes, strict=True)
        return tuple(Axis(**vars(of), name=name, linear=linear) for name, linear, of in columns)

    def doubts(self) -> Iterator[str]:
        """Yield warnings about guessed limits, and about axes whose units may be wrong."""
        if self.guessed:
            yield self.guessed
        for axis in self.axes:
            v, a, j = axis.max_velocity, axis.max_acceleration, axis.max_jerk
            per_minute = v * MINUTE / axis.shown_size
            slowest, fastest = LIKELY[axis.linear]
            if not axis.locked:
                if not slowest <= per_minute <= fastest:
                    yield (
                        f'{axis.name}: the largest velocity of the machine file is '
                        f'{per_minute:g} {axis.shown_unit}/min; is the unit right?'
                    )
                elif not QUICKEST <= v / a <= LONGEST or not QUICKEST <= a / j <= LONGEST:
                    yield (
                        f'{axis.name}: by the machine file it needs {v / a:.3g} s to reach its '
                        f'largest velocity, {a / j:.3g} s for acceleration; are the units right?'
                    )

    @property
    def guessed(self) -> str:
        """Text that names the guessed limits; '' if all limits are known."""
        guessed = () if self.arm is None else self.arm.guessed
        return f'limits of {self.name} are guessed: {", ".join(guessed)}' if guessed else ''

    @property
    def driven(self) -> list[tuple[AxisDrive, DriveLoad | None]]:
        return [
            (self.drives.get(j, IDEAL), axis.load if j in self.drives else None)
            for j, axis in enumerate(self.limits.axes)
        ]

    def axis(self, name: str) -> Axis:
        return self.axes[self.axis_names.index(name)]

    @property
    def scale(self) -> float:
        """Reach of an arm over the usual size, at least 1; 1 for other machines [-]."""
        return 1.0 if self.arm is None else max(1.0, self.arm.reach / USUAL_SIZE)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the axes in URDF and joint states; an arm has the names of its own URDF."""
        return self.axis_names if self.arm is None else self.arm.joints

    @property
    def extra_names(self) -> tuple[str, ...]:
        return self.axis_names[len(self.axis_names) - len(self.extra_direction) :]

    @property
    def rotary_names(self) -> tuple[str, ...]:
        """Letters of the rotary axes that programs may name."""
        last = len(self.axis_names) - len(self.extra_direction)
        return self.axis_names[3:last] if self.has_rotary else ()

    @property
    def program_names(self) -> tuple[str, ...]:
        """Letters of the program coordinates with a zero of their own."""
        return ('X', 'Y', 'Z', *self.rotary_names)

    @property
    def has_rotary(self) -> bool:
        """Whether the machine has rotary axes that programs can name; an arm has none."""
        return self.arm is None and not self.is_linear.all()

    @staticmethod
    def load(path_or_name: str | Path) -> Machine:
        """Read a machine file, or a bundled machine. MachineError has a line for each mistake."""
        path = find_machine_file(path_or_name)
        try:
            content = read_yaml(path)
        except (OSError, UnreadableError) as problem:
            text = ' '.join(str(problem).split())
            raise MachineError(f'{path}: cannot be read as YAML: {text}') from None
        demand(
            isinstance(content, dict),
            f'{path}: not a machine file; see config/machines/xyzac.yaml',
        )
        try:
            machine = from_mapping(content, path.parent)
        except MachineError as problem:
            lines = (f'{path}: {line}' for line in str(problem).splitlines())
            raise MachineError('\n'.join(lines)) from None
        bundled = path.parent in (machines_directory(), arms_directory())
        return machine if bundled else replace(machine, file=str(path.resolve()))


def arm_of(machine: Machine) -> Arm:
    assert machine.arm is not None, 'a machine with joints'
    return machine.arm


def limits_of(limits: Machine | Limits) -> Limits:
    return limits.limits if isinstance(limits, Machine) else limits


def machines_directory() -> Path:
    return config_directory() / 'machines'


def arms_directory() -> Path:
    return config_directory() / 'arms'


def find_machine_file(path_or_name: str | Path) -> Path:
    path = Path(path_or_name)
    if path.is_file():
        return path
    folders = machines_directory(), arms_directory()
    found = {file.stem: file for folder in folders for file in folder.glob('*.yaml')}
    if str(path_or_name) in found:
        return found[str(path_or_name)]
    names = ', '.join(sorted(found))
    raise MachineError(f"no machine '{path_or_name}'; give a YAML file, or one of: {names}")


def from_mapping(content: dict[str, Any], folder: Path = Path()) -> Machine:
    """Read a machine from the content of its file; named files are in ``folder``."""
    if 'urdf' in content:
        return _arm(content, folder)
    rotary = content.get('rotary') or {}
    demand(isinstance(rotary, dict), 'must hold primary and secondary', 'rotary')
    names = ['X', 'Y', 'Z'] + [
        str(entries.entry(rotary, key, 'rotary', 'name'))
        for key in ('primary', 'secondary')
        if rotary
    ]
    linear = [name in 'XYZ' for name in names]
    extra = entries.extra_axes(content)
    names, linear = names + list(extra), linear + [True] * len(extra)
    limits: Any = content.get('limits')
    demand(
        isinstance(limits, dict),
        'missing; it holds velocity, acceleration, jerk of each axis',
        'limits',
    )
    mistakes = Mistakes()
    for name in limits:
        with mistakes:
            demand(name in names, f'the machine has no such axis (axes: {" ".join(names)})', name)
    found = [
        entries.LOCKED_LIMITS
        if not linear[i] and entries.is_locked(rotary, names[i])
        else mistakes.read(entries.axis_limits, limits, name, linear[i])
        for i, name in enumerate(names)
    ]
    read_geometry = entries.rotary_geometry if rotary else entries.linear_geometry
    geometry = mistakes.read(read_geometry, rotary or content)
    reads = control, macros, standstill
    chosen = {read.__name__: mistakes.read(read, content) for read in reads}
    mistakes.report()
    travel = {
        name: (np.array(of.travel), MM if straight else DEG)
        for name, of, straight in zip(names, found, linear, strict=True)
    }
    loads = mistakes.read(drive_loads, content, names, linear, found)
    by_place = mistakes.read(entries.limits_by_position, content, names, linear, found)
    switches = mistakes.read(homing, content, travel)
    errors = mistakes.read(entries.following_errors, content, names, linear)
    ends = np.array([of.travel for of in found[:3]])
    of_geometry = mistakes.read(geometric_errors, content, ends, folder)
    macro = mistakes.read(entries.tool_change_macro, content, folder)
    pace = mistakes.read(entries.block_pace, content, min(axis.max_jerk for axis in found[:3]))
    mistakes.report()
    drives = mistakes.read(axis_drives, content, names, linear, loads)
    machine_signals = mistakes.read(
        signals, content, switches.index, switches.switches, switches.squared
    )
    mistakes.report()
    return Machine(
        name=str(content.get('name', 'unnamed')),
        axis_names=tuple(names),
        limits=Limits(tuple(found)).having(by_place=by_place, load=loads),
        drives=drives,
        extra_direction=np.array(list(extra.values())).reshape(-1, 3),
        following_errors=errors,
        homing=switches,
        pace=pace,
        errors=of_geometry,
        signals=machine_signals,
        tool_change_macro=macro,
        **chosen,
        **geometry,
    )


#: Entries of the machine file of an arm.
ARM_ENTRIES = (
    'name',
    'urdf',
    'base',
    'flange',
    'tcp',
    'part',
    'joint_limits',
    'limits',
    'home_deg',
    'start',
    'spin_deg',
    'singular_cone_deg',
    'standstill',
    'control',
)


def _arm(content: dict[str, Any], folder: Path) -> Machine:
    entries.require_known(content, ARM_ENTRIES, 'arm')
    found, limits = arm(content, folder)
    cone = content.get('singular_cone_deg', 0.2)
    shape = entries.linear_geometry({})
    shape['singular_cone'] = entries.number(cone, 'singular_cone_deg', 1e-2, 30.0) * DEG
    return Machine(
        name=str(content.get('name', 'unnamed')),
        axis_names=(*(f'J{k}' for k in range(1, ARM + 1)), *found.further),
        extra_direction=np.zeros((len(found.further), 3)),
        limits=Limits(limits),
        standstill=standstill(content),
        control=control(content),
        arm=found,
        **shape,
    )


def _write(content: dict[str, Any], file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, yaml.safe_dump(content, sort_keys=False))


DIGITS = 9  #: Decimals of offsets that are written to a file [mm].


def placed_machine(
    name: str, shift: tuple[float, float, float], turn: float, file: Path
) -> Machine:
    """Write and read a copy of a machine file, its workpiece shifted and turned about its zero.

    If the C axis carries the workpiece, the same program runs on a workpiece that is turned by an
    angle w:

        R_C(C) (R_z(w) p + m) = R_C(C + w) (p + R_z(-w) m)

    C then counts from the turned workpiece, and only the offset m changes. ``shift`` [mm],
    ``turn`` [deg]. Raises MachineError if no table of the machine turns about Z.
    """
    machine = Machine.load(name)
    demand(
        machine.arm is None, f'{machine.name} is an arm; move `part` in its machine file instead'
    )
    x, y, _ = machine.rotary_direction[1]
    demand(
        not turn or (machine.has_rotary and not machine.rotary_on_head[1] and x == y == 0.0),
        f'no rotary axis of {machine.name} turns the workpiece about Z; leave out --turn, and '
        'turn the program instead',
    )
    content = content_of(name)
    x, y, z = (1e3 * old + more for old, more in zip(machine.offsets[0], shift, strict=True))
    c, s = cos(radians(turn)), sin(radians(turn))
    offset = [round(float(v), DIGITS) for v in (c * x + s * y, c * y - s * x, z)]
    if machine.has_rotary:
        content['rotary']['workpiece_offset_mm'] = offset
    else:
        content['workpiece_zero_mm'] = offset
    _write(content, file)
    return Machine.load(file)


def content_of(name: str | Path) -> dict[str, Any]:
    """Return the content of a machine file, with the files that it names included."""
    file = find_machine_file(name)
    content: dict[str, Any] = deepcopy(read_yaml(file))
    if 'urdf' in content:
        return without_files(content, file.parent)
    if isinstance(errors := content.get('errors'), dict):
        content['errors'] = {k: table_of(of, k, file.parent) for k, of in errors.items()}
    if macro := entries.tool_change_macro(content, file.parent):
        content[entries.TOOL_CHANGE] = macro
    return content


def whole_text(name: str) -> str:
    """Return the text of a machine file, with the files that it names included."""
    found = find_machine_file(name)
    if not {'urdf', 'errors', entries.TOOL_CHANGE} & set(read_yaml(found)):
        return found.read_text(encoding='utf-8')
    return str(yaml.safe_dump(content_of(name), sort_keys=False))


def without_topic(name: str, file: Path) -> str:
    """Return ``name``; if its URDF is on a topic, write ``file`` with the URDF and return it."""
    Machine.load(name)  # rejects other files
    if str(read_yaml(find_machine_file(name)).get('urdf')).startswith(TOPIC):
        _write(content_of(name), file)
        return str(file)
    return name


def with_guessed_limits(name: str, file: Path) -> Machine:
    """Write a copy of an arm's file in which missing limits are guessed, and read it."""
    found = find_machine_file(name)
    content = read_yaml(found)
    demand(
        isinstance(content, dict) and 'urdf' in content,
        f'{found}: --limits guess is for arms; write the limits into the file',
    )
    _write({**content_of(name), 'limits': 'guess'}, file)
    return Machine.load(file)


def with_geometry(name: str, file: Path, geometry: Machine) -> None:
    """Write a copy of a machine file, with rotary axis and head offsets of ``geometry``."""
    content = content_of(name)
    offsets = np.concatenate([geometry.offsets, geometry.tool_offset])
    for key, offset in zip(entries.GEOMETRY, offsets, strict=True):
        if key in content['rotary'] or offset.any():
            content['rotary'][key] = [round(1e3 * float(x), DIGITS) for x in offset]
    _write(content, file)
