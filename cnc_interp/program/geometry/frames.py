"""Conversion of program coordinates to points: work offsets, shifts, rotated frames, tool length.

    point = work + Rz @ (programmed_turn @ scaled + shift + G52 + G92) + tool length
    scaled = factor * program + moved, for mirroring (factor -1) and scaling

With tool-tip programming, a point is the tip in W; without it, X Y Z minus the workpiece zero.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.program.geometry.program_coordinates import ProgramCoordinates
from cnc_interp.program.job import ROTATION, WORK_OFFSETS, JobSetup, SetupChange

Vector = FloatArray


class Frames:
    """The active frames at one moment; ``zero`` (3,): workpiece zero of the machine file [m]."""

    def __init__(self, setup: JobSetup, zero: Vector, rotary_letters: tuple[str, ...]):
        self._zero = np.concatenate([zero, np.zeros(2)])
        self.letters = ('X', 'Y', 'Z', *rotary_letters)
        self.named = ''  #: Work offset last named by the program; empty before.
        self.local = np.zeros(5)
        self.length = 0.0
        self.names_length = False  #: Whether a word has named or cancelled the tool length.
        self.along = np.array([0.0, 0.0, 1.0])  #: Direction of the tool length.
        #: Shift and rotation that the program has set, in the frame of the work offset.
        self.shift, self.programmed_turn = np.zeros(3), np.eye(3)
        self.tilt_code = ''  #: The code of the rotation; empty for ROT.
        #: Position at which each axis number is mirrored [m]; scales and their centre [-, m].
        self.mirrors: dict[int, float] = {}
        self.scale, self.scale_centre = np.ones(3), np.zeros(3)
        self.take(setup)

    def take(self, setup: JobSetup) -> None:
        self._setup = setup
        self._work, self._base = self.work(setup.offset), rotation(2, setup.rotation(setup.offset))
        self.g92 = np.zeros(5)
        for i, letter in enumerate(self.letters):
            self.g92[i] = setup.g92.get(letter, 0.0) if setup.g92_on else 0.0
        self.update()

    def work(self, name: str) -> Vector:
        position = self._setup.work_offsets.get(name, {})
        offset = np.zeros(5)
        for i, letter in enumerate(self.letters):
            offset[i] = position.get(letter, float(self._zero[i])) - self._zero[i]
        return offset

    def follow(self, before: Frames) -> None:
        names = 'named', 'length', 'names_length', 'shift', 'programmed_turn', 'along', 'tilt_code'
        for name in (*names, 'scale', 'scale_centre'):
            setattr(self, name, getattr(before, name))
        self.mirrors = dict(before.mirrors)
        self.local = before.local.copy()
        self.update()

    def work_change(
        self, index: int, words: dict[int, float], here: Vector | None, angle: float | None = None
    ) -> SetupChange:
        """Return the change of an offset by G10 L2, or by L20 (``here`` then reads ``words``)."""
        name = WORK_OFFSETS[index - 1] if index else self._setup.offset
        position = dict(self._setup.work_offsets.get(name, {}))
        if angle is not None:
            position[ROTATION] = angle
        if here is not None:
            words = self.origin_of(name, words, here)
        for i, value in words.items():
            position[self.letters[i]] = value
        return SetupChange('work_offsets', position, name)

    def origin_of(self, name: str, words: dict[int, float], here: Vector) -> dict[int, float]:
        """Return the zero of a work offset with which the position ``here`` reads ``words``."""
        turn = rotation(2, self._setup.rotation(name))
        added, zero = self.local + self.g92, self.work(name)
        gone = here - np.array([*(self.length * self.along), 0.0, 0.0])
        reads = gone - zero - added
        reads[:3] = turn.T @ (gone - zero)[:3] - added[:3]
        for i, value in words.items():
            reads[i] = value
        origin = gone - reads - added + self._zero
        origin[:3] = gone[:3] - turn @ (reads + added)[:3] + self._zero[:3]
        changed = set(words)
        if self._setup.rotation(name) and changed & {0, 1}:
            changed |= {0, 1}
        return {i: float(origin[i]) for i in sorted(changed)}

    def update(self) -> None:
        added = self.local + self.g92
        work, length = self._work[:3], self.length * self.along
        self.origin = work + self._base @ (self.shift + added[:3]) + length
        self.rotary_origin = self._work[3:] + added[3:]
        #: Rotation from program coordinates to points.
        self.turn = self._base @ self.programmed_turn
        self.rotated = bool(np.any(self.turn != np.eye(3)))
        mirror, about = np.ones(3), np.zeros(3)
        for i, place in self.mirrors.items():
            mirror[i], about[i] = -1.0, 2.0 * place
        self.factor = self.scale * mirror
        self._moved = self.scale * (about - self.scale_centre) + self.scale_centre
        self.scales = bool(self.mirrors) or bool(np.any(self.scale != 1.0))
        turned = bool(np.any(self.programmed_turn != np.eye(3)))
        found = {
            'G92': self.g92.any(),
            'G52': self.local.any(),
            'TRANS': self.shift.any(),
            self.tilt_code or 'ROT': turned,
            'G51.1': bool(self.mirrors),
            'G51': bool(np.any(self.scale != 1.0)),
        }
        scaled = self.factor.tobytes(), self._moved.tobytes()
        #: A value that changes whenever other coordinates take effect.
        self.counts = (
            added.tobytes(),
            self.turn.tobytes(),
            self.shift.tobytes(),
            self.length,
            scaled,
        )
        #: Codes of the shifts that are added to the work offset and are not zero.
        self.shifts = tuple(code for code, counts in found.items() if counts)

    def coordinates(self, offset: str, of_tip: bool, rotary: int) -> ProgramCoordinates:
        """Return the program coordinates in effect; ``rotary``: the number of rotary axes."""
        if self.scales:
            return ProgramCoordinates()  # program coordinates do not cover mirrored or scaled axes
        name = ' + '.join((offset, *self.shifts)) + (', tool tip' if of_tip else '')
        origin = self.origin - self.length * self.along, self.rotary_origin[:rotary]
        turn = tuple(self.turn.ravel().tolist())
        return ProgramCoordinates(
            name, of_tip, tuple(np.concatenate(origin).tolist()), turn, self.length
        )

    def point(self, program: Vector) -> Vector:
        """Convert program coordinates to points, (3,) or (n, 3) [m]."""
        scaled = self.factor * program + self._moved if self.scales else program
        turned = scaled @ self.turn.T if self.rotated else scaled
        return np.asarray(turned + self.origin)

    def program(self, point: Vector) -> Vector:
        scaled = self.turn.T @ (point - self.origin)
        return np.asarray((scaled - self._moved) / self.factor)

    def plane(self, a: int, b: int) -> FloatArray:
        """Return the directions of two program axes and of their normal as columns, (3, 3)."""
        first, second = (self.turn[:, i] * np.sign(self.factor[i]) for i in (a, b))
        return np.stack([first, second, np.cross(first, second)], axis=1)

    def reset_scale(self) -> None:
        self.mirrors, self.scale, self.scale_centre = {}, np.ones(3), np.zeros(3)

    def reset_frame(self) -> None:
        self.shift, self.programmed_turn, self.tilt_code = np.zeros(3), np.eye(3), ''

    def tilt(self, code: str, shift: Vector, turn: FloatArray) -> None:
        self.tilt_code = code
        self.shift = self.shift + self.programmed_turn @ shift
        self.programmed_turn = self.programmed_turn @ turn
        self.update()

    def rotate(self, angles: dict[str, float]) -> None:
        for letter in 'ZYX':
            if letter in angles:
                turn = rotation('XYZ'.index(letter), angles[letter])
                self.programmed_turn = self.programmed_turn @ turn
        self.update()

    def move(self, shift: Vector) -> None:
        self.shift = self.shift + self.programmed_turn @ shift
        self.update()


def rotation(axis: int, angle: float) -> FloatArray:
    """Return the rotation matrix about a coordinate axis, (3, 3); right angles are exact."""
    c, s = np.cos(angle), np.sin(angle)
    c, s = (np.round(v) if abs(v - np.round(v)) < 1e-15 else v for v in (c, s))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
    return turn
