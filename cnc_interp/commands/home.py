"""`cnc-interp home`: home axes of a running machine."""

from __future__ import annotations

import argparse
from typing import Any

from cnc_interp.command_options import FAILED, FINE, command, nodes_options


def add_home_command(commands: Any) -> None:
    """Declare `home`."""
    home = command(
        commands, 'home', home_command,
        'home axes of a running machine, all that have a reference switch or those named',
        'cnc-interp home; cnc-interp home Z',
    )  # fmt: skip
    home.add_argument('axes', nargs='*', metavar='AXIS', help='letter of an axis')
    nodes_options(home)


def home_command(options: argparse.Namespace) -> int:
    """Home and wait for the end."""
    from cnc_interp.client.hand_move import home_axes

    missing = home_axes([name.upper() for name in options.axes], options.namespace, options.domain)
    print(f'not homed: {" ".join(missing)}' if missing else 'homed')
    return FAILED if missing else FINE
