"""The pace of another control: its speed on short blocks, and its stops."""

from dataclasses import replace

import numpy as np

from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.machine_model.machine_entries import BlockPace
from cnc_interp.program.blocks import WITHIN_MOTION, Blocks
from cnc_interp.settings.options import Settings

#: A turn is averaged over this length before and after the middle of a block [m], and over at most
#: this number of blocks on each side.
REACH, NEAR = 1e-3, 8
HELD = NEAR + 1  #: Rows that wait for later rows, unless the tool rests between.
KEPT = HELD + NEAR + 2  #: Rows that a pacer keeps: the waiting rows, and those before them.


def pace_limits(
    pace: BlockPace, length: FloatArray, turn: FloatArray, feed: FloatArray
) -> FloatArray:
    """Return the largest mean speeds on blocks; ``turn`` (n,): from block to block [rad].

    A control changes the velocity at a vertex between two blocks by at most ``jump``, so the speed
    there is v = jump / (2 sin(turn / 2)). On the block between two vertices the speed rises and
    falls again with the jerk J. With x the square root of the rise in speed over J, a block of
    length L takes the time 4 x: ``2 J x^3 + 4 v x = L``. The feed of a block is at most its mean
    speed L / (4 x), and at most L over the time that the control needs for a block. Sharper turns
    are corners, for which the planner itself slows down.
    """
    with np.errstate(divide='ignore'):
        v = np.minimum(pace.jump / (2.0 * np.sin(0.5 * turn)), feed)
    bump = length / (4.0 * rise_root(v, length, pace.jerk))
    return np.asarray(np.minimum(bump, length / pace.block_time))


def rise_root(v: FloatArray, length: FloatArray, jerk: float) -> FloatArray:
    """Return the real root of x^3 + p x = q, with p = 2 v / J and q = L / (2 J), by sinh."""
    p, q = 2.0 * np.maximum(v, 1e-9) / jerk, 0.5 * length / jerk
    a = np.sqrt(p / 3.0)
    return np.asarray(2.0 * a * np.sinh(np.arcsinh(0.5 * q / a**3) / 3.0))


def mean_turns(length: FloatArray, turn: FloatArray, stop: BoolArray) -> FloatArray:
    """Return the turns of blocks, averaged over the path near each; all (n,) [m, rad].

    In records, ten chords at the end of a slot slow a control down less (by half) than the same
    chords in a full circle, because it judges the path over some length, not vertex by vertex.
    This length ends where the tool rests; ``stop`` (n,): whether the tool rests at the end of a
    block.
    """
    bent, way, n = turn.copy(), length.copy(), len(length)
    lengths, turns = (np.pad(one, NEAR) for one in (length, turn))
    stops = np.pad(stop, NEAR)
    for side in (-1, 1):
        left = REACH - 0.5 * length
        for k in range(1, NEAR + 1):
            near = slice(NEAR + side * k, NEAR + side * k + n)
            between = NEAR + side * k - (side > 0)
            left = np.where(stops[between : between + n], 0.0, left)
            part = np.clip(left, 0.0, lengths[near])
            bent += turns[near] * part / np.maximum(lengths[near], 1e-12)
            way += part
            left = left - lengths[near]
    return np.asarray(bent * length / np.maximum(way, 1e-12))


class Pacer:
    """Set the feed of blocks to what the control reaches; the last rows wait for the next rows."""

    def __init__(self, pace: BlockPace, settings: Settings):
        self._pace, self._longest = pace, settings.longest_block
        self._sharp = settings.corner_angle
        self._kept: Blocks | None = None
        self._sent = 0  # rows of those kept that have been returned

    def push(self, blocks: Blocks) -> Blocks:
        rows = blocks if self._kept is None else Blocks.concatenate([self._kept, blocks])
        paced, sent = self._paced(rows), self._sent
        rests = np.flatnonzero(paced.exact_stop[:-1]) + 1
        end = max(sent, len(rows) - HELD, *rests[-1:].tolist())
        self._kept = rows[-KEPT:]
        self._sent = end - len(rows) + len(self._kept)
        return paced[sent:end]

    def finish(self) -> Blocks | None:
        return None if self._kept is None else self._paced(self._kept)[self._sent :]

    def _paced(self, rows: Blocks) -> Blocks:
        if self._pace.stops_at_rapids:
            ends = rows.rapid.copy()
            ends[:-1] |= rows.rapid[1:]
            rows = replace(rows, exact_stop=rows.exact_stop | ends)
        if len(rows) < 4:
            return rows
        step = np.diff(rows.tip, axis=0)
        length = np.linalg.norm(step, axis=1)
        unit = step / np.maximum(length, 1e-12)[:, None]
        half_chord = 0.5 * np.linalg.norm(np.diff(unit, axis=0), axis=1)
        turn = 2.0 * np.arcsin(np.minimum(half_chord, 1.0))
        turn[(turn > self._sharp) | rows.exact_stop[1:-1]] = 0.0
        own = slice(2, -1)
        piece = rows.corner == WITHIN_MOTION
        piece[1:] |= piece[:-1]
        slow = ~piece[own] & (length[1:-1] < self._longest) & (length[1:-1] > 1e-9)
        slow &= ~rows.rapid[own] & ~rows.on_spline[own]
        slow &= np.isfinite(rows.feedrate[own])
        k, feed = np.flatnonzero(slow), rows.feedrate.copy()
        turn = 0.5 * (np.append(0.0, turn) + np.append(turn, 0.0))
        turn = mean_turns(length, turn, rows.exact_stop[1:])[k + 1]
        feed[k + 2] = np.minimum(
            feed[k + 2], pace_limits(self._pace, length[k + 1], turn, feed[k + 2])
        )
        return replace(rows, feedrate=feed)
