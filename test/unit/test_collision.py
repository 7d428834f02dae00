"""Clearances along the path, against distances by dense sampling; and faults of a checker."""

from pathlib import Path

import numpy as np
import pytest
from collision_cases import (
    distance,
    least_distance,
    link_pose,
    moved,
    random_path,
    random_piece,
    reach,
    route_of,
    space_of,
)
from scipy.spatial.transform import Rotation
from tiers import examples

from cnc_interp.collision import clearance, gjk, shapes
from cnc_interp.collision.clearance import descend
from cnc_interp.collision.enclosure import enclose
from cnc_interp.collision.gjk import nearest
from cnc_interp.collision.hits import largest_motion, least_apart, nearest_along
from cnc_interp.collision.link_poses import chain_of, pose_links
from cnc_interp.collision.pieces import triangle_tree, winding
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine_model.machine import Machine, machines_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.proof.clearance import links_of
from cnc_interp.proof.clearance_bound import Cells, Solids, certified

MACHINES = 'xyzac', 'head_head', 'head_table', 'xyzacw'
LINKS = {
    'xyzac': [('tool_tip', 'workpiece'), ('z_slide', 'a_table'), ('tool_tip', 'base_link')],
    'head_head': [('tool_tip', 'workpiece'), ('a_head', 'base_link')],
    'head_table': [('tool_tip', 'workpiece'), ('b_head', 'c_table')],
    'xyzacw': [('tool_tip', 'workpiece'), ('c_table', 'w_slide')],
}


def case(seed, off=None):
    """A machine, two pieces that come near each other, and a path."""
    rng = np.random.default_rng(seed)
    name = MACHINES[seed % len(MACHINES)]
    machine = Machine.load(name)
    path = random_path(rng, machine)
    links = LINKS[name][rng.integers(len(LINKS[name]))]
    one, other = random_piece(rng), random_piece(rng)
    q = evaluate(path, path.s[[len(path.s) // 2]])[0][0]
    (_, oa), (rb, ob) = (link_pose(machine, link, q) for link in links)
    way = rng.normal(size=3)
    way *= rng.uniform(0.03, 0.12) / np.linalg.norm(way)
    return machine, (one, moved(other, rb.T @ (oa - ob) + way)), links, path


def found_in(machine, pieces, links, path, clearance_of_pair, search=descend):
    space, route = space_of(machine, list(pieces), links, clearance_of_pair), route_of(path)
    cells = 0, len(path.s) - 1
    return space, search(space, route, cells, np.array([[0, 1]]), np.full((2, 2), -np.inf), 1)


def proven(machine, space, path, found):
    cells = Cells(path.s, path.cell_left, path.cell_right)
    pieces = space.pieces
    solids = Solids(*(getattr(pieces, name) for name in Solids._fields))
    rows = np.lexsort((found.span[:, 1], found.span[:, 0]))
    return certified(solids, links_of(machine), cells, found.span, found.pair, found.normal, rows)


@pytest.mark.parametrize('file', sorted(machines_directory().glob('*.yaml')), ids=lambda f: f.stem)
def test_links_are_where_the_transformation_has_the_tool(file):
    machine, rng = Machine.load(file), np.random.default_rng(0)
    chain, names = chain_of(machine)
    for q in rng.normal(scale=0.4, size=(5, len(machine.axis_names))):
        pose = np.empty((len(names), 12))
        pose_links(chain, q, pose)
        tool, work = (pose[names.index(link)] for link in ('tool_tip', 'workpiece'))
        turn = work[:9].reshape(3, 3).T
        tip, axis = Transform.of(machine).forward(q[None])
        np.testing.assert_allclose(turn @ (tool[9:] - work[9:]), tip[0], atol=1e-13)
        np.testing.assert_allclose(turn @ tool[:9].reshape(3, 3)[:, 2], axis[0], atol=1e-13)
        for name in names:
            rotation, place = link_pose(machine, name, q)
            found = pose[names.index(name)]
            np.testing.assert_allclose(found, [*rotation.ravel(), *place], atol=1e-13)


def test_a_distance_has_a_plane_between_the_pieces_and_points_on_both():
    rng = np.random.default_rng(1)
    apart = 0
    for seed in range(examples(60, 600)):
        one, other = random_piece(rng), random_piece(rng)
        packed = shapes.gathered([one, other], np.full((2, 2), -1), np.arange(2), np.arange(2))
        turn = Rotation.random(random_state=seed).as_matrix()
        shift = rng.normal(scale=0.06, size=3)
        out = np.empty(9)
        found = nearest(packed, 0, 1, np.concatenate([turn.ravel(), shift]), out)
        if found == 0.0:
            continue
        apart += 1
        n = out[:3]
        plane = -reach(other, -n) - reach(one, turn.T @ n) - shift @ n
        points = np.linalg.norm(turn @ out[3:6] + shift - out[6:]) - one.round - other.round
        assert abs(plane - found) < 1e-7 * found + 1e-9
        assert abs(points - found) < 1e-12
    assert apart > 30


def test_the_search_for_the_nearest_points_keeps_four_at_most(monkeypatch):
    """A shank in a block: four points held 0 up to rounding, and a fifth had no place."""
    cylinder = np.array([[0.0, 0.0, 0.002, 0.002], [0.0, 0.0, 0.02, 0.002]])
    shank = shapes.Piece(cylinder, np.array([0.0, 0.0, 1.0]))
    corners = [(x, y, z) for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (-0.01, 0.0)]
    packed = shapes.gathered(
        [shank, shapes.hull(np.array(corners))], np.full((2, 2), -1), np.arange(2), np.arange(2)
    )
    shift = -2.3835064707239395e-05, -0.003049999999999997, -0.001999999796619689
    pose = np.concatenate([np.eye(3).ravel(), shift])
    # Python raises an error where compiled code writes beyond the array.
    monkeypatch.setattr(gjk, 'affine_minimum', gjk.affine_minimum.py_func)
    assert nearest.py_func(packed, 0, 1, pose, np.empty(9)) < 1e-9, 'the shank is 0.2 nm deep'


def test_the_path_lies_in_its_enclosure():
    for seed in range(examples(4, 40)):
        rng = np.random.default_rng(seed)
        path = random_path(rng, Machine.load('xyzac'))
        route = route_of(path)
        begin, end = np.sort(rng.uniform(path.s[0], path.s[-1], 2))
        first, last = np.searchsorted(path.s, [begin, end], 'right') - 1
        motion = np.empty((3, 5))
        enclose(route.s, route.bezier, begin, end, first, last, motion)
        s = np.linspace(begin, end, 500)
        t = np.linspace(-1.0, 1.0, 500)[:, None]
        beside = np.abs(evaluate(path, s)[0] - motion[0] - t * motion[1])
        assert (beside <= motion[2] + 1e-12).all()
        assert (beside.max(axis=0) >= 0.3 * motion[2] - 1e-9).all(), 'the bound is far too wide'


def test_nothing_is_missed_and_nothing_is_false_near_the_clearance():
    """The clearance is the least distance, more or less up to 0.3 mm; sampling is the judge."""
    judged = 0
    for seed in range(examples(12, 400)):
        machine, pieces, links, path = case(seed)
        least = least_distance(machine, pieces, links, path, samples=examples(80, 1000))
        rng = np.random.default_rng(1000 + seed)
        for sign in (1.0, -1.0):
            off = sign * 10.0 ** rng.uniform(-5.3, -3.5)
            if least + off < 1e-5:
                continue
            space, found = found_in(machine, pieces, links, path, least + off)
            assert len(found.hit) == (sign > 0.0), (seed, off)
            assert (proven(machine, space, path, found) >= least + off).all()
            judged += 1
            if len(found.hit):  # the first contact, to a micrometre
                q = evaluate(path, found.hit[:1, 0])[0][0]
                assert distance(machine, pieces, links, q) <= least + off + 1.1e-6
    assert judged >= examples(12, 400)


def test_the_least_distance_of_all_cells_is_found():
    for seed in range(examples(8, 200)):
        machine, pieces, links, path = case(seed)
        space, route = space_of(machine, list(pieces), links, 0.0), route_of(path)
        cells, moved_so_far = (0, len(path.s) - 1), largest_motion(space, route)
        found = nearest_along(space, route, cells, moved_so_far, np.array([[0, 1]]), np.inf)
        some = np.append(np.arange(0, cells[1], 1 + cells[1] // 60), found[2])
        each = [distance(machine, pieces, links, q) for q in evaluate(path, path.s[some])[0]]
        assert each[-1] == pytest.approx(found[0], abs=1e-7)
        assert min(each) > found[0] - 1e-7


def test_certificates_and_hits_leave_no_gap():
    for seed in range(10):
        machine, pieces, links, path = case(seed)
        least = least_distance(machine, pieces, links, path, 80)
        if least > 1e-4:
            break
    _, found = found_in(machine, pieces, links, path, least - 2e-5)
    order = np.argsort(found.span[:, 0])
    span = found.span[order]
    assert span[0, 0] == path.s[0] and span[-1, 1] == path.s[-1]
    assert (span[1:, 0] == span[:-1, 1]).all()


def mutant(old, new):
    """The descent with a fault, from its own source; it runs without numba."""
    source = Path(clearance.__file__).read_text()
    assert source.count(old) == 1, old
    space = {'__name__': 'mutant'}
    text = source.replace(old, new).replace(
        'from cnc_interp.core.kernels import njit',
        'def njit(**options):\n    return lambda function: function',
    )
    exec(compile(text, 'mutant', 'exec'), space)
    return space['descend']


MUTANTS = {
    'without res': ('max(ahead, behind) - res - rest', 'max(ahead, behind) - rest'),
    'without rem': ('max(ahead, behind) - res - rest', 'max(ahead, behind) - res'),
    'wrong sense': (
        'sense * motion[1, axis], motion[2, axis]',
        'motion[1, axis], motion[2, axis]',
    ),
    'displacement without angles': ('way += chord * lever', 'way += 0.0'),
}


@pytest.mark.parametrize('fault', MUTANTS)
def test_a_fault_of_the_checker_shows_in_its_certificates(fault):
    """Outcomes alone do not show it: without ``rem`` nothing was missed in 100 cases."""
    search, wrong = mutant(*MUTANTS[fault]), 0
    for seed in range(examples(40, 200)):
        machine, pieces, links, path = case(seed)
        allowed = 1e-4 if seed % 2 else 2e-3
        space, found = found_in(machine, pieces, links, path, allowed, search)
        wrong += int((proven(machine, space, path, found) < allowed).sum())
        if wrong:
            return
    pytest.fail(f'{fault}: no certificate contradicts')


def test_the_checker_itself_makes_no_such_certificate():
    search = mutant('STILL = 0.4e-6', 'STILL = 4e-7')
    for seed in range(6):
        machine, pieces, links, path = case(seed)
        space, found = found_in(machine, pieces, links, path, 1e-4, search)
        _, compiled = found_in(machine, pieces, links, path, 1e-4)
        assert (proven(machine, space, path, found) >= 1e-4).all()
        np.testing.assert_array_equal(found.span, compiled.span)


def cube(half):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return corners[np.array(faces)]


def test_a_tree_of_boxes_holds_its_triangles():
    rng = np.random.default_rng(3)
    triangles = rng.normal(size=(57, 3, 3))
    pieces, child = triangle_tree(triangles)
    leaves = [k for k in range(len(pieces)) if child[k, 0] < 0]
    assert len(leaves) == 57 and len(pieces) == 113
    found = sorted(tuple(pieces[k].discs[:, :3].ravel()) for k in leaves)
    assert found == sorted(map(tuple, triangles.reshape(-1, 9)))
    for k, parts in enumerate(child):
        for part in parts[parts >= 0]:
            for n in rng.normal(size=(20, 3)):
                assert reach(pieces[k], n) >= reach(pieces[part], n) - 1e-12


def test_a_closed_mesh_winds_once_around_what_is_inside():
    mesh = cube(0.02)
    assert winding(mesh, np.array([0.001, 0.002, 0.0])) == pytest.approx(1.0)
    assert winding(mesh, np.array([0.03, 0.0, 0.0])) == pytest.approx(0.0)


def test_a_mesh_decides_as_its_triangles_do():
    """The mill between two walls of a mesh: its hull would always be hit."""
    machine = Machine.load('xyzac')
    for seed in range(examples(3, 12)):
        rng = np.random.default_rng(seed)
        path = random_path(rng, machine, cells=12)
        tool = shapes.hull([[0.0, 0, 0], [0, 0, 0.03]], 0.002)
        mesh = cube(0.01).reshape(-1, 3)
        q = evaluate(path, path.s[[6]])[0][0]
        (_, oa), (rb, ob) = (link_pose(machine, k, q) for k in ('tool_tip', 'workpiece'))
        mesh = (mesh + rb.T @ (oa - ob) + [0.03, 0.02 * rng.normal(), -0.02]).reshape(-1, 3, 3)
        tree, child = triangle_tree(mesh)
        pieces = [tool, *tree]
        leaf = [shapes.hull(triangle) for triangle in mesh]
        pair = 'tool_tip', 'workpiece'
        least = min(least_distance(machine, (tool, t), pair, path, 60) for t in leaf)
        for off in (3e-5, -3e-5):
            if least + off < 1e-5:
                continue
            children = np.vstack([[-1, -1], np.where(child >= 0, child + 1, -1)])
            links = ['tool_tip', *['workpiece'] * len(tree)]
            space = space_of(machine, pieces, links, least + off, children)
            body = np.array([0, *[1] * len(tree)])
            space = space._replace(pieces=space.pieces._replace(body=body))
            found = descend(
                space, route_of(path), (0, 12), np.array([[0, 1]]), np.full((2, 2), -np.inf), 9
            )
            assert (len(found.hit) > 0) == (off > 0.0)
            assert (proven(machine, space, path, found) >= least + off).all()


def test_how_deep_two_bodies_overlap():
    """A ball of 5 mm, 3 mm deep in a wall."""
    machine = Machine.load('xyzac')
    path = random_path(np.random.default_rng(0), machine, cells=4)
    q = evaluate(path, path.s[:1])[0][0]
    rotation, place = link_pose(machine, 'workpiece', q)
    tip = rotation.T @ (link_pose(machine, 'tool_tip', q)[1] - place)
    ball, wall = shapes.hull(np.zeros((1, 3)), 0.005), shapes.box(-np.ones(3), np.ones(3))
    space = space_of(machine, [ball, moved(wall, tip - [0, 0, 0.998])], ['tool_tip', 'workpiece'])
    depth = least_apart(space, route_of(path), 0, 1, path.s[0], path.s[0] + 1e-9)
    assert depth == pytest.approx(-0.007, abs=1e-6)


@pytest.mark.thorough
def test_a_contact_that_is_short_for_its_line_has_its_distance():
    """A ball passes another one by 0.05 mm, in 1.6 mm of a line of 200 mm."""
    machine = Machine.load('xyzac')
    ends = np.zeros((2, len(machine.axis_names)))
    ends[:, 0] = -0.1, 0.1
    bezier = (ends[0] + np.linspace(0.0, 1.0, 8)[:, None] * (ends[1] - ends[0])).T[None]
    route = clearance.Route(np.array([0.0, 0.2]), np.ascontiguousarray(bezier), np.array([0.2]))
    links = 'tool_tip', 'workpiece'
    (_, tip), (turn, place) = (link_pose(machine, link, ends.mean(axis=0)) for link in links)
    large, small = (shapes.hull(np.zeros((1, 3)), size) for size in (0.005, 0.001))
    other = moved(small, turn.T @ (tip - place - [0.0, 0.0, 6.05e-3]))
    space = space_of(machine, [large, other], links, 1e-4)
    found = descend(space, route, (0, 1), np.array([[0, 1]]), np.full((2, 2), -np.inf), 1)
    begin, end = found.hit[0, :2]
    assert begin == pytest.approx(0.1 - np.sqrt(6.1**2 - 6.05**2) * 1e-3, abs=2e-6)
    assert least_apart(space, route, 0, 1, begin, end) == pytest.approx(5e-5, abs=2e-6)
