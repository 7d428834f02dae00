"""Homing: axes move onto their switches, slowly back off them, and on to an index pulse."""

from collections.abc import Sequence
from enum import Enum

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, StreamError
from cnc_interp.machine.drives import HomedDrives
from cnc_interp.machine.jog import Jog
from cnc_interp.machine.playback import Playback
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import home_input, index_signals, square_output
from cnc_interp.run.run_state import Reason, State

SEARCH, BACK = 0.1, 0.01  #: Share of the velocity limit: to the switch, and back [-].
AT_END = 1e-6  #: An axis nearer to its end of travel has missed its switch [m, rad].


class AxisHoming(Enum):
    SEARCHES = 'moves towards its switch'
    LEAVES = 'moves back until the switch releases'
    INDEX = 'moves on to its index pulse'
    DONE = 'its position is known'


MISSED = {
    AxisHoming.SEARCHES: 'without a switch',
    AxisHoming.LEAVES: 'and its switch stays pressed',
    AxisHoming.INDEX: 'without an index pulse',
}


class SimulatedSwitches:
    """Simulated reference switches, pressed between their position and the nearer travel end."""

    def __init__(self, machine: Machine):
        names, given = machine.axis_names, machine.homing
        self._at = np.array([given.switches.get(name, np.nan) for name in names])
        self._index = np.array([given.index.get(name, np.nan) for name in names])
        low, high = machine.travel.T
        self.towards = np.where(self._at - low >= high - self._at, 1.0, -1.0)

    def pressed(self, q: FloatArray) -> BoolArray:
        return np.asarray((q - self._at) * self.towards >= 0.0)

    def passed(self, q: FloatArray) -> BoolArray:
        """Return which axes have passed the index pulse for which they search."""
        return np.asarray((q - self._index) * self.towards <= 0.0)

    def lose(self, names: Sequence[str]) -> None:
        """Do nothing: the positions of simulated axes are always known."""

    find = ask = lose

    def square(self, names: Sequence[str], on: bool) -> None:
        """Do nothing: a simulated gantry is always square."""


class WiredSwitches(SimulatedSwitches):
    """Switches on inputs ``home_x`` etc.; release or index pulse defines the position.

    Until then the axis is assumed to be at an end of its travel, so that it can move over the
    whole travel.
    """

    def __init__(self, playback: Playback, drives: HomedDrives):
        self._machine = machine = playback.axes.machine
        super().__init__(machine)
        self._playback, self._drives = playback, drives
        inputs, outputs = (
            {signal.name: k for k, signal in enumerate(declared)}
            for declared in (machine.signals.inputs, machine.signals.wires)
        )
        wires = [(home_input(name), *index_signals(name)) for name in machine.axis_names]
        self._inputs = [inputs.get(home, -1) for home, *_ in wires]
        self._waits = [inputs.get(waits, -1) for _, _, waits, _ in wires]
        self._asks = [outputs.get(asked, -1) for _, asked, _, _ in wires]
        self._squares = {
            name: outputs[square_output(name)]
            for name in machine.axis_names
            if square_output(name) in outputs
        }

    def pressed(self, q: FloatArray) -> BoolArray:
        told = np.append(self._drives.inputs, 0.0)  # the last is of an axis without a switch
        return np.asarray(told[self._inputs] != 0.0)

    def passed(self, q: FloatArray) -> BoolArray:
        return np.isfinite(self._drives.released)

    def ask(self, names: Sequence[str]) -> None:
        self._watch(names, self._waits, 1.0)

    def _watch(self, names: Sequence[str], inputs: list[int], asks: float) -> None:
        for i in map(self._machine.axis_names.index, names):
            self._drives.watch(i, inputs[i])
            if self._asks[i] >= 0:
                self._playback.spindle.commanded[self._asks[i]] = asks

    def square(self, names: Sequence[str], on: bool) -> None:
        for name in set(names) & set(self._squares):
            self._playback.spindle.commanded[self._squares[name]] = float(on)

    def lose(self, names: Sequence[str]) -> None:
        self._watch(names, self._inputs, 0.0)
        q = self._playback.axes.setpoints[-1]
        low, high = self._machine.travel.T
        near = np.where(self.towards > 0.0, high, low)
        far = low + high - near
        # Beyond the far end there is room for the motion of an axis after its switch released.
        room = 0.5 * (near - self._at)
        self._shift(names, np.where(self.pressed(q), near, far + room) - q)

    def find(self, names: Sequence[str]) -> None:
        at = np.where(np.isfinite(self._index), self._index, self._at)
        self._shift(names, at - self._drives.released)
        self._watch(names, self._inputs, 0.0)
        self.square(names, False)

    def _shift(self, names: Sequence[str], by: FloatArray) -> None:
        homed = np.isin(self._machine.axis_names, list(names))
        self._playback.shift(self._drives, np.where(homed, by, 0.0))


class Homing:
    """The homing of a machine."""

    def __init__(self, playback: Playback, jog: Jog):
        self._playback, self._jog = playback, jog
        self._machine, drives = playback.axes.machine, playback.drives
        self._switches = SimulatedSwitches(self._machine)
        self._required = self._machine.homing.required
        if isinstance(drives, HomedDrives):
            self._switches, self._required = WiredSwitches(playback, drives), True
        self._names = self._machine.axis_names
        self._groups: list[tuple[str, ...]] = []
        self._stages: dict[str, AxisHoming] = {}  # of a group; empty while none is homed
        self._unknown = set(self._machine.homing.switches)
        self._seen = playback.state

    @property
    def active(self) -> bool:
        return bool(self._stages)

    @property
    def homed(self) -> list[bool]:
        return [name not in self._unknown for name in self._names]

    @property
    def must_home(self) -> list[str]:
        return sorted(self._unknown, key=self._names.index) if self._required else []

    def forget(self) -> None:
        """Mark all axes with a switch as not homed, because the drives were off."""
        self._unknown = set(self._machine.homing.switches)
        self._watch_limits(True)
        self._groups, self._stages = [], {}
        self._jog.by_drives = False

    def know(self, axes: Sequence[str]) -> None:
        """Mark axes as homed, because their positions were stored while the power was off."""
        self._unknown -= set(axes)

    def begin(self, axes: Sequence[str], now: float) -> tuple[str, ...]:
        """Begin to home axes, by default all; return their names, or raise StreamError."""
        given = self._machine.homing
        for name in axes:
            if name not in given.switches:
                known = ' '.join(given.switches) or 'none'
                raise StreamError(f'{name} has no reference switch (axes that have: {known})')
        if not given.switches:
            raise StreamError('the machine file names no reference switches (homing)')
        if self._playback.state.state is not State.IDLE:
            raise StreamError(
                f'homing is not possible while {self._playback.state.state.value}; '
                'the machine must be at rest without a program'
            )
        probe = self._machine.signals.probe
        if probe and self._playback.drives.inputs[probe[1]]:
            raise StreamError('homing is not possible while the probe touches; move it free')
        self._playback.check_jog()
        self._jog.beat({}, 0.0, now)  # a key that is still held has no effect
        self._seen = self._playback.state
        wanted = set(axes or given.switches)
        groups = [tuple(name for name in group if name in wanted) for group in given.groups]
        self._groups = [group for group in groups if group]
        self._unknown |= wanted
        self._next()
        return tuple(name for group in groups for name in group)

    def _watch_limits(self, watched: bool) -> None:
        axes = [self._names.index(name) for name in self._stages]
        self._playback.cycle.watch_limits(axes, watched)

    def _next(self) -> None:
        self._watch_limits(True)
        group = self._groups.pop(0) if self._groups else ()
        if group:
            self._switches.lose(group)
        self._stages = dict.fromkeys(group, AxisHoming.SEARCHES)
        self._jog.by_drives = bool(group)
        self._watch_limits(False)

    def stop(self, now: float) -> None:
        self._watch_limits(True)
        self._switches.square(self._names, False)
        self._groups, self._stages = [], {}
        self._jog.by_drives = False
        self._jog.beat({}, 0.0, now)

    def work(self, now: float) -> None:
        """Continue homing; called before ``Jog.work``. Raises StreamError if it ended early."""
        if not self._stages:
            return
        state = self._playback.state
        held = state is not self._seen and state.reason is Reason.FEED_HOLD
        self._seen = state
        if held or state.state not in (State.IDLE, State.JOGGING):
            self.stop(now)
            raise StreamError('homing was stopped; home again')
        q = self._playback.axes.setpoints[-1]
        stands = self._playback.feedback.position[-1]
        pressed, passed = self._switches.pressed(stands), self._switches.passed(stands)
        for name, stage in self._stages.items():
            i = self._names.index(name)
            if stage is AxisHoming.SEARCHES and pressed[i]:
                self._stages[name] = AxisHoming.LEAVES
                self._switches.square([name], True)
            elif stage is AxisHoming.LEAVES and not pressed[i]:
                self._stages[name] = AxisHoming.DONE
                if name in self._machine.homing.index:
                    self._switches.ask([name])
                    self._stages[name] = AxisHoming.INDEX
            elif stage is AxisHoming.INDEX and passed[i]:
                self._stages[name] = AxisHoming.DONE
            searches = stage is AxisHoming.SEARCHES
            end = self._machine.travel[i][int(searches == (self._switches.towards[i] > 0.0))]
            if self._stages[name] is stage is not AxisHoming.DONE and abs(q[i] - end) < AT_END:
                self.stop(now)
                raise StreamError(f'{name} has reached its end of travel {MISSED[stage]}')
        self._jog.beat(self._shares(), 0.0, now)
        rests = state.state is State.IDLE
        if rests and all(stage is AxisHoming.DONE for stage in self._stages.values()):
            self._switches.find(list(self._stages))
            self._unknown -= set(self._stages)
            self._next()

    def _shares(self) -> dict[str, float]:
        share = {AxisHoming.SEARCHES: SEARCH, AxisHoming.LEAVES: -BACK, AxisHoming.INDEX: -BACK}
        return {
            name: share[stage] * float(self._switches.towards[self._names.index(name)])
            for name, stage in self._stages.items()
            if stage in share
        }
