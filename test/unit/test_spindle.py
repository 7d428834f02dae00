"""The spindle: axes in step with its angle, the speed that goes out, the feed in a turn."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from test_functions_played import MACHINE, Bench, T, milling
from tiers import few_of

from cnc_interp.core import MM, ProgramError
from cnc_interp.machine.spindle import Spindle, see_angle
from cnc_interp.machine_model.signals import Signals, signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_state import Reason, State
from cnc_interp.settings.options import Settings

NAMES = [signal.name for signal in MACHINE.signals.wires]
SPEED, FORWARD, REVERSE = (
    NAMES.index(f'spindle_{name}') for name in ('speed', 'forward', 'reverse')
)
ANGLE = [signal.name for signal in MACHINE.signals.inputs].index('spindle_angle')
START, LEAD = 'G0 X0 Y0 Z5\nS900 M3\n', 1.5
TAP, THREAD = (f'{START}{code} Z-10 K{LEAD}\nG0 X10\nM30' for code in ('G33.1', 'G33'))


def finished(bench, each=lambda: None, most=9000):
    """Run to the end, or to a fault; ``each`` is called after every period."""
    for _ in range(most):
        bench.step()
        each()
        if bench.play.state.completed or bench.play.state.state in (State.FAULT, State.HELD):
            return bench.play.state.state
    raise AssertionError(f'not executed: {bench.play.state}')


def lines(bench):
    """Yield place [turns of the lead] and angle [rev] in each period of every line in step."""
    for _, parts in groupby(bench.play.followed, key=lambda part: part.block):
        each = list(parts)
        z = np.concatenate([part.position[:, 2] for part in each])
        held = np.pad(z, 3, mode='edge')
        for order, limit in enumerate(MACHINE.limits.by_order[:, 2], start=1):
            assert np.abs(np.diff(held, order)).max() <= limit * T**order * (1 + 1e-6)
        yield (z[0] - z) / (LEAD * MM), np.concatenate([part.angle for part in each])


def drooping(bench, share=0.06):
    """Let the load slow the spindle down while the tool is below Z 0, within some 0.1 s."""
    droop = [0.0]

    def each():
        deep = bench.play.axes.setpoints[-1][2] < 0.0
        droop[0] += (share * deep - droop[0]) * T / 0.1
        speed = bench.drives.memory[10]  # of the simulated spindle [rev/s]
        bench.drives.inputs[ANGLE] -= droop[0] * speed * T

    return each


@pytest.mark.parametrize('reverse', few_of(2, [True, False]))
def test_a_tapped_hole_is_in_step_in_and_out_with_a_spindle_that_droops(reverse):
    bench = Bench(TAP.replace('M3', 'M4') if reverse else TAP)
    assert finished(bench, drooping(bench)) is State.IDLE
    ((place, angle),) = lines(bench)
    deep = place > 3.0
    off = (-angle if reverse else angle)[deep] - place[deep]
    # The thread begins at an index, and no place of it is off by more, on the way out as well.
    assert np.abs(off - np.round(off[0])).max() * LEAD < 6e-3
    assert abs(place.max() - 10.0) < 0.15 and place[-1] == 0.0
    turning = [(NAMES[k], v) for _, k, v in ((b, NAMES.index(n), v) for b, n, v in bench.set)]
    back, forth = ('forward', 'reverse') if reverse else ('reverse', 'forward')
    switched = [(n.removeprefix('spindle_'), v) for n, v in turning if 'speed' not in n]
    assert switched[1:5] == [
        *sorted([(forth, 0.0), (back, 1.0)]),
        *sorted([(forth, 1.0), (back, 0.0)]),
    ]


def test_passes_of_a_thread_meet_at_every_speed_and_a_hold_waits_for_their_end():
    again = f'{START}G33 Z-10 K{LEAD}\nG0 Z5\nG33 Z-10 K{LEAD}\nG0 X10\nM30'
    bench, held = Bench(again), []

    def each():
        if bench.play.cycle.follows and not held:
            bench.play.hold()
            held.append(True)

    assert finished(bench, each) is State.HELD
    assert bench.play.axes.setpoints[-1][2] == pytest.approx(-10 * MM, abs=1e-12)
    bench.play.spindle.state[0].override = 0.7
    bench.play.start()
    assert finished(bench, drooping(bench)) is State.IDLE
    phases = []
    for place, angle in lines(bench):
        in_step = (place > 2.0) & (place < 8.0)
        assert in_step.sum() > 300 and place[-1] == pytest.approx(10.0, abs=1e-9)
        off = (angle - place)[in_step]
        assert np.ptp(off) * LEAD < 6e-3
        phases.append(off.mean() % 1.0)
    assert abs((phases[1] - phases[0] + 0.5) % 1.0 - 0.5) * LEAD < 3e-3


#: X and Z of two passes out of those that rs274 prints for this line, and of the last one.
PASSES = 'G18 S500 M3\nG0 X10 Z5\nG76 P1.5 Z-20 I-2 J0.4 R1.5 K1 Q29.5 H1\nG0 X20\nM2'
OF_RS274 = {
    1: [(10.6, 4.7737), (7.6, 4.7737), (7.6, -19.6605), (10.6, -19.6605)],
    5: [(10.365, 4.6408), (7.365, 4.6408), (7.365, -19.7935), (10.365, -19.7935)],
    17: [(10.0, 4.4342), (7.0, 4.4342), (7.0, -20.0), (10.0, -20.0)],
}


def test_the_threading_cycle_has_the_passes_of_linuxcnc():
    blocks = read_text(PASSES, 'p.ngc', Transform.of(MACHINE), Settings()).blocks
    assert len(blocks.tip) == 22
    zero = blocks.tip[0] / MM - (10.0, 0.0, 5.0)
    for row, wanted in OF_RS274.items():
        got = blocks.tip[row : row + 4] / MM - zero
        assert got[:, [0, 2]] == pytest.approx(np.array(wanted), abs=1e-4)
    assert blocks.rapid[1:5].tolist() == [True, True, False, True]


@pytest.mark.thorough
def test_the_passes_of_a_threading_cycle_meet():
    bench = Bench(PASSES.replace('Z-20', 'Z-8').replace('H1', ''), MACHINE)
    assert finished(bench, most=60_000) is State.IDLE
    off = [(angle - place)[(place > 2.0) & (place < 6.0)] for place, angle in lines(bench)]
    phases = np.array([each.mean() for each in off]) - off[0].mean()
    assert len(off) == 4 and max(map(np.ptp, off)) * LEAD < 6e-3
    assert np.abs(phases - phases.round()).max() * LEAD < 3e-3  # each enters at the same angle


@pytest.mark.parametrize(
    ('old', 'new', 'told'),
    [
        ('G18', 'G17', 'G18 first'),
        ('P1.5', 'P0', 'P above 0'),
        ('K1 ', '', 'needs K'),
        ('J0.4', 'J1.4', 'below K'),
        ('H1', 'H1 L2 E1', 'tapers are not supported'),
        ('H1', 'H1.5', 'whole'),
        ('J0.4', 'J0.000001', 'passes'),
        ('H1', 'X4', 'axis words'),
    ],
)
def test_what_the_threading_cycle_cannot_cut_is_refused(old, new, told):
    with pytest.raises(ProgramError, match=told):
        read_text(PASSES.replace(old, new), 'p.ngc', Transform.of(MACHINE), Settings())


def test_what_the_axis_cannot_follow_stops_within_its_limits_and_says_so():
    bench, jam = Bench(TAP), []

    def each():
        if bench.play.axes.setpoints[-1][2] < 0.0:
            jam.append(bench.drives.inputs[ANGLE] if not jam else jam[0])
            bench.drives.inputs[ANGLE] = jam[0] - bench.drives.memory[10] * T

    assert finished(bench, each) is State.FAULT
    list(lines(bench))
    assert 'Z cannot follow the spindle within its' in bench.play.state.text
    assert not bench.play.spindle.commanded[[FORWARD, REVERSE]].any()


@pytest.mark.parametrize(
    ('change', 'why'),
    [
        (('S900 M3', 'S5000 M3'), 'too short'),
        (('S900 M3', 'S900'), 'does not turn'),
    ],
)
def test_a_thread_that_cannot_begin_does_not_move(change, why):
    bench = Bench(THREAD.replace(*change))
    assert finished(bench) is State.FAULT and why in bench.play.state.text
    assert bench.play.axes.setpoints[-1][2] == 5 * MM


def test_an_emergency_stop_follows_the_spindle_until_it_stands():
    bench = Bench(TAP)

    def each():
        if bench.play.axes.setpoints[-1][2] < 0.0 and bench.play.state.state is State.RUNNING:
            bench.play.stop()

    assert finished(bench, each) is State.FAULT
    assert bench.play.state.reason is Reason.EMERGENCY_STOP
    ((place, angle),) = lines(bench)
    off = (angle - place)[place > 3.0]
    assert np.ptp(off) * LEAD < 10e-3 and abs(bench.drives.memory[10]) < 0.1


def test_without_an_encoder_a_tap_has_a_floating_holder_and_a_thread_is_refused():
    given = milling()
    del given['inputs']['spindle_angle'], given['interlocks']['tool_change']
    del given['functions']['M6']
    plain = replace(MACHINE, signals=signals({'signals': given}))
    with pytest.raises(ProgramError, match='the spindle has no encoder'):
        Bench(THREAD, plain)
    bench = Bench(f'{START}G84 Z-10 R2 F1350\nG80\nM30', plain)
    bench.run()
    turned = [(b, n) for b, n, value in bench.set if value and n != 'spindle_speed']
    # Forward for the start, in reverse at the bottom, and forward again above.
    assert [n for _, n in turned] == ['spindle_forward', 'spindle_reverse', 'spindle_forward']
    none = replace(MACHINE, signals=Signals())
    with pytest.raises(ProgramError, match='the spindle has no encoder'):
        Bench(THREAD, none)


def test_threads_of_fanuc_count_f_along_the_longest_axis():
    text = 'G0 X0 Y0 Z5\nM3 S900\nG32 Z-5 F1.5\nG0 Z5\nG32 X10 Z-15 F1.5\nG0 X0\nM30'
    blocks = read_text(text, 'p.nc', Transform.of(MACHINE), Settings()).blocks
    speed = blocks.feedrate[blocks.line_number == 3], blocks.feedrate[blocks.line_number == 5]
    np.testing.assert_allclose(speed, 1.35 / 60 * np.array([[1.0], [np.sqrt(1.25)]]))
    with pytest.raises(ProgramError, match='G32: needs F'):
        read_text('G0 X0 Y0 Z5\nM3 S900\nG32 Z-5 K1', 'p.nc', Transform.of(MACHINE), Settings())
    with pytest.raises(ProgramError, match='G32: a thread of Fanuc'):
        read_text(text, 'p.ngc', Transform.of(MACHINE), Settings())


def test_surface_speed_follows_x_and_the_override_up_to_the_largest_speed():
    text = 'G0 X60 Y0 Z0\nG96 S120 D1500 M3\nG1 X2 F3500\nG97 S700\nX30\nM30'
    bench, seen = Bench(text), []
    bench.play.spindle.state[0].override = 1.1

    def each():
        block = bench.play.last.block if bench.play.last else 0
        seen.append((block, bench.play.axes.setpoints[-1][0], bench.drives.outputs[SPEED]))

    assert finished(bench, each) is State.IDLE
    block, x, speed = np.array(seen).T
    turning = (block == 1) & (x < 59 * MM)
    expected = np.minimum(1.1 * 120.0 / (2 * np.pi * x[turning]), 1500.0)
    assert turning.sum() > 500 and (expected == 1500.0).any()
    # X of the period before is known when the outputs of a period are set.
    assert np.abs(speed[turning] - expected).max() < 1e-6 * 1500
    assert speed[(block == 2) & (x > 4 * MM)] == pytest.approx(770.0)


@pytest.mark.parametrize(
    ('words', 'spindle', 'feed'),
    [
        ('', 0.5, 0.5),
        ('M50 P0', 1.0, 0.5),
        pytest.param('M51 P0', 1.2, 1.0, marks=pytest.mark.thorough),
        pytest.param('S60000 F0.02', 1.2, 1.0, marks=pytest.mark.thorough),
        *(
            pytest.param(*each, marks=pytest.mark.thorough)
            for each in (
                ('', 1.2, 1.0),
                ('M49', 0.5, 0.5),
            )
        ),
    ],
)
def test_feed_in_a_turn_holds_at_every_override_unless_the_program_keeps_it(words, spindle, feed):
    bench = Bench(f'G0 X0 Y0 Z0\nS1000 M3\nG95 F2\n{words}\nG1 X8\nM48 G94 F900 X12\nM30')
    bench.settings = OperatorSettings(feed, spindle=spindle)
    bench.begin_planner(np.zeros(3), 0.0)
    bench.play.spindle.state[0].override = spindle
    seen = []

    def each():
        block = bench.play.last.block if bench.play.last else 0
        seen.append((block, *bench.play.axes.setpoints[-1], bench.drives.outputs[SPEED]))

    assert finished(bench, each, 60_000) is State.IDLE
    rows = np.array(seen)
    x, speed = rows[:, 1], rows[:, 4]
    rate = np.diff(x, prepend=0.0) / T / MM * 60.0  # [mm/min]
    middle = (x > 4 * MM) & (x < 6 * MM)
    kept, fixed = 'M49' in words or 'M50' in words, 'M49' in words or 'M51' in words
    wanted = (60000 if 'S6' in words else 1000) * (1.0 if fixed else spindle)
    assert speed[middle] == pytest.approx(min(wanted, 60000))
    turn = (0.02 if 'S6' in words else 2.0) * (1.0 if kept else feed)
    assert rate[middle] / speed[middle] == pytest.approx(turn, rel=1e-3)
    after = (x > 9.5 * MM) & (x < 10.5 * MM)
    assert rate[after] == pytest.approx(900.0 * feed, rel=1e-3)


@pytest.mark.parametrize('missed', [0, 4])
def test_a_reversal_is_foreseen_though_its_angle_is_told_ten_periods_late(missed):
    """``missed``: of forty periods the angle was not sampled in time in so many."""
    late, ramp, counts = 10, 25.0, 4096
    inputs = replace(MACHINE.signals.inputs[ANGLE], ramp=ramp)
    kept = tuple(inputs if k == ANGLE else s for k, s in enumerate(MACHINE.signals.inputs))
    machine = replace(MACHINE, signals=replace(MACHINE.signals, inputs=kept))
    spindle = Spindle.of(machine, T, late * T)
    outputs, told = np.zeros(len(NAMES)), np.zeros(len(kept))
    angle, rate, seen, off = 0.0, 0.0, [0.0] * late, []
    for k in range(4000):
        outputs[[SPEED, FORWARD, REVERSE]] = 900.0, k < 2000, k >= 2000
        change = np.clip((15.0 if k < 2000 else -15.0) - rate, -ramp * T, ramp * T)
        angle, rate = angle + T * (rate + 0.5 * change), rate + change
        seen.append(np.floor(angle * counts) / counts)
        told[ANGLE] = np.nan if k % 40 < missed else seen[k]
        see_angle(spindle, outputs, told)
        off.append(spindle.state[0].chain[0] - angle)
    assert np.ptp(off[1500:]) * LEAD < 1e-3  # 26 um by the encoder alone


@pytest.mark.parametrize('rows', [0, 2])
def test_a_setpoint_that_is_played_twice_or_never_is_no_step_of_the_angle(rows):
    """On a busy computer, a FIFO filled up at rest put the next pass 14 um beside the thread."""
    late = 10
    spindle = Spindle.of(MACHINE, T, late * T)
    outputs, told = np.zeros(len(NAMES)), np.zeros(len(MACHINE.signals.inputs))
    turned, off = 0.0, []
    for k in range(2000):
        outputs[[SPEED, FORWARD]] = 900.0, True
        periods = rows if k == 1500 else 1
        turned += 15.0 * T * periods
        told[ANGLE] = turned - late * 15.0 * T
        see_angle(spindle, outputs, told, periods)
        off.append(spindle.state[0].chain[0] - turned)
    assert np.ptp(off[1400:]) * LEAD < 1e-6
