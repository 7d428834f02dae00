"""Random bodies and paths for tests of clearances, and distances by dense sampling."""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from cnc_interp.collision import shapes
from cnc_interp.collision.clearance import Route, Space
from cnc_interp.collision.enclosure import bezier_table
from cnc_interp.collision.gjk import nearest
from cnc_interp.collision.link_poses import chain_of, step_table
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.machine_model.links import joints_of


def random_piece(rng, size=0.03):
    kind = rng.integers(4)
    if kind == 0:
        return shapes.hull(size * rng.normal(size=(rng.integers(3, 12), 3)))
    if kind == 1:
        half = rng.uniform(0.3, 1.5, 3) * size
        return shapes.box(-half, half)
    if kind == 2:
        profile = np.column_stack([np.sort(rng.uniform(0, 3, 3)), rng.uniform(0.1, 1, 3)])
        return shapes.stack(size * profile)
    return shapes.stack([[0.0, size * rng.uniform(0.2, 0.8)]], round=size * rng.uniform(0.1, 0.3))


def moved(piece, shift):
    discs = piece.discs.copy()
    discs[:, :3] += shift
    return piece._replace(discs=discs)


def random_path(rng, machine, cells=40, length=0.2):
    """A smooth path with all axes in motion, exact derivatives at both ends of each cell."""
    n = len(machine.axis_names)
    linear = machine.is_linear
    s = np.linspace(0.0, length, cells + 1) + 1.0
    turn = rng.uniform(0.3, 3.0, (3, n)) * 2 * np.pi / length
    size = rng.uniform(-1, 1, (3, n)) * np.where(linear, 0.03, 0.25)
    phase = rng.uniform(0, 2 * np.pi, (3, n))
    jets = [
        sum(
            size[k] * turn[k] ** m * np.sin(np.outer(s, turn[k]) + phase[k] + m * np.pi / 2)
            for k in range(3)
        )
        for m in range(4)
    ]
    jets = np.stack(jets)
    stop = np.zeros(cells + 1, dtype=bool)
    stop[[0, -1]] = True
    zeros = np.zeros((cells + 1, 3))
    feed, block = np.full(cells, 0.1), np.arange(cells) // 4 + 1
    return AxisPath(
        s, jets[:, :-1].copy(), jets[:, 1:].copy(), zeros, zeros + [0, 0, 1.0], feed, block, stop
    )


def space_of(machine, pieces, links, clearance=1e-4, child=None):
    chain, names = chain_of(machine)
    numbers = np.array([names.index(link) for link in links])
    body = np.arange(len(pieces))
    child = np.full((len(pieces), 2), -1) if child is None else child
    packed = shapes.gathered(pieces, child, body, numbers)
    allowed = np.full((len(pieces), len(pieces)), clearance)
    return Space(packed, chain, *step_table(chain), allowed)


def route_of(path):
    block_end = np.flatnonzero(np.diff(path.cell_block, append=-1)) + 1
    ends = path.s[block_end[np.searchsorted(block_end, np.arange(len(path.cell_block)), 'right')]]
    return Route(path.s, bezier_table(path), ends)


def link_pose(machine, link, q):
    """Rotation and origin of a link in the base, by SciPy."""
    rotation, place = np.eye(3), np.zeros(3)
    joints = {joint.child: joint for joint in joints_of(machine)}
    while link in joints:
        joint = joints[link]
        shift, turn = np.array(joint.origin), np.eye(3)
        if joint.kind == 'prismatic':
            shift = shift + np.array(joint.along) * q[joint.axis]
        elif joint.axis >= 0:
            turn = Rotation.from_rotvec(np.array(joint.along) * q[joint.axis]).as_matrix()
        rotation, place = turn @ rotation, shift + turn @ place
        link = joint.parent
    return rotation, place


def reach(piece, n):
    across = np.linalg.norm(np.cross(n, piece.along))
    return (piece.discs[:, :3] @ n + piece.discs[:, 3] * across).max() + piece.round


def distance(machine, pieces, links, q, with_normal=False):
    """Distance of two pieces at one position, proven from both sides, and the normal in B."""
    (ra, oa), (rb, ob) = (link_pose(machine, link, q) for link in links)
    rotation, place = rb.T @ ra, rb.T @ (oa - ob)
    packed = shapes.gathered(list(pieces), np.full((2, 2), -1), np.arange(2), np.arange(2))
    out = np.zeros(9)
    found = nearest(packed, 0, 1, np.concatenate([rotation.ravel(), place]), out)
    if found > 0.0:
        n = out[:3]
        apart = -reach(pieces[1], -n) - reach(pieces[0], rotation.T @ n) - place @ n
        assert abs(apart - found) < 1e-8 + 2e-7 * found
    return (found, out[:3]) if with_normal else found


def least_distance(machine, pieces, links, path, samples=400):
    """Least distance along a path, by dense sampling and a search around the lowest samples."""

    def at(s):
        return distance(machine, pieces, links, evaluate(path, np.array([s]))[0][0])

    places = np.linspace(path.s[0], path.s[-1], samples)
    values = np.array([at(s) for s in places])
    best = values.min()
    low = np.flatnonzero(
        (values <= np.r_[np.inf, values[:-1]]) & (values <= np.r_[values[1:], np.inf])
    )
    for k in low[np.argsort(values[low])[:3]]:
        ends = places[max(k - 1, 0)], places[min(k + 1, samples - 1)]
        best = min(
            best, minimize_scalar(at, bounds=ends, method='bounded', options={'xatol': 1e-9}).fun
        )
    return best
