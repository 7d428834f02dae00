"""The joystick node: while its button is pressed, it turns ``joy`` into beats and steps."""

from functools import partial
from typing import Any

from cnc_interp_msgs.msg import Jog
from cnc_interp_msgs.srv import MoveAxes
from rclpy.node import Node
from sensor_msgs.msg import Joy

from cnc_interp.machine.drive_kinds import Declared
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes import parameters
from cnc_interp.nodes.node_main import run_node
from cnc_interp.nodes.parameters import MACHINE
from cnc_interp.nodes.qos import BEATS

TOOL = 'tool'  #: Parameter name of the motion along the tool, like an axis name.


def declared(names: tuple[str, ...]) -> tuple[Declared, ...]:
    found = [
        Declared('enable_button', 4, 'Number in joy of the button that enables motion', 0, 63),
        Declared('step', 0.1, 'Travel per count of a handwheel [mm, deg]', 1e-4, 100.0),
        Declared('deadband', 0.1, 'Deflections below this are ignored [-]', 0.0, 0.9),
    ]
    for name in (*names, TOOL):
        found += [
            Declared(f'axis.{name}', -1, f'Axis of joy that moves {name}; -1: no axis', -1, 63),
            Declared(f'scale.{name}', 1.0, 'Largest share of the axis velocity [-]', -1.0, 1.0),
        ]
    for name in names:
        told = f'Axis of joy that counts the steps of a handwheel for {name}; -1: no handwheel'
        found.append(Declared(f'wheel.{name}', -1, told, -1, 63))
    return tuple(found)


class JoyJogNode(Node):
    def __init__(self) -> None:
        super().__init__('joy_jog_node')
        machine = parameters.declare(self, (MACHINE,))['machine']
        self._axes = Machine.load(machine).axes
        self._names = tuple(axis.name for axis in self._axes)
        self._values: dict[str, Any] = parameters.declare(self, declared(self._names))
        self._enabled, self._counts = False, dict[str, float]()
        self._mover = self.create_client(MoveAxes, 'move_axes')
        self._beats = self.create_publisher(Jog, 'jog', BEATS)
        self.create_subscription(Joy, 'joy', self._take, BEATS)

    def _take(self, joy: Joy) -> None:
        """Publish a beat for each message while the button is pressed; at release an empty one."""
        button = self._values['enable_button']
        before, self._enabled = self._enabled, bool(joy.buttons[button : button + 1].count(1))
        self._turn(joy)
        if not self._enabled:
            if before:
                self._beats.publish(Jog())
            return
        shares = {name: self._share(joy, name) for name in (*self._names, TOOL)}
        tool = shares.pop(TOOL)
        moved = {} if tool else {name: share for name, share in shares.items() if share}
        beat = Jog(axes=list(moved), shares=list(moved.values()), tool=tool)
        self._beats.publish(beat)

    def _turn(self, joy: Joy) -> None:
        """Move axes by the new counts of their handwheels while the button is pressed."""
        wheels = {axis: self._values[f'wheel.{axis.name}'] for axis in self._axes}
        now = {
            axis.name: float(joy.axes[k]) for axis, k in wheels.items() if 0 <= k < len(joy.axes)
        }
        before, self._counts = self._counts, now
        step = self._values['step']
        moved = {
            axis.name: (now[axis.name] - before[axis.name]) * step * axis.shown_size
            for axis in wheels
            if axis.name in now and now[axis.name] != before.get(axis.name, now[axis.name])
        }
        if moved and self._enabled:
            values = list(moved.values())
            request = MoveAxes.Request(axes=list(moved), values=values, relative=True)
            self._mover.call_async(request)

    def _share(self, joy: Joy, name: str) -> float:
        number, deadband = self._values[f'axis.{name}'], self._values['deadband']
        if not 0 <= number < len(joy.axes):
            return 0.0
        deflection = max(-1.0, min(1.0, float(joy.axes[number])))
        if not abs(deflection) > deadband:
            return 0.0
        part = (abs(deflection) - deadband) / (1.0 - deadband)
        share = float(self._values[f'scale.{name}']) * part
        return share if deflection > 0.0 else -share


main = partial(run_node, JoyJogNode)
