"""Frames of CL data: coordinate systems, TRACUT and COPY.

The points after MSYS (NX: origin, X, Y) or CSYS (three rows of four numbers, or X, Y, Z and the
origin) lie in that system. The first one is that of the workpiece; others are taken into it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import DEG
from cnc_interp.program.frames import rotation

#: How far the axes of a system may be from right angles [-].
_ROUNDED = 1e-4
_COPY = re.compile(r'(\d+)\s*(?:,\s*(SAME|TRANSL|XYROT|YZROT|ZXROT)\s*((?:,\s*[-+.\dE]+\s*)*))?')
_MOST_COPIES = 10_000  #: A part of a program is copied at most so many times.

IDENTITY = '1,0,0,0,0,1,0,0,0,0,1,0'  #: A system that moves nothing.


def system_of(numbers: Sequence[float]) -> tuple[FloatArray, FloatArray] | None:
    """Return axes as columns, shape (3, 3), and origin of a system; None if it is not one."""
    rows = np.array(numbers)
    if len(rows) == 9:
        x, y = rows[3:6], rows[6:]
        found = [(np.stack([x, y, np.cross(x, y)], axis=1), rows[:3])]
    elif len(rows) == 12:
        whole = rows.reshape(3, 4)
        found = [(whole[:, :3], whole[:, 3]), (rows[:9].reshape(3, 3).T, rows[9:])]
    else:
        return None
    for axes, origin in found:
        if np.abs(axes.T @ axes - np.eye(3)).max() < _ROUNDED and np.linalg.det(axes) > 0.0:
            left, _, right = np.linalg.svd(axes)
            return np.asarray(left @ right), origin
    return None


def moves(system: tuple[FloatArray, FloatArray]) -> bool:
    return bool(np.abs(system[0] - np.eye(3)).max() > 1e-9 or np.abs(system[1]).max() > 1e-9)


class ClFrames:
    def __init__(self) -> None:
        self._first: tuple[FloatArray, FloatArray] | None = None
        self._system = self._cut = self._copied = np.eye(3), np.zeros(3)
        self.is_moved = False  # whether points are not as they are written
        self._marks: dict[int, int] = {}  # INDEX by number: the first statement after it
        self.kept: list[tuple[int, str]] = []  # statements since the first INDEX

    def enter(self, system: tuple[FloatArray, FloatArray]) -> bool:
        self._first = axes, origin = self._first or system
        self._system = axes.T @ system[0], axes.T @ (system[1] - origin)
        self._note()
        return moves(self._system)

    def cut(self, system: tuple[FloatArray, FloatArray]) -> None:
        """Process TRACUT: the points from here on are moved by a system."""
        self._cut = system
        self._note()

    def _note(self) -> None:
        parts = (self._system, self._cut, self._copied)
        self.is_moved = any(moves(part) for part in parts)

    def point(self, point: Sequence[float]) -> FloatArray:
        """Return a point in the frame of the workpiece, shape (3,)."""
        found = np.array(point)
        for axes, origin in (self._cut, self._copied, self._system):
            found = axes @ found + origin
        return found

    def direction(self, direction: Sequence[float]) -> FloatArray:
        found = np.array(direction)
        return self._system[0] @ self._copied[0] @ self._cut[0] @ found if self.is_moved else found

    def index(self, number: int) -> None:
        """Process INDEX: COPY repeats what follows."""
        self._marks[number] = len(self.kept)

    def keep(self, line_number: int, statement: str) -> None:
        if self._marks:
            self.kept.append((line_number, statement))

    def copy(self, minor: str, run: Callable[[int, str], None]) -> bool:
        match = _COPY.fullmatch(minor)
        if match is None or int(match[1]) not in self._marks:
            return False
        given = [float(word) for word in (match[3] or '').split(',') if word.strip()]
        *values, times = given or [1.0]
        kind = match[2] or 'SAME'
        if len(values) != {'SAME': 0, 'TRANSL': 3}.get(kind, 1) or not 0 < times <= _MOST_COPIES:
            return False
        turn, shift = np.eye(3), np.zeros(3)
        if kind == 'TRANSL':
            shift = np.array(values)
        elif kind != 'SAME':
            turn = rotation({'YZROT': 0, 'ZXROT': 1, 'XYROT': 2}[kind], values[0] * DEG)
        before, part = self._copied, self.kept[self._marks.pop(int(match[1])) :]
        for _ in range(int(times)):
            axes, origin = self._copied
            self._copied = turn @ axes, turn @ origin + shift
            self._note()
            for number, statement in part:
                run(number, statement)
        self._copied = before
        self._note()
        return True
