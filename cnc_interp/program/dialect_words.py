"""Words of several letters and assignments of a block: names with a meaning, and variables."""

from __future__ import annotations

import re
from difflib import get_close_matches

from cnc_interp.core.units import DEG
from cnc_interp.program import codes
from cnc_interp.program.arcs import Corner
from cnc_interp.program.contact_normal import NORMAL_WORDS
from cnc_interp.program.expressions import ExpressionError, ProgramVariables
from cnc_interp.program.modal_state import FARTHEST
from cnc_interp.program.modes import Modes
from cnc_interp.program.motion import Mover
from cnc_interp.program.splines import CURVE_WORDS
from cnc_interp.program.tilted_plane import TiltedPlane
from cnc_interp.program.words import BlockWords

_SIEMENS_FRAMES = {'TRANS', 'ATRANS', 'ROT', 'AROT'}
_MACHINE_KEYS = {'SUPA', 'G153'}
_KNOWN = sorted(
    _SIEMENS_FRAMES | _MACHINE_KEYS | codes.TCP_ON | codes.TCP_OFF | codes.HARMLESS_KEYS
    | codes.INTERPOLATION_KEYS.keys() | codes.RADIUS_KEYS.keys() | {'BSPLINE'}
)  # fmt: skip


class NamedWords:
    def __init__(
        self, mover: Mover, modes: Modes, plane: TiltedPlane, variables: ProgramVariables
    ):
        self._mover, self.fault, self.notice = mover, mover.fault, mover.notice
        self._modes, self._plane, self._variables = modes, plane, variables

    def execute(self, words: BlockWords) -> None:
        for key, given in words.keys:
            self._key_word(key, given, words)
        self._assign(words)

    def _key_word(self, key: str, given: tuple[float | None, ...], words: BlockWords) -> None:
        mover = self._mover
        if key in codes.INTERPOLATION_KEYS:
            if mover.settings.interpolation == 'auto' and mover.rotary_letters:
                mover.great_circle = codes.INTERPOLATION_KEYS[key]
            else:
                self.notice(key, 'ignored, the interpolation is fixed')
        elif key in codes.TCP_ON:
            self._modes.switch_tcp(key)
        elif key in codes.TCP_OFF:
            mover.switch_tcp('')
        elif key in _SIEMENS_FRAMES:
            self._modes.turn_frame(key, words)
        elif key in _MACHINE_KEYS:
            words.g.append('G53')
        elif key == 'CYCLE832':
            # High-speed settings: a tolerance, and smoothing instead of exact stops.
            tolerance = given[0] if given and given[0] else None
            if tolerance is not None and not 0.0 < tolerance * mover.unit < FARTHEST:
                raise self.fault('the tolerance must be greater than zero', key)
            self._modes.tolerances(key, tolerance, tolerance)
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

    def _assign(self, words: BlockWords) -> None:
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
