"""
A program on its way to program_node: sent until it is answered, then followed to its end.

When program_node is killed and started again, DDS addresses the dead process for some twenty
seconds. The goal is therefore sent again until an answer comes. It keeps its id, so it cannot run
twice.
"""

from __future__ import annotations

import time
import uuid
from typing import Any

from cnc_interp_msgs.action import RunProgram
from unique_identifier_msgs.msg import UUID

#: Time without an answer after which a goal is sent again [s].
AGAIN = 1.0


class SentProgram:
    """A goal of ``run_program`` and what has been heard about it."""

    def __init__(self, client: Any, goal: RunProgram.Goal, ahead: int = 0):
        self.goal, self._ahead = goal, ahead
        self.feedback: RunProgram.Feedback | None = None
        self._client = client
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._answers: list[Any] = []
        self.handle: Any = None  # of the goal, once it is accepted
        self._result: Any = None
        self._send()

    def _send(self) -> None:
        self._sent_at = time.monotonic()
        self._answers.append(
            self._client.send_goal_async(self.goal, self._see_feedback, goal_uuid=self._id)
        )

    def _see_feedback(self, message: Any) -> None:
        self.feedback = message.feedback

    def follow(self) -> None:
        """
        Read an answer, or send the goal again. Call this repeatedly.

        A second answer to the same goal says "not accepted", because the first one runs. So the
        first answer counts.
        """
        if self.handle is not None:
            return
        answer = next((answer for answer in self._answers if answer.done()), None)
        if answer is not None:
            self.handle = answer.result()
            self._result = self.handle.get_result_async()
        elif time.monotonic() - self._sent_at > AGAIN:
            self._send()

    @property
    def accepted(self) -> bool:
        """True once program_node has accepted the goal."""
        return self.handle is not None

    @property
    def result(self) -> RunProgram.Result | None:
        """The result; None while the program waits or runs."""
        if self._result is None or not self._result.done():
            return None
        result: RunProgram.Result = self._result.result().result
        return result

    @property
    def programs_ahead(self) -> int:
        """Number of programs that run before this one."""
        return self._ahead if self.feedback is None else int(self.feedback.programs_ahead)

    def cancel(self) -> None:
        """Ask program_node to cancel the program."""
        if self.handle is not None:
            self.handle.cancel_goal_async()
