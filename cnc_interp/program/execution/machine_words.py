"""Words for the machine: tools, spindle, outputs, program stops, and the saved modal state."""

import numpy as np

from cnc_interp.core import MM, DependsOn
from cnc_interp.machine_model import signals
from cnc_interp.program.blocks.functions import Acting, acting
from cnc_interp.program.execution.context import Execution, State
from cnc_interp.program.execution.setup_words import choose_offset
from cnc_interp.program.geometry.target_row import AT_M0, AT_M1
from cnc_interp.program.job import SetupChange
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import LINUXCNC
from cnc_interp.program.text.words import BlockWords


def choose_tool(at: Execution, words: BlockWords) -> None:
    """Select the tool given by T, or by Q with M61; M6 and M61 also change to it."""
    values = words.values
    changes = 'M6' in words.m or 'M61' in words.m
    at.refuse_if('M61' in words.m and 'Q' not in values, 'give the number of the tool as Q', 'M61')
    tool = values.pop('Q') if 'M61' in words.m else values.get('T')
    if tool is not None:
        at.chosen_tool = round(min(abs(tool), 1e6))
    if changes or not at.tool:
        at.tool = at.chosen_tool
    if changes:
        at.has_tool = at.tool == at.mover.setup.tool
        at.mover.change(SetupChange('tool', at.tool))
    if words.second_tool is not None:
        at.demand(changes, 'T is written twice in one block; keep one of them', 'T')
        at.chosen_tool = round(min(abs(words.second_tool), 1e6))


def set_speed(at: Execution, words: BlockWords) -> None:
    """Process S; with G96, S is a surface speed, and D limits the spindle speed."""
    mover, speed, by_surface = at.mover, words.values.get('S'), at.by_surface
    if 'G96' in words.g and by_surface:
        mover.surface_limit = abs(words.values.pop('D', 0.0))
        if speed is None:
            raise at.fault('write S, the surface speed, in the same block', 'G96')
        at.refuse_if(
            mover.tcp or (mover.rotary_letters and mover.rotary.any()),
            'the rotary axes must be at 0, without tool-tip programming',
            'G96',
        )
    if by_surface and speed is not None:
        mover.surface_speed = speed * (1.0 if mover.unit == MM else 0.3048)
    elif speed is not None:
        mover.spindle_speed = speed
    elif at.states[1] and not by_surface:
        raise at.fault('needs S, the speed in rev/min', 'G97')


def _surface(at: Execution) -> tuple[float, float]:
    """Return the X axis position at program X 0 [mm], and the largest speed [rev/min]."""
    mover = at.mover
    return float((mover.frames.point(np.zeros(3)) + mover.zero)[0] / MM), mover.surface_limit


def functions_of(at: Execution, words: BlockWords) -> tuple[list[Acting], list[Acting]]:
    values, mover = words.values, at.mover
    found = [letter for letter in 'ST' if letter in values]
    of_feed = 'G95' if mover.feed_mode == 'G95' else 'G94'
    states = of_feed, (*_surface(at), mover.surface_speed) * at.by_surface
    if states[0] != at.states[0]:
        found.insert(0, of_feed)
    if states[1] != at.states[1]:
        found.insert(0, 'G96' if states[1] else 'G97')
    if states[1] and 'S' in found:
        found.remove('S')
    at.states = states
    found = [word for word in found if word in at.signals.words]
    if at.has_tool and at.signals.changed_by_hand:
        words.m[:] = [code for code in words.m if code != 'M6']
    found += sorted(words.m, key=lambda code: codes.FIRST_M.get(code, len(codes.FIRST_M)))
    if not found:
        return [], []
    tool = at.tool if 'M6' in words.m else at.chosen_tool
    given = {'R': 0.0} if 'M19' in words.m else {}  # angle at which the spindle stops
    given |= {**values, 'S': mover.spindle_speed, 'T': float(tool)}
    given |= zip(signals.SURFACE, states[1], strict=False)
    if {'M50', 'M51'} & set(words.m):
        given[signals.FIXED] = float(values.pop('P', 1.0) == 0.0)
    moments = acting(at.signals, found, given, at.fault)
    words.take(at.signals.letters(found) & {'P', 'Q', 'R'})
    if 'M19' in words.m and 'G64' not in words.g:
        words.take('RPQ')
    return moments


def refuse_function(at: Execution, code: str, _: BlockWords) -> None:
    raise at.fault(codes.REFUSED_M[code], code, DependsOn.LINE)


def machine_function(at: Execution, code: str, _: BlockWords) -> None:
    at.outputs |= codes.OUTPUTS.get(code, {})
    if code in at.signals.words:
        return
    if code in codes.NO_OUTPUT:
        at.notice(code, codes.NO_OUTPUT[code])
    else:
        at.notice(code, 'no effect, it does not move the tool')


def numbered_function(at: Execution, code: str, words: BlockWords) -> None:
    """Process M62 to M68, which name an output or an input of the machine by its number."""
    if not words.values.keys() & {'P', 'E'} and at.mover.dialect is not LINUXCNC:
        machine_function(at, code, words)  # another control's own meaning of it
        return
    word = signals.numbered_word(code, words.values)
    if not word:
        raise at.fault(codes.NO_SUCH_NUMBER[code == 'M66'], code)
    if word in at.signals.words:
        words.take('PEL')
        words.m[words.m.index(code)] = word
    else:
        words.take('PELQ')
        at.notice(code, codes.NO_NUMBER.format(word))


def save_or_restore(at: Execution, code: str, _: BlockWords) -> None:
    """Process M70 to M73, which save, discard or restore the state; M73 restores at return."""
    flow, mover = at.flow, at.mover
    if code == 'M72':
        if flow.saved_state is None:
            raise at.fault('no state is saved here; write M70 first', code)
        restore(at, flow.saved_state)
        return
    state = (mover.saved_values(), dict(at.outputs))
    flow.save(None if code == 'M71' else state, restores=code == 'M73')


def restore(at: Execution, state: State) -> None:
    values, outputs = state
    before, speed = at.outputs, at.mover.spindle_speed
    outputs = before if outputs is None else outputs  # after the subprogram of M6
    at.outputs = dict(outputs)
    if str(values['offset']) != at.mover.setup.offset:
        choose_offset(at, str(values['offset']))
    at.mover.restore_values(values)
    words = ['S'] if at.mover.spindle_speed != speed else []
    spindle, turned = (told.get('spindle', 'M5') for told in (outputs, before))
    words += [spindle] if spindle != turned else []
    on, was = ({'M7', 'M8'} & {*told.values()} for told in (outputs, before))
    words += (['M9'] if was - on else []) + sorted(on if was - on else on - was)
    for word in words:
        if word in at.signals.words:
            given = {'S': at.mover.spindle_speed}
            for steps in acting(at.signals, [word], given, at.fault):
                at.act(steps)


def program_stop(at: Execution, code: str) -> None:
    at.mover.end_corner()
    at.targets.program_stop()
    if at.targets.stands and not at.splines.open:
        waits = code != 'M1'
        at.targets.waits_first |= waits
        at.notice(f'{code} at the start', codes.WAITS_FIRST if waits else codes.NOT_YET)
    else:
        at.notice(code, codes.STOP_M[code])
        at.splines.stop_here(AT_M1 if code == 'M1' else AT_M0)
