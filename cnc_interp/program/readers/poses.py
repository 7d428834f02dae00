"""Convert a table of poses, or a recorded nav_msgs/Path, to motion targets.

A pose is the frame of an arm's TCP in the part: its Z points from the tool into the part, and
its X to the side of the tool. So the pose also gives the spin, the turn of the tool about its
axis.
"""

from __future__ import annotations

import re
from math import nan, pi

import numpy as np

from cnc_interp.core import MM, MM_PER_MIN, FloatArray
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.notices import Notices
from cnc_interp.program.readers.cl_data import ClReader
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

PLACE, TURN = ('X', 'Y', 'Z'), ('QX', 'QY', 'QZ', 'QW')
FEED = 'FEED'
_UNIT_QUATERNION = 5e-3  # published tables carry few decimals
_SAME = 1e-9  #: Poses that differ by less are equal [m, rad].
_DOWN = 1e-6  #: Least distance of the tool axis from -Z of the part [-].
_BETWEEN = re.compile(r'[\s,;]+')
_IN_PATH = 'XYZXYZW'  #: Numbers of each pose in a path: position [m] and quaternion.
_NUMBER = re.compile(r'(?:-\s+)?([XYZW]):\s*(\S+)')


class PoseReader(ClReader):
    no_feed = 'no feedrate; add the column feed [mm/min], or choose one (settings, --feed)'

    def __init__(self, geometry: Transform, settings: Settings, source: Source, notices: Notices):
        super().__init__(geometry, settings, source, notices)
        self._columns = list[str]()
        self._values = list[float]()  # of a pose in a path, so far
        self._pose: FloatArray | None = None  # the last one: tip [m], axis [-], spin [rad]
        self._height, arm = settings.flank_height, geometry.machine.arm
        self._column = None if arm is None else self.targets.give_spin()

    def _statement(self, line_number: int, statement: str) -> None:
        self.line_number = line_number
        words = _BETWEEN.split(statement.strip(' ,;'))
        if self._columns:
            if not statement.startswith('#'):
                self._row(words)
        elif set(PLACE + TURN) <= set(words):
            unknown = [word for word in words if word not in (*PLACE, *TURN, FEED)]
            twice = len(set(words)) < len(words)
            self._demand(not unknown and not twice, 'the columns are x y z qx qy qz qw and feed')
            self._columns = words
        elif number := _NUMBER.fullmatch(statement):
            self._values.append(self._float(number[2]))
            expected = _IN_PATH[len(self._values) - 1]
            self._demand(number[1] == expected, f'expected {expected.lower()}', statement)
            if number[1] == 'W':
                place, turn = np.split(np.array(self._values), [3])
                self._values.clear()
                self._go_to(place, turn)
        else:
            self._demand(
                statement not in ('...', "'...'", "- '...'"),
                'poses are left out here; record with ros2 topic echo --full-length',
            )

    def _float(self, word: str) -> float:
        try:
            return float(word)
        except ValueError:
            raise self._fault('not a number', word) from None

    def _row(self, words: list[str]) -> None:
        told = f'expected {len(self._columns)} numbers, as the header names them'
        self._demand(len(words) == len(self._columns), told)
        row = dict(zip(self._columns, map(self._float, words), strict=True))
        if FEED in row:
            self._demand(0.0 < row[FEED] < np.inf, 'a feed must be greater than 0', FEED)
            self.feedrate = row[FEED] * MM_PER_MIN
        place, turn = (np.array([row[name] for name in names]) for names in (PLACE, TURN))
        self._go_to(place * MM, turn)

    def _go_to(self, place: FloatArray, turn: FloatArray) -> None:
        """Add a pose: position [m] and quaternion x y z w."""
        length = float(np.linalg.norm(turn))
        self._demand(
            abs(length - 1.0) <= _UNIT_QUATERNION,
            f'the quaternion has length {length:g} instead of 1; correct it',
        )
        x, y, z, w = turn / length
        side = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
        axis = -np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
        self.axis = float(axis[0]), float(axis[1]), float(axis[2])
        spin = nan
        if self._column is not None:
            before = self._pose
            spin = self._spin_of(axis, side, 0.0 if before is None else float(before[6]))
            pose = np.array([*place, *axis, spin])
            if before is not None:
                moved = np.abs(pose - before) > _SAME
                self._demand(
                    moved[:6].any() or not moved[6],
                    'the tool only turns about its own axis here; move or tilt it in this block, '
                    'too',
                )
            self._pose = pose
            self.targets.extra_start[self._column] = spin * self._height
        else:
            self._notice('poses', 'only the tool axis counts, the turn about it is free')
        self._go(*place.tolist())

    def _spin_of(self, axis: FloatArray, side: FloatArray, near: float) -> float:
        """Return the spin [rad] of a tool with this axis and side, nearest to ``near``."""
        i, j, k = axis
        self._demand(1.0 + k > _DOWN, 'the tool points along -Z of the part; turn the part frame')
        zero = np.array([1.0 - i * i / (1.0 + k), -i * j / (1.0 + k), -i])
        spin = float(np.arctan2(np.cross(zero, side) @ axis, zero @ side))
        return spin + 2.0 * pi * round((near - spin) / (2.0 * pi))
