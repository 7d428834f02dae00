"""Services and topics of the machine node for the operator, and service ``optional_stop``."""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import G1Block, MachineSignals, MachineState, PathSegment
from cnc_interp_msgs.msg import Jog as JogMessage
from cnc_interp_msgs.srv import Home, MoveAxes, SwitchOutputs
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from cnc_interp.core import BlockError, FloatArray, StreamError
from cnc_interp.machine.handwheel import Handwheel
from cnc_interp.machine.homing import Homing
from cnc_interp.machine.jog import Jog
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.switching import Act
from cnc_interp.machine_model.signals import Step
from cnc_interp.machine_model.transform_port import Transform, positions_of_pose
from cnc_interp.nodes.node_main import AND, BODIES, OK, WARN, Diagnostics, answering
from cnc_interp.nodes.qos import BEATS, OVERRIDE, STATE
from cnc_interp.nodes.seals import publishers_of
from cnc_interp.run.clearance_stage import ContactError, Foresight
from cnc_interp.run.overrides import OVERRIDES, OperatorSettings, sound_override
from cnc_interp.run.setpoints import Wait
from cnc_interp.wire.path_messages import check_functions

TOLD = 10.0  #: For this time, the page shows why a motion by hand was rejected or stopped [s].


class Controls:
    """Commands that act at once and need no other node; jogging and homing are among them."""

    def __init__(
        self,
        node: Any,
        playback: Playback,
        diagnostics: Diagnostics,
        give_up: Callable[[str], None],
        wake: Callable[[], None],
        contact: Foresight | None = None,
    ):
        self._playback, self._diagnostics = playback, diagnostics
        self._give_up, self._wake = give_up, wake
        self._jog = Jog(playback, contact and (lambda q: self._contact(contact, q)))
        self._transform = Transform.of(playback.axes.machine)
        self.homing = Homing(playback, self._jog)
        self._handwheel = Handwheel(playback, self._jog)
        for kind, name, act in (
            (Trigger, 'feed_hold', partial(self._press, playback.hold)),
            (Trigger, 'cycle_start', partial(self._press, playback.start)),
            (Trigger, 'emergency_stop', partial(self._press, playback.stop)),
            (Trigger, 'reset', self._reset),
            (SetBool, 'single_block', self._set_single_block),
            (MoveAxes, 'move_axes', self._move),
            (Home, 'home', self._home),
            (SwitchOutputs, 'switch_outputs', self._switch),
        ):
            node.create_service(kind, name, answering(act, wake))
        node.create_subscription(JogMessage, 'jog', self._beat, BEATS)
        if not playback.drives.wired:
            node.create_subscription(MachineSignals, 'machine_inputs', self._take_inputs, STATE)
        self._told_until = 0.0  # end of the report about a rejected motion [s]

    def _contact(self, contact: Foresight, q: FloatArray) -> Any:
        """Return the contact predicted on moves through ``q``; None while axes are not homed."""
        return None if self.homing.must_home else contact(q)

    def _press(self, act: Callable[[], None], _request: Any, _response: Any) -> str:
        act()
        return self._playback.state.state.value

    def _reset(self, request: Any, response: Any) -> str:
        state = self._press(self._playback.reset, request, response)
        self._give_up('given up by reset')  # informs the senders and the playback
        return state

    def _set_single_block(self, request: Any, _response: Any) -> str:
        self._playback.single_block = request.data
        return f'single block: {request.data}'

    def _beat(self, message: JogMessage) -> None:
        self._wake()
        try:
            shares = _pairs(message.axes, message.shares)
            if self.homing.active and not (any(shares.values()) or message.tool):
                self.homing.stop(time.monotonic())
            self._refuse_beside_homing()
            silence = self._jog.beat(shares, message.tool, time.monotonic())
            if silence:
                told = f'the axes stopped: no message of the held key for {silence:.1f} s'
                self._warn(f'{told}; the computer or the network is busy')
            else:
                self._diagnostics.say('jog', OK, 'follows jog')
        except StreamError as problem:
            self._warn(str(problem))

    def _warn(self, text: str) -> None:
        self._told_until = time.monotonic() + TOLD
        self._diagnostics.say('jog', WARN, text)

    def _move(self, request: MoveAxes.Request, response: MoveAxes.Response) -> str:
        self._refuse_beside_homing()
        values, relative = _pairs(request.axes, request.values), request.relative
        if request.tip or request.axis:
            if values or request.tool or relative:
                raise StreamError('move either to a pose, or axes, or along the tool')
            values = self._values_of_pose(list(request.tip), list(request.axis))
        place = self._jog.move(values, relative, request.tool, request.speed)
        response.positions = place.tolist()
        return 'moving'

    def _values_of_pose(self, tip: list[float], axis: list[float]) -> dict[str, float]:
        if len(tip) not in (0, 3) or len(axis) not in (0, 3):
            raise StreamError('a pose has three values of the tip, and three of the tool axis')
        point = np.array(tip or [np.nan] * 3)
        stands = self._jog.target
        try:
            q = positions_of_pose(self._transform, point, np.array(axis) if axis else None, stands)
        except (BlockError, ValueError) as problem:
            raise StreamError(str(problem)) from None
        return dict(zip(self._transform.machine.axis_names, q.tolist(), strict=True))

    def _home(self, request: Home.Request, _response: Any) -> str:
        return f'homing {" ".join(self.homing.begin(list(request.axes), time.monotonic()))}'

    def _switch(self, request: SwitchOutputs.Request, _response: Any) -> str:
        self._refuse_beside_homing()
        signals = self._playback.axes.machine.signals
        check_functions('switch_outputs', request.functions, signals)
        if len(request.names) != len(request.values) or (request.names and request.functions):
            raise StreamError('name each output once, with one value for each')
        acts = [
            Act(signals.steps[f.step], f.value, k, f.step, 0, f.line_number)
            for k, f in enumerate(request.functions)
        ]
        outputs = [signal.name for signal in signals.wires]
        for name, value in zip(request.names, request.values, strict=True):
            if name not in outputs:
                raise StreamError(f'{name!r} is no output; choose {", ".join(outputs)}')
            if fault := signals.outputs[outputs.index(name)].fault_of(value):
                raise StreamError(fault)
            acts.append(Act(Step('', outputs.index(name), value), value))
        self._playback.switch(acts)
        return 'switched'

    def _take_inputs(self, message: MachineSignals) -> None:
        """Set inputs from a message: simulated switches, or those of a trajectory controller."""
        self._wake()
        signals, problem = self._playback.axes.machine.signals, ''
        known = {signal.name: k for k, signal in enumerate(signals.inputs)}
        for name, value in zip(message.inputs, message.input_values, strict=False):
            fault = signals.inputs[known[name]].fault_of(value) if name in known else 'unknown'
            if fault:
                problem = f'input {name} refused: {fault}'
            else:
                self._playback.drives.inputs[known[name]] = value
        level = WARN if problem else OK
        self._diagnostics.say('machine_inputs', level, problem or 'follows machine_inputs')

    def _refuse_beside_homing(self) -> None:
        if self.homing.active:
            raise StreamError('the axes are being homed; feed hold ends it')

    def work(self, override: float) -> None:
        try:
            self.homing.work(time.monotonic())
            self._handwheel.work(self.homing.active)
            self._jog.work(time.monotonic(), override)
        except ContactError as problem:
            if self.homing.active:  # again, of axes that were homed
                self.homing.stop(time.monotonic())
            self._told_until = math.inf  # the bodies stay near each other
            self._diagnostics.say('jog', WARN, str(problem), **{BODIES: AND.join(problem.bodies)})
        except StreamError as problem:
            self._warn(str(problem))
        if time.monotonic() > self._told_until:
            self._told_until = math.inf
            self._diagnostics.say('jog', OK, 'no motion by hand refused')


def _pairs(axes: list[str], values: Any) -> dict[str, float]:
    if len(axes) != len(values) or len(set(axes)) != len(axes):
        raise StreamError('name each axis once, with one value for each')
    return dict(zip(axes, values, strict=True))


class Overrides:
    """The overrides. Only machine_node subscribes, so that all nodes use the same values."""

    def __init__(
        self, node: Any, playback: Playback, diagnostics: Diagnostics, wake: Callable[[], None]
    ):
        self.feed = self.rapid = self.spindle = 1.0
        self._node, self._playback = node, playback
        self._diagnostics, self._wake = diagnostics, wake
        for topic in OVERRIDES:
            node.create_subscription(Float64, topic, partial(self._take, topic), OVERRIDE)

    def _take(self, topic: str, message: Float64) -> None:
        self._wake()
        try:
            value = sound_override(topic, float(message.data))
        except StreamError as problem:
            senders = publishers_of(self._node, topic)
            text = f'{problem}; the value from {senders} is ignored'
            self._diagnostics.say(topic, WARN, text)
            return
        setattr(self, topic.removesuffix('_override'), value)
        self._playback.spindle.state[0].override = self.spindle
        self._diagnostics.say(topic, OK, f'{value:g}')


class OperatorInputs:
    """The operator's settings. Overrides and single block are read from the machine state."""

    def __init__(self, node: Any):
        self.settings, self._optional_stop = OperatorSettings(), False
        node.create_service(SetBool, 'optional_stop', answering(self._set_optional_stop))

    def see(self, state: MachineState) -> bool:
        before = self.settings
        self.settings = OperatorSettings(
            state.feed_override, state.single_block, state.rapid_override, state.spindle_override
        )
        return self.settings != before

    def _set_optional_stop(self, request: Any, _response: Any) -> str:
        self._optional_stop = request.data
        return f'optional stop: {request.data}'

    def pauses_after(self, segments: list[PathSegment]) -> dict[int, Wait]:
        """Return block -> wait for each block after which M0 or M1 stops the machine."""
        waits = {G1Block.STOP: Wait.PROGRAM_STOP}
        if self._optional_stop:
            waits[G1Block.OPTIONAL_STOP] = Wait.OPTIONAL_STOP
        return {
            int(segment.last_block): waits[segment.program_stop]
            for segment in segments
            if segment.program_stop in waits
        }
