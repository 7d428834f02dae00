"""The work of the `cam` commands: surface, passes, program, plan, motion, N-buffer, page."""

import argparse
import json
import sys
import time
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.cam import summary as facts
from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.gouge import Neighbours
from cnc_interp.cam.iso_scallop import IsoScallopOptions, IsoScallopPaths, iso_scallop_paths
from cnc_interp.cam.nbuffer import Heights, cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.simulation import (
    Motion,
    Section,
    cross_sections,
    executed,
    planned,
    programmed,
)
from cnc_interp.cam.spline_pass import MachinedFace, Strips, cut_back
from cnc_interp.cam.step_file import Part
from cnc_interp.cam.surface import SAMPLES, Placed, Surface, SurfaceError
from cnc_interp.cam.surface_file import read_part
from cnc_interp.cam.tile_work import refuse_options, simulate_in_tiles
from cnc_interp.cam.tool_path import UPRIGHT, LinkOptions, link, write_tool_path
from cnc_interp.core import DEG, MM, MM_PER_MIN, UM, FloatArray, InterpError, cross, norm, unit
from cnc_interp.core.progress_bar import ProgressBar
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import open_program, read_program
from cnc_interp.proof.plan_files import PlanFiles, read_plan
from cnc_interp.run.chain import plan_to_files
from cnc_interp.settings.options import Settings

#: Tolerances of the program, as a share of the scallop height, and of what is held in reserve.
SMOOTHING, SMOOTHING_OF_RESERVE = 0.2, 0.5
HIGHER = 1.002  #: A note names executed ridges that are higher than so many scallops.


def make_program(options: argparse.Namespace) -> int:
    if not _left_by_passes(options) > 0.0:
        raise InterpError('--scallop must be larger than --reserve and --chord together')
    part = _part(options)
    cutter = _cutter(options)
    faces = [_machined(number, part, cutter, options) for number in part.surfaces]
    links = LinkOptions(options.linking, options.clearance * MM)
    around = None if options.ignore_neighbours else part.neighbours
    up = _upwards(faces)
    steps = [
        step
        for face in faces
        for step in link(face.parts, face.surface, cutter, links, _all(faces, around), up)
    ]
    machine = Machine.load(options.machine)
    tolerance = _tolerance(cutter, options)
    reading = Settings(contour_tolerance=tolerance, orientation_tolerance=tolerance)
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    file = write_tool_path(
        steps,
        options.feed * MM_PER_MIN,
        options.chord * UM,
        out / 'program',
        options.format,
        machine,
        reading,
    )
    program = read_program(file, Transform.of(machine), reading)
    summary = {
        'surface': str(options.surface),
        **facts.facts_of(faces),
        'program': str(file),
        'blocks': len(program.blocks) - 1,
    }
    beside = facts.pole_turn(
        [piece for face in faces for parts in face.parts for piece in parts],
        options.feed * MM_PER_MIN,
        tolerance / reading.flank_height,
        machine,
    )
    if beside:
        summary['pole'] = asdict(beside)
    motions = []
    if options.run or options.simulate:
        motions.append(programmed(program))
        if options.run:
            progress = _progress(options)
            summary['cycle_time'] = plan_to_files(
                open_program(file, Transform.of(machine), reading),
                machine,
                out / 'plan',
                progress=progress.of('planning'),
            )['cycle_time']
            progress.end(complete=True)
            files = read_plan(out / 'plan').in_memory()
            motions += [planned(files, machine), _executed(files, machine, options)]
    figures = _drawn(faces, motions, cutter, summary, options)
    (out / 'summary.json').write_text(json.dumps(summary, indent=2) + '\n', encoding='utf-8')
    text = facts.describe(summary)
    from cnc_interp.cam.program_page import write_page

    write_page(out / 'cam.html', str(options.surface), text, figures)
    print(json.dumps(summary, indent=2) if options.json else f'{text}\nwritten        {out}')
    for face, found in zip(faces, facts.face_facts(summary), strict=True):
        highest = found.get('executed', {}).get('ridge_highest', 0.0)
        if highest > HIGHER * options.scallop * UM:
            more = options.reserve + 0.05 * np.ceil(20.0 * (highest / UM - options.scallop))
            face.notes.append(
                f'the drives leave ridges up to {highest / UM:.2f} um; --compensate MACHINE or '
                f'--reserve {more:.2f} lowers them'
            )
        for note in face.notes:
            _note(f'face {face.number}: {note}' if len(faces) > 1 else note)
    return 0


def _left_by_passes(options: argparse.Namespace) -> float:
    chord = 0.0 if options.format == 'spline' else options.chord
    return float((options.scallop - options.reserve - chord) * UM)


def _tolerance(cutter: Cutter, options: argparse.Namespace) -> float:
    if not options.reserve:
        return float(SMOOTHING * options.scallop * UM)
    widest = 1.0 + (cutter.tool_radius + cutter.corner_radius) / Settings().flank_height
    return float(SMOOTHING_OF_RESERVE * options.reserve * UM / widest)


def _upwards(faces: list[MachinedFace]) -> FloatArray:
    mean = np.mean([unit(_mean_normal(face.surface)) for face in faces], axis=0)
    if float(norm(mean)) < UPRIGHT:
        raise SurfaceError('the faces look in opposite directions; make a program for each side')
    return unit(mean)


def _machined(
    number: int, part: Part, cutter: Cutter, options: argparse.Namespace
) -> MachinedFace:
    surface = part.surfaces[number]
    normal = across(surface, options.direction * DEG)
    others = part.neighbours.without(number) if part.neighbours else None
    axis = unit(_mean_normal(surface)) if cutter.is_ball else None
    try:
        clock = time.perf_counter()
        paths = _followed(surface, cutter, normal, options)
        clock = time.perf_counter() - clock
        parts, notes = cut_back(
            paths,
            cutter,
            options.overrun * MM,
            axis,
            None if options.ignore_neighbours else others,
        )
    except SurfaceError as error:
        if len(part.surfaces) == 1:
            raise
        raise SurfaceError(f'face {number}: {error}') from error
    own = paths.notes if isinstance(paths, IsoScallopPaths) else []
    return MachinedFace(number, surface, normal, paths, parts, clock, [*own, *notes])


def _all(faces: list[MachinedFace], around: Neighbours | None) -> Neighbours | None:
    if around is not None or len(faces) == 1:
        return around
    found = []
    for face in faces:
        u, v = face.surface.grid(SAMPLES, SAMPLES)
        ours = face.surface.contains(u, v)
        found.append(face.surface.at(u[ours], v[ours]).position)
    owner = np.repeat([face.number for face in faces], [len(x) for x in found])
    return Neighbours(np.concatenate(found), owner)


def _drawn(
    faces: list[MachinedFace],
    motions: list[Motion],
    cutter: Cutter,
    summary: dict[str, Any],
    options: argparse.Namespace,
) -> list[tuple[str, str, Any]]:
    from cnc_interp.cam.program_page import path_figure, tilt_figure

    figures = []
    for face, figures_of in zip(faces, facts.face_facts(summary), strict=True):
        name = f'Face {face.number}: ' if len(faces) > 1 else ''
        drawn = [('Passes', 'Contact lines and tool axes.', path_figure(face.paths))]
        if isinstance(face.paths, IsoScallopPaths):
            drawn.append(('Tilt', 'Tilt along the passes.', tilt_figure(face.paths)))
        for motion in motions:
            heights, section = _cut(face.surface, cutter, motion, face.across, options)
            figures_of[motion.name] = facts.results(heights, section)
            drawn += _height_figures(motion, heights, section, options.scallop * UM)
        figures += [(name + heading, text, figure) for heading, text, figure in drawn]
    return figures


def _part(options: argparse.Namespace) -> Part:
    part = read_part(options.surface, options.face or [], _note)
    turns = options.turn_x, options.turn_y, options.turn_z
    if not any(turns):
        return part
    turn = Rotation.from_euler('xyz', turns, degrees=True).as_matrix()
    surfaces: dict[int, Surface] = {
        number: Placed(surface, turn, np.zeros(3)) for number, surface in part.surfaces.items()
    }
    return Part(surfaces, part.neighbours.turned(turn) if part.neighbours else None)


def _followed(
    surface: Surface, cutter: Cutter, normal: FloatArray, options: argparse.Namespace
) -> Strips:
    progress = _progress(options)
    show = progress.of('passes')
    if options.strategy == 'planes':
        planes = iso_scallop_paths(surface, cutter, normal, _choices(options), show)
        progress.end(complete=True)
        return planes
    from cnc_interp.cam.classical import classical_paths

    paths = classical_paths(
        surface, cutter, normal, _left_by_passes(options), options.tilt * DEG, progress=show
    )
    progress.end(complete=not paths.loop)
    if paths.loop:
        raise SurfaceError(
            f'the classical path cannot cover this surface: {paths.loop}; take another direction '
            'or --strategy planes'
        )
    strips: Strips = paths
    return strips


def _executed(files: PlanFiles, machine: Machine, options: argparse.Namespace) -> Motion:
    model = Machine.load(options.compensate) if options.compensate else None
    return executed(files, machine, model)


def simulate_motion(options: argparse.Namespace) -> int:
    refuse_options(options)
    ((_, surface),) = _part(options).surfaces.items()
    cutter = _cutter(options)
    machine = Machine.load(options.machine)
    if options.motion.is_dir():
        files = read_plan(options.motion).in_memory()
        of_drives = options.executed
        motion = _executed(files, machine, options) if of_drives else planned(files, machine)
    else:
        reading = Settings(feedrate=MM_PER_MIN, contour_tolerance=SMOOTHING * options.scallop * UM)
        motion = programmed(read_program(options.motion, Transform.of(machine), reading))
    normal = across(surface, options.direction * DEG)
    if options.tiles:
        section = cross_sections(surface, cutter, motion, normal, options.margin * MM)
        summary = {motion.name: simulate_in_tiles(surface, cutter, motion, section, options)}
    else:
        heights, section = _cut(surface, cutter, motion, normal, options)
        summary = {motion.name: facts.results(heights, section)}
    if options.out:
        from cnc_interp.cam.program_page import write_page

        figures = _height_figures(motion, heights, section, options.scallop * UM)
        write_page(options.out, str(options.motion), facts.describe(summary), figures)
    print(json.dumps(summary, indent=2) if options.json else facts.describe(summary))
    return 0


def across(surface: Surface, direction: float) -> FloatArray:
    """Return N for a feed direction in the mean tangent plane of a surface."""
    u, v = surface.grid(21, 21)
    point = surface.at(u, v)
    up = unit(_mean_normal(surface))
    first = point.d_u.reshape(-1, 3).mean(axis=0)
    first = unit(first - (first @ up) * up)
    feed = np.cos(direction) * first + np.sin(direction) * cross(up, first)
    return cross(feed, up)


def _mean_normal(surface: Surface) -> FloatArray:
    u, v = surface.grid(21, 21)
    return np.asarray(surface.at(u, v).normal.reshape(-1, 3).mean(axis=0))


def _cut(
    surface: Surface,
    cutter: Cutter,
    motion: Motion,
    normal: FloatArray,
    options: argparse.Namespace,
) -> tuple[Heights, Section]:
    needles = Needles.on(surface, options.spacing * MM, options.margin * MM)
    progress = _progress(options)
    show = progress.of(f'cutting, {motion.name}')
    heights = cut_needles(
        needles, cutter, motion.tip, motion.axis, show, getattr(options, 'device', 'cpu')
    )
    progress.end(complete=True)
    return heights, cross_sections(surface, cutter, motion, normal, options.margin * MM)


def _height_figures(
    motion: Motion, heights: Heights, section: Section, scallop: float
) -> list[tuple[str, str, Any]]:
    from cnc_interp.cam.program_page import map_figure, section_figure

    words = facts.heights_in_words(facts.results(heights, section))
    drawn = section_figure(section, scallop)
    return [
        (f'Surface, {motion.name}', words, map_figure(heights, scallop)),
        (f'Section, {motion.name}', 'Heights across the passes.', drawn),
    ]


def _cutter(options: argparse.Namespace) -> Cutter:
    return Cutter.of_diameter(options.tool_diameter * MM, options.corner_radius * MM)


def _choices(options: argparse.Namespace) -> IsoScallopOptions:
    low, high = options.tilt_limits
    return IsoScallopOptions(
        scallop_height=_left_by_passes(options),
        stepover=None if options.stepover is None else options.stepover * MM,
        tilt=options.tilt * DEG,
        tilt_limits=(low * DEG, high * DEG),
        yaw=options.yaw * DEG,
        freedom=options.freedom,
        start=options.start,
        points=options.points,
        stray=None if options.no_restart else IsoScallopOptions.stray,
        overrun=options.overrun * MM,
    )


def _progress(options: argparse.Namespace) -> ProgressBar:
    return ProgressBar(None if options.json else sys.stderr)


def _note(text: str) -> None:
    print(f'note: {text}', file=sys.stderr)
