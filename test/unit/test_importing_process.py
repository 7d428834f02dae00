"""A process that imports the library keeps its environment, its numba and its toppra."""

import os
import subprocess
import sys
from pathlib import Path

FOREIGN = """
from numba import njit

@njit(cache=True)
def put(part, into):
    into[1:4] = part
"""
#: Plans with the library; foreign kernels are compiled before, meanwhile and after.
ASK = """
import os, sys
import numba, numpy as np
from numba.core import ccallback, cpu
from numba.np import arrayobj
import first

def what_numba_is():
    found = {}
    for name in [name for name in sys.modules if name.partition('.')[0] == 'numba']:
        for key, value in vars(sys.modules[name]).items():
            if callable(value):
                found[name, key] = value
            if isinstance(value, type):
                for inner, kept in vars(value).items():
                    if callable(kept) or isinstance(kept, property):
                        found[name, key, inner] = kept
    return found

first.put(np.ones(3), np.zeros(5))
variables, numba_before = dict(os.environ), what_numba_is()
import cnc_interp
from cnc_interp.core.kernels import njit

@njit()
def ours(part, into):
    into[1:4] = part

ours(np.ones(3), np.zeros(5))
machine = cnc_interp.Machine.load('xyz')
geometry = cnc_interp.Transform.of(machine)
plan = cnc_interp.plan_program(cnc_interp.read_text('G1 X10 F1000\\nX20', '', geometry), machine)
import second
try:
    second.put(np.ones(2), np.zeros(5))
except ValueError as error:
    print(error)
now = what_numba_is()
print([name for name, value in numba_before.items() if now.get(name) is not value])
print(dict(os.environ) == variables, 'matplotlib' in sys.modules)
import cnc_interp.feedrate.backward_pass
import toppra
from toppra.constraint import JointVelocityConstraint
path = toppra.SplineInterpolator([0, 1, 2], [[0.0], [1.0], [3.0]])
limit = JointVelocityConstraint(np.array([[-1.0, 1.0]]))
law = toppra.algorithm.TOPPRA([limit], path, np.linspace(0, 2, 50), 'seidel', 'ParametrizeSpline')
print('algorithm' in dir(toppra), round(law.compute_trajectory().duration))
"""


def test_a_process_that_imports_the_library_stays_as_it_was(tmp_path):
    for name in ('first', 'second'):
        (tmp_path / f'{name}.py').write_text(FOREIGN)
    given = {name: value for name, value in os.environ.items() if 'THREADS' not in name}
    given |= {'PYTHONPATH': os.pathsep.join([str(tmp_path), str(Path.cwd())])}
    done = subprocess.run(
        [sys.executable, '-c', ASK], env=given, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.stdout.splitlines() == [
        'cannot assign slice of shape (3,) from input of shape (2,)',
        '[]',
        'True False',
        'True 3',
    ], done.stderr
    kept = {file.name.partition('.')[0] for file in (tmp_path / '__pycache__').glob('*.nbi')}
    assert kept == {'first', 'second'}
