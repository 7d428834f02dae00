"""The spindle in the compiled cycle: its speed output, and lines in step with its angle.

Words set ``commanded`` values; only the cycle writes the outputs. With G96 the speed follows X.
The override takes effect in each period.

A line in step with the spindle starts and ends at rest. Its place is a function of the angle
alone (a cam), so it is the same at every speed and in reverse. With theta in turns,

    x(theta) = theta - ramp/2, after x = ramp (u^3 - u^4/2), u = theta/ramp, in the first turns

so x'(theta) rises smoothly from 0 to 1. The cam begins half a ramp before an index of the spindle,
so each pass of a thread meets the same angles; a thread ends by the same ramp. A tapped hole turns
the spindle at its end and follows it back to the start of the cam, where x is 0 and rests.

The commanded speed and the ramp of the machine file predict the angle. The difference between the
encoder and this prediction goes through a fading-memory filter of second order, so a reversal is
not seen late. A chain of three integrators follows the sum and smooths the steps of the encoder.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.records import record
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import STATES, SURFACE, THREAD, SpindleSignals

AT_REST, SETTLES, WAITS, FOLLOWS, BRAKES, DONE = range(6)  #: Modes.
NO_ANGLE, STANDS, SHORT, STEPS = 1, 2, 3, 10  #: Causes; 10 ... 40 and the axis: ``KINDS``.
KINDS = 'velocity', 'acceleration', 'jerk', 'travel'
_NAMES = list(STATES)
ZERO, LIMIT, SURFACE_SPEED = (_NAMES.index(name) for name in SURFACE)
WAY, TURNS = _NAMES.index(THREAD[0]), _NAMES.index(THREAD[3])
SPINDLE_FIXED = _NAMES.index('spindle_fixed')
#: Memory of the filter: at least this [s], and this share of the time that it extrapolates, which
#: amplifies encoder steps [-]. Product of the memory and the speed of the chain [-].
FADING, OF_AHEAD, BANDWIDTH = 4e-3, 0.75, 1.2
LOST = 0.25  #: A larger step of the angle resets the filter [rev].
SLOWEST = 0.05  #: A slower spindle counts as stopped [rev/s].
#: Largest relative change of a steady speed [1/s], and longest wait for it [s].
STEADY, LONGEST = 0.5, 20.0
FASTER = 1.15  #: Factor by which the spindle may speed up during the ramp [-].
RESERVE = 0.8  #: Share of the axis limits for the ramp; changes of speed need the rest [-].
BEARS = 5.0  #: The chain remains stable up to this multiple of the ramp's largest jerk [-].


class SpindleState:
    """State of a spindle, and of a line in step with it, that the cycle keeps between periods."""

    override: float  #: Override of the programmed speed, where the program allows it [-].
    #: Filtered difference of the encoder angle and the predicted angle, with two derivatives
    #: [rev, rev/s, rev/s2]; whether the filter has begun.
    seen: Annotated[FloatArray, 3]
    begun: bool
    #: Predicted angle with two derivatives [rev, rev/s, rev/s2]; number of periods so far.
    known: Annotated[FloatArray, 3]
    periods: int
    #: The smooth angle that a line follows, with two derivatives [rev, rev/s, rev/s2].
    chain: Annotated[FloatArray, 3]
    quick: float  #: Bandwidth of the chain [rad/s].
    rate: float  #: Speed by the encoder [rev/s].
    mode: int  #: Phase of the line: ``AT_REST`` ... ``DONE``.
    cause: int  #: Why it failed; 0 if it did not.
    waited: float  #: Time waited for a steady speed [s].
    sense: float  #: 1 if the spindle turns forward, else -1.
    #: Angle at which the cam begins, and its ramp [rev].
    begin: float
    ramp: float
    turned: bool  #: Whether the line has reversed the spindle at its end.
    jerk: float  #: Largest jerk of the chain in step with the spindle [rev/s3].
    places: Annotated[FloatArray, 3]  #: The last three places of the line [rev].


class Spindle(NamedTuple):
    """The data of a spindle that the kernels need."""

    commanded: FloatArray  #: (n_outputs,): Commanded values: outputs of the machine, then states.
    places: SpindleSignals  #: Indices of its outputs, angle and states among all signals.
    state: Sequence[SpindleState]  #: (1,).
    limits: FloatArray  #: (3, 3): Velocity, acceleration, jerk of X Y Z [m/s, m/s2, m/s3].
    known: FloatArray  #: (D, 2): Predicted angle and speed in the last D periods [rev, rev/s].
    highest: float = 0.0  #: Largest speed [rev/min].
    ahead: float = 0.0  #: Delay from receiving a setpoint to playing it [s].
    period: float = 0.0  #: [s].
    slows: float = 0.0  #: Acceleration of the spindle [rev/s2].

    @staticmethod
    def without(commanded: FloatArray) -> Spindle:
        state = record(SpindleState)
        return Spindle(commanded, SpindleSignals(), state, np.zeros((3, 3)), np.zeros((1, 2)))

    @staticmethod
    def of(machine: Machine, period: float, ahead: float) -> Spindle:
        signals, places = machine.signals, machine.signals.spindle
        spindle = Spindle.without(np.zeros(len(signals.outputs)))
        if places.speed < 0:
            return spindle
        spindle.state[0].override, spindle.state[0].quick = 1.0, BANDWIDTH / memory_of(ahead)
        return spindle._replace(
            places=places,
            limits=machine.limits.lowest.by_order[:, :3].copy(),
            known=np.zeros((round(max(ahead, 0.0) / period) + 1, 2)),
            highest=signals.outputs[places.speed].high,
            ahead=ahead,
            period=period,
            slows=signals.inputs[places.angle].ramp if places.angle >= 0 else math.inf,
        )

    @property
    def turns(self) -> bool:
        """Whether the spindle turns, according to its encoder."""
        return abs(self.state[0].rate) > SLOWEST

    def turning(self, inputs: FloatArray, outputs: FloatArray) -> tuple[float, float]:
        """Return speed [rev/min] and angle [rev] of the spindle, from its encoder if any."""
        places = self.places
        if places.angle >= 0:
            return 60.0 * float(self.state[0].rate), inputs[places.angle]
        if places.forward < 0 or places.reverse < 0:
            return 0.0, math.nan
        forward, reverse = outputs[[places.forward, places.reverse]]
        return float(outputs[places.speed] * (forward - reverse)), math.nan

    def cause(self, axes: Sequence[str]) -> str:
        """Return why a line in step with the spindle has failed."""
        cause = self.state[0].cause
        if cause == NO_ANGLE:
            return 'these drives do not report the spindle angle in each period'
        if cause == STANDS:
            return 'the spindle does not turn, or not steadily; start it before (S, M3)'
        if cause == SHORT:
            return (
                f'too short: the axes need {self.state[0].ramp:.3g} turns to get in step, and as '
                'many to stop; use a lower speed, or begin farther away'
            )
        kind = KINDS[cause // STEPS - 1]
        return f'{axes[cause % STEPS]} cannot follow the spindle within its {kind}; turn slower'


@njit(cache=True, nogil=True)
def set_outputs(spindle: Spindle, outputs: FloatArray, x: float) -> None:
    """Write the outputs to the drives: commanded values, and the speed that applies at X [m]."""
    commanded, places = spindle.commanded, spindle.places
    for i in range(len(outputs)):
        outputs[i] = commanded[i]
    if places.speed < 0:
        return
    states = commanded[places.states :]
    speed, most = commanded[places.speed], spindle.highest
    if states[SURFACE_SPEED] > 0.0:
        radius = max(abs(x - states[ZERO] * 1e-3), 1e-9)
        speed = states[SURFACE_SPEED] / (2.0 * math.pi * radius)
        if states[LIMIT] > 0.0:
            most = min(most, states[LIMIT])
    share = spindle.state[0].override if states[SPINDLE_FIXED] == 0.0 else 1.0
    outputs[places.speed] = min(speed * share, most)


@njit(cache=True, nogil=True)
def memory_of(ahead: float) -> float:
    """Return the memory of the filter [s]."""
    return max(FADING, OF_AHEAD * ahead)


@njit(cache=True, nogil=True)
def _turn_by_ramp(spindle: Spindle, outputs: FloatArray) -> FloatArray:
    """Advance the predicted angle; return predicted angle and speed of the reported period."""
    places, state, ring = spindle.places, spindle.state[0], spindle.known
    period, known = spindle.period, state.known
    if spindle.slows < math.inf:
        sense = outputs[places.forward] - outputs[places.reverse]
        wanted = (sense * outputs[places.speed] / 60.0 - known[1]) / period
        known[2] = min(max(wanted, -spindle.slows), spindle.slows)
        known[0] += period * (known[1] + 0.5 * period * known[2])
        known[1] += period * known[2]
    number = state.periods
    state.periods += 1
    ring[number % len(ring)] = known[:2]
    return ring[(number + 1) % len(ring)]


@njit(cache=True, nogil=True)
def see_angle(spindle: Spindle, outputs: FloatArray, inputs: FloatArray, periods: int = 1) -> None:
    """Advance filter and chain by ``periods`` periods; only the last one has a measured angle.

    If it is NaN because the drives have not sampled it yet, the motion is extrapolated.
    """
    if spindle.places.angle >= 0:
        for k in range(periods, 0, -1):
            _see(spindle, outputs, inputs[spindle.places.angle] if k == 1 else math.nan)


@njit(cache=True, nogil=True)
def _see(spindle: Spindle, outputs: FloatArray, measured: float) -> None:
    state = spindle.state[0]
    told = _turn_by_ramp(spindle, outputs)
    period, seen, chain, known = spindle.period, state.seen, state.chain, state.known
    angle, rate = seen[0] + period * (seen[1] + 0.5 * period * seen[2]), seen[1] + period * seen[2]
    off = measured - told[0] - angle
    if math.isnan(off):
        if not state.begun:
            return
        off = 0.0
    if not state.begun or not abs(off) < LOST:
        seen[0], seen[1], seen[2] = measured - told[0], 0.0, 0.0
        chain[:], state.begun = seen + known, True
        return
    ahead = spindle.ahead
    fading, speed = math.exp(-period / memory_of(ahead)), state.quick
    seen[0] = angle + off * (1.0 - fading**3)
    seen[1] = rate + off * 1.5 * (1.0 - fading) ** 2 * (1.0 + fading) / period
    seen[2] += off * (1.0 - fading) ** 3 / period**2
    state.rate = seen[1] + told[1]
    chain[0] += period * (chain[1] + 0.5 * period * chain[2])
    chain[1] += period * chain[2]
    place = known[0] + seen[0] + ahead * (seen[1] + 0.5 * ahead * seen[2])
    jerk = speed**3 * (place - chain[0])
    jerk += 3.0 * speed**2 * (known[1] + seen[1] + ahead * seen[2] - chain[1])
    jerk += 3.0 * speed * (known[2] + seen[2] - chain[2])
    if state.mode == FOLLOWS:
        jerk = min(max(jerk, -state.jerk), state.jerk)
    chain[0] += period**3 * jerk / 6.0
    chain[1] += period**2 * jerk / 2.0
    chain[2] += period * jerk


@njit(cache=True, nogil=True)
def begin(spindle: Spindle) -> int:
    """Choose ramp and begin of the cam once the speed is steady; return the mode."""
    state, limits = spindle.state[0], spindle.limits
    states = spindle.commanded[spindle.places.states :]
    way, turns = states[WAY : WAY + 3] * 1e-3, states[TURNS]
    state.cause, state.turned = 0, False
    if spindle.places.angle < 0 or spindle.ahead < 0.0:
        state.cause = NO_ANGLE
        return AT_REST
    rate, state.waited = state.chain[1], state.waited + spindle.period
    if abs(state.chain[2]) > STEADY * abs(rate) or abs(rate) < SLOWEST:
        state.cause = STANDS if state.waited > LONGEST else 0
        return AT_REST if state.cause else SETTLES
    state.places[:] = 0.0
    state.sense, ramp = (1.0 if rate > 0.0 else -1.0), 0.0
    rate, state.jerk = FASTER * abs(rate), math.inf
    for i in range(3):
        step = abs(way[i]) / RESERVE
        if step > 0.0:
            state.jerk = min(state.jerk, limits[2, i] / step)
        if abs(way[i]) * rate > limits[0, i]:
            state.cause = STEPS + i
            return AT_REST
        ramp = max(ramp, 1.5 * step * rate**2 / limits[1, i])
        ramp = max(ramp, math.sqrt(6.0 * step * rate**3 / limits[2, i]))
    state.ramp, state.quick = ramp, BANDWIDTH / memory_of(spindle.ahead)
    if spindle.slows < math.inf:
        state.quick = min(state.quick, BEARS * state.jerk / (3.0 * spindle.slows))
    if abs(turns) < (ramp if turns > 0.0 else 0.5 * ramp):
        state.cause = SHORT
        return AT_REST
    index = math.ceil(state.sense * state.chain[0] + 0.5 * ramp)
    state.begin = index - 0.5 * ramp
    return WAITS


@njit(cache=True, nogil=True)
def _cam(theta: float, ramp: float) -> float:
    u = min(max(theta / ramp, 0.0), 1.0)
    return ramp * u**3 * (1.0 - 0.5 * u) + max(theta - ramp, 0.0)


@njit(cache=True, nogil=True)
def _turn(spindle: Spindle, forward: bool, backward: bool) -> None:
    spindle.commanded[spindle.places.forward] = forward
    spindle.commanded[spindle.places.reverse] = backward


@njit(cache=True, nogil=True)
def give_up(spindle: Spindle, cause: int) -> None:
    """Brake from now on, out of step with the spindle, and stop the spindle."""
    state = spindle.state[0]
    if state.mode == FOLLOWS:
        state.mode, state.cause = BRAKES, cause
        _turn(spindle, False, False)


@njit(cache=True, nogil=True)
def _brake(place: FloatArray, most: FloatArray, period: float) -> float:
    """Return the next place while braking, within ``most`` acceleration and jerk [rev]."""
    rate = (place[2] - place[1]) / period
    change = (place[2] - 2.0 * place[1] + place[0]) / period**2
    step = most[1] * period
    if abs(rate) <= step * period and abs(change) <= step:
        return float(place[2])
    # The largest change of speed that ends at 0 together with the speed.
    wanted = min(most[0], max(math.sqrt(2.0 * most[1] * abs(rate)) - step, 0.0))
    wanted = -math.copysign(wanted, rate)
    change += min(max(wanted - change, -step), step)
    return float(place[2] + period * (rate + period * change))


@njit(cache=True, nogil=True)
def _violation(spindle: Spindle, way: FloatArray, place: float) -> int:
    """Return 0, or a number for the limit and axis that the next place violates."""
    limits, period = spindle.limits, spindle.period
    c, b, a = spindle.state[0].places
    steps = (place - a, place - 2.0 * a + b, place - 3.0 * a + 3.0 * b - c)
    for order in range(3):
        for i in range(3):
            if abs(way[i] * steps[order]) > limits[order, i] * period ** (order + 1):
                return STEPS * (order + 1) + i
    return 0


@njit(cache=True, nogil=True)
def follow(spindle: Spindle, setpoint: FloatArray, stands: FloatArray) -> None:
    """Make the next ``setpoint`` (2, n_axes) of a line that began at ``stands``."""
    state, places, period = spindle.state[0], spindle.places, spindle.period
    states = spindle.commanded[places.states :]
    way, turns = states[WAY : WAY + 3] * 1e-3, states[TURNS]
    sense, ramp, place = state.sense, state.ramp, state.places
    forward = spindle.commanded[places.forward] != 0.0
    drives = forward or spindle.commanded[places.reverse] != 0.0
    theta, count = sense * state.chain[0] - state.begin, abs(turns)
    following = float(place[2])
    if state.mode == SETTLES:
        state.mode, state.cause = AT_REST, STANDS
        if drives:
            state.mode = begin(spindle)
        return
    if state.mode == WAITS:
        state.mode = FOLLOWS if theta >= 0.0 else WAITS
        if not drives:
            state.mode, state.cause = AT_REST, STANDS
    if state.mode == FOLLOWS:
        left = count + ramp - theta  # of a thread
        following = _cam(theta, ramp)
        if turns > 0.0 and left < theta:
            following = count - _cam(left, ramp)
        slows = state.chain[1] ** 2 / (2.0 * spindle.slows)
        if turns < 0.0 and not state.turned and drives and following + slows >= count:
            state.turned = True
            _turn(spindle, sense < 0.0, sense > 0.0)
        broken = _violation(spindle, way, following)
        if broken or (not drives and abs(state.chain[1]) < SLOWEST):
            give_up(spindle, broken)
        elif (turns > 0.0 and theta >= count + ramp) or (state.turned and theta <= 0.0):
            following = count if turns > 0.0 else 0.0
            state.mode = DONE
            if turns < 0.0 and drives:
                _turn(spindle, sense > 0.0, sense < 0.0)
    if state.mode == BRAKES:
        least = np.full(2, np.inf)
        for i in range(3):
            for k in range(2):
                if way[i] != 0.0:
                    least[k] = min(least[k], RESERVE * spindle.limits[k + 1, i] / abs(way[i]))
        following = _brake(place, least, period)
        if following == place[2]:
            state.mode = AT_REST
    for i in range(3):
        setpoint[0, i] = stands[i] + way[i] * following
        setpoint[1, i] = way[i] * (following - place[2]) / period
    place[0], place[1], place[2] = place[1], place[2], following
