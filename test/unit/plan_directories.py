"""Small plan directories whose truth is known: straight moves with a closed-form profile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from ruckig import InputParameter, Ruckig, Trajectory

from cnc_interp.core.units import MM, MM_PER_MIN
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform

PERIOD = 1e-3
HEIGHT = 30 * MM
Files = dict[str, dict[str, Any]]


def stroke(length: float, velocity: float, acceleration: float, jerk: float) -> Any:
    """Sample the time-optimal rest-to-rest profile, with its derivatives, past its end."""
    request = InputParameter(1)
    request.current_position, request.target_position = [0.0], [length]
    request.max_velocity, request.max_acceleration = [velocity], [acceleration]
    request.max_jerk = [jerk]
    profile = Trajectory(1)
    Ruckig(1).calculate(request, profile)
    time = np.arange(int(np.ceil(profile.duration / PERIOD)) + 1) * PERIOD
    rows = np.array([profile.at_time(min(t, profile.duration)) for t in time])
    return rows[:, :, 0].T


def line_x(machine: Machine, length: float = 60 * MM, feed: float = 6000 * MM_PER_MIN) -> Files:
    """Drive along X with the tool upright: three blocks that lie on one line."""
    x, v, a = stroke(length, feed, machine.max_acceleration[0], machine.max_jerk[0])
    direction = np.zeros(len(machine.axis_names))
    direction[0] = 1.0
    tip = np.outer(np.array([0.0, 0.25, 0.5, 1.0]) * length, [1.0, 0.0, 0.0])
    block = np.searchsorted(tip[:-1, 0], x, side='left').clip(1)
    return files(machine, np.stack([np.outer(c, direction) for c in (x, v, a)]), block, tip, feed)


def files(
    machine: Machine, motion: Any, block: Any, tip: Any, feed: float, axis: Any = None
) -> Files:
    """Put a motion (3, K, n) of axes that begins at 0 and a program into plan files."""
    transform = Transform.of(machine)
    home = np.zeros((1, len(machine.axis_names)))
    origin = transform.forward(home)[0][0]
    tip = np.asarray(tip, float) + origin
    axis = np.tile([0.0, 0.0, 1.0], (len(tip), 1)) if axis is None else np.asarray(axis)
    at, towards = transform.forward(motion[0])
    turned = HEIGHT * np.abs(np.diff(motion[0][:, 3:], axis=0)).sum(axis=1)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1) + turned)]
    grid = np.flatnonzero(np.r_[True, np.diff(way) > 0.0])
    speed = np.linalg.norm(motion[1][:, :3], axis=1)
    rows = len(tip)
    return {
        'setpoints': {
            'time': np.arange(len(way)) * PERIOD, 'position': motion[0], 'velocity': motion[1],
            'acceleration': motion[2], 'jerk': np.zeros_like(motion[0]), 'block': block, 's': way,
        },
        'path': {
            's': way[grid], 'tip': at[grid], 'axis': towards[grid], 'q': motion[0][grid],
            'programmed_feed': np.full(len(grid), feed), 'feed_limit': np.full(len(grid), feed),
            'feed': speed[grid], 'block': block[grid], 'stop': np.zeros(len(grid), bool),
        },
        'blocks': {
            'tip': tip, 'axis': axis, 'feed': np.full(rows, feed),
            'line': 10 * np.arange(1, rows + 1), 'contour_tolerance': np.full(rows, 0.01 * MM),
            'orientation_tolerance': np.full(rows, 0.01 * MM), 'rapid': np.zeros(rows, bool),
        },
        'summary': {
            'cycle_time': (len(way) - 1) * PERIOD, 'interpolation_period': PERIOD,
            'flank_height': HEIGHT, 'machine': machine.name,
        },
    }  # fmt: skip


def write(directory: Path, content: Files) -> Path:
    """Write plan files."""
    directory.mkdir(parents=True, exist_ok=True)
    for name in ('setpoints', 'path', 'blocks'):
        np.savez(directory / f'{name}.npz', **content[name])
    (directory / 'summary.json').write_text(json.dumps(content['summary']), encoding='utf-8')
    return directory
