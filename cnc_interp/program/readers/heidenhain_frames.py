"""Frames of Heidenhain, each relative to the last: datum shift (cycle 7), planes, rotation (10).

Mirroring (8) and scaling (11, 26) are about the zero of these frames, and are applied first.
"""

from collections.abc import Mapping, Set
from functools import reduce

import numpy as np

from cnc_interp.core import DEG, DependsOn, FloatArray
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.geometry.frames import rotation
from cnc_interp.program.modal.state import ORIENTED
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.motion.tilted_plane import TiltedPlane
from cnc_interp.program.text.words import BlockWords

#: Axis numbers for the angles of a plane, from the last rotation to the first.
_TURNS = {
    'SPATIAL': {'SPC': 2, 'SPB': 1, 'SPA': 0},
    'EULER': {'EULPR': 2, 'EULNU': 0, 'EULROT': 2},
}


class HeidenhainFrames:
    def __init__(self, mover: Mover, tilted: TiltedPlane):
        self._mover, self._tilted = mover, tilted
        self._fault, self._demand, self._refuse_if = mover.fault, mover.demand, mover.refuse_if
        #: Datum shift [mm or inch, deg], plane and rotation [deg], and the angles of cycle 19.
        self._shift: dict[str, float] = {}
        self._turn: FloatArray | None = None
        self._angle = 0.0
        self.angles: dict[str, float] = {}
        #: Whether the rotary axes must still turn to the plane, and their targets (Q120-Q122)
        #: [rad].
        self._waits, self.found = False, mover.rotary

    def shift(self, values: Mapping[str, float]) -> None:
        """Process cycle 7; I and a letter (IX) add to the shift, and zeros end the shift."""
        if self._turn is not None and any(values.values()) and (self._turn != np.eye(3)).any():
            raise self._fault(
                'a datum shift in a tilted plane; write PLANE RESET first', 'CYCL DEF 7'
            )
        if any(values.values()):
            self._mover.demand_no_scale('CYCL DEF 7')
        for name, value in values.items():
            before = self._shift.get(name[1:], 0.0) if name[0] == 'I' else 0.0
            self._shift[name.removeprefix('I')] = before + value
        self._frame()

    def rotate(self, values: Mapping[str, float]) -> None:
        factor = self._mover.frames.factor
        if np.ptp(factor) or (factor < 0.0).any():  # another rotation if it came before
            self._mover.demand_no_scale('CYCL DEF 10')
        self._angle = values.get('ROT', self._angle) + values.get('IROT', 0.0)
        self._frame()

    def mirror(self, values: Mapping[str, float]) -> None:
        """Process cycle 8, which mirrors the axes in ``values`` and no others."""
        frames = self._mover.frames
        mirrors = {'XYZ'.index(letter): 0.0 for letter in values}
        self._set_scale('CYCL DEF 8', mirrors, frames.scale, frames.scale_centre)

    def scale_all(self, values: Mapping[str, float]) -> None:
        """Process cycle 11, which ends the scales of cycle 26."""
        scale = self._mover.scale_of(values.get('SCL', 1.0), 'SCL')
        self._set_scale('CYCL DEF 11', None, np.full(3, scale), np.zeros(3))

    def scale_axes(self, values: Mapping[str, float]) -> None:
        """Process cycle 26: scales of some axes, about CCX, CCY and CCZ."""
        frames, unit = self._mover.frames, self._mover.unit
        scale, centre = frames.scale.copy(), frames.scale_centre.copy()
        for i, letter in enumerate('XYZ'):
            scale[i] = self._mover.scale_of(values.get(letter, scale[i]), letter)
            centre[i] = values.get(f'CC{letter}', centre[i] / unit) * unit * (scale[i] != 1.0)
        self._set_scale('CYCL DEF 26', None, scale, centre)

    def _set_scale(
        self,
        cycle: str,
        mirrors: dict[int, float] | None,
        scale: FloatArray,
        centre: FloatArray,
    ) -> None:
        frames, mover = self._mover.frames, self._mover
        mirrors = frames.mirrors if mirrors is None else mirrors
        if not (frames.scales or mirrors or (scale != 1.0).any()):
            return
        self._refuse_if(
            mover.tcp or mover.oriented or self._turn is not None,
            'not possible with tool-tip programming or a tilted plane; post the path itself',
            cycle,
        )
        self._demand(
            not (mirrors and centre.any()),
            'not possible with a mirrored axis and a centre; cancel the mirroring first',
            cycle,
        )
        mover.end_corner()
        frames.mirrors, frames.scale, frames.scale_centre = mirrors, scale, centre
        frames.update()

    def add_angles(self, values: Mapping[str, float]) -> None:
        self.angles |= values
        angles = {name: value for name, value in self.angles.items() if name in 'ABC'}
        turn = self._plane_of('SPATIAL', {f'SP{name}': value for name, value in angles.items()})
        others = [name for name, value in angles.items() if value]
        self._demand(
            len(others) <= 1,
            'angles in space on some machines, positions of axes on others; '
            'post with PLANE SPATIAL or PLANE AXIAL',
            'CYCL DEF 19',
        )
        if not others:
            self._turn, self._waits = None, False
            self._mover.set_oriented(False)
            self._frame()
            return
        self._mover.demand_no_scale('CYCL DEF 19')
        self._turn = turn
        self._frame()
        self._position('STAY', 0)

    def tilt(
        self, kind: str, values: Mapping[str, float], way: str, choice: int, table: bool
    ) -> None:
        """Process PLANE: the rotary axes move at once (MOVE, TURN), or by later words (STAY)."""
        if kind == 'RESET':
            self._tilted.cancel()
            self._turn, self._waits = None, False
            self._frame()
            if way != 'STAY':
                self._position(way or 'MOVE', 0)
                self._mover.set_oriented(False)
            return
        self._mover.demand_no_scale(f'PLANE {kind}')
        self._turn = self._plane_of(kind, values)
        self._frame()
        self._position(way, choice, table)

    def _frame(self) -> None:
        frames, unit = self._mover.frames, self._mover.unit
        frames.reset_frame()
        frames.move(np.array([self._shift.get(letter, 0.0) * unit for letter in 'XYZ']))
        if self._turn is not None:
            frames.tilt('PLANE', np.zeros(3), self._turn)
        if self._angle:
            axis = 'XYZ'[PLANES[self._mover.plane][2]]
            frames.rotate({axis: self._angle * DEG})
        for i, letter in enumerate(self._mover.rotary_letters):
            frames.local[3 + i] = self._shift.get(letter, 0.0) * DEG
        frames.update()

    def _plane_of(self, kind: str, values: Mapping[str, float]) -> FloatArray:
        if kind in _TURNS:
            turns = _TURNS[kind].items()
            return reduce(np.matmul, (rotation(i, values.get(k, 0.0) * DEG) for k, i in turns))
        if kind == 'VECTOR':
            along, normal = (np.array([values.get(c + x, 0.0) for x in 'XYZ']) for c in 'BN')
            return self._tilted.plane_of(along, normal)
        if kind == 'AXIAL':
            return self._turn_of_axes(values)
        raise self._fault(
            'only SPATIAL, VECTOR, EULER, AXIAL and RESET of PLANE are supported',
            f'PLANE {kind}',
            DependsOn.LINE,
        )

    def _turn_of_axes(self, values: Mapping[str, float]) -> FloatArray:
        rotary = self._mover.rotary.copy()
        for letter, value in values.items():
            self._demand(
                letter in self._mover.rotary_letters,
                f'the machine has no axis {letter}; remove the word',
                'PLANE AXIAL',
            )
            rotary[self._mover.rotary_letters.index(letter)] = value * DEG
        if not self._mover.rotary_letters:
            return np.eye(3)
        z = self._mover.geometry.tool_axis(rotary[None])[0]
        up = np.array([0.0, 0.0, 1.0])
        angle = float(np.arccos(np.clip(z @ up, -1.0, 1.0)))
        axis = np.cross(up, z)
        if np.linalg.norm(axis) < 1e-9:
            return np.eye(3)
        self._demand(
            np.abs(axis).max() > (1.0 - 1e-12) * np.linalg.norm(axis),
            'the turn of X and Y in this plane depends on the machine; post with PLANE SPATIAL',
            'PLANE AXIAL',
        )
        which = int(np.argmax(np.abs(axis)))
        return rotation(which, float(np.copysign(angle, axis[which])))

    def _position(self, way: str, choice: int, table: bool = False) -> None:
        self.found = self._tilted.solution(choice, 'PLANE', table)
        self._waits = way not in ('TURN', 'MOVE')
        if not self._waits:
            code = 'G53.1' if way == 'TURN' else 'G53.6'
            self._tilted.stand_up(code, choice, BlockWords(), table)
        elif self._stands():
            self._mover.set_oriented(True)
            self._waits = False

    def _stands(self) -> bool:
        return bool(self._mover.tool_axis @ self._mover.frames.turn[:, 2] > 1.0 - 1e-9)

    def before(self, named: Set[str], machine: bool) -> None:
        """Prepare for the words of a block; X Y Z in the plane require a tool upright on it."""
        mover = self._mover
        turns = machine or not named.isdisjoint(mover.rotary_letters)
        if turns and mover.tcp == ORIENTED:
            mover.set_oriented(False)
            self._waits = True
        self._refuse_if(
            self._waits and not machine and not {'X', 'Y', 'Z'}.isdisjoint(named),
            'the tool does not stand upright on the plane; turn the axes in a '
            'block before, or write TURN or MOVE',
            'PLANE',
        )

    def after(self) -> None:
        if self._waits and self._stands():
            self._waits = False
            self._mover.set_oriented(True)
