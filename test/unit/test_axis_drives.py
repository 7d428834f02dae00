"""Drives as they are, against closed forms: lag, stick, reversal, resonance, torque, dead time."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from plan_directories import stroke
from scipy.integrate import solve_ivp

from cnc_interp.core import ARCSEC, MM, UM, MachineError
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.simulated_drives import SimulatedDrives, simulate
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

TIRED = Machine.load('xyzac_tired')
KV, F, TAU = 50.0, 0.9, 4e-3
DRIVE = AxisDrive(KV, F, TAU)
MASS, COULOMB, VISCOUS = 200.0, 80.0, 500.0
LOAD = DriveLoad(MASS, 2000.0, COULOMB, VISCOUS)
PERIODS = [2.5e-4, 1e-3, 4e-3]


def one_axis(drive, load=None):
    """A machine whose X has this drive."""
    return replace(TIRED, drives={0: drive}).having(load={0: load})


def run(machine, period, way):
    """Move X over setpoints, shape (K,)."""
    setpoints = np.zeros((len(way), 5))
    setpoints[:, 0] = way
    found = simulate(machine, period, setpoints)
    assert np.all(found.position[:, 1:] == 0.0)
    return found.position[:, 0], found.velocity[:, 0]


@pytest.mark.parametrize('period', PERIODS)
@pytest.mark.parametrize('speed', [0.1, -0.02])
def test_lag_on_a_ramp_with_friction_backlash_and_dead_time(period, speed):
    drive = replace(DRIVE, delay=1.7e-3, backlash=9 * UM, mode_frequency=40.0, mode_damping=0.05)
    way = speed * period * np.arange(round(1.2 / period))
    position, velocity = run(one_axis(drive, LOAD), period, way)
    # At rest relative to the ramp: kv (r - m) + f V - V = tau (B V + C sign V) / J.
    friction = (VISCOUS * speed + COULOMB * np.sign(speed)) / MASS
    lag = ((1.0 - F) * speed + TAU * friction) / KV + 1.7e-3 * speed
    lag += np.sign(speed) * 4.5 * UM
    assert way[-1] - position[-1] == pytest.approx(lag, abs=2e-9)
    assert velocity[-1] == pytest.approx(speed, rel=1e-6)


@pytest.mark.parametrize('period', PERIODS)
def test_an_axis_sticks_without_chatter_and_breaks_away(period):
    static = 130.0
    drive = replace(DRIVE, static=static, stribeck_velocity=2 * MM)
    machine, count = one_axis(drive, LOAD), round(0.5 / period)
    x, _, _ = stroke(20 * MM, 0.05, 1.0, 20.0)
    time = np.arange(len(x)) * 1e-3
    way = np.interp(np.arange(round(time[-1] / period)) * period, time, x)
    away = TAU * static / MASS / KV  # so far the setpoint goes before the axis follows
    held = np.concatenate([way, np.full(count, way[-1])])
    position, velocity = run(machine, period, held)
    rest = position[-1]
    assert 0.0 <= held[-1] - rest <= away
    assert np.all(position[-count // 2 :] == rest) and np.all(velocity[-count // 2 :] == 0.0)
    for step, moves in ((0.95, False), (1.1, True)):
        creep = np.linspace(0.0, rest + step * away - held[-1], count)
        further = np.concatenate([held, held[-1] + creep])
        position, velocity = run(machine, period, further)
        assert (position[-1] > rest) == moves, step
        assert velocity[len(held) + 5 :].min() > -1e-9


@pytest.mark.parametrize('period', PERIODS)
def test_backlash_at_a_reversal(period):
    drive, speed = AxisDrive(KV, 1.0, TAU, backlash=12 * UM), 1 * MM
    up = speed * period * np.arange(round(0.5 / period))
    way = np.concatenate([up, up[-1] - up[1:], up[1:]])
    position, velocity = run(one_axis(drive), period, way)
    gap = way - position
    assert gap[len(up) - 4] == pytest.approx(6 * UM, abs=1e-9)
    assert gap[2 * len(up) - 5] == pytest.approx(-6 * UM, abs=1e-9)
    # The table stands still while the motor crosses the play.
    still = np.count_nonzero(velocity[len(up) + round(0.1 / period) :] == 0.0) * period
    assert still == pytest.approx(12 * UM / speed, abs=2e-3 + 2 * period)  # the motor turns


@pytest.mark.parametrize('frequency', [8.0, 25.0, 40.0, 55.0, 90.0])
def test_resonance_at_its_frequency(frequency):
    drive = AxisDrive(KV, F, TAU, delay=0.8e-3, mode_frequency=40.0, mode_damping=0.05)
    period = 2.5e-4
    time = np.arange(round(2.0 / period)) * period
    way = 1e-4 * np.sin(2 * np.pi * frequency * time)
    position, _ = run(one_axis(drive), period, way)
    tail, s = slice(len(time) // 2, None), 2j * np.pi * frequency
    wave = np.exp(-2j * np.pi * frequency * time[tail])
    answer = np.mean(position[tail] * wave) / np.mean(way[tail] * wave)
    omega = 2 * np.pi * 40.0
    loops = (F * s + KV) / (TAU * s**2 + s + KV)
    mode = (2 * 0.05 * omega * s + omega**2) / (s**2 + 2 * 0.05 * omega * s + omega**2)
    expected = loops * mode * np.exp(-0.8e-3 * s)
    assert abs(answer - expected) < 0.02 * abs(expected)


@pytest.mark.parametrize('period', PERIODS)
def test_the_largest_torque_bounds_the_acceleration(period):
    weak = replace(LOAD, torque=300.0)
    way = np.full(round(0.2 / period), 5 * MM)
    way[0] = 0.0
    position, velocity = run(one_axis(DRIVE, weak), period, way)
    # From rest at the largest torque: J v' = T - C - B v, until the loop asks for less.
    time = np.arange(len(way)) * period
    rate = VISCOUS / MASS
    most = (300.0 - COULOMB) / MASS
    # The setpoint rises linearly in the first period: the torque is largest a little later.
    assert velocity.max() < most * 0.12
    early = slice(round(0.012 / period), round(0.024 / period))
    slope = np.diff(velocity[early]) / period
    exact = most - rate * 0.5 * (velocity[early][1:] + velocity[early][:-1])
    assert slope == pytest.approx(exact, rel=1e-3)
    assert time[-1] > 0.15 and position[-1] == pytest.approx(5 * MM, abs=0.1 * MM)


def test_dead_time_shifts_the_answer():
    time = np.arange(600) * 1e-3
    way = 2 * MM * np.sin(9.0 * time)
    late, _ = run(one_axis(replace(DRIVE, delay=3e-3)), 1e-3, way)
    now, _ = run(one_axis(DRIVE), 1e-3, way)
    assert late[3:] == pytest.approx(now[:-3], abs=1e-12)


def test_slip_and_mode_against_an_integrator():
    drive = replace(
        DRIVE, static=130.0, stribeck_velocity=5 * MM, mode_frequency=35.0, mode_damping=0.06
    )
    way, _, _ = stroke(20 * MM, 0.05, 1.0, 20.0)
    time, rate = np.arange(len(way)) * 1e-3, np.gradient(way, 1e-3)
    position, _ = run(one_axis(drive, LOAD), 1e-3, way)
    omega, zeta = 2 * np.pi * 35.0, 0.06

    def slope(t, z):
        m, v, x, w = z
        push = (KV * (np.interp(t, time, way) - m) + F * np.interp(t, time, rate) - v) / TAU
        level = (COULOMB + 50.0 * np.exp(-((v / (5 * MM)) ** 2))) / MASS
        drag = level * np.tanh(v / 1e-7) + VISCOUS / MASS * v
        return [v, push - drag, w, omega**2 * (m - x) + 2 * zeta * omega * (v - w)]

    exact = solve_ivp(
        slope,
        (0, time[-1]),
        [0.0] * 4,
        t_eval=time,
        method='Radau',
        rtol=1e-8,
        atol=1e-11,
        max_step=1e-3,
    )
    assert position == pytest.approx(exact.y[2], abs=0.2 * UM)


def test_the_period_does_not_matter():
    found, ways = [], [8 * MM, -3 * MM, 5 * MM, 0.05, -0.1]
    for period in PERIODS:
        time = np.arange(round(1.6 / period) + 1) * period
        q = np.outer(1 - np.cos(2 * np.pi * time), ways)
        rate = np.outer(2 * np.pi * np.sin(2 * np.pi * time), ways)
        every = round(4e-3 / period)
        found.append(simulate(TIRED, period, q, rate).position[::every])
    # What remains is the chord between setpoints: T^2 / 12 times the acceleration.
    chord = np.abs(ways) * (2 * np.pi) ** 2 * 4e-3**2 / 12
    step = 1.1 * np.array([TIRED.drives[j].resolution for j in range(5)])
    for each in found[:2]:
        assert np.all(np.abs(each - found[2]).max(axis=0) < 1.3 * chord + step)
    assert np.all(np.abs(found[0] - found[1]).max(axis=0) < 0.1 * chord + step)


def test_the_measuring_system_reads_in_steps():
    q = np.outer(1 - np.cos(4.0 * np.arange(800) * 1e-3), [5 * MM, 0, 0, 0.02, 0])
    found = simulate(TIRED, 1e-3, q).position
    for j, step in ((0, 0.1 * UM), (3, 0.2 * ARCSEC)):
        assert np.abs(found[:, j] / step - np.round(found[:, j] / step)).max() < 1e-6
        assert len(np.unique(found[:, j])) > 100


@pytest.mark.parametrize('period', PERIODS)
def test_cycle_and_simulation_of_real_drives_agree_to_the_last_bit(period):
    time = np.arange(round(1.0 / period)) * period
    ways = [8 * MM, -3 * MM, 5 * MM, 0.05, -0.1]
    q = np.outer(1 - np.cos(2 * np.pi * time), ways)
    rate = np.outer(2 * np.pi * np.sin(2 * np.pi * time), ways)
    whole = simulate(TIRED, period, q, rate)
    drives = SimulatedDrives(TIRED, period, q[0])
    endless = np.tile([-np.inf, np.inf], (5, 1))
    cycle = Cycle(period, endless, np.full(5, np.inf), 4, drives.step, drives.memory)
    cycle.place(q[0])
    zeros, ones = np.zeros_like(q), np.ones(len(q), dtype=int)
    parts = [
        Setpoints(time[:n], q[:n], rate[:n], zeros[:n], zeros[:n], ones[:n], time[:n])
        for n in (len(q), 0)
    ]
    cycle.start(cycle.push(Chunk(*parts, Wait.PROGRAM_STOP)))
    for _ in q:
        cycle.step()
    played = cycle.read()
    assert np.array_equal(played.position, whole.position)
    assert np.array_equal(played.velocity, whole.velocity)
    assert np.array_equal(drives.position, q[-1])


def test_an_axis_without_an_entry_is_ideal_and_its_load_does_not_slow_it():
    way = 5 * MM * (1 - np.cos(5.0 * np.arange(400) * 1e-3))
    loaded = replace(TIRED, drives={}).having(load={0: LOAD})
    ideal = replace(TIRED, drives={}).having(load={})
    assert np.array_equal(run(loaded, 1e-3, way)[0], run(ideal, 1e-3, way)[0])


def test_the_file_gives_the_drives_in_si():
    a = TIRED.drives[3]
    assert (a.position_gain, a.time_constant, a.delay) == (40.0, 6e-3, 2.5e-3)
    assert a.backlash == pytest.approx(12 * ARCSEC) and a.static == 7.0
    assert TIRED.drives[0].stribeck_velocity == pytest.approx(2 * MM)
    ideal = Machine.load('xyzac')
    assert np.array_equal(TIRED.limits.by_order, ideal.limits.by_order)
    assert np.array_equal(TIRED.offsets, ideal.offsets)


@pytest.mark.parametrize(
    ('axis', 'change', 'words'),
    [
        ('X', {'position_gain_per_s': 0.0}, 'drives.X.position_gain_per_s: 0 is outside'),
        ('A', {'velocity_lag_ms': 'fast'}, 'drives.A.velocity_lag_ms: must hold numbers'),
        ('Y', {'backlash_um': -1.0}, 'drives.Y.backlash_um: -1 is outside'),
        ('Y', {'backlash_arcsec': 1.0}, 'drives.Y.backlash_arcsec: unknown; known'),
        ('Y', {'mode_damping': 0.0}, 'drives.Y.mode_damping: must be positive'),
        ('Z', {'static_N': 10.0}, 'drives.Z.static_N: must be at least the Coulomb friction'),
        ('Z', {'stribeck_mm_per_s': 0.0}, 'drives.Z: give static_N and stribeck_mm_per_s'),
        ('B', {}, 'drives.B: the machine has no such axis'),
    ],
)
def test_drives_that_cannot_be_are_refused(axis, change, words):
    content = deepcopy(read_yaml(find_machine_file('xyzac_tired')))
    content['drives'].setdefault(axis, {}).update(change)
    with pytest.raises(MachineError, match=words.replace('.', r'\.')):
        from_mapping(content)
