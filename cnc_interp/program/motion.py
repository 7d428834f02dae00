"""
The modal state that moves: position, feed, frames; targets from axis words, one block at a time.

``runs.py`` does the same for many plain lines at once.
"""

from __future__ import annotations

from math import inf, nan, pi

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import DEG, MINUTE, MM
from cnc_interp.program import codes
from cnc_interp.program.arcs import FAULTS, PLANES, arcs_of
from cnc_interp.program.columns import NO_ARC, TargetColumns
from cnc_interp.program.flow import Flow
from cnc_interp.program.frames import Frames
from cnc_interp.program.job import JobSetup
from cnc_interp.program.notices import Notices
from cnc_interp.program.rotary_geometry import RotaryGeometry
from cnc_interp.program.words import BlockWords
from cnc_interp.settings.choices import Settings

FARTHEST = 1e5 * MM
MOST_TURN = 1e3 * 360.0 * DEG
#: A rotary axis that turns further in one cutting block is told of [rad].
LONG_WAY = 180.0 * DEG + 1e-9
LENGTH_WITH_TCP = (
    'with tool-tip programming the length of the tool belongs into the machine file '
    '(tip_to_secondary_pivot_mm); give it length 0 in the setup'
)
_NO_F = 'no feedrate (F) before the first G1; write F or give --feed MM_PER_MIN'
_NO_NEW_F = 'no feedrate (F) since the way it is given has changed (G93, G94, G95); write F'


class Mover:
    """
    Position and modal settings of a program.

    Parameters
    ----------
    geometry : RotaryGeometry
        The machine.
    settings : Settings
        The user's choices.
    setup : JobSetup
        Work offsets, tool lengths and reference points.
    flow : Flow
        Where the reader is, for line numbers and errors.
    notices : Notices
        Collects what is harmless.

    """

    def __init__(
        self,
        geometry: RotaryGeometry,
        settings: Settings,
        setup: JobSetup,
        flow: Flow,
        notices: Notices,
    ):
        self.geometry, self.settings, self.setup = geometry, settings, setup
        self.flow, self.notices = flow, notices
        self.targets = TargetColumns(geometry, settings, flow.main.name)
        self.rotary_letters = tuple(geometry.axis_names[3:5])
        # Modal settings; the names are those of codes.SETTINGS.
        self.motion: int | None = None
        self.plane, self.unit, self.incremental, self.centre_absolute = 'G17', MM, False, False
        self.feed_mode, self.retract_to_start = 'G94', True
        self.stop_always = self.stop_once = False
        self.great_circle = settings.interpolation == 'vector' or not self.rotary_letters
        self.tcp = ''
        self.feedrate = settings.feedrate
        self.turn_rate = nan if self.feedrate is None else self.feedrate / MM * DEG
        self.blocks_per_minute: float | None = None
        self.feed_changed = False  # from G93, G94, G95 to another of them
        self.spindle_speed = 0.0
        self.contour = settings.contour_tolerance
        self.orientation = settings.orientation_tolerance
        # Position: a point (see frames.py) [m], rotary axes [rad], whether words named them.
        self.zero = geometry.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
        self.frames = Frames(setup, self.zero, self.rotary_letters)
        self.point = np.zeros(3)
        self.rotary = np.zeros(2) if self.rotary_letters else np.full(2, nan)
        self.named = 0.0
        #: The tool axis where direction words gave it last, else None: the rotary words rule.
        self.vector: FloatArray | None = None

    def fault(self, message: str, word: str = '') -> ProgramError:
        """Make an error at the present line."""
        return self.flow.fault(message, word)

    def notice(self, key: str, text: str) -> None:
        """Note something harmless once."""
        self.notices.once(key, self.flow.line_number, f'{key}: {text}')

    # --- position ------------------------------------------------------------------------------

    @property
    def by_axes(self) -> bool:
        """True where axis words are axis positions: with rotary axes and without TCP."""
        return bool(self.rotary_letters) and not self.tcp

    def here(self) -> FloatArray:
        """Return the position in program coordinates, shape (5,) [m, rad]."""
        rotary = self.rotary - self.frames.rotary_origin
        return np.concatenate([self.frames.program(self.point), rotary])

    def switch_tcp(self, word: str) -> None:
        """Turn tool-tip programming on (by a word) or off (empty); nothing moves."""
        if bool(word) == bool(self.tcp):
            self.tcp = word
            return
        if word:
            if self.frames.length:
                raise self.fault(LENGTH_WITH_TCP, word)
            if self.rotary.any():
                q = np.concatenate([self.point + self.zero, self.rotary])[None]
                self.point = self.geometry.forward(q)[0][0]
        else:
            self._rotary_of_vector()
            if self.rotary.any():
                linear = self.geometry.linear(self.point[None], self.rotary[None])[0]
                self.point = linear - self.zero
        self.tcp = word

    def _rotary_of_vector(self) -> None:
        """After direction words, find where the rotary axes stand: nearest to the last words."""
        if self.vector is None:
            return
        solutions = self.geometry.rotary_solutions(self.vector)
        if not solutions:
            raise self.fault('the machine cannot reach the tool axis', 'TRAFOOF')
        near = [
            pair + 2.0 * pi * np.round((self.rotary - pair) / (2.0 * pi)) for pair in solutions
        ]
        self.rotary = min(near, key=lambda pair: float(np.abs(pair - self.rotary).sum()))
        self.targets.stand_at(self.rotary)
        self.vector = None

    # --- one block -----------------------------------------------------------------------------

    def move(self, words: BlockWords, feed_given: bool, machine: bool = False) -> None:
        """
        Move to the axis words of a block, if it has any; words not given keep their value.

        Parameters
        ----------
        words : BlockWords
            Axis words and arc words are taken out.
        feed_given : bool
            Whether the block has an F.
        machine : bool
            True where the words are machine coordinates (G53, SUPA).

        """
        arc_words = self._take_arc(words)
        named = self._has_axes(words)
        if not named and arc_words is None and self._take_vector(words) is None:
            return
        if self.motion is None:
            raise self.fault('axis words before G0 or G1; write G0 or G1 first')
        vector = self._vector_of(words, arc_words)
        if machine:
            self.refuse_machine_words()
            target, point = self.here(), self.machine_target(words)
        else:
            target = self.target(words)
            point = self.frames.point(target[:3])
        rotary = self._rotary_target(words, target, machine)
        arc: tuple[float, ...] = NO_ARC
        if self.motion >= 2 and arc_words is not None:
            if machine:
                raise self.fault('an arc in machine coordinates; write G0 or G1', 'G53')
            arc = self._arc(target, arc_words)
        elif self.motion >= 2:
            raise self.fault(FAULTS[1])
        self.go(point, rotary, vector, arc, feed_given)

    def _has_axes(self, words: BlockWords) -> bool:
        for letter in 'ABC':
            if letter in words.values and letter not in self.rotary_letters:
                raise self.fault(
                    f'the machine has no axis {letter}, only {" ".join(self.geometry.axis_names)}',
                    words.texts[letter],
                )
        return any(letter in words.values for letter in ('X', 'Y', 'Z', *self.rotary_letters))

    def target(self, words: BlockWords) -> FloatArray:
        """Take the axis words out and return program coordinates, shape (5,) [m, rad]."""
        here = self.here()
        target = here.copy()
        for i, letter in enumerate(('X', 'Y', 'Z', *self.rotary_letters)):
            value = words.values.pop(letter, None)
            if value is None:
                continue
            way = words.ways.get(letter, 'IC' if self.incremental else '')
            size = self.unit if i < 3 else DEG
            if way == 'IC':
                target[i] = here[i] + value * size
            else:
                target[i] = value * size
            if i >= 3:
                target[i] = self._turned(float(here[i]), float(target[i]), way)
        return target

    def _turned(self, here: float, angle: float, way: str) -> float:
        """Choose whole turns of an absolute rotary word."""
        if way == 'DC' or (self.settings.rotary_sense == 'shortest' and way in ('', 'AC')):
            return angle - 2.0 * pi * round((angle - here) / (2.0 * pi))
        if way == 'ACP':
            return here + (angle - here) % (2.0 * pi)
        if way == 'ACN':
            return here - (here - angle) % (2.0 * pi)
        return angle

    def refuse_machine_words(self) -> None:
        """Refuse machine coordinates where X Y Z are tool tips."""
        if self.tcp:
            raise self.fault('machine coordinates need tool-tip programming off (TRAFOOF, G49)')
        if not self.rotary_letters and not self.zero.any():
            self.notice('machine coordinates', 'on this machine their zero is the workpiece zero')

    def machine_target(self, words: BlockWords) -> FloatArray:
        """Take X Y Z out as machine coordinates and return the point."""
        point = self.point.copy()
        for i, letter in enumerate('XYZ'):
            if (value := words.values.pop(letter, None)) is not None:
                point[i] = self.frames.machine_point(i, value * self.unit)
        return point

    def _rotary_target(self, words: BlockWords, target: FloatArray, machine: bool) -> FloatArray:
        """Return the rotary positions of a target; notes that words have named them."""
        if not self.rotary_letters:
            return self.rotary
        rotary = target[3:] + self.frames.rotary_origin
        if machine:
            for i, letter in enumerate(self.rotary_letters):
                if (value := words.values.pop(letter, None)) is not None:
                    rotary[i] = value * DEG
                    self.named = 1.0
        elif any(letter in words.texts for letter in self.rotary_letters):
            self.named = 1.0
        return np.asarray(rotary)

    def go(
        self,
        point: FloatArray,
        rotary: FloatArray,
        vector: FloatArray | None = None,
        arc: tuple[float, ...] = NO_ARC,
        feed_given: bool = True,
        rapid: bool | None = None,
    ) -> None:
        """Add the target of one block."""
        self.check_point(point)
        if self.rotary_letters and not np.abs(rotary).max() <= MOST_TURN:
            which = int(np.argmax(np.abs(rotary)))
            raise self.fault(
                'a rotary axis beyond 1000 turns; correct the angle',
                f'{self.rotary_letters[which]}{rotary[which] / DEG:g}',
            )
        rapid = self.motion == 0 if rapid is None else rapid
        feed = (inf, nan, inf) if rapid else self.feed(feed_given)
        self.tell_long_way(np.abs(rotary - self.rotary), rapid)
        self.point, self.rotary = point, rotary
        if vector is not None:
            self.vector = vector
        elif self.named and self.vector is not None and not self.tcp:
            self.vector = None
        axis = (nan, nan, nan) if self.rotary_letters else (0.0, 0.0, 1.0)
        named, circle = self.named, self.great_circle and not self.by_axes
        if self.vector is not None:
            axis, named, circle = tuple(self.vector), 0.0, True
        feedrate, duration, turn_rate = feed
        self.targets.add(
            (
                *point, *axis, *rotary, named, float(circle), feedrate, duration, rapid,
                self.stop_always or self.stop_once, self.contour, self.orientation,
                self.flow.main_line, self.by_axes, turn_rate, *arc,
            )
        )  # fmt: skip

    def check_point(self, point: FloatArray) -> None:
        """Refuse a point that no machine can reach."""
        farthest = int(np.argmax(np.abs(point)))
        if not abs(point[farthest]) <= FARTHEST:
            raise self.fault(
                'a coordinate beyond 100,000 mm; correct it or its unit (G20, G21)',
                f'{"XYZ"[farthest]} {point[farthest] / self.unit:g}',
            )

    def tell_long_way(self, turned: FloatArray, rapid: bool) -> None:
        """Tell of rotary words that turn an axis the long way round while cutting."""
        if rapid or not self.rotary_letters or self.targets.empty:
            return
        which = int(np.argmax(turned))
        if turned[which] > LONG_WAY and self.settings.rotary_sense == 'programmed':
            self.notice(
                f'{self.rotary_letters[which]} turns by more than 180 deg in a cutting block',
                'done as programmed; --rotary-sense shortest takes the short way',
            )

    def feed(self, given: bool) -> tuple[float, float, float]:
        """Feedrate [m/s], duration [s] and rate of turn [rad/s] of a cutting block."""
        if self.targets.empty:
            return inf, nan, inf
        if self.feed_mode != 'G93':
            if self.feedrate is None:
                raise self.fault(_NO_NEW_F if self.feed_changed else _NO_F)
            if self.feed_mode == 'G94':
                return self.feedrate, nan, self.turn_rate
            if not self.spindle_speed > 0.0:
                raise self.fault('feed per revolution (G95) without a spindle speed S', 'G95')
            return self.feedrate * self.spindle_speed, nan, self.turn_rate * self.spindle_speed
        if self.blocks_per_minute is None:
            raise self.fault('no F in inverse-time feed (G93); give F in 1/min in each G1 block')
        if not given:
            self.notice('G93', 'a block without F keeps the last one')
        return nan, MINUTE / self.blocks_per_minute, nan

    def set_feed(self, value: float, word: str) -> None:
        """Take over an F word."""
        if not 0.0 < value < inf:
            raise self.fault('the feedrate must be greater than zero', word)
        if self.feed_mode == 'G93':
            self.blocks_per_minute = value
        else:  # G95 counts in m per rev/min, turned into m/s by the spindle speed
            self.feedrate, self.turn_rate = value * self.unit / MINUTE, value * DEG / MINUTE

    # --- arcs and tool vectors -----------------------------------------------------------------

    def _take_arc(self, words: BlockWords) -> BlockWords | None:
        """Take I J K, R (or CR) and P of an arc out, as words of their own."""
        if self.motion is None or self.motion < 2:
            return None
        taken = BlockWords()
        for letter in ('I', 'J', 'K', 'R', 'P'):
            if letter in words.values:
                taken.values[letter] = words.values.pop(letter)
                taken.ways[letter] = words.ways.get(letter, '')
        return taken if taken.values or self._has_axes(words) else None

    def _arc(self, target: FloatArray, words: BlockWords) -> tuple[float, ...]:
        """Resolve an arc from the present position to program coordinates."""
        offset, absolute = np.full((1, 3), nan), np.zeros((1, 3), dtype=bool)
        for i, letter in enumerate('IJK'):
            if letter in words.values:
                offset[0, i] = words.values[letter] * self.unit
                way = words.ways[letter]
                absolute[0, i] = way == 'AC' or (self.centre_absolute and way != 'IC')
        turns = words.values.get('P', 1.0)
        if not (turns >= 1.0 and turns == round(turns) and turns <= 500.0):
            raise self.fault('the turns of an arc are a whole number from 1', f'P{turns:g}')
        arcs = arcs_of(
            self.plane, np.array([self.motion == 3]), self.here()[None, :3], target[None, :3],
            offset, np.array([words.values.get('R', nan) * self.unit]), absolute, turns,
        )  # fmt: skip
        if arcs.fault[0]:
            raise self.arc_fault(int(arcs.fault[0]), float(arcs.mismatch[0]))
        centre = self.frames.point(arcs.centre[0])
        normal = self.frames.turn[:, PLANES[self.plane][2]]
        return (*centre, *normal, float(arcs.sweep[0]))

    def arc_fault(self, kind: int, mismatch: float) -> ProgramError:
        """Make the error of an arc that does not exist."""
        amount = f' (by {mismatch / self.unit:.4g})' if kind in (3, 4) else ''
        return self.fault(FAULTS[kind] + amount, 'G2' if self.motion == 2 else 'G3')

    def _take_vector(self, words: BlockWords) -> tuple[float, float, float] | None:
        """Find the direction words of a block: A3 B3 C3, or I J K with G43.5."""
        names = {name: value for name, value in words.sets if name in ('A3', 'B3', 'C3')}
        if names:
            return tuple(float(names.get(name, 0.0)) for name in ('A3', 'B3', 'C3'))  # type: ignore[return-value]
        if self.tcp == 'G43.5' and any(letter in words.values for letter in 'IJK'):
            return tuple(words.values.get(letter, 0.0) for letter in 'IJK')  # type: ignore[return-value]
        return None

    def _vector_of(self, words: BlockWords, arc_words: BlockWords | None) -> FloatArray | None:
        """Return the unit tool axis in W that direction words give, None without them."""
        given = self._take_vector(words)
        if given is None:
            if any(letter in words.values for letter in self.rotary_letters):
                self._rotary_of_vector()
            return None
        if not self.tcp:
            raise self.fault(
                f'a tool direction needs tool-tip programming; write {codes.TCP_ON_WORDS}', 'A3'
            )
        if any(letter in words.values for letter in self.rotary_letters):
            raise self.fault('a tool direction and rotary words in one block; keep one of them')
        if arc_words is None:
            for letter in 'IJK':
                words.values.pop(letter, None)
        length = float(np.linalg.norm(given))
        if not length > 1e-6:
            raise self.fault('the tool direction is zero; correct A3, B3, C3 or I, J, K')
        return np.asarray(self.frames.turn @ (np.array(given) / length))
