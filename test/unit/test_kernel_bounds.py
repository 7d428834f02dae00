"""Kernels with checked bounds: compiled code does not notice an index beyond its array."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
#: Tests that pass through most kernels of clearances and stock, and need no others.
SHARE = (
    'test_collision.py::test_nothing_is_missed_and_nothing_is_false_near_the_clearance',
    'test_collision.py::test_a_mesh_decides_as_its_triangles_do',
    'test_stock.py::test_a_bore_has_its_volume',
    'test_stock.py::test_a_tilted_mill_leaves_its_tilted_slot',
)


@pytest.mark.thorough
def test_no_kernel_goes_beyond_its_arrays(tmp_path):
    checked = {'NUMBA_BOUNDSCHECK': '1', 'NUMBA_CACHE_DIR': str(tmp_path)}
    words = [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider']
    words += ['--override-ini=addopts=', *(str(HERE / name) for name in SHARE)]
    run = subprocess.run(
        words, env=os.environ | checked, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout[-4000:]
    assert f'{len(SHARE)} passed' in run.stdout
