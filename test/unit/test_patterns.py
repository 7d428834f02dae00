"""Regular expressions of the package: the same matches in every Python, and in linear time."""

import ast
import re
from pathlib import Path

import pytest

from cnc_interp.cam.part21 import INSTANCE, PART, TOKEN

PACKAGE = Path(__file__).parents[2] / 'cnc_interp'
#: A possessive quantifier or an atomic group. Debian 12's Python 3.11.2 matches them wrongly.
POSSESSIVE = re.compile(r'(?<!\\)[*+?}]\+|\(\?>')
LONG = 100_000


def texts_of(path):
    """All text constants of a source, parts of f-strings included."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes)):
            text = node.value
            yield text.decode('latin-1') if isinstance(text, bytes) else text


def test_no_pattern_is_possessive():
    found = {
        (path.name, text)
        for path in PACKAGE.rglob('*.py')
        for text in texts_of(path)
        if POSSESSIVE.search(text)
    }
    assert not found


@pytest.mark.parametrize('pattern', [r'\d++', r'(?:\s|a)*+', r'a?+', r'a{2}+', r'(?>a)'])
def test_possessive_patterns_are_seen(pattern):
    assert POSSESSIVE.search(pattern)


@pytest.mark.parametrize(
    'text',
    ['/* ' * LONG, '/* a */' * LONG, ' ' * LONG, "'" * (2 * LONG + 1), '1' * LONG, '/' * LONG],
    ids=['open comments', 'comments', 'spaces', 'quotes', 'digits', 'slashes'],
)
def test_statements_of_step_files_are_refused_in_linear_time(text):
    """Quadratic time would be hours here."""
    for pattern in (PART, INSTANCE, TOKEN):
        pattern.match(text + '!')
