"""Streams stopped, held, slowed and planned anew at random places: on the path, within limits."""

import contextlib
from functools import cache

import numpy as np
import pytest
import whole_plans
from programs import pyramid, zigzag
from tiers import examples, few_of

from cnc_interp.core import StreamError
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.overrides import OVERRIDES, OperatorSettings, sound_override
from cnc_interp.run.setpoints import Interpolator, Setpoints, Wait
from cnc_interp.settings.options import Settings

T = 1e-3
MACHINE = Machine.load('xyzac')
LIMITS = (MACHINE.max_velocity, MACHINE.max_acceleration, MACHINE.max_jerk)
PROGRAMS = {'pyramid': pyramid, 'zigzag': lambda: zigzag(0), 'fine': lambda: zigzag(3, 20, 1e-3)}
NAMES = few_of(3, PROGRAMS)
SEEDS = few_of(9, ('zigzag', 'fine', 'pyramid'), range(3))


@cache
def path_of(name) -> AxisPath:
    return whole_plans.path_of(PROGRAMS[name](), Transform.of(MACHINE), Settings())


def stream_of(name):
    stream = MotionStream(MACHINE, T)
    stream.push(path_of(name))
    stream.end_leg(Wait.END)
    return stream


def drain(stream, until=10**9):
    """Take chunks until the stream ends or so many setpoints came."""
    chunks, count = [], 0
    while count < until:
        if stream.current.can_sample:
            new = stream.current.sample()
        elif stream.current.can_plan:
            stream.current.plan()
            continue
        else:
            break
        chunks += new
        count += sum(len(chunk.samples) for chunk in new)
    return chunks


def revised(stream, number, settings):
    """Adopt a revision where there is one."""
    revision = stream.revision(number, settings)
    if revision is not None:
        stream.adopt(revision)
    return revision is not None


def joined(chunks):
    return Setpoints.concatenate([chunk.samples for chunk in chunks])


def assert_sound(samples, path, from_rest=True):
    """Within all limits by differences, down to rest, forward and on the path."""
    q = samples.position
    held = np.concatenate([np.tile(q[:1], (3 if from_rest else 0, 1)), q, np.tile(q[-1:], (3, 1))])
    for order, limit in enumerate(LIMITS, start=1):
        use = np.abs(np.diff(held, order, axis=0)).max(axis=0) / T**order / limit
        assert use.max() <= 1.001, (order, use)
    assert (np.diff(samples.s) >= -1e-15).all()
    assert np.abs(q - evaluate(path, samples.s)[0]).max() < 1e-11
    assert not samples.velocity[-1].any() and not samples.acceleration[-1].any()


@pytest.mark.parametrize('name', NAMES)
def test_chunks_are_the_interpolated_plan_bit_for_bit(name):
    path, samples = path_of(name), joined(drain(stream_of(name)))
    interpolator = Interpolator(T)
    plain = Setpoints.concatenate(
        [interpolator.push(plan_path(path, MACHINE)), interpolator.finish()]
    )
    assert np.array_equal(samples.position, plain.position)
    assert_sound(samples, path)
    assert (samples.s[0], samples.s[-1]) == (0.0, path.s[-1])


@pytest.mark.parametrize('name', NAMES)
def test_every_chunk_can_be_stopped_after_it(name):
    path, chunks = path_of(name), drain(stream_of(name))
    samples = joined(chunks)
    count, stops = 0, 0
    for chunk in chunks:
        count += len(chunk.samples)
        before = samples[max(0, count - 4) : count]
        assert_sound(Setpoints.concatenate([before, chunk.tail]), path, from_rest=count <= 4)
        stops += len(chunk.tail) > 0
    assert chunks[-1].wait is Wait.END and len(chunks[-1].tail) == 0
    assert stops > 0.9 * len(chunks)
    assert max(len(chunk.tail) for chunk in chunks) < 3.5 / T


@pytest.mark.parametrize('name', PROGRAMS)
@pytest.mark.parametrize('speed', [1e-20, 1e-18, 1e-16, 1e-12, 1e-6])
def test_a_stop_from_all_but_rest_is_one_or_none(name, speed):
    path = path_of(name)
    state = (0.5 * (path.s[0] + path.s[1]), speed, 0.0)
    stop = stop_law(path, state, MACHINE.limits.table, 0.0)
    assert stop is not None or speed <= 1e-12
    if stop is not None:
        s, v, a, _ = stop.law.evaluate(np.array([0.0, stop.law.end_time]))
        assert (s[0], v[0], a[0]) == state and s[1] >= s[0] and max(abs(v[1]), abs(a[1])) < 1e-9


@pytest.mark.parametrize(('name', 'seed'), SEEDS)
def test_stopped_anywhere_and_resumed_runs_the_whole_path(name, seed):
    rng, path, stream = np.random.default_rng(seed), path_of(name), stream_of(name)
    s = 0.0
    for _ in range(6):
        chunks = drain(stream, until=int(rng.integers(20, 1500)))
        executed = chunks[: int(rng.integers(1, len(chunks) + 1))]
        ran = Setpoints.concatenate([joined(executed), executed[-1].tail])
        assert_sound(ran, path)
        assert ran.s[0] == s or abs(ran.s[0] - s) < 1e-12
        s = float(ran.s[-1])
        stream.release(s)
        if executed[-1].wait is Wait.END:
            break
        stream.resume(s, stream.current.settings)
    rest = drain(stream)
    if rest:
        assert_sound(joined(rest), path)
        assert abs(rest[0].samples.s[0] - s) < 1e-12 and rest[-1].wait is Wait.END


@pytest.mark.parametrize('name', NAMES)
def test_stopped_by_the_last_tail_the_run_ends_at_the_end_of_the_path(name):
    path, stream = path_of(name), stream_of(name)
    *chunks, end = drain(stream)
    assert end.wait is Wait.END
    # what the stream has sampled after this chunk was never executed
    tail = chunks[-1].tail
    stream.resume(float(tail.s[-1]), stream.current.settings)
    rest = drain(stream)
    assert rest[-1].wait is Wait.END
    assert_sound(Setpoints.concatenate([tail[-1:], joined(rest)]), path)
    assert np.abs(joined(rest).position[-1] - path.cell_right[0, -1]).max() < 1e-12


@pytest.mark.parametrize(('name', 'seed'), SEEDS)
def test_override_changes_anywhere_keep_limits_and_path(name, seed):
    rng, path, stream = np.random.default_rng(100 + seed), path_of(name), stream_of(name)
    sent, queue, accepted, override = [], [], 0, 1.0
    while True:
        count = sum(len(chunk.samples) for chunk in sent)
        wanted = float(rng.choice([0.0, 0.01, 0.1, 0.5, 0.9, 1.2, 1.5]))
        if sent and revised(stream, count - 1, OperatorSettings(wanted)):
            queue, override, accepted = [], wanted, accepted + 1
        queue += drain(stream, until=int(rng.integers(20, 1200)))
        if override == 0.0 and queue and not stream.current.can_sample:
            assert queue[-1].wait is Wait.OVERRIDE
        take = int(rng.integers(1, len(queue) + 1)) if queue else 0
        sent, queue = sent + queue[:take], queue[take:]
        if sent[-1].wait is Wait.END:
            break
    assert accepted > 5
    samples = joined(sent)
    assert_sound(samples, path)
    assert samples.s[-1] == path.s[-1]


#: What a topic may carry: sound, tiny, and impossible values.
SAID = (0.0, 5e-324, 1e-7, 9.9e-4, 0.001, 0.01, 0.3, 1.0, 1.5, 2.0, -1.0, 1e300, np.nan, np.inf)


@pytest.mark.parametrize(('name', 'seed'), SEEDS)
def test_whatever_is_said_as_an_override_the_motion_ends_at_override_1(name, seed):
    """After 0.001 and 1 the motion crawled on; 1e-7 starved; NaN, -1 and 5e-324 ended a run."""
    rng, path, stream = np.random.default_rng(200 + seed), path_of(name), stream_of(name)
    sent, override = drain(stream, until=200), 1.0
    for _ in range(examples(12, 40)):
        if sent[-1].wait is Wait.END:
            break
        with contextlib.suppress(StreamError):
            override = sound_override('feed_override', float(rng.choice(SAID)))
        count = sum(len(chunk.samples) for chunk in sent)
        assert revised(stream, count - 1, OperatorSettings(override)), override
        new = drain(stream, until=int(rng.integers(20, 200)))
        if override == 0.0 and not stream.current.can_sample:
            assert (new or sent)[-1].wait is Wait.OVERRIDE
        sent += new
    count = sum(len(chunk.samples) for chunk in sent)
    if sent[-1].wait is not Wait.END:
        assert revised(stream, count - 1, OperatorSettings(1.0))
        rest = drain(stream)
        assert len(joined(rest)) < 4 * len(joined(drain(stream_of(name))))
        sent += rest
    samples = joined(sent)
    assert_sound(samples, path)
    assert sent[-1].wait is Wait.END and samples.s[-1] == path.s[-1]


@pytest.mark.parametrize('name', OVERRIDES)
def test_only_sound_overrides_count(name):
    least, most = OVERRIDES[name]
    for value in (least, most, 1.0):
        assert sound_override(name, value) == value
    for value in (np.nan, np.inf, -np.inf, -1.0, -5e-324, 1e300, np.nextafter(most, 2.0)):
        with pytest.raises(StreamError, match=rf'{name} is .*must lie between'):
            sound_override(name, value)
    for value in (5e-324, 1e-7, 9.99e-4):
        if name == 'feed_override':
            assert sound_override(name, value) == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize('name', NAMES)
def test_a_revision_that_is_dropped_leaves_no_trace(name):
    rng, stream, chunks, revised = np.random.default_rng(7), stream_of(name), [], 0
    while not chunks or chunks[-1].wait is not Wait.END:
        chunks += drain(stream, until=int(rng.integers(20, 400)))
        count = sum(len(chunk.samples) for chunk in chunks)
        settings = OperatorSettings(float(rng.choice([0.0, 0.4, 1.3])), single_block=True)
        revision = stream.revision(max(0, count - int(rng.integers(1, 200))), settings)
        revised += revision is not None
    untouched = drain(stream_of(name))
    assert revised > 3 and stream.current.settings == OperatorSettings()
    assert np.array_equal(joined(chunks).position, joined(untouched).position)
    tails = [chunk.tail.position for chunk in chunks], [chunk.tail.position for chunk in untouched]
    assert all(np.array_equal(*pair) for pair in zip(*tails, strict=True))


def test_a_lower_override_slows_at_once_and_down_to_its_feed():
    path, stream = path_of('pyramid'), stream_of('pyramid')
    chunks = drain(stream, until=600)
    count = sum(len(chunk.samples) for chunk in chunks)
    assert revised(stream, count - 1, OperatorSettings(0.3))
    after = joined(drain(stream))
    speed = np.diff(after.s) / T
    assert speed[60] < speed[:20].min()
    assert speed[400:].max() <= 0.3 * 0.05 * (1 + 1e-6)
    assert_sound(Setpoints.concatenate([joined(chunks), after]), path)


def test_single_block_rests_where_the_block_changes():
    path, stream = path_of('zigzag'), stream_of('zigzag')
    chunks = drain(stream, until=300)
    count = sum(len(chunk.samples) for chunk in chunks)
    assert revised(stream, count - 1, OperatorSettings(1.0, single_block=True))
    after = drain(stream)
    waits = [chunk.samples.s[-1] for chunk in after if chunk.wait is Wait.SINGLE_BLOCK]
    changes = path.s[1:-1][np.diff(path.cell_block) != 0]
    assert len(waits) >= 8 and np.isin(waits, changes).all()
    assert_sound(Setpoints.concatenate([joined(chunks), joined(after)]), path)


def test_after_a_block_with_a_pause_it_waits():
    path, stream = path_of('zigzag'), MotionStream(MACHINE, T)
    stream.pause_blocks[4] = Wait.OPTIONAL_STOP
    stream.push(path)
    stream.end_leg(Wait.END)
    chunks = drain(stream)
    waits = [chunk.wait for chunk in chunks if chunk.wait is not Wait.NOTHING]
    assert waits == [Wait.OPTIONAL_STOP, Wait.END]
    assert_sound(joined(chunks), path)
