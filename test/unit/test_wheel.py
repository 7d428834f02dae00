"""The wheel of the source package runs beside nothing: no checkout, no compiler, no git.

So goes the way of a student who has a feed law and a wheel (docs/library.md).
"""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import cnc_interp
from cnc_interp import kernel_cache

ROOT = Path(__file__).parents[2]


def told(*command, cwd, **variables):
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={'HOME': str(cwd), **variables},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_a_wheel_plans_proves_and_compares_laws_where_nothing_else_is(tmp_path):
    path = {'PATH': os.environ['PATH']}
    told(sys.executable, 'setup.py', '-q', 'sdist', '-d', tmp_path, cwd=ROOT, **path)
    (source,) = tmp_path.glob('*.tar.gz')
    pip = 'pip', '--disable-pip-version-check', '-q'
    wheel = *pip, 'wheel', '--no-deps', '--no-build-isolation', '-w', tmp_path, source
    told(sys.executable, '-m', *wheel, cwd=tmp_path, **path)
    (made,) = tmp_path.glob('*.whl')
    told(sys.executable, '-m', 'venv', 'own', cwd=tmp_path, **path)
    own = tmp_path / 'own' / 'bin' / 'python'
    told(own, '-m', *pip, 'install', '--no-index', '--no-deps', made, cwd=tmp_path)
    (site,) = (tmp_path / 'own' / 'lib').glob('python*/site-packages')
    # What it depends on comes from here; the checkout is reached by a .pth file there, so not.
    (site / 'others.pth').write_text(sysconfig.get_path('purelib'))
    bare = {'PATH': str(own.parent), kernel_cache.FOLDER: str(kernel_cache.folder())}
    place = told(own, '-c', 'import cnc_interp; print(cnc_interp.__file__)', cwd=tmp_path, **bare)
    assert Path(place.strip()).parent == site / 'cnc_interp'

    def run(*words):
        return told(own.parent / 'cnc-interp', *words, cwd=tmp_path, **bare)

    git = ['git', 'describe', '--always', '--dirty=+', '--exclude=*']
    commit = subprocess.run(git, cwd=ROOT, capture_output=True, text=True).stdout
    assert run('--version').split() == ['cnc-interp', cnc_interp.__version__, *commit.split()]
    (tmp_path / 'part.ngc').write_text('G1 X0 Y0 F1000\nX20\nY10\n')
    assert 'proven  ' in run('plan', 'part.ngc', '--machine', 'xyz', '--out', 'plan')
    assert 'proven' in run('check', 'plan')
    assert 'complete -o' in run('completion', 'bash')
    assert run('completion', 'man').startswith('.TH CNC')
    law = site.parents[2] / 'share' / 'cnc_interp' / 'examples' / '13_feed_law.py'
    assert told(own, law, cwd=tmp_path, **bare).count(' times the optimum') == 3
