"""Every input that broke us, and what it must do: the table is cases.yaml."""

import io
import json
import resource
import subprocess
import sys
import tempfile
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from cnc_interp.commands.cli import BAD_INPUT, FINE, main
from cnc_interp.core import DEG, MM
from cnc_interp.machine_model.machine import Machine

HERE = Path(__file__).parent
OWN, SHARED = HERE / 'inputs', HERE.parents[2] / 'shared' / 'cases'
CASES = yaml.safe_load((HERE / 'cases.yaml').read_text())['cases']
#: Cycle times and positions agree to the digits of the table.
SECONDS, MILLIMETRES, DEGREES = 1e-3, 0.011, 0.01
#: Corners between lines are rounded [mm, deg].
ROUNDED = 0.5


@dataclass
class Outcome:
    """What a command did with an input: exit code, error text, and the figures of its plan."""

    code: int
    error: str
    proven: bool = False
    seconds: float = np.inf
    #: First, last, smallest and largest position of each axis [mm, deg].
    first: dict[str, float] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    swing: dict[str, float] = field(default_factory=dict)
    #: Position of each axis at the last setpoint of each line [mm, deg].
    ends: dict[int, dict[str, float]] = field(default_factory=dict)
    #: Last position of the tool tip [mm].
    tip: tuple[float, ...] = ()


def where(name):
    """Find an input in the folder of this test or in ../shared/cases."""
    found = next((folder / name for folder in (OWN, SHARED) if (folder / name).exists()), None)
    if found is None:
        pytest.skip('needs ../shared/cases')
    return found


def arguments_of(case, machine, folder):
    """Words of the command, without --out."""
    program = where(case['input'])
    if 'generate' in case:
        made = Path(folder) / f'{program.stem}.ngc'
        subprocess.run([sys.executable, program, *case['generate'], made], check=True)
        program = made
    named = ['--machine', machine] if machine else []
    options = [str(where(w)) if w.endswith('.yaml') else w for w in case.get('options', [])]
    return [*case.get('command', ['plan']), str(program), *named, *options]


def said(arguments):
    """Exit code of a command, and what it wrote to the terminal as an error."""
    error = io.StringIO()
    with redirect_stderr(error), redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter('error', RuntimeWarning)
        return main(arguments), error.getvalue()


@cache
def outcome(number, machine):
    """Do once what a row of the table says, for all that is expected of it."""
    case = CASES[number]
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / 'plan'
        code, error = said([*arguments_of(case, machine, folder), '--out', str(plan)])
        if code != FINE or 'command' in case:
            return Outcome(code, error, proven=code == FINE)
        summary = json.loads((plan / 'summary.json').read_text())
        with np.load(plan / 'setpoints.npz') as setpoints, np.load(plan / 'path.npz') as path:
            q, block, tip = setpoints['position'], setpoints['block'], path['tip'][-1] / MM
        with np.load(plan / 'blocks.npz') as blocks:
            line = blocks['line'][block]
        names = Machine.load(machine).axis_names
        q = q / [DEG if name in 'ABC' else MM for name in names]
        return Outcome(
            code,
            error,
            said(['check', str(plan)])[0] == FINE,
            summary['cycle_time'],
            dict(zip(names, q[0])),
            dict(zip(names, q[-1])),
            dict(zip(names, np.ptp(q, axis=0))),
            {int(n): dict(zip(names, q[line == n][-1])) for n in np.unique(line)},
            tuple(tip),
        )


def near(axis):
    return DEGREES if axis in 'ABC' else MILLIMETRES


#: Runs a command and prints the most memory of its own process. What the system says of a child
#: that has ended counts the process from which it was forked, too.
MEASURED = """
import sys
from cnc_interp.commands.cli import main
code = main(sys.argv[1:])
print(next(line for line in open('/proc/self/status') if line.startswith('VmHWM')))
sys.exit(code)
"""


def largest_memory(case, machine, folder):
    """Largest memory of the command as a process of its own [MB]; it may not take 6 GB."""
    words = [*arguments_of(case, machine, folder), '--out', str(folder)]
    done = subprocess.run(
        [sys.executable, '-c', MEASURED, *words],
        check=True,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30)),
    )
    return int(done.stdout.split()[-2]) / 1024


def expect(number, machine, wanted):
    """Compare what a row of the table expects with what happens."""
    if 'memory' in wanted:
        with tempfile.TemporaryDirectory() as folder:
            assert largest_memory(CASES[number], machine, folder) <= wanted['memory']
        return
    found = outcome(number, machine)
    if 'refused' in wanted:
        told = [line for line in found.error.splitlines() if not line.startswith('note: ')]
        wanted_lines = wanted['refused']
        wanted_lines = [wanted_lines] if isinstance(wanted_lines, str) else wanted_lines
        assert found.code == BAD_INPUT and len(told) == len(wanted_lines)
        assert all(words in line for words, line in zip(wanted_lines, told))
        return
    assert found.code == FINE, found.error
    assert found.proven
    assert found.seconds <= wanted.get('seconds', np.inf) * (1 + SECONDS)
    for axis, way in wanted.get('moves', {}).items():
        assert abs(found.last[axis] - found.first[axis] - way) < near(axis), axis
    for line, axes in wanted.get('lines', {}).items():
        for axis, way in axes.items():
            assert abs(found.ends[line][axis] - found.first[axis] - way) < ROUNDED, axis
    for axis, way in wanted.get('swings', {}).items():
        assert abs(found.swing[axis] - way) < near(axis), axis
    if 'tip' in wanted:
        assert np.abs(np.subtract(found.tip, wanted['tip'])).max() < MILLIMETRES


def rows():
    """All expectations of the table, those of open faults as expected failures."""
    for number, case in enumerate(CASES):
        machines = case.get('machines', ['xyzac'])
        for machine in machines:
            for kind in ('today', 'must'):
                if kind not in case:
                    continue
                by_turns = case.get('thorough') or machine != machines[0]
                marks = [pytest.mark.thorough] if by_turns else []
                if kind == 'must':
                    marks.append(pytest.mark.xfail(reason=case['fault'], strict=True))
                words = [case['input'], machine, *case.get('options', []), kind]
                name = ' '.join(word for word in words if word)
                yield pytest.param(number, machine, case[kind], marks=marks, id=name)


@pytest.mark.parametrize(('number', 'machine', 'wanted'), list(rows()))
def test_inputs_that_broke_us(number, machine, wanted):
    expect(number, machine, wanted)


def test_every_input_is_in_the_table():
    known = {name for case in CASES for name in (case['input'], *case.get('options', []))}
    groups = {Path(case['input']).parent for case in CASES}
    files = {
        path.relative_to(folder)
        for folder in (OWN, SHARED)
        for path in folder.rglob('*')
        if path.is_file() and path.name != 'README.md'
    }
    missing = {path for path in files if path.parent in groups} - set(map(Path, known))
    assert not missing, missing
