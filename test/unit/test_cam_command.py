"""The cam commands: from a surface to executed motion, and one line for what does not fit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.make_program import across
from cnc_interp.cam.nbuffer import cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.shapes import Bumps
from cnc_interp.cam.simulation import Motion, cross_sections, programmed, thinned
from cnc_interp.cam.strategies import STRATEGIES, Strategy, StrategyOption
from cnc_interp.cam.surface import Placed
from cnc_interp.cam.surface_file import read_part
from cnc_interp.commands import cli
from cnc_interp.commands.cli import main, parser
from cnc_interp.commands.parser import BAD_INPUT, FINE
from cnc_interp.core import DEG, MM, UM
from cnc_interp.machine.simulated_drives import simulate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_program
from cnc_interp.settings.options import Settings

thorough = pytest.mark.thorough
EXAMPLES = Path(__file__).parents[2] / 'examples'

SURFACE = {
    'kind': 'bumps',
    'size_mm': [16, 12],
    'bumps_mm': [[0, 0, 0.5, 8]],
    'placement': {'rotation_deg': [25, 0, 0]},
}


TILTED = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, np.cos(25 * DEG), -np.sin(25 * DEG)],
        [0.0, np.sin(25 * DEG), np.cos(25 * DEG)],
    ]
)
MILL = Cutter(5 * MM, 1.5 * MM)
NEEDLES = Needles.on(
    Placed(Bumps((16 * MM, 12 * MM), [(0, 0, 0.5 * MM, 8 * MM)]), TILTED, np.zeros(3)),
    0.3 * MM,
    1 * MM,
)


@pytest.fixture
def surface(tmp_path):
    file = tmp_path / 'surface.json'
    file.write_text(json.dumps(SURFACE))
    return file


def test_from_a_surface_to_the_executed_surface(surface, tmp_path, capsys):
    out = tmp_path / 'out'
    arguments = ['--stepover', '2', '--run', '--spacing', '0.5', '--json', '--out', str(out)]
    assert main(['cam', 'iso-scallop', str(surface), *arguments]) == FINE
    summary = json.loads(capsys.readouterr().out)
    assert summary['passes'] >= 6 and summary['cycle_time'] > 1.0
    for motion in ('programmed', 'planned', 'executed'):
        assert summary[motion]['uncut'] == 0.0
        assert summary[motion]['lowest'] > -2.5e-6 and summary[motion]['highest'] < 13e-6
        assert summary[motion]['ridge_50'] == pytest.approx(10e-6, rel=0.05)
    assert (out / 'cam.html').stat().st_size > 1e6
    assert main(['check', str(out / 'plan')]) == FINE
    capsys.readouterr()
    for motion in (out / 'program.mpf', out / 'plan'):
        cut = ['--surface', str(surface), '--spacing', '0.5', '--json']
        assert main(['cam', 'simulate', str(motion), *cut]) == FINE
        (found,) = json.loads(capsys.readouterr().out).values()
        assert found['highest'] < 13e-6 and found['uncut'] == 0.0


@pytest.mark.thorough
def test_all_formats_hold_the_same_path(surface, tmp_path, capsys):
    motions = {}
    for form, suffix in (('spline', 'mpf'), ('cl', 'apt'), ('gcode', 'ngc')):
        arguments = ['--stepover', '2', '--format', form, '--chord', '0.1', '--json']
        command = ['cam', 'iso-scallop', str(surface), *arguments, '--out', str(tmp_path / form)]
        assert main(command) == FINE
        machine = Transform.of(Machine.load('xyzac'))
        reading = Settings(contour_tolerance=1 * UM)
        motion = programmed(read_program(tmp_path / form / f'program.{suffix}', machine, reading))
        motions[form] = cut_needles(NEEDLES, MILL, motion.tip, motion.axis).height
    capsys.readouterr()
    for form in ('cl', 'gcode'):
        np.testing.assert_allclose(motions[form], motions['spline'], atol=0.3 * UM)


@thorough
def test_no_ridge_is_higher_than_promised(tmp_path, capsys):
    """Setpoints, also through the drives, cut by the N-buffer; the drives need a reserve."""
    machine, hollow, highest = Machine.load('xyzac'), EXAMPLES / 'hollow.json', {}
    face = read_part(hollow).surfaces[1]
    for name, more in (('cl', ['--format', 'cl']), ('', []), ('reserve', ['--reserve', '0.15'])):
        out = tmp_path / (name or 'spline')
        command = ['cam', 'iso-scallop', str(hollow), '--stepover', '5', '--run', *more, '--json']
        assert main([*command, '--spacing', '1', '--out', str(out)]) == FINE
        assert ('--reserve 0.15 lowers' in capsys.readouterr().err) == (not name)
        rows = np.load(out / 'plan' / 'setpoints.npz')
        drives = simulate(machine, 1e-3, rows['position'], rows['velocity'])
        poses = Transform.of(machine).forward(rows['position']), (drives.tip, drives.axis)
        for motion, (tip, axis) in zip(('planned', 'executed'), poses, strict=True):
            cut = cross_sections(
                face, MILL, thinned(Motion('', tip, axis)), across(face, 0.0), 2 * MM
            )
            highest[name, motion] = cut.ridges.max() / UM
    assert 9.9 < highest['', 'planned'] < 10.02 and 9.7 < highest['cl', 'planned'] < 10.02
    assert highest['', 'executed'] > 10.05
    assert 9.8 < highest['reserve', 'executed'] < 10.02


@pytest.mark.parametrize(
    'words', ['iso-scallop x.json --out x', 'simulate x.mpf --surface x.json']
)
def test_mill_and_scallop_are_those_of_the_paper_unless_given(words):
    options = parser().parse_args(['cam', *words.split()])
    assert (options.tool_diameter, options.corner_radius, options.scallop) == (13.0, 1.5, 10.0)


def rates_about_the_pole(program):
    """Speed of C along the cutting moves of a program at the programmed feed, over its largest."""
    machine = Machine.load('xyzac')
    motion = programmed(read_program(program, Transform.of(machine), Settings()))
    azimuth = np.arctan2(motion.axis[:, 0], motion.axis[:, 1])
    turned = np.abs((np.diff(azimuth) + np.pi) % (2.0 * np.pi) - np.pi)
    way = np.linalg.norm(np.diff(motion.tip, axis=0), axis=1)
    tilted = np.hypot(motion.axis[:, 0], motion.axis[:, 1]) > 1e-3
    moves = tilted[1:] & tilted[:-1] & (way > 1e-6) & (way < 0.5 * MM)  # links are longer
    return turned[moves] / (way[moves] / (50 * MM)) / machine.max_velocity[4]


@pytest.mark.thorough
def test_passes_beside_the_pole_are_told_with_the_turn_that_avoids_it(tmp_path, capsys):
    """The face of examples/bumps.json lies flat here; then it is turned as told."""
    face = json.loads((EXAMPLES / 'bumps.json').read_text())

    def made(turn):
        face['placement'] = {'rotation_deg': turn}
        (tmp_path / 'face.json').write_text(json.dumps(face))
        out = tmp_path / f'{sum(turn):g}'
        command = ['cam', 'iso-scallop', str(tmp_path / 'face.json'), '--stepover', '2']
        assert main([*command, '--format', 'cl', '--out', str(out)]) == FINE
        summary = json.loads((out / 'summary.json').read_text())
        return rates_about_the_pole(out / 'program.apt').max(), summary, capsys.readouterr().out

    fastest, summary, said = made([0.0, 0.0, 0.0])
    told = summary['pole']
    assert told['axis'] == 'C' and told['passes'] >= 10 and told['rate'] > 100.0
    assert fastest > 20.0
    angle = round(np.degrees(told['angle']))
    assert f'turn the workpiece by {angle} deg about {told["about"]}' in said
    assert 1 <= abs(angle) <= 15
    fastest, summary, said = made([angle * (told['about'] == name) for name in 'XYZ'])
    assert fastest <= 1.02 and 'pole' not in summary and 'near the pole' not in said


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (['--stepover', '0.4'], 'too narrow'),
        (['--stepover', '9'], 'too wide'),
        (['--corner-radius', '7'], 'a corner radius of 7 mm does not fit a diameter of 13 mm'),
        (['--corner-radius', '6.5'], 'ball mill'),
        (['--tilt', '80'], 'do not make sense'),
        (['--points', '2'], 'too few'),
        (['--reserve', '10'], '--scallop must be larger than --reserve'),
    ],
)
def test_what_does_not_fit_gets_one_line(arguments, says, surface, tmp_path, capsys):
    out = tmp_path / 'out'
    command = ['cam', 'iso-scallop', str(surface), '--out', str(out), *arguments]
    assert main(command) == BAD_INPUT
    error = capsys.readouterr().err
    assert says in error and error.count('\n') == 1
    assert not out.exists()


def test_a_strategy_is_its_own_code_and_a_row(surface, tmp_path, capsys, monkeypatch):
    """Command line, program, summary and text follow from the row."""
    asked = []

    def passes(face, cutter, normal, wanted, show):
        asked.append(wanted.choices)
        planes = STRATEGIES['planes']
        usual = {option.name.replace('-', '_'): option.default for option in planes.options}
        steep = replace(wanted, choices=planes.choices(usual | {'tilt': 6.0}))
        return planes.passes(face, cutter, normal, steep, show)

    row = Strategy(
        'steep',
        'with a steep mill',
        (StrategyOption('lead', 'its lead (4 deg)', 4.0, 'DEG', DEG, positive=True),),
        passes,
        facts=lambda paths: {'steep_passes': len(paths.passes)},
        words=lambda facts: [f'steep passes   {facts["steep_passes"]}'],
    )
    monkeypatch.setitem(STRATEGIES, 'steep', row)
    monkeypatch.setattr(cli, 'parser', parser.__wrapped__)
    words = ['--strategy', 'steep', '--lead', '6', '--tool-diameter', '13']
    assert main(['cam', 'iso-scallop', str(surface), '--out', str(tmp_path), *words]) == FINE
    found = json.loads((tmp_path / 'summary.json').read_text())
    assert asked == [{'lead': pytest.approx(6 * DEG)}]
    assert found['strategy'] == 'steep' and found['steep_passes'] == found['passes'] > 2
    assert f'steep passes   {found["passes"]}' in capsys.readouterr().out
