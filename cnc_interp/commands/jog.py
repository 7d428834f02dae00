"""`cnc-interp jog`: move axes of a running machine by a distance or to a position."""

from __future__ import annotations

import argparse
import json
from typing import Any

from cnc_interp.command_options import FAILED, FINE, command, nodes_options, positive
from cnc_interp.core.errors import InterpError


def add_jog_command(commands: Any) -> None:
    """Declare `jog`."""
    jog = command(
        commands, 'jog', jog_command,
        'move axes of a running machine by hand, by a distance or to a position',
        'cnc-interp jog X 10 A -5 (by 10 mm and -5 deg); cnc-interp jog --to X 0 Y 0; '
        'cnc-interp jog --pose X 0 Y 0 Z 50 I 0 J 0 K 1',
    )  # fmt: skip
    jog.add_argument(
        'words', nargs='*', metavar='AXIS VALUE',
        help='letter of an axis, and distance or position [mm, deg]; may be repeated',
    )  # fmt: skip
    jog.add_argument('--to', action='store_true', help='the values are positions of the axes')
    jog.add_argument(
        '--pose', action='store_true',
        help='the values are a tool pose in the workpiece frame: X Y Z of the tip [mm], I J K of '
        'the tool axis; what is not named stays',
    )  # fmt: skip
    jog.add_argument(
        '--tool', type=float, default=0.0, metavar='MM',
        help='move along the tool instead, away from the workpiece where positive',
    )  # fmt: skip
    jog.add_argument(
        '--speed', type=positive, default=100.0, metavar='PERCENT',
        help='part of the largest velocities of the axes (100)',
    )  # fmt: skip
    jog.add_argument('--json', action='store_true', help='print the result as JSON')
    nodes_options(jog)


def pairs(words: list[str]) -> dict[str, float]:
    """Return the value of each axis named."""
    found: dict[str, float] = {}
    for name, value in zip(words[::2], words[1::2], strict=False):
        try:
            found[name.upper()] = float(value)
        except ValueError:
            raise InterpError(
                f'{name} {value}: write an axis and a number, such as X 10'
            ) from None
    if 2 * len(found) != len(words):
        raise InterpError('write each axis once, with its value: X 10 Y -5')
    return found


def jog_command(options: argparse.Namespace) -> int:
    """Move and wait for the end."""
    values = pairs(options.words)
    if bool(values) == bool(options.tool):
        raise InterpError('name an axis and its value, such as X 10, or --tool and a distance')
    if ((options.to or options.pose) and options.tool) or (options.to and options.pose):
        raise InterpError('--to, --pose and --tool exclude each other')
    if options.pose and (wrong := ' '.join(sorted(set(values) - set('XYZIJK')))):
        raise InterpError(f'{wrong}: a pose has X Y Z [mm] and the tool axis I J K')
    from cnc_interp.client.hand_move import HandMove, move_by_hand

    relative = not (options.to or options.pose)
    wanted = HandMove(values, relative, options.tool, options.speed / 100.0, options.pose)
    ended = move_by_hand(wanted, options.namespace, options.domain)
    if options.json:
        print(json.dumps(ended.to_json(), indent=2))
    else:
        print(ended.text())
    return FINE if ended.arrived else FAILED
