"""Random programs with rotary words: axes on their lines, words met, corners within bounds."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline
from tiers import examples, few_of
from whole_plans import plan_program

from cnc_interp.core import DEG, MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks import AXES_LINEAR, ROTARY_LINEAR
from cnc_interp.proof.verify import verify
from cnc_interp.run.path_chain import segments_of
from cnc_interp.settings.options import Settings

SOURCE = Path(__file__).parents[2] / 'benchmarks' / 'rotary_words.py'
spec = importlib.util.spec_from_file_location('rotary_words', SOURCE)
rotary_words = importlib.util.module_from_spec(spec)
spec.loader.exec_module(rotary_words)

MACHINES = rotary_words.rotary_machines()
COUNT = examples(1, 60)
KNOTS = [0.0] * 4 + [0.5] + [1.0] * 4
HEIGHT, TOLERANCE = 30 * MM, 0.02 * MM


def vertices(text, machine, zero):
    """Axis words of every block, by a reader of its own: lengths, rotary axes at flank height."""
    here, found = np.zeros(len(machine.axis_names)), []
    here[:3] = zero
    for line in text.splitlines():
        words = {word[0]: float(word[1:]) for word in line.split()}
        if not set(words) & set(machine.axis_names):
            continue
        for k, name in enumerate(machine.axis_names):
            if name in words:
                offset = zero[k] if name in 'XYZ' else 0.0
                here[k] = offset + words[name] * (DEG if name in 'ABC' else MM)
        found.append(here.copy())
    return np.array(found)


def distances(points, start, end):
    """Distance of points from the nearest point of each line, shape (points, lines)."""
    way = end - start
    square = np.maximum((way**2).sum(axis=1), 1e-30)
    share = np.clip(((points[:, None] - start) * way).sum(axis=2) / square, 0.0, 1.0)
    return np.linalg.norm(points[:, None] - start - share[..., None] * way, axis=2)


@pytest.mark.parametrize('name', few_of(6, MACHINES))
def test_axes_run_on_lines_to_their_words(name):
    machine = Machine.load(name)
    transform = Transform.of(machine)
    zero = transform.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    scale = np.where(machine.is_linear, 1.0, HEIGHT)
    for seed in range(COUNT):
        text = rotary_words.random_program(np.random.default_rng([5, seed]), machine, tcp=False)
        plan = plan_program(read_text(text, 't.ngc', transform, Settings()), machine)
        corners = vertices(text, machine, zero) * scale
        q = plan.setpoints.position * scale
        assert np.abs(q[-1] - corners[-1]).max() < 1e-12
        # At one point of its line X Y Z and the rotary axes are within a tolerance each.
        off = distances(q, corners[:-1], corners[1:]).min(axis=1)
        assert off.max() <= np.sqrt(2.0) * TOLERANCE
        passed = np.array([np.linalg.norm(q - corner, axis=1).min() for corner in corners])
        steps = np.linalg.norm(np.diff(q, axis=0), axis=1).max()
        assert passed.max() <= np.sqrt(2.0) * TOLERANCE + steps
        proof = verify(rotary_words.files_of(plan), machine)
        assert proof.ok, (seed, proof.failures)
        steps = np.diff(corners, axis=0)
        steps = steps[np.linalg.norm(steps, axis=1) > 0.0]
        ways = steps / np.linalg.norm(steps, axis=1)[:, None]
        reversals = (ways[:-1] * ways[1:]).sum(axis=1) < np.cos(176.0 * DEG)
        assert plan.segments.stop.sum() == 1 + reversals.sum()


@pytest.mark.parametrize('name', few_of(6, MACHINES))
def test_words_near_the_pole_are_met_with_tool_tips(name):
    machine = Machine.load(name)
    transform = Transform.of(machine)
    scale = np.where(machine.is_linear, 1.0, HEIGHT)
    tip = [k for k, name in enumerate(machine.axis_names) if name in 'XYZ']
    for seed in range(COUNT):
        text = rotary_words.random_program(np.random.default_rng([6, seed]), machine, tcp=True)
        plan = plan_program(read_text(text, 't.ngc', transform, Settings()), machine)
        proof = verify(rotary_words.files_of(plan), machine)
        assert proof.ok, (seed, proof.failures)
        assert rotary_words.words_missed(text, plan, tcp=True) < 1e-9
        # The tool rests beside turns about a resting tip, where the path turns back, and beside
        # blocks so short that they stay poses.
        steps = np.diff(vertices(text, machine, np.zeros(3)), axis=0) * scale
        steps = steps[np.linalg.norm(steps, axis=1) > 0.0]
        rests = np.linalg.norm(steps[:, tip], axis=1) <= Settings().longest_block
        backs = (steps[:-1, tip] * steps[1:, tip]).sum(axis=1) <= np.cos(170.0 * DEG) * (
            np.linalg.norm(steps[:-1, tip], axis=1) * np.linalg.norm(steps[1:, tip], axis=1)
        )
        assert plan.segments.stop.sum() <= 1 + (rests[:-1] | rests[1:] | backs).sum()


@pytest.mark.parametrize(('name', 'tcp'), few_of(7, MACHINES, (False, True)))
def test_corners_in_coordinates_stay_within_their_bounds(name, tcp):
    machine = Machine.load(name)
    transform = Transform.of(machine)
    u, fine = np.linspace(0.0, 1.0, 41), np.linspace(0.0, 1.0, 4001)
    tried = 0
    for seed in range(max(COUNT, 4)):
        text = rotary_words.random_program(np.random.default_rng([7, seed]), machine, tcp)
        blocks = read_text(text, 't.ngc', transform, Settings()).blocks
        segments = segments_of(blocks, transform, Settings())
        wanted = ROTARY_LINEAR if tcp else AXES_LINEAR
        for i in np.flatnonzero((segments.kind == 1) & (segments.interpolation == wanted)):
            values = np.hstack([segments.bottom[i], segments.rotary[i], segments.extra[i]])[:5]

            def poses(at, in_axes=not tcp):
                tip, axis = transform.forward(at)
                tip = tip if in_axes else at[:, :3]
                return np.hstack([tip, tip + HEIGHT * axis])

            curve = poses(BSpline(KNOTS, values, 3)(u))
            # The programmed poses: lines from P0 to the vertex P2 and on to P4.
            legs = [
                values[a] + fine[:, None] * (values[b] - values[a]) for a, b in ((0, 2), (2, 4))
            ]
            program = poses(np.vstack(legs))
            apart = np.linalg.norm((curve[:, None] - program).reshape(41, -1, 2, 3), axis=3)
            # The place on the program is the same for tip and top point.
            use = (apart / TOLERANCE).max(axis=2).min(axis=1)
            step = np.abs(np.diff(program, axis=0)).max() / TOLERANCE
            assert use.max() <= 1.0 + step
            assert segments.deviation[i].max() <= TOLERANCE * (1.0 + 1e-6)
            assert np.linalg.norm(values[1] - values[2]) > 0.0
            tried += 1
    assert tried or tcp


def test_an_axis_beside_its_line_is_found_where_the_tool_does_not_show_it():
    machine = Machine.load('xyzac')
    # The tip stands on the C axis, and the tool is vertical: C moves nothing else.
    text = 'G21 G90\nG0 X-40 Y70 Z0 A0 C0\nG1 Z20 C90 F500\nM30'
    program = read_text(text, 't.ngc', Transform.of(machine), Settings())
    files = rotary_words.files_of(plan_program(program, machine))
    assert verify(files, machine).ok
    position = files.position.copy()
    share = np.linspace(0.0, 1.0, len(position))
    position[:, 4] += 1.0 * DEG * np.sin(np.pi * share) ** 4
    bent = replace(files, setpoints={**files.setpoints, 'position': position})
    failures = verify(bent, machine).failures
    assert any('axes beside their line' in failure for failure in failures)
    other = replace(files, blocks={**files.blocks, 'rotary': files.blocks['rotary'].copy()})
    other.blocks['rotary'][-1, 1] += 360.0 * DEG
    failures = verify(other, machine).failures
    assert any('rotary word missed' in failure for failure in failures)


def planned_words(name, tcp):
    """A plan whose last two blocks end on rotary words away from the pole, and its machine."""
    machine = Machine.load(name)
    outer = Transform.of(machine).outer
    ends = {3 + outer: (5, 40), 4 - outer: (12, 25)}
    words = [
        ' '.join(
            f'{machine.axis_names[k]}{end[i]}'
            for k, end in ends.items()
            if np.ptp(machine.travel[k]) > 1e-6
        )
        for i in range(2)
    ]
    text = '\n'.join(
        [
            'G21 G90 G94',
            *(['M428'] if tcp else []),
            f'G0 X0 Y0 Z0 {words[0]}',
            f'G1 X8 Y5 {words[1]} F1500',
            'X16 Y0',
            'M30',
        ]
    )
    transform = Transform.of(machine)
    program = read_text(text, 't.ngc', transform, Settings())
    return machine, transform, rotary_words.files_of(plan_program(program, machine))


def with_positions(files, position):
    return replace(files, setpoints={**files.setpoints, 'position': position})


def other_branch(transform, q):
    """The same poses with the other solution of the rotary axes, without jumps."""
    tip, axis = transform.forward(q)
    rotary = []
    for pair, o in zip(q[:, 3:5], axis, strict=True):
        far = max(
            transform.rotary_solutions(o),
            key=lambda found: np.abs(np.sin(0.5 * (found - pair))).max(),
        )
        rotary.append(far)
    other = q.copy()
    other[:, 3:5] = np.unwrap(rotary, axis=0)
    other[:, :3] = transform.linear(tip, other[:, 3:5])
    if q.shape[1] > 5:
        other[:, :3] -= q[:, 5:] @ transform.machine.extra_direction
    return other


@pytest.mark.parametrize(('name', 'tcp'), few_of(9, MACHINES, (False, True)))
def test_check_finds_the_wrong_branch_and_the_wrong_turn(name, tcp):
    """The poses are right at every moment; only axes and words differ."""
    machine, transform, files = planned_words(name, tcp)
    assert verify(files, machine).ok
    outer = 3 + transform.outer
    turned = files.position.copy()
    turned[:, outer] += 2.0 * np.pi
    for position in (other_branch(transform, files.position), turned):
        for mine, theirs in zip(
            transform.forward(position), transform.forward(files.position), strict=True
        ):
            assert np.abs(mine - theirs).max() < 1e-9
        failures = verify(with_positions(files, position), machine).failures
        assert any('rotary word missed' in failure for failure in failures), failures


def rests_on_the_pole(seed, inner):
    """Lines that turn C at a resting tip on the pole or beside it by a digit, then leave it."""
    rng = np.random.default_rng(seed)
    turn, tip = rng.uniform(-180, 180), rng.uniform(-40, 40, 3)
    poses = [(tip, 0.0, turn)]
    for _ in range(rng.integers(1, 5)):
        turn += rng.uniform(0.2, 1) * rng.choice([0.05, 3, 29, 120, -75])
        poses.append((tip, rng.choice([0.0, 0.0, 0.0005, 0.001, 0.003]), turn))
    if rng.random() < 0.7:
        poses.append((tip + rng.uniform(-0.4, 0.4, 3), 0.0, turn))
    for _ in range(2):
        tip = tip + rng.uniform(-3, 3, 3)
        turn += rng.uniform(-3, 3)
        poses.append((tip, rng.uniform(0.2, 8), turn))
    words = [f'X{x:.4f} Y{y:.4f} Z{z:.4f} {inner}{a:.4f} C{c:.4f}' for (x, y, z), a, c in poses]
    return '\n'.join(['G21 G90', 'M128', *(f'G1 {line} F600' for line in words), 'M2', ''])


@pytest.mark.parametrize('seed', range(examples(6, 200)))
def test_lines_that_turn_on_the_pole_run_and_meet_their_words(seed):
    """Where the tool axis hardly turns, C does; a run of them became a line, and C was lost."""
    name, inner = (('xyzac', 'A'), ('xyzbc', 'B'))[seed % 2]
    machine = Machine.load(name)
    text = rests_on_the_pole(seed, inner)
    plan = plan_program(read_text(text, 't.ngc', Transform.of(machine), Settings()), machine)
    assert not verify(rotary_words.files_of(plan), machine).failures
    last = np.degrees(plan.setpoints.position[-1, 3:5])
    words = [float(word[1:]) for word in text.splitlines()[-2].split() if word[0] in inner + 'C']
    np.testing.assert_allclose(last, words, atol=1e-3)


@pytest.mark.parametrize('name', few_of(6, MACHINES))
def test_check_finds_each_axis_beside_its_line(name):
    """With TCP off every axis is compared, also where the others hide it from the tool."""
    machine, _, files = planned_words(name, tcp=False)
    share = np.linspace(0.0, 1.0, len(files.position))
    for k, axis in enumerate(machine.axis_names):
        position = files.position.copy()
        size = 0.1 * MM if machine.is_linear[k] else 0.1 * MM / HEIGHT
        position[:, k] += size * np.sin(np.pi * share) ** 4
        failures = verify(with_positions(files, position), machine).failures
        assert any('axes beside their line' in failure for failure in failures), (axis, failures)
