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
from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit

#: Least distance of nodes from the surface, as a share of the grid; corners then never coincide
#: [-].
APART = 0.01
NODES = 100_000  #: Approximate number of nodes of the grid for drawings.
SMALLEST = 1e-15  #: Pieces that remove less are not divided [m3].
LEVEL = 0.1  #: A surface is followed both ways along an axis that its normal leaves by less [-].
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

    A gouge is a negative excess. Each place is measured along the lines nearest to its normal;
    where the surface of the stock is nearer along another axis, that distance counts. Places
    whose whole line is outside the stock are left out.
    """
    assert part.triangles is not None
    fields = [stock.field_along(axis) for axis in range(3)]
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    places, turned, found = [], [], []
    for axis, left in enumerate(fields):
        corners = np.ascontiguousarray(np.roll(part.triangles, 2 - axis, axis=2))
        who, ends = crossings(left.place, lines(left), corners, 0.0)
        judged = np.abs(normals[who[:, 1]]).argmax(axis=1) == axis
        (line, triangle), height = who[judged].T, ends[judged, 0]
        found.append(beyond(left, line, height, normals[triangle, axis]))
        across = lines(left).reshape(-1, 2)[line]
        places.append(np.roll(np.column_stack([across, height]), axis - 2, axis=1))
        turned.append(normals[triangle])
    error = np.concatenate(found)
    known = np.isfinite(error)
    error, place = error[known], np.concatenate(places)[known]
    outward = np.concatenate(turned)[known] * np.sign(error)[:, None]
    size = np.abs(error)
    for axis, left in enumerate(fields):
        down, up = ways_out(left, np.roll(place, 2 - axis, axis=1), error > 0.0).T
        np.minimum(size, up, out=size, where=outward[:, axis] > -LEVEL)
        np.minimum(size, down, out=size, where=outward[:, axis] < LEVEL)
    return place, np.copysign(size, error)


@njit(cache=True, nogil=True)
def ways_out(field: Field, place: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the ways down and up from places, (n, 3), to the next end of material, (n, 2) [m].

    ``inside``: whether each place lies in material. The four lines around a place are followed.
    Where one of them says otherwise, the surface is within a cell.
    """
    out, size = np.full((len(place), 2), FAR), field.place[2]
    for m in range(len(place)):
        low_i = int(np.floor((place[m, 0] - field.place[0]) / size - 0.5))
        low_j = int(np.floor((place[m, 1] - field.place[1]) / size - 0.5))
        for corner in range(4):
            i, j, within = low_i + corner % 2, low_j + corner // 2, False
            if not (0 <= i < field.used.shape[0] and 0 <= j < field.used.shape[1]):
                continue
            for k in range(field.used[i, j]):
                down = place[m, 2] - field.ends[i, j, k, 0]
                up = field.ends[i, j, k, 1] - place[m, 2]
                here = down >= 0.0 and up >= 0.0
                within |= here
                if inside[m] and here:
                    out[m, 0], out[m, 1] = min(out[m, 0], down), min(out[m, 1], up)
                if not inside[m] and up < 0.0:
                    out[m, 0] = min(out[m, 0], -up)
                if not inside[m] and down < 0.0:
                    out[m, 1] = min(out[m, 1], -down)
            if within != inside[m]:
                out[m] = np.minimum(out[m], size)
    return out


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
