"""Figures of passes and of simulated surfaces: for summary.json and as text."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cnc_interp.cam.iso_scallop import IsoScallopPaths
from cnc_interp.cam.nbuffer import Heights
from cnc_interp.cam.pole_turn import PoleTurn
from cnc_interp.cam.simulation import Section
from cnc_interp.cam.spline_pass import MachinedFace
from cnc_interp.core import DEG, MM, UM


def facts_of(faces: Sequence[MachinedFace]) -> dict[str, Any]:
    found = [_facts_of(face) for face in faces]
    if len(faces) == 1:
        return found[0]
    return {'faces': [{'face': face.number, **one} for face, one in zip(faces, found)]}


def face_facts(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the part of a summary for each face; a single face has the whole summary."""
    found: list[dict[str, Any]] = summary.get('faces', [summary])
    return found


def _facts_of(face: MachinedFace) -> dict[str, Any]:
    paths = face.paths
    found = {
        'passes': len(paths.passes), 'postures': sum(len(p.s) for p in paths.passes),
        'computing_time': face.seconds, 'length': sum(p.curve.length for p in paths.passes),
        'milled_parts': sum(map(len, face.parts)),
        'milled_length': sum(x.ends[1] - x.ends[0] for parts in face.parts for x in parts),
    }  # fmt: skip
    if not isinstance(paths, IsoScallopPaths):
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
    return heights.statistics() | ridges_of(section)


def ridges_of(section: Section) -> dict[str, Any]:
    if not len(section.ridges):
        return {}
    low, middle, high = np.percentile(section.ridges, [5.0, 50.0, 95.0]).tolist()
    return {
        'ridges': len(section.ridges), 'ridge_5': low, 'ridge_50': middle, 'ridge_95': high,
        'ridge_highest': float(section.ridges.max()),
    }  # fmt: skip


def describe(summary: dict[str, Any]) -> str:
    lines = []
    if 'surface' in summary:
        lines.append(f'surface        {summary["surface"]}')
    for face in face_facts(summary):
        if 'face' in face:
            lines.append(f'face           {face["face"]}')
        if 'passes' in face:
            lines += _passes_in_words(face)
    if 'program' in summary:
        lines.append(f'program        {summary["program"]}, {summary["blocks"]} blocks')
    if 'pole' in summary:
        lines.append(f'pole           {PoleTurn(**summary["pole"]).text}')
    if 'cycle_time' in summary:
        lines.append(f'cycle time     {summary["cycle_time"]:.3f} s')
    for face in face_facts(summary):
        for name in ('programmed', 'planned', 'executed'):
            if name in face:
                of = f'face {face["face"]}: ' if 'face' in face else ''
                lines.append(f'{name:<15}{of}{heights_in_words(face[name])}')
    return '\n'.join(lines)


def _passes_in_words(face: dict[str, Any]) -> list[str]:
    several = face['milled_parts'] != face['passes']
    parts = f' in {face["milled_parts"]} parts' if several else ''
    return [
        f'passes         {face["passes"]}{parts}, {face["milled_length"] / MM:.0f} mm; '
        f'{face["postures"]} postures in {face["computing_time"]:.2f} s',
        *(_planes_in_words(face) if 'tilt' in face else []),
    ]


def _planes_in_words(summary: dict[str, Any]) -> list[str]:
    tilt, steps, counts = summary['tilt'], summary['plane_distance'], summary['iterations']
    apart = f'{steps[0] / MM:.3f} to {steps[1] / MM:.3f} mm apart, ' if steps else ''
    return [
        f'tilt           {tilt[0] / DEG:.2f} to {tilt[1] / DEG:.2f} deg',
        f'planes         {apart}{summary["started_afresh"]} passes started afresh',
        f'iterations     {counts["march"]:.1f} to bracket and {counts["scallop"]:.1f} to solve '
        f'a scallop point, {counts["posture"]:.1f} a posture',
    ]


def heights_in_words(found: dict[str, Any]) -> str:
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
    if 'tiles' in found:
        tiles = found['tiles']
        known = f', {tiles["known_before"]} of them known before' if tiles['known_before'] else ''
        text += (
            f'\n{"":15}{tiles["needles"]} needles ({tiles["rows"]} x {tiles["columns"]}) in '
            f'{tiles["tiles"]} tiles{known}\n{"written":<15}{tiles["folder"]}: index.html, '
            'heights.zarr'
        )
    return text
