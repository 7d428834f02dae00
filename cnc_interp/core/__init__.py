"""Array types, products of vectors, units and errors, which all rooms use.

Shop-floor units are defined by their SI values: ``0.02 * MM`` is a length in metres. All values in
the code are SI.
"""

from enum import Enum, IntEnum
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

MM = 1e-3
UM = 1e-6
INCH = 25.4e-3
DEG = pi / 180.0
ARCSEC = DEG / 3600.0
REV = 2.0 * pi
MINUTE, HOUR = 60.0, 3600.0
MS = 1e-3
MM_PER_MIN = MM / MINUTE
M_PER_MIN = 1.0 / MINUTE
REV_PER_MIN = REV / MINUTE


# Products of arrays of vectors, (..., 3): faster than ``np.cross`` and ``norm`` on short ones.


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return scalar products; the order of summation is fixed, so results are reproducible."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def norm(a: FloatArray) -> FloatArray:
    return np.sqrt(dot(a, a))


def unit(a: FloatArray) -> FloatArray:
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(a / norm(a)[..., None])


def scaled(factor: Any, a: FloatArray) -> FloatArray:
    return np.asarray(np.asarray(factor)[..., None] * a)


class InterpError(Exception):
    """A request cannot be carried out; the message says what is wrong and what to do."""


class DependsOn(Enum):
    """What a refusal of a line depends on. After an earlier rejected line, that may be wrong."""

    LINE = 1  #: Only the words of the line itself.
    PLACE = 2  #: The position that earlier lines have reached.
    STATE = 3  #: The modal state that earlier lines have set.
    LEFT_OVER = 4  #: As STATE, but the rest of the line was executed.


class ProgramError(InterpError):
    """A part program cannot be read; ``line_number`` counts from 1, and 0 means the whole file."""

    def __init__(
        self,
        message: str,
        source: str = '',
        line_number: int = 0,
        word: str = '',
        depends_on: DependsOn = DependsOn.STATE,
    ):
        self.message, self.depends_on = message, depends_on
        self.source, self.line_number, self.word = source, line_number, word
        place = source + (f':{line_number}' if line_number else '')
        at = f'{word}: ' if word else ''
        super().__init__(f'{place}: {at}{message}' if place else f'{at}{message}')


class RefusedLinesError(ProgramError):
    """A part program cannot be read for several reasons; the attributes describe the first."""

    def __init__(self, errors: list[ProgramError], text: str):
        first = errors[0]
        super().__init__(first.message, first.source, first.line_number, first.word)
        self.errors, self.text = tuple(errors), text

    def __str__(self) -> str:
        return self.text


class MachineError(InterpError):
    """A machine file cannot be used; ``key`` is the entry that is wrong."""

    def __init__(self, message: str, key: str = ''):
        self.key = key
        super().__init__(f'{key}: {message}' if key else message)


class SettingsError(InterpError):
    """The user chose a value that is not possible."""

    def __init__(self, name: str, reason: str):
        self.name, self.reason = name, reason
        super().__init__(f'{name}: {reason}')


class BlockError(InterpError):
    """A block is rejected before anything moves; callers that know the file set ``source``."""

    def __init__(
        self, message: str, line_number: int = 0, axis: str = '', value: float = float('nan')
    ):
        self.message, self.source = message, ''
        self.line_number, self.axis, self.value = line_number, axis, value
        super().__init__(message)

    def __str__(self) -> str:
        if self.source:
            line = f':{self.line_number}' if self.line_number else ''
            return f'{self.source}{line}: {self.message}'
        return f'line {self.line_number}: {self.message}' if self.line_number else self.message


class TravelError(BlockError):
    """A pose lies outside the travel of an axis."""


class SingularityError(BlockError):
    """The path passes through a pose where a rotary axis is undefined."""


class PlanningError(BlockError):
    """No motion law within the axis limits was found along a path."""


class Refusal(IntEnum):
    """Why a message or the rest of a run is rejected; values as in ``StreamStatus``."""

    NONE = 0
    # The whole run is refused:
    BAD_MESSAGE = 1  # a message has a wrong value or shape
    NOT_READY = 2  # the node is not active, or the machine is busy or on hold
    BAD_PATH = 3  # a block cannot be executed on this machine
    GIVEN_UP = 4  # the machine was reset or restarted
    MACHINE_FAULT = 5  # the machine stopped by a fault or an emergency stop
    PROBED = 6  # no fault: the run has ended where the probe answered
    # One message is refused, and the stream continues:
    GAP = 16  # messages before it are missing
    SPOILT = 17  # its checksum is wrong
    REPEAT = 18  # it was received before
    FOREIGN_RUN = 19  # the message belongs to another run
    LATE = 20  # it comes after the end of its run
    PLAN_OVER = 21  # no fault: the message was under way when a stop ended its plan
    TOO_LATE = 22  # its plan was to join where the machine has passed; the plan before goes on
    FOREIGN = 23  # no fault of the run: another node sent it, and it was ignored


class StreamError(InterpError):
    """A message breaks the rules of its stream: gap, repeat, wrong program or wrong shape."""

    def __init__(self, message: str, kind: Refusal = Refusal.BAD_MESSAGE):
        self.kind = kind
        super().__init__(message)


def demand(holds: object, fault: Exception) -> None:
    """Raise a fault unless what is demanded holds."""
    if not holds:
        raise fault


def refuse_if(fails: object, fault: Exception) -> None:
    """Raise a fault if something fails."""
    if fails:
        raise fault
