"""The close-up of corners and the comparison of runs, against physics and the plan files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from packed_page import PACKED, unpacked
from plan_directories import line_x, write
from tiers import few_of

from cnc_interp.commands.cli import main
from cnc_interp.core import MM, UM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.report import write_report
from cnc_interp.report.corner_plots import shift
from cnc_interp.report.corners import MOST, curves_of, lengths, read_segments, views_of
from cnc_interp.smoothing.corners.connection import Curves, poses
from cnc_interp.smoothing.segments import SPLINE

MACHINE = Machine.load('xyzac')
POCKET = Path(__file__).parents[2] / 'examples' / 'pocket_corner.apt'


@pytest.fixture(scope='module')
def plans(tmp_path_factory):
    """Plan one corner twice: with u_top = u_bottom, and with a parametrization of its own."""
    folder = tmp_path_factory.mktemp('plans')
    common = ['plan', str(POCKET), '--contour-tolerance', '0.2', '--orientation-tolerance', '0.2']
    main([*common, '--out', str(folder / 'exact')])
    paper = ['--parametrization', 'paper', '--top', 'tolerance']
    main([*common, *paper, '--out', str(folder / 'paper')])
    return folder


@pytest.mark.parametrize('name', ['exact', 'paper'])
def test_the_close_up_shows_the_corner_s_own_geometry(plans, name):
    segments = read_segments(plans / name)
    (view,) = views_of(read_plan(plans / name), segments)
    assert view.in_step == (name == 'exact')
    assert view.top_u[0] == pytest.approx(0.0) and view.top_u[-1] == pytest.approx(1.0)
    away = view.top - view.bottom
    assert np.allclose(away / np.linalg.norm(away, axis=1)[:, None], view.axis, atol=1e-12)
    # Both curves start and end with their control polygons; the middle point is the program's.
    for curve, polygon in ((view.bottom, view.bottom_polygon), (view.top, view.top_polygon)):
        assert np.allclose(curve[[0, -1]], polygon[[0, -1]], atol=1e-9)
    assert np.allclose(view.vertex, read_plan(plans / name).blocks['tip'][1] / MM, atol=1e-9)
    nearest = np.linalg.norm(view.bottom - view.vertex, axis=1).min()
    assert nearest * MM / UM == pytest.approx(view.deviation[0], rel=1e-3)
    # Moved for the picture only along the tool axis at the middle.
    assert np.linalg.norm(np.cross(shift(view), view.axis[len(view.axis) // 2])) < 1e-12


@pytest.mark.parametrize('name', few_of(2, ['exact', 'paper']))
def test_third_derivatives_are_those_of_finite_differences(plans, name):
    segments = read_segments(plans / name)
    (view,) = views_of(read_plan(plans / name), segments)
    row = int(np.flatnonzero(segments.kind == 1)[0])
    one = segments[row : row + 1]
    curves = Curves(one.bottom, one.top, one.connection, one.parametrization)
    u = np.linspace(0.0, 1.0, 20001)
    tip, axis = (np.concatenate(x) for x in zip(*(poses(curves, v) for v in u), strict=True))
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))] / MM
    assert way[-1] * MM == pytest.approx(lengths(one, 30 * MM)[0], rel=1e-6)
    middle, width = 0.5 * way[-1], way[-1] / 400
    for at in (-0.31, -0.17, 0.12, 0.33):
        places = middle + at * way[-1] + width * np.array([-1.5, -0.5, 0.5, 1.5])
        o = np.stack([np.interp(places, way, axis[:, i]) for i in range(3)], axis=1)
        found = np.linalg.norm(np.array([-1.0, 3.0, -3.0, 1.0]) @ o) / width**3
        drawn = np.interp(at * way[-1], view.way, view.turn)
        assert drawn == pytest.approx(found, rel=0.05, abs=0.02 * view.turn.max())
    # On the lines the axis turns at a constant rate.
    rate = np.linalg.norm(segments.rotation[row - 1]) / (segments.length[row - 1] / MM)
    assert view.turn[0] == pytest.approx(rate**3)


def test_the_feed_shown_is_the_planned_one(tmp_path):
    """With so small a tolerance the corner begins and ends in motion."""
    main(['plan', str(POCKET), '--contour-tolerance', '0.02', '--out', str(tmp_path)])
    plan = read_plan(tmp_path)
    (view,) = views_of(plan, read_segments(tmp_path))
    assert 0.0 < view.slowest < view.programmed
    inside = (view.feed_way >= view.ends[0] - 1e-6) & (view.feed_way <= view.ends[1] + 1e-6)
    assert view.slowest == pytest.approx(view.feed[inside].min())
    # The corner is where the tool passes nearest to the programmed one.
    nearest = np.argmin(np.linalg.norm(plan.path['tip'] - plan.blocks['tip'][1], axis=1))
    middle = plan.path['s'][nearest] - 0.5 * plan.path['s'][-1]
    assert abs(middle / MM) < 0.1 * (view.ends[1] - view.ends[0])


def test_the_page_draws_corners_and_both_runs(plans, tmp_path):
    other = copytree(plans / 'paper', tmp_path / '<b>&')
    assert (
        main(
            [
                'report',
                str(plans / 'exact'),
                '--compare',
                str(other),
                '--html',
                str(tmp_path / 'r.html'),
            ]
        )
        == 0
    )
    page = (tmp_path / 'r.html').read_text(encoding='utf-8')
    body = PACKED.sub('', page)
    place = re.findall(r'<script type="application/json" id="(.*?)">', body).index('corner-data')
    corners = json.loads(unpacked(page)[1 + place])
    assert len(corners) == body.count('<option ') <= MOST
    assert not re.search(r'<(script|img|iframe)[^>]*\ssrc=|<link|@import|url\(', body)
    assert '&lt;b&gt;&amp;' in body and '<b>&' not in body  # the name of a run
    cycle = [read_plan(plans / name).summary['cycle_time'] for name in ('exact', 'paper')]
    cells = r'<th>cycle time</th><td>([\d.]+) s</td><td>([\d.]+) s</td><td>(.*?)</td>'
    *times, change = re.search(cells, body).groups()
    assert [float(x) for x in times] == pytest.approx(cycle, abs=2e-3)
    percent = 100.0 * (cycle[1] / cycle[0] - 1.0)
    assert change == ('=' if abs(percent) < 0.05 else f'{percent:+.1f} %')


@pytest.mark.thorough
def test_segments_of_another_plan_are_refused(plans, tmp_path):
    directory = write(tmp_path, line_x(MACHINE))
    (directory / 'segments.npz').write_bytes((plans / 'exact' / 'segments.npz').read_bytes())
    with pytest.raises(InterpError, match='not of the same plan'):
        write_report(directory, tmp_path / 'r.html')
    (directory / 'segments.npz').write_bytes(b'nothing')
    with pytest.raises(InterpError, match=r'segments\.npz: cannot be read'):
        write_report(directory, tmp_path / 'r.html')


def test_dense_blocks_are_shown_as_the_curves_they_became(tmp_path):
    turn = np.linspace(0.0, 1.2, 61)
    points = np.column_stack([30 * np.cos(turn), 30 * np.sin(turn), np.zeros(61)])
    text = ''.join(f'G1 X{x:.4f} Y{y:.4f} Z{z:.4f} F2000\n' for x, y, z in points)
    program = tmp_path / 'arc.ngc'
    program.write_text(f'G21 G90 G94\nG0 X30 Y0 Z0\n{text}G1 X-20 F2000\nM30\n')
    plan = tmp_path / 'plan'
    assert main(['plan', str(program), '--compress', '--out', str(plan)]) == 0
    segments = read_segments(plan)
    view = curves_of(read_plan(plan), segments)
    assert view is not None and view.runs == 1
    assert view.spans == (segments.kind == SPLINE).sum()
    assert 58 <= view.blocks <= 61
    # the arc, and the curve's end two longest spacings (4 mm) inside the line after it
    assert view.share == pytest.approx(40.0 / (36.0 + 10.87 + 20.0), rel=0.02)
    assert view.bound.max() * UM <= 0.02 * MM
    summary = read_plan(plan).summary
    assert summary['curves'] == {'blocks': view.blocks, 'spans': view.spans}
    assert list(summary['tolerance_used'].values()) == pytest.approx(view.used.tolist())
    assert view.used == pytest.approx(view.bound.max(axis=0) * UM / (0.02 * MM))
    # the drawn curve lies as near to the drawn blocks as the bound says
    a, b = view.polyline[:-1], view.polyline[1:]
    moved = (b - a).any(axis=1)
    a, b = a[moved], b[moved]
    foot = np.einsum('pki,ki->pk', view.curve[:, None] - a, b - a) / ((b - a) ** 2).sum(axis=1)
    near = a + np.clip(foot, 0, 1)[..., None] * (b - a)
    off = np.linalg.norm(view.curve[:, None] - near, axis=2).min(axis=1).max()
    assert 0.5 * view.bound.max() * UM < off * MM <= view.bound.max() * UM
    write_report(plan, tmp_path / 'r.html')
    assert 'Dense blocks as curves' in (tmp_path / 'r.html').read_text()
    assert main(['plan', str(program), '--no-compress', '--out', str(plan)]) == 0
    assert curves_of(read_plan(plan), read_segments(plan)) is None
