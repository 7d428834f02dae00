"""Read the program text again, by LinuxCNC or as plain words, and compare it with the blocks."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cnc_interp.core import (
    InterpError,
    ProgramError,
)
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof import linuxcnc_reader as second
from cnc_interp.proof.compared_moves import Agreement, Read, RowsByLine, RowsByPlace
from cnc_interp.proof.linuxcnc_reader import LinuxCNCError
from cnc_interp.proof.plain_reader import (
    PlainSettings,
    ReadMove,
    read_plainly,
)
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.verdict import Proof

#: Tool changes; words of probing, and calls of subprograms that may contain them.
_CHANGE = re.compile(r'(?<![A-Z<_])M\s*0*6(?!\d)|TOOL\s*CALL|LOADTL', re.IGNORECASE)
_TOUCHES = re.compile(r'G\s*0?31|G\s*38\.[2-5]|MEAS|CALL|G\s*65|M\s*98|CYCLE9')
# Cycles that LinuxCNC ends otherwise than other controls.
_OTHER_HOLES = re.compile(r'(?<![A-Z<_])G[ \t]*0*(?:74|84|89)(?![\d.])', re.IGNORECASE)
LONGEST = 64 << 20  #: Longest program that is read [bytes].


def with_program(proof: Proof, found: Agreement) -> Proof:
    said = 'agree with' if not found.faults else 'were compared with'
    line = f'program text   {found.motions} motions, {found.arcs} arcs {said} the blocks'
    line += f'; {found.readers}'
    return replace(proof, failures=(*proof.failures, *found.faults), program=line)


def compare_with_text(plan: PlanFiles, machine: Machine, program: Path) -> Agreement:
    """Compare the blocks with the text as read by other readers; InterpError if none can."""
    settings = plan.settings

    def demand(holds: bool, why_not: str) -> None:
        if not holds:
            raise InterpError(f'{program}: {why_not}')

    unknown = 'which the second readers do not support; this program cannot be compared'
    shortest = settings.get('rotary_sense') == 'shortest'
    demand(not shortest, f'planned with --rotary-sense shortest, {unknown}')
    for name, usual in (('arc_centres', 'start'), ('units', 'mm'), ('numbers', 'units')):
        choice = settings.get(name, 'auto')
        choice = machine.control.get(name, usual) if choice == 'auto' else choice
        demand(choice == usual, f'planned with {name} {choice}, {unknown}')
    inside = 'the plan starts inside the program; compare a plan from its top'
    demand(not plan.starts_inside, inside)
    told = not settings.get('setup') or bool(plan.summary.get('setup'))
    demand(told, 'the plan does not contain the values of its setup, so it cannot be compared')
    setup = second.setup_of(plan.summary.get('setup'), machine)
    try:
        with program.open('rb') as file:
            text = file.read(LONGEST + 1).decode('utf-8-sig', errors='replace')
    except OSError as problem:
        raise ProgramError(f'cannot be opened: {problem.strerror}', str(program)) from None
    demand(len(text) <= LONGEST, f'longer than {LONGEST >> 20} MB; cannot be compared')
    feed, skip = settings.get('feedrate'), bool(settings.get('skip_blocks'))
    cut = plan.blocks['line'][plan.block[len(plan.block) - 1]] if plan.by_probe else 0
    lines = text.upper().splitlines()
    touches = not cut or _TOUCHES.search(lines[cut - 1] if cut <= len(lines) else '')
    unprobed = f'{plan.cut}; but line {cut} of the program has no word of a probe'
    names = ('X', 'Y', 'Z', *machine.rotary_names, *machine.extra_names)
    given = (settings.get(f'{name}_tolerance') for name in ('contour', 'orientation'))
    tolerances = [float(t) if isinstance(t, int | float) else float('nan') for t in given]
    found, readers = [], []
    dialect = settings.get('dialect', 'auto')
    linuxcnc = dialect == 'linuxcnc' or program.suffix.lower() == '.ngc'
    combined = {'fanuc': (True,), 'auto': (False, True)}.get(dialect, (False,))
    combined = (False,) if linuxcnc else combined
    try:
        if not linuxcnc and _OTHER_HOLES.search(text):
            raise LinuxCNCError('LinuxCNC retracts from the holes of G74, G84 and G89 differently')
        moves: Iterable[Read] = second.read_by_linuxcnc(
            text, names, skip, len(plan.blocks['tip']), setup
        )
        by_places = RowsByPlace(plan.blocks, machine, tolerances)
        by_places.combined = combined
        found.append(by_places.follow(_as_planned(moves, settings)))
        readers.append(f"read by LinuxCNC's rs274 to {second.LAST_DIGIT:g} of its unit")
    except LinuxCNCError as reason:
        readers.append(str(reason))
    try:
        tools = second.cutters_of(plan.summary.get('setup'))
        if tools is None:
            raise ProgramError('the reader of plain words knows no offsets and tool lengths')
        if machine.tool_change_macro and _CHANGE.search(text):
            raise ProgramError('the reader of plain words knows no subprogram of M6')
        plain = PlainSettings(
            float(feed) if isinstance(feed, int | float) else None,
            skip,
            tools,
            setup.tool,
            plan.flank_height,
            machine.signals.after,
            machine.signals.changed_by_hand,
            (1.0,) if linuxcnc else {'fanuc': (1e-3,)}.get(dialect, (1.0, 1e-3, 0.0)),
            () if machine.arm is None else (float('nan'),) * len(machine.arm.further),
        )
        moves = read_plainly(text, str(program), names, plain)
        by_lines = RowsByLine(plan.blocks, machine, tolerances)
        by_lines.combined, by_lines.height = combined, plan.flank_height
        found.append(by_lines.follow(_as_planned(moves, settings)))
        found.append(replace(found[-1], faults=by_lines.waits(plan)))
        readers.append('read by the second reader of plain words')
    except ProgramError as reason:
        readers.append(str(reason))
        if found:
            found.append(replace(found[-1], faults=by_places.waits(plan, second.KNOWN_CALLS)))
            readers.append(f'of the functions {", ".join(second.KNOWN_CALLS)} are compared')
    if not found:
        raise InterpError('; '.join(reversed(readers)))
    return Agreement(
        found[-1].motions,
        found[-1].arcs,
        (*([] if touches else [unprobed]), *(fault for each in found for fault in each.faults)),
        '; '.join(readers),
    )


def _as_planned(read: Iterable[Read], settings: Mapping[str, Any]) -> Iterator[Read]:
    nan = float('nan')
    for each in read:
        if isinstance(each, ReadMove) and settings.get('force_tolerances'):
            each = replace(each, tolerance=nan, orientation=nan)
        if isinstance(each, ReadMove) and settings.get('interpolation') == 'vector':
            each = replace(each, worded=each.worded and not each.tcp)
        yield each
