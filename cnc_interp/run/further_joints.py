"""Choose the positions of a rail or positioner for a program that does not move it.

These joints rest during a cut. If the arm cannot follow a cut with the joints where they are, they
move during the rapid moves before the cut. Their new position is the one with which the arm can
follow the cut at the most spins of the tool. Among several, the nearest is chosen.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from cnc_interp.core import DEG, FloatArray
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import arm_of
from cnc_interp.program.blocks import Blocks

SPINS = np.arange(8) * 45.0 * DEG  #: Spins that are tried, relative to that of the machine file.
TRIED = 13  #: Tried positions per joint, over its travel or one turn.
POSES = 200  #: Number of poses on a cut that the arm must follow.


def placed(blocks: Blocks, chain: JointChain) -> Blocks:
    """Return blocks with chosen positions of further joints, unless the program moves them."""
    extra = blocks.extra.copy()
    if not extra.shape[1] or (extra != arm_of(chain.machine).home[ARM:]).any():
        return blocks
    cutting = ~blocks.rapid
    cutting[0] = False
    edges = np.flatnonzero(np.diff(cutting, prepend=False, append=False)).tolist()
    here, end = extra[0], 0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        begin, before = first - 1, here
        row = np.linspace(begin, last - 1.0, POSES)
        known, both = np.arange(begin, last), np.hstack([blocks.tip, blocks.axis])[begin:last]
        poses = np.stack([np.interp(row, known, column) for column in both.T], axis=1)
        tip, axis = (np.ascontiguousarray(part) for part in np.split(poses, 2, axis=1))
        here = _place(chain, tip, axis / np.linalg.norm(axis, axis=1, keepdims=True), before)
        steps = np.linalg.norm(np.diff(blocks.tip[end:first], axis=0), axis=1)
        share = np.append(0.0, np.cumsum(steps)) / max(float(steps.sum()), 1e-12)
        extra[end:first] = before + (share[:, None] if end else 1.0) * (here - before)
        extra[begin:] = here
        end = last - 1
    return replace(blocks, extra=extra)


def _place(chain: JointChain, tip: FloatArray, axis: FloatArray, here: FloatArray) -> FloatArray:
    if _spins(chain, tip, axis, here):
        return here
    travel = chain.machine.travel[ARM:]
    a_turn = here[:, None] + np.array([-np.pi, np.pi])
    ends = np.where(np.isfinite(travel).all(axis=1, keepdims=True), travel, a_turn)
    grids = [np.linspace(float(low), float(high), TRIED) for low, high in ends]
    places = np.array(list(product(*grids)))
    away = (np.abs(places - here) / chain.machine.max_velocity[ARM:]).max(axis=1)
    best, most = here, 0
    for place in places[np.argsort(away, kind='stable')]:
        count = _spins(chain, tip, axis, place)
        if count > most:
            best, most = place, count
        if most == len(SPINS):
            break
    return np.asarray(best)


def _spins(chain: JointChain, tip: FloatArray, axis: FloatArray, place: FloatArray) -> int:
    """Return at how many spins the arm follows m poses; ``place`` (k,): further joints."""
    count, rows, (low, high) = 0, np.tile(place, (len(tip), 1)), chain.machine.travel.T
    for spin in chain.spin + SPINS:
        spun = chain.spun(float(spin))
        for start in spun.branches(tip[0], axis[0], place):
            q, least = spun.followed(tip, axis, rows, start)
            inside = ((q >= low) & (q <= high)).all()
            if len(q) == len(tip) and least > chain.least and inside:
                count += 1
                break
    return count
