"""Regular expressions of the package: the same matches in every Python."""

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / 'cnc_interp'
#: A possessive quantifier or an atomic group. Debian 12's Python 3.11.2 matches them wrongly.
POSSESSIVE = re.compile(r'(?<!\\)[*+?}]\+|\(\?>')


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
