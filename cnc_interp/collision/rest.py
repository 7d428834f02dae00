"""The remaining stock: its surface as triangles, and its excess and gouges against the part.

Three fields with lines through the nodes of one grid give the depth of each node along three
directions. Marching tetrahedra turn these depths into a closed surface.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc_interp.collision.follow import CutStock
from cnc_interp.collision.mill_sweep import FAR
from cnc_interp.collision.motions import BEGIN, END, REMOVED, part_of
from cnc_interp.collision.scene import Body
from cnc_interp.collision.stock import Field, crossings, field_of, lines
from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

#: Least distance of nodes from the surface, as a share of the grid; corners then never coincide
#: [-].
APART = 0.01
NODES = 100_000  #: Approximate number of nodes of the grid for drawings.
SMALLEST = 1e-15  #: Pieces that remove less are not divided [m3].
#: A cube in six tetrahedra around its diagonal; corner k lies at (k & 1, k >> 1 & 1, k >> 2).
TETRAHEDRA = (0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)
#: Edges of a tetrahedron that cross the surface, three per triangle, for each number of corners
#: inside. Corners inside come first.
CROSSED = {
    1: ((0, 1), (0, 2), (0, 3)),
    2: ((0, 2), (0, 3), (1, 3), (0, 2), (1, 3), (1, 2)),
    3: ((0, 3), (1, 3), (2, 3)),
}


def stock_triangles(stock: CutStock) -> FloatArray:
    """Return the surface of the remaining stock, (m, 3, 3), in the frame of its link [m].

    The corners run counter-clockwise when seen from outside.
    """
    return _surface([stock.field_along(axis) for axis in range(3)])


def stages_of(stock: CutStock, count: int) -> Iterator[tuple[float, FloatArray]]:
    """Yield path lengths and the remaining stock there, coarsely; stages remove about the same."""
    low, high = stock.body.bounds()
    size = max(stock.pitch, float(np.cbrt((high - low).prod() / NODES)))
    fields = [field_of(stock.body, axis, size, shifted=False) for axis in range(3)]
    yield -np.inf, _surface(fields)
    rows = _divided(stock.rows, stock.rows[:, REMOVED].sum() / count)
    removed = np.cumsum(rows[:, REMOVED])
    shares = np.linspace(0.0, 1.0, count + 1)[1:] * removed[-1:].sum()
    for last in np.unique(np.searchsorted(removed, shares).clip(0, len(removed) - 1) + 1):
        fields = [stock.cut(field, rows[:last]) for field in fields]
        yield float(rows[last - 1, END]), _surface(fields)


def _divided(rows: FloatArray, most: float) -> FloatArray:
    """Divide pieces of motion into parts that each remove about ``most`` at most [m3]."""
    count = np.ceil(rows[:, REMOVED] / max(most, SMALLEST)).clip(1.0).astype(int)
    found, at = np.empty((count.sum(), rows.shape[1])), 0
    for row, parts in zip(rows, count.tolist(), strict=True):
        ends = np.linspace(row[BEGIN], row[END], parts + 1)
        for k in range(parts):
            part_of(row, ends[k], ends[k + 1], found[at])
            found[at, REMOVED] /= parts
            at += 1
    return found


def _surface(fields: list[Field]) -> FloatArray:
    size, depths = float(fields[0].place[2]), []
    low = np.array([fields[axis - 1].place[0] for axis in range(3)])
    for axis, field in enumerate(fields):
        depth = np.full((*field.used.shape, fields[axis - 1].used.shape[0]), -FAR)
        depths_along(field, low[axis], depth)
        depths.append(np.moveaxis(depth, (0, 1, 2), ((axis + 1) % 3, (axis + 2) % 3, axis)))
    least = np.abs(depths).min(axis=0).clip(APART * size, size)
    inside = np.pad(np.where(depths[2] > 0.0, least, -least), 1, mode='edge')
    beyond_grid = np.pad(np.zeros(least.shape), 1, constant_values=size)
    return low + (_march(inside - beyond_grid) - 0.5) * size


@njit(cache=True, nogil=True)
def depths_along(field: Field, low: float, out: FloatArray) -> None:
    """Write the distance of nodes to the next end of material on their line; < 0 outside [m]."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for k in range(out.shape[2]):
                at = low + (k + 0.5) * field.place[2]
                for m in range(field.used[i, j]):
                    begin, end = field.ends[i, j, m]
                    out[i, j, k] = max(out[i, j, k], min(at - begin, end - at))


def _march(inside: FloatArray) -> FloatArray:
    """Return triangles between nodes above and below 0, in units of the grid, (m, 3, 3)."""
    corners = np.array([(k & 1, k >> 1 & 1, k >> 2) for k in range(8)])
    low = np.indices([n - 1 for n in inside.shape]).reshape(3, -1)
    count = sum(inside[tuple(low + c[:, None])] > 0.0 for c in corners)
    low = low[:, (count > 0) & (count < 8)].T
    found = []
    for tetrahedron in TETRAHEDRA:
        nodes = low[:, None] + corners[list(tetrahedron)]
        values = inside[tuple(np.moveaxis(nodes, 2, 0))]
        order = np.argsort(values <= 0.0, axis=1, kind='stable')
        nodes = np.take_along_axis(nodes, order[..., None], axis=1)
        values = np.take_along_axis(values, order, axis=1)
        for number, edges in CROSSED.items():
            mine = (values > 0.0).sum(axis=1) == number
            one, other = (np.take(nodes[mine], np.array(edges)[:, k], axis=1) for k in (0, 1))
            a, b = (np.take(values[mine], np.array(edges)[:, k], axis=1) for k in (0, 1))
            places = one + (a / (a - b))[..., None] * (other - one)
            outward = nodes[mine][:, number:].mean(axis=1) - nodes[mine][:, :number].mean(axis=1)
            triangles = places.reshape(-1, 3, 3)
            normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
            outward = np.repeat(outward, len(edges) // 3, axis=0)
            turned = np.einsum('ij,ij->i', normal, outward) < 0.0
            triangles[turned] = triangles[turned][:, ::-1]
            found.append(triangles)
    return np.concatenate(found)


def against_part(stock: CutStock, part: Body) -> tuple[FloatArray, FloatArray]:
    """Return places on the surface of the part, (n, 3), and the excess there, (n,) [m].

    A gouge is a negative excess. Each place is measured along the lines nearest to its normal.
    Places where the whole line is outside the stock are left out.
    """
    assert part.triangles is not None
    places, found = [], []
    for axis in range(3):
        left = stock.field_along(axis)
        corners = np.ascontiguousarray(np.roll(part.triangles, 2 - axis, axis=2))
        who, ends = crossings(left.place, lines(left), corners, 0.0)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        judged = np.abs(normal).argmax(axis=1)[who[:, 1]] == 2
        along = (normal[:, 2] / np.linalg.norm(normal, axis=1))[who[:, 1]]
        line, height = who[judged, 0], ends[judged, 0]
        found.append(beyond(left, line, height, along[judged]))
        places.append(np.column_stack([lines(left).reshape(-1, 2)[line], height]))
        places[-1] = np.roll(places[-1], axis - 2, axis=1)
    error = np.concatenate(found)
    known = np.isfinite(error)
    return np.concatenate(places)[known], error[known]


@njit(cache=True, nogil=True)
def beyond(field: Field, line: IntArray, height: FloatArray, along: FloatArray) -> FloatArray:
    """Return the excess at places of the part's surface [m]; negative: a gouge, NaN: no stock.

    ``along``: component along the lines of the outward normal at each place [-].
    """
    found = np.full(len(line), np.nan)
    for m in range(len(line)):
        i, j = divmod(line[m], field.used.shape[1])
        sense, missing, excess = np.sign(along[m]), FAR, 0.0
        for k in range(field.used[i, j]):
            ends = sense * (field.ends[i, j, k] - height[m])
            front, back = max(ends[0], ends[1]), min(ends[0], ends[1])
            if back <= 0.0:  # else it lies outside, with a gap
                missing = min(missing, max(-front, 0.0))
                excess = max(excess, front)
        if missing < FAR:
            found[m] = (excess - missing) * abs(along[m])
    return found
