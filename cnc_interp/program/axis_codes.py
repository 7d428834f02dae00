"""Codes with their own meaning of axis words: offsets and reference points."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.units import DEG
from cnc_interp.program.modal_state import FARTHEST
from cnc_interp.program.motion import Mover
from cnc_interp.program.words import BlockWords


class AxisCodes:
    """
    The codes G10, G28, G28.1, G30, G30.1, G52 and G92 to G92.3.

    Parameters
    ----------
    mover : Mover
        Position and frames of the program.

    """

    def __init__(self, mover: Mover):
        self._mover, self.fault = mover, mover.fault
        points = mover.setup.reference_points
        self._references = {code: dict(points.get(code, {})) for code in ('G28', 'G30')}

    def execute(self, code: str, words: BlockWords) -> None:
        """Execute a code and remove its words from the block."""
        mover, values = self._mover, words.values
        frames = mover.frames
        if code == 'G10':
            self._write_offset(words)
        elif code in ('G28', 'G30'):
            self._reference(code, words)
        elif code in ('G28.1', 'G30.1'):
            machine = np.concatenate([mover.point + mover.zero, mover.rotary])
            letters = ('X', 'Y', 'Z', *mover.rotary_letters)
            self._references[code[:3]] = dict(zip(letters, machine.tolist(), strict=False))
        elif code == 'G52':
            # The frame moves; the tool does not.
            for i, value in self._offset_words(values).items():
                frames.local[i] = value
        elif code == 'G92':
            frames.g92_on = True
            frames.update()
            here = mover.here()
            for i, value in self._offset_words(values).items():
                turned = frames.turn[:, i] if i < 3 else None
                if turned is None:
                    frames.g92[i] += here[i] - value
                else:
                    frames.g92[:3] += turned * (here[i] - value)
        else:
            frames.g92_on = code == 'G92.3'
            if code == 'G92.1':
                frames.g92 = np.zeros(5)
        frames.update()

    def _offset_words(self, values: dict[str, float]) -> dict[int, float]:
        """Remove axis words and return them as offsets by axis number [m, rad]."""
        found = {}
        for i, letter in enumerate(('X', 'Y', 'Z', *self._mover.rotary_letters)):
            if letter in values:
                found[i] = values.pop(letter) * (self._mover.unit if i < 3 else DEG)
                if not abs(found[i]) <= FARTHEST:
                    raise self.fault('an offset beyond 100,000 mm; correct it', letter)
        return found

    def _write_offset(self, words: BlockWords) -> None:
        """Process G10 L2 and L20: set a work offset."""
        kind, index = words.values.pop('L', 0.0), words.values.pop('P', 0.0)
        if kind not in (2.0, 20.0) or index not in range(10) or 'R' in words.values:
            raise self.fault('only G10 L2 and L20 with P0 to P9 are supported', 'G10')
        mover = self._mover
        position = None
        if kind == 20.0:
            work = mover.frames
            base = np.concatenate([mover.point, mover.rotary])
            position = base - (work.local + (work.g92 if work.g92_on else 0.0))
            position[2] -= work.length
        mover.frames.set_work(int(index), self._offset_words(words.values), position)

    def _reference(self, code: str, words: BlockWords) -> None:
        """Process G28 and G30: rapid over the point of the block to the reference point."""
        mover = self._mover
        mover.refuse_machine_words()
        letters = ('X', 'Y', 'Z', *mover.rotary_letters)
        named = [letter for letter in letters if letter in words.values]
        if named:
            target = mover.target(words)
            rotary = (
                target[3:] + mover.frames.rotary_origin if mover.rotary_letters else mover.rotary
            )
            mover.go(mover.frames.point(target[:3]), rotary, rapid=True)
        point, rotary = mover.point.copy(), mover.rotary.copy()
        for letter in named or letters:
            home = self._references[code].get(letter, 0.0)
            if letter in 'XYZ':
                i = 'XYZ'.index(letter)
                point[i] = mover.frames.machine_point(i, home)
            else:
                rotary[mover.rotary_letters.index(letter)] = home
                mover.named = 1.0
        mover.go(point, rotary, rapid=True)
