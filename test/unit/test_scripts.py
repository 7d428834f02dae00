"""Scripts beside the package import what is there; most of them no test starts."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OWN = re.compile(r'cnc_interp(\.|$)')
FOLDERS = 'docs', 'examples', 'benchmarks'
SCRIPTS = [path for folder in FOLDERS for path in (ROOT / folder).glob('*.py')]


@cache
def file_of(module):
    place = ROOT.joinpath(*module.split('.'))
    return next((p for p in (place.with_suffix('.py'), place / '__init__.py') if p.exists()), None)


@cache
def names_in(module):
    """Names that a module binds at its top level, also inside ``if`` and ``try``."""
    waiting, found = list(ast.parse(file_of(module).read_text()).body), set()
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        waiting += ast.iter_child_nodes(node)
    return found


def lacking(source):
    """Names that a source takes from the package and the package lacks."""
    tree, modules, found = ast.parse(source), {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if OWN.match(alias.name)]
            found += [name for name in names if file_of(name) is None]
        elif isinstance(node, ast.ImportFrom) and OWN.match(node.module or ''):
            for alias in node.names:
                name = f'{node.module}.{alias.name}'
                if file_of(name):
                    modules[alias.asname or alias.name] = name
                elif file_of(node.module) is None or alias.name not in names_in(node.module):
                    found.append(name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = modules.get(node.value.id)
            if module and node.attr not in names_in(module) | {'__file__'}:
                found.append(f'{module}.{node.attr}')
    return found


@pytest.mark.parametrize('script', SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_script_imports_is_there(script):
    assert not lacking(script.read_text())


@pytest.mark.parametrize(
    'source',
    [
        'import cnc_interp.report.dense_blocks',
        'from cnc_interp.report.dense_blocks import lengths',
        'from cnc_interp.report.corners import widths',
        'from cnc_interp.feedrate import jerk_stage\njerk_stage.plans()',
        'from cnc_interp import Machines',
    ],
)
def test_what_the_package_lacks_is_seen(source):
    assert lacking(source)
