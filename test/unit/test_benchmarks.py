"""Benchmarks are there for a page that cites them, and run in small."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ALL = runpy.run_path(str(ROOT / 'benchmarks' / 'all.py'))['ALL']


def test_each_benchmark_is_cited_by_its_page():
    for one in ALL:
        assert (ROOT / 'benchmarks' / f'{one.script}.py').is_file(), one.script
        page = (ROOT / 'docs' / one.page).read_text()
        assert f'{one.script}.py' in page, f'{one.page} does not cite {one.script}.py'


@pytest.mark.thorough
def test_all_benchmarks_that_need_no_ros_run_in_small():
    command = [sys.executable, str(ROOT / 'benchmarks' / 'all.py'), '--small']
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
