"""Cubic and quadratic splines of LinuxCNC (G5, G5.1), as lines within a tenth of the tolerance."""

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.text.words import BlockWords

CODES = ('G5', 'G5.1')
CHORD_SHARE = 0.1  #: Share of the contour tolerance for the chords; smoothing uses the rest [-].
MOST_CHORDS = 100_000


def go_along(mover: Mover, code: str, words: BlockWords) -> None:
    """Add the motion along a spline in X and Y.

    I J lead from the start to the first control point, P Q from the end to the second one. Without
    I J, a cubic spline continues the preceding one smoothly.
    """
    values, here = words.values, mover.here()[:3]
    mover.demand(
        mover.plane == 'G17', 'a spline lies in the plane of X and Y; write G17 first', code
    )
    mover.demand(not mover.targets.empty, 'begins where the tool is; move there first', code)
    first, last = (_way(mover, pair, values) for pair in ('IJ', 'PQ'))
    if code == 'G5.1' and first is None:
        raise mover.fault('needs I and J, the vector to the control point', code)
    if code == 'G5' and last is None:
        raise mover.fault(
            'needs P and Q, the vector from the end to the second control point', code
        )
    if code == 'G5' and first is None:
        first, ended = mover.spline_goes_on
        mover.demand(
            np.array_equal(ended, mover.point),
            'needs I and J, because it follows no spline',
            code,
        )
    assert first is not None
    end = mover.target(words)[:3]
    mover.demand(
        abs(end[2] - here[2]) <= 0.0, 'a spline lies in the plane of X and Y; leave out Z', code
    )
    points = np.stack(
        [here, here + first, end] if last is None else [here, here + first, end + last, end]
    )
    if last is None:  # a quadratic one, as a cubic one
        points = np.stack(
            [points[0], *(points[i] + 2.0 / 3.0 * (points[1] - points[i]) for i in (0, 2)), end]
        )
    # A chord of a curve with the second derivative b leaves it by b / (8 n^2) at most.
    bend = 6.0 * np.abs(np.diff(points, 2, axis=0)).max(axis=0)
    count = np.sqrt(np.linalg.norm(bend) / (8.0 * CHORD_SHARE * mover.contour))
    mover.demand(
        count <= MOST_CHORDS, f'more than {MOST_CHORDS:,} chords; widen the tolerance', code
    )
    kept = mover.contour, mover.stop_always, mover.stop_once
    mover.contour, mover.stop_always = (1.0 - CHORD_SHARE) * mover.contour, False
    mover.stop_once = False
    for u in np.linspace(0.0, 1.0, max(int(np.ceil(count)), 1) + 1)[1:]:
        weights = np.array([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3])
        place = end if u == 1.0 else weights @ points
        if u == 1.0:
            _, mover.stop_always, mover.stop_once = kept
        mover.go(mover.frames.point(place), mover.rotary, rapid=False)
    mover.contour = kept[0]
    mover.spline_goes_on = np.stack([points[3] - points[2], mover.point])


def _way(mover: Mover, pair: str, values: dict[str, float]) -> FloatArray | None:
    given = [values.pop(letter) for letter in pair if letter in values]
    mover.demand(len(given) != 1, f'give both {pair[0]} and {pair[1]}, or neither', 'G5')
    return np.array([*given, 0.0]) * mover.unit if given else None
