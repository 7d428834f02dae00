"""Requests that are resent until they are answered: service calls, and programs.

An answer is lost if the node received the request before it discovered the client's reader of
answers. A killed node never answers. A resent goal keeps its id, so it cannot run twice. The
result of a goal is also requested repeatedly: a restarted node answers that the goal is unknown.
"""

import math
import time
import uuid
from typing import Any

from cnc_interp_msgs.action import RunProgram
from unique_identifier_msgs.msg import UUID

#: Default time until an unanswered request is resent [s].
AGAIN = 0.5


class Question:
    """One service request, resent until it is answered."""

    def __init__(self, client: Any, request: Any, again: float = AGAIN):
        self._client, self._request, self._again = client, request, again
        self._sent: list[Any] = []
        self._sent_at = -math.inf

    def answer(self) -> Any | None:
        """Return the response, or None while there is none; call this repeatedly."""
        for future in self._sent:
            if future.done():
                self.drop()
                self._sent = [future]
                return future.result()
        now = time.monotonic()
        if now - self._sent_at >= self._again and self._client.service_is_ready():
            self._sent_at = now
            self._sent.append(self._client.call_async(self._request))
        return None

    def drop(self) -> None:
        for future in self._sent:
            self._client.remove_pending_request(future)


GOAL_AGAIN = 1.0  #: Time until an unanswered goal is resent [s].
#: Longest time between requests for a result [s]; nodes store results for ten seconds.
SELDOM = 8.0


class SentProgram:
    """A goal of ``run_program``, with the answers received so far."""

    def __init__(self, client: Any, goal: RunProgram.Goal, ahead: int = 0):
        self.goal, self._ahead = goal, ahead
        self.feedback: RunProgram.Feedback | None = None
        self._client = client
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._answers: list[Any] = []
        self.handle: Any = None  # of the goal, once it is accepted
        self._results: list[Any] = []
        self._ask_after = GOAL_AGAIN
        self._send()

    def _send(self) -> None:
        self._sent_at = time.monotonic()
        sent = self._client.send_goal_async(self.goal, self._see_feedback, goal_uuid=self._id)
        self._answers.append(sent)

    def _see_feedback(self, message: Any) -> None:
        self.feedback = message.feedback

    def follow(self) -> None:
        """Read answers; resend the goal, or the request for its result. Call this repeatedly.

        Only the first answer counts: a second copy of the goal is answered "not accepted", because
        the first one is running.
        """
        now = time.monotonic()
        if self.handle is not None:
            if self.result is None and now - self._sent_at > self._ask_after:
                self._ask_after = min(2.0 * self._ask_after, SELDOM)
                self._ask(now)
            return
        answer = next((answer for answer in self._answers if answer.done()), None)
        if answer is not None:
            self.handle = answer.result()
            self._ask(now)
        elif now - self._sent_at > GOAL_AGAIN:
            self._send()

    def _ask(self, now: float) -> None:
        self._sent_at = now
        self._results.append(self.handle.get_result_async())

    @property
    def accepted(self) -> bool:
        return self.handle is not None

    @property
    def result(self) -> RunProgram.Result | None:
        return next((one.result().result for one in self._results if one.done()), None)

    @property
    def programs_ahead(self) -> int:
        return self._ahead if self.feedback is None else int(self.feedback.programs_ahead)

    def cancel(self) -> None:
        if self.handle is not None:
            self.handle.cancel_goal_async()
