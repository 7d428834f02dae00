"""Where the rotary axes are, from touches of one ball at several rotary positions.

The centre c(q) of the probe's ball is at the distance R + r from the centre b of the ball that it
touches, for every touch. With the offsets g of the machine file,

    | c(q; g) - b | = R + r + e,

is solved for changes of g, b and the pretravel e, the same in all directions, by Gauss and Newton.
Some changes of g move nothing: the axes along themselves, and all together. Of all
solutions the smallest change of g is taken, so what cannot be seen stays as it is.
"""

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_entries import GEOMETRY
from cnc_interp.machine_model.transform import Transform

STEP, SMALLEST = 1e-5, 1e-9  #: Of the differences, and of a last change [m].
SEEN = 1e-3  #: Smaller singular values than this share of the largest belong to what is not seen.
LEAST = 4  #: Numbers that two axes have at least: two for the place of each line.
ROUNDS = 20


@dataclass(frozen=True)
class RotaryCentres:
    machine: Machine  #: With the new offsets.
    spread: FloatArray  #: (5, 3): Standard deviations of ``offsets`` and ``tool_offset`` [m].
    ball: FloatArray  #: (3,): Its centre in W [m].
    residuals: FloatArray  #: (n,): What is left of each touch [m].

    def text(self) -> str:
        offsets = np.concatenate([self.machine.offsets, self.machine.tool_offset])
        return '\n'.join(
            f'{key}: [{", ".join(f"{x / MM:.4f}" for x in row)}]  # +- '
            + ', '.join(f'{x / MM:.4f}' for x in spread)
            for key, row, spread in zip(GEOMETRY, offsets, self.spread, strict=True)
            if spread.max() > SMALLEST
        )


def centres_of(machine: Machine, q: FloatArray, beyond: float) -> FloatArray:
    tip, axis = Transform.of(machine).forward(q)
    return tip - beyond * axis


def ball_of(machine: Machine, q: FloatArray, reach: float, beyond: float) -> FloatArray:
    c = centres_of(machine, q, beyond)
    b = c[0] - [0.0, 0.0, reach]
    for _ in range(ROUNDS):
        ways = c - b
        lengths = np.linalg.norm(ways, axis=1)
        step = np.linalg.lstsq(ways / lengths[:, None], lengths - reach, rcond=None)[0]
        b = b + step
    return np.asarray(b)


def fit_rotary_centres(
    machine: Machine, q: FloatArray, reach: float, beyond: float
) -> RotaryCentres:
    """Fit the offsets of a machine to touches.

    ``q`` (n, n_axes): axis positions at the contacts [m, rad]; ``reach``: radius of the ball and
    of the probe's ball [m]; ``beyond``: centre of the latter beyond the tip in the machine file
    [m]. Raises InterpError where the touches do not determine the axes.
    """
    if not machine.has_rotary:
        raise InterpError('the machine has no rotary axes')
    offsets = np.concatenate([machine.offsets, machine.tool_offset])
    ball, pretravel = ball_of(machine, q[:5], reach, beyond), 0.0
    # The workpiece offset only shifts W, and arms of the tool are those of heads.
    free = np.repeat([False, True, True, *[bool(any(machine.rotary_on_head))] * 2], 3)

    def gaps(offsets: FloatArray, ball: FloatArray) -> FloatArray:
        changed = replace(machine, offsets=offsets[:3], tool_offset=offsets[3:])
        ways = centres_of(changed, q, beyond) - ball
        return np.asarray(np.linalg.norm(ways, axis=1) - reach)

    for _ in range(ROUNDS):
        gap = gaps(offsets, ball) - pretravel
        slope = np.zeros((len(q), 15))
        for k in np.flatnonzero(free):
            moved = offsets.copy()
            moved.ravel()[k] += STEP
            slope[:, k] = (gaps(moved, ball) - pretravel - gap) / STEP
        beside = [(gaps(offsets, ball + way) - pretravel - gap) / STEP for way in STEP * np.eye(3)]
        others = np.stack([*beside, np.full(len(q), -1.0)], axis=1)
        # What ball and pretravel can do is theirs.
        own = slope - others @ np.linalg.lstsq(others, slope, rcond=None)[0]
        inverse = np.linalg.pinv(own, rcond=SEEN)
        change = -inverse @ gap
        rest = -np.linalg.lstsq(others, gap + slope @ change, rcond=None)[0]
        offsets += change.reshape(5, 3)
        ball, pretravel = ball + rest[:3], pretravel + rest[3]
        if np.abs(change).max() < SMALLEST:
            break
    seen = int(np.linalg.matrix_rank(inverse, tol=0.0 if not inverse.any() else None))
    left = gaps(offsets, ball) - pretravel
    if seen < LEAST or len(q) <= seen + 4:
        raise InterpError('the touches do not determine both rotary axes; turn them further')
    noise = np.sqrt(left @ left / (len(q) - seen - 4))
    spread = noise * np.linalg.norm(inverse, axis=1).reshape(5, 3)
    found = replace(machine, offsets=offsets[:3], tool_offset=offsets[3:])
    return RotaryCentres(found, spread, ball, left)
