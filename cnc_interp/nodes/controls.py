"""Services of the machine for the operator: holds and stops, cycle start, single block, reset."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool, Trigger

from cnc_interp.core.errors import StreamError
from cnc_interp.machine.playback import Playback


class Controls:
    """Services that act on the playback at once, without the other nodes."""

    def __init__(
        self,
        node: Any,
        playback: Playback,
        give_up: Callable[[str], None],
        wake: Callable[[], None],
    ):
        self._playback, self._give_up, self._wake = playback, give_up, wake
        for name, act, gives_up in (
            ('feed_hold', playback.hold, ''),
            ('cycle_start', playback.start, ''),
            ('emergency_stop', playback.stop, ''),
            ('reset', playback.reset, 'given up by reset'),
        ):
            node.create_service(Trigger, name, self._answering(act, gives_up))
        node.create_service(SetBool, 'single_block', self._set_single_block)

    def _set_single_block(self, request: Any, response: Any) -> Any:
        """Answer the service ``single_block``."""
        self._playback.single_block = request.data
        response.success, response.message = True, f'single block: {request.data}'
        return response

    def _answering(self, act: Callable[[], None], gives_up: str) -> Callable[[Any, Any], Any]:
        """Make a service of an action; an action that is not possible raises."""

        def serve(_request: Any, response: Any) -> Any:
            self._wake()
            try:
                act()
                state = self._playback.state.state.value
                if gives_up:  # informs the senders and the playback
                    self._give_up(gives_up)
                response.success, response.message = True, state
            except StreamError as problem:
                response.success, response.message = False, str(problem)
            return response

        return serve
