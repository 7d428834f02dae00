"""Whole programs: golden files, the bundled examples, and real ones where they are at hand."""

import csv
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_program_subdivision import TableAC

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, read_program
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.settings.options import Settings

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / 'examples'
SHARED = ROOT.parent / 'shared' / 'programs'
#: What no machine can make readable: the word at which it is refused.
#: They take a second each to read.
LONG = 'dmu50-boss-h', 'linuxcnc-stellabee', 'nist-box-op5', 'mach-pulley-r-arcs'
REFUSED = {'gcws-sinumerik840d': 'L54'}
#: Programs that need another machine or the operator's work offsets.
SETUPS = {'nist-box-op5': JobSetup(work_offsets={'G58': {'X': 0.0, 'Y': 0.0}})}
MACHINES = {
    'spinner-achskreuz-mpf': 'bc_trunnion',
    'opencn-congee-5x': 'xyzbc',
    'solidcam-4x-rotx': 'xyza',
    **dict.fromkeys(('nist-box-op5', 'qtpyvcp-bezel', 'fanuc-test-g91'), 'vmc'),
}


def read(path, **options):
    return read_program(path, TableAC(), Settings(**options))


def shared(name):
    files = [path for path in (SHARED / name).glob('*') if path.name != 'SOURCE']
    if not files:
        pytest.skip('the collection of real programs is not at hand')
    return files[0]


def test_golden_tilted_square():
    folder = ROOT / 'test' / 'golden' / 'program'
    blocks = read(folder / 'tilted_square.ngc').blocks
    with (folder / 'tilted_square.csv').open() as rows:
        wanted = [
            {key: float(value) for key, value in row.items()} for row in csv.DictReader(rows)
        ]
    ends = np.flatnonzero(np.diff(blocks.line_number, append=-1))
    assert blocks.line_number[ends].tolist() == [row['line'] for row in wanted]
    for row, end in zip(wanted, ends, strict=True):
        pieces = blocks.line_number == row['line']
        np.testing.assert_allclose(blocks.tip[end] * 1e3, [row[k] for k in 'xyz'], atol=1e-9)
        np.testing.assert_allclose(np.degrees(blocks.rotary[end]), [row['a'], row['c']], atol=1e-9)
        np.testing.assert_allclose(blocks.feedrate[pieces] * 6e4, row['feed'])
        np.testing.assert_allclose(blocks.duration[pieces].sum(), row['duration'])
        assert blocks.exact_stop[pieces].sum() == row['exact_stop']


def test_examples_are_what_their_script_writes(tmp_path):
    script = tmp_path / 'make_examples.py'
    script.write_text((EXAMPLES / 'make_examples.py').read_text())
    subprocess.run([sys.executable, str(script)], check=True)
    for name in ('pyramid.apt', 'pyramid.ngc', 'pocket_corner.apt'):
        assert (tmp_path / name).read_text() == (EXAMPLES / name).read_text()


def wall_tilt(blocks, row):
    """Angle of the wall between two blocks against the vertical [deg]."""
    along = blocks.tip[row] - blocks.tip[row - 1]
    normal = np.cross(along, blocks.axis[row])
    other = np.cross(along, blocks.axis[row - 1])
    np.testing.assert_allclose(
        normal / np.linalg.norm(normal), other / np.linalg.norm(other), atol=1e-8
    )
    return np.degrees(np.arcsin(normal[2] / np.linalg.norm(normal)))


@pytest.mark.parametrize('name', ['pyramid.apt', 'pyramid.ngc'])
def test_pyramid_has_four_flat_walls_tilted_outward(name):
    blocks = read(EXAMPLES / name).blocks
    assert len(blocks) == 5
    for row in range(1, 5):
        assert abs(wall_tilt(blocks, row)) == pytest.approx(15.0, abs=1e-6)
        assert np.linalg.norm(blocks.tip[row] - blocks.tip[row - 1]) == pytest.approx(0.06)
        assert blocks.tip[row, :2] @ blocks.axis[row, :2] > 0.0
    np.testing.assert_allclose(blocks.feedrate[1:], 0.05)
    np.testing.assert_allclose(blocks.tip[0], blocks.tip[-1])
    np.testing.assert_allclose(blocks.contour_tolerance, 2e-5)


def test_both_pyramids_are_the_same_path():
    first, second = (read(EXAMPLES / name).blocks for name in ('pyramid.apt', 'pyramid.ngc'))
    np.testing.assert_allclose(first.tip, second.tip, atol=1e-12)
    np.testing.assert_allclose(first.axis, second.axis, atol=1e-8)


def test_pocket_corner_has_walls_of_15_and_12_deg():
    blocks = read(EXAMPLES / 'pocket_corner.apt').blocks
    assert [abs(wall_tilt(blocks, row)) for row in (1, 2)] == pytest.approx([15, 12], abs=1e-6)
    for end, row in ((0, 1), (2, 2)):
        along = blocks.tip[row] - blocks.tip[row - 1]
        assert along @ blocks.axis[end] == pytest.approx(0.0, abs=1e-12)


def test_impeller_against_a_plain_reading_of_its_lines():
    path = shared('linuxcnc-impeller-xyzac')
    program = read(path)
    blocks = program.blocks
    ends = np.flatnonzero(np.diff(blocks.line_number, append=-1))
    at = dict(zip(blocks.line_number[ends].tolist(), ends.tolist(), strict=True))
    position = dict.fromkeys('XYZAC', 0.0)
    before, compared = None, 0
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        if not line.startswith(('G0 ', 'G1 ')):
            continue
        words = {k: float(v) for k, v in re.findall(r'([XYZACF])\s*(-?[\d.]+)', line)}
        position.update({k: v for k, v in words.items() if k != 'F'})
        now = tuple(position.values())
        if now == before:
            assert number not in at
            continue
        before = now
        end = at[number]
        found = [*blocks.tip[end] * 1e3, *np.degrees(blocks.rotary[end])]
        np.testing.assert_allclose(found, now, atol=1e-9)
        pieces = blocks.line_number == number
        if line.startswith('G1'):
            assert blocks.duration[pieces].sum() == pytest.approx(60.0 / words['F'])
        else:
            assert blocks.rapid[pieces].all() and np.isinf(blocks.feedrate[pieces]).all()
        compared += 1
    assert compared == len(ends) and compared > 4000
    np.testing.assert_allclose(np.linalg.norm(blocks.axis, axis=1), 1.0, atol=1e-12)


def test_creo_points_against_a_plain_reading():
    path = shared('creo-finition-ncl')
    joined = path.read_text().replace('$\n', ' ')
    points = np.array(
        [
            [float(word) for word in line.split('/')[1].split(',')]
            for line in joined.splitlines()
            if line.startswith('GOTO')
        ]
    )
    blocks = read(path).blocks
    keep = np.concatenate([[True], (np.abs(np.diff(points, axis=0)) > 0).any(axis=1)])
    np.testing.assert_allclose(blocks.tip, points[keep, :3] * 0.0254, atol=1e-12)
    np.testing.assert_allclose(blocks.axis, points[keep, 3:], atol=1e-9)
    assert blocks.rapid.sum() == joined.count('RAPID\n') - 1 + blocks.rapid[0]
    np.testing.assert_allclose(blocks.feedrate[1:][~blocks.rapid[1:]], 1193.663081 * 0.0254 / 60)


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(path.name, marks=[pytest.mark.thorough] * (path.name in LONG))
        for path in sorted(SHARED.glob('*'))
    ],
)
def test_every_real_program_is_read_or_refused_with_its_line(name):
    machine = Transform.of(Machine.load(MACHINES.get(name, 'xyzac')))
    settings = Settings(feedrate=0.05)
    setup = SETUPS.get(name)
    if name in REFUSED:
        with pytest.raises(ProgramError) as caught:
            read_program(shared(name), machine, settings, setup)
        assert caught.value.word == REFUSED[name]
        assert caught.value.line_number > 0
        return
    blocks = read_program(shared(name), machine, settings, setup).blocks
    for column in ('tip', 'axis', 'contour_tolerance'):
        assert np.isfinite(getattr(blocks, column)).all()
    moving = np.isnan(blocks.feedrate[1:]) != np.isnan(blocks.duration[1:])
    assert moving.all() and blocks.exact_stop[-1]


def test_swivelled_operations_have_the_tool_along_the_frame(monkeypatch):
    """A posted AROT frame and the rotary words before it name the same direction independently."""
    machine = Transform.of(Machine.load('bc_trunnion'))
    seen = []
    go = Mover.go

    def watched(mover, point, rotary, *more, **named):
        if mover.frames.rotated:
            seen.append([*mover.frames.turn[:, 2], *machine.tool_axis(rotary[None])[0]])
        return go(mover, point, rotary, *more, **named)

    monkeypatch.setattr(Mover, 'go', watched)
    read_program(shared('spinner-achskreuz-mpf'), machine, Settings())
    directions = np.array(seen)
    assert len(np.unique(directions[:, :3].round(6), axis=0)) == 5
    np.testing.assert_allclose(directions[:, :3], directions[:, 3:], atol=1e-12)
