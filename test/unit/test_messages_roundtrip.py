"""Arrows to messages and back, bit for bit, through the wire format; unsound messages stay out."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1Block, MachineState, PathSegment, SetpointChunk
from programs import blocks_of as blocks_of_points
from programs import spline_segments
from rclpy.serialization import deserialize_message, serialize_message
from tiers import examples

from cnc_interp.core import InterpError, StreamError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_program, read_text
from cnc_interp.run import path_chain
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import CORNER
from cnc_interp.wire import message_checks as soundness
from cnc_interp.wire import path_messages as messages
from cnc_interp.wire.run_messages import add_executed, run_id_of

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / 'shared' / 'programs'
TRANSFORM = Transform.of(Machine.load('xyzac'))
H = 0.03
P = RunId('p')
#: So many blocks of each program.
MOST = examples(80, 2000)

# Every kind of segment: lines, corners, a turn of the resting tool, inverse time, a rapid.
ALL_KINDS = """G21 G90 G94
TRAORI
G0 X0 Y0 Z0 A10 C20
G1 X10 F600
G1 Y10 A14 M0
G93 G1 X0 F12
G94 G1 C80 F600 M1
M30
"""


def example_programs():
    return sorted(
        path for path in (ROOT / 'examples').glob('*') if path.suffix in {'.ngc', '.apt'}
    )


def blocks_of(path):
    return read_program(path, TRANSFORM, Settings(feedrate=0.05)).blocks[:MOST]


def segments_of(blocks, **settings):
    return path_chain.segments_of(blocks, TRANSFORM, Settings(**settings))


def over_the_wire(sent):
    return [deserialize_message(serialize_message(message), type(message)) for message in sent]


def same_bits(first, second):
    for field in fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        assert a.dtype == b.dtype and a.shape == b.shape, field.name
        assert a.tobytes() == b.tobytes(), field.name


def checked(received, check):
    for message in received:
        check(message)
    return received


@pytest.mark.parametrize('path', example_programs(), ids=lambda path: path.name)
def test_examples_keep_every_bit(path):
    keeps_every_bit(blocks_of(path))


@pytest.mark.thorough
@pytest.mark.skipif(not SHARED.is_dir(), reason='no shared programs beside the repository')
def test_real_programs_keep_every_bit():
    tried = 0
    for path in sorted(SHARED.glob('*/*')):
        try:
            blocks = blocks_of(path)
            segments_of(blocks)
        except InterpError:
            continue  # not for this reader or this machine: other tests say so
        keeps_every_bit(blocks)
        tried += 1
    assert tried


def keeps_every_bit(blocks):
    sent = messages.block_messages(blocks, P, 0, H, end=True)
    received = checked(over_the_wire(sent), soundness.check_block)
    same_bits(messages.blocks_from(received), blocks)
    assert [m.sequence for m in received] == list(range(len(blocks)))
    assert [m.end_of_program for m in received] == [False] * (len(blocks) - 1) + [True]
    segments = segments_of(blocks)
    sent = messages.segment_messages(segments, P, 5, H, end=True)
    received = checked(over_the_wire(sent), soundness.check_segment)
    same_bits(messages.segments_from(received), segments)
    assert [m.sequence for m in received] == list(range(5, 5 + len(segments)))


def control_points(knot_interval=0.5):
    tip = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    axis = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.6, 0.8]])
    interval = np.array([np.nan, 0.0, knot_interval])
    top = np.where(np.isnan(interval)[:, None], np.nan, tip + 0.02 * axis)
    return blocks_of_points(tip, axis, top=top, knot_interval=interval)


def test_control_points_of_splines_keep_every_bit():
    blocks = control_points()
    sent = messages.block_messages(blocks, P, 0, H, end=True)
    received = checked(over_the_wire(sent), soundness.check_block)
    assert [m.spline for m in received] == [False, True, True]
    same_bits(messages.blocks_from(received), blocks)


@pytest.mark.parametrize(
    ('field', 'value', 'word'),
    [
        ('knot_interval', -0.1, 'knot_interval is -0.1'),
        ('knot_interval', float('nan'), 'knot_interval'),
        ('top', [float('nan'), 0.0, 0.0], 'top must be'),
        ('top', [0.01, 0.0, 0.02], 'top must be'),
        ('top', [0.01, -0.012, -0.016], 'top must be'),
    ],
)
def test_unsound_control_points_are_refused_by_name(field, value, word):
    message = messages.block_messages(control_points(), P, 0, H, end=True)[2]
    check(message)
    setattr(message, field, value)
    with pytest.raises(StreamError, match=word):
        check(message)


def test_every_kind_of_segment_keeps_every_bit():
    segments = segments_of(read_text(ALL_KINDS, 'kinds.ngc', TRANSFORM, Settings()).blocks)
    assert set(segments.kind.tolist()) == {0, 1, 2}
    sent = messages.segment_messages(segments, P, 0, H, end=False)
    assert not any(m.end_of_program for m in sent)
    same_bits(
        messages.segments_from(checked(over_the_wire(sent), soundness.check_segment)), segments
    )


def test_splines_keep_every_bit():
    segments, _ = spline_segments(1)
    received = over_the_wire(messages.segment_messages(segments, P, 0, H, end=True))
    same_bits(messages.segments_from(checked(received, soundness.check_segment)), segments)


@pytest.mark.parametrize(
    'options',
    [
        {'parametrization': 'paper', 'top': 'tolerance'},
        {'parametrization': 'exact', 'top': 'tolerance', 'septic': True},
        {'parametrization': 'linear'},
        {'corner': 'paper'},
    ],
)
def test_every_way_to_make_a_corner_keeps_every_bit(options):
    blocks = blocks_of(ROOT / 'examples' / 'pyramid.apt')
    segments = segments_of(blocks, **options)
    received = over_the_wire(messages.segment_messages(segments, P, 0, H, end=True))
    back = messages.segments_from(checked(received, soundness.check_segment))
    corner = segments.kind == CORNER
    same_bits(back[np.flatnonzero(corner)], segments[np.flatnonzero(corner)])


def test_a_parametrization_that_does_not_rise_from_0_to_1_is_refused():
    blocks = blocks_of(ROOT / 'examples' / 'pyramid.apt')
    segments = segments_of(blocks, parametrization='paper')
    sent = messages.segment_messages(segments, P, 0, H, end=True)
    corner = next(m for m in sent if m.kind == CORNER)
    corner.parametrization.control_points[-1] = 0.9
    with pytest.raises(StreamError, match='parametrization must rise from 0 to 1'):
        soundness.check_segment(corner)


def setpoints(n=10, axes=5):
    rng = np.random.default_rng(2)
    table = [rng.normal(size=(n, axes)) for _ in range(4)]
    block = np.sort(rng.integers(0, 2**40, n))
    s, line = np.sort(rng.normal(size=n)), np.arange(n)
    return Setpoints(np.arange(n) * 0.001, *table, block, s, line)


@pytest.mark.parametrize('axes', [3, 5])
def test_setpoints_keep_every_bit(axes):
    sent = Chunk(setpoints(axes=axes), setpoints(7, axes), Wait.SINGLE_BLOCK)
    message = messages.chunk_message(sent, RunId('p', 1, 3), 20, 0.001)
    (received,) = over_the_wire([message])
    back = messages.chunk_from(received)
    for name in ('samples', 'tail'):
        for field in ('position', 'velocity', 'acceleration', 'jerk', 'block', 's', 'line'):
            there, here = (getattr(getattr(c, name), field) for c in (back, sent))
            assert there.tobytes() == here.tobytes(), (name, field)
    assert back.wait is Wait.SINGLE_BLOCK
    assert list(received.line_numbers) == list(range(10))
    assert list(received.tail_line_numbers) == list(range(7))
    assert (run_id_of(received), received.first_sample) == (RunId('p', 1, 3), 20)
    assert not received.end_of_program


def sound(kind):
    if kind is SetpointChunk:
        still = Setpoints(
            np.arange(10) * 0.001, *np.zeros((4, 10, 5)), np.ones(10, dtype=int), np.zeros(10)
        )
        chunk = Chunk(still, still[:7], Wait.NOTHING)
        return messages.chunk_message(chunk, P, 0, 0.001)
    if kind is MachineState:
        still = [0.0] * 5
        state = MachineState(positions=still, commanded_positions=still, interpolation_period=1e-3)
        state.feed_override = state.rapid_override = state.spindle_override = 1.0
        return state
    blocks = read_text(ALL_KINDS, 'kinds.ngc', TRANSFORM, Settings()).blocks
    if kind is G1Block:
        return messages.block_messages(blocks, P, 0, H, end=True)[1]
    segments = messages.segment_messages(segments_of(blocks), P, 0, H, end=True)
    return next(m for m in segments if m.kind == PathSegment.CORNER)


def check(message):
    if isinstance(message, MachineState):
        soundness.check_state(message, 5)
    elif isinstance(message, SetpointChunk):
        soundness.check_chunk(message, Machine.load('xyzac'), 0.001, np.zeros((3, 5)))
    elif isinstance(message, G1Block):
        soundness.check_block(message)
    else:
        soundness.check_segment(message)


def test_every_rest_passes_as_the_machine_knows_it():
    for wait in Wait:
        message = sound(SetpointChunk)
        message.wait, message.end_of_program = wait, wait is Wait.END
        check(message)


NAN, INF = float('nan'), float('inf')


@pytest.mark.parametrize(
    ('kind', 'field', 'value', 'word'),
    [
        (G1Block, 'tip', [NAN, 0.0, 0.0], 'tip is not finite'),
        (G1Block, 'tip', [INF, 0.0, 0.0], 'tip is not finite'),
        (G1Block, 'axis', [0.0, 0.0, 1.001], 'length 1.001'),
        (G1Block, 'axis', [0.0, 0.0, 0.0], 'length 0'),
        (G1Block, 'axis', [NAN, 0.0, 1.0], 'length nan'),
        (G1Block, 'rotary', [0.1, NAN], 'both rotary'),
        (G1Block, 'contour_tolerance', -1e-5, 'contour_tolerance'),
        (G1Block, 'contour_tolerance', NAN, 'contour_tolerance'),
        (G1Block, 'orientation_tolerance', 0.0, 'orientation_tolerance'),
        (G1Block, 'flank_height', 0.0, 'flank_height'),
        (G1Block, 'feedrate', 0.0, 'feedrate'),
        (G1Block, 'feedrate', NAN, 'feedrate'),
        (G1Block, 'duration', -1.0, 'duration'),
        (PathSegment, 'kind', 7, 'kind 7'),
        (PathSegment, 'axis', [0.0, 0.6, 0.6], 'length'),
        (PathSegment, 'flank_height', NAN, 'flank_height'),
        (PathSegment, 'feedrate', [0.0, 1.0], 'feedrate'),
        (PathSegment, 'feedrate', [NAN, 1.0], 'feedrate'),
        (PathSegment, 'rotation', [NAN, 0.0, 0.0], 'not finite'),
        (PathSegment, 'connection', [0.0] * 17, 'connection'),
        (PathSegment, 'connection', [NAN] * 18, 'not finite'),
        (SetpointChunk, 'axis_count', 4, '4 axes'),
        (SetpointChunk, 'period', 0.002, 'period'),
        (SetpointChunk, 'positions', [0.0] * 49, '49 values'),
        (SetpointChunk, 'velocities', [NAN] * 50, 'velocities'),
        (SetpointChunk, 'line_numbers', [1] * 9, 'line_numbers'),
        (SetpointChunk, 'sequences', [], 'empty'),
        (SetpointChunk, 'tail_positions', [0.0] * 34, '34 values'),
        (SetpointChunk, 'tail_line_numbers', [1] * 6, 'line_numbers'),
        (SetpointChunk, 'positions', [0.0] * 49 + [1e-6], 'C asked for .* times its largest'),
        (SetpointChunk, 'tail_positions', [0.0] * 30 + [1e-7] + [0.0] * 4, 'X asked for'),
        (SetpointChunk, 'positions', [0.0] * 49 + [1e6], 'C asked'),
        (SetpointChunk, 'positions', [0.6] + [0.0] * 49, 'soft limit: X'),
        (SetpointChunk, 'wait', 8, 'wait 8'),
        (SetpointChunk, 'end_of_program', True, 'wait 0 does not fit'),
        (MachineState, 'commanded_positions', [0.0] * 4, '4 values'),
        (MachineState, 'commanded_positions', [0.0] * 4 + [NAN], 'not finite'),
        (MachineState, 'positions', [], '0 values'),
        (MachineState, 'resume_positions', [0.0], '1 values'),
        (MachineState, 'path_position', NAN, 'path_position'),
        (MachineState, 'interpolation_period', 0.0, 'a working machine has no such state'),
        (MachineState, 'feed_override', INF, 'feed_override'),
        (MachineState, 'feed_override', 1e-7, 'feed_override'),
        (MachineState, 'rapid_override', -1.0, 'rapid_override'),
        (MachineState, 'spindle_override', NAN, 'spindle_override'),
        (MachineState, 'state', 99, 'a working machine has no such state'),
    ],
)
def test_unsound_values_are_refused_by_name(kind, field, value, word):
    message = sound(kind)
    check(message)
    setattr(message, field, value)
    with pytest.raises(StreamError, match=word):
        check(message)


@pytest.mark.parametrize('curve', ['bottom', 'top'])
@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('degree', 2),
        ('dimension', 2),
        ('knots', [0.0] * 4 + [0.4] + [1.0] * 4),
        ('control_points', [0.0] * 12),
        ('control_points', [NAN] * 15),
    ],
)
def test_curves_of_another_shape_are_refused(curve, field, value):
    message = sound(PathSegment)
    setattr(getattr(message, curve), field, value)
    with pytest.raises(StreamError, match=curve):
        check(message)


LINEAR_ROTARY = """G21 G90
G0 X0 Y0 Z30 A10 C0
G0 A-10 C40
G1 X20 C180 F1000
G1 Y10
M428
G1 X30 Y0 A5 C90
G1 X0 A-5 C-90
G1 Z40
M30
"""


@pytest.mark.parametrize('parametrization', ['exact', 'paper'])
def test_linear_rotary_axes_keep_every_bit(parametrization):
    blocks = read_text(LINEAR_ROTARY, 'axes.ngc', TRANSFORM, Settings()).blocks
    assert set(blocks.interpolation.tolist()) == {0, 1, 2}
    keeps_every_bit(blocks)
    segments = segments_of(blocks, parametrization=parametrization)
    kinds = set(zip(segments.kind.tolist(), segments.interpolation.tolist(), strict=True))
    assert {(0, 1), (0, 2), (1, 1), (1, 2)} <= kinds
    sent = messages.segment_messages(segments, P, 0, H, end=True)
    received = messages.segments_from(checked(over_the_wire(sent), soundness.check_segment))
    for field in fields(segments):
        if field.name != 'parametrization' or parametrization == 'exact':
            a, b = getattr(received, field.name), getattr(segments, field.name)
            assert a.tobytes() == b.tobytes(), field.name


def test_linear_rotary_axes_without_positions_are_refused():
    blocks = read_text(LINEAR_ROTARY, 'axes.ngc', TRANSFORM, Settings()).blocks
    row = int(np.flatnonzero(blocks.interpolation)[0])
    message = messages.block_messages(blocks, P, 0, H, end=True)[row]
    soundness.check_block(message)
    message.rotary_from = [np.nan, 0.0]
    with pytest.raises(StreamError, match='both ends'):
        soundness.check_block(message)
    message.interpolation = 3
    with pytest.raises(StreamError, match='interpolation 3'):
        soundness.check_block(message)
    segments = segments_of(blocks)
    corner = int(np.flatnonzero((segments.kind == 1) & (segments.interpolation > 0))[0])
    sent = messages.segment_messages(segments, P, 0, H, end=True)[corner]
    soundness.check_segment(sent)
    sent.rotary[8] = np.nan
    with pytest.raises(StreamError, match='control values of the rotary axes'):
        soundness.check_segment(sent)


def test_a_result_tells_the_times_of_what_was_executed():
    state = MachineState(samples=1201, approach_samples=200, interpolation_period=0.002)
    result = RunProgram.Result()
    add_executed(result, [state])
    assert (result.samples, result.path_length) == (1001, 0.0)
    assert (result.cycle_time, result.approach_time) == pytest.approx((2.0, 0.4))
