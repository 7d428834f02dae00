"""The report: one page that stands alone, small, and shows what the proof found."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plan_directories import files, line_x, stroke, write

from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import DEG, MM, MM_PER_MIN
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify
from cnc_interp.report import write_report
from cnc_interp.report.figures import feed_ceiling, feed_span
from cnc_interp.report.series import extremes, series_of

MACHINE = Machine.load('xyzac')


def page_of(tmp_path, content):
    directory = write(tmp_path / 'plan', content)
    write_report(directory, tmp_path / 'out' / 'report.html')
    return (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')


def test_the_page_needs_no_network(tmp_path):
    page = page_of(tmp_path, line_x(MACHINE))
    head = page[: page.index('<script>')]
    body = page[page.index('</script></head>') :]
    assert page.count('Plotly.newPlot(') >= 4
    for part in (head, body):
        assert not re.search(r'<(script|img|iframe)[^>]*\ssrc=|<link|@import|url\(', part)
    # Nor is there a button that would send it anywhere.
    assert body.count('"modeBarButtonsToRemove"') == 4
    assert len(page) < 8e6
    assert '>proven<' in page and 'not proven' not in page


def test_what_is_not_proven_stands_at_the_head(tmp_path):
    content = line_x(MACHINE)
    content['setpoints']['position'][300, 4] += 1e-5
    content['summary']['program'] = 'a<b>.ngc'
    page = page_of(tmp_path, content)
    assert '>not proven<' in page
    assert 'jerk of C' in page
    assert 'a&lt;b&gt;.ngc' in page and 'a<b>' not in page


def test_errors_at_the_tool_are_told_for_drives_that_are_not_ideal(tmp_path):
    content = line_x(Machine.load('xyzac_tired'))
    content['summary']['machine'] = 'xyzac_tired'
    page = page_of(tmp_path, content)
    told = page[page.index('As they are: tip') :]
    plain, compensated = (float(x) for x in re.findall(r'axis ([0-9.]+)&Prime; at most', told)[:2])
    assert plain >= compensated
    assert 'Error at the tool' not in page_of(tmp_path / 'ideal', line_x(MACHINE))


@pytest.mark.thorough
def test_a_long_program_stays_small(tmp_path):
    page = page_of(tmp_path, line_x(MACHINE, feed=20 * MM_PER_MIN))
    assert '180,' in page  # samples
    assert len(page) < 15e6


def test_three_axes(tmp_path):
    page = page_of(tmp_path, line_x(Machine.load('xyz')))
    assert '>proven<' in page


def test_errors_in_one_line(tmp_path, monkeypatch):
    content = line_x(MACHINE)
    directory = write(tmp_path, content)
    with pytest.raises(InterpError, match='not made for machine xyz'):
        write_report(directory, tmp_path / 'r.html', Machine.load('xyz'))
    (tmp_path / 'file').write_text('')
    with pytest.raises(InterpError, match='cannot be written'):
        write_report(directory, tmp_path / 'file' / 'r.html')
    content['summary']['machine'] = 'nowhere'
    with pytest.raises(InterpError):
        write_report(write(tmp_path, content), tmp_path / 'r.html')
    write_report(directory, tmp_path / 'r.html', MACHINE)
    monkeypatch.setitem(sys.modules, 'plotly.offline', None)
    with pytest.raises(InterpError, match='pip install plotly'):
        write_report(directory, tmp_path / 'r.html', MACHINE)


def test_series_are_the_proof_s_figures(tmp_path):
    content = line_x(MACHINE)
    wave = 3e-6 * np.sin(np.linspace(0, np.pi, len(content['setpoints']['time']))) ** 6
    content['setpoints']['position'][:, 1] = wave
    plan = read_plan(write(tmp_path, content))
    series, proof = series_of(plan, MACHINE), verify(plan, MACHINE)
    for k, kind in enumerate(('velocity', 'acceleration', 'jerk')):
        for j, name in enumerate(MACHINE.axis_names):
            found = proof.largest(kind, name)
            assert np.abs(series.axis_use[k][:, j]).max() == pytest.approx(found.ratio, abs=1e-9)
            assert np.abs(series.axis_use[k][found.sample, j]) == pytest.approx(found.ratio)
    assert series.contour_error.max() == pytest.approx(3.0, rel=1e-3)
    assert series.axis_limits[:, 0, 0] == pytest.approx([500.0, 2500.0, 5000.0])
    assert series.axis_limits[0, 0, 4] == pytest.approx(MACHINE.max_velocity[4] / DEG)
    assert series.feed.max() == pytest.approx(6000.0, rel=1e-3)
    assert series.way[-1] == pytest.approx(60.0)


def test_rapids_leave_the_feed_pictures_finite(tmp_path):
    x, v, a = stroke(60 * MM, 0.5, 2.5, 5.0)
    motion = np.zeros((3, len(x), 5))
    motion[:, :, 2] = x, v, a
    content = files(MACHINE, motion, np.ones(len(x), int), [[0, 0, 0], [0, 0, 60 * MM]], np.inf)
    content['blocks']['rapid'][:] = True
    series = series_of(read_plan(write(tmp_path, content)), MACHINE)
    assert np.isinf(series.programmed_feed).all()
    assert np.isfinite(feed_ceiling(series)) and feed_ceiling(series) > series.feed.max()
    assert 'newPlot' in page_of(tmp_path, content)


def test_short_rapids_do_not_rule_the_colours(tmp_path):
    plan = read_plan(write(tmp_path, line_x(MACHINE)))
    series = series_of(plan, MACHINE)
    assert feed_span(series) == (pytest.approx(6000.0, rel=1e-3), 'feed, mm/min')
    slow = np.full(len(series.feed), 300.0)
    slow[:9] = 9000.0
    top, title = feed_span(type(series)(**{**vars(series), 'feed': slow}))
    assert top == pytest.approx(330.0) and 'faster' in title


@given(st.integers(1, 400), st.integers(1, 3), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_thinning_keeps_extremes_and_ends(count, columns, buckets, seed):
    table = np.random.default_rng(seed).normal(size=(count, columns))
    rows = extremes(table, buckets)
    assert rows[0] == 0 and rows[-1] == count - 1
    assert np.all(np.diff(rows) > 0)
    assert len(rows) <= buckets * (1 + 2 * columns) + 1
    assert np.array_equal(table[rows].max(axis=0), table.max(axis=0))
    assert np.array_equal(table[rows].min(axis=0), table.min(axis=0))
