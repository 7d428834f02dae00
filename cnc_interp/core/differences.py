"""Differences of setpoints over the limits of the axes: how much of each limit is used."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cnc_interp.core.arrays import FloatArray

#: Setpoints that must be known before the first one whose differences are taken.
BEFORE = 3
#: An excess of up to 0.1 % of a limit or a tolerance is rounding.
ROUNDING = 1.001


def largest_differences(limits: FloatArray, period: float) -> FloatArray:
    """
    Return the largest first, second and third difference that the limits allow.

    Parameters
    ----------
    limits : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits [m or rad, per s, per s2, per s3].
    period : float
        Interpolation period T [s].

    Returns
    -------
    ndarray, shape (3, n_axes)
        ``limits`` times T, T^2 and T^3 [m, rad].

    """
    largest: FloatArray = limits * np.array([[period], [period**2], [period**3]])
    return largest


def limit_shares(positions: FloatArray, largest: FloatArray) -> FloatArray:
    """
    Divide the first, second and third differences of setpoints by the largest allowed.

    Parameters
    ----------
    positions : ndarray, shape (3 + K, n_axes)
        The three setpoints before, then K setpoints [m, rad].
    largest : ndarray, shape (3, n_axes)
        See ``largest_differences`` [m, rad].

    Returns
    -------
    ndarray, shape (3, K, n_axes)
        Signed shares of the velocity, acceleration and jerk limits [-]. Row k belongs to the
        differences that end at setpoint k.

    """
    shares = np.empty((3, len(positions) - BEFORE, positions.shape[1]))
    for row, order in enumerate((1, 2, 3)):
        shares[row] = np.diff(positions[BEFORE - order :], order, axis=0) / largest[row]
    return shares


def excesses(
    uses: Mapping[str, Mapping[str, float]], tolerances: Mapping[str, float]
) -> list[str]:
    """
    Name limits and tolerances that are exceeded by more than rounding.

    Parameters
    ----------
    uses : mapping
        Largest share of velocity, acceleration and jerk limit of each axis [-].
    tolerances : mapping
        Largest share of contour and orientation tolerance [-].

    """
    shares = [(f'{kind} of {axis}', use) for kind, of in uses.items() for axis, use in of.items()]
    shares += [(f'{kind} tolerance', use) for kind, use in tolerances.items()]
    return [f'{name} {use:.2%}' for name, use in shares if not use <= ROUNDING]
