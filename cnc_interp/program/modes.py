"""Settings that need more than one attribute: tool length, TCP, zeros, frames, tolerances."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import DEG
from cnc_interp.program import codes
from cnc_interp.program.arcs import PLANES
from cnc_interp.program.contact_normal import ToolShape
from cnc_interp.program.job import ALL_OFFSETS, SetupChange, Tool
from cnc_interp.program.modal_state import FARTHEST
from cnc_interp.program.motion import Mover
from cnc_interp.program.words import BlockWords
from cnc_interp.settings.options import Settings

#: Tolerances that nobody asked for [m].
USUAL = Settings().contour_tolerance, Settings().orientation_tolerance


class Modes:
    def __init__(self, mover: Mover):
        self._mover, self.fault, self.notice = mover, mover.fault, mover.notice

    def tool_length(self, code: str, words: BlockWords, tool: int) -> None:
        """Process G43, G44, G43.1, G49, and the tool-tip modes that are a kind of tool length."""
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
        """Process G40, G41, G42; as G41.2, or after CUT3DF, they follow contact normals."""
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
            radius = self._cutter(words, tool).radius
        if not 0.0 <= abs(radius) < FARTHEST:
            raise self.fault('a radius beyond 100,000 mm; correct it', words.texts.get('D', code))
        mover.begin_radius(code, radius if code.startswith('G41') else -radius)

    def _cutter(self, words: BlockWords, tool: int) -> Tool:
        """Take D out of a block, and return the tool that it names, else that in the spindle."""
        named = words.values.pop('D', None)
        number = tool if named is None else round(min(abs(named), 1e6))
        tools = self._mover.setup.tools
        if number and number not in tools:
            why = 'the setup has no radius of this tool; add it (--setup)'
            raise self.fault(why, f'D{number}')
        self._mover.used.add(f'tool {number}')
        return tools[number] if number else Tool()

    def _contact_normals(self, code: str, words: BlockWords, tool: int) -> None:
        """Process G41.2 and G42.2: D is the tool, R its corner radius.

        With Q and P, X Y Z are tips of a tool with this radius and corner radius.
        """
        mover, values, chosen = self._mover, words.values, self._cutter(words, tool)
        corner = chosen.corner_radius
        if 'R' in values:
            corner = values.pop('R') * mover.unit
        if corner is None:
            raise self.fault('the corner radius of the tool is not known; write R (0: flat end, '
                             'the radius: ball), or corner_radius in the setup', code)  # fmt: skip
        cutter = ToolShape(chosen.radius, corner)
        self._demand_corner(cutter, words.texts.get('R', code))
        if ('Q' in values) != ('P' in values):
            raise self.fault('Q is the radius and P the corner radius of the tool of the program; '
                             'write both', code)  # fmt: skip
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
            raise self.fault(f'another plane while {mover.radius_code} is on; write G40 before',
                             mover.plane)  # fmt: skip

    def switch_tcp(self, word: str) -> None:
        if not self._mover.rotary_letters:
            raise self.fault('tool-tip programming needs a machine with rotary axes', word)
        self._mover.switch_tcp(word)

    def choose_work_offset(self, code: str) -> None:
        """Select G54 to G59.3. The first one may be unknown; it is then the workpiece zero."""
        frames = self._mover.frames
        if not frames.known(code) and frames.named not in ('', code):
            raise self.fault(
                f'the program began with {frames.named}; set where {code} lies in a setup '
                'file (--setup)',
                code,
            )
        if not frames.known(code):
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
            self.notice(word, "the program's tolerance counts, not the one that was asked for; "
                        'to change this: --force-tolerances')  # fmt: skip
        mover.contour = settings.contour_tolerance if contour is None else contour * mover.unit
        mover.orientation = (
            settings.orientation_tolerance if orientation is None else orientation * mover.unit
        )

    def turn_frame(self, key: str, words: BlockWords) -> None:
        """Process TRANS, ATRANS, ROT and AROT: shift or rotate the program coordinates."""
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
