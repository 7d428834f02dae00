"""
Tool path: passes in the order of cutting, with safe links between them.

A pass sweeps the same volume in both directions. Zigzag therefore uses the postures of one-way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.spline_pass import SplinePass, sampled
from cnc_interp.cam.surface import Surface
from cnc_interp.cam.vectors import unit
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM

Linking = Literal['zigzag', 'one-way']


@dataclass(frozen=True)
class LinkOptions:
    """
    How passes are linked.

    Parameters
    ----------
    linking : {'zigzag', 'one-way'}
        Every second pass in the opposite direction after a short lift, or all passes in one
        direction with a return over a safe level.
    clearance : float
        Lift between passes, and height of the safe level above the surface [m].

    Raises
    ------
    InterpError
        If the clearance is not positive.

    """

    linking: Linking = 'zigzag'
    clearance: float = 2.0 * MM

    def __post_init__(self) -> None:
        if not self.clearance > 0.0:
            raise InterpError('clearance must be positive')


@dataclass(frozen=True)
class Link:
    """
    A straight move between passes.

    Parameters
    ----------
    tip : ndarray, shape (3,)
        Tool tip at the end [m].
    axis : ndarray, shape (3,)
        Unit tool axis at the end [-].
    rapid : bool
        True for a rapid move.

    """

    tip: FloatArray
    axis: FloatArray
    rapid: bool


def link(
    passes: Sequence[SplinePass], surface: Surface, cutter: Cutter, options: LinkOptions
) -> list[Link | SplinePass]:
    """
    Put passes into the order and direction of cutting, with safe moves between them.

    Parameters
    ----------
    passes : sequence of SplinePass
        Passes in their order on the surface.
    surface : Surface
        The surface that the links must not touch.
    cutter : Cutter
        The mill.
    options : LinkOptions
        The user's choices.

    Returns
    -------
    list of Link or SplinePass

    """
    u, v = surface.grid(61, 61)
    points = surface.at(u, v)
    up = unit(points.normal.reshape(-1, 3).mean(axis=0))
    widest = cutter.tool_radius + cutter.corner_radius
    # The lowest point of a leaning mill lies below its tip by less than its radius.
    safe = float((points.position @ up).max()) + widest + options.clearance
    steps: list[Link | SplinePass] = []

    def over(tip: FloatArray) -> FloatArray:
        return np.asarray(tip + max(safe - float(tip @ up), options.clearance) * up)

    for k, one in enumerate(passes):
        turned = options.linking == 'zigzag' and k % 2
        one = one.reversed if turned else one
        tip, axis = one.poses(np.array(one.ends))
        before, behind = tip + options.clearance * axis
        if k == 0 or options.linking == 'one-way':
            steps.append(Link(over(before), axis[0], True))
        steps += [Link(before, axis[0], True), Link(tip[0], axis[0], False), one]
        steps.append(Link(behind, axis[1], False))
        if k == len(passes) - 1 or options.linking == 'one-way':
            steps.append(Link(over(behind), axis[1], True))
    return steps


@dataclass(frozen=True)
class ToolPath:
    """
    Poses of a whole program, joined by straight lines.

    Parameters
    ----------
    tip : ndarray, shape (n, 3)
        Tool tips [m].
    axis : ndarray, shape (n, 3)
        Unit tool axes [-].
    rapid : ndarray of bool, shape (n,)
        True where the move to this pose is a rapid.
    number : ndarray of int, shape (n,)
        Number of the pass, from 1; 0 for links.

    """

    tip: FloatArray
    axis: FloatArray
    rapid: BoolArray
    number: IntArray

    @staticmethod
    def of(steps: Sequence[Link | SplinePass], chord_tolerance: float) -> ToolPath:
        """
        Sample the passes within a chord tolerance.

        Parameters
        ----------
        steps : sequence of Link or SplinePass
            The tool path.
        chord_tolerance : float
            Largest deviation of the chords [m].

        Returns
        -------
        ToolPath

        """
        tips, axes, rapid, numbers, number = [], [], [], [], 0
        for step in steps:
            if isinstance(step, Link):
                tip, axis, ours = step.tip[None], step.axis[None], 0
            else:
                number += 1
                (tip, axis), ours = (x[1:] for x in sampled(step, chord_tolerance)), number
            tips.append(tip)
            axes.append(axis)
            rapid += [isinstance(step, Link) and step.rapid] * len(tip)
            numbers += [ours] * len(tip)
        return ToolPath(np.vstack(tips), np.vstack(axes), np.array(rapid), np.array(numbers))
