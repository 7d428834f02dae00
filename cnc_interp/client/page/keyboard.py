"""
The keys of a keyboard and the keys of the page that they press.

A key that stops is one stroke away. Cycle start takes two, so that no elbow starts a motion, and
neither space nor Enter presses a key that moves the machine.
"""

from __future__ import annotations

#: What the browser calls a key; what is printed on it; the key of the page.
KEYBOARD = (
    ('F1', 'F1', 'EMERGENCY STOP'),
    ('Escape', 'Esc', 'feed hold'),
    ('R', 'Shift + R', 'cycle start'),
    ('-', '-', 'slower'),
    ('+', '+', 'faster'),
    ('0', '0', '100%'),
    ('j', 'J', 'jog'),
    ('?', '?', 'keyboard'),
)
#: Names of keys, as the browser calls them, and the keys of the page.
MARKS = {name: mark for name, _, mark in KEYBOARD}
#: What is shown beside a key of the page that does not say it itself.
MEANINGS = {
    'slower': 'feed override 5 % less',
    'faster': 'feed override 5 % more',
    '100%': 'feed override 100 %',
    'jog': 'show or hide the keys that move an axis',
    'keyboard': 'show or hide this list',
}
