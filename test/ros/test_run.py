"""Real processes: programs run to their end, bad input moves nothing, what is unsound is named."""

import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState

from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.convert.conversion import convert
from cnc_interp.core import UM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.run_state import RunId
from cnc_interp.settings.options import Settings
from cnc_interp.wire.path_messages import block_messages

Result = RunProgram.Result
MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
PROGRAM = """PARTNO TEST
UNITS/MM
MULTAX/ON
GOTO/0.0,0.0,0.0,0.10,-0.20,0.974679434
FEDRAT/3000,MMPM
GOTO/10.0,0.0,0.0,0.14,-0.18,0.973653
GOTO/10.0,8.0,1.0,0.15,-0.10,0.983616
GOTO/16.0,12.0,0.0,0.05,-0.12,0.991514
FINI
"""
LAST = (np.array([16.0, 12.0, 0.0]) * 1e-3, np.array([0.05, -0.12, 0.991514]))
TOO_FAR = PROGRAM.replace('16.0,12.0', '1600.0,12.0')
#: The table turns under a resting tool: both ends are inside the travel, the way is not.
TOO_FAR_BETWEEN = 'G21 G90 G94\nM428\nG0 X0 Y569.8 Z0 A0 C0\nG1 C170 F2000\nM30\n'
NO_NUMBER = PROGRAM.replace('10.0,8.0', '10.0,eight')

RUN_FOR_EVER = """
import time
from cnc_interp.processes.node_processes import Children
from cnc_interp.client.session import nodes_file
with Children('/killed', 99, {}, nodes_file()) as nodes:
    print(*(node.process.pid for node in nodes.nodes.values()), flush=True)
    time.sleep(1000)
"""


def assert_at_the_last_pose(position):
    tip, axis = TRANSFORM.forward(np.array([position]))
    assert np.linalg.norm(tip[0] - LAST[0]) < 1e-6
    assert np.linalg.norm(axis[0] - LAST[1] / np.linalg.norm(LAST[1])) < 1e-5


@pytest.fixture(scope='module')
def nodes(shared_nodes):
    return shared_nodes


def test_session_runs_a_program_and_what_the_machine_received_is_proven(tmp_path):
    program, out = tmp_path / 'part.apt', tmp_path / 'received'
    setup = tmp_path / 'kept' / 'setup.yaml'  # in a folder of its own: the command line names it
    setup.parent.mkdir()
    setup.write_text('active: G54\n')
    program.write_text(PROGRAM)
    (result,) = run_session(
        RunRequest(program, settings=Settings(setup=setup), out=out, quiet=True)
    )
    assert result.ok, result.message
    assert result.blocks_sent == result.blocks_executed == 3
    assert_at_the_last_pose(list(result.position.values()))
    proof = verify_plan(out, MACHINE)
    assert proof.ok, proof.text()
    samples = np.load(out / 'setpoints.npz')
    assert len(samples['time']) == result.samples
    assert result.cycle_time == pytest.approx(samples['time'][-1])


@pytest.mark.thorough
def test_native_splines_run_over_the_nodes_and_are_proven(tmp_path):
    program, out = tmp_path / 'curves.mpf', tmp_path / 'received'
    read = read_text(PROGRAM, 'part.apt', TRANSFORM, Settings())
    written = convert(read, MACHINE, Settings(), 'siemens-bspline', 0.01 * UM)
    program.write_text(written.text)
    (result,) = run_session(RunRequest(program, out=out, quiet=True))
    assert result.ok, result.message
    assert written.text.count('BSPLINE') >= 2, 'both corners are curves now'
    assert result.blocks_sent == result.blocks_executed > 10
    assert_at_the_last_pose(list(result.position.values()))
    proof = verify_plan(out, MACHINE)
    assert proof.ok, proof.text()


def test_session_names_a_missing_program_and_a_wrong_machine(tmp_path):
    with pytest.raises(InterpError, match=r'nothing\.ngc'):
        run_session(RunRequest(tmp_path / 'nothing.ngc', quiet=True))


@pytest.mark.parametrize(
    ('text', 'code', 'word'),
    [
        (NO_NUMBER, Result.BAD_PROGRAM, ':7'),
        (TOO_FAR, Result.REFUSED, 'axis X'),
        (TOO_FAR_BETWEEN, Result.REFUSED, ':4: axis Y would have to go to 501.548 mm'),
        ('', Result.BAD_PROGRAM, ''),
    ],
)
def test_a_bad_program_is_refused_and_nothing_moves(nodes, text, code, word):
    before = nodes.next_state()
    result = nodes.run(text=text)
    assert result.code == code and word in result.message and '\n' not in result.message
    assert (result.blocks_sent, result.blocks_executed, result.samples) == (0, 0, 0)
    after = nodes.next_state()
    assert after.commanded_positions == before.commanded_positions
    assert (after.state, after.samples) == (MachineState.IDLE, before.samples)


def test_another_machine_than_the_nodes_run_is_refused(nodes):
    result = nodes.run(text=PROGRAM, machine='xyzbc')
    assert result.code == Result.REFUSED and 'xyzbc' in result.message


def test_programs_run_one_after_the_other_without_restart(nodes):
    first = nodes.run(text=PROGRAM)
    assert (first.code, first.message) == (Result.SUCCEEDED, 'executed to the end')
    state = nodes.next_state()
    assert state.completed and state.state == MachineState.IDLE
    assert_at_the_last_pose(state.positions)
    loaded = nodes.loaded[-1]
    assert (loaded.program_id, loaded.text) == (first.program_id, PROGRAM)
    assert loaded.path_length == pytest.approx(first.path_length, rel=1e-6)
    second = nodes.run(text=PROGRAM)
    assert second.code == Result.SUCCEEDED
    assert second.program_id != first.program_id
    moving = [state for state in nodes.states if state.state == MachineState.RUNNING]
    assert max(state.feedrate for state in moving) > 0.01
    recent = np.max([state.recent_jerk_use for state in nodes.states], axis=0)
    assert 0.1 < recent.max() <= 1.001
    for result in (first, second):
        assert result.blocks_sent == result.blocks_executed == 3
        use = [*result.velocity_use, *result.acceleration_use, *result.jerk_use]
        assert 0.1 < max(use) <= 1.001
    # The way from the end back to the start is an approach of its own and does not count.
    assert second.approach_time > 0.0
    if not first.starvations and not second.starvations:  # a busy computer takes longer
        assert second.cycle_time == first.cycle_time


def test_cancelling_ends_at_rest_on_the_path(nodes):
    handle = nodes.start(text=PROGRAM)
    nodes.spin_until(lambda: nodes.peers.state.state == MachineState.RUNNING)
    handle.cancel_goal_async()
    result = nodes.result_of(handle)
    assert result.code == Result.CANCELED
    assert nodes.next_state().state == MachineState.IDLE


@pytest.mark.thorough
def test_nodes_end_with_a_run_that_is_killed():
    run = subprocess.Popen([sys.executable, '-c', RUN_FOR_EVER], stdout=subprocess.PIPE, text=True)
    nodes = [int(word) for word in run.stdout.readline().split()]
    assert len(nodes) == 4 and all(map(lives, nodes))
    run.kill()
    run.wait()
    deadline = time.monotonic() + 60.0
    while any(map(lives, nodes)):
        assert time.monotonic() < deadline, 'a node outlives its run'
        time.sleep(0.1)


def lives(process):
    """Whether a process runs and is not only remembered."""
    try:
        return ') Z ' not in Path(f'/proc/{process}/stat').read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


def sound_blocks(program_id):
    blocks = read_text(PROGRAM, 'part.apt', TRANSFORM, Settings()).blocks
    return block_messages(blocks, RunId(program_id), 0, 0.03, end=True)


def named(nodes, word):
    return lambda: any('blocks' in name and word in text for name, text in nodes.diagnostics)


@pytest.mark.parametrize(
    ('field', 'value', 'word'),
    [
        ('axis', [0.0, 0.0, 2.0], 'block 0 .* length 2'),
        ('tip', [math.nan, 0.0, 0.0], 'block 0 .* not finite'),
        ('contour_tolerance', -1e-5, 'block 0 .* contour_tolerance'),
        ('sequence', 4, 'gap: 4 of unknown program'),
    ],
)
def test_an_unsound_first_block_is_named_and_nothing_moves(nodes, field, value, word):
    before = nodes.next_state()
    message = sound_blocks(f'bad-{field}')[0]
    setattr(message, field, value)
    nodes.diagnostics.clear()
    nodes.blocks.publish(message)
    parts = word.split(' .* ')
    nodes.spin_until(lambda: all(named(nodes, part)() for part in parts))
    after = nodes.next_state()
    assert after.commanded_positions == before.commanded_positions


def test_motion_ends_at_the_last_sound_block(nodes):
    blocks = sound_blocks('spoiled')
    blocks[2].axis = [math.nan, 0.0, 0.0]
    nodes.diagnostics.clear()
    for message in blocks:
        nodes.blocks.publish(message)
    nodes.spin_until(named(nodes, 'block 2'))
    nodes.spin_until(lambda: nodes.peers.state.program_id == 'spoiled')
    nodes.spin_until(lambda: nodes.peers.state.completed)
    state = nodes.next_state()
    tip, _ = TRANSFORM.forward(np.array([state.commanded_positions]))
    assert state.state == MachineState.IDLE and state.sequence == 1
    assert np.linalg.norm(tip[0] - np.array(blocks[1].tip)) < 1e-9


def test_lost_repeated_and_foreign_blocks_do_not_move_the_machine_off_its_program(nodes):
    blocks = sound_blocks('patchy')
    for i in (0, 0, 2):  # a repeat, and one after a gap
        nodes.blocks.publish(blocks[i])
    nodes.blocks.publish(sound_blocks('foreign')[0])
    nodes.spin_until(named(nodes, 'foreign program foreign'))
    for i in (3, 3, 1, 1, 2):  # the gap is closed after its end came
        nodes.blocks.publish(blocks[i])
    nodes.spin_until(lambda: nodes.peers.state.program_id == 'patchy')
    nodes.spin_until(lambda: nodes.peers.state.completed)
    state = nodes.next_state()
    assert state.sequence == 3
    assert_at_the_last_pose(state.positions)
    assert nodes.run(text=PROGRAM).code == Result.SUCCEEDED
