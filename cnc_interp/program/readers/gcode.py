"""G-code to motion targets, line by line; ``plain_lines.py`` reads many plain lines at once."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy

import numpy as np

from cnc_interp.core import INCH, MINUTE, MM, FloatArray, ProgramError
from cnc_interp.machine_model import signals
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.block_modes import NONE, ActiveModes
from cnc_interp.program.blocks.functions import Acting, acting
from cnc_interp.program.execution.setting_words import Modes
from cnc_interp.program.geometry.arcs import OF_PLACE, PLANES
from cnc_interp.program.geometry.target_row import AT_M0, AT_M1
from cnc_interp.program.job import JobSetup, SetupChange
from cnc_interp.program.modal.groups import MODES, SETTINGS
from cnc_interp.program.modal.state import NO_F, NO_NEW_F, modal_words
from cnc_interp.program.motion import cycles, probing
from cnc_interp.program.motion.cycles import TAPPING, CannedCycle, SiemensCycle
from cnc_interp.program.motion.mover import Mover
from cnc_interp.program.motion.probing import Probe
from cnc_interp.program.motion.splines import Splines
from cnc_interp.program.motion.thread_cycle import cut_thread
from cnc_interp.program.motion.tilted_plane import TiltedPlane
from cnc_interp.program.notices import Notices, Refusals
from cnc_interp.program.readers.plain_lines import SHORTEST, move_along
from cnc_interp.program.text import codes, scan
from cnc_interp.program.text.dialects import FANUC, LINUXCNC, PLAIN, SIEMENS, Dialect
from cnc_interp.program.text.expressions import UNSET, ExpressionError, ProgramVariables
from cnc_interp.program.text.flow import Flow
from cnc_interp.program.text.source import Source, is_name, leader_lines
from cnc_interp.program.text.words import BlockWords, split_words, without_comments
from cnc_interp.settings.options import Settings

_NUMBER_AND_SKIP = re.compile(r'(?:[N:]\s*\d+\s*)?(/\d?\s*)?(?:N\s*\d+\s*)?')
#: A length or an angle without a decimal point; codes of units and of canned cycles.
_NO_POINT = re.compile(r'(?<![A-Z_#<\d])([ABCIJKQRUVWXYZ])\s*([-+]?\d+)(?![\d.]|\s*=)')
#: What a comment tells the operator, and parameters in it.
_MESSAGE = re.compile(r'\(\s*(?:DEBUG|PRINT|MSG)\s*,([^)]*)\)', re.IGNORECASE)
_PARAMETER = re.compile(r'#(\d+|<[^<>]+>)')
_UNIT, _CYCLE = re.compile(r'G2[01](?!\d)'), re.compile(r'G(?:7[346]|8[1-9])(?!\d)')


class GcodeReader:
    def __init__(
        self,
        geometry: Transform,
        settings: Settings,
        setup: JobSetup,
        source: Source,
        notices: Notices,
        dialect: Dialect = PLAIN,
    ):
        self.settings, self.notices = settings, notices
        self.variables = ProgramVariables(
            lambda: self.mover.system_variables(self._tool),
            lambda: self.mover.predefined_names(self._tool, self._chosen_tool, self._outputs),
        )
        self.flow = Flow(source, self.variables, settings.most_jumps)
        self.mover = Mover(geometry, settings, setup, self.flow, notices)
        self.targets = self.mover.targets
        self.mover.dialect = dialect
        self.mover.motion = dialect.starts_with
        self.mover.centres_open &= dialect is not LINUXCNC
        self.splines = Splines(self.mover)
        self.fault, self.notice = self.mover.fault, self.mover.notice
        self._cycle: CannedCycle | None = None
        self._tool = self._chosen_tool = setup.tool
        self._called: SiemensCycle | None = None  # by MCALL
        self._outputs: dict[str, str] = {}  # the last M code of each output
        #: What functions have set last: G94 or G95, and what ``SURFACE`` names with G96.
        self._states: tuple[str, tuple[float, ...]] = 'G94', ()
        self._signals = geometry.machine.signals
        self._percent_seen = False
        self._leader = leader_lines(source)
        self.whole = True  # whether more lines can follow, so that it can look ahead
        self.finished = False  # whether M2 or M30 was read
        self.waits_at_probes = False  # so that what follows is read with its answer
        self.probe: Probe | None = None  # that is waited for
        self._in_flow = False  # whether a refusal leaves it open which line is the next
        self._plane = TiltedPlane(self.mover)
        self._modes = Modes(self.mover, self._plane, self.variables)

    @property
    def used(self) -> set[str]:
        return self.mover.used | {'G92', self.mover.last_offset}

    @property
    def share(self) -> float:
        return self.flow.share * self.targets.share

    def follow(self, before: GcodeReader) -> None:
        self.mover.follow(before.mover)
        self.variables.follow(before.variables)
        self._chosen_tool = before._chosen_tool or self._tool
        self._cycle = deepcopy(before._cycle)
        self._outputs = dict(before._outputs)

    def stand_at(self, q: FloatArray) -> None:
        self.mover.stand_at(q)
        if self._cycle is not None:
            self._cycle.start = self._level()

    def _level(self) -> float:
        return float(self.mover.here()[PLANES[self.mover.plane][2]])

    def active_modes(self, offset: str, tool: int) -> ActiveModes:
        _, motion, feed = self._state()
        code = '' if self._cycle is None else self._cycle.code
        return self.mover.active_modes(code, offset, tool, self._outputs).moving(motion, feed)

    def _state(self) -> tuple[float, float, float]:
        mover, tool = self.mover, self._tool
        code = '' if self._cycle is None else self._cycle.code
        motion = NONE if code or mover.motion is None else float(mover.motion)
        number = mover.targets.modes.number(
            (code, tool, *self._outputs.values(), *mover.recorded_values()),
            lambda: mover.active_modes(code, mover.setup.offset, tool, self._outputs),
        )
        return number, motion, mover.feed_word

    def blocks(self) -> Iterator[Blocks]:
        """Yield the blocks in batches, none after a refusal; raise all refusals at the end."""
        flow, targets, refused = self.flow, self.targets, Refusals()
        while self.probe is None:
            try:
                self._in_flow = True
                if not flow.here():
                    break
                self._in_flow = False
                self._next_lines(together=not refused)
            except ProgramError as problem:
                if self._in_flow:  # what follows may not be what would be executed
                    refused.add(problem, of_place=False)
                    raise refused.error() from None
                later = problem.line_number not in (flow.line_number, flow.main_line)
                unset = problem.message in (NO_F, NO_NEW_F) or problem.message.endswith(UNSET)
                refused.add(problem, later or problem.message.startswith(OF_PLACE), unset)
                flow.row += 1
            else:
                if refused and self.mover.motion in (0, 1):
                    refused.arrive()
            parts = targets.take()
            if not refused:
                yield from parts
        if flow.ran_out and flow.has_o_words and self.mover.dialect is LINUXCNC:
            raise self.fault('the program ends without M2, M30 or %; add M2')
        if refused:
            raise refused.error()
        if self.mover.lone_arc:
            raise self.mover.lone_arc
        self.splines.end()
        self.mover.end_corner()
        if targets.empty and targets.switches:  # a program that moves nothing
            self.mover.go(self.mover.point, self.mover.rotary, rapid=True)
        yield from targets.finish()

    def _next_lines(self, together: bool) -> None:
        flow = self.flow
        window, row = flow.window, flow.row
        end = self._until_start(row, window.next_rare(row))
        end = end if together else min(end, row + 1)
        if end > row:
            self._run(row, end)
        else:
            flow.jumped = False
            self._line(window.line(row))
            if flow.restoring is not None:
                self._restore(flow.restoring)
                flow.restoring = None
            if not flow.jumped:
                flow.row = row + 1

    def _until_start(self, row: int, end: int) -> int:
        start, flow = self.targets.start, self.flow
        ahead = start.line - flow.line_number
        if not start.line or ahead < 0 or flow.source is not flow.main:
            return end
        if ahead == 0:
            start.reach(self._state_words)
            return end
        return min(end, row + ahead)

    def _state_words(self) -> tuple[str, ...]:
        words = modal_words(self.mover)
        if self._tool:
            words.insert(0, f'T{self._tool}')
        if self.mover.spindle_speed:
            words.append(f'S{self.mover.spindle_speed:g}')
        return (*words, *(code for code in self._outputs.values() if code))

    def _run(self, first: int, end: int) -> None:
        window = self.flow.window
        rows = first + np.flatnonzero(window.kind[first:end] == scan.PLAIN)
        in_main = self.flow.source is self.flow.main
        free = (
            self._cycle is None
            and self._called is None
            and not self.mover.radius_code
            and not self.splines.open
            and not self._plane.parts
            and not self.mover.by_surface_speed
            and self.settings.numbers != 'increments'
        )
        if len(rows) >= SHORTEST and in_main and free:
            lines = window.start.line + rows
            if move_along(self.mover, window.code[rows], window.values[rows], lines):
                self.flow.row = end
                return
        for row in rows:
            self.flow.row = int(row)
            self._line(window.line(row))
            if self.flow.ended:
                return
        self.flow.row = end

    def _line(self, raw: str) -> None:
        if self.flow.main_line <= self._leader:
            self.notice('text before %', 'it does not belong to the program')
            return
        line = without_comments(raw.upper(), self.fault)
        if '(' in raw and (said := _MESSAGE.search(raw)):
            self._say(said[1])
        if not line:
            return
        if line[0] == '%' and line[-1] != '*':
            if self._percent_seen or not self.targets.empty:
                self.flow.ended = True
            self._percent_seen = True
            return
        head = _NUMBER_AND_SKIP.match(line)
        if head and head.end():
            if head[1]:
                if self.settings.skip_blocks:
                    return
                self.notice('/', 'lines that can be skipped are executed')
            line = line[head.end() :]
        self._in_flow = True
        rest = self.flow.execute(line) if line else None
        self._in_flow = False
        if rest and rest[-1] == '*':
            raise self.fault(
                '* ends a block in DIN/ISO of Heidenhain, where G30 and G31 are the '
                'blank; post for Fanuc or as plain text',
                '*',
            )
        if rest and self.settings.numbers == 'increments':
            rest = self._with_points(rest)
        if rest and not (rest[0] in 'O<' and self.targets.empty and is_name(rest)):
            self._execute(split_words(rest, self.variables, self.fault))

    def _say(self, text: str) -> None:

        def value(match: re.Match[str]) -> str:
            name, known = match[1].upper(), self.variables
            try:
                return f'{known.number(int(name)) if name.isdigit() else known.named(name):.6g}'
            except ExpressionError:
                return match[0]

        text = _PARAMETER.sub(value, text).strip()
        if self.mover.probed and not self.waits_at_probes:
            text += ' (before the probe answers)'
        self.mover.notices.once(text, self.flow.line_number, text)

    def _with_points(self, line: str) -> str:
        """Write lengths and angles of a line that count increments with a decimal point."""
        unit = _UNIT.search(line)
        inch = unit[0].endswith('0') if unit else self.mover.unit == INCH
        counts = self._cycle is not None or _CYCLE.search(line)  # K of a cycle

        def written(match: re.Match[str]) -> str:
            letter, number = match[1], int(match[2])
            if letter == 'K' and counts:
                return match[0]
            return f'{letter}{number * (1e-4 if inch and letter not in "ABC" else 1e-3):.4f}'

        return _NO_POINT.sub(written, line)

    def _execute(self, words: BlockWords) -> None:
        values, mover = words.values, self.mover
        for letter in ('N', 'O'):
            values.pop(letter, None)
        words.g += probing.measuring(words)
        if mover.dialect is LINUXCNC and 'G76' in words.g:
            words.g[words.g.index('G76')] = codes.THREAD_CYCLE
        drilling = self._siemens_cycle(words)
        for key, given in words.keys:
            self._modes.key_word(key, given, words)
        self._modes.assign(words)
        changes = 'M6' in words.m or 'M61' in words.m
        if 'M61' in words.m and 'Q' not in values:
            raise self.fault('give the number of the tool as Q', 'M61')
        tool = values.pop('Q') if 'M61' in words.m else values.get('T')
        if tool is not None:
            self._chosen_tool = round(min(abs(tool), 1e6))
        if changes or not self._tool:
            self._tool = self._chosen_tool
        if changes:
            mover.change(SetupChange('tool', self._tool))
        if 'M19' in words.m and 'G64' not in words.g:
            for letter in 'RPQ':  # where the spindle stops
                values.pop(letter, None)
        if words.second_tool is not None:
            if not changes:
                raise self.fault('T is written twice in one block; keep one of them', 'T')
            self._chosen_tool = round(min(abs(words.second_tool), 1e6))
        dwell = 'PXFSU' if 'G4' in words.g else ''
        times = {letter: values.pop(letter) for letter in dwell if letter in values}
        unit = mover.unit
        self._settings(words)
        self._set_speed(words)
        for code in words.m:
            self._machine_function(code)
        before, after = self._functions(words)
        self._act(before)
        f = values.pop('F', None) if codes.TAKE_F.isdisjoint(words.g) else None
        if f is not None:
            mover.set_feed(f, words.texts['F'], unit if mover.dialect.feeds_first else mover.unit)
        mover.targets.state = self._state()
        if mover.radius_code:
            self._modes.stay_beside_contour(words)
        taking = [code for code in words.g if code in codes.TAKE_AXES]
        if len(taking) > 1:
            raise self.fault(f'{taking[0]} is in the same block; keep one of them', taking[1])
        if mover.polar and (other := codes.NOT_POLAR & set(taking)):
            raise self.fault('polar coordinates are on; write G15 before', min(other))
        calling = self.flow.call_of(words)
        if 'G4' in taking:
            self._dwell(words, times)
        elif self._plane.takes(taking):
            self._plane.execute(taking[0], words)
        elif taking and taking[0] in codes.THREADS:
            self._thread(taking[0], words)
        elif taking and taking[0] in probing.CODES:
            self._probe(taking[0], words)
        elif taking and 'G65' not in taking:
            self._modes.axis_code(taking[0], words)
        if any(key == 'BSPLINE' for key, _ in words.keys):
            self._cycle = None
            self.splines.begin()
        moves = self._called is not None and not set('XYZ').isdisjoint(values)
        self._move(words, f is not None)
        for cycle in drilling or ([self._called] if moves and self._called else []):
            cycle.make()
        self._act(after)
        mover.stop_once = False
        for code in words.m:
            if code in codes.STOP_M:
                self._program_stop(code)
        if not codes.END_M.isdisjoint(words.m):
            mover.change(SetupChange('active', ''))  # all other offsets are kept
            self.flow.ended = self.finished = True
        elif calling:
            self.flow.call_number(*calling)
        elif (returns := codes.RETURN_M & set(words.m)) and self.flow.depth:
            self.flow.leave()
        elif returns:
            self.notice(min(returns), 'in the main program: its end')
            self.flow.ended = True

    def _siemens_cycle(self, words: BlockWords) -> list[SiemensCycle]:
        mover, modal, found = self.mover, False, list[SiemensCycle]()
        if not words.keys:
            return found
        for key, given in words.keys:
            if key == 'MCALL':
                modal, self._called = True, None
            elif key in cycles.SIEMENS:
                found.append(SiemensCycle(key, given, mover))
            elif key in cycles.PATTERNS:
                self._drill_pattern(key, given)
        words.keys[:] = [key for key in words.keys if key[0] not in cycles.SIEMENS_WORDS]
        if modal and found:
            self._called = found.pop()
        return found

    def _drill_pattern(self, key: str, given: Sequence[float | None]) -> None:
        mover = self.mover
        if self._called is None:
            raise self.fault('a pattern needs a modal cycle; write MCALL CYCLE81(...) before', key)
        for place in cycles.places_of(key, given, mover):
            target = mover.here()
            target[list(PLANES[mover.plane][:2])] = place
            mover.go(mover.frames.point(target[:3]), mover.rotary, rapid=True)
            self._called.make()

    def _settings(self, words: BlockWords) -> None:
        mover = self.mover
        was = mover.feed_mode
        set_here: dict[str, str] = {}
        for code in words.g:
            if code in codes.LOOK_AHEAD and not codes.SPLINE_LETTERS & words.values.keys():
                for letter in codes.LOOK_AHEAD[code]:
                    words.values.pop(letter, None)
                self.notice(code, 'no effect, the path is always smoothed within the tolerances')
            elif code in codes.REFUSED_G:
                raise self.fault(codes.REFUSED_G[code], code)
            elif code in codes.TURNING and (
                ({'P', 'Q'} <= words.values.keys() and 'Z' not in words.values)
                or ('U' in words.values and 'U' not in mover.extra_letters)
            ):
                raise self.fault('a cycle of a lathe; lathe programs are not read', code)
            elif code in SETTINGS:
                attribute, value = SETTINGS[code]
                if other := set_here.get(attribute):
                    raise self.fault(f'{other} is in the same block; keep one of them', code)
                set_here[attribute] = code
                setattr(mover, attribute, value)
                mover.centres_open &= attribute != 'centre_absolute'
                if attribute == 'motion':
                    self._cycle = None
                    self.splines.end()
            elif code in codes.WORK_OFFSETS:
                if 'H' in words.values and not codes.LENGTH_CODES & set(words.g):
                    raise self.fault(codes.OKUMA_LENGTH, code)
                self._modes.choose_work_offset(code)
            elif code in ('G54.1', 'G154'):
                self._modes.choose_extended_offset(code, words)
            elif code in codes.LENGTH or code in codes.TCP_ON or code in codes.TCP_OFF:
                self._modes.tool_length(code, words, self._tool)
            elif code in codes.RADIUS:
                if not self.whole and code != 'G40':
                    raise self.fault('looks ahead; run it in a program', code)
                self._modes.cutter_radius(code, words, self._tool)
            elif code in codes.CYCLES:
                if self._cycle is None:
                    self._cycle = CannedCycle(code, self._level())
                self._cycle.code = code
                if code in TAPPING:
                    self.mover.tell_tapping(code)
            elif code == 'G80':
                self._cycle = None
            elif code == 'G69':
                self._plane.cancel()
            elif code == 'G16':
                if mover.dialect not in MODES['polar'].dialects:
                    raise self.fault(
                        'polar coordinates are those of Fanuc; post with X and Y', code
                    )
                mover.polar = True
            elif code in codes.HARMLESS_G:
                letters, why = codes.OTHER_MEANING.get(code, ('', ''))
                if found := set(letters) & words.values.keys():
                    raise self.fault(why, f'{code} {words.texts[min(found)]}')
                if code == 'G54.2' and words.values.get('P'):
                    raise self.fault('a dynamic offset is not supported; write G54.2 P0', code)
                if code == 'G15' and mover.polar:
                    mover.polar = False
                    continue
                for letter in codes.IDLE_LETTERS.get(code, ''):
                    words.values.pop(letter, None)
                if code in ('G96', 'G97'):
                    mover.by_surface_speed = code == 'G96'
                if code not in self._signals.words:
                    self.notice(code, codes.HARMLESS_G[code])
            elif code not in codes.TAKE_AXES and code != 'G53':
                raise self.fault('this G code is not supported; post without it', code)
        if (
            mover.dialect in (FANUC, PLAIN)
            and 'H' in words.values
            and mover.frames.length
            and not (codes.LENGTH_CODES | {'G65'}) & set(words.g)
        ):
            code = mover.tcp if mover.tcp in codes.TCP_BY_LENGTH else 'G43'
            self._modes.tool_length(code, words, self._tool)
        if 'G64' in words.g:
            self._modes.path_tolerance(words)
        if was != mover.feed_mode:
            # F in mm/min must not be used as 1/min, or the reverse.
            mover.feedrate, mover.blocks_per_minute = self.settings.feedrate, None
            mover.feed_changed = True

    def _machine_function(self, code: str) -> None:
        if code in codes.REFUSED_M:
            raise self.fault(codes.REFUSED_M[code], code)
        if code in codes.STATE_M:
            self._save_or_restore(code)
        elif code in codes.TCP_ON:
            self._modes.switch_tcp(code)
        elif code in codes.TCP_OFF:
            self.mover.switch_tcp('')
        elif code not in codes.ACTING_M:
            self._outputs |= codes.OUTPUTS.get(code, {})
            if code in self._signals.words:
                return
            if code in ('M3', 'M4'):
                self.notice(code, codes.NO_SPINDLE)
            else:
                self.notice(code, 'no effect, it does not move the tool')

    def _functions(self, words: BlockWords) -> tuple[list[Acting], list[Acting]]:
        values, mover = words.values, self.mover
        found = [letter for letter in 'ST' if letter in values]
        of_feed = 'G95' if mover.feed_mode == 'G95' else 'G94'
        states = of_feed, (*self._surface(), mover.surface_speed) * self._by_surface
        if states[0] != self._states[0]:
            found.insert(0, of_feed)
        if states[1] != self._states[1]:
            found.insert(0, 'G96' if states[1] else 'G97')
        if states[1] and 'S' in found:
            found.remove('S')
        self._states = states
        found = [word for word in found if word in self._signals.words]
        found += sorted(words.m, key=lambda code: codes.FIRST_M.get(code, len(codes.FIRST_M)))
        if not found:
            return [], []
        tool = self._tool if 'M6' in words.m else self._chosen_tool
        given = {**values, 'S': mover.spindle_speed, 'T': float(tool)}
        given |= zip(signals.SURFACE, states[1], strict=False)
        if {'M50', 'M51'} & set(words.m):
            given[signals.FIXED] = float(values.pop('P', 1.0) == 0.0)
        moments = acting(self._signals, found, given, self.fault)
        for letter in self._signals.letters(found) & {'P', 'Q'}:
            values.pop(letter, None)
        return moments

    def _set_speed(self, words: BlockWords) -> None:
        """Take S, a speed of the surface with G96, whose D is the largest speed."""
        mover, speed, by_surface = self.mover, words.values.get('S'), self._by_surface
        if 'G96' in words.g and by_surface:
            mover.surface_limit = abs(words.values.pop('D', 0.0))
            if speed is None:
                raise self.fault('needs S, the speed of the surface', 'G96')
            if mover.tcp or (mover.rotary_letters and mover.rotary.any()):
                raise self.fault(
                    'the rotary axes must be at 0, without tool-tip programming', 'G96'
                )
        if by_surface and speed is not None:
            mover.surface_speed = speed * (1.0 if mover.unit == MM else 0.3048)
        elif speed is not None:
            mover.spindle_speed = speed
        elif self._states[1] and not by_surface:
            raise self.fault('needs S, the speed in rev/min', 'G97')

    @property
    def _by_surface(self) -> bool:
        return self.mover.by_surface_speed and 'G96' in self._signals.words

    def _surface(self) -> tuple[float, float]:
        """Return X of the axis where that of the program is 0 [mm], and the largest speed."""
        mover = self.mover
        return float((mover.frames.point(np.zeros(3)) + mover.zero)[0] / MM), mover.surface_limit

    def _act(self, steps: list[Acting]) -> None:
        for number, value in steps:
            if self._signals.steps[number].rests:
                self.mover.end_corner()
                if not self.targets.stands or self.splines.open:
                    self.splines.stop_here()
            self.targets.change((number, value), self.flow.main_line)

    def _save_or_restore(self, code: str) -> None:
        """Process M70 to M73: save the state, forget it, restore it; M73 does so at return."""
        flow, mover = self.flow, self.mover
        if code == 'M72':
            if flow.saved_state is None:
                raise self.fault('no state is saved here; write M70 before', code)
            self._restore(flow.saved_state)
            return
        state = (mover.saved_values(), dict(self._outputs))
        flow.save(None if code == 'M71' else state, restores=code == 'M73')

    def _restore(self, state: tuple[dict[str, object], dict[str, str]]) -> None:
        values, outputs = state
        before, speed = self._outputs, self.mover.spindle_speed
        self._outputs = dict(outputs)
        if str(values['offset']) != self.mover.setup.offset:
            self._modes.choose_work_offset(str(values['offset']))
        self.mover.restore_values(values)
        words = ['S'] if self.mover.spindle_speed != speed else []
        spindle, turned = (told.get('spindle', 'M5') for told in (outputs, before))
        words += [spindle] if spindle != turned else []
        on, was = ({'M7', 'M8'} & {*told.values()} for told in (outputs, before))
        words += (['M9'] if was - on else []) + sorted(on if was - on else on - was)
        for word in words:
            if word in self._signals.words:
                given = {'S': self.mover.spindle_speed}
                for steps in acting(self._signals, [word], given, self.fault):
                    self._act(steps)

    def _program_stop(self, code: str) -> None:
        self.mover.end_corner()
        self.targets.program_stop()
        if self.targets.stands and not self.splines.open:
            waits = code != 'M1'
            self.targets.waits_first |= waits
            self.notice(f'{code} at the start', codes.WAITS_FIRST if waits else codes.NOT_YET)
        else:
            self.notice(code, codes.STOP_M[code])
            self.splines.stop_here(AT_M1 if code == 'M1' else AT_M0)

    def _move(self, words: BlockWords, feed_given: bool) -> None:
        mover, values = self.mover, words.values
        machine = 'G53' in words.g and not {'G28', 'G30'} & set(words.g)
        axes = any(letter in values for letter in ('X', 'Y', 'Z', *mover.rotary_letters))
        if machine and axes and mover.incremental and mover.dialect is not SIEMENS:
            raise self.fault('with G91 Fanuc leaves it out, LinuxCNC refuses it; write G90', 'G53')
        if self._cycle is not None and axes:
            if machine:
                raise self.fault('machine coordinates in a canned cycle; write G80 before', 'G53')
            self._cycle.drill(mover, words, feed_given)
        elif self._cycle is None and not self.splines.take(words, feed_given):
            mover.move(words, feed_given, machine)
        for letter in list(values):
            if letter == 'H' and mover.frames.length:
                raise self.fault(
                    'on Fanuc it changes the tool length; write G43 with it, or leave it out',
                    words.texts['H'],
                )
            if self._signals.uses(letter):
                continue
            if letter in 'STDHE':
                self.notice(letter, 'no effect, it does not move the tool')
            elif letter in 'ABCUVW':
                raise self.fault(mover.why_not(letter), words.texts[letter])
            elif letter == 'L' and len(values) == 1:
                why = 'is not supported; put it into this file'
                raise self.fault(f'the subprogram L{values[letter]:g} {why}', words.texts[letter])
            elif self._cycle is None or letter not in 'QRPKL':
                raise self.fault('this word has no meaning here', words.texts[letter])

    def _thread(self, code: str, words: BlockWords) -> None:
        """Process G33, G33.1 which comes back, and G32 of Fanuc: K or F is the way per turn."""
        mover, letter = self.mover, 'F' if code == 'G32' else 'K'
        if code == 'G32' and mover.dialect not in (FANUC, PLAIN):
            raise self.fault('a thread of Fanuc; write G33 with K', code)
        if not mover.follows:
            raise self.fault(
                'the spindle has no encoder; name the input spindle_angle in the machine file',
                code,
            )
        mover.end_corner()
        self.splines.stop_here()
        if code == codes.THREAD_CYCLE:
            cut_thread(mover, words)
            mover.motion = None
            return
        pitch = words.values.pop(letter, 0.0) * mover.unit
        if not pitch > 0.0:
            raise self.fault(f'needs {letter}, the way per turn', code)
        target = mover.frames.point(mover.target(words)[:3])
        if code == 'G32' and (way := np.abs(target - mover.point)).any():
            pitch *= float(np.linalg.norm(way)) / way.max()  # F counts along the longest axis
        mover.in_step(code, target, pitch, code == 'G33.1')
        mover.motion = None  # it holds on controls; here each line says it again

    def _probe(self, code: str, words: BlockWords) -> None:
        """Process G38.2 to G38.5 and G31: move from rest to rest, while the probe is watched."""
        mover = self.mover
        if self.targets.start.line and not self.targets.start.passes:
            raise self.fault('the line of the start comes after a probe; start at the top', code)
        point = probing.target_of(code, words, mover, self._signals)
        mover.end_corner()
        self.splines.stop_here()
        ready, _ = acting(self._signals, [probing.CODES[code].word], {}, self.fault)
        self._act(ready)
        mover.go(point, mover.rotary, rapid=False)
        self.splines.stop_here()
        if code.startswith('G38'):
            mover.motion = None
        mover.probed = probing.answer(mover, True)
        if self.waits_at_probes:
            self.probe = Probe(code, self.flow.main_line)
        else:
            self.notice(code, probing.ASSUMED)

    def go_on(self, stands: FloatArray, at: FloatArray | None) -> None:
        self.probe = None
        self._begin_at(stands if at is None else at)
        self.mover.probed = probing.answer(self.mover, at is not None)
        self._begin_at(stands)

    def _begin_at(self, stands: FloatArray) -> None:
        self.mover.begin_targets()
        self.targets = self.mover.targets
        self.stand_at(stands)

    def _dwell(self, words: BlockWords, given: Mapping[str, float]) -> None:
        self.mover.end_corner()
        if {'X', 'Y', 'Z', *self.mover.rotary_letters} & set(words.values):
            raise self.fault('a dwell and a motion in one block; write two lines', 'G4')
        self.splines.stop_here()
        letter = next(iter(given), '')
        seconds = given.get(letter, 0.0)  # X, U, F; S: turns
        if letter == 'S':
            seconds *= MINUTE / max(self.mover.spindle_speed, 1.0)
        self._rest_for('G4', seconds, words.texts.get('P', '') if letter == 'P' else '.')

    def _rest_for(self, code: str, time: float, text: str = '.') -> None:
        seconds = cycles.dwell_of(self.mover, code, time, text)
        self._act(acting(self._signals, ['G4'], {signals.DWELL: seconds}, self.fault)[0])
