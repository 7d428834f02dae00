"""Assignments of a block: words with an equals sign, parameters and variables."""

import re

from cnc_interp.core import DEG, DependsOn
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.geometry.arcs import Corner
from cnc_interp.program.geometry.contact_normal import NORMAL_WORDS
from cnc_interp.program.modal.state import FARTHEST
from cnc_interp.program.motion.splines import CURVE_WORDS
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import FANUC
from cnc_interp.program.text.expressions import ExpressionError
from cnc_interp.program.text.words import BlockWords

#: Variables that a macro sets to raise an alarm with a text, or to stop.
ALARM, STOP = 3000, 3006
IDLE = {
    3001,
    3002,
    3003,
    3004,
    3005,
    3007,
    3008,
}  #: Timers and switches; setting them moves nothing.
_TEXT = re.compile(r'3000\s*=[^(]*\(([^()]*)\)')


def assign(at: Execution, words: BlockWords) -> None:
    mover = at.mover
    others = bool(words.values or words.g or words.m or words.keys)
    for name, value in words.sets:
        if name in ('A3', 'B3', 'C3', 'RPL', 'ANG', *CURVE_WORDS, *NORMAL_WORDS):
            continue
        if name in mover.extra_letters:
            words.put(str(name), value, f'{name}={value:g}')
        elif name == 'CR':
            words.put('R', value, f'CR={value:g}')
        elif name == 'TURN':
            words.put('P', value + 1.0, f'TURN={value:g}')
        elif name in ('RND', 'RNDM', 'CHR', 'CHF') and not at.variables.exists(str(name)):
            modal = name == 'RNDM'
            mover.corner = Corner('RND' if modal else str(name), value * mover.unit, modal)
        elif name in ('CTOL', 'OTOL'):
            at.demand(
                0.0 < value * mover.unit < FARTHEST,
                'the tolerance must be greater than zero',
                str(name),
            )
            if mover.settings.force_tolerances:
                at.notice(str(name), "ignored, the command's tolerances are forced")
            elif name == 'CTOL':
                mover.contour = value * mover.unit
            else:  # OTOL is an angle; convert it to the deviation at flank height
                mover.orientation = min(value, 90.0) * DEG * mover.settings.flank_height
        elif isinstance(name, int):
            if _set_by_macro(at, name, value, words):
                continue
            try:
                at.variables.set_number(name, value)
            except ExpressionError as problem:
                raise at.fault(str(problem), f'#{name}') from None
        else:
            _set_name(at, name, value, others)


def _set_name(at: Execution, name: str, value: float, others: bool) -> None:
    if not at.variables.exists(name) and not name.startswith('<'):
        if why := codes.REFUSED_NAMES.get(name):
            raise at.fault(why, name, DependsOn.LINE)
        if name in codes.HARMLESS_NAMES or re.fullmatch(r'[SM]\d', name):
            at.notice(name, 'no effect, it does not move the tool')
            return
        at.demand(not re.fullmatch(r'[A-QS-Z]\d+', name), codes.NO_SUCH_AXIS, name, DependsOn.LINE)
        at.refuse_if(others and not re.fullmatch(r'R\d+', name), codes.UNKNOWN_NAME, name)
    at.variables.set_name(name, value)


def _set_by_macro(at: Execution, number: int, value: float, words: BlockWords) -> bool:
    """Execute an assignment to a variable of the control; return False for other variables."""
    if at.mover.dialect is not FANUC or not 1000 <= number < 10_000:
        return False
    if number == ALARM:
        line = at.flow.window.line(at.flow.row)
        said = text[1].strip() if (text := _TEXT.search(line)) else f'{value:g}'
        raise at.fault(f'the program raises this alarm; {said}', f'#{number}')
    if number == STOP:
        words.m.append('M0')
    elif number in IDLE:
        at.notice(f'#{number}', 'no effect, it does not move the tool')
    else:
        raise at.fault(
            'a variable of the control; set tools and offsets with G10, others from #100 on',
            f'#{number}',
        )
    return True
