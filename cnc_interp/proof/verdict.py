"""The result of a proof: assumptions, largest uses of limits, and failures, as text and JSON."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partialmethod
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import MM, MS, FloatArray, IntArray, MachineError
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.proof.plan_files import Columns, PlanFiles

# Differences of the positions that have limits, and the power of the second in their units.
DIFFERENCES = (('velocity', ''), ('acceleration', '2'), ('jerk', '3'))
BEFORE_END = 3  #: Number of samples before the end of a cut record whose jerk is unknown.
TORQUE = 'torque'  #: The limit that only some axes have.


@dataclass(frozen=True)
class Finding:
    #: Name of the quantity, and name of its axis if it has one.
    what: str
    axis: str
    #: Value and limit in SI units, and value / limit [-].
    value: float
    limit: float
    ratio: float
    sample: int  #: Sample number, or -1 if the finding belongs to a block or to the path.
    time: float  #: Time of the sample [s], NaN if ``sample`` is -1.
    line: int  #: Line of the part program.
    exceeded: int  #: Number of places at which the limit is exceeded.
    linear: bool = True  #: Whether value and limit are lengths rather than angles.


@dataclass(frozen=True)
class Proof:
    machine: str  #: Name of the machine whose limits were used.
    axis_names: tuple[str, ...]  #: Names of the axes of that machine.
    #: Number of setpoints and of program rows after the start pose.
    samples: int
    blocks: int
    #: Interpolation period and duration of the motion [s].
    period: float
    cycle_time: float
    findings: tuple[Finding, ...]  #: Largest use of each limit and tolerance.
    failures: tuple[str, ...]  #: One sentence for each fact that is not proven.
    machine_file: str = ''  #: File of the machine; empty for a bundled one.
    given: tuple[Given, ...] = ()  #: Assumptions that are not proven.
    program: str = ''  #: Result of the comparison with the program text, or ''.
    beside: str = ''  #: Motion executed outside the program, or ''.
    #: Where a cut record ends, or ''. This is a failure, unless a probe of the program ended it or
    #: a bag shows that the operator did.
    until: str = ''

    @property
    def ok(self) -> bool:
        return not self.failures

    def largest(self, what: str, axis: str = '') -> Finding:
        return next(f for f in self.findings if f.what == what and f.axis == axis)

    @property
    def kinds(self) -> tuple[str, ...]:
        kinds = tuple(kind for kind, _ in DIFFERENCES)
        return (*kinds, TORQUE) if any(f.what == TORQUE for f in self.findings) else kinds

    def use_of(self, kind: str, axis: str) -> float:
        uses = (f.ratio for f in self.findings if f.what == kind and f.axis == axis)
        return next(uses, float('nan'))

    def to_json(self) -> dict[str, Any]:
        text = json.dumps({'ok': self.ok, **asdict(self)})
        return json.loads(text, parse_constant=lambda _: None)

    def __str__(self) -> str:
        return self.text()

    def text(self) -> str:
        lines = [row.text() for row in self.given]
        lines += [
            f'{self.samples} samples of {self.period * 1e3:g} ms, {self.cycle_time:.3f} s, '
            f'{self.blocks} blocks, machine {self.machine}'
        ]
        if self.findings:
            lines.append('largest use  ' + ''.join(f'{name:>9}' for name in self.axis_names))
            for kind in self.kinds:
                uses = [self.use_of(kind, name) for name in self.axis_names]
                cells = ('-' if np.isnan(use) else f'{use:.2%}' for use in uses)
                lines.append(f'{kind:<13}' + ''.join(f'{cell:>9}' for cell in cells))
        for finding in self.findings:
            if not finding.axis:
                value, limit = _with_units(finding)
                lines.append(f'{finding.what:<22}{value:>17} of {limit:<17}{_place(finding)}')
        lines += [line for line in (self.beside, self.program) if line]
        verdict = f'proven as far as it goes: {self.until}' if self.until else 'proven'
        if self.failures:
            # A cut record is not a fault of the motion that it contains.
            verdict = f'NOT proven, faults: {len(set(self.failures) - {self.until})}'
            if self.failures == (self.until,):
                verdict = 'proven as far as the record goes, NOT to the end of the program'
        elif self.machine_file:
            verdict += f' for the machine file {self.machine_file}, which is not bundled'
        return '\n'.join([*lines, *self.failures, verdict])


class Ledger:
    def __init__(self, plan: PlanFiles, machine: Machine):
        self.plan, self.machine = plan, machine
        # Every quantity that was judged, by its name and axis, with the share that counts and
        # whether only its failure is reported; and every fault, a text or such a name, in order.
        self._judged: dict[tuple[str, str], tuple[Finding, float, bool]] = {}
        self._faults: list[str | tuple[str, str]] = []
        # A cut record proves nothing from here on, because the next setpoints are missing.
        count, rows = len(plan.position), len(plan.blocks['tip'])
        self.known_samples = count - BEFORE_END if plan.cut and not plan.ends_at_rest else count
        self.known_rows = int(plan.block[count - 1]) if plan.cut and count else rows

    @property
    def findings(self) -> list[Finding]:
        return [f for f, _, quiet in self._judged.values() if f.exceeded or not quiet]

    @property
    def failures(self) -> list[str]:
        texts = []
        for fault in self._faults:
            if isinstance(fault, str):
                texts.append(fault)
            elif (finding := self._judged[fault][0]).exceeded:
                texts.append(_failure(finding))
        return texts

    def judge(
        self,
        what: str,
        value: FloatArray,
        limit: FloatArray | float,
        axis: str = '',
        allowed: float = 1.0,
        slack: float = 0.0,
        rows: IntArray | None = None,
        first: int = 0,
        quiet: bool = False,
    ) -> None:
        """Record the largest ``value / limit``; it is a failure if it exceeds ``allowed``."""
        if not len(value):
            return
        limit = np.broadcast_to(np.asarray(limit, dtype=float), value.shape)
        if self.plan.cut:
            numbers = first + np.arange(len(value)) if rows is None else rows
            known = numbers < (self.known_samples if rows is None else self.known_rows)
            if not known.any():
                return
            value, limit = value[known], limit[known]
            rows = None if rows is None else rows[known]
        ratio = np.divide(value, limit, out=np.full(value.shape, np.inf), where=limit > 0.0)
        ratio[(limit <= 0.0) & (value <= slack)] = 0.0
        # In this form a NaN counts as exceeded.
        exceeded = ~(value <= limit * allowed + slack)
        judged = np.where(exceeded, np.where(np.isnan(ratio), np.inf, ratio) + 1e6, ratio)
        worst, count = int(np.argmax(judged)), int(np.count_nonzero(exceeded))
        name, share = (what, axis), float(judged[worst])
        if name in self._judged:
            before, most, _ = self._judged[name]
            if share <= most:
                before = replace(before, exceeded=before.exceeded + count)
                self._judged[name] = before, most, quiet
                return
            count += before.exceeded
        else:
            self._faults.append(name)
        sample = min(first + worst, len(self.plan.position) - 1) if rows is None else -1
        row = int(self.plan.block[sample] if rows is None else rows[worst])
        finding = Finding(
            what,
            axis,
            float(value[worst]),
            float(limit[worst]),
            float(ratio[worst]),
            sample,
            float(self.plan.setpoints['time'][sample]) if rows is None else float('nan'),
            int(self.plan.blocks['line'][row]),
            count,
            not axis or self.machine.axis(axis).linear,
        )
        self._judged[name] = finding, share, quiet

    #: As ``judge``, for a consistency check that is recorded only if it fails.
    check = partialmethod(judge, quiet=True)

    def fail(self, fault: str) -> None:
        self._faults.append(fault)

    def require(self, holds: bool | np.bool_, fault: str) -> None:
        if not holds:
            self.fail(fault)

    def close(self) -> Proof:
        plan, machine, until = self.plan, self.machine, self.plan.cut
        if until and not plan.ends_at_rest:
            until += f'; nothing is known after {self.known_samples * plan.period:.3f} s'
        return Proof(
            machine.name,
            machine.axis_names,
            len(plan.position),
            len(plan.blocks['tip']) - 1,
            plan.period,
            (len(plan.position) - 1) * plan.period,
            tuple(self.findings),
            (*self.failures, *([until] if until and not plan.by_probe else [])),
            machine.file,
            until=until,
        )


def _failure(finding: Finding) -> str:
    value, limit = _with_units(finding)
    others = f'; {finding.exceeded} places in all' if finding.exceeded > 1 else ''
    of = f' of {finding.axis}' if finding.axis else ''
    return (
        f'{finding.what}{of} {value}, limit {limit} ({finding.ratio:.2%}) '
        f'{_place(finding)}{others}'
    )


def _place(finding: Finding) -> str:
    if finding.sample < 0:
        return f'line {finding.line}'
    return f'at sample {finding.sample} ({finding.time:.3f} s, line {finding.line})'


def _with_units(finding: Finding) -> tuple[str, str]:
    scale, unit = (1e3, 'mm') if finding.linear else (180.0 / np.pi, 'deg')
    order = dict(DIFFERENCES).get(finding.what.removeprefix('planned ').removesuffix(' column'))
    if finding.what == 'tip feed':
        scale, unit = 60e3, 'mm/min'
    elif finding.what == 'rotation time':
        scale, unit = 1.0, 's'
    elif finding.what == TORQUE:
        scale, unit = 1.0, 'N' if finding.linear else 'Nm'
    elif 'rotary word' in finding.what:
        scale, unit = 180.0 / np.pi, 'deg'
    elif order is not None:
        unit += f'/s{order}'
    return f'{_figure(finding.value * scale)} {unit}', f'{_figure(finding.limit * scale)} {unit}'


def _figure(value: float) -> str:
    return f'{value:.6g}' if abs(value) >= 1e-8 else '0'


#: Figures of a plan that are not proven, because only the planner knows them.
UNPROVEN = 'largest errors, tolerances used, time bound, windows, segments, curves'
DIGITS = 12  #: Number of hash digits shown.


@dataclass(frozen=True)
class Given:
    #: Name of the assumption, its value in shop units, and its source.
    what: str
    value: str
    source: str
    sha256: str = ''  #: First digits of the hash of the file's content, or ''.

    def text(self) -> str:
        end = f' (sha256 {self.sha256})' if self.sha256 else ''
        return f'{self.what:<15}{self.value}, from {self.source}{end}'


def given_of(plan: PlanFiles, machine: Machine, name: str, source: Path) -> tuple[Given, ...]:
    blocks, summary = plan.blocks, plan.summary
    in_bag = not (source / 'blocks.npz').is_file()
    of_blocks = 'the recorded blocks' if in_bag else 'blocks.npz'
    of_summary = 'the bag' if in_bag else 'summary.json'
    file = find_machine_file(name)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:DIGITS]
    tolerances = ' and '.join(
        _span(blocks[f'{kind}_tolerance'] / MM) + f' mm {kind}'
        for kind in ('contour', 'orientation')
    )
    program = f'{len(blocks["tip"]) - 1} blocks of {_name(summary)}'
    rows = [
        Given('program', program, of_blocks, digest_of(blocks)),
        Given('machine', machine.name, machine_source(machine, file), digest),
        Given('tolerances', tolerances, of_blocks),
        Given('flank height', f'{plan.flank_height / MM:g} mm', of_summary),
        Given('period', f'{plan.period / MS:g} ms', of_summary),
    ]
    if machine.arm is not None and machine.arm.guessed:
        guessed = ', '.join(machine.arm.guessed)
        rows.append(Given('guessed limits', guessed, '--limits guess, not from the maker'))
    if machine.errors is not None:
        tables = enumerate(machine.errors.tables)
        columns = {f'{k} {name}': of for k, table in tables for name, of in vars(table).items()}
        told = 'of X Y Z, compensated at the tip; the tool axis keeps its error'
        rows.append(Given('errors', told, f'{file} with its tables', digest_of(columns)))
    if scene := plan.settings.get('scene'):
        from cnc_interp.collision.scene_file import find_scene_file  # loaded with a scene only

        found = find_scene_file(str(scene))
        content = found.read_bytes() if found.is_file() else b''
        told = f'{len(plan.collision.get("begin", ()))} certificates and hits'
        digest = hashlib.sha256(content).hexdigest()[:DIGITS]
        rows.append(Given('scene', told, f'{found} with its meshes', digest))
    for name, column in (('feed override', 1), ('spindle override', 2)):
        shares = [step[column] for step in summary.get('overrides', [])]
        if set(shares) - {1.0}:
            told = f'{min(shares):.1%} to {max(shares):.1%}'
            rows.append(Given(name, f'{told}, in {len(shares)} steps', of_summary))
    if (source / 'segments.npz').is_file():
        rows += [
            Given('not checked', 'segments.npz, which only the report draws', 'its folder'),
            Given('not checked', UNPROVEN, 'summary.json'),
        ]
    return tuple(rows)


def machine_source(machine: Machine, file: Path) -> str:
    if not machine.file:
        return f'the bundled {file.name}'
    try:
        bundled = find_machine_file(machine.name)
    except MachineError:
        bundled = file
    same = bundled.resolve() == file.resolve() or bundled.read_bytes() == file.read_bytes()
    differs = '' if same else f' and differs from the bundled {machine.name}'
    return f'{file}, which is not bundled{differs}'


def digest_of(columns: Columns) -> str:
    digest = hashlib.sha256()
    for name in sorted(columns):
        column = np.ascontiguousarray(columns[name])
        digest.update(f'{name} {column.dtype.str} {column.shape}'.encode())
        digest.update(column.data)
    return digest.hexdigest()[:DIGITS]


def _name(summary: Mapping[str, Any]) -> str:
    name = str(summary.get('program', 'an unnamed program'))
    return ''.join(letter if letter.isprintable() else '?' for letter in name)


def _span(values: FloatArray) -> str:
    least, most = f'{values.min():g}', f'{values.max():g}'
    return least if least == most else f'{least} to {most}'
