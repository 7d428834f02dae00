"""The identity of a run in messages."""

from __future__ import annotations

from typing import Any

from cnc_interp.run.run_id import RunId


def run_id_of(message: Any) -> RunId:
    """Read the identity from a message; a message without the field ``plan`` has plan 0."""
    return RunId(message.program_id, message.attempt, getattr(message, 'plan', 0))
