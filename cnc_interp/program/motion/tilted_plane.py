"""Tilted working planes: a frame in space, on which the tool is turned upright.

G68.2 to G68.4 and CYCLE800 define the frame; G53.1, G53.3, G53.6 and CYCLE800 turn the tool. Then
X Y Z are positions of the tip in the plane until G69 (``docs/how_it_works/tilted_planes.md``).
"""

from collections.abc import Sequence
from math import pi

import numpy as np

from cnc_interp.core import DEG, FloatArray
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.geometry.frames import rotation
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.text.words import BlockWords

#: Codes that define a plane; these and the codes that turn the tool to it.
DEFINING = {'G68', 'G68.2', 'G68.3', 'G68.4'}
CODES = DEFINING | {'G53.1', 'G53.3', 'G53.6'}
#: Orders of rotations: about turned axes (Euler), and about fixed axes.
EULER = (313, 323, 121, 131, 212, 232)
FIXED = (123, 132, 213, 231, 312, 321)
SMALL = 1e-6  #: Tolerance for parallel and perpendicular directions [-].
#: Indices of the arguments of CYCLE800; retract and name of the swivel data come before.
STATE, MODE, BEFORE, ANGLES, AFTER, DIRECTION = 2, 3, slice(4, 7), slice(7, 10), slice(10, 13), 13
BY_AXES, SOLID, PROJECTED, DIRECT = range(4)  #: Kinds of angles of CYCLE800.


class TiltedPlane:
    def __init__(self, mover: Mover):
        self._mover, self.notice = mover, mover.notice
        self.fault, self.demand, self.refuse_if = mover.fault, mover.demand, mover.refuse_if
        #: Points or directions of a plane defined by several blocks (P2, P3), by number.
        self.parts: dict[int, tuple[FloatArray, FloatArray, float]] = {}

    def refuse_gaps(self, codes: Sequence[str]) -> None:
        """Reject other words until all blocks of a plane have been read."""
        self.refuse_if(
            self.parts and not DEFINING & set(codes),
            'the plane of G68.2 is not complete; P2 takes three points, Q1 Q2 '
            'Q3, P3 two directions',
        )

    def execute(self, code: str, words: BlockWords) -> None:
        if code in DEFINING:
            self._define(code, words)
        else:
            self._orient(code, words)

    def _define(self, code: str, words: BlockWords) -> None:
        if code == 'G68':
            self._turn_in_plane(words)
            return
        named = {letter for letter in 'XYZ' if letter in words.values}
        origin = self._take(words, 'XYZ', self._mover.unit)
        if code == 'G68.3':
            self._along_tool(origin, named, self._angle(words, 'R'))
            return
        form = words.values.pop('P', 0.0)
        self.demand(form in range(5), 'P must be a whole number, 0 to 4', words.texts.get('P', ''))
        if form in (2, 3):
            self._collect(int(form), code, origin, words)
            return
        order = words.values.pop('Q', 0.0)
        turn = self._turn_of(int(form), order, words)
        self._set(code, origin, turn, self._angle(words, 'R'))

    def _turn_of(self, form: int, order: float, words: BlockWords) -> FloatArray:
        angles = self._take(words, 'IJK', DEG)
        if form == 4:
            return self._projected(angles)
        orders = FIXED if form else EULER
        order = order or orders[0]
        if order not in orders:
            text = ' '.join(str(found) for found in orders)
            raise self.fault(f'the order of rotations must be one of {text}', f'Q{order:g}')
        axes = [int(digit) - 1 for digit in str(int(order))]
        turn = np.eye(3)
        for i, axis in enumerate(axes):
            if form:  # I turns about X, J about Y, K about Z, which all stay where they are
                turn = rotation(axis, angles[axis]) @ turn
            else:  # I J K in the order of the rotations, about the axes as turned so far
                turn = turn @ rotation(axis, angles[i])
        return turn

    def _projected(self, angles: FloatArray) -> FloatArray:
        """Return the plane through X turned I about Y and Y turned J about X, then turned by K."""
        along, beside = rotation(1, angles[0])[:, 0], rotation(0, angles[1])[:, 1]
        normal = np.cross(along, beside)
        return self.plane_of(along, normal) @ rotation(2, angles[2])

    def _collect(self, form: int, code: str, origin: FloatArray, words: BlockWords) -> None:
        part = words.values.pop('Q', 0.0)
        self.demand(
            part in range(4 if form == 2 else 3),
            'Q must be the number of the point or direction',
            f'Q{part:g}',
        )
        direction = self._take(words, 'IJK', 1.0)
        if part in self.parts:
            self.parts.clear()  # another definition begins
        self.parts[int(part)] = origin, direction, self._angle(words, 'R')
        if form == 2 and {1, 2, 3} <= self.parts.keys():
            first, second, third = (self.parts[k][0] for k in (1, 2, 3))
            # Q0 gives the origin, if it comes before; else that is the first point.
            origin, _, angle = self.parts.get(0, self.parts[1])
            along = second - first
            turn = self.plane_of(along, np.cross(along, third - first))
            self._set(code, origin, turn, angle)
        elif form == 3 and len(self.parts) == 2:
            (origin, along, angle), (_, normal, _) = (self.parts[k] for k in sorted(self.parts))
            lengths = float(np.linalg.norm(along) * np.linalg.norm(normal))
            self.demand(
                abs(along @ normal) <= SMALL * lengths,
                'X and Z of the plane are not at right angles; correct I J K',
                code,
            )
            self._set(code, origin, self.plane_of(along, normal), angle)

    def plane_of(self, along: FloatArray, normal: FloatArray) -> FloatArray:
        z = self._unit(normal)
        y = self._unit(np.cross(z, self._unit(along)))
        return np.stack([np.cross(y, z), y, z], axis=1)

    def _unit(self, direction: FloatArray) -> FloatArray:
        length = float(np.linalg.norm(direction))
        self.demand(
            length > SMALL * self._mover.unit,
            'these words give no plane; its points lie on one line, or a direction is zero',
        )
        return np.asarray(direction / length)

    def _along_tool(self, origin: FloatArray, named: set[str], angle: float) -> None:
        self.refuse_if(
            named and len(named) < 3, 'give X, Y and Z of the origin, or none of them', 'G68.3'
        )
        mover = self._mover
        self.cancel()
        normal = mover.frames.turn.T @ mover.tool_axis  # in the frame of the work offset
        up = np.array([0.0, 0.0, 1.0])
        along = np.cross(up, normal)
        if np.linalg.norm(along) < SMALL:
            along = np.array([1.0, 0.0, 0.0])
        if not named:
            mover.set_oriented(True)
            origin = mover.here()[:3]
        self._set('G68.3', origin, self.plane_of(along, normal), angle)
        mover.set_oriented(True)

    def _set(self, code: str, origin: FloatArray, turn: FloatArray, angle: float) -> None:
        """Set a frame, turned about its own Z; G68.4 is relative to the current frame."""
        self.parts.clear()
        frames = self._mover.frames
        if code != 'G68.4':
            frames.reset_frame()
        frames.tilt(code, origin, turn @ rotation(2, angle))

    def _turn_in_plane(self, words: BlockWords) -> None:
        """Process G68: turn the program coordinates about a point, or about I J K in space."""
        mover, frames = self._mover, self._mover.frames
        self.demand('R' in words.values, 'give the angle R', 'G68')
        angle, here = self._angle(words, 'R'), mover.here()[:3]
        axis = np.eye(3)[PLANES[mover.plane][2]]
        if any(letter in words.values for letter in 'IJK'):
            axis = self._unit(self._take(words, 'IJK', 1.0))
        centre = here.copy()
        for i, value in words.take('XYZ').items():
            centre[i] = value * mover.unit
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # Rodrigues' formula.
        turn = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        frames.tilt('G68', centre - turn @ centre, turn)

    def cancel(self) -> None:
        self.parts.clear()
        self._mover.set_oriented(False)
        self._mover.frames.reset_frame()
        self._mover.frames.update()

    def _orient(self, code: str, words: BlockWords) -> None:
        """Process G53.1, G53.3, G53.6: turn the tool; P1: tilting axis above 0, P2: below 0."""
        choice = words.values.pop('P', 0.0)
        self.demand(choice in (0.0, 1.0, 2.0), 'P must be 0, 1 or 2', words.texts.get('P', ''))
        if not self._mover.frames.rotated and code != 'G53.3':
            self.notice(code, 'the frame is not tilted')
        self.stand_up(code, int(choice), words)

    def stand_up(self, code: str, choice: int, words: BlockWords, table: bool = False) -> None:
        """Turn the tool upright; ``choice``: P of G53.1; ``code``: which point stays in place."""
        mover = self._mover
        mover.rotary_of_vector()
        rotary = self.solution(choice, code, table)
        if code != 'G53.1':
            mover.set_oriented(True)
            stays = code == 'G53.6'
            point = mover.point if stays else mover.frames.point(mover.target(words)[:3])
            mover.turn_to(point, rotary)
            return
        tcp = mover.tcp
        mover.set_oriented(False)
        mover.switch_tcp('')
        mover.turn_to(mover.point, rotary)
        mover.set_oriented(True)
        if tcp:
            mover.switch_tcp(tcp)

    def solution(self, choice: int, code: str, table: bool = False) -> FloatArray:
        """Return rotary positions [rad]; at the pole an axis stays, or with ``table`` aligns X."""
        mover, (along, _, normal) = self._mover, self._mover.frames.turn.T
        if not mover.rotary_letters:
            self.demand(
                normal[2] >= 1.0 - SMALL,
                'the tool cannot be turned; this machine has no rotary axes',
                code,
            )
            return mover.rotary
        geometry, low, high = mover.geometry.five_axis, *mover.geometry.machine.travel[3:5].T
        tilting = 1 - geometry.outer
        found, free = [], None
        upright = np.arccos(np.clip(normal @ geometry.pole, -1.0, 1.0))
        if upright < geometry.machine.singular_cone:
            free = mover.rotary.copy()
            if table and not geometry.machine.rotary_on_head[geometry.outer]:
                free[geometry.outer] = -np.arctan2(along[1], along[0]) * geometry.pole[2]
        for near in geometry.branches(normal, mover.rotary, free):
            near = near - 2.0 * pi * np.ceil(np.maximum(near - high, 0.0) / (2.0 * pi) - SMALL)
            near = near + 2.0 * pi * np.ceil(np.maximum(low - near, 0.0) / (2.0 * pi) - SMALL)
            if np.all((near >= low - SMALL) & (near <= high + SMALL)):
                found.append(np.clip(near, low, high))
        self.demand(
            found,
            'the machine cannot reach the tool axis of the plane; choose another clamping',
            code,
        )
        sign = (0.0, 1.0, -1.0)[choice]
        wanted = [pair for pair in found if sign * pair[tilting] >= -SMALL]
        if not wanted:
            self.notice(code, 'the requested solution is beyond the travel; the other one is used')
        return min(wanted or found, key=lambda pair: float(np.abs(pair - mover.rotary).sum()))

    def swivel(self, given: Sequence[float | None], words: BlockWords) -> None:
        values = [value or 0.0 for value in given] + [0.0] * (DIRECTION + 1)
        state, direction = int(values[STATE]), values[DIRECTION]
        self.demand(
            direction in (-1.0, 1.0),
            'the direction must be 1 or -1; a frame alone is ROT',
            'CYCLE800',
        )
        if values[0]:
            self.notice('CYCLE800', 'no retract; move the tool away in an earlier block')
        turn = self._swivelled(int(values[MODE]), np.array(values[ANGLES]) * DEG)
        unit, frames = self._mover.unit, self._mover.frames
        self._set('G68.4' if state % 10 else 'G68.2', np.array(values[BEFORE]) * unit, turn, 0.0)
        frames.move(np.array(values[AFTER]) * unit)
        tip_stays = state // 10 % 10 == 1
        self.stand_up('G53.6' if tip_stays else 'G53.1', 1 if direction > 0.0 else 2, words)

    def _swivelled(self, mode: int, angles: FloatArray) -> FloatArray:
        """Return the rotation, (3, 3); ``mode``: kind, then two bits per axis, the last first."""
        kind, axes = mode >> 6, [(mode >> shift & 3) - 1 for shift in (0, 2, 4)]
        self.demand(
            kind != DIRECT,
            'rotary positions cannot define a plane; turn the axes by G0, then write G68.3',
            'CYCLE800',
        )
        if kind == SOLID:
            self.demand(
                not angles[2], 'solid angles are two; leave the third one at 0', 'CYCLE800'
            )
            return np.asarray(rotation(2, angles[0]) @ rotation(1, angles[1]))
        if kind == PROJECTED and sorted(axes[:2]) == [0, 1]:
            return self._projected(angles[[axes.index(1), axes.index(0), 2]])
        self.demand(
            kind == BY_AXES and sorted(axes) == [0, 1, 2],
            'give the angles axis by axis (mode 27, 30, 39, 45, 54 or 57), as solid angles '
            '(64) or projected on X and Y (182, 185)',
            'CYCLE800',
        )
        turn = np.eye(3)
        for axis, angle in zip(axes, angles, strict=True):
            turn = turn @ rotation(axis, angle)
        return turn

    def _take(self, words: BlockWords, letters: str, size: float) -> FloatArray:
        return np.array([words.values.pop(letter, 0.0) * size for letter in letters])

    def _angle(self, words: BlockWords, letter: str) -> float:
        return words.values.pop(letter, 0.0) * DEG
