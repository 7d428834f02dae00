"""
G-code -> targets: the modal state of a program, line by line.

Plain motion lines, nearly all of a program, are matched by one expression and go straight to
``_move``; every other line is split into words, its settings are applied, then it moves, then it
stops or ends.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, nan

from cnc_interp.errors import ProgramError
from cnc_interp.program import codes
from cnc_interp.program.columns import TargetColumns
from cnc_interp.program.options import Notices, ReadOptions, RotaryGeometry
from cnc_interp.program.words import PLAIN_MOTION, BlockWords, split_words
from cnc_interp.units import DEG, MINUTE, MM

_FARTHEST = 1e5 * MM
_MOST_TURN = 1e3 * 360.0 * DEG
_NO_F = 'no feedrate (F) before the first G1; write F or give --feed MM_PER_MIN'


class GcodeReader:
    """
    Modal state of a G-code program; ``read`` runs it over the lines.

    Parameters
    ----------
    geometry : RotaryGeometry
        Names the rotary axes.
    options : ReadOptions
        Tolerances, feedrate and interpolation where the program gives none.
    source : str
        File name for errors.
    notices : Notices
        Collects what is harmless.

    """

    def __init__(
        self, geometry: RotaryGeometry, options: ReadOptions, source: str, notices: Notices
    ):
        self.geometry, self.options, self.source = geometry, options, source
        self.notices, self.line_number = notices, 0
        self.targets = TargetColumns(geometry, options, source)
        self.rotary_letters = tuple(geometry.axis_names[3:5])
        # Modal settings; the names are those of codes.SETTINGS.
        self.rapid: bool | None = None
        self.unit, self.incremental, self.inverse_time = MM, False, False
        self.stop_always = self.stop_once = False
        self.great_circle = options.interpolation == 'vector' or not self.rotary_letters
        self.tcp, self.work_offset = '', ''
        self.feedrate = options.feedrate
        self.blocks_per_minute: float | None = None
        self.contour = options.contour_tolerance
        self.orientation = options.orientation_tolerance
        # Position: X Y Z [m], rotary axes [rad], whether rotary words have been named.
        self.tip = (0.0, 0.0, 0.0)
        self.rotary = (0.0, 0.0) if self.rotary_letters else (nan, nan)
        self.named = 0.0
        self.axis = (nan, nan, nan) if self.rotary_letters else (0.0, 0.0, 1.0)
        self.ended = False

    def read(self, lines: Iterable[str]) -> None:
        """Read all lines up to the end of the program."""
        percent_seen = False
        plain = PLAIN_MOTION.fullmatch
        for self.line_number, raw in enumerate(lines, start=1):
            line = raw.strip().upper()
            if match := plain(line):
                g, x, y, z, a, b, c, f = match.groups()
                if g:
                    self.rapid = g == '0'
                if f:
                    self._set_feed(float(f), 'F' + f)
                rotary = self._rotary_words(a, b, c) if a or b or c else None
                if x or y or z or rotary:
                    self._move(
                        float(x) if x else None,
                        float(y) if y else None,
                        float(z) if z else None,
                        rotary,
                        bool(f),
                    )
            elif line[0] == '%':
                if percent_seen or not self.targets.empty:
                    return
                percent_seen = True
            else:
                self._execute(split_words(self._strip_skip(line), self.source, self.line_number))
                if self.ended:
                    return

    def _fault(self, message: str, word: str = '') -> ProgramError:
        return ProgramError(message, self.source, self.line_number, word[:40])

    def _notice(self, key: str, text: str) -> None:
        self.notices.once(key, self.line_number, f'{key}: {text}')

    def _strip_skip(self, line: str) -> str:
        """Remove the block-skip slash and the program-name colon from the beginning of a line."""
        head = line.lstrip('N0123456789 \t') if line[0] == 'N' else line
        if head.startswith('/'):
            self._notice('/', 'lines that can be skipped are executed')
            return head[1:].lstrip('123456789') if head[1:2].isdigit() else head[1:]
        return 'O' + line[1:] if line[0] == ':' else line

    def _execute(self, words: BlockWords) -> None:
        values = words.values
        for letter in ('N', 'O'):
            values.pop(letter, None)
        for key in words.keys:
            self._key_word(key)
        if 'G4' in words.g:
            self._dwell(words)
        self._settings(words)
        for code in words.m:
            self._machine_function(code)
        f = values.pop('F', None)
        if f is not None:
            self._set_feed(f, words.texts['F'])
        self._move_words(words, f is not None)
        self.stop_once = False
        if codes.STOP_M & set(words.m):
            self.targets.stop_here()
        self.ended = bool(codes.END_M & set(words.m))

    def _settings(self, words: BlockWords) -> None:
        """Apply the G codes of a block."""
        was_inverse = self.inverse_time
        set_here: dict[str, str] = {}
        for code in words.g:
            if code in codes.REFUSED_G:
                raise self._fault(codes.REFUSED_G[code], code)
            if code in codes.SETTINGS:
                attribute, value = codes.SETTINGS[code]
                if attribute in set_here:
                    raise self._fault(
                        f'{set_here[attribute]} stands in the same block; keep one of them', code
                    )
                set_here[attribute] = code
                setattr(self, attribute, value)
            elif code in codes.WORK_OFFSETS:
                self._choose_work_offset(code)
            elif code in codes.TCP_SWITCHES or code in codes.HARMLESS_G:
                self._switch_tcp(code)
            elif code != 'G4':
                raise self._fault('this G code is not supported; remove it or post without', code)
        if 'G64' in words.g:
            self._path_tolerance(words)
        if was_inverse != self.inverse_time:
            # A number that meant mm/min must not be taken for 1/min, nor the reverse.
            self.feedrate, self.blocks_per_minute = self.options.feedrate, None

    def _switch_tcp(self, word: str) -> None:
        """Turn tool-tip programming on or off by any control's word; tell of harmless codes."""
        if word in codes.TCP_ON:
            if not self.rotary_letters:
                raise self._fault('tool-tip programming needs a machine with rotary axes', word)
            self.tcp = word
            return
        by_length = self.tcp in codes.TCP_BY_LENGTH and word in codes.LENGTH
        if word in codes.HARMLESS_G and not (by_length or (self.tcp and word in codes.TCP_OFF)):
            self._notice(word, codes.HARMLESS_G[word])
        if by_length or word in codes.TCP_OFF:
            self.tcp = ''

    def _choose_work_offset(self, code: str) -> None:
        if self.work_offset and code != self.work_offset:
            raise self._fault(
                f'the program began with {self.work_offset}; changing the workpiece zero is not '
                f'supported yet; split the program',
                code,
            )
        self.work_offset = code
        self._notice(code, 'taken as the workpiece zero')

    def _path_tolerance(self, words: BlockWords) -> None:
        """G64 P: both tolerances from here on; without P, the user's."""
        tolerance = words.values.pop('P', None)
        if words.values.pop('Q', None) is not None:
            self._notice('Q', 'the tolerance of G64 is taken from P alone')
        if tolerance is not None and not 0.0 < tolerance * self.unit < _FARTHEST:
            raise self._fault('the tolerance must be greater than zero', words.texts['P'])
        if tolerance is None or self.options.force_tolerances:
            self.contour = self.options.contour_tolerance
            self.orientation = self.options.orientation_tolerance
            if tolerance is not None:
                self._notice('G64 P', "ignored, the command's tolerances are forced")
        else:
            self.contour = self.orientation = tolerance * self.unit

    def _dwell(self, words: BlockWords) -> None:
        """G4: its P, X, F, S or U is a time, no motion."""
        for letter in 'PXFSU':
            words.values.pop(letter, None)
        if {'X', 'Y', 'Z', *self.rotary_letters} & set(words.values):
            raise self._fault('a dwell and a motion in one block; write two lines', 'G4')
        self._notice('G4', 'exact stop; the dwell time is not kept')
        self.targets.stop_here()

    def _machine_function(self, code: str) -> None:
        if code in codes.REFUSED_M:
            raise self._fault(codes.REFUSED_M[code], code)
        if code in codes.TCP_SWITCHES:
            self._switch_tcp(code)
        elif code in codes.STOP_M:
            self._notice(code, 'exact stop; the program goes on by itself')
        elif code not in codes.END_M:
            self._notice(code, 'passed on, it does not move the tool')

    def _key_word(self, key: str) -> None:
        if key in codes.INTERPOLATION_KEYS:
            if self.options.interpolation == 'auto' and self.rotary_letters:
                self.great_circle = codes.INTERPOLATION_KEYS[key]
            else:
                self._notice(key, 'ignored, the interpolation is fixed')
        elif key in codes.TCP_SWITCHES:
            self._switch_tcp(key)
        elif key in codes.HARMLESS_KEYS:
            self._notice(key, 'passed on, it does not move the tool')
        else:
            unknown = 'unknown word; remove it, or write a letter and a number as X10'
            raise self._fault(codes.refused_key(key) or unknown, key)

    def _set_feed(self, value: float, word: str) -> None:
        if not 0.0 < value < inf:
            raise self._fault('the feedrate must be greater than zero', word)
        if self.inverse_time:
            self.blocks_per_minute = value
        else:
            self.feedrate = value * self.unit / MINUTE

    def _move_words(self, words: BlockWords, feed_given: bool) -> None:
        """Move to the axis words of a block; every other word is harmless or refused."""
        values = words.values
        x, y, z = values.pop('X', None), values.pop('Y', None), values.pop('Z', None)
        rotary = None
        if {'A', 'B', 'C'} & set(values):
            abc = (words.texts[k][1:].lstrip(' =') if k in values else None for k in 'ABC')
            rotary = self._rotary_words(*abc)
        for letter in values.keys() - {'A', 'B', 'C'}:
            if letter in 'STDH':
                self._notice(letter, 'passed on, it does not move the tool')
            elif letter in 'UVW':
                raise self._fault('this axis is not supported', words.texts[letter])
            else:
                raise self._fault('this word has no meaning here', words.texts[letter])
        if not (x is None and y is None and z is None and rotary is None):
            self._move(x, y, z, rotary, feed_given)

    def _rotary_words(
        self, a: str | None, b: str | None, c: str | None
    ) -> tuple[float | None, float | None]:
        """Rotary words of a block as angles of the machine's two rotary axes [deg]."""
        angles: list[float | None] = [None, None]
        for letter, text in zip('ABC', (a, b, c), strict=True):
            if text is None:
                continue
            if letter not in self.rotary_letters:
                raise self._fault(
                    f'the machine has no axis {letter}, only {" ".join(self.geometry.axis_names)}',
                    letter + text,
                )
            angles[self.rotary_letters.index(letter)] = float(text)
        return angles[0], angles[1]

    def _move(
        self,
        x: float | None,
        y: float | None,
        z: float | None,
        rotary: tuple[float | None, float | None] | None,
        feed_given: bool,
    ) -> None:
        """Add the target of one block; words not given keep their value."""
        if self.rapid is None:
            raise self._fault('axis words before G0 or G1; write G0 or G1 first')
        unit = self.unit
        here_x, here_y, here_z = self.tip
        if self.incremental:
            here_x += 0.0 if x is None else x * unit
            here_y += 0.0 if y is None else y * unit
            here_z += 0.0 if z is None else z * unit
        else:
            here_x = here_x if x is None else x * unit
            here_y = here_y if y is None else y * unit
            here_z = here_z if z is None else z * unit
        if max(abs(here_x), abs(here_y), abs(here_z)) > _FARTHEST:
            value, letter = max(zip(map(abs, (here_x, here_y, here_z)), 'XYZ', strict=True))
            raise self._fault(
                'a coordinate beyond 100,000 mm; correct it or its unit (G20, G21)',
                f'{letter} {value / unit:g}',
            )
        self.tip = (here_x, here_y, here_z)
        if rotary is not None or not self.tcp:
            self._turn(rotary)
        rapid, exact = self.rapid, self.stop_always or self.stop_once
        feedrate, duration = (inf, nan) if rapid else self._feed(feed_given)
        self.targets.add(
            (
                *self.tip,
                *self.axis,
                *self.rotary,
                self.named,
                self.great_circle,
                feedrate,
                duration,
                rapid,
                exact,
                self.contour,
                self.orientation,
                self.line_number,
            )
        )

    def _feed(self, given: bool) -> tuple[float, float]:
        """Feedrate [m/s] and duration [s] of a G1 block, one of them NaN."""
        if self.targets.empty:
            return inf, nan
        if not self.inverse_time:
            if self.feedrate is None:
                raise self._fault(_NO_F)
            return self.feedrate, nan
        if self.blocks_per_minute is None:
            raise self._fault('no F in inverse-time feed (G93); give F in 1/min in each G1 block')
        if not given:
            self._notice('G93', 'a block without F keeps the last one')
        return nan, MINUTE / self.blocks_per_minute

    def _turn(self, rotary: tuple[float | None, float | None] | None) -> None:
        """Take over rotary words; without tool-tip programming they must stay at zero."""
        before = self.rotary
        if rotary is not None:
            base = before if self.incremental else (0.0, 0.0)
            self.rotary = tuple(  # type: ignore[assignment]
                now if word is None else start + word * DEG
                for word, start, now in zip(rotary, base, before, strict=True)
            )
            self.named = 1.0
            if max(abs(self.rotary[0]), abs(self.rotary[1])) > _MOST_TURN:
                raise self._fault(
                    'a rotary axis beyond 1000 turns; correct the angle', self._spelled(rotary)
                )
        if self.tcp or not self.rotary_letters:
            return
        if any(before) or any(self.rotary):
            raise self._fault(
                'motion with turned rotary axes needs tool-tip programming; switch it on with '
                f'{codes.TCP_ON_WORDS} before this line (axis coordinates are not supported yet)',
                self._spelled(rotary),
            )

    def _spelled(self, rotary: tuple[float | None, float | None] | None) -> str:
        """Rotary words as they were meant, for errors."""
        pairs = zip(self.rotary_letters, rotary or (), strict=False)
        return ' '.join(f'{letter}{angle:g}' for letter, angle in pairs if angle is not None)
