"""The work of the `cam` commands: surface, passes, program, plan, motion, N-buffer, page."""

import json
import sys
import time
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.cam import summary as facts
from cnc_interp.cam.gouge import Neighbours
from cnc_interp.cam.nbuffer import Heights, cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.request import CamRequest, CutRequest, SimulateRequest
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
from cnc_interp.cam.tool_path import UPRIGHT, link, write_tool_path
from cnc_interp.core import (
    MM_PER_MIN,
    UM,
    FloatArray,
    InterpError,
    cross,
    demand,
    norm,
    refuse_if,
    unit,
)
from cnc_interp.core.progress_bar import ProgressBar
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program, read_program
from cnc_interp.proof.plan_files import PlanFiles, read_plan
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

HIGHER = 1.002  #: A note names executed ridges above this multiple of the scallop height [-].


def make_program(request: CamRequest) -> int:
    demand(
        request.passes.ridge > 0.0,
        InterpError('--scallop must be larger than --reserve and --chord together'),
    )
    part, cutter = _part(request), request.cutter
    faces = [_machined(number, part, request) for number in part.surfaces]
    around = None if request.ignore_neighbours else part.neighbours
    up = _upwards(faces)
    steps = [
        step
        for face in faces
        for step in link(face.parts, face.surface, cutter, request.links, _all(faces, around), up)
    ]
    machine, tolerance = Machine.load(request.machine), request.tolerance
    reading = Settings(contour_tolerance=tolerance, orientation_tolerance=tolerance)
    out = request.out
    out.mkdir(parents=True, exist_ok=True)
    file = write_tool_path(
        steps,
        request.feed,
        request.chord,
        out / 'program',
        request.format,
        machine,
        reading,
    )
    program = read_program(file, Transform.of(machine), reading)
    summary = {
        'surface': str(request.surface),
        'strategy': request.strategy.name,
        **facts.facts_of(faces, request.strategy),
        'program': str(file),
        'blocks': len(program.blocks) - 1,
    }
    beside = facts.pole_turn(
        [piece for face in faces for parts in face.parts for piece in parts],
        request.feed,
        tolerance / reading.flank_height,
        machine,
    )
    if beside:
        summary['pole'] = asdict(beside)
    motions = []
    if request.run or request.simulate:
        motions.append(programmed(program))
        if request.run:
            with _progress(request) as progress:
                summary['cycle_time'] = plan_to_files(
                    open_program(file, Transform.of(machine), reading),
                    machine,
                    out / 'plan',
                    progress=progress.of('planning'),
                )['cycle_time']
            files = read_plan(out / 'plan').in_memory()
            motions += [planned(files, machine), _executed(files, machine, request)]
    figures = _drawn(faces, motions, summary, request)
    (out / 'summary.json').write_text(json.dumps(summary, indent=2) + '\n', encoding='utf-8')
    text = facts.describe(summary)
    from cnc_interp.cam.program_page import write_page

    write_page(out / 'cam.html', str(request.surface), text, figures)
    print(json.dumps(summary, indent=2) if request.json else f'{text}\nwritten        {out}')
    for face, found in zip(faces, facts.face_facts(summary), strict=True):
        highest = found.get('executed', {}).get('ridge_highest', 0.0)
        if highest > HIGHER * request.scallop:
            over = (highest - request.scallop) / UM
            more = request.reserve / UM + 0.05 * np.ceil(20.0 * over)
            face.notes.append(
                f'the drives leave ridges up to {highest / UM:.2f} um; --compensate MACHINE or '
                f'--reserve {more:.2f} lowers them'
            )
        for note in face.notes:
            _note(f'face {face.number}: {note}' if len(faces) > 1 else note)
    return 0


def _upwards(faces: list[MachinedFace]) -> FloatArray:
    mean = np.mean([unit(_mean_normal(face.surface)) for face in faces], axis=0)
    refuse_if(
        float(norm(mean)) < UPRIGHT,
        SurfaceError('the faces look in opposite directions; make a program for each side'),
    )
    return unit(mean)


def _machined(number: int, part: Part, request: CamRequest) -> MachinedFace:
    surface, cutter = part.surfaces[number], request.cutter
    normal = across(surface, request.direction)
    others = part.neighbours.without(number) if part.neighbours else None
    try:
        clock = time.perf_counter()
        paths = _followed(surface, normal, request)
        clock = time.perf_counter() - clock
        parts, notes = cut_back(
            paths,
            cutter,
            request.overrun,
            None if request.ignore_neighbours else others,
        )
    except SurfaceError as error:
        if len(part.surfaces) == 1:
            raise
        raise SurfaceError(f'face {number}: {error}') from error
    return MachinedFace(number, surface, normal, paths, parts, clock, [*paths.notes, *notes])


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
    summary: dict[str, Any],
    request: CamRequest,
) -> list[tuple[str, str, Any]]:
    from cnc_interp.cam.program_page import path_figure

    figures = []
    for face, figures_of in zip(faces, facts.face_facts(summary), strict=True):
        name = f'Face {face.number}: ' if len(faces) > 1 else ''
        drawn = [('Passes', 'Contact lines and tool axes.', path_figure(face.paths))]
        drawn += request.strategy.figures(face.paths)
        for motion in motions:
            heights, section = _cut(face.surface, motion, face.across, request)
            figures_of[motion.name] = facts.results(heights, section)
            drawn += _height_figures(motion, heights, section, request.scallop)
        figures += [(name + heading, text, figure) for heading, text, figure in drawn]
    return figures


def _part(request: CutRequest) -> Part:
    part = read_part(request.surface, request.face, _note)
    if not any(request.turns):
        return part
    turn = Rotation.from_euler('xyz', request.turns, degrees=True).as_matrix()
    surfaces: dict[int, Surface] = {
        number: Placed(surface, turn, np.zeros(3)) for number, surface in part.surfaces.items()
    }
    return Part(surfaces, part.neighbours.turned(turn) if part.neighbours else None)


def _followed(surface: Surface, normal: FloatArray, request: CamRequest) -> Strips:
    with _progress(request) as progress:
        show = progress.of('passes')
        return request.strategy.passes(surface, request.cutter, normal, request.passes, show)


def _executed(files: PlanFiles, machine: Machine, request: CutRequest) -> Motion:
    model = Machine.load(request.compensate) if request.compensate else None
    return executed(files, machine, model)


def simulate_motion(request: SimulateRequest) -> int:
    refuse_options(request)
    ((_, surface),) = _part(request).surfaces.items()
    machine = Machine.load(request.machine)
    if request.motion.is_dir():
        files = read_plan(request.motion).in_memory()
        of_drives = request.executed
        motion = _executed(files, machine, request) if of_drives else planned(files, machine)
    else:
        reading = Settings(feedrate=MM_PER_MIN, contour_tolerance=request.tolerance)
        motion = programmed(read_program(request.motion, Transform.of(machine), reading))
    normal = across(surface, request.direction)
    if request.tiles:
        section = cross_sections(surface, request.cutter, motion, normal, request.margin)
        summary = {motion.name: simulate_in_tiles(surface, motion, section, request)}
    else:
        heights, section = _cut(surface, motion, normal, request)
        summary = {motion.name: facts.results(heights, section)}
    if request.out:
        from cnc_interp.cam.program_page import write_page

        figures = _height_figures(motion, heights, section, request.scallop)
        write_page(request.out, str(request.motion), facts.describe(summary), figures)
    print(json.dumps(summary, indent=2) if request.json else facts.describe(summary))
    return 0


def across(surface: Surface, direction: float) -> FloatArray:
    """Return the plane normal N for a feed direction [rad] in the mean tangent plane."""
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
    surface: Surface, motion: Motion, normal: FloatArray, request: CutRequest
) -> tuple[Heights, Section]:
    needles, cutter = Needles.on(surface, request.spacing, request.margin), request.cutter
    with _progress(request) as progress:
        show = progress.of(f'cutting, {motion.name}')
        heights = cut_needles(needles, cutter, motion.tip, motion.axis, show)
    return heights, cross_sections(surface, cutter, motion, normal, request.margin)


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


def _progress(request: CutRequest) -> ProgressBar:
    return ProgressBar(None if request.json else sys.stderr)


def _note(text: str) -> None:
    print(f'note: {text}', file=sys.stderr)
