"""Every refusal of the interpolator: one base class, specific kinds that carry their values."""

from __future__ import annotations

from enum import IntEnum


class InterpError(Exception):
    """A request that cannot be carried out; the message says what is wrong and what to do."""


class ProgramError(InterpError):
    """
    A part program that cannot be read.

    Parameters
    ----------
    message : str
        What is wrong and what would be right.
    source : str
        File name, or ``<text>``.
    line_number : int
        Line in the file, from 1; 0 when the fault belongs to the whole file.
    word : str
        The offending word as written, or empty.

    """

    def __init__(self, message: str, source: str = '', line_number: int = 0, word: str = ''):
        self.source, self.line_number, self.word = source, line_number, word
        place = source + (f':{line_number}' if line_number else '')
        at = f'{word}: ' if word else ''
        super().__init__(f'{place}: {at}{message}' if place else f'{at}{message}')


class MachineError(InterpError):
    """A machine file that cannot be used; names the key."""

    def __init__(self, message: str, key: str = ''):
        self.key = key
        super().__init__(f'{key}: {message}' if key else message)


class SettingsError(InterpError):
    """
    A choice of the user that is not possible.

    Parameters
    ----------
    name : str
        Name of the choice.
    reason : str
        What is wrong with its value and what would be right.

    """

    def __init__(self, name: str, reason: str):
        self.name, self.reason = name, reason
        super().__init__(f'{name}: {reason}')


class BlockError(InterpError):
    """
    A block whose motion is refused before anything moves.

    The rooms know the line of a block; who knows the file as well sets ``source``.

    Parameters
    ----------
    message : str
        What is wrong and what to do.
    line_number : int
        Line of the part program, 0 when unknown.
    axis : str
        Name of the machine axis concerned, or empty.
    value : float
        The offending value in SI, NaN when there is none.

    """

    def __init__(
        self, message: str, line_number: int = 0, axis: str = '', value: float = float('nan')
    ):
        self.message, self.source = message, ''
        self.line_number, self.axis, self.value = line_number, axis, value
        super().__init__(message)

    def __str__(self) -> str:
        """Name the file, where it is known, and the line."""
        if self.source:
            line = f':{self.line_number}' if self.line_number else ''
            return f'{self.source}{line}: {self.message}'
        return f'line {self.line_number}: {self.message}' if self.line_number else self.message


class TravelError(BlockError):
    """A pose outside the travel of an axis."""


class SingularityError(BlockError):
    """A path through a pose where a rotary axis is undefined."""


class PlanningError(BlockError):
    """A path along which no motion law within the limits was found."""


class Refusal(IntEnum):
    """Why a message or the rest of a run is not taken; constants of ``StreamStatus``."""

    NONE = 0
    # For the whole run:
    BAD_MESSAGE = 1  # a message is not sound: a value or a shape
    NOT_READY = 2  # the node is not active, or the machine is busy or on hold
    BAD_PATH = 3  # a block cannot be executed on this machine
    GIVEN_UP = 4  # the machine has left the run: it was reset or restarted
    MACHINE_FAULT = 5  # the machine stopped: fault or emergency stop
    # For one message; the stream goes on:
    GAP = 16  # messages before it are missing
    SPOILT = 17  # its checksum is wrong
    REPEAT = 18  # it was received before
    FOREIGN_RUN = 19  # it belongs to another run
    LATE = 20  # it comes after the end of its run or plan


class StreamError(InterpError):
    """
    A message that breaks the contract of a stream (gap, repeat, foreign program, wrong shape).

    Parameters
    ----------
    message : str
        What is wrong and what to do.
    kind : Refusal
        What the run is refused for because of it.

    """

    def __init__(self, message: str, kind: Refusal = Refusal.BAD_MESSAGE):
        self.kind = kind
        super().__init__(message)
