"""
A goal for `run_program`, sent until it is answered.

Where program_node was killed and started again, DDS goes on believing in the dead one for some
twenty seconds, and what is sent before the new one was found goes to the dead one only. The goal
keeps its id, so it can never run twice.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from typing import Any

from unique_identifier_msgs.msg import UUID

#: Time without an answer after which a goal is sent again [s].
AGAIN = 1.0


class AskedGoal:
    """
    A goal on its way; ask for ``handle`` again and again.

    Parameters
    ----------
    client : ActionClient
        Of `run_program`.
    goal : RunProgram.Goal
        What is wanted.
    on_feedback : callable
        Told every feedback message.

    """

    def __init__(self, client: Any, goal: Any, on_feedback: Callable[[Any], None] | None = None):
        self._client, self._goal, self._on_feedback = client, goal, on_feedback
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._sent: list[Any] = []
        self._send()

    def _send(self) -> None:
        self._sent_at = time.monotonic()
        self._sent.append(
            self._client.send_goal_async(self._goal, self._on_feedback, goal_uuid=self._id)
        )

    @property
    def handle(self) -> Any:
        """
        The handle of the goal once it was answered; None before.

        What comes twice is answered with "not accepted" the second time, for the first one runs.
        """
        for answer in self._sent:
            if answer.done():
                return answer.result()
        if time.monotonic() - self._sent_at > AGAIN:
            self._send()
        return None
