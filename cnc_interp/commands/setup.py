"""`cnc-interp offsets`, `tools` and `touch-off`: the setup of a running machine."""

from __future__ import annotations

import argparse
import json
from typing import Any

from cnc_interp.command_options import FINE, command, nodes_options
from cnc_interp.commands.jog import pairs
from cnc_interp.core.units import MM


def add_setup_commands(commands: Any) -> None:
    """Declare `offsets`, `tools` and `touch-off`."""
    offsets = command(
        commands, 'offsets', offsets_command,
        'show or change the work offsets and G92 of a running machine',
        'cnc-interp offsets; cnc-interp offsets G55 X 140 Y -70 --use',
    )  # fmt: skip
    offsets.add_argument('offset', nargs='?', default='', help='G54 to G59.3, or G92')
    offsets.add_argument(
        'words', nargs='*', metavar='AXIS VALUE',
        help='letter of an axis, and machine coordinate of the zero [mm, deg]; R: rotation of the '
        'offset about Z [deg]; may be repeated',
    )  # fmt: skip
    offsets.add_argument('--clear', action='store_true', help='remove the values it had before')
    offsets.add_argument('--use', action='store_true', help='make it the active one')
    tools = command(
        commands, 'tools', tools_command, 'show or change the tool table of a running machine',
        'cnc-interp tools; cnc-interp tools 3 --length 75 --radius 5 --remark ball --load',
    )  # fmt: skip
    tools.add_argument('number', nargs='?', type=int, help='number of the tool')
    tools.add_argument('--length', type=float, metavar='MM', help='its length')
    tools.add_argument('--radius', type=float, metavar='MM', help='its radius')
    tools.add_argument(
        '--corner-radius', type=float, metavar='MM',
        help='radius of its corner: 0 for a flat end, the radius for a ball',
    )  # fmt: skip
    tools.add_argument('--remark', metavar='TEXT', help='what tells it from others')
    tools.add_argument('--remove', action='store_true', help='take it out of the table')
    tools.add_argument('--load', action='store_true', help='it is in the spindle; 0: none is')
    touch = command(
        commands, 'touch-off', touch_off_command,
        'set a work offset so that coordinates read given values where the axes stand',
        'cnc-interp touch-off X 0 Y 0; cnc-interp touch-off Z 10 --offset G55',
    )  # fmt: skip
    touch.add_argument(
        'words', nargs='+', metavar='AXIS VALUE',
        help='letter of an axis, and what its coordinate shall read [mm, deg]; may be repeated',
    )  # fmt: skip
    touch.add_argument('--offset', default='', metavar='G', help='the offset (the active one)')
    for added in (offsets, tools, touch):
        added.add_argument('--json', action='store_true', help='print the result as JSON')
        nodes_options(added)


def offsets_command(options: argparse.Namespace) -> int:
    """Show or change offsets."""
    words = pairs(options.words)
    wanted = {'offset': options.offset.upper(), 'clear': options.clear, 'activate': options.use}
    return _do(options, 'set_offset', wanted if any(wanted.values()) else None, words)


def tools_command(options: argparse.Namespace) -> int:
    """Show or change tools."""
    names = ('length', 'radius', 'corner_radius', 'remark')
    given = {name: getattr(options, name) for name in names}
    given = {
        name: value if name == 'remark' else value * MM
        for name, value in given.items()
        if value is not None
    }
    wanted: dict[str, Any] | None = None
    if options.number is not None:
        number = min(max(options.number, 0), 2**32 - 1)
        wanted = {'number': number, 'fields': list(given), **given}
        wanted |= {'remove': options.remove, 'load': options.load}
    return _do(options, 'set_tool', wanted)


def touch_off_command(options: argparse.Namespace) -> int:
    """Set an offset from where the axes stand."""
    return _do(options, 'touch_off', {'offset': options.offset.upper()}, pairs(options.words))


def _do(
    options: argparse.Namespace,
    service: str,
    wanted: dict[str, Any] | None,
    words: dict[str, float] | None = None,
) -> int:
    """Ask for a change, or show the table where nothing is asked for."""
    from cnc_interp.client.setup_console import SetupConsole

    with SetupConsole(options.namespace, options.domain) as console:
        told = ''
        if wanted is not None:
            fields = console.values(words) if words is not None else {}
            told = console.ask(service, **wanted, **fields)
        if options.json:
            print(json.dumps({'changed': told} if wanted else console.to_json(), indent=2))
        elif wanted is not None:
            print(told)
        else:
            print(console.tools_text() if service == 'set_tool' else console.offsets_text())
    return FINE
