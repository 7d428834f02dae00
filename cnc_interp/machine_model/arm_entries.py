"""Read the machine file of an arm: its chain of joints from a URDF, and their limits.

The last six joints of the chain are the arm. Joints before them belong to a rail or a positioner.
Programs name these *further joints* as axes: U, V, W if they slide, and E1, E2, E3 if they turn.
"""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, MachineError
from cnc_interp.core.axis_limits import AxisLimits
from cnc_interp.core.small_files import UnreadableError, read_yaml, small_text
from cnc_interp.machine_model.demands import demand
from cnc_interp.machine_model.joint import (
    ARM,
    TOOL_TIP,
    WORKPIECE,
    Joint,
    angles,
    rotation,
    vector,
)
from cnc_interp.machine_model.machine_entries import (
    EXTRA_LETTERS,
    PLAUSIBLE,
    POSITIONERS,
    number,
    numbers,
    require_known,
)

LONGEST_URDF = 1 << 22  #: Largest size of a URDF [bytes].
TOPIC = 'topic '  #: Beginning of the entry ``urdf`` if it names a ROS topic instead of a file.
#: Guessed times to reach the largest velocity, and the largest acceleration, of a joint [s].
GUESS = (0.4, 0.1)
ORDERS = ('velocity', 'acceleration', 'jerk')
MOST_FURTHER = 3  #: Largest number of joints of rail and positioner.
ORIGIN = {'xyz': '0 0 0', 'rpy': '0 0 0'}


@dataclass(frozen=True)
class Arm:
    """Geometry of an arm in W, all joints at zero. The six joints of the arm come first."""

    joints: tuple[str, ...]  #: Names of the joints in the URDF.
    further: tuple[str, ...]  #: Names of the further joints in programs.
    #: All joints, parents before children, with those to ``tool_tip`` and ``workpiece``.
    tree: tuple[Joint, ...]
    urdf: str  #: Text of its URDF.
    lines: FloatArray  #: (n, 6): Direction of each joint [-], and a point on it [m].
    #: (3, 3): Position of the tip [m], X of the TCP [-], and tool axis [-].
    tool: FloatArray
    #: (n,): Joint positions [rad]; configurations near them are preferred. Programs begin with the
    #: further joints at these positions [m or rad].
    home: FloatArray
    spin: float  #: Rotation of the tool about its own axis [rad].
    guessed: tuple[str, ...] = field(default_factory=tuple)  #: Names of limits that are guessed.

    @property
    def reach(self) -> float:
        """Length of the stretched arm with its tool [m]."""
        points = np.vstack([self.lines[:ARM, 3:], self.tool[0]])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def arm(content: dict[str, Any], folder: Path) -> tuple[Arm, tuple[AxisLimits, ...]]:
    """Read the machine file of an arm; return arm and limits. Named files are in ``folder``."""
    text, robot = _robot(content, folder)
    elements = {joint.get('name', ''): joint for joint in robot.iter('joint')}
    parents = {_link(joint, 'child'): joint for joint in elements.values()}
    flange, base = _frame(content, 'flange'), _frame(content, 'base')
    part = _pose(content, 'part', base, parents)
    back, ahead = _chain(parents, base, flange)
    here, names, lines, directions = np.linalg.inv(part), list[str](), [], list[FloatArray]()
    for joint, sense in [(one, -1.0) for one in back] + [(one, 1.0) for one in ahead]:
        here = here if sense < 0.0 else here @ _origin(joint)
        if joint.get('type') != 'fixed':
            names.append(joint.get('name', ''))
            directions.append(_direction(joint))
            lines.append([*sense * here[:3, :3] @ directions[-1], *here[:3, 3]])
        here = here @ np.linalg.inv(_origin(joint)) if sense < 0.0 else here
    count = len(names) - ARM
    own = names[count:] if count >= 0 else []
    demand(
        len(own) == ARM
        and all(elements[name] in ahead and not _slides(elements[name]) for name in own),
        f'{flange} must follow {ARM} turning joints in a row; other arms are not supported',
        'urdf',
    )
    demand(
        count <= MOST_FURTHER,
        f'at most {MOST_FURTHER} joints may carry the arm or the part',
        'urdf',
    )
    sliding, turning = iter(EXTRA_LETTERS), iter(POSITIONERS)
    letters = [next(sliding if _slides(elements[name]) else turning) for name in names[:count]]
    names = own + names[:count]
    lines, directions = lines[count:] + lines[:count], directions[count:] + directions[:count]
    tcp = _pose(content, 'tcp', flange, parents)
    tool = here @ tcp
    shown = [f'J{k}' for k in range(1, ARM + 1)] + letters
    limits, guessed = _limits(content, folder, dict(zip(names, shown, strict=True)), elements)
    home = np.array(numbers(content.get('home_deg', [0.0] * ARM), ARM, 'home_deg')) * DEG
    home = np.append(home, _begins(content, letters, limits[ARM:]))
    spin = numbers([content.get('spin_deg', 0.0)], 1, 'spin_deg')[0] * DEG
    # Z of the TCP points out of the tool, the tool axis of programs from the tip to the holder.
    shape = np.array([tool[:3, 3], tool[:3, 0], -tool[:3, 2]])
    axes = dict(zip(names, zip(directions, limits, strict=True), strict=True))
    root = _link(back[-1], 'parent') if back else base
    tree = _tree(list(elements.values()), root, axes)
    frames = {WORKPIECE: (base, part), TOOL_TIP: (flange, tcp * [1.0, -1.0, -1.0, 1.0])}
    known = {root, *(joint.child for joint in tree)}
    for frame, (carrier, pose) in frames.items():
        demand(frame not in known, f'has a link {frame}; rename it, this name is reserved', 'urdf')
        place, turn = vector(pose[:3, 3]), angles(pose[:3, :3])
        tree.append(Joint(f'{carrier}_{frame}', 'fixed', carrier, frame, place, rpy=turn))
    joints = tuple(names), tuple(letters), tuple(tree), text
    return Arm(*joints, np.array(lines), shape, home, spin, guessed), limits


def _slides(joint: ElementTree.Element) -> bool:
    return joint.get('type') == 'prismatic'


def _direction(joint: ElementTree.Element) -> FloatArray:
    """Return the unit direction (3,) of a joint's axis in the frame of its child."""
    name, along = joint.get('name', ''), joint.find('axis')
    demand(
        joint.get('type') in ('revolute', 'continuous', 'prismatic')
        and joint.find('mimic') is None,
        f'joint {name} of the URDF must be fixed, turn about one axis or slide along one; other '
        'joints are not supported',
        'urdf',
    )
    direction = _words('1 0 0' if along is None else along.get('xyz', ''), name, 3)
    length = float(np.linalg.norm(direction))
    demand(length > 0.0, f'joint {name} of the URDF has an axis of no length', 'urdf')
    return direction / length


def _begins(
    content: dict[str, Any], letters: Sequence[str], limits: Sequence[AxisLimits]
) -> list[float]:
    """Return the positions of the further joints at the start of programs [m or rad]."""
    given, found = content.get('start') or {}, []
    demand(isinstance(given, dict), 'must hold positions, such as {U: 500.0, E1: 90.0}', 'start')
    require_known(given, letters, 'start')
    for letter, of in zip(letters, limits, strict=True):
        size = DEG if letter in POSITIONERS else MM
        low, high = (float(end) / size for end in of.travel)
        usual = min(max(0.0, low), high)
        (value,) = numbers([given.get(letter, usual)], 1, f'start.{letter}')
        demand(low <= value <= high, f'outside its travel {low:g} ... {high:g}', f'start.{letter}')
        found.append(value * size)
    return found


def _tree(
    joints: Sequence[ElementTree.Element],
    base: str,
    axes: dict[str, tuple[FloatArray, AxisLimits]],
) -> list[Joint]:
    """Return all joints below ``base``, parents first. Joints without an axis stay at zero."""
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
                kind = 'prismatic' if _slides(joint) else kind
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
    """Return the machine file of an arm, with the files that it names included in it."""
    found = {**content, 'urdf': _robot(content, folder)[0]}
    if isinstance(content.get('joint_limits'), str):
        found['joint_limits'] = read_yaml(folder / content['joint_limits'])['joint_limits']
    return found


def _robot(content: dict[str, Any], folder: Path) -> tuple[str, ElementTree.Element]:
    """Return the text and the root element of the URDF that the machine file names or holds."""
    given = str(content['urdf'])
    try:
        text = given
        if given.startswith(TOPIC):
            text = _published(given.removeprefix(TOPIC).strip())
        elif not given.lstrip().startswith('<'):
            text = small_text(folder / given, LONGEST_URDF)
        if '<!ENTITY' in text:
            raise UnreadableError('it defines entities')
        return text, ElementTree.fromstring(text)
    except (OSError, UnreadableError, ElementTree.ParseError, ValueError) as problem:
        raise MachineError(f'{given[:80]}: cannot be read as URDF: {problem}', 'urdf') from None


@cache
def _published(topic: str) -> str:
    """Return the last text of a topic. Another process receives it: planning needs no ROS."""
    command = [sys.executable, '-m', 'cnc_interp.client.robot_description', topic]
    heard = subprocess.run(command, capture_output=True, text=True, check=False)
    told = heard.stderr.strip().splitlines() or ['']
    demand(heard.returncode == 0, told[-1], 'urdf')
    return heard.stdout


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
) -> tuple[list[ElementTree.Element], list[ElementTree.Element]]:
    """Return the joints from ``base`` up the tree, and then those down to ``link``."""
    ways, tops = list[list[ElementTree.Element]](), list[str]()
    for at in (base, link):
        ways.append([])
        while at in parents and len(ways[-1]) <= len(parents):
            ways[-1].append(parents[at])
            at = _link(parents[at], 'parent')
        tops.append(at)
    back, ahead = ways
    while back and ahead and back[-1] is ahead[-1]:
        del back[-1], ahead[-1]
    demand(
        tops[0] == tops[1] and max(map(len, ways)) <= len(parents),
        f'no joints of the URDF lead from {base} to {link}',
        'urdf',
    )
    return back, ahead[::-1]


def _origin(joint: ElementTree.Element) -> FloatArray:
    origin, name = joint.find('origin'), joint.get('name', '')
    words = ORIGIN if origin is None else ORIGIN | origin.attrib
    xyz, rpy = (_words(words[key], name, 3) for key in ORIGIN)
    return _matrix(xyz, rpy)


def _pose(
    content: dict[str, Any], key: str, link: str, parents: dict[str, ElementTree.Element]
) -> FloatArray:
    """Return the pose (4, 4) of entry ``key`` in a link: given as numbers, or as a fixed link."""
    given: Any = content.get(key)
    if isinstance(given, str):
        found = np.eye(4)
        for sense, joints in zip((-1, 1), _chain(parents, link, given), strict=True):
            for joint in joints:
                demand(joint.get('type') == 'fixed', f'{given} is not fixed to {link}', key)
                found = found @ np.linalg.matrix_power(_origin(joint), sense)
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
    """Return a pose as a matrix (4, 4); ``rpy`` [rad]: rotation about fixed X, then Y, then Z."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation(*rpy), xyz
    return found


def _limits(
    content: dict[str, Any],
    folder: Path,
    names: dict[str, str],
    elements: dict[str, ElementTree.Element],
) -> tuple[tuple[AxisLimits, ...], tuple[str, ...]]:
    """Return the limits of the joints, and names of guessed ones; MoveIt precedes the URDF.

    ``names``: name of a joint in the URDF -> name of the axis.
    """
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
    for name, axis in names.items():
        own, where = given.get(name) or {}, f'joint_limits.{name}'
        demand(isinstance(own, dict), 'must hold max_velocity and others', where)
        told, slides = elements[name].find('limit'), _slides(elements[name])
        urdf = {} if told is None else told.attrib
        found = list[float]()
        for k, (order, bounds) in enumerate(zip(ORDERS, PLAUSIBLE[slides], strict=True)):
            value = own.get(f'max_{order}') if own.get(f'has_{order}_limits') else None
            if value is None and order == 'velocity' and 'velocity' in urdf:
                value = float(_words(urdf['velocity'], name, 1)[0])
            if value is None and guess and found:
                value = found[-1] / GUESS[k - 1]
                guessed.append(f'{axis} {order}')
            demand(
                value is not None,
                f'max_{order} (has_{order}_limits) is missing; or plan with --limits guess',
                where,
            )
            found.append(number(value, f'{where}.max_{order}', *bounds))
        travel = np.array([-inf, inf])
        if elements[name].get('type') != 'continuous':
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
