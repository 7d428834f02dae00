"""The command line as its users meet it: words, exit codes, files, and one line per mistake."""

import errno
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cnc_interp
from cnc_interp.commands.cli import main, parser
from cnc_interp.commands.parser import BAD_INPUT, FAILED, FINE
from cnc_interp.core import BlockError
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.text.code_tables import NO_SPINDLE
from cnc_interp.run import planning_chain
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.plan_figures import ToleranceUse
from cnc_interp.run.plan_writer import PlanWriter
from cnc_interp.settings.options import Settings

EXAMPLES = Path(__file__).parents[2] / 'examples'
TCP = 'TRAORI\nG90 G94\nG1 X0 Y0 Z0 A10 C0 F1000\n'


def test_plan_check_and_report_of_the_pyramid(tmp_path, capsys):
    plan = tmp_path / 'plan'
    assert main(['plan', str(EXAMPLES / 'pyramid.apt'), '--out', str(plan)]) == FINE
    assert 'cycle time' in capsys.readouterr().out
    assert main(['check', str(plan)]) == FINE
    assert capsys.readouterr().out.rstrip().endswith('proven')
    assert main(['report', str(plan)]) == FINE
    assert (plan / 'report.html').stat().st_size > 1e6
    summary = json.loads((plan / 'summary.json').read_text())
    setpoints, path = np.load(plan / 'setpoints.npz'), np.load(plan / 'path.npz')
    assert summary['blocks'] == 4 and summary['samples'] == len(setpoints['time'])
    assert path['cell_left'].shape == (4, len(path['s']) - 1, 5)
    for name in ('velocity', 'acceleration', 'jerk'):
        assert max(summary['largest_use'][name].values()) <= 1.0
    for name in ('velocity', 'acceleration'):
        assert setpoints[name].shape == setpoints['position'].shape


def test_examples_that_helps_name_are_found_from_everywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for own in (False, True):
        found = parser().parse_args(['plan', 'examples/pyramid.apt', '--out', 'x']).program
        assert found == (Path('examples/pyramid.apt') if own else EXAMPLES / 'pyramid.apt')
        (tmp_path / 'examples').mkdir(exist_ok=True)
        (tmp_path / 'examples' / 'pyramid.apt').touch()
    assert parser().parse_args(['plan', 'examples/no', '--out', 'x']).program == Path(
        'examples/no'
    )


def test_shells_and_the_man_page_know_every_command(capsys):
    (commands,) = (a.choices for a in parser()._actions if isinstance(a.choices, dict))
    for kind in ('man', 'zsh', 'bash'):
        assert main(['completion', kind]) == FINE
        printed = capsys.readouterr().out
        plain = printed.replace('\\', '')
        assert '--contour-tolerance' in plain and all(name in plain for name in commands)
    script = f'{printed}\nCOMP_WORDS=(cnc-interp swe) COMP_CWORD=1\n'
    script += '_shtab_cnc_interp; echo "${COMPREPLY[@]}"'
    done = subprocess.run(['bash', '-c', script], capture_output=True, text=True)
    assert done.stdout == 'sweep\n', done.stderr


def test_version_tells_the_commit(capsys):
    with pytest.raises(SystemExit):
        main(['--version'])
    git = ['git', 'describe', '--always', '--dirty=+', '--exclude=*']
    commit = subprocess.run(git, cwd=EXAMPLES, capture_output=True, text=True).stdout
    assert (
        capsys.readouterr().out == f'cnc-interp {cnc_interp.__version__} {commit}'.rstrip() + '\n'
    )


def test_a_plan_over_a_limit_is_not_proven_and_fails(tmp_path, capsys, monkeypatch):
    program = str(EXAMPLES / 'pyramid.apt')
    assert main(['plan', program, '--out', str(tmp_path)]) == FINE
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith('proven  ') and str(tmp_path) in last
    # The figures are taken with lower limits than the motion was planned with.
    machine = Machine.load('xyzac')
    lower = machine.having(max_jerk=machine.max_jerk * [0.8, 1, 1, 1, 1])
    monkeypatch.setattr(
        planning_chain,
        'PlanWriter',
        lambda folder, _, settings: PlanWriter(folder, lower, settings),
    )
    assert main(['plan', program, '--out', str(tmp_path)]) == FAILED
    last = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(r'NOT proven +jerk of X 12\d\.\d\d%', last)


def test_segments_that_leave_their_tolerance_are_refused():
    text = 'G0 X0\nG64 P0.02\nG1 X10 F3000\nG64 P0.01\nY10\nX0\nY0'
    transform = Transform.of(Machine.load('xyzac'))
    blocks = read_text(text, 'a.ngc', transform, Settings()).blocks
    segments = segments_of(blocks, transform, Settings())
    use = ToleranceUse()
    use.blocks(blocks)
    for first in range(len(segments)):  # also in parts, of which some are empty
        use.require(segments[first:first])
        use.require(segments[first : first + 1])
    assert 0.9 < use.largest[0] < 1.0 + 1e-9
    last = segments.deviation[:, 0] == segments.deviation[segments.block[:, 1] >= 3, 0].max()
    spoilt = segments.deviation * np.where(last, 1.1, 1.0)[:, None]
    use = ToleranceUse()
    use.blocks(blocks)
    with pytest.raises(BlockError, match=r'line \d: .* contour tolerance: 1[01].* um of 10 um'):
        use.require(replace(segments, deviation=spoilt))


def test_a_tool_axis_beside_the_pole_is_refused_where_the_tolerance_does_not_reach_it(
    tmp_path, capsys
):
    file = tmp_path / 'pole.apt'
    file.write_text('FEDRAT/3000,MMPM\nGOTO/0,0,0,.0001,.2,.9798\nGOTO/30,0,0,.0001,-.2,.9798\n')
    words = ['plan', str(file), '--out', str(tmp_path), '--orientation-tolerance', '0.001']
    assert main(words) == BAD_INPUT
    assert ':3: the turning tool axis comes closer than 0.02 deg' in capsys.readouterr().err
    assert main(words[:4]) == FINE, 'with more of it the path is moved through the pole'


def test_check_of_a_spoilt_plan_fails(tmp_path, capsys):
    assert main(['plan', str(EXAMPLES / 'pyramid.apt'), '--out', str(tmp_path)]) == FINE
    setpoints = dict(np.load(tmp_path / 'setpoints.npz'))
    setpoints['position'][500, 1] += 1e-6
    np.savez(tmp_path / 'setpoints.npz', **setpoints)
    assert main(['check', str(tmp_path)]) == FAILED
    assert 'NOT proven' in capsys.readouterr().out


@pytest.mark.parametrize(
    'way',
    [
        ['--parametrization', 'paper'],
        ['--top', 'tolerance', '--septic'],
        ['--corner', 'paper'],
        ['--corner', 'paper', '--parametrization', 'linear', '--ratio', '1.75'],
    ],
)
def test_other_ways_to_make_corners_are_proven_too(way, tmp_path):
    program = str(EXAMPLES / 'pyramid.apt')
    assert main(['plan', program, '--out', str(tmp_path), *way]) == FINE
    assert main(['check', str(tmp_path)]) == FINE


def test_a_machine_of_ones_own_is_found_again_by_check(tmp_path, capsys):
    file = tmp_path / 'mine.yaml'
    text = find_machine_file('xyzac').read_text().replace('name: xyzac', 'name: mine')
    file.write_text(text.replace('jerk_m_per_s3: 5.0', 'jerk_m_per_s3: 2.0'))
    out = tmp_path / 'plan'
    program = str(EXAMPLES / 'pyramid.apt')
    assert main(['plan', program, '--machine', str(file), '--out', str(out)]) == FINE
    assert main(['check', str(out)]) == FINE
    assert 'machine mine' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('name', 'text', 'says'),
    [
        ('no_feed.ngc', 'G90\nG1 X0\nG1 X10\n', ':3: no feedrate (F)'),
        ('arc.ngc', 'F1000\nG1 X0 Y0\nG2 X10 I4\n', ':3: G2: start and end differ'),
        ('letter.ngc', 'F1000\nG1 X0\nG1 X1O\n', ':3: O: a letter without a number'),
        ('zero.ngc', 'F1000\nGO X0\n', ':2: GO: the letter O where a digit is expected'),
        ('comma.ngc', 'F1000\nG1 X0\nG1 X30,5\n', ':3: ,5: a decimal comma; write a point'),
        ('binary.ngc', 'G1\x01\x02\x03' * 200 + '\n' * 9, ': this is not text'),
        (
            'endless.ngc',
            'F1000\no1 while [1]\nG1 X1\nX0\no1 endwhile\nM2\n',
            ':5: this loop does not',
        ),
        (
            'resets.ngc',
            '#1=0\nwhile [1 EQ 1] DO1\n#1=[#1+1]\nIF [#1 GT 5] THEN #1=0\nEND1\nM2\n',
            ':5: this loop does not end',
        ),
        ('word.ngc', 'F1000\nG1 X0\nG1 X10 Q2\n', ':3: Q2: this word has no meaning'),
        ('tcp.nc', 'F1000\nG0 A5\nM428\nG0 G53 Z0\n', ':4: machine coordinates with tool-tip'),
        ('axis.apt', 'GOTO/0,0,0,0,0,1\nGOTO/9,0,0,0,0,0\n', ':2: GOTO: the tool axis is not'),
        ('travel.ngc', TCP + 'G1 X900\n', ':4: axis X would have to go to 940.000 mm'),
        ('feed.ngc', 'F-100\nG1 X0\nG1 X10\n', ':1: F-100: the feedrate must be greater'),
        ('tolerance.ngc', 'F1000\nG64 P-1\nG1 X0\nG1 X1\n', ':2: P-1: the tolerance must be'),
        ('empty.ngc', '', ': no motion found'),
        ('still.ngc', 'F1000\nG1 X0\n', ': holds no motion'),
    ],
)
def test_wrong_program_gets_one_line_with_file_and_line(name, text, says, tmp_path, capsys):
    file = tmp_path / name
    file.write_text(text)
    assert main(['plan', str(file), '--out', str(tmp_path / 'out')]) == BAD_INPUT
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and error.startswith(f'cnc-interp: {file}{says}')
    assert not (tmp_path / 'out').exists()


def test_an_unknown_option_gets_the_one_that_is_near(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(['plan', str(EXAMPLES / 'pyramid.apt'), '--out', str(tmp_path), '--fed=9'])
    error = capsys.readouterr().err
    assert (ended.value.code, error.count('\n')) == (BAD_INPUT, 1)
    assert 'unknown option --fed; did you mean --feed?' in error


def test_a_full_disk_is_named(tmp_path, capsys, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('cnc_interp.run.planning_chain.plan_to_files', full)
    out = str(tmp_path / 'plan')
    assert main(['plan', str(EXAMPLES / 'pyramid.apt'), '--out', out]) == BAD_INPUT
    assert capsys.readouterr().err == f'cnc-interp: {out}: No space left on device\n'


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path, capsys):
    (file := tmp_path / 'file').write_text('')
    for out in (file, file / 'plan'):
        assert main(['plan', str(EXAMPLES / 'pyramid.apt'), '--out', str(out)]) == BAD_INPUT
        assert capsys.readouterr().err == (
            f'cnc-interp: {file}: this is a file where a folder is needed; name another folder\n'
        )


def test_a_spindle_that_does_not_turn_is_a_warning(tmp_path, capsys):
    for name, text in (
        ('a.ngc', 'G21 M3 S900\nG1 X1 F9\nX0\n'),
        ('a.apt', 'SPINDL/RPM,900,CLW\nFEDRAT/9\nGOTO/0,0,0\nGOTO/1,0,0\nGOTO/0,0,0\nFINI\n'),
    ):
        (tmp_path / name).write_text(text)
        main(['plan', str(tmp_path / name), '--out', str(tmp_path / 'plan')])
        said = capsys.readouterr().err.splitlines()
        assert said[-1].endswith(NO_SPINDLE) and not said[-1].startswith('note')


def test_a_tolerance_that_does_not_count_is_told(tmp_path, capsys):
    file, out = tmp_path / 'part.ngc', str(tmp_path / 'out')
    file.write_text('G21 G90\nG64 P0.02\nG1 X0 F1000\nX5\nY5\nM2\n')
    for words, count in (([], 0), (['--contour-tolerance', '0.05'], 1)):
        assert main(['plan', str(file), '--out', out, *words]) == FINE
        assert capsys.readouterr().err.count('note: line 2: G64 P: the program') == count


def test_missing_things_get_one_line(tmp_path, capsys):
    program = str(EXAMPLES / 'pyramid.apt')
    blocked = tmp_path / 'file'
    blocked.write_text('')
    for arguments, says in (
        (['plan', 'nowhere.ngc', '--out', str(tmp_path)], 'nowhere.ngc: cannot be opened'),
        (['plan', program, '--machine', 'hermle', '--out', str(tmp_path)], "no machine 'hermle'"),
        (['plan', program, '--out', str(blocked / 'plan')], 'this is a file where'),
        (['check', str(tmp_path)], 'summary.json: cannot be read'),
        (['report', str(tmp_path)], 'summary.json: cannot be read'),
    ):
        assert main(arguments) == BAD_INPUT
        error = capsys.readouterr().err
        assert says in error and error.count('\n') == 1


def test_a_package_that_is_missing_is_named_in_one_line():
    """A wheel without ROS plans and checks; what needs ROS said so in a traceback."""
    without = "import sys; sys.modules['rclpy'] = None; from cnc_interp.commands.cli import main; "
    run = [sys.executable, '-c', without + "sys.exit(main(['jog', 'X', '1']))"]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.count('\n') == 1
    assert done.stderr.startswith('cnc-interp: rclpy is not installed')


def test_help_needs_neither_compiler_nor_solver():
    """Numba and what compiles with it took half of the time until the help was there."""
    script = (
        'import sys\nfrom cnc_interp.commands.cli import main\n'
        'try: main(["--help"])\nexcept SystemExit: pass\n'
        'print([name for name in ("numba", "scipy", "rclpy") if name in sys.modules])'
    )
    run = [sys.executable, '-c', script]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == '[]'


def test_folders_of_what_is_written_are_made(tmp_path, capsys):
    """Before the work: a fit of a minute is not lost at its end."""
    out = tmp_path / 'new' / 'folder' / 'excite.ngc'
    assert main(['excite', '--machine', 'xyzac_tired', '--out', str(out)]) == 0
    assert out.read_text().startswith('(')
    (tmp_path / 'file').write_text('')
    words = ['identify', str(tmp_path / 'bag'), '--out', str(tmp_path / 'file' / 'm.yaml')]
    assert main(words) == 2
    told = capsys.readouterr().err
    assert 'this is a file where a folder is needed' in told and told.count('\n') == 1


def test_the_model_of_another_machine_compensates_nothing():
    from cnc_interp.core import MachineError
    from cnc_interp.drives.compensation import compensated_model
    from cnc_interp.machine_model.machine import Machine

    machine = Machine.load('xyzac')
    assert compensated_model('xyzac_tired', machine).name == 'xyzac_tired'
    with pytest.raises(MachineError, match='the model of another machine'):
        compensated_model('xyzac_trt', machine)
