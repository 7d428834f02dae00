"""The Python interface: plan and check whole programs in memory, without commands and files."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import make_interp_spline

from cnc_interp.core import DEG, MM, MS, FloatArray, InterpError
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform, reached
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.reading import Program, read_program, read_text
from cnc_interp.proof.plan_files import BLOCK_COLUMNS, PlanFiles
from cnc_interp.proof.verdict import Proof
from cnc_interp.proof.verify import verify
from cnc_interp.run.path_chain import PathChain, batches
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.run.planning_chain import Chain, at_fault, no_motion, spun_for
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.settings.options import DEFAULT_MACHINE, Settings
from cnc_interp.smoothing.segments import PathSegments

if TYPE_CHECKING:
    from cnc_interp.collision.path_clearance import Certificates

#: Colours of axes in figures.
COLOURS = '#2a6fb0', '#c8553d', '#3f8f5b', '#8b5fb0', '#b8902b', '#5b6b78'
LONGEST_NAME = 256  #: A longer text is not read as a path [characters].
DEGREE = 5  #: Spline degree: q_ss and q_sss are continuous, as jerk limits require.


def axis_path_from(
    q: FloatArray, s: FloatArray, machine: Machine, feedrate: float = np.inf
) -> AxisPath:
    """Return the smooth path from rest to rest through axis positions, by quintic splines.

    The error of the path is of sixth order in the distance of the points. The path overshoots at
    corners.

    Parameters
    ----------
    q : FloatArray
        (N, n_axes): axis positions, N >= 6 [m, rad].
    s : FloatArray
        (N,): increasing, usually the path length of the tool tip [m].
    feedrate : float
        Largest ds/dt [m/s].

    Raises
    ------
    InterpError
        The arrays do not fit.

    """
    q, s = np.array(q, dtype=float), np.array(s, dtype=float)
    axes = len(machine.axis_names)
    if s.ndim != 1 or q.shape != (len(s), axes):
        raise InterpError(f'q must have shape ({s.size}, {axes}): a row for each s, of all axes')
    if len(s) <= DEGREE:
        raise InterpError(f'{len(s)} points: a quintic spline needs {DEGREE + 1} or more')
    if not (np.isfinite(q).all() and np.isfinite(s).all() and (np.diff(s) > 0.0).all()):
        raise InterpError('q and s must be finite numbers, and s must increase')
    spline = make_interp_spline(s, q, k=DEGREE)
    jets = np.stack([spline(s, nu) for nu in range(4)])
    jets[0] = q
    tip, axis = reached(Transform.of(machine), q)
    stop = np.zeros(len(s), dtype=np.bool_)
    stop[[0, -1]] = True
    return AxisPath(
        s=s,
        cell_left=jets[:, :-1].copy(),
        cell_right=jets[:, 1:].copy(),
        tip=tip,
        axis=axis,
        cell_feed=np.full(len(s) - 1, feedrate),
        cell_block=np.zeros(len(s) - 1, dtype=np.int64),
        stop=stop,
    )


class Kept:
    """Stores everything that the planning chain outputs in memory."""

    def __init__(self) -> None:
        self.parts: list[PathSegments] = []
        self.pieces: list[PlannedPiece] = []
        self.samples: list[Setpoints] = []
        self.segments, self.piece = self.parts.append, self.pieces.append
        self.setpoints = self.samples.append
        self.clear: list[Certificates] = []
        self.certificates = self.clear.append


@dataclass(frozen=True, repr=False)
class Plan:
    """A planned program."""

    program: Program
    machine: Machine
    settings: Settings
    segments: PathSegments  #: The smooth path of the tool.
    pieces: list[PlannedPiece]  #: The path of the axes and the motion law along it, in parts.
    #: ``time`` (K,) [s]; ``position``, ``velocity``, ``acceleration``, ``jerk`` (K, n_axes) [m or
    #: rad, per s, ...]; ``block``, ``line`` (K,), ``s`` (K,) [m].
    setpoints: Setpoints
    planning_time: dict[str, float]  #: Computing time of each stage [s].

    def __repr__(self) -> str:
        """Return a summary with the program, the machine and the cycle time."""
        count, period = len(self.setpoints), self.settings.interpolation_period / MS
        return (
            f'<Plan of {self.program.source or "blocks"} on {self.machine.name}: '
            f'{self.cycle_time:.3f} s, {self.length / MM:.1f} mm, '
            f'{count} setpoints every {period:g} ms>'
        )

    @property
    def cycle_time(self) -> float:
        """Time of the motion [s]."""
        return float(self.pieces[-1].law.end_time)

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.setpoints.s[-1])

    def check(self) -> Proof:
        """Prove the setpoints; see ``cnc_interp.check``."""
        return check(self)

    def plot(self) -> Any:
        """Return a plotly figure of positions and the use of the limits over time."""
        from plotly.subplots import make_subplots

        heads = 'position [mm, deg]', 'velocity, share of its limit', 'jerk, share of its limit'
        figure = make_subplots(rows=3, cols=1, shared_xaxes=True, subplot_titles=heads)
        machine, told = self.machine, self.setpoints
        rows = (
            told.position / [MM if axis.linear else DEG for axis in machine.axes],
            told.velocity / machine.max_velocity,
            told.jerk / machine.max_jerk,
        )
        for row, values in enumerate(rows, 1):
            for k, name in enumerate(machine.axis_names):
                curve = {'x': told.time, 'y': values[:, k], 'name': name, 'legendgroup': name}
                look = {'line': {'color': COLOURS[k % len(COLOURS)]}, 'showlegend': row == 1}
                figure.add_scatter(**curve, **look, row=row, col=1)
        figure.update_xaxes(title_text='time [s]', row=3)
        return figure


def _names_a_file(text: str) -> bool:
    """Return whether a text is a file name: a file exists, or the suffix consists of letters."""
    short = '\n' not in text and len(text) < LONGEST_NAME
    return short and (Path(text).is_file() or Path(text).suffix[1:].isalpha())


def plan(
    program: str | Path | Program, machine: str | Path | Machine = DEFAULT_MACHINE, **settings: Any
) -> Plan:
    """Plan a program to setpoints that keep every limit.

    Parameters
    ----------
    program : str, Path or Program
        G-code or CL data as text, the path of such a file, or what ``read_text`` returns.
    machine : str, Path or Machine
        Name of a bundled machine, or the path of a machine file.
    **settings
        Fields of ``Settings`` [SI], such as ``contour_tolerance=1e-5``.

    Raises
    ------
    InterpError
        The program cannot be read, nothing moves, or the machine cannot follow the path.
    TypeError
        An argument has a wrong type, or is not a field of ``Settings``.

    """
    if isinstance(machine, str | Path):
        machine = Machine.load(str(machine))
    if not isinstance(machine, Machine):
        given = type(machine).__name__
        raise TypeError(f'machine must be a name, the path of a file or a Machine, not {given}')
    known = [field.name for field in fields(Settings)]
    if unknown := sorted(set(settings) - set(known)):
        near = get_close_matches(unknown[0], known, 1)
        hint = f'; did you mean {near[0]}?' if near else '; help(cnc_interp.Settings) has all'
        raise TypeError(f'{unknown[0]} is no setting{hint}')
    chosen, geometry = Settings(**settings), Transform.of(machine)
    if isinstance(program, Path) or (isinstance(program, str) and _names_a_file(program)):
        program = read_program(Path(program), geometry, chosen)
    elif isinstance(program, str):
        program = read_text(program, 'text', geometry, chosen)
    if not isinstance(program, Program):
        given = type(program).__name__
        raise TypeError(f'program must be text, the path of a file or a Program, not {given}')
    return plan_program(program, machine, chosen)


def plan_program(program: Program, machine: Machine, settings: Settings | None = None) -> Plan:
    """Plan a whole program to setpoints in memory; ``cnc-interp plan`` has no limit on length.

    Parameters
    ----------
    program : Program
        As ``read_program`` and ``read_text`` return it, or ``Program(blocks)``.
    settings : Settings, optional
        Tolerances and period; by default 0.02 mm and 1 ms.

    Raises
    ------
    InterpError
        Nothing moves, or the machine cannot follow the path; the message names the line.

    """
    settings, kept = settings or Settings(), Kept()
    with at_fault(program.source):
        blocks, spun, why = spun_for(program.blocks, Transform.of(machine), settings)
    program = replace(program, blocks=blocks)
    if why:
        told = f'line {program.blocks.line_number[0]}: {why}'
        program = replace(program, notices=(*program.notices, told))
    chain = Chain(machine, settings, kept, spun=spun)
    if chain.clearance is not None:
        chain.clearance.rows(program.blocks)
    with at_fault(program.source):
        for batch in batches(program.blocks):
            chain.push(batch)
        chain.finish()
    if chain.clearance is not None:
        chain.clearance.require(program.source)
    if not chain.moved:
        raise no_motion(program.source)
    segments, setpoints = PathSegments.concatenate(kept.parts), Setpoints.concatenate(kept.samples)
    setpoints = replace(setpoints, line=program.blocks.line_number[setpoints.block])
    return Plan(program, machine, settings, segments, kept.pieces, setpoints, chain.seconds)


def smooth_path(blocks: Blocks, geometry: Transform, settings: Settings | None = None) -> AxisPath:
    """Round the corners of blocks within their tolerances, and return the path of the axes.

    Parameters
    ----------
    blocks : Blocks
        The blocks of a program, or ``Blocks.of_poses(tip, axis, feedrate)``.
    settings : Settings, optional
        ``Settings(compress=False)`` rounds every corner and makes no curves of dense blocks.

    Raises
    ------
    ProgramError
        Nothing moves.

    """
    settings = settings or Settings()
    blocks, spun, _ = spun_for(blocks, geometry, settings)
    chain = PathChain(geometry, settings, spun=spun)
    parts = [*(chain.push(batch) for batch in batches(blocks)), chain.finish()]
    paths = [part.path for part in parts if part.path is not None]
    if not paths:
        raise no_motion('blocks')
    return AxisPath.join(paths)


def check(plan: Plan) -> Proof:
    """Prove the setpoints of a plan against limits, tolerances, feed and order of its program.

    Returns
    -------
    Proof
        ``ok``; ``failures``, a sentence for each; ``largest('jerk', 'X').ratio``: use of a limit.

    """
    rows, found = len(plan.program.blocks), block_columns(plan.program.blocks)
    blocks = {name: found.get(name, of.filled(rows)) for name, of in BLOCK_COLUMNS.items()}
    given = {
        'interpolation_period': plan.settings.interpolation_period,
        'flank_height': plan.settings.flank_height,
        'settings': {'longest_block': plan.settings.longest_block},
    }
    return verify(PlanFiles(plan.setpoints.columns(), {}, blocks, given), plan.machine)
