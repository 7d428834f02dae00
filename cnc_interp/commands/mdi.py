"""`cnc-interp mdi`: have lines of G-code executed by a running machine."""

from __future__ import annotations

import argparse
import json
from typing import Any

from cnc_interp.command_options import BAD_INPUT, FINE, command, nodes_options


def add_mdi_command(commands: Any) -> None:
    """Declare `mdi`."""
    mdi = command(
        commands, 'mdi', mdi_command,
        'have lines of G-code executed by a running machine, from where it stands',
        "cnc-interp mdi 'G91' 'G1 X10 F500' (without a line: show the modal state)",
    )  # fmt: skip
    mdi.add_argument('lines', nargs='*', metavar='LINE', help='a line of G-code')
    mdi.add_argument('--json', action='store_true', help='print the results as JSON')
    nodes_options(mdi)


def mdi_command(options: argparse.Namespace) -> int:
    """Give the lines and wait for the end of each; the first one refused ends it."""
    from cnc_interp.client.mdi import give_lines

    ends = []
    for end in give_lines(options.lines, options.namespace, options.domain):
        ends.append(end)
        if not options.json:
            print(end.text(), flush=True)
    if options.json:
        print(json.dumps([end.to_json() for end in ends], indent=2))
    else:
        print(f'modes: {ends[-1].modes}')
    return FINE if ends[-1].answer.ok else BAD_INPUT
