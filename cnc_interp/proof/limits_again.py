"""Axis limits at the positions of a motion, and drive torques, computed for the proof alone."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine

AT_REST = 1e-12  #: An axis that moves less than this in a period is at rest [m or rad].


def limits_at(machine: Machine, order: int, q: FloatArray) -> FloatArray:
    limits = np.tile(machine.limits.by_order[order - 1], (len(q), 1))
    for j, of in machine.limits.placed:
        limits[:, j] = np.interp(q[:, j], of.position, of[order - 1])
    return limits


def limits_of_differences(machine: Machine, order: int, q: FloatArray) -> FloatArray:
    """Return the limits of differences, which are averages: the largest limit in their range."""
    limits = np.tile(machine.limits.by_order[order - 1], (len(q) - order, 1))
    for j, of in machine.limits.placed:
        around = sliding_window_view(q[:, j], order + 1)
        low, high = around.min(axis=1), around.max(axis=1)
        place, limit = of.position, of[order - 1]
        largest = np.maximum(np.interp(low, place, limit), np.interp(high, place, limit))
        for there, value in zip(place, limit, strict=True):
            inside = (low < there) & (there < high)
            largest[inside] = np.maximum(largest[inside], value)
        limits[:, j] = largest
    return limits


def torques_of(machine: Machine, axis: int, q: FloatArray, period: float) -> FloatArray:
    """Return the torque |J a + B v + C sign(v)| at inner samples; at reversals the smaller one."""
    load = machine.limits.loads[axis]
    before, after = q[1:-1] - q[:-2], q[2:] - q[1:-1]
    inertia = load.inertia * (after - before) / period**2
    moved = inertia + load.viscous * (q[2:] - q[:-2]) / (2.0 * period)
    forth = (before > AT_REST) | (after > AT_REST)
    back = (before < -AT_REST) | (after < -AT_REST)
    one_way = np.abs(moved + load.coulomb * (1.0 * forth - 1.0 * back))
    both_ways = np.maximum(np.abs(moved) - load.coulomb, 0.0)
    return np.where(forth & back, both_ways, one_way)
