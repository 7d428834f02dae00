"""Division of blocks into pieces in which [B2013, Eq. 4] approximates the programmed motion.

The deviation of a piece falls with the square of its length, so one trial gives the number of
pieces.
"""

from collections.abc import Callable

import numpy as np

from cnc_interp.core import DEG, FloatArray, IntArray

Poses = Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]]

# The deviation of a short piece is a parabola plus an odd cubic. The largest value at these points
# is within 3 % of the maximum of either; the margin covers this.
_PROBES = (0.25, 0.5, 0.75)
_MARGIN = 1.05
_TRIAL_SWEEP = 15.0 * DEG
MOST_PIECES = 1_000_000
_LARGEST_SWEEP = 89.9 * DEG


def great_circle(o_from: FloatArray, o_to: FloatArray, u: FloatArray) -> FloatArray:
    """Return tool axes ``(sin((1 - u) theta) o_from + sin(u theta) o_to) / sin(theta)``."""
    theta = angle_between(o_from, o_to)
    with np.errstate(invalid='ignore', divide='ignore'):
        w_from = np.sin((1.0 - u) * theta) / np.sin(theta)
        w_to = np.sin(u * theta) / np.sin(theta)
    small = theta < 1e-9
    w_from, w_to = np.where(small, 1.0 - u, w_from), np.where(small, u, w_to)
    o = w_from[:, None] * o_from + w_to[:, None] * o_to
    return np.asarray(o / np.linalg.norm(o, axis=1)[:, None])


def angle_between(o_from: FloatArray, o_to: FloatArray) -> FloatArray:
    """Return the angles between unit vectors [rad], accurate for small and large angles."""
    apart = np.linalg.norm(o_to - o_from, axis=1)
    return np.asarray(2.0 * np.arctan2(apart, np.linalg.norm(o_to + o_from, axis=1)))


def piece_counts(
    poses: Poses,
    turned: FloatArray,
    allowed_tip: FloatArray,
    allowed_top: FloatArray,
    height: float,
) -> IntArray:
    """Return the number of equal pieces per block, (n,), so that chords and great circles fit.

    ``poses`` maps block indices and parameters in [0, 1], (m,), to tips [m] and tool axes;
    ``turned`` (n,): turn of the rotary axes or of the arc [rad]; ``allowed_tip``, ``allowed_top``
    (n,): largest distance from the chord [m]. A count above ``MOST_PIECES`` is a lower bound.
    """
    fewest = np.maximum(np.ceil(turned / _LARGEST_SWEEP), 1.0)
    trial = np.maximum(np.ceil(turned / _TRIAL_SWEEP), 1.0)
    every = np.arange(len(trial))
    ratio = _MARGIN * _largest_deviation(poses, every, trial, allowed_tip, allowed_top, height)
    counts = np.maximum(fewest, np.ceil(trial * np.sqrt(ratio)))
    open_rows = np.arange(len(counts))
    while len(open_rows) and counts.max() <= MOST_PIECES:
        ratio = _MARGIN * _largest_deviation(
            poses, open_rows, counts[open_rows], allowed_tip, allowed_top, height
        )
        wide = ratio > 1.0
        open_rows, ratio = open_rows[wide], ratio[wide]
        counts[open_rows] = np.maximum(
            counts[open_rows] + 1.0, np.ceil(counts[open_rows] * np.sqrt(ratio))
        )
    return np.asarray(counts, dtype=np.int64)


def _largest_deviation(
    poses: Poses,
    rows: IntArray,
    counts: FloatArray,
    allowed_tip: FloatArray,
    allowed_top: FloatArray,
    height: float,
) -> FloatArray:
    which, piece = ragged(counts.astype(np.int64))
    block, step = rows[which], 1.0 / counts[which]
    tip_from, o_from = poses(block, piece * step)
    tip_to, o_to = poses(block, (piece + 1.0) * step)
    worst = np.zeros(len(block))
    for u in _PROBES:
        tip, o = poses(block, (piece + u) * step)
        off = tip - tip_from - u * (tip_to - tip_from)
        worst = np.maximum(worst, np.linalg.norm(off, axis=1) / allowed_tip[block])
        o_circle = great_circle(o_from, o_to, np.full(len(block), u))
        top = np.linalg.norm(off + height * (o - o_circle), axis=1)
        top = np.maximum(top, height * angle_between(o, o_circle))
        worst = np.maximum(worst, top / allowed_top[block])
    first = np.concatenate([[0], np.cumsum(counts.astype(np.int64))[:-1]])
    return np.asarray(np.maximum.reduceat(worst, first))


def ragged(counts: IntArray) -> tuple[IntArray, IntArray]:
    """Return block index and index within its block of every piece, given ``counts`` (n,)."""
    row = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    return row, np.arange(len(row)) - first[row]
