"""The figures of a plan in `summary.json`; they are updated with every batch."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np

from cnc_interp import __version__
from cnc_interp.core import MM, UM, BlockError, BoolArray, FloatArray
from cnc_interp.feedrate.planner_tuning import wanted_tool
from cnc_interp.feedrate.planning_windows import CONVERGED, SOLVED_BY, PlannedPiece
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.overrides import NOMINAL, OverrideStep
from cnc_interp.run.program_times import ProgramTimes
from cnc_interp.run.setpoints import BEFORE, Setpoints, largest_shares, torque_shares
from cnc_interp.run.start_place import StartPlace
from cnc_interp.settings.options import Settings, values_of
from cnc_interp.smoothing.segments import SPLINE, PathSegments

if TYPE_CHECKING:
    from cnc_interp.drives.tool_error import ToolError, ToolMotion


class ToleranceUse:
    """Compares certified deviations with the tolerances of blocks; only changes are stored."""

    def __init__(self) -> None:
        self._marks = np.zeros((0, 4))
        self._lines = np.zeros(0, dtype=np.int64)
        self._rows = 0
        self.largest = np.zeros(2)

    def blocks(self, blocks: Blocks) -> None:
        rows = self._rows + np.arange(len(blocks))
        tolerances = blocks.contour_tolerance, blocks.orientation_tolerance
        told = np.column_stack([rows, *tolerances, blocks.on_spline])
        known = self._marks[-1:, 1:] if len(self._marks) else np.full((1, 3), np.nan)
        changed = np.diff(told[:, 1:], axis=0, prepend=known).astype(bool).any(axis=1)
        self._marks = np.concatenate([self._marks, told[changed]])
        self._lines = np.concatenate([self._lines, blocks.line_number[changed]])
        self._rows += len(blocks)

    def segments(self, segments: PathSegments) -> BoolArray:
        if not len(segments):
            return np.zeros(0, dtype=np.bool_)
        place = np.searchsorted(self._marks[:, 0], segments.block, 'right') - 1
        share = segments.deviation / self._marks[place, 1:3].min(axis=1)
        self.largest = np.maximum(self.largest, share.max(axis=0))
        native: BoolArray = self._marks[place[:, 1], 3] > 0.0
        self._marks, self._lines = self._marks[place.min() :], self._lines[place.min() :]
        return native

    def require(self, segments: PathSegments) -> None:
        lines, marks = self._lines, self._marks
        self.segments(segments)
        if (self.largest <= ROUNDING).all():
            return
        place = np.searchsorted(marks[:, 0], segments.block, 'right') - 1
        tolerance: FloatArray = marks[place, 1:3].min(axis=1)
        worst = int(np.argmax(segments.deviation / tolerance))
        at, kind = np.unravel_index(worst, tolerance.shape)
        raise BlockError(
            f'the rounded path leaves the {("contour", "orientation")[kind]} tolerance: '
            f'{segments.deviation[at, kind] / UM:.4g} um of {tolerance[at, kind] / UM:.4g} um; '
            'plan with --no-compress, and report the program',
            int(lines[place[at, 1]]),
        )


class PlanFigures:
    def __init__(self, machine: Machine, settings: Settings):
        period = settings.interpolation_period
        self._machine, self._settings = machine, settings
        self._period, self._height = period, settings.flank_height
        self._use = np.zeros_like(machine.limits.by_order)
        self._torque_use = np.zeros(len(machine.axis_names))
        self._last: FloatArray | None = None  # the last three positions
        self._deviation = np.zeros(2)
        self._curved = self._spans = 0  # blocks that became curves, and spans of these
        self._on_curve, self._last_row = False, 0  # where the last segment ended
        self._tolerances = ToleranceUse()
        self._tool = wanted_tool(machine, settings)
        self._tool_motion: ToolMotion | None = None
        self._tool_error = np.zeros(2)  # of the tip, and of the axis at flank height [m]
        self.functions = Functions.none()
        self.start: StartPlace | None = None  # where the run started, if not at the top
        #: Result of the clearance check; None without a scene.
        self.clearance: dict[str, Any] | None = None
        self.cut = ''  # where a record ends before the program does
        self.waits_first: bool | None = False  # for the operator (M0); a record does not tell
        self.samples = self._segments = self._blocks = 0
        self.times = ProgramTimes()
        self._windows = dict.fromkeys(SOLVED_BY, 0)
        self._over_bound = 0.0  # of the windows that have not converged [s]
        self._planned = self._spanned = self._path_length = self._least = 0.0

    def blocks(self, blocks: Blocks) -> None:
        self._tolerances.blocks(blocks)
        self.times.blocks(blocks)
        self._blocks += len(blocks)

    def segments(self, segments: PathSegments) -> None:
        if not len(segments):
            return
        self._segments += len(segments)
        self._deviation = np.maximum(self._deviation, segments.deviation.max(axis=0))
        self._count_curves(segments, self._tolerances.segments(segments))

    def _count_curves(self, segments: PathSegments, native: BoolArray) -> None:
        spans = (segments.kind == SPLINE) & ~native
        before = np.append(self._last_row, segments.block[:-1, 1])
        goes_on = np.append(self._on_curve, (spans & ~segments.stop)[:-1])
        first = np.where(goes_on, before + 1, np.maximum(before + 1, segments.block[:, 0]))
        self._curved += int((segments.block[:, 1] - first + 1)[spans].sum())
        self._spans += int(spans.sum())
        self._on_curve = bool(spans[-1] and not segments.stop[-1])
        self._last_row = int(segments.block[-1, 1])

    def piece(self, piece: PlannedPiece) -> None:
        self._planned = piece.law.end_time
        self.times.piece(piece)
        self._least += piece.least_time
        self._windows[piece.solved] += 1
        if piece.solved != CONVERGED:
            self._over_bound += float(piece.law.duration.sum()) - piece.least_time

    def setpoints(self, samples: Setpoints) -> None:
        if not len(samples):
            return
        self.samples += len(samples)
        self._path_length = float(samples.s[-1])
        self._spanned = float(samples.time[-1])
        self._measure(samples.position)
        if not self._planned:  # a record
            self.times.spent(samples.block, np.full(len(samples), self._period))
        if self._tool is not None:
            if self._tool_motion is None:
                self._tool_motion = self._tool.motion_from(samples.position[0])
            self._note_error(self._tool_motion.push(samples.position, samples.velocity))

    def _note_error(self, error: ToolError) -> None:
        if len(error.tip):
            largest = np.array([error.tip.max(), error.axis.max() * self._height])
            self._tool_error = np.maximum(self._tool_error, largest)

    @property
    def cycle_time(self) -> float:
        as_planned = abs(self._spanned - self._planned) <= self._period
        return self._planned if as_planned else self._spanned

    def _measure(self, position: FloatArray) -> None:
        before = np.repeat(position[:1], BEFORE, axis=0) if self._last is None else self._last
        held = np.concatenate([before, position])
        limits = self._machine.limits
        self._use = np.maximum(self._use, largest_shares(held, limits, self._period))
        if limits.loads:
            torques = torque_shares(held, limits, self._period)
            self._torque_use = np.maximum(self._torque_use, torques.max(axis=0))
        self._last = held[-BEFORE:]

    def summary(
        self,
        source: str,
        seconds: Mapping[str, float],
        overrides: Sequence[OverrideStep] = NOMINAL,
        setup: str = '',
    ) -> dict[str, Any]:
        """Return the summary in SI units; ``seconds``: planning stage -> computing time [s]."""
        if self._last is not None:
            self._measure(np.repeat(self._last[-1:], BEFORE, axis=0))  # stays where it is
        error = None
        if self._tool is not None:
            if self._tool_motion is not None:
                self._note_error(self._tool_motion.copy().settle())
            error = dict(zip(('tip', 'axis'), self._tool_error.tolist(), strict=True))
            error['limit'] = self._tool.largest
        machine = self._machine
        stands = self.functions.standstill(machine.signals, machine.standstill)
        uses = {
            name: dict(zip(machine.axis_names, use.tolist(), strict=True))
            for name, use in zip(('velocity', 'acceleration', 'jerk'), self._use, strict=True)
        }
        if loads := machine.limits.loads:
            names, use = machine.axis_names, self._torque_use
            uses['torque'] = {names[axis]: float(use[axis]) for axis in loads}
        used = self._tolerances.largest
        return {
            'program': source,
            'machine': machine.file or machine.name,
            'cycle_time': self.cycle_time,
            'time_bound': self._least or None,
            'windows': {**self._windows, 'over_bound': self._over_bound},
            'interpolation_period': self._period,
            'flank_height': self._height,
            'settings': values_of(self._settings),
            'setup': setup,
            'overrides': [list(step) for step in overrides],
            'start': None if self.start is None else self.start.to_json(),
            **({'cut': self.cut} if self.cut else {}),
            **({} if self.waits_first is None else {'waits_first': self.waits_first}),
            'functions': self.functions.counts(machine.signals),
            'standstill': float(stands.sum()),
            'tools': [
                section.to_json()
                for section in self.times.sections(
                    self.functions,
                    machine,
                    source if self._planned else '',  # of a record: a name
                )
            ],
            'samples': self.samples,
            'blocks': self._blocks - 1,
            'segments': self._segments,
            'path_length': self._path_length,
            'planning_time': sum(seconds.values()),
            'planning_time_by_room': dict(seconds),
            'largest_use': uses,
            'contour_deviation_bound': float(self._deviation[0]),
            'orientation_deviation_bound': float(self._deviation[1]),
            'tolerance_used': {'contour': float(used[0]), 'orientation': float(used[1])},
            'tool_error': error,
            **({'collision': self.clearance} if self.clearance else {}),
            'curves': {'blocks': self._curved, 'spans': self._spans},
            'versions': versions(),
        }


def clearance_text(found: Mapping[str, Any]) -> str:
    """Return the result of the clearance check in one line."""
    hits, nearest = len(found['hits']), found['nearest']
    told = f'{found["bodies"]} bodies, {found["pairs"]} pairs'
    if hits:
        return f'NOT clear: {told}, {hits} hit{"s" * (hits > 1)}'
    told = f'{told} keep their clearances, by {found["certificates"]} certificates'
    if nearest is None:
        return told
    where = f'{" and ".join(nearest["bodies"])} in line {nearest["line"]}'
    return f'{told}; nearest {nearest["distance"] / MM:.3g} mm, {where}'


def collision_text(summary: Mapping[str, Any]) -> str:
    """Return the result of the clearance check, and the stock figures, in one line."""
    if not (found := summary.get('collision')):
        return ''
    stock = f'; stock: {stock_text(found["stock"])}' if 'stock' in found else ''
    return clearance_text(found) + stock


def stock_text(found: Mapping[str, Any]) -> str:
    """Return the removed volume, and excess and gouge compared with the part, in one line."""
    cubic = MM**3
    told = f'{found["removed"] / cubic:.4g} of {found["volume"] / cubic:.4g} mm3 removed'
    told += f', on a grid of {found["grid"] / MM:g} mm'
    if 'excess' not in found:
        return told
    more, less = (f'{found[what] / MM:.3g} mm' for what in ('excess', 'gouge'))
    return f'{told}; up to {more} more than the part, up to {less} gouged'


def bound_text(summary: Mapping[str, Any]) -> str:
    """Return a text with the lower bound of the motion time; '' if it was not computed."""
    least = summary['time_bound']
    if least is None:
        return ''
    return (
        'no motion within these velocities and accelerations takes less than '
        f'{least:.3f} s; this one {summary["cycle_time"]:.3f} s'
    )


def windows_text(windows: Mapping[str, Any]) -> str:
    """Return a text about planning windows that have not converged; '' if all have."""
    if not any(windows[how] for how in SOLVED_BY[1:]):
        return ''
    told = ', '.join(f'{windows[how]} {how}' for how in SOLVED_BY if windows[how])
    return f'{told}; those not converged take {windows["over_bound"]:.3f} s more than the bound'


def versions() -> dict[str, str]:
    found = {'cnc_interp': __version__, 'python': platform.python_version()}
    for name in ('numpy', 'numba', 'scipy', 'toppra', 'ruckig'):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


ROUNDING = 1.001  #: Larger multiples of a limit or tolerance exceed it; 0.1 % is rounding.


def excesses(
    uses: Mapping[str, Mapping[str, float]],
    tolerances: Mapping[str, float],
    tool_error: Mapping[str, float] | None = None,
) -> list[str]:
    shares = [(f'{kind} of {axis}', use) for kind, of in uses.items() for axis, use in of.items()]
    shares += [(f'{kind} tolerance', use) for kind, use in tolerances.items()]
    found = [f'{name} {use:.2%}' for name, use in shares if not use <= ROUNDING]
    if tool_error:
        limit = tool_error['limit']
        share = max(tool_error['tip'], tool_error['axis']) / limit
        if not share <= ROUNDING:
            found.append(
                f'error at the tool {share:.2%}: friction and backlash may need more than '
                f'{limit / MM:g} mm at any speed; raise --tool-error, or --compensate'
            )
    return found


def tool_error_text(error: Mapping[str, float], height: float) -> str:
    """Return a text with the largest tool errors; ``height``: flank height [m]."""
    return (
        f'tool error     tip {error["tip"] / MM:.4f} mm, axis {error["axis"] / MM:.4f} mm at '
        f'{height / MM:g} mm; limit {error["limit"] / MM:g} mm, by the drives of the machine file'
    )
