"""What a proof says: largest uses, failures in one line each, as text and as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.kinematics.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles

# The orders of difference that have limits, and the power of the second in their units.
DIFFERENCES = (('velocity', ''), ('acceleration', '2'), ('jerk', '3'))


@dataclass(frozen=True)
class Finding:
    """
    The place where one quantity comes nearest to what it must not exceed, or exceeds it most.

    Parameters
    ----------
    what, axis : str
        The quantity, and the axis it belongs to or ''.
    value, limit, ratio : float
        In SI, and their quotient.
    sample : int
        Sample number, -1 where the finding belongs to a block or the path instead.
    time : float
        Time of the sample [s], or NaN.
    line : int
        Line of the part program.
    exceeded : int
        How many places exceed the limit.
    linear : bool
        False where the axis is a rotary one, so that value and limit count in rad.

    """

    what: str
    axis: str
    value: float
    limit: float
    ratio: float
    sample: int
    time: float
    line: int
    exceeded: int
    linear: bool = True


@dataclass(frozen=True)
class Proof:
    """
    What was proven about a plan, and what was not.

    Parameters
    ----------
    machine : str
        Name of the machine whose limits count.
    axis_names : tuple of str
        Axes of that machine.
    samples, blocks : int
        Number of setpoints and of program rows after the start pose.
    period, cycle_time : float
        Interpolation period and duration of the motion [s].
    findings : tuple of Finding
        Largest use of every limit and tolerance.
    failures : tuple of str
        One line for each thing that is not proven.
    remarks : dict
        Figures for information; nothing depends on them.

    """

    machine: str
    axis_names: tuple[str, ...]
    samples: int
    blocks: int
    period: float
    cycle_time: float
    findings: tuple[Finding, ...]
    failures: tuple[str, ...]
    remarks: dict[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """True if everything is proven."""
        return not self.failures

    def largest(self, what: str, axis: str = '') -> Finding:
        """Look up a finding."""
        return next(f for f in self.findings if f.what == what and f.axis == axis)

    def to_json(self) -> dict[str, Any]:
        """Return the proof as plain values for JSON; what is not finite becomes None."""
        text = json.dumps({'ok': self.ok, **asdict(self)})
        plain: dict[str, Any] = json.loads(text, parse_constant=lambda _: None)
        return plain

    def text(self) -> str:
        """Write the proof for a terminal."""
        lines = [
            f'{self.samples} samples of {self.period * 1e3:g} ms, {self.cycle_time:.3f} s, '
            f'{self.blocks} blocks, machine {self.machine}'
        ]
        if self.findings:
            lines.append('largest use  ' + ''.join(f'{name:>9}' for name in self.axis_names))
            for kind, _ in DIFFERENCES:
                uses = [self.largest(kind, name).ratio for name in self.axis_names]
                lines.append(f'{kind:<13}' + ''.join(f'{use:>9.2%}' for use in uses))
        for finding in self.findings:
            if not finding.axis:
                value, limit = _spoken(finding)
                lines.append(f'{finding.what:<22}{value:>17} of {limit:<17}{_place(finding)}')
        verdict = f'NOT proven, faults: {len(self.failures)}' if self.failures else 'proven'
        return '\n'.join([*lines, *self.failures, verdict])


class Ledger:
    """Collects findings and failures while a plan is being proven."""

    def __init__(self, plan: PlanFiles, machine: Machine):
        self.plan, self.machine = plan, machine
        self.findings: list[Finding] = []
        self.failures: list[str] = []
        self.remarks: dict[str, float] = {}

    def judge(
        self,
        what: str,
        value: FloatArray,
        limit: FloatArray | float,
        axis: str = '',
        allowed: float = 1.0,
        slack: float = 0.0,
        rows: IntArray | None = None,
    ) -> None:
        """
        Enter the largest ``value / limit``; more than ``allowed`` times the limit is a failure.

        ``rows`` names the program row of each value; without it values belong to the samples.
        """
        if not len(value):
            return
        limit = np.broadcast_to(np.asarray(limit, dtype=float), value.shape)
        ratio = np.divide(value, limit, out=np.full(value.shape, np.inf), where=limit > 0.0)
        ratio[(limit <= 0.0) & (value <= slack)] = 0.0
        # Written so that a NaN counts as exceeded.
        exceeded = ~(value <= limit * allowed + slack)
        judged = np.where(exceeded, np.where(np.isnan(ratio), np.inf, ratio) + 1e6, ratio)
        worst = int(np.argmax(judged))
        sample = min(worst, len(self.plan.position) - 1) if rows is None else -1
        row = int(self.plan.block[sample] if rows is None else rows[worst])
        finding = Finding(
            what, axis, float(value[worst]), float(limit[worst]), float(ratio[worst]), sample,
            float(self.plan.setpoints['time'][sample]) if rows is None else float('nan'),
            int(self.plan.blocks['line'][row]), int(np.count_nonzero(exceeded)),
            not axis or self.machine.axis(axis).linear,
        )  # fmt: skip
        self.findings.append(finding)
        if finding.exceeded:
            value_text, limit_text = _spoken(finding)
            others = f'; {finding.exceeded} places in all' if finding.exceeded > 1 else ''
            of = f' of {axis}' if axis else ''
            self.failures.append(
                f'{what}{of} {value_text}, limit {limit_text} ({finding.ratio:.2%}) '
                f'{_place(finding)}{others}'
            )

    def check(
        self,
        what: str,
        value: FloatArray,
        limit: FloatArray | float,
        axis: str = '',
        allowed: float = 1.0,
        rows: IntArray | None = None,
    ) -> None:
        """Judge a consistency: only its failure is worth telling."""
        before = len(self.findings)
        self.judge(what, value, limit, axis, allowed, rows=rows)
        self.findings = [f for i, f in enumerate(self.findings) if i < before or f.exceeded]

    def demand(self, holds: bool | np.bool_, fault: str) -> None:
        """Enter a failure unless a condition holds."""
        if not holds:
            self.failures.append(fault)

    def close(self) -> Proof:
        """Sum up."""
        plan, machine = self.plan, self.machine
        return Proof(
            machine.name, machine.axis_names, len(plan.position), len(plan.blocks['tip']) - 1,
            plan.period, (len(plan.position) - 1) * plan.period, tuple(self.findings),
            tuple(self.failures), self.remarks,
        )  # fmt: skip


def _place(finding: Finding) -> str:
    if finding.sample < 0:
        return f'line {finding.line}'
    return f'at sample {finding.sample} ({finding.time:.3f} s, line {finding.line})'


def _spoken(finding: Finding) -> tuple[str, str]:
    """Write value and limit in the units of the shop floor."""
    scale, unit = (1e3, 'mm') if finding.linear else (180.0 / np.pi, 'deg')
    order = dict(DIFFERENCES).get(finding.what.removeprefix('planned ').removesuffix(' column'))
    if finding.what == 'tip feed':
        scale, unit = 60e3, 'mm/min'
    elif finding.what == 'rotation time':
        scale, unit = 1.0, 's'
    elif 'rotary word' in finding.what:
        scale, unit = 180.0 / np.pi, 'deg'
    elif order is not None:
        unit += f'/s{order}'
    return f'{_figure(finding.value * scale)} {unit}', f'{_figure(finding.limit * scale)} {unit}'


def _figure(value: float) -> str:
    """Write a number; a hundredth of a nanometre is zero."""
    return f'{value:.6g}' if abs(value) >= 1e-8 else '0'
