"""
The keys of a keyboard and the keys of the page that they press.

A key that stops is one stroke away. Cycle start takes two, so that no elbow starts a motion, and
neither space nor Enter presses a key that moves the machine.
"""

from __future__ import annotations

from typing import Any

from nicegui import ui

#: What the browser calls a key; what is printed on it; the key of the page.
KEYBOARD = (
    ('F1', 'F1', 'EMERGENCY STOP'),
    ('Escape', 'Esc', 'feed hold'),
    ('R', 'Shift + R', 'cycle start'),
    ('-', '-', 'slower'),
    ('+', '+', 'faster'),
    ('0', '0', '100%'),
    ('7', '7', 'rapid 25%'),
    ('8', '8', 'rapid 50%'),
    ('9', '9', 'rapid 100%'),
    ('s', 'S', 'single block'),
    ('o', 'O', 'optional stop'),
    ('b', 'B', 'block delete'),
    ('j', 'J', 'jog'),
    ('p', 'P', 'pose'),
    ('?', '?', 'keyboard'),
)
#: Names of keys, as the browser calls them, and the keys of the page.
MARKS = {name: mark for name, _, mark in KEYBOARD}
#: What is shown beside a key of the page that does not say it itself.
MEANINGS = {
    'slower': 'feed override 5 % less',
    'faster': 'feed override 5 % more',
    '100%': 'feed override 100 %',
    'rapid 25%': 'rapid override 25 %',
    'rapid 50%': 'rapid override 50 %',
    'rapid 100%': 'rapid override 100 %',
    'single block': 'single block on or off',
    'optional stop': 'optional stop (M1) on or off',
    'block delete': 'block delete on or off: lines that begin with a slash are left out',
    'pose': 'show or hide the fields of a tool pose',
    'jog': 'show or hide the keys that move an axis',
    'keyboard': 'show or hide this list',
}


def keyboard_list() -> Any:
    """Make the dialog that lists the keys of the keyboard."""
    with ui.dialog() as dialog, ui.card().classes('settings'):
        ui.label('keyboard').classes('title')
        with ui.element('div').classes('map'):
            for _, printed, mark in KEYBOARD:
                ui.html(f'<kbd>{printed}</kbd>', sanitize=False)
                ui.label(MEANINGS.get(mark, mark))
            ui.html('<kbd>← → ↑ ↓ PgUp PgDn</kbd>', sanitize=False)
            ui.label('X, Y, Z while the key is held and the jog keys are shown')
            ui.html('<kbd>Enter ↑ ↓</kbd>', sanitize=False)
            ui.label('in the MDI field: execute the line; show the lines before')
        ui.label(
            'Space and Enter never press a key that moves the machine. '
            'Enter executes the line in the MDI field.'
        ).classes('small')
    return dialog
