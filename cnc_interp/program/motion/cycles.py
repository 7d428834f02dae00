"""Holes made by the cycles of all dialects, and the canned cycles of G-code and Siemens.

Z, R, Q and P of G73 to G89 stay valid for the next holes. The first arguments of Siemens cycles
are RTP, RFP, SDIS, DP (absolute) and DPR (below RFP). With MCALL a cycle runs after every motion
block.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import DEG, INCH, MINUTE, MM, FloatArray, ProgramError
from cnc_interp.machine_model import signals
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.geometry.target_row import AT_M0
from cnc_interp.program.modal.state import FARTHEST
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import FANUC, LINUXCNC, PLAIN
from cnc_interp.program.text.words import BlockWords

#: Kinds of strokes: a rapid, and those at the feed into the hole and out of it.
RAPID, INTO, OUT_OF = range(3)
_MOST_PECKS = 10_000
_NOTHING = 1e-9  #: Remaining depth that needs no further stroke [m].


@dataclass(frozen=True)
class Hole:
    """The strokes of a hole; levels are measured along the tool [m]."""

    retract: float  #: Level at which the feed begins.
    bottom: float
    clear: float  #: Level at which the tool has left the hole.
    pecks: Sequence[float] = ()  #: Levels above the bottom at which the tool turns back.
    #: Whether the tool retracts after each peck only by ``gap``; otherwise it leaves the hole, and
    #: returns to ``gap`` above the last peck.
    breaks: bool = False
    gap: float = 0.0
    feeds_back: bool = False  #: Whether it retracts from each peck at feed.
    rests: bool = False
    dwell: float = 0.0  #: Dwell at the bottom, on machines that support it [s].
    waits: bool = False  #: Whether an operator retracts the tool.
    out: float | None = None  #: Level up to which it retracts at feed; None for a rapid.
    shift: FloatArray | None = None  #: (3,): Shift of the tool at the bottom [m].
    #: Feeds into the hole and out of it [m/s]; None: programmed feed, and feed into the hole.
    feed: float | None = None
    feed_out: float | None = None
    reverse: str = ''  #: Spindle word for leaving a tapped hole: M4, or M3 for a left-hand thread.

    def strokes(self) -> Iterator[tuple[float, int, bool, float]]:
        """Yield for each stroke: level, kind, whether the tool is shifted, and stop at its end."""
        for peck in self.pecks:
            yield peck, INTO, False, 0.0
            if not self.breaks:
                yield self.retract, INTO if self.feeds_back else RAPID, False, 0.0
            if self.breaks or not self.feeds_back:
                yield min(peck + self.gap, self.retract), RAPID, False, 0.0
        rests = self.rests or self.out is not None
        yield self.bottom, INTO, False, AT_M0 if self.waits else float(rests)
        if self.out is not None:
            yield self.out, OUT_OF, False, 0.0
        elif self.shift is not None:
            yield self.bottom, RAPID, True, 0.0
            yield self.clear, RAPID, True, 0.0
        yield self.clear, RAPID, False, 0.0


def pecks_of(
    top: float,
    bottom: float,
    first: float,
    fault: Callable[[str], ProgramError],
    then: Callable[[float, float], float] | None = None,
) -> list[float]:
    """Return the levels of pecks [m]; ``then``: next stroke, from the last one and the rest."""
    depth, done, stroke, levels = top - bottom, first, first, list[float]()
    while depth - done > _NOTHING:
        levels.append(top - done)
        if len(levels) > _MOST_PECKS:
            raise fault(f'more than {_MOST_PECKS} pecks; enlarge the peck')
        stroke = stroke if then is None else then(stroke, depth - done)
        done = first * (len(levels) + 1) if then is None else done + stroke
    return levels


def go_along(
    mover: Mover, place: FloatArray, axis: int, along: float, feed_given: bool, rapid: bool = True
) -> None:
    target = place.copy()
    target[axis] = along
    mover.go_to(target, feed_given, rapid)


def make_hole(
    mover: Mover, hole: Hole, place: FloatArray, axis: int, feed_given: bool = True
) -> None:
    kept = mover.feedrate
    feed = hole.feed or kept
    if hole.reverse and mover.follows:
        mover.feedrate = feed
        pitch = mover.feed(feed_given)[0] * MINUTE / (mover.spindle_speed or np.inf)
        for level in (*hole.pecks, hole.bottom):
            target = place[:3].copy()
            target[axis] = level
            mover.targets.stop_here()
            mover.in_step('tapping', mover.frames.point(target), pitch, True)
        mover.feedrate = kept
        go_along(mover, place, axis, hole.clear, feed_given)
        return
    known = mover.geometry.machine.signals.words.keys()
    turns = hole.reverse if {'M3', 'M4'} <= known else ''
    beside = place.copy()
    beside[:3] += np.zeros(3) if hole.shift is None else hole.shift
    for level, kind, aside, stop in hole.strokes():
        mover.feedrate = hole.feed_out or feed if kind == OUT_OF else feed
        go_along(mover, beside if aside else place, axis, level, feed_given, kind == RAPID)
        if stop:
            mover.targets.stop_here(stop)
        if stop and hole.dwell:
            mover.act('G4', {signals.DWELL: hole.dwell})
        if turns and kind != RAPID:
            mover.targets.stop_here()
            mover.act(turns if level < hole.retract else _OTHER[turns], {})
    mover.feedrate = kept


def dwell_of(mover: Mover, code: str, time: float, text: str = '.') -> float:
    """Return the time of a dwell [s]; 0 if the unit of a P without a decimal point is unknown."""
    fanuc, sure = mover.dialect is FANUC, '.' in text or mover.dialect in (FANUC, LINUXCNC)
    kept = 'G4' in mover.geometry.machine.signals.words
    if time and not (kept and sure):
        mover.notice(code, codes.ANY_DWELL if kept else codes.DWELL)
    return time * (1e-3 if fanuc and '.' not in text else 1.0) if sure else 0.0


#: Clearance above the last peck, and retract distance of G73, by unit [m].
_CLEARANCE = {MM: 0.254 * MM, INCH: 0.01 * INCH}
_MOST_REPEATS = 10_000
_PECKING = {'G73', 'G83'}
_REVERSES = {'G74': 'M3', 'G84': 'M4', 'G84.2': 'M4', 'G84.3': 'M3'}
TAPPING = set(_REVERSES)
_OTHER = {'M3': 'M4', 'M4': 'M3'}
_FEED_OUT = {*TAPPING, 'G85', 'G89'}
_RESTING = {'G76', 'G82', 'G86', 'G87', 'G89'}
_SHIFTING = {'G76', 'G87'}


class CannedCycle:
    def __init__(self, code: str, start: float):
        self.code, self.start = code, start
        self._sticky: dict[str, float] = {}
        self._texts: dict[str, str] = {}

    def drill(self, mover: Mover, words: BlockWords, feed_given: bool) -> None:
        axis = PLANES[mover.plane][2]
        drilling = 'XYZ'[axis]
        values = words.values
        self._refuse(mover, words)
        kept = (drilling, 'R', 'Q', 'P', *('IJK' if self.code in _SHIFTING else ''))
        for i, value in words.take(kept).items():
            self._sticky[kept[i]] = value
            self._texts[kept[i]] = words.texts.get(kept[i], '')
        repeats = values.pop('L', None)
        repeats = values.pop('K', 1.0) if repeats is None else repeats
        mover.demand(
            0.0 <= repeats <= _MOST_REPEATS,
            f'a cycle is repeated 0 to {_MOST_REPEATS} times',
            f'L{repeats:g}',
        )
        for letter, meaning in ((drilling, 'depth'), ('R', 'retract plane')):
            mover.demand(
                letter in self._sticky, f'the cycle needs its {meaning} {letter}', self.code
            )
        for _ in range(round(repeats)):
            hole = mover.target(
                BlockWords(values=dict(values), ways=words.ways, texts=words.texts)
            )
            self._hole(mover, hole, axis, feed_given)
        words.take(('X', 'Y', 'Z', *mover.rotary_letters))

    def _refuse(self, mover: Mover, words: BlockWords) -> None:
        mover.refuse_if(
            mover.by_axes and mover.rotary.any() and mover.frames.rotated,
            'a cycle in a rotated frame needs tool-tip programming',
            self.code,
        )
        turns = not words.values.keys().isdisjoint(mover.rotary_letters)
        mover.refuse_if(
            turns and not mover.dialect.turns_in_cycles,
            'LinuxCNC takes no rotary words in a canned cycle; turn in a block '
            'before, or choose --dialect fanuc',
            self.code,
        )
        mover.refuse_if(
            self.code in ('G87', 'G88') and mover.dialect is LINUXCNC,
            'LinuxCNC has none; post it as G0 and G1 moves',
            self.code,
        )
        mover.refuse_if(
            self.code in TAPPING and mover.dialect is LINUXCNC and mover.plane != 'G17',
            'LinuxCNC taps along the wrong axis here; tap in G17, or choose --dialect fanuc',
            self.code,
        )

    def _hole(self, mover: Mover, place: FloatArray, axis: int, feed_given: bool) -> None:
        depth, retract = (self._sticky['XYZ'[axis]], self._sticky['R'])
        here = mover.here()
        level = float(here[axis])
        if mover.incremental:
            retract = self.start + retract * mover.unit
            bottom = retract + depth * mover.unit
        else:
            retract, bottom = retract * mover.unit, depth * mover.unit
        if retract < bottom and self.code != 'G87':
            mover.demand(
                mover.dialect in (FANUC, PLAIN),
                'the retract plane R lies below the depth',
                self.code,
            )
            mover.notice(
                f'WARNING: {self.code} with R below Z', 'the feed goes from R up to Z, as on Fanuc'
            )
        clear = max(self.start, retract) if mover.retract_to_start else retract
        if self.code == 'G87':
            clear = max(self.start, retract)
        whole = mover.dialect is LINUXCNC and self.code != 'G85'
        out = (clear if whole else retract) if self.code in _FEED_OUT else None
        hole = Hole(
            retract,
            bottom,
            clear,
            self._pecks(mover, retract, bottom),
            self.code == 'G73',
            _CLEARANCE[mover.unit],
            self.code in TAPPING,
            self.code in _RESTING,
            self._dwell(mover),
            self.code == 'G88',
            out,
            self._shift(mover),
            reverse=_REVERSES.get(self.code, ''),
        )
        if self.code == 'G88':
            mover.notice('G88', 'waits at the bottom; the retract after cycle start is a rapid')
        start = place
        if self.code == 'G87':
            if hole.shift is None:
                mover.notice(
                    'WARNING: G87 without a shift', 'the tool moves to R and back inside the bore'
                )
            else:
                start = place.copy()
                start[:3] += hole.shift
        levels = [level, retract]
        if level < retract:
            levels = [retract]
            go_along(mover, here, axis, retract, feed_given)
        for along in levels:
            go_along(mover, start, axis, along, feed_given)
        if start is not place:
            go_along(mover, place, axis, retract, feed_given)
        make_hole(mover, hole, place, axis, feed_given)

    def _dwell(self, mover: Mover) -> float:
        time = self._sticky.get('P', 0.0) if self.code in _RESTING else 0.0
        return dwell_of(mover, self.code, time, self._texts.get('P', ''))

    def _shift(self, mover: Mover) -> FloatArray | None:
        """Return the shift of the tool in G76 and G87, shape (3,) [m], or None."""
        if self.code not in _SHIFTING:
            return None
        if not {'I', 'J', 'K'} & self._sticky.keys():
            amount, first = self._sticky.get('Q', 0.0), PLANES[mover.plane][0]
            if not amount:
                return None
            mover.notice(
                f'WARNING: {self.code} Q',
                f'the tool is shifted along +{"XYZ"[first]}; '
                'a parameter of the control may give another direction',
            )
            return np.asarray(np.eye(3)[first] * abs(amount) * mover.unit)
        return np.array([self._sticky.get(letter, 0.0) * mover.unit for letter in 'IJK'])

    def _pecks(self, mover: Mover, retract: float, bottom: float) -> list[float]:
        if self.code not in _PECKING and not ('Q' in self._sticky and self.code in TAPPING):
            return []
        step = self._sticky.get('Q', 0.0) * mover.unit
        if step == 0.0 and mover.dialect in (FANUC, PLAIN):
            mover.notice(
                f'WARNING: {self.code} without a peck Q',
                'drilled in one stroke; Fanuc and LinuxCNC refuse it',
            )
            return []
        mover.demand(
            0.0 < step < FARTHEST, 'the cycle needs its peck Q, greater than zero', self.code
        )
        return pecks_of(retract, bottom, step, lambda text: mover.fault(text, self.code))


SIEMENS = {f'CYCLE{number}' for number in (81, 82, 83, 84, 840, 85, 86, 87, 88, 89)}
PATTERNS = {'HOLES1', 'HOLES2'}
SIEMENS_WORDS = {'MCALL', 'CYCLE80', *SIEMENS, *PATTERNS}
_SIEMENS_TAPPING = {'CYCLE84', 'CYCLE840'}
_SIEMENS_FEED_OUT = {*_SIEMENS_TAPPING, 'CYCLE85', 'CYCLE89'}
#: Retract to break the chip, and gap to the last peck on return [m].
_BREAK, _NEAR, _NEAR_SHARE, _NEAR_MOST = 1.0 * MM, 0.6 * MM, 0.02, 7.0 * MM
_MOST_HOLES = 10_000

Given = Sequence[float | None]


class SiemensCycle:
    def __init__(self, name: str, given: Given, mover: Mover):
        self.name, self._given, self._mover = name, given, mover
        mover.refuse_if(
            None in (self._at(0), self._at(1)) or (self._at(3), self._at(4)) == (None, None),
            'give the planes RTP and RFP and the depth DP or DPR',
            name,
        )

    def _at(self, index: int) -> float | None:
        return self._given[index] if index < len(self._given) else None

    def _value(self, index: int) -> float:
        return self._at(index) or 0.0

    def make(self) -> None:
        mover, unit = self._mover, self._mover.unit
        axis = PLANES[mover.plane][2]
        reference, depth = self._value(1) * unit, self._at(3)
        bottom = reference - self._value(4) * unit if depth is None else depth * unit
        mover.demand(reference >= bottom, 'the reference plane lies below the depth', self.name)
        retract, clear = reference + self._value(2) * unit, self._value(0) * unit
        mover.demand(
            clear >= retract, 'the retract plane RTP lies below the safety distance', self.name
        )
        pecks = self._pecks(reference, bottom) if self.name == 'CYCLE83' else []
        shift = None
        if self.name == 'CYCLE86' and any(self._value(i) for i in (7, 8)):
            shift = np.zeros(3)
            for index, place in zip((7, 8), PLANES[mover.plane][:2], strict=True):
                shift[place] = self._value(index) * unit
        if self.name in _SIEMENS_TAPPING:
            mover.tell_tapping(self.name)
        time = 0.0 if self.name == 'CYCLE81' else self._value(8 if self.name == 'CYCLE83' else 5)
        if time < 0.0:  # turns of the spindle
            time *= -MINUTE / max(mover.spindle_speed, 1.0)
        rests = self.name in ('CYCLE82', 'CYCLE86', 'CYCLE88', 'CYCLE89') or time > 0.0
        waits = self.name in ('CYCLE87', 'CYCLE88')
        breaks = self.name == 'CYCLE83' and not self._value(11)
        distance = self._value(14) * unit or _BREAK
        near = self._value(16) * unit or min(
            max(_NEAR, _NEAR_SHARE * (reference - bottom)), _NEAR_MOST
        )
        here = mover.here()
        for along in (clear, retract) if here[axis] < retract else (retract,):
            go_along(mover, here, axis, along, feed_given=True)
        hole = Hole(
            retract,
            bottom,
            clear,
            pecks,
            breaks,
            distance if breaks else near,
            rests=rests,
            dwell=dwell_of(mover, self.name, time),
            waits=waits,
            shift=shift,
            out=retract if self.name in _SIEMENS_FEED_OUT else None,
            feed=self._feed(),
            feed_out=self._feed_out(),
            reverse=self._reverse,
        )
        make_hole(mover, hole, here, axis)

    def _feed(self) -> float | None:
        """Return the feed into the hole [m/s]: FFR, or pitch times speed; None: modal feed."""
        unit, speed = self._mover.unit, self._mover.spindle_speed
        if self.name == 'CYCLE85':
            return self._value(6) * unit / MINUTE
        if self.name == 'CYCLE84':
            return abs(self._value(8)) * MM * (self._value(10) or speed) / MINUTE
        return abs(self._value(10)) * MM * speed / MINUTE if self.name == 'CYCLE840' else None

    @property
    def _reverse(self) -> str:
        if self.name not in _SIEMENS_TAPPING:
            return ''
        return 'M3' if self._value(8 if self.name == 'CYCLE84' else 10) < 0.0 else 'M4'

    def _feed_out(self) -> float | None:
        if self.name == 'CYCLE85' and self._value(7):
            return self._value(7) * self._mover.unit / MINUTE
        if self.name == 'CYCLE84' and self._value(8) and self._value(11):
            return abs(self._value(8)) * MM * self._value(11) / MINUTE
        return None

    def _pecks(self, reference: float, bottom: float) -> list[float]:
        unit, depth = self._mover.unit, reference - bottom
        first = self._at(5)
        stroke = self._value(6) * unit if first is None else reference - first * unit
        if not 0.0 < stroke < depth:
            return []
        less, least = self._value(7), max(self._value(13) * unit, 0.0)

        def then(stroke: float, left: float) -> float:
            if less > 0.0:
                stroke = max(stroke - less * unit, less * unit)
            elif less < 0.0:
                stroke = max(stroke * -less, least, 1e-6)
            stroke = max(stroke, least)
            if less > 0.0 and stroke < left < 2.0 * stroke:
                return 0.5 * left  # the last two strokes are equal
            return min(stroke, left)

        return pecks_of(
            reference, bottom, stroke, lambda text: self._mover.fault(text, self.name), then
        )


def places_of(name: str, given: Given, mover: Mover) -> list[tuple[float, float]]:
    """Return the hole positions of HOLES1 (a row) and HOLES2 (a circle) in the plane [m]."""
    unit = mover.unit
    values = [value or 0.0 for value in given] + [0.0] * 6
    a, b, count = values[0] * unit, values[1] * unit, int(values[5])
    mover.demand(0 < count <= _MOST_HOLES, 'the number of holes is missing', name)
    if name == 'HOLES1':
        along = np.exp(1j * values[2] * DEG)
        steps = (values[3] + values[4] * np.arange(count)) * unit
        found = a + 1j * b + steps * along
    else:
        turn = values[4] or 360.0 / count
        angles = (values[3] + turn * np.arange(count)) * DEG
        found = a + 1j * b + values[2] * unit * np.exp(1j * angles)
    return [(float(place.real), float(place.imag)) for place in found]
