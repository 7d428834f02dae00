"""Motion by hand over ROS: topic ``jog``, services ``move_axes`` and ``home`` of the machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import Jog as JogMessage
from cnc_interp_msgs.srv import Home, MoveAxes

from cnc_interp.core.errors import BlockError, StreamError
from cnc_interp.machine.homing import Homing, SimulatedSwitches
from cnc_interp.machine.jog import Jog
from cnc_interp.machine.playback import Playback
from cnc_interp.machine_model.pose import positions_of_pose
from cnc_interp.machine_model.transform import Transform
from cnc_interp.nodes.diagnostics import OK, WARN, Diagnostics
from cnc_interp.nodes.qos import BEATS


class JogCommands:
    """Takes the operator's commands for motion by hand."""

    def __init__(
        self, node: Any, playback: Playback, diagnostics: Diagnostics, wake: Callable[[], None]
    ):
        self._jog, self._diagnostics, self._wake = Jog(playback), diagnostics, wake
        self._transform = Transform.of(playback.axes.machine)
        switches = SimulatedSwitches(playback.axes.machine)
        self.homing = Homing(playback, self._jog, switches.pressed, switches.towards)
        node.create_service(Home, 'home', self._home)
        node.create_subscription(JogMessage, 'jog', self._beat, BEATS)
        node.create_service(MoveAxes, 'move_axes', self._move)
        diagnostics.say('jog', OK, 'no motion by hand refused')

    def _beat(self, message: JogMessage) -> None:
        """Take a beat, or name on the diagnostics why not."""
        self._wake()
        try:
            shares = _pairs(message.axes, message.shares)
            if self.homing.active and not (any(shares.values()) or message.tool):
                self.homing.stop(time.monotonic())
            self._refuse_beside_homing()
            self._jog.beat(shares, message.tool, time.monotonic())
            self._diagnostics.say('jog', OK, 'follows jog')
        except StreamError as problem:
            self._diagnostics.say('jog', WARN, str(problem))

    def _move(self, request: MoveAxes.Request, response: MoveAxes.Response) -> Any:
        """Answer ``move_axes``."""
        self._wake()
        try:
            self._refuse_beside_homing()
            values, relative = _pairs(request.axes, request.values), request.relative
            if request.tip or request.axis:
                if values or request.tool or relative:
                    raise StreamError('move either to a pose, or axes, or along the tool')
                values = self._values_of_pose(list(request.tip), list(request.axis))
            place = self._jog.move(values, relative, request.tool, request.speed)
            response.success, response.message = True, 'moving'
            response.positions = place.tolist()
        except StreamError as problem:
            response.success, response.message = False, str(problem)
        return response

    def _values_of_pose(self, tip: list[float], axis: list[float]) -> dict[str, float]:
        """Return the position of each axis at a tool pose."""
        if len(tip) not in (0, 3) or len(axis) not in (0, 3):
            raise StreamError('a pose has three values of the tip, and three of the tool axis')
        point = np.array(tip or [np.nan] * 3)
        stands = self._jog.target
        try:
            q = positions_of_pose(self._transform, point, np.array(axis) if axis else None, stands)
        except (BlockError, ValueError) as problem:
            raise StreamError(str(problem)) from None
        return dict(zip(self._transform.axis_names, q.tolist(), strict=True))

    def _home(self, request: Home.Request, response: Home.Response) -> Any:
        """Answer ``home``."""
        self._wake()
        try:
            axes = self.homing.begin(list(request.axes), time.monotonic())
            response.success, response.message = True, f'homing {" ".join(axes)}'
        except StreamError as problem:
            response.success, response.message = False, str(problem)
        return response

    def _refuse_beside_homing(self) -> None:
        if self.homing.active:
            raise StreamError('the axes are being homed; feed_hold or an empty jog ends it')

    def work(self, override: float) -> None:
        """Hand out what the machine needs next; name what cannot be moved."""
        try:
            self.homing.work(time.monotonic())
            self._jog.work(time.monotonic(), override)
        except StreamError as problem:
            self._diagnostics.say('jog', WARN, str(problem))


def _pairs(axes: list[str], values: Any) -> dict[str, float]:
    """Return the value of each axis named."""
    if len(axes) != len(values) or len(set(axes)) != len(axes):
        raise StreamError('name each axis once, with one value for each')
    return dict(zip(axes, values, strict=True))
