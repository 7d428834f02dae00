"""Simulated drives with the interface of ``drives.py``, and the simulation of whole motions."""

import numpy as np
from numba import carray, types

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import cfunc
from cnc_interp.core.native import call_drives, pointer
from cnc_interp.drives.compensation import Compensation, compensate_all, compensate_once
from cnc_interp.drives.drive_model import RING, follow_all, follow_once, lag_of, words_of
from cnc_interp.drives.learning import LearntMotion
from cnc_interp.machine.axis_motion import AxisMotion, ContourErrors, Recording
from cnc_interp.machine.drives import CycleDrives
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform

CALM = 0.02  #: Time between two steps at rest [s].
#: Simulated spindle: default acceleration [rev/s2], time constant near its speed [s], and words of
#: its memory. The words are the addresses of step and memory of the axes, of outputs and inputs;
#: their numbers; period, ramp and speed.
RAMP, NEARS, SPIN_WORDS = 50.0, 0.03, 11


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def spin_once(memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Step the axes and turn the spindle; see ``drives.CycleDrives``."""
    words = carray(pointer(memory), (SPIN_WORDS,))
    head, period, ramp = words.view(np.int64), words[8], words[9]
    fault = call_drives(np.uintp(head[0]), np.uintp(head[1]), setpoint, feedback, n)
    outputs = carray(pointer(np.uintp(head[2])), (max(head[4], head[5], head[6]) + 1,))
    inputs = carray(pointer(np.uintp(head[3])), (head[7] + 1,))
    sense = outputs[head[5]] - outputs[head[6]]
    change = (sense * outputs[head[4]] / 60.0 - words[10]) / NEARS
    change = min(max(change, -ramp), ramp)
    inputs[head[7]] += period * (words[10] + 0.5 * period * change)
    words[10] += period * change
    return int(fault)


class SimulatedDrives(CycleDrives):
    """Drives that follow setpoints by ``drive_model.py``, beginning at ``position``."""

    calm = CALM

    def __init__(self, machine: Machine, period: float, position: FloatArray):
        self.lag, self.step = lag_of(machine), int(follow_once.address)
        words = words_of(machine, period, position)
        self.memory = np.concatenate([[float(words.shape[1])], words.ravel()])
        self._words = self.memory[1:].reshape(words.shape)
        self.outputs = np.zeros(machine.signals.wired)
        self.inputs = np.zeros(len(machine.signals.inputs))
        inputs = enumerate(machine.signals.inputs)
        self._follow = [(k, list(each.follows), each.after) for k, each in inputs if each.follows]
        self._spin(machine, period)
        self._before, self._unchanged = self.outputs.copy(), np.full(len(self.outputs), np.inf)

    def _spin(self, machine: Machine, period: float) -> None:
        """Turn a spindle with an encoder in each period."""
        places = machine.signals.spindle
        if places.angle < 0:
            return
        self._axes = self.memory  # must stay where it is
        self.memory = np.zeros(SPIN_WORDS)
        head = self.memory.view(np.int64)
        head[:4] = self.step, *(x.ctypes.data for x in (self._axes, self.outputs, self.inputs))
        head[4:8] = places[:4]
        ramp = machine.signals.inputs[places.angle].ramp
        self.memory[8:10] = period, ramp if np.isfinite(ramp) else RAMP
        self.step = int(spin_once.address)

    @property
    def position(self) -> FloatArray:
        return self._words[:, RING].copy()

    def exchange(self, seconds: float) -> None:
        """Set the inputs from the outputs that they follow by their declaration."""
        self._unchanged += seconds
        self._unchanged[self.outputs != self._before] = 0.0
        self._before[:] = self.outputs
        for k, follows, after in self._follow:
            settled = self._unchanged[follows].min() >= after
            self.inputs[k] = settled and self.outputs[follows[0]] != 0.0


def simulate(
    machine: Machine,
    period: float,
    positions: FloatArray,
    velocities: FloatArray | None = None,
    model: Machine | None = None,
) -> Recording:
    """Simulate drives over all setpoints, from rest; same bits as ``SimulatedDrives``.

    Parameters
    ----------
    positions, velocities : FloatArray
        (K, n_axes), one row each period [m or rad, per s]; by default central differences.
    model : Machine, optional
        Compensate the drives of this machine; axes are then later by ``Compensation.lead``.

    Returns
    -------
    Recording
        ``position``, ``following_error`` (K, n_axes), ``tip``, ``axis`` (K, 3), ``contour_error``
        (K,) [m or rad].

    """
    r = np.ascontiguousarray(positions, dtype=float)
    rate = np.gradient(r, period, axis=0) if velocities is None else velocities
    rate = np.ascontiguousarray(rate, dtype=float)
    sent, lag = r, lag_of(machine)
    if model is not None:
        compensation = Compensation(model, period, r[0])
        sent, rate = compensate_all(compensation.words, compensation.known, r)
        lag = compensation.lead
    x, v = follow_all(words_of(machine, period, r[0]), sent, rate)
    return AxisMotion(machine, period, lag, r[0]).measure(r, x, v)


class CompensatedDrives(CycleDrives):
    """Drives whose setpoints are corrected by the inverse of their model and by ``learnt``."""

    calm = CALM

    def __init__(
        self, inner: CycleDrives, model: Machine, period: float, learnt: LearntMotion | None = None
    ):
        self._compensation = Compensation(model, period, inner.position)
        for name in ('switch_on', 'switch_off', 'close', 'fault', 'exchange', 'outputs', 'inputs'):
            setattr(self, name, getattr(inner, name))
        self.lag, self.step = self._compensation.lead, int(compensate_once.address)
        self._learnt = learnt  # its arrays must stay where they are
        taught = None if learnt is None else (learnt.setpoint, learnt.rate)
        self.memory = self._compensation.memory(inner.step, inner.memory, period, taught)

    @property
    def position(self) -> FloatArray:
        return self._compensation.newest(self.memory)


class Uncompensated:
    """Drives of a model that receive uncorrected setpoints, beginning at ``position``."""

    def __init__(self, model: Machine, period: float, position: FloatArray):
        self._words = words_of(model, period, position)
        self._transform = Transform.of(model)
        at_rest = self._transform.forward(position[None, :])[0]
        self._contour = ContourErrors(period, lag_of(model), at_rest[0])

    def contour_errors(self, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Take setpoints (K, n_axes); return contour errors (K,), a few periods late [m]."""
        x, _ = follow_all(self._words, positions, velocities)
        commanded, tips = (self._transform.forward(at)[0] for at in (positions, x))
        return self._contour.push(commanded, tips)
