"""The spindle in the cycle, compiled: the speed that goes out, and a line in step with its angle.

What words set are ``commanded`` values; the cycle alone writes the outputs. With G96 the speed
follows X, and the override counts in each period.

A line in step with the spindle starts and ends at rest. Its place is a function of the angle
alone, a cam, so it is the same at every speed, and in reverse. With theta in turns,

    x(theta) = theta - ramp/2, after x = ramp (u^3 - u^4/2), u = theta/ramp, in the first turns

so x'(theta) rises smoothly from 0 to 1. The cam begins half a ramp before an index of the spindle,
so each pass of a thread meets the same angles; a thread ends by the same ramp. A tapped hole turns
the spindle at its end and follows it back to the start of the cam, where x is 0 and rests.

What the spindle is told, and the ramp of the machine file, say how it turns; what it turns
otherwise goes through a fading-memory filter of second order, so that a reversal is not seen late.
A chain of three integrators follows the sum: steps of an encoder become smooth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import STATES, SURFACE, THREAD

#: Words: the override, largest speed [rev/min], how much later than it is told a setpoint is
#: played [s], period [s], how fast the spindle changes its speed [rev/s2]; ...
OVERRIDE, MOST, AHEAD, PERIOD, SLOWS = range(5)
#: ... what the line does, why it failed, filtered angle and chain with their two derivatives
#: [rev, per s, s2], whether the filter has begun, and of the line: sense, begin of the cam, its
#: ramp, whether the spindle was turned; the angle by the ramp with two derivatives, periods so
#: far, speed by the encoder [rev/s], how fast the chain follows [rad/s], its largest jerk in step
#: with the spindle [rev/s3]; and the last three places of the line with the speed of a stop [rev].
MODE, CAUSE, ANGLE, CHAIN, BEGUN, SENSE, BEGIN, RAMP, TURNED = 5, 6, 7, 10, 13, 14, 15, 16, 17
KNOWN, PERIODS, RATE, QUICK, JERK, PLACES, WORDS = 18, 21, 22, 23, 24, 25, 28
AT_REST, SETTLES, WAITS, FOLLOWS, BRAKES, DONE = range(6)  #: Modes.
NO_ANGLE, STANDS, SHORT, STEPS = 1, 2, 3, 10  #: Causes; 10 ... 40 and the axis: ``KINDS``.
#: Numbers among the places of the spindle: outputs, input and the first state.
SPEED, FORWARD, REVERSE, INPUT, STATE = range(5)
KINDS = 'velocity', 'acceleration', 'jerk', 'travel'
_NAMES = list(STATES)
ZERO, LIMIT, SURFACE_SPEED = (_NAMES.index(name) for name in SURFACE)
WAY, TURNS = _NAMES.index(THREAD[0]), _NAMES.index(THREAD[3])
SPINDLE_FIXED = _NAMES.index('spindle_fixed')
#: Memory of the filter, at least [s], and as a share of the time that it looks ahead, which
#: amplifies the steps of an encoder [-]; product of the memory and the speed of the chain [-].
FADING, OF_AHEAD, BANDWIDTH = 4e-3, 0.75, 1.2
LOST = 0.25  #: A larger step of the angle is no motion [rev].
SLOWEST = 0.05  #: A slower spindle stands [rev/s].
STEADY, LONGEST = 0.5, 20.0  #: Change of a steady speed [1/s], and longest wait for it [s].
FASTER = 1.15  #: The ramp bears a spindle so much faster than it is [-].
RESERVE = 0.8  #: Share of the limits for the ramp; a changing speed needs the rest.
BEARS = 5.0  #: The chain is stable where the ramp asks for so many times its largest jerk [-].


class Spindle(NamedTuple):
    """What the kernels know of a spindle; ``places`` is empty without an output for its speed."""

    commanded: FloatArray  #: (n_outputs,): What words set: outputs of the machine, then states.
    places: IntArray  #: ``Signals.spindle``, the numbers of its outputs and of the angle.
    words: FloatArray  #: (WORDS,).
    limits: FloatArray  #: (3, 3): Velocity, acceleration, jerk of X Y Z [m/s, m/s2, m/s3].
    known: FloatArray  #: (D, 2): Angle and speed by the ramp since what is told now [rev, rev/s].

    @staticmethod
    def without(commanded: FloatArray) -> Spindle:
        numbers = np.zeros(0, np.int64), np.zeros(WORDS), np.zeros((3, 3)), np.zeros((1, 2))
        return Spindle(commanded, *numbers)

    @staticmethod
    def of(machine: Machine, period: float, ahead: float) -> Spindle:
        signals = machine.signals
        spindle = Spindle.without(np.zeros(len(signals.outputs)))
        if not signals.spindle:
            return spindle
        speed, angle, words = signals.spindle[SPEED], signals.spindle[INPUT], spindle.words
        slows = signals.inputs[angle].ramp if angle >= 0 else math.inf
        words[: SLOWS + 1] = 1.0, signals.outputs[speed].high, ahead, period, slows
        words[QUICK] = BANDWIDTH / memory_of(ahead)
        limits, known = (
            machine.lowest_limits[:, :3],
            np.zeros((round(max(ahead, 0.0) / period) + 1, 2)),
        )
        return Spindle(spindle.commanded, np.array(signals.spindle), words, limits.copy(), known)

    @property
    def turns(self) -> bool:
        """Whether the encoder sees that it turns."""
        return bool(abs(self.words[RATE]) > SLOWEST)

    def cause(self, axes: Sequence[str]) -> str:
        """Say why a line in step with the spindle has failed."""
        cause = round(self.words[CAUSE])
        if cause == NO_ANGLE:
            return 'these drives do not tell the angle of the spindle in each period'
        if cause == STANDS:
            return 'the spindle does not turn, or not steadily; start it before (S, M3)'
        if cause == SHORT:
            return (
                f'too short: the axes need {self.words[RAMP]:.3g} turns to get in step, and as '
                'many to stop; turn slower, or begin farther off'
            )
        kind = KINDS[cause // STEPS - 1]
        return f'{axes[cause % STEPS]} cannot follow the spindle within its {kind}; turn slower'


@njit(cache=True, nogil=True)
def set_outputs(spindle: Spindle, outputs: FloatArray, x: float) -> None:
    """Write what drives get: commanded values, and the speed that counts at X [m]."""
    commanded, places, words = spindle.commanded, spindle.places, spindle.words
    for i in range(len(outputs)):
        outputs[i] = commanded[i]
    if len(places) == 0:
        return
    states = commanded[places[STATE] :]
    speed, most = commanded[places[SPEED]], words[MOST]
    if states[SURFACE_SPEED] > 0.0:
        radius = max(abs(x - states[ZERO] * 1e-3), 1e-9)
        speed = states[SURFACE_SPEED] / (2.0 * math.pi * radius)
        if states[LIMIT] > 0.0:
            most = min(most, states[LIMIT])
    share = words[OVERRIDE] if states[SPINDLE_FIXED] == 0.0 else 1.0
    outputs[places[SPEED]] = min(speed * share, most)


@njit(cache=True, nogil=True)
def memory_of(ahead: float) -> float:
    """Return the memory of the filter [s]."""
    return max(FADING, OF_AHEAD * ahead)


@njit(cache=True, nogil=True)
def _turn_by_ramp(spindle: Spindle, outputs: FloatArray) -> FloatArray:
    """Turn as told, by the ramp; return angle and speed so of the period that is told now."""
    places, words, ring = spindle.places, spindle.words, spindle.known
    period, known = words[PERIOD], words[KNOWN : KNOWN + 3]
    if words[SLOWS] < math.inf:
        sense = outputs[places[FORWARD]] - outputs[places[REVERSE]]
        wanted = (sense * outputs[places[SPEED]] / 60.0 - known[1]) / period
        known[2] = min(max(wanted, -words[SLOWS]), words[SLOWS])
        known[0] += period * (known[1] + 0.5 * period * known[2])
        known[1] += period * known[2]
    number = int(words[PERIODS])
    words[PERIODS] += 1.0
    ring[number % len(ring)] = known[:2]
    return ring[(number + 1) % len(ring)]


@njit(cache=True, nogil=True)
def see_angle(spindle: Spindle, outputs: FloatArray, inputs: FloatArray) -> None:
    """Take the angle of this period into the filter and the chain."""
    places, words = spindle.places, spindle.words
    if len(places) == 0 or places[INPUT] < 0:
        return
    told = _turn_by_ramp(spindle, outputs)
    period, seen, chain = words[PERIOD], words[ANGLE : ANGLE + 3], words[CHAIN : CHAIN + 3]
    known = words[KNOWN : KNOWN + 3]
    angle, rate = seen[0] + period * (seen[1] + 0.5 * period * seen[2]), seen[1] + period * seen[2]
    off = inputs[places[INPUT]] - told[0] - angle
    if words[BEGUN] == 0.0 or not abs(off) < LOST:
        seen[0], seen[1], seen[2] = inputs[places[INPUT]] - told[0], 0.0, 0.0
        chain[:], words[BEGUN] = seen + known, 1.0
        return
    ahead = words[AHEAD]
    fading, speed = math.exp(-period / memory_of(ahead)), words[QUICK]
    seen[0] = angle + off * (1.0 - fading**3)
    seen[1] = rate + off * 1.5 * (1.0 - fading) ** 2 * (1.0 + fading) / period
    seen[2] += off * (1.0 - fading) ** 3 / period**2
    words[RATE] = seen[1] + told[1]
    chain[0] += period * (chain[1] + 0.5 * period * chain[2])
    chain[1] += period * chain[2]
    place = known[0] + seen[0] + ahead * (seen[1] + 0.5 * ahead * seen[2])
    jerk = speed**3 * (place - chain[0])
    jerk += 3.0 * speed**2 * (known[1] + seen[1] + ahead * seen[2] - chain[1])
    jerk += 3.0 * speed * (known[2] + seen[2] - chain[2])
    if words[MODE] == FOLLOWS:
        jerk = min(max(jerk, -words[JERK]), words[JERK])
    chain[0] += period**3 * jerk / 6.0
    chain[1] += period**2 * jerk / 2.0
    chain[2] += period * jerk


@njit(cache=True, nogil=True)
def begin(spindle: Spindle) -> int:
    """Choose the ramp and the begin of the cam, once the speed is steady; return the mode."""
    words, limits = spindle.words, spindle.limits
    states = spindle.commanded[spindle.places[STATE] :]
    way, turns = states[WAY : WAY + 3] * 1e-3, states[TURNS]
    words[CAUSE] = words[TURNED] = 0.0
    if spindle.places[INPUT] < 0 or words[AHEAD] < 0.0:
        words[CAUSE] = NO_ANGLE
        return AT_REST
    rate, words[PLACES] = words[CHAIN + 1], words[PLACES] + words[PERIOD]
    if abs(words[CHAIN + 2]) > STEADY * abs(rate) or abs(rate) < SLOWEST:
        words[CAUSE] = STANDS if words[PLACES] > LONGEST else 0.0
        return AT_REST if words[CAUSE] else SETTLES
    words[PLACES:] = 0.0
    words[SENSE], ramp = (1.0 if rate > 0.0 else -1.0), 0.0
    rate, words[JERK] = FASTER * abs(rate), math.inf
    for i in range(3):
        step = abs(way[i]) / RESERVE
        if step > 0.0:
            words[JERK] = min(words[JERK], limits[2, i] / step)
        if abs(way[i]) * rate > limits[0, i]:
            words[CAUSE] = STEPS + i
            return AT_REST
        ramp = max(ramp, 1.5 * step * rate**2 / limits[1, i])
        ramp = max(ramp, math.sqrt(6.0 * step * rate**3 / limits[2, i]))
    words[RAMP], words[QUICK] = ramp, BANDWIDTH / memory_of(words[AHEAD])
    if words[SLOWS] < math.inf:
        words[QUICK] = min(words[QUICK], BEARS * words[JERK] / (3.0 * words[SLOWS]))
    if abs(turns) < (ramp if turns > 0.0 else 0.5 * ramp):
        words[CAUSE] = SHORT
        return AT_REST
    index = math.ceil(words[SENSE] * words[CHAIN] + 0.5 * ramp)
    words[BEGIN] = index - 0.5 * ramp
    return WAITS


@njit(cache=True, nogil=True)
def _cam(theta: float, ramp: float) -> float:
    u = min(max(theta / ramp, 0.0), 1.0)
    return ramp * u**3 * (1.0 - 0.5 * u) + max(theta - ramp, 0.0)


@njit(cache=True, nogil=True)
def _turn(spindle: Spindle, forward: bool, backward: bool) -> None:
    spindle.commanded[spindle.places[FORWARD]] = forward
    spindle.commanded[spindle.places[REVERSE]] = backward


@njit(cache=True, nogil=True)
def give_up(spindle: Spindle, cause: int) -> None:
    """Brake from now on, out of step, and let the spindle stop."""
    if spindle.words[MODE] == FOLLOWS:
        spindle.words[MODE], spindle.words[CAUSE] = BRAKES, cause
        _turn(spindle, False, False)


@njit(cache=True, nogil=True)
def _brake(place: FloatArray, most: FloatArray, period: float) -> float:
    """Return the next place on the way to rest, within ``most`` acceleration and jerk [rev]."""
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
    """Return 0, or which limit of which axis the next place breaks."""
    words, limits = spindle.words, spindle.limits
    period, c, b, a = words[PERIOD], words[PLACES], words[PLACES + 1], words[PLACES + 2]
    steps = (place - a, place - 2.0 * a + b, place - 3.0 * a + 3.0 * b - c)
    for order in range(3):
        for i in range(3):
            if abs(way[i] * steps[order]) > limits[order, i] * period ** (order + 1):
                return STEPS * (order + 1) + i
    return 0


@njit(cache=True, nogil=True)
def follow(spindle: Spindle, setpoint: FloatArray, stands: FloatArray) -> None:
    """Make the next ``setpoint`` (2, n_axes) of a line that began at ``stands``."""
    words, states = spindle.words, spindle.commanded[spindle.places[STATE] :]
    way, turns, period = states[WAY : WAY + 3] * 1e-3, states[TURNS], words[PERIOD]
    sense, ramp, place = words[SENSE], words[RAMP], words[PLACES:]
    forward = spindle.commanded[spindle.places[FORWARD]] != 0.0
    drives = forward or spindle.commanded[spindle.places[REVERSE]] != 0.0
    theta, count = sense * words[CHAIN] - words[BEGIN], abs(turns)
    following = float(place[2])
    if words[MODE] == SETTLES:
        words[MODE], words[CAUSE] = AT_REST, STANDS
        if drives:
            words[MODE] = begin(spindle)
        return
    if words[MODE] == WAITS:
        words[MODE] = FOLLOWS if theta >= 0.0 else WAITS
        if not drives:
            words[MODE], words[CAUSE] = AT_REST, STANDS
    if words[MODE] == FOLLOWS:
        left = count + ramp - theta  # of a thread
        following = _cam(theta, ramp)
        if turns > 0.0 and left < theta:
            following = count - _cam(left, ramp)
        slows = words[CHAIN + 1] ** 2 / (2.0 * words[SLOWS])
        if turns < 0.0 and words[TURNED] == 0.0 and drives and following + slows >= count:
            words[TURNED] = 1.0
            _turn(spindle, sense < 0.0, sense > 0.0)
        broken = _violation(spindle, way, following)
        if broken or (not drives and abs(words[CHAIN + 1]) < SLOWEST):
            give_up(spindle, broken)
        elif (turns > 0.0 and theta >= count + ramp) or (words[TURNED] != 0.0 and theta <= 0.0):
            following = count if turns > 0.0 else 0.0
            words[MODE] = DONE
            if turns < 0.0 and drives:
                _turn(spindle, sense > 0.0, sense < 0.0)
    if words[MODE] == BRAKES:
        least = np.full(2, np.inf)
        for i in range(3):
            for k in range(2):
                if way[i] != 0.0:
                    least[k] = min(least[k], RESERVE * spindle.limits[k + 1, i] / abs(way[i]))
        following = _brake(place, least, period)
        if following == place[2]:
            words[MODE] = AT_REST
    for i in range(3):
        setpoint[0, i] = stands[i] + way[i] * following
        setpoint[1, i] = way[i] * (following - place[2]) / period
    place[0], place[1], place[2] = place[1], place[2], following
