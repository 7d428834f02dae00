"""Small plan directories whose truth is known: straight moves with a closed-form profile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from ruckig import InputParameter, Ruckig, Trajectory

from cnc_interp.core import MM, MM_PER_MIN
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform

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


def turned_tip(a: Any, c: Any) -> Any:
    """Find by hand the X Y Z that keep the tip where it is at A = C = 0."""
    d = np.array([0.0, 0.15, 80.0]) * MM
    around = np.stack([d[0] * np.cos(c) - d[1] * np.sin(c), d[0] * np.sin(c) + d[1] * np.cos(c)])
    arm = np.stack([d[0] - around[0], d[1] - around[1], np.zeros_like(c)])
    return np.stack(
        [arm[0], arm[1] * np.cos(a) - arm[2] * np.sin(a), arm[1] * np.sin(a) + arm[2] * np.cos(a)],
        axis=1,
    )


def files(
    machine: Machine, motion: Any, block: Any, tip: Any, feed: float, axis: Any = None
) -> Files:
    """Put a motion (3, K, n) of axes that begins at 0 and a program into plan files."""
    transform = Transform.of(machine)
    home = np.zeros((1, len(machine.axis_names)))
    origin = transform.forward(home)[0][0]
    tip = np.asarray(tip, float) + origin
    axis = np.tile([0.0, 0.0, 1.0], (len(tip), 1)) if axis is None else np.asarray(axis)
    rows = len(tip)
    content: Files = {
        'setpoints': {
            'time': np.arange(len(block)) * PERIOD,
            'position': motion[0],
            'velocity': motion[1],
            'acceleration': motion[2],
            'block': block,
        },
        'blocks': {
            'tip': tip,
            'axis': axis,
            'feed': np.full(rows, feed),
            'line': 10 * np.arange(1, rows + 1),
            'contour_tolerance': np.full(rows, 0.01 * MM),
            'orientation_tolerance': np.full(rows, 0.01 * MM),
            'rapid': np.zeros(rows, bool),
        },
        'summary': {
            'cycle_time': (len(block) - 1) * PERIOD,
            'interpolation_period': PERIOD,
            'flank_height': HEIGHT,
            'machine': machine.name,
        },
    }
    lay_path(machine, content, feed)
    return content


def lay_path(machine: Machine, content: Files, feed: float) -> None:
    """Make the path of the setpoints: a grid point at each of them, and stops where they rest."""
    position, block = content['setpoints']['position'], content['setpoints']['block']
    at, towards = Transform.of(machine).forward(position)
    turned = HEIGHT * np.abs(np.diff(position[:, 3:], axis=0)).sum(axis=1)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1) + turned)]
    grid = np.flatnonzero(np.r_[True, np.diff(way) > 0.0])
    speed = np.gradient(way, PERIOD)
    speed[[0, -1]] = 0.0
    s, q = way[grid], position[grid]
    rests = np.diff(way, prepend=-1.0, append=way[-1]) == 0.0
    stop = (rests[:-1] | rests[1:])[grid]
    stop[[0, -1]] = True
    secant = np.diff(q, axis=0) / np.diff(s)[:, None]
    mean = 0.5 * (secant[:-1] + secant[1:])
    inner = np.where(stop[1:-1, None], np.nan, mean)
    left, right = np.zeros((2, 4, len(s) - 1, q.shape[1]))
    left[0], right[0] = q[:-1], q[1:]
    left[1], right[1] = secant, secant
    left[1, 1:] = np.where(np.isnan(inner), secant[1:], inner)
    right[1, :-1] = np.where(np.isnan(inner), secant[:-1], inner)
    limit = np.full(len(s), feed)
    with np.errstate(divide='ignore'):
        for side, at_side in ((left, slice(None, -1)), (right, slice(1, None))):
            reach = np.min(machine.max_velocity / np.abs(side[1]), axis=1)
            limit[at_side] = np.minimum(limit[at_side], reach)
    content['setpoints']['s'] = way
    content['path'] = {
        's': s,
        'tip': at[grid],
        'axis': towards[grid],
        'q': q,
        'cell_left': left,
        'cell_right': right,
        'programmed_feed': np.full(len(grid), feed),
        'feed_limit': limit,
        'feed': speed[grid],
        'block': block[grid],
        'stop': stop,
    }


def write(directory: Path, content: Files) -> Path:
    """Write plan files."""
    directory.mkdir(parents=True, exist_ok=True)
    for name in ('setpoints', 'path', 'blocks'):
        np.savez(directory / f'{name}.npz', **content[name])
    (directory / 'summary.json').write_text(json.dumps(content['summary']), encoding='utf-8')
    return directory
