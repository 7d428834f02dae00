"""Heidenhain plain text (Klartext) as plain G-code for the second reader; without loops."""

import re
from collections.abc import Callable

import numpy as np

from cnc_interp.core import FloatArray, ProgramError

_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)'
_HEAD = re.compile(r'(BEGIN PGM|END PGM|BLK FORM|TOOL DEF|\*|LN?|CC|CR|C)(?![A-Z])\s*(.*)')
_WORD = re.compile(
    rf'(?:R0?(?![-+.\d])|(I?)([XYZABC])\s*({_NUMBER})|(F\s*MAX)|([FR])\s*({_NUMBER})|'
    r'DR\s*([-+])|(M\d+))(?![\w.])'
)
_CYCLE = re.compile(r'CYCL\s+DEF\s*(\d+)\.(\d+)\s*(.*)')
_OF_CYCLE = re.compile(rf'(SCL|I?(?:CC)?[XYZ])\s*({_NUMBER})?\s*')
_TOOL = re.compile(rf'TOOL CALL (\d+) Z((?:\s*[SF]\s*{_NUMBER})*)')
#: M codes with the same meaning as in G-code.
_SAME_M = {'M0', 'M1', 'M2', 'M3', 'M4', 'M5', 'M7', 'M8', 'M9', 'M30', 'M128', 'M129'}


class Klartext:
    def __init__(self, refuse: Callable[[str], ProgramError], measures: bool):
        self.refuse, self.measures = refuse, measures
        self.centre = np.zeros(2)
        self.shift, self.scale, self.about = np.zeros(3), np.ones(3), np.zeros(3)

    def lines(self, text: str, here: dict[str, float]) -> list[str]:
        """Return a line as lines of G-code; ``here``: current coordinates in program units."""
        text = re.sub(r'^\s*\d+(?!\S)|;.*', '', text).strip()
        if not text:
            return []
        if cycle := _CYCLE.fullmatch(text):
            return self._cycle(int(cycle[1]), int(cycle[2]), cycle[3])
        if tool := _TOOL.fullmatch(text):
            length = f' G43 H{tool[1]}' if self.measures else ''
            return [f'T{tool[1]} M6{length} {tool[2]}']
        head = _HEAD.fullmatch(text)
        if text == 'STOP' or head is None:
            head = re.match(r'()(.*)', {'STOP': 'M0'}.get(text, text))
        assert head is not None
        kind, rest = head[1], head[2]
        if kind == 'BEGIN PGM':
            return ['G20' if rest.endswith('INCH') else 'G21']
        if kind in ('END PGM', 'BLK FORM', 'TOOL DEF', '*'):
            return ['M30'] if kind == 'END PGM' else []
        return self._motion(kind, rest, here)

    def _motion(self, kind: str, text: str, here: dict[str, float]) -> list[str]:
        ends: dict[str, float] = {}
        words, codes, turn, rapid = [], [], '', False
        while text:
            word = _WORD.match(text)
            if word is None or (word[8] and word[8] not in _SAME_M):
                raise self.refuse(text.split()[0])
            text = text[word.end() :].lstrip()
            if word[2]:
                ends[word[2]] = float(word[3]) + (here[word[2]] if word[1] else 0.0)
            elif word[5]:
                words.append(f'{word[5]}{float(word[6]):.12f}')
            codes += [word[8]] if word[8] else []
            turn, rapid = word[7] or turn, rapid or bool(word[4])
        if kind == 'CC':
            self.centre = np.array([ends.get(k, here[k]) for k in 'XY'])
            return []
        code = {'C': f'G{2 + (turn == "+")}', 'CR': f'G{2 + (turn == "+")}'}.get(kind)
        if kind == 'LN' or (code and not turn):
            raise self.refuse(kind)
        if kind == 'C':
            words += [f'{i}{c - here[k]:.12f}' for i, k, c in zip('IJ', 'XY', self.centre)]
        places = [f'{letter}{value:.12f}' for letter, value in ends.items()]
        move = [code or ('G0' if rapid else 'G1')] if places else []
        return [' '.join([*move, *places, *words, *codes])]

    def _cycle(self, number: int, part: int, text: str) -> list[str]:
        given = {name: float(value or 0.0) for name, value in _OF_CYCLE.findall(text)}
        if number == 9:
            return [f'G4 X{text.split()[-1]}'] if part else []
        if number not in (7, 8, 11, 26) or (part and _OF_CYCLE.sub('', text).strip()):
            raise self.refuse(f'CYCL DEF {number}')
        if not part:
            return []
        for i, letter in enumerate('XYZ'):
            if number == 7:
                self.shift[i] = given.get(letter, self.shift[i] + given.get(f'I{letter}', 0.0))
            elif number == 11:
                self.scale[i], self.about[i] = given['SCL'], 0.0
            elif number == 26:
                self.scale[i] = given.get(letter, self.scale[i])
                self.about[i] = given.get(f'CC{letter}', self.about[i])
        if number == 7:
            return [f'G52 {_row("XYZ", self.shift)}']
        if number == 8:
            return ['G50.1', *([f'G51.1 {_row(given, np.zeros(len(given)))}'] if given else [])]
        return [f'G51 {_row("XYZ", self.about)} {_row("IJK", self.scale)}']


def _row(letters: str | dict[str, float], values: FloatArray) -> str:
    return ' '.join(f'{letter}{value:.12f}' for letter, value in zip(letters, values, strict=True))
