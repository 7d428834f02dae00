"""Entries of a machine file that describes an arm: a chain of joints from a URDF, and limits."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, MachineError
from cnc_interp.core.axis_limits import AxisLimits
from cnc_interp.core.small_files import UnreadableError, read_yaml, small_text
from cnc_interp.machine_model.demands import demand
from cnc_interp.machine_model.joint import TOOL_TIP, WORKPIECE, Joint, angles, rotation, vector
from cnc_interp.machine_model.machine_entries import (
    PLAUSIBLE,
    number,
    numbers,
    require_known,
)

LONGEST_URDF = 1 << 22  #: [bytes].
#: Guessed times in which a joint reaches its largest velocity and acceleration [s].
GUESS = (0.4, 0.1)
ORDERS = ('velocity', 'acceleration', 'jerk')
ORIGIN = {'xyz': '0 0 0', 'rpy': '0 0 0'}


@dataclass(frozen=True)
class Arm:
    """An arm at zero, in the workpiece frame W, with its joints from the part to the tool."""

    joints: tuple[str, ...]  #: Names in the URDF.
    #: All its joints, parents before children; those to ``tool_tip`` and ``workpiece`` included.
    tree: tuple[Joint, ...]
    urdf: str  #: Its URDF.
    lines: FloatArray  #: (n, 6): Direction of each joint [-], and a point on it [m].
    #: (3, 3): Tip [m], side and axis of the tool [-]; the axis points away from the part.
    tool: FloatArray
    home: FloatArray  #: (n,): Positions near which configurations are preferred [rad].
    spin: float  #: Turn of the tool about its axis [rad].
    guessed: tuple[str, ...] = field(default_factory=tuple)  #: Names of limits that are guessed.


def arm(content: dict[str, Any], folder: Path) -> tuple[Arm, tuple[AxisLimits, ...]]:
    """Read the machine file of an arm; the files that it names are in ``folder``."""
    text, robot = _robot(content, folder)
    elements = {joint.get('name', ''): joint for joint in robot.iter('joint')}
    parents = {_link(joint, 'child'): joint for joint in elements.values()}
    flange, base = _frame(content, 'flange'), _frame(content, 'base')
    part = _pose(content, 'part', base, parents)
    directions = list[FloatArray]()
    here, names, lines = np.linalg.inv(part), [], []
    for joint in _chain(parents, base, flange):
        here, name, kind = here @ _origin(joint), joint.get('name', ''), joint.get('type')
        if kind == 'fixed':
            continue
        demand(
            kind in ('revolute', 'continuous') and joint.find('mimic') is None,
            f'joint {name} of the URDF is neither fixed nor a plain revolute joint; only those '
            'are supported yet',
            'urdf',
        )
        along = joint.find('axis')
        direction = _words('1 0 0' if along is None else along.get('xyz', ''), name, 3)
        length = float(np.linalg.norm(direction))
        demand(length > 0.0, f'joint {name} of the URDF has an axis of no length', 'urdf')
        names.append(name)
        directions.append(direction / length)
        lines.append([*here[:3, :3] @ directions[-1], *here[:3, 3]])
    demand(
        len(names) == 6,
        f'{len(names)} joints turn between {base} and {flange}; an arm has 6 for now',
        'urdf',
    )
    tcp = _pose(content, 'tcp', flange, parents)
    tool = here @ tcp
    limits, guessed = _limits(content, folder, names, elements)
    home = np.array(numbers(content.get('home_deg', [0.0] * 6), 6, 'home_deg')) * DEG
    spin = numbers([content.get('spin_deg', 0.0)], 1, 'spin_deg')[0] * DEG
    # Z of the TCP points out of the tool, the tool axis of programs from the tip to the holder.
    shape = np.array([tool[:3, 3], tool[:3, 0], -tool[:3, 2]])
    axes = dict(zip(names, zip(directions, limits, strict=True), strict=True))
    tree = _tree(list(elements.values()), base, axes)
    frames = {WORKPIECE: (base, part), TOOL_TIP: (flange, tcp * [1.0, -1.0, -1.0, 1.0])}
    known = {base, *(joint.child for joint in tree)}
    for frame, (carrier, pose) in frames.items():
        demand(frame not in known, f'has a link {frame}; rename it, this name is taken', 'urdf')
        place, turn = vector(pose[:3, 3]), angles(pose[:3, :3])
        tree.append(Joint(f'{carrier}_{frame}', 'fixed', carrier, frame, place, rpy=turn))
    joints = tuple(names), tuple(tree), text
    return Arm(*joints, np.array(lines), shape, home, spin, guessed), limits


def _tree(
    joints: Sequence[ElementTree.Element],
    base: str,
    axes: dict[str, tuple[FloatArray, AxisLimits]],
) -> list[Joint]:
    """Return the joints from the base on, parents first; those without an axis stay at zero."""
    found, reached = list[Joint](), [base]
    numbers_ = {name: k for k, name in enumerate(axes)}
    for link in reached:
        for joint in (one for one in joints if _link(one, 'parent') == link):
            name, child, origin = joint.get('name', ''), _link(joint, 'child'), _origin(joint)
            demand(child not in reached, f'link {child} of the URDF has two parents', 'urdf')
            reached.append(child)
            place, turn = vector(origin[:3, 3]), angles(origin[:3, :3])
            plain = Joint(name, 'fixed', link, child, place, rpy=turn)
            if name in axes:
                direction, limits = axes[name]
                kind = 'revolute' if np.isfinite(limits.travel).all() else 'continuous'
                plain = replace(
                    plain,
                    kind=kind,
                    along=vector(direction),
                    travel=limits.travel,
                    max_velocity=limits.max_velocity,
                    axis=numbers_[name],
                )
            found.append(plain)
    return found


def without_files(content: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the machine file of an arm, with the content of the files that it names."""
    found = {**content, 'urdf': _robot(content, folder)[0]}
    if isinstance(content.get('joint_limits'), str):
        found['joint_limits'] = read_yaml(folder / content['joint_limits'])['joint_limits']
    return found


def _robot(content: dict[str, Any], folder: Path) -> tuple[str, ElementTree.Element]:
    """Return the URDF as text, which the machine file names or holds, and its content."""
    given = str(content['urdf'])
    try:
        text = given
        if not given.lstrip().startswith('<'):
            text = small_text(folder / given, LONGEST_URDF)
        if '<!ENTITY' in text:
            raise UnreadableError('it defines entities')
        return text, ElementTree.fromstring(text)
    except (OSError, UnreadableError, ElementTree.ParseError, ValueError) as problem:
        raise MachineError(f'{given[:80]}: cannot be read as URDF: {problem}', 'urdf') from None


def _frame(content: dict[str, Any], key: str) -> str:
    demand(isinstance(content.get(key), str), 'missing; name a link of the URDF', key)
    return str(content[key])


def _link(joint: ElementTree.Element, end: str) -> str:
    found = joint.find(end)
    return '' if found is None else found.get('link', '')


def _words(text: str, joint: str, count: int) -> FloatArray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    demand(
        len(values) == count and np.isfinite(values).all(),
        f'joint {joint} of the URDF: {text!r} must be {count} numbers',
        'urdf',
    )
    return values


def _chain(
    parents: dict[str, ElementTree.Element], base: str, link: str
) -> list[ElementTree.Element]:
    joints, at = list[ElementTree.Element](), link
    while at != base:
        demand(
            at in parents and len(joints) <= len(parents),
            f'no joints of the URDF lead from {base} to {link}',
            'urdf',
        )
        joints.insert(0, parents[at])
        at = _link(parents[at], 'parent')
    return joints


def _origin(joint: ElementTree.Element) -> FloatArray:
    origin, name = joint.find('origin'), joint.get('name', '')
    words = ORIGIN if origin is None else ORIGIN | origin.attrib
    xyz, rpy = (_words(words[key], name, 3) for key in ORIGIN)
    return _matrix(xyz, rpy)


def _pose(
    content: dict[str, Any], key: str, link: str, parents: dict[str, ElementTree.Element]
) -> FloatArray:
    """Return the pose of a frame in a link: numbers, or the name of a link fixed to it."""
    given: Any = content.get(key)
    if isinstance(given, str):
        found = np.eye(4)
        for joint in _chain(parents, link, given):
            demand(joint.get('type') == 'fixed', f'{given} is not fixed to {link}', key)
            found = found @ _origin(joint)
        return found
    demand(
        isinstance(given, dict),
        'missing; name a link, or give {xyz_mm: [x, y, z], rpy_deg: [r, p, y]}',
        key,
    )
    require_known(given, ('xyz_mm', 'rpy_deg'), key)
    xyz, rpy = (numbers(given.get(k, [0.0] * 3), 3, f'{key}.{k}') for k in ('xyz_mm', 'rpy_deg'))
    return _matrix(np.array(xyz) * MM, np.array(rpy) * DEG)


def _matrix(xyz: FloatArray, rpy: FloatArray) -> FloatArray:
    """Return the pose of a frame as a matrix (4, 4): turned about fixed X, then Y, then Z."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation(*rpy), xyz
    return found


def _limits(
    content: dict[str, Any],
    folder: Path,
    names: Sequence[str],
    elements: dict[str, ElementTree.Element],
) -> tuple[tuple[AxisLimits, ...], tuple[str, ...]]:
    """Return the limits of the joints: MoveIt's ``joint_limits``, else those of the URDF."""
    given, guess = content.get('joint_limits'), content.get('limits') == 'guess'
    demand(
        content.get('limits', 'guess') == 'guess',
        "may only be 'guess'; joint_limits holds the limits of an arm",
        'limits',
    )
    if isinstance(given, str):
        try:
            given = read_yaml(folder / given)
        except (OSError, UnreadableError) as problem:
            raise MachineError(f'cannot be read: {problem}', 'joint_limits') from None
        given = given.get('joint_limits') if isinstance(given, dict) else None
    if not isinstance(given, dict):
        demand(guess, 'missing; name the joint_limits.yaml of MoveIt', 'joint_limits')
        given = {}
    limits, guessed = list[AxisLimits](), list[str]()
    for number_, name in enumerate(names, start=1):
        own, where = given.get(name) or {}, f'joint_limits.{name}'
        demand(isinstance(own, dict), 'must hold max_velocity and others', where)
        told = elements[name].find('limit')
        urdf = {} if told is None else told.attrib
        found = list[float]()
        for k, (order, bounds) in enumerate(zip(ORDERS, PLAUSIBLE[False], strict=True)):
            value = own.get(f'max_{order}') if own.get(f'has_{order}_limits') else None
            if value is None and order == 'velocity' and 'velocity' in urdf:
                value = float(_words(urdf['velocity'], name, 1)[0])
            if value is None and guess and found:
                value = found[-1] / GUESS[k - 1]
                guessed.append(f'J{number_} {order}')
            demand(
                value is not None,
                f'max_{order} (has_{order}_limits) is missing; or plan with --limits guess',
                where,
            )
            found.append(number(value, f'{where}.max_{order}', *bounds))
        travel = np.array([-inf, inf])
        if elements[name].get('type') == 'revolute':
            travel = _words(f'{urdf.get("lower", "")} {urdf.get("upper", "")}', name, 2)
        if own.get('has_position_limits'):
            given_ends = [own.get(f'{end}_position') for end in ('min', 'max')]
            travel = np.clip(
                numbers(given_ends, 2, f'{where}.min_position, max_position'), *travel
            )
        demand(travel[0] < travel[1], 'its lowest position must be below its highest', where)
        velocity, acceleration, jerk = found
        ends = float(travel[0]), float(travel[1])
        limits.append(AxisLimits(velocity, acceleration, jerk, ends))
    return tuple(limits), tuple(guessed)
