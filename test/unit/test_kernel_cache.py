"""Compiled kernels never outlive a change of any kernel they call."""

import os
import subprocess
import sys
from pathlib import Path

from cnc_interp.core import kernel_cache

INNER = 'from numba import njit\n\n@njit(cache=True)\ndef inner():\n    return {value}\n'
OUTER = (
    'from numba import njit\nfrom pack.inner import inner\n\n'
    '@njit(cache=True)\ndef outer():\n    return inner()\n'
)
START = (
    'import os\nfrom pathlib import Path\nfrom cnc_interp import kernel_cache\n'
    "os.environ.pop('NUMBA_CACHE_DIR', None)\n"
    'kernel_cache.choose(Path(__file__).parent, os.environ)\n'
)


def result(folder):
    """What the outer kernel says in a fresh process."""
    code = 'from pack.outer import outer; print(outer())'
    here = str(Path(kernel_cache.__file__).parents[1])
    environment = {
        **os.environ,
        'PYTHONPATH': os.pathsep.join([str(folder), here]),
        'PYTHONDONTWRITEBYTECODE': '1',  # Python itself misses a change within the same second
    }
    done = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def test_a_change_in_a_called_kernel_reaches_its_caller(tmp_path):
    package = tmp_path / 'pack'
    package.mkdir()
    (package / '__init__.py').write_text(START)
    (package / 'outer.py').write_text(OUTER)
    for value in (1, 2):
        (package / 'inner.py').write_text(INNER.format(value=value))
        assert result(tmp_path) == value
    folders = list((package / '__pycache__').glob(kernel_cache.PREFIX + '*'))
    assert len(folders) == 1, 'kernels of older sources are removed'


def test_the_users_choice_wins(tmp_path):
    environment = {'NUMBA_CACHE_DIR': 'mine'}
    kernel_cache.choose(tmp_path, environment)
    assert environment == {'NUMBA_CACHE_DIR': 'mine'}


def test_other_sources_do_not_matter(tmp_path):
    (tmp_path / 'kernel.py').write_text(INNER.format(value=1))
    before = kernel_cache.fingerprint(tmp_path)
    (tmp_path / 'plain.py').write_text('x = 1\n')
    assert kernel_cache.fingerprint(tmp_path) == before
    (tmp_path / 'kernel.py').write_text(INNER.format(value=2))
    assert kernel_cache.fingerprint(tmp_path) != before
