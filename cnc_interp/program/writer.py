"""Write poses and curves as part programs: G-code, native Siemens B-splines, or CL data."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isfinite, isnan, nan

from cnc_interp.core import DEG, MM, MM_PER_MIN, FloatArray
from cnc_interp.program.blocks import GO_ON, OPTIONAL_STOP, STOP

#: Decimals of coordinates [mm], angles [deg] and tool axes [-]; finer than double precision needs.
_LENGTH, _ANGLE, _AXIS = 9, 10, 12
RAPID_FEED = 100_000.0  #: Feedrate of rapids in a spline, which needs an F [mm/min].
#: Words for a stop in G-code and in CL data.
_STOPS = {GO_ON: ('G9', 'DELAY/0'), STOP: ('M0', 'STOP'), OPTIONAL_STOP: ('M1', 'OPSTOP')}


def fixed(value: float, decimals: int) -> str:
    """Return a number as text, without trailing zeros and never as -0."""
    text = f'{value:.{decimals}f}'.rstrip('0').rstrip('.') if decimals else f'{value:.0f}'
    return '0' if text in ('-0', '') else text


def feed_word(feedrate: float) -> str:
    return f'{min(feedrate / MM_PER_MIN, RAPID_FEED):.9g}'


@dataclass
class Modal:
    kept: dict[str, str] = field(default_factory=dict)

    def words(self, pairs: Iterable[tuple[str, str]]) -> str:
        changed = [(letter, text) for letter, text in pairs if self.kept.get(letter) != text]
        self.kept.update(changed)
        return ' '.join(letter + text for letter, text in changed)


@dataclass(frozen=True)
class WrittenMove:
    tip: FloatArray  #: (3,): Tool tip or control point [m].
    feedrate: float  #: Speed of the tip [m/s].
    #: Whether the block is a rapid, and whether the tool rests at its end.
    rapid: bool
    exact_stop: bool
    program_stop: int = GO_ON  #: GO_ON, STOP or OPTIONAL_STOP.
    #: (2,): Positions of the rotary axes [rad]; None if they are not written.
    rotary: FloatArray | None = None
    duration: float = nan  #: [s], if it is used instead of the feedrate.
    on_great_circle: bool = False  #: Whether the tool axis turns on the great circle.
    tolerance: float = 0.0  #: Path tolerance [m].
    axis: FloatArray | None = None  #: (3,): Unit tool axis [-].
    second: FloatArray | None = None  #: (3,): Second point on the tool axis [m].
    knot_interval: float = nan  #: Knot interval of a control point [m]; NaN on lines.


def gcode(moves: Iterable[WrittenMove], rotary_letters: tuple[str, ...], notes: list[str]) -> str:
    state = Modal()
    lines = [*(f'; {note}' for note in notes), 'G21 G90 G94']
    if rotary_letters:
        lines.append('TRAORI')
    motion, timed, orientation, tolerance = '', False, '', ''
    for move in moves:
        if (
            rotary_letters
            and (way := 'ORIVECT' if move.on_great_circle else 'ORIAXES') != orientation
        ):
            orientation = way
            lines.append(way)
        if (text := fixed(move.tolerance / MM, _LENGTH)) != tolerance:
            tolerance = text
            lines.append(f'G64 P{text}')
        words = [_STOPS[move.program_stop][0]] if move.exact_stop else []
        if not move.rapid and isfinite(move.duration) != timed:
            timed = not timed
            words.append('G93' if timed else 'G94')
            state.kept.pop('F', None)
        if (code := 'G0' if move.rapid else 'G1') != motion:
            motion = code
            words.append(code)
        pairs = [(k, fixed(v / MM, _LENGTH)) for k, v in zip('XYZ', move.tip, strict=True)]
        if move.rotary is not None:
            angles = zip(rotary_letters, move.rotary, strict=True)
            pairs += [(letter, fixed(v / DEG, _ANGLE)) for letter, v in angles]
        moved = state.words(pairs)
        # A block without motion is written only if it has other words.
        words.append(moved or (f'X{state.kept["X"]}' if words else ''))
        if not move.rapid and timed:
            words.append(f'F{60.0 / move.duration:.12g}')
        elif not move.rapid:
            words.append(state.words([('F', feed_word(move.feedrate))]))
        lines.append(' '.join(filter(None, words)))
    return '\n'.join([*filter(None, lines), 'M30', ''])


def siemens(moves: Iterable[WrittenMove], notes: list[str]) -> str:
    state = Modal()
    moves = list(moves)
    lines = [f'; {note}' for note in notes]
    if any(move.second is not None for move in moves):
        lines += ['TRAORI', 'ORICURVE']
    lines.append('G90 G94')
    motion = ''
    for move in moves:
        words = []
        on_spline = not isnan(move.knot_interval)
        code = 'BSPLINE' if on_spline else 'G0' if move.rapid else 'G1'
        if code != motion:
            motion = code
            words.append(code + (' SD=3' if on_spline else ''))
        if move.exact_stop:
            words.append('G9')
        words += [f'{k}{fixed(v / MM, _LENGTH)}' for k, v in zip('XYZ', move.tip, strict=True)]
        if move.second is not None:
            second = zip(('XH', 'YH', 'ZH'), move.second, strict=True)
            words += [f'{k}={fixed(v / MM, _LENGTH)}' for k, v in second]
        if on_spline:
            words.append(f'PL={move.knot_interval / MM:.15g}')
        if on_spline or not move.rapid:
            words.append(state.words([('F', feed_word(move.feedrate))]))
        lines.append(' '.join(filter(None, words)))
    return '\n'.join([*lines, 'M30', ''])


def cl_data(moves: Iterable[WrittenMove], name: str, notes: list[str]) -> str:
    lines = [f'PARTNO {name}', *(f'$$ {note}' for note in notes), 'UNITS/MM', 'MULTAX/ON']
    feed = ''
    for number, move in enumerate(moves):
        if move.rapid:
            lines.append('RAPID')
        elif number and (text := feed_word(move.feedrate)) != feed:
            feed = text
            lines.append(f'FEDRAT/{text},MMPM')
        words = [fixed(v / MM, _LENGTH) for v in move.tip]
        assert move.axis is not None
        words += [fixed(v, _AXIS) for v in move.axis]
        lines.append(('GOTO/' if number else 'FROM/') + ','.join(words))
        if move.exact_stop:
            lines.append(_STOPS[move.program_stop][1])
    return '\n'.join([*lines, 'FINI', ''])
