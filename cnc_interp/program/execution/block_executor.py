"""Execute the words of a block, phase by phase, in the order in which a control acts on them."""

import re
from difflib import get_close_matches

from cnc_interp.core import DependsOn, ProgramError
from cnc_interp.machine_model.machine_entries import TOOL_CHANGE
from cnc_interp.program.execution.assignments import assign
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.dialect_words import (
    KEYS,
    NOT_BESIDE_CONTOUR,
    OTHER_G,
    OTHER_M,
    G,
    M,
    Phase,
)
from cnc_interp.program.execution.machine_words import (
    choose_tool,
    functions_of,
    program_stop,
    set_speed,
)
from cnc_interp.program.execution.motion_words import move, siemens_cycles
from cnc_interp.program.execution.setting_words import path_tolerance, refuse_lathe
from cnc_interp.program.execution.setup_words import tool_length
from cnc_interp.program.job import SetupChange
from cnc_interp.program.motion import probing
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import FANUC, LINUXCNC, PLAIN
from cnc_interp.program.text.flow import Call
from cnc_interp.program.text.words import BlockWords


def execute(at: Execution, words: BlockWords) -> None:
    if 'M6' in words.m and at.tool_change_macro and not at.flow.in_macro:
        _change_by_macro(at, words)
        return
    values, mover = words.values, at.mover
    words.take('NO')
    words.g += probing.measuring(words)
    if mover.dialect is LINUXCNC and 'G76' in words.g:
        words.g[words.g.index('G76')] = codes.THREAD_CYCLE
    drilling = siemens_cycles(at, words)
    for key, _ in words.keys:
        if key not in KEYS:
            raise _unknown(at, key)
        KEYS[key].act(at, key, words)
    assign(at, words)
    choose_tool(at, words)
    dwell = 'PXFSU' if 'G4' in words.g else ''
    at.times = {letter: values.pop(letter) for letter in dwell if letter in values}
    unit = mover.unit
    _set_modes(at, words)
    set_speed(at, words)
    for code in words.m:
        M.get(code, OTHER_M).act(at, code, words)
    before, after = functions_of(at, words)
    at.act(before)
    feeds = not any(G[code].takes_f for code in words.g)
    f = values.pop('F', None) if feeds else None
    if f is not None:
        mover.set_feed(f, words.texts['F'], unit if mover.dialect.feeds_first else mover.unit)
    mover.targets.state = at.state()
    if mover.radius_code:
        _stay_beside_contour(at, words)
    taking = [code for code in words.g if G[code].phase is Phase.AXES]
    if len(taking) > 1:
        raise at.fault(f'{taking[0]} is in the same block; keep one of them', taking[1])
    if mover.polar and taking and not G[taking[0]].in_polar:
        raise at.fault('polar coordinates are on; write G15 first', taking[0])
    calling = at.flow.call_of(words)
    if 'G4' not in taking:
        at.plane.refuse_gaps(taking)
    if taking:
        G[taking[0]].act(at, taking[0], words)
    if any(key == 'BSPLINE' for key, _ in words.keys):
        at.cycle = None
        at.splines.begin()
    moves = at.called is not None and not set('XYZ').isdisjoint(values)
    move(at, words, f is not None)
    for cycle in drilling or ([at.called] if moves and at.called else []):
        cycle.make()
    at.act(after)
    mover.stop_once = False
    _end_block(at, words, calling)


def _change_by_macro(at: Execution, words: BlockWords) -> None:
    """Select the tool and call the subprogram of M6; the other words are executed after it."""
    words.m.remove('M6')
    selects = BlockWords()
    if 'T' in words.values:
        selects.put('T', words.values.pop('T'), words.texts.pop('T'))
        execute(at, selects)
    if words.second_tool is not None:
        words.put('T', words.second_tool)
        words.second_tool = None
    setup = at.mover.setup
    for variable, name in codes.PLACES_OF_MACRO.items():
        known = name in {**setup.reference_points, **setup.work_offsets}
        at.demand(known or variable not in at.tool_change_macro, codes.NO_PLACE.format(name), 'M6')
    state = at.mover.saved_values(), None
    at.flow.call_macro(at.tool_change_macro, TOOL_CHANGE, words, state)


def _unknown(at: Execution, key: str) -> ProgramError:
    unknown = 'unknown word; remove it, or write a letter and a number, such as X10'
    if near := get_close_matches(key, sorted(KEYS), 1, 0.8):
        unknown = f'unknown word; is it {near[0]}? It may move the tool'
    if re.fullmatch(r'[A-Z]O+', key):
        zero = key.replace('O', '0')
        unknown = f'the letter O where a digit is expected; write {zero} with the digit 0'
    return at.fault(codes.refused_key(key) or unknown, key, DependsOn.LINE)


def _set_modes(at: Execution, words: BlockWords) -> None:
    mover, at.set_here = at.mover, {}
    was = mover.feed_mode
    for code in words.g:
        if code in codes.TURNING:
            refuse_lathe(at, code, words)
        word = G.get(code, OTHER_G)
        if word.phase is Phase.SET:
            word.act(at, code, words)
    if (
        mover.dialect in (FANUC, PLAIN)
        and 'H' in words.values
        and mover.frames.length
        and not (codes.LENGTH_CODES | {'G65'}) & set(words.g)
    ):
        tool_length(at, mover.tcp if mover.tcp in codes.TCP_BY_LENGTH else 'G43', words)
    if 'G64' in words.g:
        path_tolerance(at, words)
    if was != mover.feed_mode:
        # F in mm/min must not be used as 1/min, or the reverse.
        mover.feedrate, mover.blocks_per_minute = at.settings.feedrate, None
        mover.feed_changed = True


def _stay_beside_contour(at: Execution, words: BlockWords) -> None:
    mover = at.mover
    named = {*words.g, *words.m, *(key for key, _ in words.keys)}
    if other := sorted(named & NOT_BESIDE_CONTOUR):
        raise at.fault(f'{mover.radius_code} is on; write G40 first', other[0])
    at.demand(
        mover.plane == mover.radius_plane,
        f'another plane while {mover.radius_code} is on; write G40 first',
        mover.plane,
    )


def _end_block(at: Execution, words: BlockWords, calling: Call | None) -> None:
    for code in words.m:
        if code in codes.STOP_M:
            program_stop(at, code)
    if not codes.END_M.isdisjoint(words.m):
        at.mover.change(SetupChange('active', ''))  # all other offsets are kept
        at.flow.ended = at.finished = True
    elif calling:
        at.flow.call_number(*calling)
    elif (returns := codes.RETURN_M & set(words.m)) and at.flow.depth:
        at.flow.leave()
    elif returns:
        at.notice(min(returns), 'it ends the program, because no subprogram was called')
        at.flow.ended = True
