"""Settings that need more than one attribute, words of several letters, and assignments."""

import re
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from cnc_interp.core import DEG, FloatArray
from cnc_interp.program.geometry.arcs import PLANES, Corner
from cnc_interp.program.geometry.contact_normal import NORMAL_WORDS, ToolShape
from cnc_interp.program.geometry.target_row import EXTRA_LETTERS
from cnc_interp.program.job import ALL_OFFSETS, MOST_TOOL, SetupChange, Tool
from cnc_interp.program.modal.groups import MODES
from cnc_interp.program.modal.state import FARTHEST
from cnc_interp.program.motion.mover import Mover
from cnc_interp.program.motion.splines import CURVE_WORDS
from cnc_interp.program.motion.tilted_plane import TiltedPlane
from cnc_interp.program.text import codes
from cnc_interp.program.text.dialects import FANUC, LINUXCNC
from cnc_interp.program.text.expressions import ExpressionError, ProgramVariables
from cnc_interp.program.text.words import BlockWords
from cnc_interp.settings.options import Settings

MOST_ANGLE = 3600.0  #: Largest rotation of a work offset [deg].
#: Tolerances that nobody asked for [m].
USUAL = Settings().contour_tolerance, Settings().orientation_tolerance


_SIEMENS_FRAMES = {'TRANS', 'ATRANS', 'ROT', 'AROT'}
_MACHINE_KEYS = {'SUPA', 'G153'}
_KNOWN = sorted(
    _SIEMENS_FRAMES
    | _MACHINE_KEYS
    | codes.TCP_ON
    | codes.TCP_OFF
    | codes.HARMLESS_KEYS
    | MODES['great_circle'].codes.keys()
    | codes.RADIUS_KEYS.keys()
    | {'BSPLINE'}
)


class Modes:
    def __init__(self, mover: Mover, plane: TiltedPlane, variables: ProgramVariables):
        self._mover, self.fault, self.notice = mover, mover.fault, mover.notice
        self._plane, self._variables = plane, variables

    def tool_length(self, code: str, words: BlockWords, tool: int) -> None:
        mover, frames = self._mover, self._mover.frames
        named = words.values.pop('H', None)
        number = tool if named is None else round(min(abs(named), 1e6))
        tools = mover.setup.tools
        if mover.tcp in codes.TCP_BY_LENGTH and code not in codes.TCP_ON:
            mover.switch_tcp('')
        length = frames.length if code in codes.TCP_ON and named is None else 0.0
        if code == 'G43.1':
            length = words.values.pop('Z', 0.0) * mover.unit
        elif code in ('G43', 'G44') or (code in codes.TCP_ON and named is not None):
            if not tools:
                self.notice(code, 'no tool lengths are set (--setup); taken as zero')
            elif number and number not in tools:
                raise self.fault('the setup has no length of this tool; add it', f'H{number}')
            if number in tools:
                mover.used.add(f'tool {number}')
                length = tools[number].length * (-1.0 if code == 'G44' else 1.0)
        # The axes do not move. The same position now has other program coordinates.
        frames.length = length
        if code in codes.TCP_ON:
            self.switch_tcp(code)
        if mover.tcp:
            mover.check_length(code)
        mover.aim()

    def cutter_radius(self, code: str, words: BlockWords, tool: int) -> None:
        mover = self._mover
        if code == 'G40':
            if not mover.radius_code:
                self.notice(code, 'nothing to switch off')
            mover.end_radius()
            return
        if mover.radius_code:
            raise self.fault(f'{mover.radius_code} is on; write G40 before', code)
        if code in ('G41.2', 'G42.2') or (mover.along_normals and code in ('G41', 'G42')):
            self._contact_normals(code, words, tool)
            return
        named = words.values.get('D')
        if code in ('G41.1', 'G42.1'):
            words.values.pop('D', None)
            if named is None:
                raise self.fault('give the diameter of the cutter as D', code)
            radius = 0.5 * named * mover.unit
        else:
            radius = self.cutter(words, tool).radius
        if not 0.0 <= abs(radius) < FARTHEST:
            raise self.fault('a radius beyond 100,000 mm; correct it', words.texts.get('D', code))
        mover.begin_radius(code, radius if code.startswith('G41') else -radius)

    def cutter(self, words: BlockWords, tool: int) -> Tool:
        named = words.values.pop('D', None)
        number = tool if named is None else round(min(abs(named), 1e6))
        tools = self._mover.setup.tools
        if number and number not in tools:
            why = 'the setup has no radius of this tool; add it (--setup)'
            raise self.fault(why, f'D{number}')
        self._mover.used.add(f'tool {number}')
        return tools[number] if number else Tool()

    def _contact_normals(self, code: str, words: BlockWords, tool: int) -> None:
        """Process G41.2, G42.2: D, R of the tool; Q, P of the one whose tips X Y Z are."""
        mover, values, chosen = self._mover, words.values, self.cutter(words, tool)
        corner = chosen.corner_radius
        if 'R' in values:
            corner = values.pop('R') * mover.unit
        if corner is None:
            raise self.fault(
                'the corner radius of the tool is not known; write R (0: flat end, '
                'the radius: ball), or corner_radius in the setup',
                code,
            )
        cutter = ToolShape(chosen.radius, corner)
        self._demand_corner(cutter, words.texts.get('R', code))
        if ('Q' in values) != ('P' in values):
            raise self.fault(
                'Q is the radius and P the corner radius of the tool of the program; write both',
                code,
            )
        if 'Q' in values:
            posted = ToolShape(values.pop('Q') * mover.unit, values.pop('P') * mover.unit)
            self._demand_corner(posted, words.texts['P'])
            cutter = cutter.beyond(posted)
        mover.begin_contact(code, cutter)

    def _demand_corner(self, cutter: ToolShape, word: str) -> None:
        if not 0.0 <= cutter.corner_radius <= cutter.radius < FARTHEST:
            radius = cutter.radius / self._mover.unit
            raise self.fault(f'the corner radius must be from 0 to the radius, {radius:g}', word)

    def stay_beside_contour(self, words: BlockWords) -> None:
        mover = self._mover
        named = {*words.g, *words.m, *(key for key, _ in words.keys)}
        if other := sorted(named & codes.NOT_BESIDE_CONTOUR):
            raise self.fault(f'{mover.radius_code} is on; write G40 before', other[0])
        if mover.plane != mover.radius_plane:
            raise self.fault(
                f'another plane while {mover.radius_code} is on; write G40 before', mover.plane
            )

    def switch_tcp(self, word: str) -> None:
        if not self._mover.rotary_letters:
            raise self.fault('tool-tip programming needs a machine with rotary axes', word)
        self._mover.switch_tcp(word)

    def choose_work_offset(self, code: str) -> None:
        """Select G54 to G59.3. The first one may be unknown; it is then the workpiece zero."""
        frames = self._mover.frames
        known = code in self._mover.setup.work_offsets
        if not known and frames.named not in ('', code):
            how = f'set where {code} lies in a setup file (--setup)'
            raise self.fault(f'the program began with {frames.named}; {how}', code)
        if not known:
            self.notice(code, 'taken as the workpiece zero')
        frames.named, before = code, self._mover.here()
        self._mover.change(SetupChange('active', code))
        self._shift(before)

    def choose_extended_offset(self, code: str, words: BlockWords) -> None:
        number = words.values.pop('P', 0.0)
        if f'G54.1 P{number:g}' not in ALL_OFFSETS:
            raise self.fault('P must be the number of the offset, 1 to 300', code)
        self.choose_work_offset(f'G54.1 P{number:g}')

    def _shift(self, before: FloatArray) -> None:
        """Keep the change of the program coordinates, where incremental words run through it."""
        if self._mover.dialect.runs_shifts and not self._mover.targets.empty:
            self._mover.shifted += before - self._mover.here()

    def path_tolerance(self, words: BlockWords) -> None:
        tolerance = words.values.pop('P', None)
        q = words.values.pop('Q', None)  # ignored: the compressor stays within P in any case
        if q is not None and (tolerance is None or not q >= 0.0):
            raise self.fault('write G64 P Q: P is the tolerance, Q not below 0', words.texts['Q'])
        tolerance = tolerance or None  # P0 is no tolerance of its own, as in LinuxCNC
        if tolerance is not None and not 0.0 < tolerance * self._mover.unit < FARTHEST:
            raise self.fault('the tolerance must be greater than zero', words.texts['P'])
        self.tolerances('G64 P', tolerance, tolerance)

    def tolerances(self, word: str, contour: float | None, orientation: float | None) -> None:
        """Set tolerances in program units; None restores the value of the settings."""
        mover, settings = self._mover, self._mover.settings
        if settings.force_tolerances:
            if contour is not None or orientation is not None:
                self.notice(word, "ignored, the command's tolerances are forced")
            return
        wanted = settings.contour_tolerance, settings.orientation_tolerance
        if wanted != USUAL and (contour or orientation):
            self.notice(
                word,
                "the program's tolerance counts, not the one that was asked for; "
                'to change this: --force-tolerances',
            )
        mover.contour = settings.contour_tolerance if contour is None else contour * mover.unit
        mover.orientation = (
            settings.orientation_tolerance if orientation is None else orientation * mover.unit
        )

    def turn_frame(self, key: str, words: BlockWords) -> None:
        mover = self._mover
        frames, before = mover.frames, mover.here()
        if not key.startswith('A'):
            frames.reset_frame()
        taken = {letter: words.values.pop(letter, 0.0) for letter in 'XYZ'}
        if key.endswith('TRANS'):
            frames.move(np.array([taken[letter] * mover.unit for letter in 'XYZ']))
        else:
            if 'RPL' in dict(words.sets):
                taken['XYZ'[PLANES[mover.plane][2]]] = dict(words.sets)['RPL']
            frames.rotate({letter: angle * DEG for letter, angle in taken.items() if angle})
        frames.update()
        if key.endswith('TRANS'):
            self._shift(before)

    def axis_code(self, code: str, words: BlockWords) -> None:
        mover, values = self._mover, words.values
        frames = mover.frames
        if code == 'G10':
            self._write_setup(words)
        elif code in ('G28', 'G30'):
            self._reference(code, words)
        elif code in ('G28.1', 'G30.1'):
            machine = np.concatenate([mover.point + mover.zero, mover.rotary])
            place = dict(zip(frames.letters, machine.tolist(), strict=False))
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
            amounts_by_letter = dict(zip(frames.letters, amounts.tolist(), strict=False))
            mover.change(SetupChange('g92', amounts_by_letter))
            mover.change(SetupChange('g92_on', True))
        else:
            if code == 'G92.1':
                mover.change(SetupChange('g92', {}))
            mover.change(SetupChange('g92_on', code == 'G92.3'))

    def _offset_words(self, values: dict[str, float]) -> dict[int, float]:
        found = {}
        for i, letter in enumerate(self._mover.frames.letters):
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
            raise self.fault(
                'only L2 and L20 with P0 to P9, and L1, L10 and L11 are supported', 'G10'
            )
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
        """Process G10 L1 (length of a tool), L10, L11 (what Z reads with it here, or in G59.3)."""
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
        mover = self._mover
        word, letters = mover.machine_words(words), mover.frames.letters
        named = [letter for letter in letters if letter in words.values]
        beside = [letter for letter in mover.extra_letters if letter in words.values]
        mover.extra = mover.extra_target(words, machine=False)
        if named or beside:
            mover.go_to(mover.target(words), rapid=True)
        point, rotary = mover.point.copy(), mover.rotary.copy()
        mover.extra = np.where([letter in beside for letter in EXTRA_LETTERS], 0.0, mover.extra)
        for letter in named or ([] if beside else letters):
            home = mover.setup.reference_points.get(code, {}).get(letter, 0.0)
            if letter in 'XYZ':
                i = 'XYZ'.index(letter)
                point[i] = home - mover.zero[i]
            else:
                rotary[mover.rotary_letters.index(letter)] = home
                mover.named = 1.0
        mover.go(point, rotary, rapid=True)
        if word:
            mover.switch_tcp(word)

    def key_word(self, key: str, given: tuple[float | None, ...], words: BlockWords) -> None:
        mover = self._mover
        if key in MODES['great_circle'].codes:
            if mover.settings.interpolation == 'auto' and mover.rotary_letters:
                mover.great_circle = MODES['great_circle'].codes[key]
            else:
                self.notice(key, 'ignored, the interpolation is fixed')
        elif key in codes.TCP_ON:
            self.switch_tcp(key)
        elif key in codes.TCP_OFF:
            mover.switch_tcp('')
        elif key in _SIEMENS_FRAMES:
            self.turn_frame(key, words)
        elif key in _MACHINE_KEYS:
            words.g.append('G53')
        elif key == 'CYCLE832':
            # High-speed settings: a tolerance, and smoothing instead of exact stops.
            tolerance = given[0] if given and given[0] else None
            if tolerance is not None and not 0.0 < tolerance * mover.unit < FARTHEST:
                raise self.fault('the tolerance must be greater than zero', key)
            self.tolerances(key, tolerance, tolerance)
            mover.stop_always = mover.stop_always and tolerance is None
        elif key == 'CYCLE800' and any(given):
            self._plane.swivel(given, words)
        elif key == 'CYCLE800':
            self._plane.cancel()
        elif key in codes.RADIUS_KEYS:
            mover.along_normals = codes.RADIUS_KEYS[key]
        elif key == 'BSPLINE':
            pass  # the curve is opened after the settings of the block
        elif key in codes.HARMLESS_KEYS:
            self.notice(key, 'no effect, it does not move the tool')
        else:
            unknown = 'unknown word; remove it, or write a letter and a number as X10'
            if near := get_close_matches(key, _KNOWN, 1, 0.8):
                unknown = f'unknown word; is it {near[0]}? It may move the tool'
            if re.fullmatch(r'[A-Z]O+', key):
                zero = key.replace('O', '0')
                unknown = f'the letter O stands where a number must; write {zero} with the digit 0'
            raise self.fault(codes.refused_key(key) or unknown, key)

    def assign(self, words: BlockWords) -> None:
        mover = self._mover
        others = bool(words.values or words.g or words.m or words.keys)
        for name, value in words.sets:
            if name in ('A3', 'B3', 'C3', 'RPL', 'ANG', *CURVE_WORDS, *NORMAL_WORDS):
                continue
            if name == 'CR':
                words.values['R'], words.texts['R'] = value, f'CR={value:g}'
            elif name == 'TURN':
                words.values['P'], words.texts['P'] = value + 1.0, f'TURN={value:g}'
            elif name in ('RND', 'RNDM', 'CHR', 'CHF') and not self._variables.exists(str(name)):
                modal = name == 'RNDM'
                mover.corner = Corner('RND' if modal else str(name), value * mover.unit, modal)
            elif name in ('CTOL', 'OTOL'):
                if not 0.0 < value * mover.unit < FARTHEST:
                    raise self.fault('the tolerance must be greater than zero', str(name))
                if mover.settings.force_tolerances:
                    self.notice(str(name), "ignored, the command's tolerances are forced")
                elif name == 'CTOL':
                    mover.contour = value * mover.unit
                else:  # OTOL is an angle; convert it to the deviation at flank height
                    mover.orientation = min(value, 90.0) * DEG * mover.settings.flank_height
            elif isinstance(name, int):
                try:
                    self._variables.set_number(name, value)
                except ExpressionError as problem:
                    raise self.fault(str(problem), f'#{name}') from None
            else:
                self._set_name(name, value, others)

    def _set_name(self, name: str, value: float, others: bool) -> None:
        if not self._variables.exists(name) and not name.startswith('<'):
            if why := codes.REFUSED_NAMES.get(name):
                raise self.fault(why, name)
            if name in codes.HARMLESS_NAMES or re.fullmatch(r'[SM]\d', name):
                self.notice(name, 'no effect, it does not move the tool')
                return
            if re.fullmatch(r'[A-QS-Z]\d+', name):
                raise self.fault(codes.NO_SUCH_AXIS, name)
            if others and not re.fullmatch(r'R\d+', name):
                raise self.fault(codes.UNKNOWN_NAME, name)
        self._variables.set_name(name, value)
