"""For the pages of the API: what stands behind `#:` at a field is its description."""

from __future__ import annotations

from typing import Any

import griffe


class FieldComments(griffe.Extension):  # type: ignore[misc]
    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        if attr.docstring or attr.lineno is None:
            return
        lines = attr.lines_collection[attr.filepath]
        _, mark, text = lines[attr.lineno - 1].partition('#:')
        above = attr.lineno - 2
        while not mark and lines[above].strip().startswith('#:'):
            text = lines[above].strip().removeprefix('#:') + ' ' + text
            above -= 1
        if text.strip():
            attr.docstring = griffe.Docstring(text.strip(), parent=attr)
