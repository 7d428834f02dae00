"""The proof proves what is right and names what is spoilt, at its axis and sample."""

from __future__ import annotations

import json

import numpy as np
import pytest
from plan_directories import (
    HEIGHT,
    PERIOD,
    files,
    lay_path,
    line_x,
    stroke,
    turned_tip,
    write,
)
from ruckig import InputParameter, Ruckig, Trajectory
from whole_plans import plan_program, write_plan

from cnc_interp.core import DEG, MM, MM_PER_MIN, UM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify, verify_plan
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')


def tool_axis(a, c):
    return np.stack([np.sin(a) * np.sin(c), np.sin(a) * np.cos(c), np.cos(a)], axis=-1)


def rotation(a, c, vertices, **columns):
    """Turn about the resting tip through given angles over time."""
    position = np.column_stack([turned_tip(a, c), a, c])
    rates = [np.gradient(position, PERIOD, axis=0)]
    rates.append(np.gradient(rates[0], PERIOD, axis=0))
    corners = np.array(vertices)
    content = files(
        MACHINE,
        np.stack([position, *rates]),
        np.ones(len(a), int),
        np.zeros((len(corners), 3)),
        np.inf,
        tool_axis(corners[:, 0], corners[:, 1]),
    )
    content['blocks'] |= columns
    content['blocks']['feed'] = np.full(len(corners), 0.1)
    return content


def proof_of(tmp_path, content):
    return verify_plan(write(tmp_path, content), MACHINE)


def only_failure(proof, *words):
    assert not proof.ok
    found = [line for line in proof.failures if all(word in line for word in words)]
    assert found, proof.failures
    return found[0]


def test_a_sound_plan_is_proven(tmp_path):
    proof = proof_of(tmp_path, line_x(MACHINE))
    assert proof.ok, proof.failures
    jerk = proof.largest('jerk', 'X')
    assert jerk.ratio == pytest.approx(1.0, abs=1e-3)
    assert proof.largest('tip feed').ratio == pytest.approx(1.0, abs=1e-6)
    assert proof.largest('velocity', 'C').ratio == 0.0
    assert 'proven' in proof.text()
    assert json.loads(json.dumps(proof.to_json(), allow_nan=False))['ok'] is True


@pytest.mark.parametrize('axis', [0, 1, 2, 3, 4])
def test_one_shifted_sample_is_named_with_its_axis(tmp_path, axis):
    content = line_x(MACHINE)
    content['setpoints']['position'][300, axis] += 1e-6
    proof = proof_of(tmp_path, content)
    failure = only_failure(proof, f'jerk of {MACHINE.axis_names[axis]} ', 'line 30')
    # Two of the four third differences around a spike are equally large.
    assert 'sample 300 ' in failure or 'sample 301 ' in failure
    for other in set(MACHINE.axis_names) - {MACHINE.axis_names[axis]}:
        assert proof.largest('jerk', other).ratio <= 1.001


@pytest.mark.parametrize('end', [0, -1])
def test_a_step_at_either_end_counts_as_motion_from_rest(tmp_path, end):
    content = line_x(MACHINE)
    last = len(content['setpoints']['position']) - 1
    kept = slice(40, None) if end == 0 else slice(None, last - 40)
    for name, column in content['setpoints'].items():
        content['setpoints'][name] = column[kept]
    content['setpoints']['time'] = content['setpoints']['time'] - content['setpoints']['time'][0]
    proof = proof_of(tmp_path, content)
    only_failure(proof, 'jerk of X')
    only_failure(proof, 'away from the first pose' if end == 0 else 'away from the last pose')


def test_a_jerk_limit_exceeded_by_one_percent_is_caught_but_rounding_is_not(tmp_path):
    for factor, ok in ((0.9995, True), (0.99, False)):
        content = line_x(MACHINE)
        held = content['setpoints']['time'][-1]
        # The same stroke on a faster clock: jerk grows with the cube.
        clock = content['setpoints']['time'] * factor ** (-1 / 3)
        x, v, a = (stroke_at(clock.clip(0, held), k) for k in range(3))
        content['setpoints']['position'][:, 0] = x
        content['setpoints']['velocity'][:, 0] = v * factor ** (-1 / 3)
        content['setpoints']['acceleration'][:, 0] = a * factor ** (-2 / 3)
        content['blocks']['feed'] *= 2
        lay_path(MACHINE, content, 12000 * MM_PER_MIN)
        proof = proof_of(tmp_path, content)
        assert proof.ok is ok, proof.failures
        assert proof.largest('jerk', 'X').ratio == pytest.approx(1 / factor, rel=2e-4)


def stroke_at(clock, derivative):
    request = InputParameter(1)
    request.current_position, request.target_position = [0.0], [60 * MM]
    request.max_velocity, request.max_acceleration = [6000 * MM_PER_MIN], [2.5]
    request.max_jerk = [5.0]
    profile = Trajectory(1)
    Ruckig(1).calculate(request, profile)
    return np.array([profile.at_time(min(t, profile.duration))[derivative][0] for t in clock])


def test_contour_error_is_the_distance_from_the_lines(tmp_path):
    content = line_x(MACHINE)
    ramp = np.sin(np.linspace(0, np.pi, len(content['setpoints']['time']))) ** 4
    for height, ok in ((9.9 * UM, True), (10.1 * UM, False)):
        content['setpoints']['position'][:, 1] = height * ramp
        proof = verify(read_plan(write(tmp_path, content)), MACHINE)
        assert proof.largest('contour deviation').value == pytest.approx(height, rel=1e-4)
        assert ('contour' in ' '.join(proof.failures)) is not ok


def test_the_smaller_tolerance_of_two_blocks_counts_at_their_vertex(tmp_path):
    content = line_x(MACHINE)
    content['blocks']['contour_tolerance'][3] = 1 * UM
    x = content['setpoints']['position'][:, 0]
    middle = int(np.searchsorted(x, 29 * MM))
    content['setpoints']['position'][middle, 1] = 2 * UM
    only_failure(proof_of(tmp_path, content), 'contour deviation', f'sample {middle} ', 'line 30')


def test_orientation_counts_at_flank_height(tmp_path):
    content = line_x(MACHINE)
    tilt = 5e-4 * np.sin(np.linspace(0, np.pi, len(content['setpoints']['time']))) ** 4
    flat = content['setpoints']['position'][:, 0]
    content['setpoints']['position'][:, 3] = tilt
    content['setpoints']['position'][:, :3] = turned_tip(tilt, 0 * tilt)
    # The reference arm at X = x stays x in front of the table's rotation about X.
    content['setpoints']['position'][:, 0] = flat
    proof = proof_of(tmp_path, content)
    assert proof.largest('contour deviation').value < 1e-9
    assert proof.largest('orientation deviation').value == pytest.approx(HEIGHT * 5e-4, rel=1e-3)
    only_failure(proof, 'orientation deviation')


def test_a_cut_corner_misses_its_vertex(tmp_path):
    content = line_x(MACHINE)
    origin = content['blocks']['tip'][0]
    content['blocks']['tip'][1] = origin + np.array([15 * MM, 0.3 * MM, 0.0])
    proof = proof_of(tmp_path, content)
    failure = only_failure(proof, 'vertex missed by tip', 'line 20')
    assert '0.3 mm' in failure


def test_a_motion_faster_than_its_block_is_caught(tmp_path):
    content = line_x(MACHINE)
    content['blocks']['feed'][2] = 5900 * MM_PER_MIN
    failure = only_failure(proof_of(tmp_path, content), 'tip feed', 'line 30')
    assert '6000 mm/min, limit 5900 mm/min' in failure


@pytest.mark.parametrize('words', ['feed', 'duration'])
def test_a_feed_override_of_the_run_is_allowed(tmp_path, words):
    content = line_x(MACHINE)
    if words == 'duration':
        content['blocks']['feed'][:] = np.nan
        content['blocks']['duration'] = np.array([1.0, 15, 15, 30]) * MM / (6000 * MM_PER_MIN)
        content['blocks']['duration'] *= 1.2
    else:
        content['blocks']['feed'] /= 1.2
        only_failure(proof_of(tmp_path, content), 'programmed feed of path')
        for name in ('programmed_feed', 'feed_limit'):
            content['path'][name] = content['path'][name] / 1.2
    only_failure(proof_of(tmp_path, content), 'tip feed')
    content['summary']['overrides'] = [[0, 1.2, 1.0]]
    proof = proof_of(tmp_path, content)
    assert proof.ok, proof.failures
    content['summary']['overrides'] = [[0, 1.19, 1.0]]
    only_failure(proof_of(tmp_path, content), 'tip feed')


def test_inverse_time_and_rapid_blocks(tmp_path):
    content = line_x(MACHINE)
    content['blocks']['feed'][:] = np.nan
    length = np.array([1.0, 15, 15, 30]) * MM
    content['blocks']['duration'] = length / (6000 * MM_PER_MIN)
    assert proof_of(tmp_path, content).ok
    content['blocks']['duration'] = content['blocks']['duration'] * 1.01
    only_failure(proof_of(tmp_path, content), 'tip feed')
    content['blocks']['rapid'][:] = True
    assert proof_of(tmp_path, content).ok


def test_order_time_and_exact_stops(tmp_path):
    content = line_x(MACHINE)
    content['blocks']['exact_stop'] = np.array([False, False, True, True])
    only_failure(proof_of(tmp_path, content), 'no rest at the exact stop of line 30')
    content = line_x(MACHINE)
    content['setpoints']['block'] = content['setpoints']['block'][::-1].copy()
    only_failure(proof_of(tmp_path, content), 'runs backwards')
    content = line_x(MACHINE)
    content['setpoints']['time'][500:] += 0.2 * PERIOD
    only_failure(proof_of(tmp_path, content), 'time is not uniform')


@pytest.mark.parametrize(
    'text',
    [
        'G0 X0\nG1 X10 F3000\nX5',
        'G0 X0\nG1 X10 F3000\nM0\nX5\nM0\nX8\nM0\nX2\nX9',
        'TRAORI\nG0 X0 A10 C0\nG1 C20 F3000\nC10\nG9\nC15\nX10',
    ],
)
def test_a_stop_that_the_tool_has_passed_before_is_kept(tmp_path, text):
    program = read_text(text, 'a.ngc', Transform.of(MACHINE), Settings())
    write_plan(plan_program(program, MACHINE), tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.failures


def test_travel_is_checked(tmp_path):
    content = line_x(MACHINE, length=510 * MM)
    failure = only_failure(proof_of(tmp_path, content), 'X exceeds its travel')
    assert 'by 10 mm' in failure


def test_spoilt_columns_and_path_are_caught(tmp_path):
    for file, name, words in (
        ('setpoints', 'velocity', 'velocity column of X'),
        ('setpoints', 'acceleration', 'acceleration column of X'),
        ('path', 'tip', 'path pose against its axes'),
        ('path', 'feed', 'planned feed'),
    ):
        content = line_x(MACHINE)
        row = content[file][name]
        row[200] += 0.2
        only_failure(proof_of(tmp_path, content), words)


def test_a_pure_rotation_follows_the_great_circle(tmp_path):
    angle, _, _ = stroke(20 * DEG, MACHINE.max_velocity[3], MACHINE.max_acceleration[3], 5.0)
    content = rotation(angle, 0 * angle, [(0.0, 0.0), (20 * DEG, 0.0)])
    proof = proof_of(tmp_path, content)
    assert proof.ok, proof.failures
    content['blocks']['axis'][1] = tool_axis(np.array(20.1 * DEG), np.array(0.0))
    only_failure(proof_of(tmp_path, content), 'vertex missed by top')
    only_failure(proof_of(tmp_path, content), 'away from the last pose')


def test_rotary_words_rule_a_pure_rotation(tmp_path):
    turn, _, _ = stroke(90 * DEG, MACHINE.max_velocity[4], MACHINE.max_acceleration[4], 5.0)
    tilt = np.full_like(turn, 15 * DEG)
    ends = [(15 * DEG, 0.0), (15 * DEG, 90 * DEG)]
    worded = rotation(tilt, turn, ends, rotary=np.array(ends))
    shift = worded['path']['tip'][0] - worded['blocks']['tip'][0]
    worded['blocks']['tip'] += shift
    proof = proof_of(tmp_path, worded)
    assert proof.ok, proof.failures
    vector = rotation(tilt, turn, ends)
    vector['blocks']['tip'] += shift
    only_failure(proof_of(tmp_path, vector), 'orientation deviation')
    worded['blocks']['rotary'] = np.array([ends[0], (15 * DEG, 450 * DEG)])
    only_failure(proof_of(tmp_path, worded), 'rotary word missed')


def test_a_rotation_about_the_tool_axis_must_reach_its_word(tmp_path):
    turn, _, _ = stroke(90 * DEG, MACHINE.max_velocity[4], MACHINE.max_acceleration[4], 5.0)
    ends = [(0.0, 0.0), (0.0, 90 * DEG)]
    content = rotation(0 * turn, turn, ends, rotary=np.array(ends))
    assert proof_of(tmp_path, content).ok
    content['blocks']['rotary'][1, 1] = 91 * DEG
    only_failure(proof_of(tmp_path, content), 'rotary word missed')


def test_a_rotation_about_the_tool_axis_must_stop_at_its_exact_stop(tmp_path):
    turn, _, _ = stroke(180 * DEG, MACHINE.max_velocity[4], MACHINE.max_acceleration[4], 5.0)
    ends = [(0.0, 0.0), (0.0, 90 * DEG), (0.0, 180 * DEG)]
    content = rotation(0 * turn, turn, ends, rotary=np.array(ends))
    content['setpoints']['block'] = np.where(turn <= 90 * DEG, 1, 2)
    lay_path(MACHINE, content, np.inf)
    assert proof_of(tmp_path, content).ok
    content['blocks']['exact_stop'] = np.array([False, True, True])
    only_failure(proof_of(tmp_path, content), 'no rest at the exact stop of line 20')


def test_a_worded_rotation_must_keep_to_its_linear_way(tmp_path):
    turn, _, _ = stroke(90 * DEG, MACHINE.max_velocity[4], MACHINE.max_acceleration[4], 5.0)
    ends = [(15 * DEG, 0.0), (15 * DEG, 90 * DEG)]
    bump = 1e-3 * np.sin(2 * turn) ** 4
    first, last = tool_axis(*np.array(ends[0])), tool_axis(*np.array(ends[1]))
    share, angle = (turn / (90 * DEG))[:, None], np.arccos(first @ last)
    circle = (np.sin((1 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)
    ways = {
        'a bump in the tilt': (15 * DEG + bump, turn),
        'the great circle': (np.arccos(circle[:, 2]), np.arctan2(circle[:, 0], circle[:, 1])),
    }
    for way in ways.values():
        content = rotation(*way, ends, rotary=np.array(ends))
        content['blocks']['tip'] += content['path']['tip'][0] - content['blocks']['tip'][0]
        only_failure(proof_of(tmp_path, content), 'orientation deviation')


def test_a_timed_rotation_takes_its_time(tmp_path):
    angle, _, _ = stroke(20 * DEG, MACHINE.max_velocity[3], MACHINE.max_acceleration[3], 5.0)
    content = rotation(angle, 0 * angle, [(0.0, 0.0), (20 * DEG, 0.0)])
    spent = (len(angle) - 1) * PERIOD
    content['blocks']['duration'] = np.array([np.nan, spent])
    assert proof_of(tmp_path, content).ok
    content['blocks']['duration'][1] = spent * 1.02
    only_failure(proof_of(tmp_path, content), 'rotation time')


def test_a_stop_beside_its_vertex_is_missed(tmp_path):
    content = line_x(MACHINE)
    content['blocks']['exact_stop'] = np.array([False, False, False, True])
    assert proof_of(tmp_path, content).ok
    content['blocks']['tip'][3, 1] += 5e-6
    only_failure(proof_of(tmp_path, content), 'exact stop missed', 'line 40')


def test_the_faster_feed_counts_near_the_border_only(tmp_path):
    content = line_x(MACHINE)
    x = content['setpoints']['position'][:, 0]
    vertex = 3 * MM
    content['blocks']['tip'][1] = content['blocks']['tip'][0] + np.array([vertex, 0.0, 0.0])
    content['setpoints']['block'] = np.where(x <= vertex, 1, content['setpoints']['block'].clip(2))
    steps = np.diff(x) / PERIOD
    last = int(np.searchsorted(x, vertex)) - 2
    lay_path(MACHINE, content, 6000 * MM_PER_MIN)
    for earlier, ok in ((1, True), (6, False)):
        content['blocks']['feed'][1] = steps[last - earlier]
        content['path']['programmed_feed'][:] = 6000 * MM_PER_MIN
        proof = proof_of(tmp_path, content)
        assert proof.ok is ok, proof.failures


def test_the_planner_s_grid_is_looked_at(tmp_path):
    def spoil(change):
        content = line_x(MACHINE)
        path = content['path']
        cells = len(path['s']) - 1
        path['cell_left'] = np.zeros((4, cells, 5))
        path['cell_right'] = np.zeros((4, cells, 5))
        path['cell_left'][0], path['cell_right'][0] = path['q'][:-1], path['q'][1:]
        path['cell_left'][1, :, 0] = path['cell_right'][1, :, 0] = 1.0
        change(path)
        return proof_of(tmp_path, content)

    def bulge(path):
        path['q'][200, 1] += 15e-6
        path['tip'][200, 1] += 15e-6
        path['cell_left'][0, 200, 1] += 15e-6
        path['cell_right'][0, 199, 1] += 15e-6

    def tear(path):
        path['cell_left'][0, 200, 2] += 1e-6

    def hurry(path):
        path['cell_right'][1, 300, 3] = 100.0

    def turn_back(path):
        path['s'][300] = path['s'][302]

    assert spoil(lambda path: None).ok
    only_failure(spoil(bulge), 'contour deviation of path')
    only_failure(spoil(tear), 'axes across path cells')
    only_failure(spoil(hurry), 'planned velocity of A')
    only_failure(spoil(turn_back), 's must increase')


def test_the_stated_cycle_time_and_the_first_row(tmp_path):
    content = line_x(MACHINE)
    content['summary']['cycle_time'] -= 2.5 * PERIOD
    only_failure(proof_of(tmp_path, content), 'summary.json says cycle_time')
    content = line_x(MACHINE)
    content['setpoints']['block'] = np.maximum(content['setpoints']['block'], 2)
    only_failure(proof_of(tmp_path, content), 'line 20 comes before it')


def test_blocks_far_shorter_than_the_tolerance(tmp_path, monkeypatch):
    content = line_x(MACHINE, length=6 * MM)
    tip = np.zeros((12001, 3))
    tip[:, 0] = np.linspace(0, 6 * MM, 12001)
    long = content['blocks']
    dense = {name: np.repeat(column[:1], 12001, axis=0) for name, column in long.items()}
    dense['tip'] = long['tip'][0] + tip
    dense['line'] = np.arange(12001)
    x = content['setpoints']['position'][:, 0]
    # Labels lag by thirty blocks, 15 um, as a fitted curve's labels may.
    block = (np.searchsorted(tip[:, 0], x) - 30).clip(1, 12000)
    content['setpoints']['block'] = block
    content['blocks'] = dense
    lay_path(MACHINE, content, 6000 * MM_PER_MIN)
    proof = proof_of(tmp_path, content)
    assert proof.ok, proof.failures
    monkeypatch.setattr('cnc_interp.proof.program_shapes.REACH', 0.0)
    only_failure(verify_plan(tmp_path, MACHINE), 'contour deviation')


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(InterpError, match='no such directory'):
        read_plan(tmp_path / 'nowhere')
    directory = write(tmp_path, line_x(MACHINE))
    whole = (directory / 'setpoints.npz').read_bytes()
    for spoilt in (b'', whole[: len(whole) // 2], b'not an archive'):
        (directory / 'setpoints.npz').write_bytes(spoilt)
        with pytest.raises(InterpError, match=r'setpoints\.npz: cannot be read'):
            read_plan(directory)
    (directory / 'setpoints.npz').unlink()
    with pytest.raises(InterpError, match=r'setpoints\.npz: cannot be read \(missing\)'):
        read_plan(directory)


@pytest.mark.parametrize(
    ('file', 'name', 'value', 'words'),
    [
        ('blocks', 'feed', None, 'column feed is missing'),
        ('setpoints', 'position', np.zeros((5, 5)), 'column position has shape'),
        ('path', 'cell_left', np.zeros((4, 3, 5)), 'column cell_left has shape'),
        ('setpoints', 'velocity', 'nan', 'velocity is not finite in row 7'),
        ('setpoints', 'block', 'big', 'block runs from'),
    ],
)
def test_wrong_columns_are_named(tmp_path, file, name, value, words):
    content = line_x(MACHINE)
    if value is None:
        del content[file][name]
    elif isinstance(value, str):
        content[file][name][7] = np.nan if value == 'nan' else 99
    else:
        content[file][name] = value
    with pytest.raises(InterpError, match=words):
        read_plan(write(tmp_path, content))


def test_three_axes(tmp_path):
    machine = Machine.load('xyz')
    directory = write(tmp_path, line_x(machine))
    proof = verify_plan(directory, machine)
    assert proof.ok, proof.failures
    other = verify_plan(directory, MACHINE)
    only_failure(other, 'the plan has 3 axes, machine xyzac has 5')
    assert 'NOT proven' in other.text()
