"""The scripts of the page: each stands in a file beside the module whose name it has."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cnc_interp.client.page.contact import AGAIN
from cnc_interp.client.page.jog_pad import ARROWS, STALE
from cnc_interp.client.page.keyboard import MARKS

#: The scripts in the order in which they are loaded, and the values in capitals in them.
SCRIPTS: Mapping[str, Mapping[str, Any]] = {
    'contact': {},
    'shown': {},
    'listing': {},
    'keyboard': {'MARKS': MARKS},
    'jog_pad': {'ARROWS': ARROWS, 'STALE': 1e3 * STALE, 'AGAIN': AGAIN},
    'scene': {},
}


def scripts() -> str:
    """Return all scripts, for the head of the page."""
    return ''.join(f'<script>{_text(name, values)}</script>' for name, values in SCRIPTS.items())


def _text(name: str, values: Mapping[str, Any]) -> str:
    """Return a script with its values."""
    text = Path(__file__).with_name(f'{name}.js').read_text(encoding='utf-8')
    for word, value in values.items():
        text = text.replace(word, json.dumps(value), 1)
    return text
