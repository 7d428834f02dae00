"""Each numbered example runs, prints what docs/course.md says, and draws a figure."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / 'examples').glob('[0-9][0-9]_*.py'))
SLOW = '13', '14'  #: ``test_reference_solver`` and ``test_wheel`` run these in smaller parts.
PAGE = (ROOT / 'docs' / 'course.md').read_text()


def test_there_are_sixteen_with_a_number_each():
    assert [int(example.name[:2]) for example in EXAMPLES] == list(range(1, 17))


@pytest.mark.parametrize(
    'example',
    [
        pytest.param(one, marks=pytest.mark.thorough if one.name.startswith(SLOW) else ())
        for one in EXAMPLES
    ],
    ids=lambda one: one.stem,
)
def test_example_prints_and_draws(example, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / 'docs')
    course = runpy.run_path(str(ROOT / 'docs' / 'make_course.py'))
    printed = course['run'](example)
    try:
        assert printed and course['section'](example, printed) in PAGE
        axes = plt.gcf().axes[0]
        drawn = [line.get_xydata() for line in axes.lines]
        drawn += [np.array([[bar.get_width(), bar.get_height()]]) for bar in axes.patches]
        assert drawn and all(len(row) and np.isfinite(row).all() for row in drawn)
        assert axes.get_xlabel()
    finally:
        plt.close('all')
    assert (ROOT / 'docs' / 'pictures' / f'course_{example.name[:2]}.png').is_file()
