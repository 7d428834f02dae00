"""Differences of setpoints over the limits of the axes: how much of each limit is used."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.limit_table import COULOMB, DRIVE, VISCOUS, largest_between
from cnc_interp.core.units import MM

#: Setpoints that must be known before the first one whose differences are taken.
BEFORE = 3
#: Steps of an axis below this are rest [m, rad].
STILL = 1e-12
#: An excess of up to 0.1 % of a limit or a tolerance is rounding.
ROUNDING = 1.001


def limit_shares(positions: FloatArray, table: FloatArray, period: float) -> FloatArray:
    """
    Divide the first, second and third differences of setpoints by the largest allowed.

    They are means of derivatives, so the largest limit between the setpoints counts.
    ``positions`` (3 + K, n_axes): the three setpoints before, then K setpoints [m, rad].
    ``table`` (7, n_axes, m): see ``limit_table.py``. ``period``: interpolation period T [s].
    Returns (3, K, n_axes): signed shares [-]; row k belongs to those that end at setpoint k.
    """
    constant = table.shape[2] == 1
    shares = np.empty((3, len(positions) - BEFORE, positions.shape[1]))
    for row, order in enumerate((1, 2, 3)):
        held = positions[BEFORE - order :]
        if constant:
            limit = table[row, :, 0]
        else:
            around = sliding_window_view(held, order + 1, axis=0)
            limit = largest_between(table, around.min(axis=-1), around.max(axis=-1))[row]
        shares[row] = np.diff(held, order, axis=0) / (limit * period**order)
    return shares


def torque_shares(positions: FloatArray, table: FloatArray, period: float) -> FloatArray:
    """
    Divide the torques that three setpoints in a row ask for by the largest ones, (K, n_axes) [-].

    Arguments as in ``limit_shares``; zero for axes without a largest torque. Where an axis turns,
    Coulomb friction has both signs, so the smaller torque counts.
    """
    steps = np.diff(positions[BEFORE - 2 :], axis=0)
    sign = np.where(np.abs(steps) < STILL, 0.0, np.sign(steps))
    asked = np.diff(steps, axis=0) / period**2
    asked += table[VISCOUS, :, 0] * (steps[1:] + steps[:-1]) / (2.0 * period)
    friction, way = table[COULOMB, :, 0], np.sign(sign[1:] + sign[:-1])
    turns = sign[1:] * sign[:-1] < 0.0
    torque = np.where(
        turns, np.maximum(np.abs(asked) - friction, 0.0), np.abs(asked + way * friction)
    )
    shares: FloatArray = torque / table[DRIVE, :, 0]
    return shares


def excesses(
    uses: Mapping[str, Mapping[str, float]],
    tolerances: Mapping[str, float],
    tool_error: Mapping[str, float] | None = None,
) -> list[str]:
    """Name limits and tolerances, and a limited error at the tool, that are exceeded."""
    shares = [(f'{kind} of {axis}', use) for kind, of in uses.items() for axis, use in of.items()]
    shares += [(f'{kind} tolerance', use) for kind, use in tolerances.items()]
    found = [f'{name} {use:.2%}' for name, use in shares if not use <= ROUNDING]
    if tool_error:
        limit = tool_error['limit']
        share = max(tool_error['tip'], tool_error['axis']) / limit
        if not share <= ROUNDING:
            found.append(
                f'error at the tool {share:.2%}: friction and backlash may need more than '
                f'{limit / MM:g} mm at any speed; raise --tool-error, or --compensate'
            )
    return found


def tool_error_text(error: Mapping[str, float], height: float) -> str:
    """Return the largest errors at the tool in words; the height is that of the flank [m]."""
    return (
        f'tool error     tip {error["tip"] / MM:.4f} mm, axis {error["axis"] / MM:.4f} mm at '
        f'{height / MM:g} mm; limit {error["limit"] / MM:g} mm, by the drives of the machine file'
    )
