"""A request to a service that is sent again until it is answered.

An answer can be lost: a node drops it if it has heard of the request before it knows where answers
are read, as happens on a busy computer while both find each other. A node that was killed never
answers, and DDS addresses the dead process for some twenty seconds.
"""

from __future__ import annotations

import math
import time
from typing import Any

#: Time without an answer after which a request is sent again, unless told otherwise [s].
AGAIN = 0.5


class Question:
    """One request, sent as often as needed."""

    def __init__(self, client: Any, request: Any, again: float = AGAIN):
        self._client, self._request, self._again = client, request, again
        self._sent: list[Any] = []
        self._sent_at = -math.inf

    def answer(self) -> Any | None:
        """Return the response; None while there is none. To be called again and again."""
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
        """Wait no longer for answers."""
        for future in self._sent:
            self._client.remove_pending_request(future)
