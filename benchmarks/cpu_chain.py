"""The chain of ``cnc-interp plan``, its rooms timed on the CPU's own clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from figures import Stopwatch

from cnc_interp.run.chain import Chain


class CpuChain(Chain):
    """A chain that counts CPU seconds."""

    def _timed(self, room: str, work: Callable[..., Any], *arguments: Any) -> Any:
        watch = Stopwatch()
        try:
            return work(*arguments)
        finally:
            self.seconds[room] += watch.seconds()
