"""Run the numbered examples, and write ``docs/course.md`` with what they print and draw.

    python docs/make_course.py [NUMBER ...]

draws ``docs/pictures/course_*.png`` of all examples, or of some of them.
"""

from __future__ import annotations

import ast
import contextlib
import io
import re
import runpy
import sys
from pathlib import Path

import matplotlib as mpl
from make_pictures import PICTURES, STYLE
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
PAGE = ROOT / 'docs' / 'course.md'
EXAMPLES = sorted((ROOT / 'examples').glob('[0-9][0-9]_*.py'))
HEAD = """# Sixteen examples

Copy an example, run it with `python`, and change it. Each example uses only the
[library](library.md), and opens the figure that is shown here.
`docs/make_course.py` makes this page.
"""


def run(example: Path) -> str:
    """Run an example, leave its figure open, and return what it prints."""
    plt.close('all')
    printed = io.StringIO()
    mpl.use('agg')
    with contextlib.redirect_stdout(printed), mpl.rc_context({**STYLE, 'figure.figsize': (7, 3)}):
        runpy.run_path(str(example), run_name='__main__')
    return re.sub(r'\S*/(\w+\.\w+ on)', r'\1', printed.getvalue())


def section(example: Path, printed: str) -> str:
    """Return the part of the page for an example."""
    title = (ast.get_docstring(ast.parse(example.read_text(encoding='utf-8'))) or '').splitlines()[
        0
    ]
    picture = f'![What {example.name} draws](pictures/course_{example.name[:2]}.png)'
    link = f'[{example.name}](../examples/{example.name})'
    heading = f'## {int(example.name[:2])}. {title.rstrip(".")}'
    return f'{heading}\n\n{picture}\n\n{link}\n\n```\n{printed}```\n'


def main() -> None:
    """Write the page and the pictures."""
    chosen = [f'{int(word):02}' for word in sys.argv[1:]]
    text = PAGE.read_text(encoding='utf-8') if PAGE.exists() else ''
    known = dict(re.findall(r'\.\./examples/(\w+\.py)\)\n\n```\n(.*?)```', text, re.S))
    for example in EXAMPLES:
        if not chosen or example.name[:2] in chosen:
            known[example.name] = run(example)
            plt.gcf().tight_layout()
            plt.gcf().savefig(PICTURES / f'course_{example.name[:2]}.png', dpi=90)
    parts = [section(example, known.get(example.name, '')) for example in EXAMPLES]
    PAGE.write_text('\n'.join([HEAD, *parts]), encoding='utf-8')


if __name__ == '__main__':
    main()
