"""Words that mirror and scale: G51, G51.1, G50, G50.1 of Fanuc; MIRROR and SCALE of Siemens.

If one axis of the plane is mirrored, the sense of arcs and the side of G41 are reversed. Tool
lengths and radii are not scaled.
"""

import numpy as np

from cnc_interp.program.execution.context import Execution
from cnc_interp.program.text.words import BlockWords

KEYS = ('MIRROR', 'AMIRROR', 'SCALE', 'ASCALE')
#: From this value, a scale without a decimal point is in thousandths; below, controls differ.
_THOUSANDTHS = 100.0


def scale_or_mirror(at: Execution, code: str, words: BlockWords) -> None:
    mover, frames = at.mover, at.mover.frames
    given = {i: value * mover.unit for i, value in words.take('XYZ').items()}
    if code == 'G50' and given:
        raise at.fault(
            'with axis words it presets coordinates on lathes; write G50 alone, or G92',
            f'G50 {words.texts["XYZ"[min(given)]]}',
        )
    if code in ('G50', 'G50.1') and not frames.scales:
        at.notice(code, 'nothing to switch off')
        return
    _demand_rest(at, code)
    if code == 'G51.1':
        at.demand(
            given, 'give the axis and the position at which it is mirrored, such as X0', code
        )
        frames.mirrors |= given
    elif code == 'G50.1':
        for i in given or list(frames.mirrors):
            frames.mirrors.pop(i, None)
    elif code == 'G50':
        frames.scale, frames.scale_centre = np.ones(3), np.zeros(3)
    else:
        here = mover.here()[:3]
        factors = {
            letter: _factor(at, letter, words) for letter in 'PIJK' if letter in words.values
        }
        at.demand(factors, 'give the scale as P, or as I J K by axis', code)
        every = factors.get('P', 1.0)
        frames.scale = np.array([factors.get(letter, every) for letter in 'IJK'])
        frames.scale_centre = np.array([given.get(i, here[i]) for i in range(3)])
    frames.update()


def _factor(at: Execution, letter: str, words: BlockWords) -> float:
    value, text = words.values.pop(letter), words.texts[letter]
    if '.' not in text:
        if abs(value) < _THOUSANDTHS:
            raise at.fault(
                f'is {value:g} on some controls, {value / 1000:g} on others; write {text}.', text
            )
        value /= 1000.0
    return at.mover.scale_of(value, text)


def _demand_rest(at: Execution, code: str) -> None:
    """Reject states in which controls differ in how they mirror and scale."""
    mover = at.mover
    at.refuse_if(
        mover.tcp or mover.oriented or at.plane.parts,
        'not possible with tool-tip programming or a tilted plane; post the path itself',
        code,
    )
    at.demand(at.cycle is None, 'a canned cycle is on; write G80 first', code)
    at.splines.end()
    mover.end_corner()


def scale_or_mirror_frame(at: Execution, key: str, words: BlockWords) -> None:
    """Mirror or scale about the zero of the frame; MIRROR and SCALE first reset the frame."""
    mover, frames = at.mover, at.mover.frames
    given = words.take('XYZ')
    _demand_rest(at, key)
    if not key.startswith('A'):
        frames.reset_frame()
        frames.reset_scale()
    for i, value in given.items():
        if key.endswith('SCALE'):
            frames.scale = frames.scale.copy()
            frames.scale[i] *= mover.scale_of(value, f'{"XYZ"[i]}{value:g}')
        elif i in frames.mirrors:
            del frames.mirrors[i]
        else:
            frames.mirrors[i] = 0.0
    frames.update()
    mover.notice(key, 'it acts about the zero of the frame; tool lengths and radii do not change')
