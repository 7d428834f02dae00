"""What is simulated: poses of programs, of plans and of executed motion; scallops in sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.nbuffer import Needles, cut_needles
from cnc_interp.cam.surface import Surface
from cnc_interp.cam.tool_path import ARM, chord_error
from cnc_interp.cam.vectors import norm
from cnc_interp.convert import with_chords
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM, UM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.simulated import SimulatedMachine
from cnc_interp.program import Program
from cnc_interp.proof.plan_files import PlanFiles

#: Sections across the passes, and distance of their needles [m].
SECTIONS, FINE = 12, 4.0 * UM
#: Setpoints are thinned so often, to this error and step [m].
THINNINGS, THIN, LONGEST = 5, 0.004 * UM, 0.4 * MM
#: A ridge stands out by this share of the highest.
PROMINENCE = 0.15


@dataclass(frozen=True)
class Motion:
    """
    Poses that the mill takes, one after the other.

    Parameters
    ----------
    name : str
        What moved: 'programmed', 'planned' or 'executed'.
    tip, axis : ndarray, shape (n, 3)
        Tool tips [m] and unit tool axes.

    """

    name: str
    tip: FloatArray
    axis: FloatArray


def thinned(motion: Motion) -> Motion:
    """
    Drop poses that their neighbours give as well.

    Setpoints come every period, however slow the tool; a thousandth of a scallop is not missed.
    """
    tip, axis = motion.tip, motion.axis
    for _ in range(THINNINGS):
        if len(tip) < 5:
            break
        odd = np.arange(1, len(tip) - 1, 2)
        pairs = np.stack([odd - 1, odd + 1], axis=1)
        top = tip + ARM * axis
        error = np.array(chord_error(tip[pairs], top[pairs], tip[odd], top[odd]))
        short = norm(tip[odd + 1] - tip[odd - 1]) <= LONGEST
        kept = np.ones(len(tip), bool)
        kept[odd[(error <= THIN) & short]] = False
        tip, axis = tip[kept], axis[kept]
    return Motion(motion.name, tip, axis)


def programmed(program: Program) -> Motion:
    """Return the poses of a part program's blocks, native splines as chords."""
    blocks = with_chords(program.blocks, ARM)
    return Motion('programmed', np.asarray(blocks.tip), np.asarray(blocks.axis))


def planned(plan: PlanFiles, machine: Machine) -> Motion:
    """Return the poses that the setpoints of a plan command."""
    return thinned(Motion('planned', *Transform.of(machine).forward(plan.position)))


def executed(plan: PlanFiles, machine: Machine) -> Motion:
    """Return the poses that the drives of the simulated machine reach with these setpoints."""
    drives = SimulatedMachine(machine, plan.period, plan.position[0])
    recording = drives.simulate(plan.position, plan.setpoints['velocity'])
    return thinned(Motion('executed', recording.tip, recording.axis))


@dataclass(frozen=True)
class Section:
    """
    Heights along lines across the passes.

    Parameters
    ----------
    way : ndarray, shape (m,)
        Distance along the first line [m].
    height : ndarray, shape (n, m)
        Heights [m].
    ridges : ndarray, shape (k,)
        Heights of all scallop ridges in all lines [m].

    """

    way: FloatArray
    height: FloatArray
    ridges: FloatArray


def cross_sections(
    surface: Surface, cutter: Cutter, motion: Motion, across: FloatArray, margin: float
) -> Section:
    """
    Cut fine sections across the passes and find the scallop ridges.

    Parameters
    ----------
    surface : Surface
        What was machined.
    cutter : Cutter
        The mill.
    motion : Motion
        Its poses.
    across : ndarray, shape (3,)
        Direction in which the passes follow each other; the sections run along the parameter
        line nearest to it.
    margin : float
        Distance of the sections from the border [m].

    Returns
    -------
    Section

    """
    (u0, u1), (v0, v1) = surface.domain
    middle = surface.at(np.array([0.5 * (u0 + u1)]), np.array([0.5 * (v0 + v1)]))
    along_u = abs(float(middle.d_u[0] @ across)) * float(norm(middle.d_v)[0]) > abs(
        float(middle.d_v[0] @ across)
    ) * float(norm(middle.d_u)[0])
    grow, fine = surface.growth(-margin), surface.growth(FINE)
    u0, u1, v0, v1 = u0 - grow[0], u1 + grow[0], v0 - grow[1], v1 + grow[1]
    if along_u:
        lines = np.linspace(v0, v1, SECTIONS)
        points = np.linspace(u0, u1, max(16, int((u1 - u0) / fine[0])))
        v, u = np.meshgrid(lines, points, indexing='ij')
    else:
        lines = np.linspace(u0, u1, SECTIONS)
        points = np.linspace(v0, v1, max(16, int((v1 - v0) / fine[1])))
        u, v = np.meshgrid(lines, points, indexing='ij')
    at = surface.at(u, v)
    heights = cut_needles(Needles(at.position, at.normal), cutter, motion.tip, motion.axis)
    way = np.concatenate([[0.0], np.cumsum(norm(np.diff(at.position[0], axis=0)))])
    found = []
    for row in heights.height:
        peaks, _ = find_peaks(row, prominence=PROMINENCE * float(np.ptp(row)))
        found.append(row[peaks])
    return Section(way, heights.height, np.concatenate(found))
