"""Requests of the `cam` commands in SI, made from the options of the command line."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, Self

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.nbuffer import Pool
from cnc_interp.cam.strategies import STRATEGIES, Strategy, Wanted
from cnc_interp.cam.tool_path import LinkOptions
from cnc_interp.core import DEG, MM, MM_PER_MIN, UM
from cnc_interp.settings.options import Settings

#: Tolerance of the program as a share of the scallop height, or of the reserve [-].
SMOOTHING, SMOOTHING_OF_RESERVE = 0.2, 0.5
#: Units of the options whose fields have the same name; other options have no unit.
UNITS = {'spacing': MM, 'margin': MM, 'overrun': MM, 'feed': MM_PER_MIN, 'scallop': UM}
UNITS |= {'reserve': UM, 'chord': UM, 'direction': DEG}


@dataclass(frozen=True)
class CutRequest:
    """A surface, the mill that cuts it, and where heights are measured."""

    surface: Path  #: Its file.
    face: tuple[int, ...]  #: Numbers of faces of a STEP file; empty for its only face.
    turns: tuple[float, float, float]  #: Turns of the surface about X, Y and Z on the table [deg].
    direction: float  #: Angle of the feed direction to the u lines of the surface [rad].
    cutter: Cutter
    scallop: float  #: Scallop height, for passes and for the colours of maps [m].
    tolerance: float  #: Tolerance of a program that leaves this scallop height [m].
    spacing: float  #: Distance of the needles [m].
    margin: float  #: Distance from the border for the figures [m].
    machine: str
    compensate: str | None  #: Machine whose drive model compensates the executed motion.
    json: bool  #: Whether the summary is printed as JSON, without progress.

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Self:
        """Make a request from command-line options, which are in shop units."""
        names = {field.name for field in fields(cls)}
        found = {n: v * UNITS[n] if n in UNITS else v for n, v in options.items() if n in names}
        mill = options['tool_diameter'] * MM, options['corner_radius'] * MM
        found['cutter'] = Cutter.of_diameter(*mill)
        found['face'] = tuple(options['face'] or ())
        found['turns'] = tuple(options[f'turn_{axis}'] for axis in 'xyz')
        found['tolerance'] = float(SMOOTHING * options['scallop'] * UM)
        return cls(**found | cls._more(options, found['cutter']))

    @classmethod
    def _more(cls, options: Mapping[str, Any], cutter: Cutter) -> dict[str, Any]:
        return {}


@dataclass(frozen=True)
class CamRequest(CutRequest):
    """Request for a program of constant scallop height."""

    out: Path  #: Folder to write.
    ignore_neighbours: bool  #: Whether passes may enter other faces of the part.
    strategy: Strategy
    passes: Wanted  #: Requested passes.
    reserve: float  #: Part of the scallop height for smoothing and drives [m].
    links: LinkOptions
    format: Literal['spline', 'cl', 'gcode']  #: Format of the program.
    chord: float  #: Chord tolerance of formats without splines [m].
    overrun: float  #: Length of the passes beyond the border [m].
    feed: float  #: [m/s].
    simulate: bool  #: Whether to simulate how the program cuts the surface.
    run: bool  #: Whether to simulate the planned and the executed motion, too.

    @classmethod
    def _more(cls, options: Mapping[str, Any], cutter: Cutter) -> dict[str, Any]:
        chord = 0.0 if options['format'] == 'spline' else options['chord']
        strategy = STRATEGIES[options['strategy']]
        ridge = float((options['scallop'] - options['reserve'] - chord) * UM)
        found = {
            'strategy': strategy,
            'passes': Wanted(ridge, options['overrun'] * MM, strategy.choices(options)),
            'links': LinkOptions(options['linking'], options['clearance'] * MM),
        }
        if options['reserve']:
            widest = 1.0 + (cutter.tool_radius + cutter.corner_radius) / Settings().flank_height
            share = float(SMOOTHING_OF_RESERVE * options['reserve'] * UM / widest)
            found['tolerance'] = share
        return found


@dataclass(frozen=True)
class SimulateRequest(CutRequest):
    """Request to simulate how a program or a plan cuts a surface."""

    motion: Path  #: Part program, or folder of a plan.
    executed: bool  #: Whether to simulate the motion of the drives instead of the setpoints.
    out: Path | None  #: Page to write.
    tiles: Path | None  #: Folder of tiles, for millions of needles.
    workers: int | None
    scheduler: str | None
    pool: Pool
