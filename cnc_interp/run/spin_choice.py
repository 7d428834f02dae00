"""The turn of an arm's tool about its axis: one constant for a program, by its planned time.

Many spins, in all configurations of the first pose, are followed along the poses. Some of those
that stay within travel and away from singular poses are planned; the fastest one counts.
"""

from math import inf

import numpy as np

from cnc_interp.core import DEG, BlockError, FloatArray, InterpError
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.chain_kernels import followed
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.path_chain import PathChain, batches
from cnc_interp.settings.options import Settings

SPINS = np.arange(24) * 15.0 * DEG  #: That are followed, beside the one of the machine file.
SAME = 1e-9  #: Spins that differ less are one [rad].
EVERY, OTHERS = 3, 4  #: Each third of them is planned, and so many others with the least turns.
MOST_POSES, MOST_BLOCKS = 600, 2000  #: That are followed, and planned, of a long program.


def with_spin(chain: JointChain, settings: Settings, blocks: Blocks) -> tuple[JointChain, str]:
    """Return the chain with the best spin and configuration for blocks, and how it was chosen."""
    tips, axes = _poses(blocks)
    ways, furthest = list[tuple[float, int, JointChain]](), 0
    spins = [chain.spin, *(float(spin) for spin in SPINS if abs(spin - chain.spin) > SAME)]
    for number, spin in enumerate(spins):
        spun, found = chain.spun(spin), list[tuple[float, int, JointChain]]()
        for start in spun.branches(tips[0], axes[0]):
            q, least = followed(spun.packed, tips, axes, start)
            furthest = max(furthest, len(q))
            shift = _shift(q, chain.machine.travel)
            if len(q) == len(tips) and least > chain.least and np.isfinite(shift).all():
                turned = np.abs(np.diff(q, axis=0)) / chain.machine.max_velocity
                way = float(turned.max(axis=1).sum())
                found.append((way, number, spun.starting(start + shift)))
        ways += sorted(found, key=lambda one: one[0])[:1]
    some = blocks[:MOST_BLOCKS]
    ways.sort(key=lambda one: (one[1] % EVERY > 0, one[0]))
    planned = ways[: sum(one[1] % EVERY == 0 for one in ways) + OTHERS]
    times = [(_time(one, settings, some), one) for _, _, one in planned]
    time, best_chain = min(times, key=lambda each: each[0], default=(inf, chain))
    if not np.isfinite(time):
        row = int(np.linspace(0, len(blocks) - 1, len(tips))[min(furthest, len(tips) - 1)])
        raise BlockError(
            f'no constant spin of {chain.machine.name} follows the program further than about '
            'here, within the travel and away from singular poses; move the part',
            int(blocks.line_number[row]),
        )
    told = f'spin {best_chain.spin / DEG:g} deg, the fastest of {len(times)} that were planned'
    part = f' for the first {MOST_BLOCKS} blocks' if len(blocks) > MOST_BLOCKS else ''
    return best_chain, f'{told}{part}, of {len(ways)} that can follow it'


def _poses(blocks: Blocks) -> tuple[FloatArray, FloatArray]:
    """Return poses at even shares of the rows, between them on chords."""
    row = np.linspace(0.0, len(blocks) - 1.0, max(MOST_POSES, 2))
    known = np.arange(len(blocks))
    both = np.hstack([blocks.tip, blocks.axis])
    poses = np.stack([np.interp(row, known, column) for column in both.T], axis=1)
    axes = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return np.ascontiguousarray(poses[:, :3]), np.ascontiguousarray(axes)


def _shift(q: FloatArray, travel: FloatArray) -> FloatArray:
    """Return the whole turns (n,) [rad] that bring a motion into its travel, NaN if none does."""
    turn = 2.0 * np.pi
    low, high = (
        np.ceil((travel[:, 0] - q.min(axis=0)) / turn),
        np.floor((travel[:, 1] - q.max(axis=0)) / turn),
    )
    return np.where(low <= high, turn * np.clip(0.0, low, high), np.nan)


def _time(chain: JointChain, settings: Settings, blocks: Blocks) -> float:
    """Return the time of blocks [s], infinite if they cannot be executed."""
    path_chain = PathChain(chain, settings)
    limits = limits_at(chain.machine, settings.interpolation_period)
    try:
        parts = [path_chain.push(batch).path for batch in batches(blocks)]
        paths = [path for path in (*parts, path_chain.finish().path) if path is not None]
        if not paths:
            return inf
        return plan_path(AxisPath.join(paths), limits, PlanOptions(bound=False)).law.end_time
    except InterpError:
        return inf
