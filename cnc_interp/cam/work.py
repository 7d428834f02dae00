"""What the `cam` commands do: surface -> passes -> program -> plan -> motion -> N-buffer."""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any

import numpy as np

from cnc_interp.cam.classical import ClassicalPaths, classical_paths
from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.iso_scallop import IsoScallopOptions, IsoScallopPaths, iso_scallop_paths
from cnc_interp.cam.nbuffer import Heights, Needles, cut_needles
from cnc_interp.cam.program_text import write_tool_path
from cnc_interp.cam.simulation import (
    Motion,
    Section,
    cross_sections,
    executed,
    planned,
    programmed,
)
from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.cam.surface_file import read_surface
from cnc_interp.cam.tool_path import LinkOptions, SplinePass, link
from cnc_interp.cam.vectors import cross, unit
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.progress_bar import ProgressBar
from cnc_interp.core.units import DEG, MM, MM_PER_MIN, UM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import open_program, read_program
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.run.chain import plan_to_files
from cnc_interp.settings.choices import Settings

#: Tolerance of the interpolator for the program, as a share of the scallop height.
SMOOTHING = 0.2


def make_program(options: argparse.Namespace) -> int:
    """Make the program of a surface, simulate it if asked, and write everything."""
    surface = read_surface(options.surface, options.face, _note)
    cutter = _cutter(options)
    normal = across(surface, options.direction * DEG)
    clock = time.perf_counter()
    paths = _followed(surface, cutter, normal, options)
    clock = time.perf_counter() - clock
    axis = unit(_mean_normal(surface)) if cutter.is_ball else None
    curves = [SplinePass.of(p, options.overrun * MM, axis) for p in paths.passes]
    steps = link(
        [c for c in curves if c], surface, cutter,
        LinkOptions(options.linking, options.clearance * MM),
    )  # fmt: skip
    machine = Machine.load(options.machine)
    tolerance = SMOOTHING * options.scallop * UM
    reading = Settings(contour_tolerance=tolerance, orientation_tolerance=tolerance)
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    file = write_tool_path(
        steps, options.feed * MM_PER_MIN, options.chord * UM, out / 'program', options.format,
        machine, reading,
    )  # fmt: skip
    program = read_program(file, Transform.of(machine), reading)
    summary = {
        'surface': str(options.surface), **facts_of(paths, clock), 'program': str(file),
        'blocks': len(program.blocks) - 1,
    }  # fmt: skip
    motions = []
    if options.run or options.simulate:
        motions.append(programmed(program))
        if options.run:
            progress = _progress(options)
            summary['cycle_time'] = plan_to_files(
                open_program(file, Transform.of(machine), reading), machine, out / 'plan',
                progress=progress.of('planning'),
            )['cycle_time']  # fmt: skip
            progress.end(complete=True)
            files = read_plan(out / 'plan')
            motions += [planned(files, machine), executed(files, machine)]
    figures = _path_figures(paths)
    for motion in motions:
        heights, section = _cut(surface, cutter, motion, normal, options)
        summary[motion.name] = results(heights, section)
        figures += _height_figures(motion, heights, section, options.scallop * UM)
    (out / 'summary.json').write_text(json.dumps(summary, indent=2) + '\n', encoding='utf-8')
    text = describe(summary)
    from cnc_interp.cam.page import page

    (out / 'cam.html').write_text(page(f'{options.surface}', text, figures), encoding='utf-8')
    print(json.dumps(summary, indent=2) if options.json else f'{text}\nwritten        {out}')
    for note in paths.notes if isinstance(paths, IsoScallopPaths) else []:
        _note(note)
    return 0


def _followed(
    surface: Surface, cutter: Cutter, normal: FloatArray, options: argparse.Namespace
) -> IsoScallopPaths | ClassicalPaths:
    """Compute the passes of the strategy asked for."""
    progress = _progress(options)
    show = progress.of('passes')
    paths: IsoScallopPaths | ClassicalPaths
    if options.strategy == 'planes':
        paths = iso_scallop_paths(surface, cutter, normal, _choices(options), show)
        progress.end(complete=True)
        return paths
    paths = classical_paths(
        surface, cutter, normal, options.scallop * UM, options.tilt * DEG, progress=show
    )
    progress.end(complete=not paths.loop)
    if paths.loop:
        raise SurfaceError(
            f'the classical path cannot cover this surface: {paths.loop}; take another direction '
            'or --strategy planes'
        )
    return paths


def simulate_motion(options: argparse.Namespace) -> int:
    """Cut a surface with a program or a plan."""
    surface = read_surface(options.surface, options.face, _note)
    cutter = _cutter(options)
    machine = Machine.load(options.machine)
    if options.motion.is_dir():
        files = read_plan(options.motion)
        motion = (executed if options.executed else planned)(files, machine)
    else:
        reading = Settings(feedrate=MM_PER_MIN, contour_tolerance=SMOOTHING * options.scallop * UM)
        motion = programmed(read_program(options.motion, Transform.of(machine), reading))
    heights, section = _cut(
        surface, cutter, motion, across(surface, options.direction * DEG), options
    )
    summary = {motion.name: results(heights, section)}
    if options.html:
        from cnc_interp.cam.page import page

        figures = _height_figures(motion, heights, section, options.scallop * UM)
        text = page(str(options.motion), describe(summary), figures)
        options.html.parent.mkdir(parents=True, exist_ok=True)
        options.html.write_text(text, encoding='utf-8')
    print(json.dumps(summary, indent=2) if options.json else describe(summary))
    return 0


def across(surface: Surface, direction: float) -> FloatArray:
    """
    Return N for a feed direction in the surface's mean tangent plane.

    Parameters
    ----------
    surface : Surface
        The surface.
    direction : float
        Angle of the feed from the mean direction of the u lines [rad].

    Returns
    -------
    ndarray, shape (3,)
        Unit normal of the guiding planes, with n x N along the feed.

    """
    u, v = surface.grid(21, 21)
    point = surface.at(u, v)
    up = unit(_mean_normal(surface))
    first = point.d_u.reshape(-1, 3).mean(axis=0)
    first = unit(first - (first @ up) * up)
    feed = np.cos(direction) * first + np.sin(direction) * cross(up, first)
    return cross(feed, up)


def _mean_normal(surface: Surface) -> FloatArray:
    """Return the mean of the normals, not of unit length."""
    u, v = surface.grid(21, 21)
    return np.asarray(surface.at(u, v).normal.reshape(-1, 3).mean(axis=0))


def facts_of(paths: IsoScallopPaths | ClassicalPaths, seconds: float) -> dict[str, Any]:
    """Return what is known of the passes; SI units."""
    found = {
        'passes': len(paths.passes),
        'postures': sum(len(p.s) for p in paths.passes),
        'computing_time': seconds,
        'length': sum(p.curve.length for p in paths.passes),
    }
    if isinstance(paths, ClassicalPaths):
        return found
    tilt = np.concatenate([p.angles.tilt for p in paths.passes])
    planes = np.abs(np.diff([p.plane for p in paths.passes]))
    marched, refined, second = paths.iterations
    return found | {
        'started_afresh': sum(p.fresh for p in paths.passes) - 1,
        'plane_distance': [float(planes.min()), float(planes.max())] if len(planes) else [],
        'tilt': [float(tilt.min()), float(tilt.max())],
        'iterations': {'march': marched, 'scallop': refined, 'posture': second},
    }


def results(heights: Heights, section: Section) -> dict[str, Any]:
    """Return statistics of heights and ridges; SI units."""
    found = heights.statistics()
    if len(section.ridges):
        low, middle, high = np.percentile(section.ridges, [5.0, 50.0, 95.0]).tolist()
        found |= {
            'ridges': len(section.ridges), 'ridge_5': low, 'ridge_50': middle, 'ridge_95': high,
            'ridge_highest': float(section.ridges.max()),
        }  # fmt: skip
    return found


def describe(summary: dict[str, Any]) -> str:
    """Return the summary in words and shop units."""
    lines = []
    if 'passes' in summary:
        lines += [
            f'surface        {summary["surface"]}',
            f'passes         {summary["passes"]}; {summary["postures"]} postures in '
            f'{summary["computing_time"]:.2f} s',
        ]
        if 'tilt' in summary:
            lines += _planes_in_words(summary)
        lines.append(
            f'program        {summary["program"]}, {summary["blocks"]} blocks; passes of '
            f'{summary["length"] / MM:.0f} mm'
        )
    if 'cycle_time' in summary:
        lines.append(f'cycle time     {summary["cycle_time"]:.3f} s')
    for name in ('programmed', 'planned', 'executed'):
        if name in summary:
            lines.append(f'{name:<15}{_in_words(summary[name])}')
    return '\n'.join(lines)


def _planes_in_words(summary: dict[str, Any]) -> list[str]:
    """Return what only passes along parallel planes have."""
    tilt, steps, counts = summary['tilt'], summary['plane_distance'], summary['iterations']
    apart = f'{steps[0] / MM:.3f} to {steps[1] / MM:.3f} mm apart, ' if steps else ''
    return [
        f'tilt           {tilt[0] / DEG:.2f} to {tilt[1] / DEG:.2f} deg',
        f'planes         {apart}{summary["started_afresh"]} passes started afresh',
        f'iterations     {counts["march"]:.1f} to bracket and {counts["scallop"]:.1f} to solve '
        f'a scallop point, {counts["posture"]:.1f} a posture',
    ]


def _in_words(found: dict[str, Any]) -> str:
    um = {k: v / UM for k, v in found.items() if isinstance(v, float)}
    text = (
        f'{um["lowest"]:.2f} to {um["highest"]:.2f} um, Sa {um["Sa"]:.2f}, Sq {um["Sq"]:.2f}, '
        f'Sz {um["Sz"]:.2f} um; deeper than 0.5 um {found["gouged"]:.2%}, uncut '
        f'{found["uncut"]:.2%}'
    )
    if 'ridges' in found:
        text += (
            f'\n{"":15}ridges {um["ridge_5"]:.2f} / {um["ridge_50"]:.2f} / {um["ridge_95"]:.2f} '
            f'um (5, 50, 95 % of {found["ridges"]}), highest {um["ridge_highest"]:.2f} um'
        )
    return text


def _cut(
    surface: Surface, cutter: Cutter, motion: Motion, normal: FloatArray,
    options: argparse.Namespace,
) -> tuple[Heights, Section]:  # fmt: skip
    """Cut the map and the sections."""
    needles = Needles.on(surface, options.spacing * MM, options.margin * MM)
    progress = _progress(options)
    show = progress.of(f'cutting, {motion.name}')
    heights = cut_needles(needles, cutter, motion.tip, motion.axis, show)
    progress.end(complete=True)
    return heights, cross_sections(surface, cutter, motion, normal, options.margin * MM)


def _path_figures(paths: IsoScallopPaths | ClassicalPaths) -> list[tuple[str, str, Any]]:
    from cnc_interp.cam.page import path_figure, tilt_figure

    figures = [('Passes', 'Contact lines and tool axes.', path_figure(paths))]
    if isinstance(paths, IsoScallopPaths):
        figures.append(('Tilt', 'Tilt along the passes.', tilt_figure(paths)))
    return figures


def _height_figures(
    motion: Motion, heights: Heights, section: Section, scallop: float
) -> list[tuple[str, str, Any]]:
    from cnc_interp.cam.page import map_figure, section_figure

    words = _in_words(results(heights, section))
    return [
        (f'Surface, {motion.name}', words, map_figure(heights, scallop)),
        (
            f'Section, {motion.name}',
            'Heights across the passes.',
            section_figure(section, scallop),
        ),
    ]


def _cutter(options: argparse.Namespace) -> Cutter:
    return Cutter.of_diameter(options.tool_diameter * MM, options.corner_radius * MM)


def _choices(options: argparse.Namespace) -> IsoScallopOptions:
    low, high = options.tilt_limits
    return IsoScallopOptions(
        scallop_height=options.scallop * UM,
        stepover=None if options.stepover is None else options.stepover * MM,
        tilt=options.tilt * DEG,
        tilt_limits=(low * DEG, high * DEG),
        yaw=options.yaw * DEG,
        freedom=options.freedom,
        start=options.start,
        points=options.points,
        stray=None if options.no_restart else IsoScallopOptions.stray,
    )


def _progress(options: argparse.Namespace) -> ProgressBar:
    """Return the progress bar of the command."""
    return ProgressBar(None if options.json else sys.stderr)


def _note(text: str) -> None:
    """Tell what the user should know, beside the results."""
    print(f'note: {text}', file=sys.stderr)
