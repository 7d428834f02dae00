"""Completeness of a motion: it passes every vertex and axis position, and makes every stop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.plan_files import PlanFiles, gathered, spans
from cnc_interp.proof.program_shapes import REACH, SLACK, ProgramShapes
from cnc_interp.proof.programmed_path import distances_to_vertices, peaks
from cnc_interp.proof.verdict import Ledger

STOP_DISTANCE = 1e-6  #: Largest accepted distance between an exact stop and its vertex [m].
SEARCHED = 20_000  #: Number of samples before and after a vertex that are searched for a rest.
STOP_ANGLE = 1e-6  #: Largest accepted error of rotary words at an exact stop [rad].
# At the pole the tool axis does not show a turn. Nearer than this number of orientation
# tolerances, the outer rotary axis must keep to its word as if the tool were at this distance.
POLE_TOLERANCES = 4.0


def prove_completeness(ledger: Ledger, plan: PlanFiles, program: ProgramShapes) -> None:
    blocks, height, machine = plan.blocks, plan.flank_height, program.machine
    vertex_top, tips, tops = blocks['tip'] + height * blocks['axis'], program.tips, program.tops
    rows, count = np.arange(len(blocks['tip'])), len(plan.position)
    contour, orientation = program.contour, program.orientation
    search = VertexSearch(plan)
    nearest, _ = search.nearest(tips, blocks['tip'], contour)
    ledger.judge('vertex missed by tip', nearest, contour, slack=SLACK, rows=rows)
    nearest_top, where = search.nearest(tops, vertex_top, orientation)
    ledger.judge('vertex missed by top', nearest_top, orientation, slack=SLACK, rows=rows)
    ends = [('first', 0, 0), ('last', count - 1, len(rows) - 1)]
    for name, sample, row in ends[:1] if plan.cut else ends:
        at = plan.position[sample : sample + 1]
        gaps = (
            float(np.linalg.norm(tips(at)[0] - blocks['tip'][row])),
            float(np.linalg.norm(tops(at)[0] - vertex_top[row])),
        )
        gap, room = max(gaps), np.zeros(2)
        if name == 'first' and plan.starts_inside:  # on a corner, beside its vertex
            room = np.array([contour[:2].min(), orientation[:2].min()])
        text = f'the motion is {gap * 1e3:.3g} mm away from the {name} pose of the program'
        ledger.require((gaps <= room + SLACK).all(), f'{text} (line {blocks["line"][row]})')
    if machine.has_rotary:
        _prove_rotary_words(ledger, plan, program, search, where)
    if machine.extra_names:
        _prove_extra_words(ledger, plan, program, search, where)
    stops = np.flatnonzero(blocks['exact_stop'])
    stops = stops[stops < ledger.known_rows]
    if len(stops):
        ledger.judge('exact stop missed', nearest[stops], STOP_DISTANCE, rows=stops)
        # While an axis passes through rest, it moves less than J T^3 / 3 in one period.
        named = np.isfinite(blocks['rotary']).all(axis=1)
        crawl = ROUNDING * machine.max_jerk * plan.period**3 / 3.0

        def moves(row: int) -> bool:
            i = int(where[row])
            if i + 2 > count - 1 or _rests(plan.position[max(i - 1, 0) : i + 3], crawl):
                return False
            # The nearest sample may be beside the rest; an axis that is not named may turn there.
            first = max(i - SEARCHED, 0)
            near = plan.position[first : i + SEARCHED]
            gaps = np.stack([tips(near) - blocks['tip'][row], tops(near) - vertex_top[row]])
            off = np.linalg.norm(gaps, axis=2).max(axis=0) > 3.0 * SLACK
            if named[row]:
                off |= np.abs(near[:, 3:5] - blocks['rotary'][row]).max(axis=1) > STOP_ANGLE
            away = np.flatnonzero(off)
            low = away[away < i - first].max(initial=-1) + 1
            high = away[away > i - first].min(initial=len(near))
            return not _rests(near[low:high], crawl)

        moving = [row for row in stops if moves(row)]
        if moving:
            line = int(blocks['line'][moving[0]])
            ledger.fail(f'no rest at the exact stop of line {line}; {len(moving)} stops missed')


def _rests(position: FloatArray, crawl: FloatArray) -> bool:
    return bool((np.abs(np.diff(position, axis=0)) <= crawl).all(axis=1).any())


def _prove_rotary_words(
    ledger: Ledger, plan: PlanFiles, program: ProgramShapes, search: VertexSearch, where: IntArray
) -> None:
    """Check that rotary axes pass their programmed positions, on the right branch and turn.

    At a rounded vertex an axis may miss its position by the tolerances at flank height, divided by
    the sine of the angle between the tool and that axis.
    """
    rotary = np.array(plan.blocks['rotary'], dtype=float)
    rows = np.flatnonzero(np.isfinite(rotary).all(axis=1))
    rows = rows[rows > 0]
    if not len(rows):
        return
    height, transform = max(plan.flank_height, 1e-3), program.transform
    contour, orientation = program.contour, program.orientation
    words = np.nan_to_num(rotary)
    allowed = np.ones((len(rotary), 3))
    for i in range(2):
        step = np.zeros(2)
        step[i] = 1e-4
        ahead, back = (transform.tool_axis(words + way) for way in (step, -step))
        sine = np.linalg.norm(ahead - back, axis=1) / 2e-4
        least = POLE_TOLERANCES * orientation / height
        allowed[:, i] = (contour + orientation) / height / np.maximum(sine, least)
    by_axes = program.path.by_axes
    linear = by_axes | np.r_[by_axes[1:], False]
    allowed[linear, :2] = (orientation[linear] / height)[:, None]
    stops = np.asarray(plan.blocks['exact_stop'], dtype=bool).copy()
    stops[-1] = True
    allowed[stops, :2] = np.minimum(allowed[stops, :2], STOP_ANGLE)

    def points(position: FloatArray) -> FloatArray:
        return np.hstack([position[:, 3:5], np.zeros((len(position), 1))])

    targets = np.hstack([words, np.zeros((len(words), 1))])
    angle = allowed[:, :2].max(axis=1)
    gap, passed = search.nearest(points, targets, angle, allowed)
    ledger.judge('rotary word missed', gap[rows] * angle[rows], angle[rows], rows=rows)
    # A turn of the tool about its own axis is hardly visible to tip and tool axis.
    rows = rows[by_axes[rows]]
    seen, there = (gathered(plan.position, at[rows]) for at in (where, passed))
    on_the_way = np.abs(points(seen) - targets[rows]).max(axis=1, initial=0.0) > STOP_ANGLE
    tip = transform.forward(there)[0]
    near = np.linalg.norm(tip - plan.blocks['tip'][rows], axis=1) <= STOP_DISTANCE
    rows = rows[on_the_way & near]
    where[rows] = passed[rows]


def _prove_extra_words(
    ledger: Ledger, plan: PlanFiles, program: ProgramShapes, search: VertexSearch, where: IntArray
) -> None:
    words, machine = plan.blocks['extra_axes'], program.machine
    if words.shape[1] < len(machine.extra_names):
        ledger.fail(f'blocks.npz has no words for the axes {machine.extra_names}')
        return
    rows = np.arange(len(words))
    after = np.clip(search.starts[1:], 1, search.count - 1)
    both = [gathered(plan.position, at) for at in (after - 1, after)]
    resting = np.r_[False, np.abs(np.diff(plan.blocks['tip'], axis=0)).max(axis=1) < SLACK]
    for k, name in enumerate(machine.extra_names):
        ends = np.stack([position[:, machine.axis_names.index(name)] for position in both])
        gap = np.maximum(words[:, k] - ends.max(axis=0), ends.min(axis=0) - words[:, k])
        gap = np.maximum(gap, 0.0)
        name += '' if machine.axis(name).linear else ' at 1 m'
        ledger.judge(f'word missed by {name}', gap, program.contour, slack=SLACK, rows=rows)
        alone = resting & (np.r_[0.0, np.abs(np.diff(words[:, k]))] > SLACK)
        nearer = np.abs(ends - words[:, k]).argmin(axis=0)
        where[alone] = (after - 1 + nearer)[alone]


class VertexSearch:
    def __init__(self, plan: PlanFiles):
        self.plan, self.count = plan, len(plan.position)
        # First sample of each row or of a later one.
        self.starts = np.full(len(plan.blocks['tip']) + 1, self.count)
        before = -1
        for a, b in spans(self.count):
            label = np.maximum.accumulate(np.maximum(plan.block[a:b], before))
            rows = np.arange(before + 1, label[-1] + 1)
            self.starts[rows] = a + np.searchsorted(label, rows)
            before = int(label[-1])

    def nearest(
        self,
        points_of: Callable[[FloatArray], FloatArray],
        vertices: FloatArray,
        tolerance: FloatArray,
        unit: FloatArray | None = None,
    ) -> tuple[FloatArray, IntArray]:
        """Return how far each vertex is from the motion, and the sample before the nearest point.

        The samples of the rows at a vertex are searched first, then more if they miss it.
        ``unit`` (M, 3): tolerance of each coordinate, if they differ.
        """
        allowed = tolerance if unit is None else np.ones(len(vertices))
        rows = np.arange(len(vertices))
        unit = np.broadcast_to(np.ones(3) if unit is None else unit, vertices.shape)
        # A vertex lies between its own row and the next. Rounding may shift the row of a sample by
        # one more, except at a stop, where a tool that turns back has passed it a row before.
        spread = np.where(self.plan.blocks['exact_stop'], 0, 1)
        nearest, where = self._among(rows - spread, rows + 1 + spread, points_of, vertices, unit)
        far = nearest > (allowed + SLACK if unit is None else allowed)
        if far.any():
            way = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(vertices, axis=0), axis=1)])
            reach = REACH * tolerance[far]
            first = np.searchsorted(way, way[far] - reach)
            last = np.searchsorted(way, way[far] + reach, 'right')
            first, last = np.minimum(first, rows[far] - 1), np.maximum(last, rows[far] + 2)
            nearest[far], where[far] = self._among(
                first, last, points_of, vertices[far], unit[far]
            )
        far = nearest > allowed
        if far.any():
            more = self._peaks(where[far], points_of, unit[far])
            nearest[far] = np.maximum(nearest[far] - more, 0.0)
        return nearest, where

    def _peaks(
        self,
        where: IntArray,
        points_of: Callable[[FloatArray], FloatArray],
        unit: FloatArray,
    ) -> FloatArray:
        around = np.clip(where[:, None] + np.arange(-2, 4), 0, self.count - 1)
        points = points_of(gathered(self.plan.position, around.ravel())).reshape(-1, 6, 3)
        return np.asarray(np.linalg.norm(peaks(points) / unit[:, None], axis=2).max(axis=1))

    def _among(
        self,
        first: IntArray,
        last: IntArray,
        points_of: Callable[[FloatArray], FloatArray],
        vertices: FloatArray,
        unit: FloatArray,
    ) -> tuple[FloatArray, IntArray]:
        end = len(self.starts) - 1
        low = np.clip(self.starts[np.clip(first, 0, end)] - 1, 0, self.count - 2)
        high = np.clip(self.starts[np.clip(last + 1, 0, end)], 1, self.count - 1)
        nearest, where = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=np.int64)
        for a, b in spans(self.count):
            k = np.flatnonzero((low < b) & (high > a) & (nearest > 0.0))
            if not len(k):
                continue
            begin = max(a - 1, 0)
            points = points_of(self.plan.position[begin : b + 2])
            samples = np.maximum(low[k], a) - begin, np.minimum(high[k], b) - begin
            found, at = distances_to_vertices(points, vertices[k], *samples, unit[k])
            better = found < nearest[k]
            nearest[k[better]], where[k[better]] = found[better], begin + at[better]
        return nearest, where
