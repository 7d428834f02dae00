"""Words of offsets and tools: work offsets, tool lengths, G10, G28, G52 and G92."""

from dataclasses import replace

import numpy as np

from cnc_interp.core import DEG, DependsOn, FloatArray
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.job import ALL_OFFSETS, MOST_TOOL, SetupChange, Tool
from cnc_interp.program.modal.state import FARTHEST
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import FANUC, LINUXCNC
from cnc_interp.program.text.words import BlockWords

MOST_ANGLE = 3600.0  #: Largest rotation of a work offset [deg].


def choose_work_offset(at: Execution, code: str, words: BlockWords) -> None:
    at.refuse_if(
        'H' in words.values and not codes.LENGTH_CODES & set(words.g),
        codes.OKUMA_LENGTH,
        code,
        DependsOn.LINE,
    )
    choose_offset(at, code)


def choose_extended_offset(at: Execution, code: str, words: BlockWords) -> None:
    number = words.values.pop('P', 0.0)
    at.demand(
        f'G54.1 P{number:g}' in ALL_OFFSETS, 'P must be the number of the offset, 1 to 300', code
    )
    choose_offset(at, f'G54.1 P{number:g}')


def choose_offset(at: Execution, code: str) -> None:
    """Select G54 to G59.3; if the first one selected is not known, it is the workpiece zero."""
    frames = at.mover.frames
    known = code in at.mover.setup.work_offsets
    if not known and frames.named not in ('', code):
        how = f'set the position of {code} in a setup file (--setup)'
        raise at.fault(f'the program began with {frames.named}; {how}', code)
    if not known:
        at.notice(code, 'taken as the workpiece zero')
    frames.named, before = code, at.mover.here()
    at.mover.change(SetupChange('active', code))
    keep_shift(at, before)


def keep_shift(at: Execution, before: FloatArray) -> None:
    """Store the shift of the coordinates, if incremental words of this dialect include it."""
    if at.mover.dialect.runs_shifts and not at.mover.targets.empty:
        at.mover.shifted += before - at.mover.here()


def tool_length(at: Execution, code: str, words: BlockWords) -> None:
    mover, frames = at.mover, at.mover.frames
    named = words.values.pop('H', None)
    number = at.tool if named is None else round(min(abs(named), 1e6))
    tools = mover.setup.tools
    if mover.tcp in codes.TCP_BY_LENGTH and code not in codes.TCP_ON:
        mover.switch_tcp('')
    keeps = code in codes.TCP_ON and named is None
    length = frames.length if keeps and frames.names_length else 0.0
    if code == 'G43.1':
        length = words.values.pop('Z', 0.0) * mover.unit
    elif code in ('G43', 'G44') or (code in codes.TCP_ON and named is not None):
        if number and number not in tools:
            at.refuse_if(at.is_live or tools, codes.NO_LENGTH, f'H{number}')
            at.notice(code, codes.NO_LENGTHS)
        if number in tools:
            mover.used.add(f'tool {number}')
            length = tools[number].worn.length * (-1.0 if code == 'G44' else 1.0)
    # The axes do not move. The same position now has other program coordinates.
    frames.length, frames.names_length = length, frames.names_length or not keeps
    if code in codes.TCP_ON:
        switch_tcp(at, code, words)
    if mover.tcp:
        mover.check_length(code)
    mover.aim()


def switch_tcp(at: Execution, word: str, _: BlockWords) -> None:
    at.demand(at.mover.turns, 'tool-tip programming needs a machine with rotary axes', word)
    at.mover.demand_no_scale(word)
    at.mover.switch_tcp(word)


def cutter_of(at: Execution, words: BlockWords) -> Tool:
    named = words.values.pop('D', None)
    number = at.tool if named is None else round(min(abs(named), 1e6))
    tools = at.mover.setup.tools
    if number and number not in tools:
        raise at.fault('the setup has no radius of this tool; add it (--setup)', f'D{number}')
    at.mover.used.add(f'tool {number}')
    return tools[number].worn if number else Tool()


def write_setup(at: Execution, _: str, words: BlockWords) -> None:
    """Process G10: L2 and L20 set a work offset, L1, L10 and L11 a tool."""
    kind, index = words.values.pop('L', 0.0), words.values.pop('P', 0.0)
    dialect = at.mover.dialect
    if at.mover.incremental and kind != 20.0 and dialect is not LINUXCNC:
        raise at.fault(codes.G10_CONFLICTS['incremental'], f'G10 L{kind:g}')
    if kind == 2.0 and index == 0.0 and dialect is not LINUXCNC:
        raise at.fault(codes.G10_CONFLICTS['L2 P0'], 'G10 L2 P0')
    if dialect is FANUC and kind in (10.0, 12.0) and 'R' in words.values:
        words.values['Z' if kind == 10.0 else 'R'] = words.values.pop('R')
        kind = 1.0
    if kind in (10.0, 11.0) and 'R' in words.values and 'Z' not in words.values:
        raise at.fault(codes.G10_CONFLICTS['tool R'], f'G10 L{kind:g} R')
    if dialect is LINUXCNC:
        words.take('IJQ')  # of a lathe
    if kind in (1.0, 10.0, 11.0):
        _write_tool(at, int(kind), index, words)
        return
    at.demand(
        kind in (2.0, 20.0) and index in range(10),
        'only L2 and L20 with P0 to P9, and L1, L10 and L11 are supported',
        'G10',
    )
    mover, angle, here = at.mover, words.values.pop('R', None), None
    if angle is not None:
        at.demand(kind != 20.0, 'L20 takes no rotation; write it with L2', words.texts['R'])
        at.demand(
            abs(angle) <= MOST_ANGLE,
            'a rotation of more than ten turns; correct it',
            words.texts['R'],
        )
        angle *= DEG
    if kind == 20.0:
        mover.demand_no_scale('G10 L20')
        here = np.concatenate([mover.point, mover.rotary])
    given = _offset_words(at, words)
    mover.change(mover.frames.work_change(int(index), given, here, angle))


def _write_tool(at: Execution, kind: int, number: float, words: BlockWords) -> None:
    """Set a tool length by G10 L1; L10 and L11 set it so that Z reads the given value here."""
    mover, frames, values = at.mover, at.mover.frames, words.values
    at.demand(
        number in range(1, MOST_TOOL + 1),
        f'G10 L{kind} needs P with a tool number, 1 to {MOST_TOOL}',
        'G10',
    )
    at.refuse_if(
        mover.tcp and kind != 1, 'a tool is measured with tool-tip programming off', f'G10 L{kind}'
    )
    tool = mover.setup.tools.get(int(number), Tool())
    length, radius = tool.length, tool.radius
    if 'R' in values:
        radius = values.pop('R') * mover.unit
        at.demand(0.0 <= radius <= FARTHEST, 'the radius must not be below 0', words.texts['R'])
    given = _offset_words(at, words)
    if 2 in given:
        length = given.pop(2)
        if kind == 10:
            length = float(mover.point[2] - (frames.origin[2] - frames.length)) - length
        elif kind == 11:
            length = float(mover.point[2] - frames.work('G59.3')[2]) - length
    at.demand(not given, 'a tool has a length (Z) and a radius (R) only', f'G10 L{kind}')
    wear = tool.length_wear if kind == 1 else 0.0  # the measured length includes the wear
    measured = replace(tool, length=length, radius=radius, length_wear=wear)
    if measured.corner_radius is not None and measured.corner_radius > radius:
        raise at.fault(
            'the radius is smaller than the corner radius of the tool', words.texts['R']
        )
    mover.change(SetupChange('tools', measured, int(number)))


def _offset_words(at: Execution, words: BlockWords) -> dict[int, float]:
    found, letters = {}, at.mover.frames.letters
    for i, value in words.take(letters).items():
        found[i] = value * (at.mover.unit if i < 3 else DEG)
        at.demand(abs(found[i]) <= FARTHEST, 'an offset beyond 100,000 mm; correct it', letters[i])
    return found


def go_to_reference(at: Execution, code: str, words: BlockWords) -> None:
    mover = at.mover
    word, letters = mover.machine_words(words), mover.frames.letters
    named = [letter for letter in letters if letter in words.values]
    beside = [letter for letter in mover.extra_letters if letter in words.values]
    mover.extra = mover.extra_target(words, machine=False)
    if named or beside:
        mover.go_to(mover.target(words), rapid=True)
    point, rotary = mover.point.copy(), mover.rotary.copy()
    for letter in beside:
        mover.extra[mover.extra_letters.index(letter)] = 0.0
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


def keep_reference(at: Execution, code: str, _: BlockWords) -> None:
    mover = at.mover
    machine = np.concatenate([mover.point + mover.zero, mover.rotary])
    place = dict(zip(mover.frames.letters, machine.tolist(), strict=False))
    mover.change(SetupChange('reference_points', place, code[:3]))


def shift_frame(at: Execution, _: str, words: BlockWords) -> None:
    """Process G52, which shifts the frame but does not move the tool."""
    frames = at.mover.frames
    for i, value in _offset_words(at, words).items():
        frames.local[i] = value
    frames.update()


def preset(at: Execution, _: str, words: BlockWords) -> None:
    """Process G92; as in LinuxCNC, it does not restore values that G92.2 suspended."""
    mover, frames = at.mover, at.mover.frames
    mover.demand_no_scale('G92')
    here, amounts = mover.here(), frames.g92.copy()
    for i, value in _offset_words(at, words).items():
        if i < 3:
            amounts[:3] += frames.programmed_turn[:, i] * (here[i] - value)
        else:
            amounts[i] += here[i] - value
    amounts_by_letter = dict(zip(frames.letters, amounts.tolist(), strict=False))
    mover.change(SetupChange('g92', amounts_by_letter))
    mover.change(SetupChange('g92_on', True))


def suspend_preset(at: Execution, code: str, _: BlockWords) -> None:
    if code == 'G92.1':
        at.mover.change(SetupChange('g92', {}))
    at.mover.change(SetupChange('g92_on', code == 'G92.3'))
