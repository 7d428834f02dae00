"""The report: one page that stands alone, small, and shows what the proof found."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from packed_page import PACKED, unpacked
from plan_directories import files, line_x, stroke, write

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, MM, MM_PER_MIN, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify
from cnc_interp.report import write_report
from cnc_interp.report.html import feed_ceiling, letters
from cnc_interp.report.plots import feed_figure, feed_span
from cnc_interp.report.series import NO_LIMIT, extremes, series_of, time_lost

MACHINE = Machine.load('xyzac')


def page_of(tmp_path, content):
    directory = write(tmp_path / 'plan', content)
    write_report(directory, tmp_path / 'out' / 'report.html')
    return (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')


def test_the_page_needs_no_network(tmp_path):
    page = page_of(tmp_path, line_x(MACHINE))
    body = PACKED.sub('', page)
    assert not re.search(r'<(script|img|iframe)[^>]*\ssrc=|<link|@import|url\(', body)
    library, *figures = unpacked(page)
    assert 'Plotly' in library and body.count('class="figure"') == len(figures) >= 4
    for figure in figures:
        assert len(json.loads(figure)['data']) > 0
    # Nor is there a button that would send it anywhere.
    assert '"modeBarButtonsToRemove"' in body
    assert len(page.encode()) < 2e6
    assert '>proven<' in page and 'not proven' not in page
    assert 'corner-data' not in body  # there are no segments
    assert 'Error at the tool' not in body  # the drives are ideal


def test_errors_at_the_tool_are_told_for_drives_that_are_not_ideal(tmp_path):
    content = line_x(Machine.load('xyzac_tired'))
    content['summary']['machine'] = 'xyzac_tired'
    page = page_of(tmp_path, content)
    told = page[page.index('As they are: tip') :]
    plain, compensated = (float(x) for x in re.findall(r'axis ([0-9.]+)&Prime; at most', told)[:2])
    assert plain >= compensated
    layout = json.loads(next(text for text in unpacked(page) if 'arcsec' in text))['layout']
    titles = [layout[axis]['title']['text'] for axis in ('yaxis', 'yaxis2')]
    assert titles == ['tip [µm]', 'axis [arcsec]']


@pytest.mark.thorough
def test_a_long_program_stays_small(tmp_path):
    page = page_of(tmp_path, line_x(MACHINE, feed=20 * MM_PER_MIN))
    assert '180,' in page  # samples
    assert len(page.encode()) < 2e6


@pytest.mark.thorough
def test_three_axes(tmp_path):
    page = page_of(tmp_path, line_x(Machine.load('xyz')))
    assert '>proven<' in page


def test_errors_in_one_line(tmp_path, monkeypatch, capsys):
    content = line_x(MACHINE)
    directory = write(tmp_path, content)
    with pytest.raises(InterpError, match='not made for machine xyz'):
        write_report(directory, tmp_path / 'r.html', Machine.load('xyz'))
    content['summary']['machine'] = 'nowhere'
    with pytest.raises(InterpError):
        write_report(write(tmp_path, content), tmp_path / 'r.html')
    content['summary']['machine'] = 'xyzac'
    directory = write(tmp_path, content)
    monkeypatch.setitem(sys.modules, 'plotly.offline', None)
    assert main(['report', str(directory), '--out', str(tmp_path / 'r.html')]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith('cnc-interp: plotly is not installed; ')


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


def test_lost_time_is_that_beyond_the_programmed_feed(tmp_path):
    plan = read_plan(write(tmp_path, line_x(MACHINE)))
    series = series_of(plan, MACHINE)
    found = time_lost(series)
    assert found.total == pytest.approx(series.time[-1] - 60.0 / 6000.0 * 60.0, abs=2e-3)
    for parts in (found.by_limit, found.by_line):
        assert sum(part[1] for part in parts.values()) == pytest.approx(found.total)
    assert sum(part[0] for part in found.by_line.values()) == pytest.approx(
        series.time[-1], abs=2e-3
    )
    # The stroke changes its acceleration with the jerk of X, and is at nothing else while it does.
    jerk, acceleration, none = (
        found.by_limit[name] for name in ('X jerk', 'X acceleration', NO_LIMIT)
    )
    assert jerk[0] > 0.0 and jerk[1] + acceleration[1] > 0.9 * found.total > none[1]
    assert {part[3] for line, part in found.by_line.items() if part[1] > 1e-3} <= {
        'X jerk',
        'X acceleration',
    }
    rapid = replace(series, programmed_feed=np.full_like(series.feed, np.inf))
    assert time_lost(rapid).total == 0.0
    # Where the error of the drives is at its limit, nothing else needs to be.
    limited = time_lost(series, np.full(len(series.time), 0.95))
    assert limited.by_limit['error at the tool'][0] == pytest.approx(series.time[-1], abs=2e-3)
    assert limited.by_limit[NO_LIMIT] == (0.0, 0.0)


@given(st.binary(max_size=60))
def test_packed_bytes_stay_what_they_are(whole):
    text = letters(whole)
    assert not set(text) & set('\0\r<')
    bits = ''.join(f'{ord(letter) & 127:07b}' for letter in text)[: 8 * len(whole)]
    assert int(bits or '0', 2).to_bytes(len(whole), 'big') == whole


def test_rapids_leave_the_feed_pictures_finite_and_what_is_not_proven_stands_at_the_head(tmp_path):
    x, v, a = stroke(60 * MM, 0.5, 2.5, 5.0)
    motion = np.zeros((3, len(x), 5))
    motion[:, :, 2] = x, v, a
    content = files(MACHINE, motion, np.ones(len(x), int), [[0, 0, 0], [0, 0, 60 * MM]], np.inf)
    content['blocks']['rapid'][:] = True
    series = series_of(read_plan(write(tmp_path, content)), MACHINE)
    assert np.isinf(series.programmed_feed).all()
    ceiling = feed_ceiling(series.feed, series.programmed_feed)
    assert np.isfinite(ceiling) and ceiling > series.feed.max()
    content['setpoints']['position'][300, 4] += 1e-5
    content['summary']['program'] = 'a<b>.ngc'
    page = page_of(tmp_path, content)
    assert len(unpacked(page)) > 4
    assert '>not proven<' in page
    assert 'jerk of C' in page
    assert 'a&lt;b&gt;.ngc' in page and 'a<b>' not in page


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


def test_a_feed_axis_ends_above_the_motion_and_a_fast_program_at_some_times_of_it():
    motion = np.array([40.0, 100.0])
    for programmed, most, end in (
        (250.0, 3.0, 250.0),
        (1000.0, 3.0, 300.0),
        (1000.0, 2.0, 200.0),
        (np.inf, 3.0, 100.0),
        (50.0, 3.0, 100.0),
    ):
        found = feed_ceiling(motion, np.array([10.0, programmed]), most)
        assert 1.3 * end < found < 1.6 * end
    assert feed_ceiling(np.zeros(2), np.full(2, np.inf)) == 1.0


def test_functions_stand_where_they_switch(tmp_path):
    program = tmp_path / 'part.ngc'
    program.write_text('G0 X0 Y0 Z5\nM8\nG1 Z0 F600\nX20 M9\nX30\nM2\n')
    assert main(['plan', str(program), '--machine', 'vmc', '--out', str(tmp_path / 'plan')]) == 0
    series = series_of(read_plan(tmp_path / 'plan'), Machine.load('vmc'))
    marks = feed_figure(series).data[-1]
    assert [text.partition('<')[0] for text in marks.text] == [
        'coolant_flood on',
        'coolant_mist off',
        'spindle_forward off',
    ]
    at = np.flatnonzero(np.isin(series.time, marks.x))
    assert np.allclose(series.tip[at, ::2], [[0, 5], [20, 0], [30, 0]], atol=0.05)
