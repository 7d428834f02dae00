"""Probing by G38.2 to G38.5, G31 (Fanuc) and MEAS (Siemens): move until the probe answers.

In a live run the program is read up to the probe, executed, and then read further
(``ProgramStream.go_on``): #5061 to #5066 are the contact, and #5070 is 1. Otherwise the probe is
assumed to answer at the end of its move.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import NamedTuple

import numpy as np

from cnc_interp.core import DEG, FloatArray, InterpError
from cnc_interp.core.small_files import config_directory
from cnc_interp.machine_model.signals import AWAY, TOWARD, Signals
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.text.control_traits import FANUC, PLAIN
from cnc_interp.program.text.words import BlockWords


class ProbeCode(NamedTuple):
    word: str  #: Function of the machine that arms the probe.
    must_answer: bool  #: Whether a missing answer of the probe is a fault.


CODES = {
    'G38.2': ProbeCode(TOWARD, True),
    'G38.3': ProbeCode(TOWARD, False),
    'G38.4': ProbeCode(AWAY, True),
    'G38.5': ProbeCode(AWAY, False),
    'G31': ProbeCode(TOWARD, False),
    'MEAS=1': ProbeCode(TOWARD, False),
    'MEAS=-1': ProbeCode(AWAY, False),
}
ANSWERED, PLACE = 5070, 5061  #: First variables of the answer, and of the contact.
SHORTEST = 1e-6  #: A shorter way counts as zero [m].
NO_PROBE = 'the machine file has no probe; give its signals the input, output and words of a probe'
AT_ONCE = 'the probe was in contact before it moved; free it'
ASSUMED = 'a plan assumes that the probe makes contact at the end of the line'


@dataclass(frozen=True)
class Probe:
    code: str
    line: int  #: Line of the main program.

    def fault(self, answered: bool, at_once: bool) -> str:
        """Return why the program cannot continue after the line; empty if it can."""
        if at_once:
            return f'line {self.line}: {self.code}: {AT_ONCE}'
        if answered or not CODES[self.code].must_answer:
            return ''
        return (
            f'line {self.line}: {self.code}: the probe made no contact up to the end of the line'
        )


def measuring(words: BlockWords) -> list[str]:
    """Remove MEAS=1 from the assignments of a block, and return it as a code."""
    found = [(name, value) for name, value in words.sets if name == 'MEAS' and value]
    words.sets[:] = [each for each in words.sets if each not in found]
    return [f'{name}={value:g}' for name, value in found]


def target_of(code: str, words: BlockWords, mover: Mover, signals: Signals) -> FloatArray:
    """Process the words of a probing block; return its end point, (3,) [m]."""
    mover.refuse_if(
        code == 'G31' and mover.dialect not in (FANUC, PLAIN), 'skips on Fanuc; write G38.3', code
    )
    mover.refuse_if(
        code.startswith('MEAS') and mover.motion != 1,
        'measures along a line; write G1 with it',
        code,
    )
    mover.demand(CODES[code].word in signals.words, NO_PROBE, code)
    mover.demand(not mover.targets.empty, 'move to a position before the part first', code)
    here, target = mover.here(), mover.target(words)
    mover.refuse_if(
        np.abs(target[3:] - here[3:]).max(initial=0.0) > 1e-9 * DEG,
        'probes along X Y Z; turn the rotary axes first',
        code,
    )
    point: FloatArray = mover.frames.point(target[:3])
    mover.demand(
        np.linalg.norm(point - mover.point) > SHORTEST, 'has no motion; give X, Y or Z', code
    )
    return point


def answer(mover: Mover, answered: bool) -> dict[int, float]:
    place = mover.in_words(mover.here())
    found = {PLACE + 'XYZABC'.index(letter): value for letter, value in place.items()}
    return {ANSWERED: float(answered), **found}


NAMES = ('surface', 'edge', 'bore', 'boss', 'angle', 'tool')
_TEXT = re.compile(r'\((.*)\)')
_PARAMETER = re.compile(r'\(#\d+ (\w+) = (\S+): (.*) \[(.*)\]\)')


@dataclass(frozen=True)
class Parameter:
    name: str
    default: float
    text: str
    unit: str


@dataclass(frozen=True)
class Cycle:
    name: str
    text: str  #: Description: what it measures, and what it sets.
    parameters: tuple[Parameter, ...]

    def line(self, values: Mapping[str, float]) -> str:
        """Return the MDI line that calls the cycle; raise InterpError for an unknown value."""
        known = {parameter.name: parameter.default for parameter in self.parameters}
        for name, value in values.items():
            if name not in known or not isfinite(value):
                text = f'{self.name}: {name} {value:g} is not possible'
                raise InterpError(f'{text}; give numbers for {", ".join(known)}')
        given = {**known, **values}
        return f'O<probe_{self.name}> CALL ' + ' '.join(f'[{v:.6g}]' for v in given.values())


@cache
def cycles() -> dict[str, Cycle]:
    found = {}
    for name in NAMES:
        file = config_directory() / 'subprograms' / f'probe_{name}.ngc'
        first, *lines = file.read_text(encoding='utf-8').splitlines()
        parameters = tuple(
            Parameter(match[1], float(match[2]), match[3], match[4])
            for match in map(_PARAMETER.fullmatch, lines)
            if match
        )
        text = _TEXT.fullmatch(first)
        assert text is not None
        found[name] = Cycle(name, text[1], parameters)
    return found
