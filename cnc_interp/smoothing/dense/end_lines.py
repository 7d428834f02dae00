"""The lines on which curves start and end: long blocks, and chords beside corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.smoothing.dense import skeleton
from cnc_interp.smoothing.dense.curve_fit import AHEAD, LONGEST
from cnc_interp.smoothing.dense.growing_skeleton import Chain
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.orientation import rotations_between, turned_by

#: A chord beside a corner is this long, where it can be, and the corner gets this part of it; both
#: in tolerances.
CHORD, CORNER_PART = 20.0, 14.0
#: Way along the blocks within which it ends, in tolerances.
REACH = 30.0
#: Tolerances that blocks may lie off it.
OFF = 0.3
#: Blocks on a chord are told apart where they are this long, in tolerances.
CUT = 0.5
#: A curve starts inside a long block at most this many longest spacings before its end,
#: and within this share of it.
LEAD, LEAD_SHARE = 2.0, 0.4


@dataclass(frozen=True)
class Leg:
    """
    The line on which a run starts or ends.

    Parameters
    ----------
    segment : int
        Segment of the chain that it stands for.
    vertex : int
        Vertex of the chain next to it inside the run.
    pose : tuple of ndarray
        Tip and axis where line and curve meet.
    goal : tuple of ndarray
        Tip and axis of ``vertex``.
    used : ndarray, shape (2,)
        Deviation of the line from the blocks [m].
    feed : float
        Lowest feed of the blocks that it stands for [m/s].
    cuts : ndarray, shape (m,)
        Where these blocks meet on the way between ``pose`` and ``goal``, as the tool goes [-].
    pieces : ndarray of int, shape (m + 1,)
        Segments of the chain between the cuts.

    """

    segment: int
    vertex: int
    pose: tuple[FloatArray, FloatArray]
    goal: tuple[FloatArray, FloatArray]
    used: FloatArray
    feed: float
    cuts: FloatArray
    pieces: IntArray


def longest_spacing(chain: Chain, k: int) -> float:
    """Return the longest spacing of knots at a segment [m]."""
    return LONGEST * float(chain.tolerance[k].min())


def leg_at(chain: Chain, vertex: int, step: int, other: int, ended: bool) -> Leg:
    """
    Choose the line on which a run meets what is before (step 1) or after it (step -1).

    Beside a long block that is the block itself; at a corner it is a chord over as many short
    blocks as lie near it. ``other`` is the vertex at the far end of the run, as far as it is known
    (``ended``: it ends there).
    """
    tip, axis = chain.blocks.tip, chain.blocks.axis
    here = tip[vertex], axis[vertex]
    if not chain.ends[vertex]:
        k = vertex if step > 0 else vertex + 1
        far = vertex - step
        length = float(np.linalg.norm(tip[far] - tip[vertex]))
        share = min(LEAD_SHARE, LEAD * longest_spacing(chain, k) / length)
        pose = between(*here, tip[far], axis[far], share)
        feed, piece = float(chain.feed[k]), np.array([k])
        return Leg(k, vertex, pose, here, chain.used[k], feed, np.zeros(0), piece)
    k = vertex + 1 if step > 0 else vertex
    longest, least = longest_spacing(chain, k), float(chain.tolerance[k].min())
    whole = abs(float(chain.u[other] - chain.u[vertex]))
    reach = whole / 3.0 if ended and whole < AHEAD * longest else REACH * least
    beyond = np.searchsorted(chain.u, chain.u[vertex] + step * reach, 'right')
    if step > 0:
        far = min(max(int(beyond) - 1, vertex + 1), other)
    else:
        far = max(min(int(beyond), vertex - 1), other)
    end, off, off_top = skeleton.straight_from(
        tip, chain.top, chain.tolerance[k], vertex, step, far, CHORD * least, OFF
    )
    low, high = min(vertex, end), max(vertex, end)
    used = np.array([off, off_top]) + chain.used[low + 1 : high + 1].max(axis=0)
    length = float(np.linalg.norm(tip[end] - tip[vertex]))
    share = min(0.5, CORNER_PART * least / length)
    pose = between(*here, tip[end], axis[end], share)
    covered = np.arange(low + 1, high + 1)
    # feet of the vertices between on the chord, as share of the way from pose to end
    along = (tip[covered[:-1]] - tip[vertex]) @ (tip[end] - tip[vertex]) / length**2
    place = (along - share) / (1.0 - share)
    if step < 0:
        place = 1.0 - place
    cuts, pieces = spread(place, covered, CUT * least / (length * (1.0 - share)))
    feed = float(chain.feed[low + 1 : high + 1].min())
    return Leg(k, end, pose, (tip[end], axis[end]), used, feed, cuts, pieces)


def spread(place: FloatArray, segments: IntArray, apart: float) -> tuple[FloatArray, IntArray]:
    """Return borders between segments within 0 to 1 that are this far apart, and what is left."""
    cuts: list[float] = []
    pieces = [int(segments[0])]
    for x, following in zip(place, segments[1:], strict=True):
        if x < apart:  # before the way begins
            pieces[-1] = int(following)
        elif x <= 1.0 - apart and x >= (cuts[-1] if cuts else 0.0) + apart:
            cuts.append(float(x))
            pieces.append(int(following))
    return np.array(cuts), np.array(pieces)


def between(
    tip: FloatArray, axis: FloatArray, far_tip: FloatArray, far_axis: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """Return the pose at a share of the way from one pose to another."""
    rotation = rotations_between(axis[None], far_axis[None])
    return tip + share * (far_tip - tip), turned_by(axis[None], rotation, share)[0]


def with_leg(
    line: Polyline,
    leg: Leg,
    pose: tuple[FloatArray, FloatArray],
    vertex: int,
    chain: Chain,
    height: float,
) -> tuple[Polyline, FloatArray]:
    """
    Return a polyline with a vertex that a leg leads to, and how curves move at its outer end.

    Parameters
    ----------
    line : Polyline
        What the leg goes on from.
    leg : Leg
        The line that is added.
    pose : tuple of ndarray
        Tip and axis where it ends.
    vertex : int
        Index of that vertex in the chain; -1 where the run ends there.
    chain : Chain
        What the leg is a part of.
    height : float
        Flank height [m].

    """
    n = len(leg.pieces)
    before = line.tip[-1], line.axis[-1]
    inner = [between(*before, *pose, float(cut)) for cut in leg.cuts]
    straight = Polyline.at(*before, -1).extended(
        pose[0][None], pose[1][None], np.array([-1]), leg.used[None], np.ones(1),
        leg.pieces[:1], leg.pieces[:1], height,
    )  # fmt: skip
    at_end = vertex < 0
    jet = straight.line_jet(len(straight.feed) - 1 if at_end else 0, at_end, height)
    line = line.extended(
        np.array([tip for tip, _ in [*inner, pose]]),
        np.array([axis for _, axis in [*inner, pose]]),
        np.append(np.full(n - 1, -1), vertex),
        np.repeat(leg.used[None], n, axis=0),
        np.full(n, leg.feed),
        chain.row[leg.pieces],
        chain.blocks.line_number[leg.pieces],
        height,
    )
    return line, jet
