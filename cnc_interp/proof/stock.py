"""The proof of ``remaining.npz``: points on lines of the stock, tested against poses of the tool.

On a seeded sample of lines, points lie just inside and outside the ends of intervals, and between
them. The tool is placed in poses so dense that a point can come at most half a step nearer between
two of them. A point inside the mill during a feed has been cut, and a point that the mill never
approaches has not. A point that certainly remains must not lie deep inside the mill of a rapid,
and must keep the clearance from shank and holder.
"""

from math import hypot, sqrt

import numpy as np
from scipy.spatial import ConvexHull

from cnc_interp.collision.scene import Body, Placed, Role
from cnc_interp.core import MM, BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.joint import TOOL_TIP
from cnc_interp.machine_model.signals import Signals
from cnc_interp.proof.clearance import Motion, tools_at
from cnc_interp.proof.clearance_bound import Cells, Links, frames, place

LINES, BETWEEN = 300, 3  #: Number of sampled lines, and of points on each besides those at ends.
#: Largest deviation of pieces of motion, step of the poses, and depth to which a rapid may enter
#: material, as shares of the width of a cell [-].
LEFT, STEP, ENTERS = 0.25, 0.1, 0.375
#: Largest deviation of frusta from the corner of a mill, as a share of its radius [-].
ARC = 0.008
SHIFTS = 0.6180339887498949, 0.7548776662466927  #: Shift of lines in their cells, per row [-].
#: Offset of the lines of a mesh in u and v, so that none runs along an edge [m].
ASIDE = np.array([1.3e-9, 0.91e-9])
SAME = 1e-6  #: Largest relative difference of equal volumes [-].
FAR = 1e9
#: Columns of a solid of revolution: lower height and radius, upper height and radius, radius of
#: its lower corner, and the clearance that it must keep [m]; 1 for a cutter, else 0.
Z0, R0, Z1, R1, CORNER, ROOM, CUTS = range(7)


def prove_stock(motion: Motion, signals: Signals) -> None:
    """Prove that the remaining stock agrees with poses of the tool at sampled points."""
    ledger, placed, cells = motion.ledger, motion.placed, motion.cells
    plan, scene = ledger.plan, motion.placed.scene
    found = plan.summary.get('collision')
    told = found.get('stock') if isinstance(found, dict) else None
    if not plan.remaining or not plan.removal or not isinstance(told, dict):
        ledger.fail('remaining.npz or removal.npz is missing, but the scene has a stock')
        return
    rows = np.asarray(plan.path['block'])[:-1]
    rapid = np.asarray(plan.blocks['rapid'], dtype=np.bool_)[rows]
    tool = tools_at(plan, signals, scene.first_tool, rows)
    number = next(k for k, body in enumerate(scene.bodies) if body.role is Role.STOCK)
    stock, pitch = scene.bodies[number], scene.grid
    line, interval = plan.remaining['line'], plan.remaining['interval']
    left = float((interval[:, 1] - interval[:, 0]).sum()) * pitch**2
    removed = float(plan.removal['removed'].sum())
    for name, value in (('volume', left + removed), ('removed', removed)):
        stated = told.get(name)
        close = isinstance(stated, int | float) and abs(stated - value) <= SAME * (left + removed)
        text = f'summary.json says {name} {stated!r} of the stock, its lines say'
        ledger.require(close, f'{text} {value / MM**3:.6g} mm3')
    points, there = _points(stock, pitch, line, interval)
    solid = _uncut(stock, points)
    numbers = placed.names.index(TOOL_TIP), placed.names.index(stock.link)
    near = np.array([[FAR], [FAR], [0.0]]).repeat(len(points), axis=1)
    profiles = {int(k): _profiles(placed, int(k), number) for k in np.unique(tool)}
    corner = max(float(shape[:, CORNER].max(initial=0.0)) for shape in profiles.values())
    margin = (LEFT + 0.5 * STEP) * pitch + ARC * corner
    sizes, starts = (STEP * pitch, margin, ENTERS * pitch), np.diff(tool, prepend=-1).nonzero()[0]
    for first, last in zip(starts, np.append(starts[1:], len(tool)), strict=True):
        stamp(
            (cells, motion.links, numbers),
            (int(first), int(last)),
            rapid,
            profiles[int(tool[first])],
            points,
            solid,
            sizes,
            near,
        )
    cut, short, at = near
    wrong = there & (~solid | (cut < -margin))
    if not plan.starts_inside:  # else the plan files lack what was cut before the start
        wrong |= ~there & solid & (cut > margin)
    text = f'remaining.npz is wrong at {int(wrong.sum())} of {len(points)} sampled points'
    ledger.require(not wrong.any(), text)
    hits = told.get('hits')
    if hits:
        ledger.fail(f'{hits} hits of the stock that is left')
    elif short.min() < 0.0 and not plan.starts_inside:
        where, _ = motion.line_at(float(at[short.argmin()]))
        ledger.fail(
            f'line {where}: the tool meets remaining material, which the plan does not list'
        )


def _points(
    stock: Body, pitch: float, line: IntArray, interval: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return points on sampled lines, (n, 3) [m], and which of them the plan calls material."""
    low, high = stock.bounds()
    size = np.ceil((high - low)[:2] / pitch).astype(int)
    begin = 0.5 * (low + high)[:2] - 0.5 * size * pitch
    rng = np.random.default_rng(len(line))
    sample = rng.choice(size.prod(), min(LINES, size.prod()), replace=False)
    if len(line):  # half of them where there is material
        sample[::2] = rng.choice(line, len(sample[::2]))
    points, there = [], []
    away = 1.2 * (LEFT + 0.5 * STEP) * pitch
    for number in np.unique(sample):
        i, j = divmod(int(number), int(size[1]))
        u = begin[0] + (i + (SHIFTS[0] * j) % 1.0) * pitch
        v = begin[1] + (j + (SHIFTS[1] * i) % 1.0) * pitch
        mine = interval[np.searchsorted(line, number) : np.searchsorted(line, number, 'right')]
        ends = [(mine + [away, -away]).ravel(), (mine + [-away, away]).ravel()]
        for w in np.concatenate([*ends, rng.uniform(low[2], high[2], BETWEEN)]):
            points.append((u, v, w))
            there.append(bool(((mine[:, 0] <= w) & (w <= mine[:, 1])).any()))
    return np.array(points), np.array(there)


def _uncut(body: Body, points: FloatArray) -> BoolArray:
    """Return which points, (n, 3), lie inside the uncut stock."""
    if body.triangles is None:
        return np.any([_in_piece(*piece, points) for piece in body.pieces], axis=0)
    found = np.zeros(len(points), dtype=np.bool_)
    places, owner = np.unique(points[:, :2], axis=0, return_inverse=True)
    ends = body.triangles[:, :, :2].min(axis=1), body.triangles[:, :, :2].max(axis=1)
    for k, at in enumerate(places + ASIDE):
        near = body.triangles[((ends[0] <= at) & (at <= ends[1])).all(axis=1)]
        normal = np.cross(near[:, 1] - near[:, 0], near[:, 2] - near[:, 0])
        sides = np.roll(near, -1, axis=1)[..., :2] - near[..., :2], at - near[..., :2]
        turns = np.sign(sides[0][..., 0] * sides[1][..., 1] - sides[0][..., 1] * sides[1][..., 0])
        met = (normal[:, 2] != 0.0) & (np.abs(turns.sum(axis=1)) == 3.0)
        slope = ((at - near[:, 0, :2]) * normal[:, :2]).sum(axis=1)[met] / normal[met, 2]
        mine = owner.ravel() == k
        above = near[met, 0, 2] - slope < points[mine, 2][:, None]
        found[mine] = above.sum(axis=1) % 2 == 1
    return found


def _in_piece(discs: FloatArray, along: FloatArray, grown: float, points: FloatArray) -> BoolArray:
    way = points - discs[0, :3]
    if len(discs) == 1:
        return np.asarray(np.linalg.norm(way, axis=1) <= grown)
    if discs[:, 3].any():
        height, top = way @ along, (discs[1, :3] - discs[0, :3]) @ along
        across = np.linalg.norm(way - height[:, None] * along, axis=1)
        radius = discs[0, 3] + (discs[1, 3] - discs[0, 3]) * height / top
        return np.asarray((height >= 0.0) & (height <= top) & (across <= radius))
    planes = ConvexHull(discs[:, :3]).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3] <= 0.0).all(axis=1))


def _profiles(placed: Placed, tool: int, stock: int) -> FloatArray:
    """Return the solids of revolution of a tool, (n, 7)."""
    rows = []
    for k, body in enumerate(placed.scene.bodies):
        cuts = body.role is Role.CUTTER
        corner = body.pieces[0].round if cuts else 0.0
        for piece in (body.pieces[-1:] if cuts else body.pieces) if body.tool == tool > 0 else ():
            (z0, r0), (z1, r1) = piece.discs[:, 2:]
            room = 0.0 if cuts else placed.clearance[k, stock]
            rows.append((z0 - corner, r0, z1, r1, corner, room, cuts))
    return np.array(rows, dtype=float).reshape(-1, 7)


@njit(cache=True, nogil=True)
def distance(row: FloatArray, z: float, r: float) -> float:
    """Return a lower bound of the distance from a solid of revolution; < 0 inside [m]."""
    z0, r0, z1, r1, corner = row[:5]
    slope = (r1 - r0) / (z1 - z0)
    found = max(z0 - z, z - z1, (r - r0 - slope * (z - z0)) / hypot(1.0, slope))
    if z < z0 + corner and r > r0 - corner:
        found = max(found, hypot(r - r0 + corner, z0 + corner - z) - corner)
    return found


@njit(cache=True, nogil=True)
def stamp(
    moved: tuple[Cells, Links, tuple[int, int]],
    span: tuple[int, int],
    rapid: BoolArray,
    profiles: FloatArray,
    points: FloatArray,
    solid: BoolArray,
    sizes: tuple[float, float, float],
    near: FloatArray,
) -> None:
    """Place the tool in poses along cells and update ``near``, (3, n).

    Its rows: the least distance of each point from the mill in feeds; the most by which a
    remaining point came too near to the tool, < 0, and the path length where it did.
    """
    (cells, links, numbers), (step, margin, enters) = moved, sizes
    cut, worst, at = near[0], near[1], near[2]
    n_links, reach = len(links.parent), 0.0
    for row in profiles:
        reach = max(reach, max(abs(row[Z0]), abs(row[Z1])) + max(row[R0], row[R1]))
    turn, origin = np.empty((n_links, 3, 3)), np.empty((n_links, 3))
    q, tool, before = np.empty(cells.left.shape[2]), np.empty(6), np.empty(6)
    travel, due = 0.0, np.zeros(len(points))
    for cell in range(span[0], span[1]):
        s0, s1 = cells.s[cell], cells.s[cell + 1]
        for s, out in ((s1, tool), (s0, before)):
            place(cells, s, q)
            frames(links, q, turn, origin)
            tool_at(turn, origin, numbers, out)
        count = max(1, int(np.ceil(1.05 * _moved(before, tool, reach) / step)))
        for k in range(count + 1):
            s = s0 + (s1 - s0) * k / count
            place(cells, s, q)
            frames(links, q, turn, origin)
            tool_at(turn, origin, numbers, tool)
            travel += _moved(before, tool, reach)
            before[:] = tool
            for p in range(len(points)):
                if travel < due[p] or not solid[p] or cut[p] < -margin:
                    continue
                x, y, w = points[p, 0] - tool[0], points[p, 1] - tool[1], points[p, 2] - tool[2]
                z = x * tool[3] + y * tool[4] + w * tool[5]
                r, nearest = sqrt(max(x * x + y * y + w * w - z * z, 0.0)), FAR
                for row in profiles:
                    found = distance(row, z, r) - row[ROOM]
                    nearest = min(nearest, found)
                    if row[CUTS] and not rapid[cell]:
                        cut[p] = min(cut[p], found)
                        continue
                    short = found + margin + enters * row[CUTS]
                    if short < worst[p] and cut[p] > margin:
                        worst[p], at[p] = short, s
                due[p] = travel + max(nearest - margin - step, 0.0)


@njit(cache=True, nogil=True)
def tool_at(
    turn: FloatArray, origin: FloatArray, numbers: tuple[int, int], out: FloatArray
) -> None:
    """Write tip and axis of the tool in the frame of the stock, (6,) [m, -]."""
    tool, stock = numbers
    out[:3] = turn[stock].T @ (origin[tool] - origin[stock])
    out[3:] = turn[stock].T @ turn[tool, :, 2].copy()


@njit(cache=True, nogil=True)
def _moved(one: FloatArray, other: FloatArray, reach: float) -> float:
    way, tilt = 0.0, 0.0
    for i in range(3):
        way, tilt = way + (one[i] - other[i]) ** 2, tilt + (one[3 + i] - other[3 + i]) ** 2
    return sqrt(way) + reach * sqrt(tilt)
