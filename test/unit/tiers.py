"""How much a test tries: little with every change, all of it with ``--all``."""

import os
from itertools import product

import pytest

#: Set by ``--all`` before any test is collected.
thorough = False


def examples(few: int, many: int) -> int:
    """Examples to try; the environment variable CNC_INTERP_EXAMPLES overrides both numbers."""
    return int(os.environ.get('CNC_INTERP_EXAMPLES', many if thorough else few))


def few_of(every, *choices):
    """
    Return all combinations of choices for ``parametrize``; each ``every``-th runs every time.

    The others are thorough. Where ``every`` shares no factor with the number of a choice, each
    value of it runs every time.
    """
    return [
        pytest.param(*row, marks=pytest.mark.thorough if k % every else ())
        for k, row in enumerate(product(*choices))
    ]
