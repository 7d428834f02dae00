"""The sending end of a stream as a ROS topic: window, acknowledgements, repetition."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import StreamStatus
from rclpy._rclpy_pybind11 import RCLError
from rclpy.qos import QoSProfile

from cnc_interp.core.errors import Refusal
from cnc_interp.nodes.message_seal import sealed
from cnc_interp.nodes.qos import STATUS, STREAM
from cnc_interp.run.run_id import RunId
from cnc_interp.wire.run_id_messages import run_id_of
from cnc_interp.wire.window_protocol import WindowedSender


class Outlet:
    """The sending end of a stream."""

    def __init__(
        self,
        node: Any,
        stream: str,
        kind: Any,
        resend_after: float,
        encode: Callable[[Any, int], Any],
        topic: str = '',
        profile: QoSProfile = STREAM,
    ):
        self.sender: WindowedSender[Any] = WindowedSender(resend_after)
        self.stream = stream
        self.peer: StreamStatus | None = None
        self.heard = -math.inf  # when, by the monotonic clock [s]
        self.turned_away = False  # the plan that was to join came too late
        self._before = self.sender
        self._encode = encode
        self._publisher = node.create_publisher(kind, topic or stream, profile)
        self._subscription = node.create_subscription(
            StreamStatus, 'stream_status', self._acknowledge, STATUS
        )

    def _acknowledge(self, status: StreamStatus) -> None:
        """Move the window forward and send."""
        if status.stream != self.stream:
            return
        if status.refusal_kind == Refusal.TOO_LATE:
            self.turned_away = run_id_of(status) == self.sender.run_id
            return
        self.peer, self.heard = status, time.monotonic()
        run_id = run_id_of(status)
        told = run_id, status.next_sequence, status.window_limit, self.heard, status.gap
        self.sender.acknowledge(*told)
        if self._before.run_id == run_id:  # valid until the new plan has joined
            self._before.acknowledge(*told)
            self.sender.open(status.window_limit)
        self.pump()

    def join(self, run_id: RunId, first: int) -> None:
        """
        Send a plan that joins the one before, from a number on; that one can be taken back.

        The numbers go on, and the window with them: nothing waits for the first acknowledgement.
        """
        self._before, self.sender = self.sender, WindowedSender(self.sender.resend_after)
        self.sender.begin(run_id, first, self._before.limit)

    def take_back(self) -> None:
        """Continue with the plan before the one that was to join."""
        self.sender, self.turned_away = self._before, False

    @property
    def refused(self) -> Refusal:
        """Why the receiver refuses the run; NONE if it does not."""
        peer = self.peer
        if peer is None or run_id_of(peer) != self.sender.run_id:
            return Refusal.NONE
        return Refusal(peer.refusal_kind)

    @property
    def refusal_text(self) -> str:
        """The receiver's text for this reason."""
        return '' if self.peer is None else str(self.peer.refusal)

    def pump(self) -> None:
        """Send as much as the window allows."""
        if not self.sender.run_id or self.refused:
            return
        items = self.sender.due(time.monotonic())
        for done, item in enumerate(items):
            try:
                self._publisher.publish(sealed(self._encode(item.item, item.first)))
            except RCLError:  # publishing failed: the rest is sent at the next call
                self.sender.take_back(len(items) - done)
                return
