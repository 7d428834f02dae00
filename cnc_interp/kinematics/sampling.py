"""Cut segments into cells of the AxisPath: q and its exact derivatives by path length.

A segment is cut until the septics of its cells agree with the exact axes inside the cells. Cells
end where the third derivative may jump: at joins and at u = 0.5 of corners.
"""

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.kinematics import segment_axes
from cnc_interp.kinematics.axis_path import septic_coefficients, septic_jet
from cnc_interp.kinematics.segment_axes import Place, SegmentRows, Stands
from cnc_interp.machine_model import error_map
from cnc_interp.smoothing.segments import CORNER, SPLINE, corner_breaks

CELL_ERROR = 1e-10  #: Largest error of the septic inside a cell [m or rad];
#: largest relative error of its third derivative [-]. ROUNDING / h^3 is noise of the axes, which
#: grows with the distance from the workpiece zero because the tool axis is a difference of two
#: points.
THIRD_ERROR = 0.01
ROUNDING, ROUNDING_PER_METRE = 1e-12, 4e-12
FINEST_CELL = 1e-10  #: Shorter cells are not divided, because s itself is rounded [m].
#: Over a longer way, joints may be those of another branch than they would be step by step [m].
SURE_STEP = 1e-3
SAME_PARAMETER = 1e-12  #: Parameters nearer than this are the same place.
WIDEST = 2.0  #: Cells of a machine with errors are at most so many pieces of their tables long.
MOST_CELLS = 4096  #: A segment is cut into at most this many cells.
#: Parameters between the cells of a corner and of any other segment, before refinement.
CORNER_GRID = np.linspace(0.0, 1.0, 13)
FINE, UNREACHABLE, SINGULAR, STANDSTILL = 0, 1, 2, 3  #: Result for a segment.


@njit(cache=True, nogil=True)
def septic_fits(
    left: FloatArray,
    right: FloatArray,
    h: float,
    x: float,
    exact: FloatArray,
    axes: IntArray,
    rounding: float,
) -> bool:
    """Return whether the septic of a cell matches the exact axes and q_sss at one place."""
    coefficients = np.empty(8)
    for i in axes:
        septic_coefficients(left[:, i], right[:, i], h, coefficients)
        q, _, _, q_sss = septic_jet(coefficients, x / h, h)
        if abs(q - exact[0, i]) > CELL_ERROR:
            return False
        size = max(abs(left[3, i]), abs(right[3, i]), abs(exact[3, i]))
        if abs(q_sss - exact[3, i]) > THIRD_ERROR * size + rounding / h**3:
            return False
    return True


@njit(cache=True, nogil=True)
def in_machine(packed: FloatArray, errors: FloatArray, q: FloatArray) -> FloatArray:
    """Return commanded axes and derivatives, (4, n); without errors the nominal ones ``q``."""
    if packed.ndim == 1:
        if len(errors) > 0:
            return error_map.commanded(errors, packed, q, error_map.STEPS)
    return q


@njit(cache=True, nogil=True)
def too_wide(errors: FloatArray, left: FloatArray, right: FloatArray) -> bool:
    """Tell whether waves of the errors may hide between the places at which a cell is checked."""
    if len(errors) > 0:
        for i in range(3):
            if abs(right[0, i] - left[0, i]) > WIDEST * error_map.spacing(errors, i):
                return True
    return False


@njit(cache=True, nogil=True)
def guided_grid(grid: FloatArray, guide: FloatArray) -> FloatArray:
    """Return the parameters of a grid, shape (k,), with the ends of a guide inserted."""
    for k in range(segment_axes.GUIDE_FROM, segment_axes.GUIDE_TO + 1):
        if 0.0 < guide[k] < 1.0 and np.abs(grid - guide[k]).min() > SAME_PARAMETER:
            grid = np.sort(np.append(grid, guide[k]))
    return grid


@njit(cache=True, nogil=True)
def first_grid(kind: int, f: FloatArray) -> FloatArray:
    if kind != CORNER:
        return segment_axes.PLAIN_GRID
    if f.shape[0] == 0:
        return CORNER_GRID
    grid = corner_breaks(f)
    breaks = len(grid)
    grid = np.concatenate((grid, CORNER_GRID))
    count = breaks
    for u in CORNER_GRID:
        if np.abs(grid[:breaks] - u).min() > 1e-3:
            grid[count] = u
            count += 1
    return np.sort(grid[:count])


@njit(cache=True, nogil=True)
def roomier(array: FloatArray, cells: int) -> FloatArray:
    larger = np.empty((cells, *array.shape[1:]))
    larger[: len(array)] = array
    return larger


@njit(cache=True, nogil=True)
def sample_segments(
    packed: FloatArray,
    errors: FloatArray,
    cone_sine: float,
    axes: IntArray,
    segments: SegmentRows,
    guides: FloatArray,
    stands: Stands,
) -> tuple[
    int,
    IntArray,
    IntArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
]:
    """Cut consecutive segments into cells; arguments as in ``sample``, one row per segment.

    ``errors``: see ``error_map``. ``axes``: columns of X Y Z, rotary and extra axes that the
    machine has. ``stands`` is updated to the nominal positions at the end. Returns FINE, or why
    the segment after the last counted one cannot be cut; number of cells of each segment, and of
    those before u = 0.5; lengths of the cells [m]; commanded axes and three derivatives at both
    ends (N, 4, n_axes); tips and tool axes (N + 1, 3).
    """
    n, n_axes = len(segments.kind), len(axes)
    counts, early = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    capacity = 8 * n + MOST_CELLS
    steps = np.empty(capacity)
    left, right = np.empty((capacity, 4, n_axes)), np.empty((capacity, 4, n_axes))
    tips, tools = np.empty((capacity + 1, 3)), np.empty((capacity + 1, 3))
    ends = np.empty(MOST_CELLS)  # right ends of the cells still to do, the next one last
    status, count, row, height = FINE, 0, 0, stands.height
    for row in range(n):
        segment, guide, way = segment_axes.segment_at(segments, row), guides[row], 0.0
        kind, how, shape, beside, spans, length = segment
        guided = guide[segment_axes.GUIDE_FROM] < 1.0
        if count + MOST_CELLS > capacity:
            capacity = 2 * capacity + MOST_CELLS
            steps, left = roomier(steps, capacity), roomier(left, capacity)
            right = roomier(right, capacity)
            tips, tools = roomier(tips, capacity + 1), roomier(tools, capacity + 1)
        free = how == segment_axes.FOLLOWING or guided
        least = 0.0
        if free and (not guided or packed.ndim == 2):
            least = cone_sine * cone_sine
        rounds = kind == CORNER and how >= segment_axes.LINEAR
        grid = CORNER_GRID if rounds else first_grid(kind, spans)
        if guided:
            grid = guided_grid(grid, guide)
        waiting = len(grid) - 1
        ends[:waiting] = grid[:0:-1]
        begin, a, fresh = count, 0.0, False
        rounding = max(ROUNDING, ROUNDING_PER_METRE * np.abs(shape[0]).max())
        if kind == SPLINE and segment_axes.tip_rests(shape):
            status = STANDSTILL
            break
        start = Place(0.0, 0.0, 0.0)
        q_a, tip, tool, sine = segment_axes.sample(packed, segment, stands, guide, start)
        c_a = in_machine(packed, errors, q_a)
        if count == 0:
            tips[0], tools[0] = tip, tool
        while waiting > 0 and sine >= least:
            b = ends[waiting - 1]
            middle = 0.5 * (a + b)
            if fresh:  # on a break the left end is another one than the last right end
                left_end = Place(way, a, middle)
                q_a = segment_axes.sample(packed, segment, stands, guide, left_end)[0]
                c_a = in_machine(packed, errors, q_a)
                fresh = False
            if free:  # whole turns follow the left end of the cell
                stands.q[:] = q_a[0]
            h = segment_axes.arc_length(kind, how, shape, beside, height, length, a, b)
            half = segment_axes.arc_length(kind, how, shape, beside, height, length, a, middle)
            inside = Place(way + half, middle, middle)
            q_m, _, _, sine = segment_axes.sample(packed, segment, stands, guide, inside)
            room = count - begin + waiting < MOST_CELLS - 1 and h > FINEST_CELL
            if sine >= least:
                if free:
                    stands.q[:] = q_m[0]
                right_end = Place(way + h, b, middle)
                end = segment_axes.sample(packed, segment, stands, guide, right_end)
                q_b, tip, tool, sine = end
            if sine < least and packed.ndim == 2 and room and h > SURE_STEP:
                ends[waiting], sine = middle, least  # a nearer start finds the same joints
                waiting += 1
                continue
            if sine < least:
                break
            c_b, fits = in_machine(packed, errors, q_b), not room
            if room:
                c_m = in_machine(packed, errors, q_m)
                fits = septic_fits(c_a, c_b, h, half, c_m, axes, rounding)
                fits = fits and not too_wide(errors, c_a, c_b)
            if not fits:
                ends[waiting] = middle
                waiting += 1
                continue
            waiting -= 1
            steps[count] = h
            for i in range(n_axes):
                left[count, :, i], right[count, :, i] = c_a[:, axes[i]], c_b[:, axes[i]]
            count += 1
            if b <= 0.5:
                early[row] = count - begin
            tips[count], tools[count] = tip, tool
            c_a = c_b
            a, q_a, fresh, way = b, q_b, (kind == CORNER or guided) and b in grid, way + h
        counts[row] = count - begin
        if sine < least:
            status = UNREACHABLE if sine < 0.0 else SINGULAR
            break
        stands.q[:] = q_a[0]
        if guided and guide[segment_axes.GUIDE_TO] <= 1.0:
            stands.branch[0] = guide[segment_axes.BRANCH_AFTER]
    return (
        status,
        counts[: row + 1],
        early[: row + 1],
        steps[:count],
        left[:count],
        right[:count],
        tips[: count + 1],
        tools[: count + 1],
    )
