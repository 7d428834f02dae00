"""Lines by hand from the command line: give each one, wait for its end, tell where it ended."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cnc_interp.client.hand_move import connected
from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.core.units import MM_PER_MIN
from cnc_interp.machine_model.machine import Machine, place_text

PER_TURN = 1e-3  #: Unit of the feedrate with G95, as it is shown [m].
MOST = 100  #: Lines that are remembered.


class LineHistory:
    """The lines given, the last one first, shared by all pages."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=MOST)

    def add(self, line: str) -> None:
        if not self._lines or self._lines[0] != line:
            self._lines.appendleft(line)

    def at(self, age: int) -> tuple[int, str]:
        """Return the line of an age, and that age, limited to what there is; empty for -1."""
        age = max(-1, min(age, len(self._lines) - 1))
        return age, self._lines[age] if age >= 0 else ''


def modes_text(modes: Any) -> str:
    """Return a ``ModalState`` as one line of words."""
    words = list(modes.codes)
    if 'G93' in words:
        words += [] if modes.duration != modes.duration else [f'F{60.0 / modes.duration:g}']
    elif modes.feedrate == modes.feedrate:
        unit = PER_TURN if 'G95' in words else MM_PER_MIN
        words.append(f'F{modes.feedrate / unit:.10g}')
    words += [f'S{modes.spindle_speed:g}'] if modes.spindle_speed else []
    words += [f'T{modes.tool}'] if modes.tool else []
    return ' '.join(words)


@dataclass(frozen=True)
class LineEnd:
    """How a line has ended: its words, the answer, the modal state and where the axes stand."""

    line: str
    answer: Answer
    modes: str
    place: str
    position: dict[str, float]

    def text(self) -> str:
        return f'{self.line}: {self.answer.message}: {self.place}' if self.line else self.place

    def to_json(self) -> dict[str, Any]:
        return {
            'line': self.line,
            'ok': self.answer.ok,
            'message': self.answer.message,
            'modes': self.modes,
            'position': self.position,
        }


def give_lines(lines: Sequence[str], namespace: str, domain: int | None) -> Iterator[LineEnd]:
    """Have lines executed one after the other until one is refused; Ctrl-C stops the motion.

    Returns the end of each line; without lines, the modal state and the place. Raises InterpError
    if no nodes answer.
    """
    with connected('mdi', namespace, domain, lambda one: not one.silent and bool(one.modes)) as (
        client, machine,
    ):  # fmt: skip
        if not lines:
            yield _end(client, machine, '', Answer(True, 'the modal state'))
        for line in lines:
            asked = client.give_line(line)
            try:
                answer = client.wait_for(asked)
            except KeyboardInterrupt:
                client.cancel_lines()
                client.wait_for(asked)
                raise
            run = answer.response
            while run is not None and run.samples and not _rests(client.state, run.program_id):
                client.serve()
            yield _end(client, machine, line, answer)
            if not answer.ok:
                return


def _rests(state: Any, program_id: str) -> bool:
    return bool(state.program_id == program_id and state.resting)


def _end(client: OperatorClient, machine: Machine, line: str, answer: Answer) -> LineEnd:
    assert client.state is not None
    position = client.state.commanded_positions
    place = place_text(machine.axes, position)
    at = dict(zip(machine.axis_names, map(float, position), strict=True))
    return LineEnd(line, answer, modes_text(client.modes), place, at)
