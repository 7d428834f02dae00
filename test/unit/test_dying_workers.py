"""What a worker of pytest leaves that dies is run by the next one, and the run ends."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('xdist')

TESTS = Path(__file__).parents[1]
TEXT = """import os
import pathlib
import pytest

@pytest.mark.parametrize('k', range(3))
def test_it(k):
    died = pathlib.Path({died!r})
    if {name!r} == {dies!r} and k == 2 and not died.exists():
        died.touch()
        os._exit(1)
"""


@pytest.mark.thorough
@pytest.mark.parametrize('dies', ['ros2', 'unit2'])  # the last one of its lane, and of all
def test_files_of_a_worker_that_died_are_run_by_the_next(dies, tmp_path):
    for folder in ('ros', 'page', 'unit'):
        (tmp_path / 'test' / folder).mkdir(parents=True)
        for k in (1, 2):
            name = f'{folder}{k}'
            text = TEXT.format(died=str(tmp_path / 'died'), name=name, dies=dies)
            (tmp_path / 'test' / folder / f'test_{name}.py').write_text(text)
    shutil.copy(TESTS / 'conftest.py', tmp_path / 'test')
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-n', '3', '-p', 'no:cacheprovider', 'test'],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=280,
        env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)},
    )
    assert '1 failed, 18 passed' in done.stdout, done.stdout[-2000:] + done.stderr[-2000:]
