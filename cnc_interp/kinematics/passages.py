"""Passages of singular poses; a segment waits until no later segment can change its guide."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Generic, TypeVar

from cnc_interp.core import IntArray
from cnc_interp.kinematics.path_ahead import PathAhead
from cnc_interp.smoothing.segments import PathSegments

Ahead = TypeVar('Ahead', bound=PathAhead)


class Passages(ABC, Generic[Ahead]):
    """Common part of the passages of a five-axis pole and of the singular poses of an arm."""

    def __init__(self) -> None:
        self._waiting: Ahead | None = None  # segments that are not released
        self._open = 0  # the first of them in which a stretch may begin
        self._begins, self._stopped = True, True
        #: Path length from the last stop to the first waiting segment [m]. It does not depend, to
        #: the last bit, on how the segments arrive.
        self._begun = 0.0

    @property
    def notice(self) -> tuple[int, str] | None:
        """A line number and a text for the operator about the passages, or None."""
        return None

    @abstractmethod
    def _look_at(self, segments: PathSegments, motion: IntArray) -> Ahead: ...

    @abstractmethod
    def _pass(self, path: Ahead, closed: bool) -> int:
        """Choose the passages of a path between stops; return how many segments are final."""

    def _step_over(self, path: Ahead, i: int) -> None:
        """Skip a segment that prescribes its rotary axes, so that it has no passage."""

    def _released(self) -> None:
        """Record that the first segments have been released."""

    def take(self, segments: PathSegments, motion: IntArray) -> Ahead:
        """Accept segments with the motion of their axes; return the segments that are final.

        The deviation of the segments includes that of the passages.
        """
        path = self._look_at(segments, motion)
        if self._waiting is not None:
            path = self._waiting.and_more(path)
        free, at, n = self._open, 0, len(path)
        stop = path.segments.stop
        while at < n:
            if not path.with_poses(at):
                self._step_over(path, at)
                at += 1
                self._begins = True
                continue
            last = at + 1
            while last < n and not stop[last - 1] and path.with_poses(last):
                last += 1
            closed = last < n or bool(stop[last - 1])
            self._open = max(free - at, 0)
            ready = self._pass(replace(path[at:last], begun=self._begun), closed)
            if not closed:
                free = at + self._open
                self._begins = self._begins and ready == 0
                at += ready
                break
            self._stopped, self._begins = bool(stop[last - 1]), True
            at = last
        self._open = max(free - at, 0)
        if at:
            self._released()
        self._waiting = path[at:]
        done = path[:at]
        deviation = done.segments.deviation.copy()
        deviation[:, 1] += done.height * done.bound
        return replace(done, segments=replace(done.segments, deviation=deviation))
