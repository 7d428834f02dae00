"""Hook of mkdocs: draw equations as MathML, and show the text of linked examples.

Browsers draw MathML without a script, so the site needs no network.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

ROOT = Path(__file__).parents[1]
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)
EXAMPLE = re.compile(r'^\[(\w+\.py)\]\(\.\./examples/\1\)$', re.M)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put the text of an example below the line that links it."""

    def text_of(found: re.Match[str]) -> str:
        text = (ROOT / 'examples' / found[1]).read_text(encoding='utf-8')
        return f'`examples/{found[1]}`\n\n```python\n{text}```'

    return EXAMPLE.sub(text_of, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Draw the equations that arithmatex has marked."""

    def drawn(found: re.Match[str]) -> str:
        display = 'inline' if found[2] == '(' else 'block'
        return str(convert(html.unescape(found[3]).strip(), display=display))

    return EQUATION.sub(drawn, content)
