"""Motions to simulate, from programs, plans or the machine; and sections with scallops."""

from dataclasses import dataclass

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.nbuffer import cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.passes import runs
from cnc_interp.cam.spline_pass import ARM, chord_error
from cnc_interp.cam.surface import Surface
from cnc_interp.convert.conversion import with_chords
from cnc_interp.core import MM, UM, FloatArray, norm
from cnc_interp.drives.tool_error import SETTLING
from cnc_interp.machine.simulated_drives import simulate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform, reached
from cnc_interp.program import Program
from cnc_interp.proof.plan_files import PlanFiles

SECTIONS = 12  #: Number of sections across the passes.
FINE = 4.0 * UM  #: Distance of the needles in a section [m].
THINNINGS = 5  #: Number of times that every second pose may be dropped.
#: Largest error of thinned motions, and largest distance of their poses [m].
THIN, LONGEST = 0.004 * UM, 0.4 * MM
SPLINE_CHORD = 0.01 * UM  #: Chord tolerance of programmed splines [m].
PROMINENCE = 0.15  #: Smallest prominence of a ridge, as a share of the range of heights.


@dataclass(frozen=True)
class Motion:
    name: str  #: 'programmed', 'planned' or 'executed'.
    tip: FloatArray  #: (n, 3): Tool tips [m].
    axis: FloatArray  #: (n, 3): Unit tool axes [-].


def thinned(motion: Motion) -> Motion:
    """Drop poses that their neighbours interpolate with an error of at most ``THIN``."""
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
    blocks = with_chords(program.blocks, ARM, SPLINE_CHORD)
    return Motion('programmed', np.asarray(blocks.tip), np.asarray(blocks.axis))


def planned(plan: PlanFiles, machine: Machine) -> Motion:
    return thinned(Motion('planned', *reached(Transform.of(machine), plan.position)))


def executed(plan: PlanFiles, machine: Machine, model: Machine | None = None) -> Motion:
    velocity = np.asarray(plan.setpoints['velocity'])
    rest = round(SETTLING / plan.period)
    held = np.concatenate([plan.position, np.tile(plan.position[-1:], (rest, 1))])
    rates = np.concatenate([velocity, np.zeros((rest, velocity.shape[1]))])
    recording = simulate(machine, plan.period, held, rates, model)
    return thinned(Motion('executed', recording.tip, recording.axis))


@dataclass(frozen=True)
class Section:
    way: FloatArray  #: (m,): Distance along the first line [m].
    height: FloatArray  #: (n, m): Heights on n lines; NaN where a line is not on the face [m].
    ridges: FloatArray  #: (k,): Heights of all scallop ridges on all lines [m].


def cross_sections(
    surface: Surface, cutter: Cutter, motion: Motion, across: FloatArray, margin: float
) -> Section:
    from scipy.signal import find_peaks  # with all of scipy.stats

    (u0, u1), (v0, v1) = surface.domain
    middle = surface.at(np.array([0.5 * (u0 + u1)]), np.array([0.5 * (v0 + v1)]))
    along_u = abs(float(middle.d_u[0] @ across)) * float(norm(middle.d_v)[0]) > abs(
        float(middle.d_v[0] @ across)
    ) * float(norm(middle.d_u)[0])
    grow, fine = surface.growth(-margin), surface.growth(FINE)
    ends = (u0 - grow[0], u1 + grow[0]), (v0 - grow[1], v1 + grow[1])
    along, beside = (0, 1) if along_u else (1, 0)
    first, last = ends[along]
    points = np.linspace(first, last, max(16, int((last - first) / fine[along])))
    grid = np.meshgrid(np.linspace(*ends[beside], SECTIONS), points, indexing='ij')
    u, v = grid[::-1] if along_u else grid
    at = surface.at(u, v)
    heights = cut_needles(Needles(at.position, at.normal), cutter, motion.tip, motion.axis)
    way = np.concatenate([[0.0], np.cumsum(norm(np.diff(at.position[0], axis=0)))])
    shown = np.where(surface.contains(u, v, -margin) & heights.cut, heights.height, np.nan)
    found = [np.zeros(0)]
    for row in shown:
        for run in runs(np.isfinite(row)):
            part = row[run]
            peaks, _ = find_peaks(part, prominence=PROMINENCE * float(np.ptp(part)))
            found.append(part[peaks])
    return Section(way, shown, np.concatenate(found))
