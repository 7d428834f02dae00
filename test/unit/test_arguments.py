"""Functions take few arguments; what belongs together is one named bundle."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / 'cnc_interp'
MOST = 8  #: Without ``self`` and ``cls``.

#: The functions of one needle take scalars and rows of arrays.
NEEDLES = {f'cam.needle_cuts.{name}' for name in ('gap', 'entry', 'entry_at', 'cut_finely')}
#: Kernels of one step of a stop, with one caller each.
KERNELS = {'feedrate.stop_law._brake', 'feedrate.stop_law._first_stop'}
#: Most arguments have defaults, and callers name the few that they give.
BY_NAME = {'machine.cycle.__init__', 'program.geometry.arcs.arcs_of', 'proof.verdict.judge'}
ALLOWED = NEEDLES | KERNELS | BY_NAME


def crowded(source):
    """Yield the names of functions with too many arguments."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            if sum(a.arg not in ('self', 'cls') for a in given) > MOST:
                yield node.name


def test_functions_take_few_arguments():
    found = set()
    for path in PACKAGE.rglob('*.py'):
        module = '.'.join(path.relative_to(PACKAGE).with_suffix('').parts)
        found |= {f'{module}.{name}' for name in crowded(path.read_text())}
    assert not found - ALLOWED, 'bundle what belongs together: NamedTuple or frozen dataclass'
    assert not ALLOWED - found, 'take it off the list'


@pytest.mark.parametrize('more', ['i', '*, i'])
def test_crowded_functions_are_seen(more):
    assert list(crowded(f'def f(self, a, b, c, d, e, f, g, h, {more}): pass'))
    assert not list(crowded('def f(self, a, b, c, d, e, f, g, h): pass'))
