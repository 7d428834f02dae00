"""Codes with their own meaning of axis words: offsets and reference points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.units import DEG
from cnc_interp.program import codes
from cnc_interp.program.control_profiles import FANUC, LINUXCNC
from cnc_interp.program.job import MOST_TOOL, SetupChange, Tool
from cnc_interp.program.modal_state import FARTHEST
from cnc_interp.program.motion import Mover
from cnc_interp.program.target_row import EXTRA_LETTERS
from cnc_interp.program.words import BlockWords

MOST_ANGLE = 3600.0  #: Largest rotation of a work offset [deg].


class AxisCodes:
    """G10, G28, G28.1, G30, G30.1, G52 and G92 to G92.3; all but G52 change the setup."""

    def __init__(self, mover: Mover):
        self._mover, self.fault = mover, mover.fault

    def execute(self, code: str, words: BlockWords) -> None:
        mover, values = self._mover, words.values
        frames = mover.frames
        if code == 'G10':
            self._write_setup(words)
        elif code in ('G28', 'G30'):
            self._reference(code, words)
        elif code in ('G28.1', 'G30.1'):
            machine = np.concatenate([mover.point + mover.zero, mover.rotary])
            letters = ('X', 'Y', 'Z', *mover.rotary_letters)
            place = dict(zip(letters, machine.tolist(), strict=False))
            mover.change(SetupChange('reference_points', place, code[:3]))
        elif code == 'G52':
            # The frame moves; the tool does not.
            for i, value in self._offset_words(values).items():
                frames.local[i] = value
            frames.update()
        elif code == 'G92':
            # Suspended values do not come back: G92 starts from what counts now, as in LinuxCNC.
            here, amounts = mover.here(), frames.g92.copy()
            for i, value in self._offset_words(values).items():
                if i < 3:
                    amounts[:3] += frames.programmed_turn[:, i] * (here[i] - value)
                else:
                    amounts[i] += here[i] - value
            mover.change(SetupChange('g92', frames.g92_of(amounts)))
            mover.change(SetupChange('g92_on', True))
        else:
            if code == 'G92.1':
                mover.change(SetupChange('g92', {}))
            mover.change(SetupChange('g92_on', code == 'G92.3'))

    def _offset_words(self, values: dict[str, float]) -> dict[int, float]:
        """Remove axis words and return them as offsets by axis number [m, rad]."""
        found = {}
        for i, letter in enumerate(('X', 'Y', 'Z', *self._mover.rotary_letters)):
            if letter in values:
                found[i] = values.pop(letter) * (self._mover.unit if i < 3 else DEG)
                if not abs(found[i]) <= FARTHEST:
                    raise self.fault('an offset beyond 100,000 mm; correct it', letter)
        return found

    def _write_setup(self, words: BlockWords) -> None:
        """Process G10: L2 and L20 set a work offset, L1, L10 and L11 a tool."""
        kind, index = words.values.pop('L', 0.0), words.values.pop('P', 0.0)
        dialect = self._mover.dialect
        if self._mover.incremental and kind != 20.0 and dialect is not LINUXCNC:
            raise self.fault(codes.G10_CONFLICTS['incremental'], f'G10 L{kind:g}')
        if kind == 2.0 and index == 0.0 and dialect is not LINUXCNC:
            raise self.fault(codes.G10_CONFLICTS['L2 P0'], 'G10 L2 P0')
        if dialect is FANUC and kind in (10.0, 12.0) and 'R' in words.values:
            words.values['Z' if kind == 10.0 else 'R'] = words.values.pop('R')
            kind = 1.0
        if kind in (10.0, 11.0) and 'R' in words.values and 'Z' not in words.values:
            raise self.fault(codes.G10_CONFLICTS['tool R'], f'G10 L{kind:g} R')
        if dialect is LINUXCNC:
            for letter in 'IJQ':  # of a lathe
                words.values.pop(letter, None)
        if kind in (1.0, 10.0, 11.0):
            self._write_tool(int(kind), index, words)
            return
        if kind not in (2.0, 20.0) or index not in range(10):
            raise self.fault('only L2 and L20 with P0 to P9, and L1, L10 and L11 are supported',
                             'G10')  # fmt: skip
        mover, angle, here = self._mover, words.values.pop('R', None), None
        if angle is not None:
            if kind == 20.0:
                raise self.fault('L20 takes no rotation; write it with L2', words.texts['R'])
            if not abs(angle) <= MOST_ANGLE:
                raise self.fault('a rotation beyond ten turns; correct it', words.texts['R'])
            angle *= DEG
        if kind == 20.0:
            here = np.concatenate([mover.point, mover.rotary])
        given = self._offset_words(words.values)
        mover.change(mover.frames.work_change(int(index), given, here, angle))

    def _write_tool(self, kind: int, number: float, words: BlockWords) -> None:
        """Process G10 L1, L10 and L11: set the length (Z) and the radius (R) of a tool.

        L1 gives the length. L10 gives the coordinate that Z reads here once the tool is taken by
        G43; L11 the same in G59.3, without G92.
        """
        mover, frames, values = self._mover, self._mover.frames, words.values
        if number not in range(1, MOST_TOOL + 1):
            raise self.fault(f'G10 L{kind} needs P with a tool number, 1 to {MOST_TOOL}', 'G10')
        if mover.tcp and kind != 1:
            raise self.fault('a tool is measured with tool-tip programming off', f'G10 L{kind}')
        tool = mover.setup.tools.get(int(number), Tool())
        length, radius = tool.length, tool.radius
        if 'R' in values:
            radius = values.pop('R') * mover.unit
            if not 0.0 <= radius <= FARTHEST:
                raise self.fault('the radius must not be below 0', words.texts['R'])
        given = self._offset_words(values)
        if 2 in given:
            length = given.pop(2)
            if kind == 10:
                length = float(mover.point[2] - (frames.origin[2] - frames.length)) - length
            elif kind == 11:
                length = float(mover.point[2] - frames.work('G59.3')[2]) - length
        if given:
            raise self.fault('a tool has a length (Z) and a radius (R) only', f'G10 L{kind}')
        measured = replace(tool, length=length, radius=radius)
        if measured.corner_radius is not None and measured.corner_radius > radius:
            raise self.fault('the corner radius of the tool is larger', words.texts['R'])
        mover.change(SetupChange('tools', measured, int(number)))

    def _reference(self, code: str, words: BlockWords) -> None:
        """Process G28 and G30: rapid over the point of the block to the reference point."""
        mover = self._mover
        word = mover.machine_words(words)
        letters = ('X', 'Y', 'Z', *mover.rotary_letters)
        named = [letter for letter in letters if letter in words.values]
        beside = [letter for letter in mover.extra_letters if letter in words.values]
        mover.extra = mover.extra_target(words, machine=False)
        if named or beside:
            target = mover.target(words)
            rotary = (
                target[3:] + mover.frames.rotary_origin if mover.rotary_letters else mover.rotary
            )
            mover.go(mover.frames.point(target[:3]), rotary, rapid=True)
        point, rotary = mover.point.copy(), mover.rotary.copy()
        mover.extra = np.where([letter in beside for letter in EXTRA_LETTERS], 0.0, mover.extra)
        for letter in named or ([] if beside else letters):
            home = mover.setup.reference_points.get(code, {}).get(letter, 0.0)
            if letter in 'XYZ':
                i = 'XYZ'.index(letter)
                point[i] = mover.frames.machine_point(i, home)
            else:
                rotary[mover.rotary_letters.index(letter)] = home
                mover.named = 1.0
        mover.go(point, rotary, rapid=True)
        if word:
            mover.switch_tcp(word)
