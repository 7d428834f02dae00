"""Conversion of the words of an arc to its centre, plane and sense of rotation."""

from math import nan

import numpy as np

from cnc_interp.core import BoolArray, DependsOn, FloatArray
from cnc_interp.program.geometry.arcs import FAULTS, OF_PLACE, PLANES, TOLD, Arcs, arcs_of
from cnc_interp.program.modal.state import ModalState
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import FANUC, LINUXCNC, PLAIN
from cnc_interp.program.text.words import BlockWords

#: Plane given by two centre letters of an arc.
_PLANE_OF = {'IJ': 'G17', 'IK': 'G18', 'JK': 'G19'}


class ArcTargets(ModalState):
    """The modal state extended by arcs: the last centre, and how I J K are interpreted."""

    def _arc(self, target: FloatArray, words: BlockWords) -> tuple[float, ...]:
        offset, absolute = np.full((1, 3), nan), np.zeros((1, 3), dtype=bool)
        for i, letter in enumerate('IJK'):
            if letter in words.values:
                way = words.ways[letter]
                absolute[0, i] = way == 'AC' or (self.centre_absolute and way != 'IC')
                sense = 1.0 if way or absolute[0, i] else self.centre_sense
                offset[0, i] = sense * words.values[letter] * self.unit
        radius = words.values.get('R', nan) * self.unit
        if words.values.keys() <= {'P'} and self.dialect is not LINUXCNC:
            offset, radius = self._modal_centre(words, target, offset, radius)
        self.last_centre, self.last_radius = offset, radius
        turns = words.values.get('P', 1.0)
        self.demand(
            turns >= 1.0 and turns == round(turns) and turns <= 500.0,
            'the number of turns of an arc must be a whole number, 1 to 500',
            f'P{turns:g}',
        )
        plane = self._plane_told(target, offset, bool(absolute.any()))
        arcs = self._arcs_to(target, offset, absolute, plane, radius, turns)
        kind = int(arcs.fault[0])
        as_centre = kind == 3 and self._fits(target, offset, absolute=True)
        back = kind == 3 and self.centre_sense > 0.0 and self._fits(target, -offset)
        if not absolute.any():
            kind = 8 if as_centre else 9 if back else kind
        if kind:
            amount = f' (by {arcs.mismatch[0] / self.unit:.4g})' if kind in (3, 4) else ''
            on = DependsOn.PLACE if kind in OF_PLACE else DependsOn.STATE
            if words.g and words.values.keys().isdisjoint('IJKR'):
                on = DependsOn.LINE
            fault = self.fault(FAULTS[kind] + amount, f'G{self.motion}', on)
            if kind < 8 or not self.centres_open or (as_centre and back):
                raise fault
            self.centres_open, self.centre_absolute = False, as_centre
            self.centre_sense = 1.0 if as_centre else -1.0
            self.notice('I J K', codes.CENTRES_TOLD[kind])
            arc, self.lone_arc = self._arc(target, words), fault
            return arc
        if np.isfinite(offset).any():
            self.centres_open = False
            if self.lone_arc and not self._fits(target, offset if absolute.any() else -offset):
                self.agreeing += 1
                if self.agreeing == 2:
                    self.lone_arc = None
        if arcs.mismatch[0] > TOLD:
            self.notice(
                'arcs',
                'the distance from the centre differs at their ends by up to '
                f'{arcs.mismatch[0] / self.unit:.3g}, as a control accepts it; the radius '
                'changes evenly',
            )
        centre = self.frames.point(arcs.centre[0])
        self._scale_in_plane(plane)
        normal = self.frames.plane(*PLANES[plane][:2])[:, 2]
        return (*centre, *normal, float(arcs.sweep[0]))

    def _modal_centre(
        self, words: BlockWords, target: FloatArray, offset: FloatArray, radius: float
    ) -> tuple[FloatArray, float]:
        """Return centre and radius; if a block has neither, those of the last arc if they fit."""
        if self.last_radius > 0.0 and words.g:
            found = offset, self.last_radius
        elif self._fits(
            target, self.last_centre, plane=self._plane_told(target, self.last_centre)
        ):
            found = self.last_centre, radius
        else:
            return offset, radius
        self.notice(
            'WARNING: arcs without I J K and R',
            'those of the previous arc are used; some controls move straight',
        )
        return found

    def _plane_told(self, target: FloatArray, offset: FloatArray, absolute: bool = False) -> str:
        """Return the active plane, or the plane of I J K if the arc fits in that one only."""
        given = set(np.array(list('IJK'))[np.isfinite(offset[0])])
        known = given and self.dialect in (FANUC, PLAIN)
        if known and not (len(given) == 1 and self._fits(target, offset, absolute)):
            for letters, plane in _PLANE_OF.items():
                other = given <= set(letters) and plane != self.plane
                if other and self._fits(target, offset, absolute, plane):
                    what = 'WARNING: arcs in another plane than the active one'
                    self.notice(
                        what, 'the plane follows from I J K; most controls need G17, G18 or G19'
                    )
                    return plane
        return self.plane

    def _fits(
        self, target: FloatArray, offset: FloatArray, absolute: bool = False, plane: str = ''
    ) -> bool:
        return not self._arcs_to(target, offset, absolute, plane or self.plane).fault[0]

    def _arcs_to(
        self,
        target: FloatArray,
        offset: FloatArray,
        absolute: BoolArray | bool,
        plane: str,
        radius: float = nan,
        turns: float = 1.0,
    ) -> Arcs:
        return arcs_of(
            plane,
            np.array([self.motion == 3]),
            self.here()[None, :3],
            target[None, :3],
            offset,
            np.array([radius]),
            absolute,
            turns,
            self.unit,
        )

    def _scale_in_plane(self, plane: str) -> float:
        first, second = (abs(float(self.frames.factor[i])) for i in PLANES[plane][:2])
        self.demand(
            first == second, 'an arc or corner whose axes have different scales; post it as lines'
        )
        return first
