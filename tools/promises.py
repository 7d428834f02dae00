#!/usr/bin/env python3
"""Compare test/promises.yaml with the pages that promise and the tests that hold it."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]


def promises() -> list[dict[str, Any]]:
    """Return the rows of the table."""
    rows: list[dict[str, Any]] = yaml.safe_load((ROOT / 'test' / 'promises.yaml').read_text())
    return rows


@cache
def tiers(file: str) -> dict[str, bool]:
    """Return the tests of a file, and whether all runs of each are thorough."""
    module = ast.parse((ROOT / 'test' / file).read_text())

    def marks(node: ast.expr) -> bool:
        return ast.unparse(node).endswith('mark.thorough')

    whole = False
    for node in module.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'pytestmark':
            values = node.value.elts if isinstance(node.value, ast.List) else [node.value]
            whole = any(map(marks, values))
    return {
        node.name: whole or any(map(marks, node.decorator_list))
        for node in module.body
        if isinstance(node, ast.FunctionDef) and node.name.startswith('test_')
    }


def faults() -> list[str]:
    """Return what is wrong with the table: words that stand nowhere, tests that do not exist."""
    found = []
    for row in promises():
        page = ROOT / row['page']
        text = ' '.join(page.read_text().split()).lower() if page.is_file() else ''
        if row['words'].lower() not in text:
            found.append(f'{row["page"]}: does not say {row["words"]!r} any more')
        for test in row['tests']:
            file, _, name = test.partition('::')
            if not (ROOT / 'test' / file).is_file() or (name and name not in tiers(file)):
                found.append(f'{test}: no such test')
    readme = (ROOT / 'README.md').read_text()
    kept = ' '.join(row['words'] for row in promises())
    for command in sorted(set(re.findall(r'^\| `cnc-interp ([a-z]+)', readme, re.M))):
        if not re.search(rf'(cnc-interp|\./cnc) {command}\b', kept):
            found.append(f'README.md: cnc-interp {command} has no row')
    return found


if __name__ == '__main__':
    wrong = faults()
    if wrong:
        raise SystemExit('\n'.join(wrong))
