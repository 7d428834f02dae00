"""`cnc-interp jog`, `home`, `mdi`, `probe`, `offsets` and others: operate a running machine."""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.commands.parser import (
    BAD_INPUT,
    FAILED,
    FINE,
    Adds,
    command,
    flag,
    nodes_options,
    option,
    positive,
)
from cnc_interp.core import DEG, INCH, MM, UM, InterpError


def add_operate_commands(commands: Any) -> None:
    shown = flag('--json', 'print the result as JSON'), *nodes_options()
    command(
        commands,
        jog_command,
        'jog X 10 A -5 (by 10 mm and -5 deg); cnc-interp jog --to X 0 Y 0; '
        'cnc-interp jog --pose X 0 Y 0 Z 50 I 0 J 0 K 1',
        option(
            'words',
            'letter of an axis, and distance or position [mm, deg]; may be repeated',
            metavar='AXIS VALUE',
            nargs='*',
        ),
        flag('--to', 'the values are positions of the axes'),
        flag(
            '--pose',
            'the values are a tool pose in the workpiece frame: X Y Z of the tip [mm], I J K of '
            'the tool axis; omitted letters stay unchanged',
        ),
        option(
            '--tool',
            'move along the tool instead, away from the workpiece if positive',
            float,
            'MM',
            default=0.0,
        ),
        option(
            '--speed',
            'share of the largest velocities of the axes (100)',
            positive,
            'PERCENT',
            default=100.0,
        ),
        *shown,
    )
    command(
        commands,
        offsets_command,
        'offsets; cnc-interp offsets G55 X 140 Y -70 --use',
        option('offset', 'G54 to G59.3, or G92', nargs='?', default=''),
        option(
            'words',
            'letter of an axis, and machine coordinate of the zero [mm, deg]; R: rotation of the '
            'offset about Z [deg]; may be repeated',
            metavar='AXIS VALUE',
            nargs='*',
        ),
        flag('--clear', 'remove its previous values'),
        flag('--use', 'make it the active offset'),
        *shown,
    )
    command(
        commands,
        tools_command,
        'tools; cnc-interp tools 3 --length 75 --radius 5 --remark ball --load',
        option('number', 'number of the tool', int, nargs='?'),
        option('--length', 'its length', float, 'MM'),
        option('--radius', 'its radius', float, 'MM'),
        option(
            '--corner-radius',
            'radius of its corner: 0 for a flat end, the radius for a ball',
            float,
            'MM',
        ),
        option('--length-wear', 'wear that is added to its length', float, 'MM'),
        option('--radius-wear', 'wear that is added to its radius', float, 'MM'),
        option(
            '--flute',
            'length of its cutting part; 0: the whole tool below the holder',
            float,
            'MM',
        ),
        option('--pocket', 'its pocket in the tool changer; 0: none', int),
        option('--remark', 'a remark, such as its name', metavar='TEXT'),
        option(
            '--holder',
            'its holder, by its name in the scene; empty for the usual one',
            metavar='NAME',
        ),
        option(
            '--import',
            'read the tools from a tool.tbl of LinuxCNC, or from a CSV file',
            Path,
            'FILE',
            dest='from_file',
        ),
        option(
            '--export',
            'write the table, in the format that the name says (CSV or tool.tbl)',
            Path,
            'FILE',
        ),
        flag('--inch', 'lengths in these files are in inches'),
        flag('--remove', 'remove the tool from the table'),
        flag('--load', 'record this tool as the one in the spindle; 0: the spindle is empty'),
        *shown,
    )
    command(
        commands,
        touch_off_command,
        'touch-off X 0 Y 0; cnc-interp touch-off Z 10 --offset G55',
        option(
            'words',
            'letter of an axis, and the value that its coordinate gets [mm, deg]; may be repeated',
            metavar='AXIS VALUE',
            nargs='+',
        ),
        option('--offset', 'the offset (the active one)', metavar='G', default=''),
        *shown,
    )
    command(
        commands,
        home_command,
        'home; cnc-interp home Z',
        option('axes', 'letter of an axis', metavar='AXIS', nargs='*'),
        *nodes_options(),
    )
    command(
        commands,
        mdi_command,
        "mdi 'G91' 'G1 X10 F500' (without a line: show the modal state)",
        option('lines', 'a line of G-code', metavar='LINE', nargs='*'),
        flag('--json', 'print the results as JSON'),
        *nodes_options(),
    )
    command(
        commands,
        probe_command,
        'probe (lists all cycles); cnc-interp probe bore diameter 20 ball 3',
        option('cycle', 'what to find', metavar='CYCLE', nargs='?', default=''),
        option(
            'words',
            'parameter of the cycle, and its value; may be repeated',
            metavar='NAME VALUE',
            nargs='*',
        ),
        *nodes_options(),
    )
    command(
        commands,
        probe_rotary_command,
        'probe-rotary --ball 25 --tip 3 --out my_machine.yaml',
        option('--ball', 'diameter of the ball', positive, 'MM', required=True),
        option('--tip', 'diameter of the ball of the probe', positive, 'MM', required=True),
        option(
            '--longer',
            'length of the probe beyond the tip in the machine file (0)',
            float,
            'MM',
            default=0.0,
        ),
        option('--beside', 'distance before a touch (5)', positive, 'MM', default=5.0),
        option('--feed', 'feed of the first touch (300)', positive, 'MM/MIN', default=300.0),
        option('--slow', 'feed of the second touch (60)', positive, 'MM/MIN', default=60.0),
        _angles('primary', -30.0, 30.0),
        _angles('secondary', -90.0, 0.0, 90.0),
        option('--out', 'machine file to write', Path, 'FILE'),
        *nodes_options(),
    )


def _angles(name: str, *default: float) -> Adds:
    text = f'positions of the {name} axis ({" ".join(f"{angle:g}" for angle in default)})'
    return option(f'--{name}', text, float, 'DEG', nargs='+', default=default)


def pairs(words: list[str]) -> dict[str, float]:
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
    """Move axes of a running machine by hand, by a distance or to a position."""
    values = pairs(options.words)
    if bool(values) == bool(options.tool):
        raise InterpError('name an axis and its value, such as X 10, or --tool and a distance')
    if ((options.to or options.pose) and options.tool) or (options.to and options.pose):
        raise InterpError('--to, --pose and --tool exclude each other')
    if options.pose and (wrong := ' '.join(sorted(set(values) - set('XYZIJK')))):
        raise InterpError(f'{wrong}: a pose has X Y Z [mm] and the tool axis I J K')
    from cnc_interp.client.hand_move import move_by_hand

    ended = move_by_hand(
        options.namespace,
        options.domain,
        values,
        options.pose,
        relative=not options.to,
        speed=options.speed / 100.0,
        tool=options.tool * MM,
    )
    if options.json:
        print(json.dumps(ended.to_json(), indent=2))
    else:
        print(ended.text())
    return FINE if ended.arrived else FAILED


def home_command(options: argparse.Namespace) -> int:
    """Home the named axes of a running machine, or all that have a reference switch."""
    from cnc_interp.client.hand_move import home_axes

    missing = home_axes([name.upper() for name in options.axes], options.namespace, options.domain)
    print(f'not homed: {" ".join(missing)}' if missing else 'homed')
    return FAILED if missing else FINE


def mdi_command(options: argparse.Namespace) -> int:
    """Execute lines of G-code on a running machine, from its present position."""
    from cnc_interp.client.hand_move import give_lines
    from cnc_interp.program.notices import tell

    ends = []
    for end in give_lines(options.lines, options.namespace, options.domain):
        ends.append(end)
        if not options.json:
            print(end.text(), flush=True)
            tell(end.notices)
    if options.json:
        print(json.dumps([end.to_json() for end in ends], indent=2))
    else:
        print(f'modes: {ends[-1].modes}')
    return FINE if ends[-1].answer.ok else BAD_INPUT


def probe_command(options: argparse.Namespace) -> int:
    """Find a place with the probe of a running machine, and set the work offset there."""
    from cnc_interp.program.motion.probing import cycles

    cycle = cycles().get(options.cycle)
    if not options.cycle:
        for each in cycles().values():
            print(f'{each.name:<14}{each.text}')
            for told in each.parameters:
                print(f'  {told.name:<12}{told.text} ({told.default:g} {told.unit})')
        return FINE
    if cycle is None:
        raise InterpError(f'no cycle {options.cycle!r}; there are {", ".join(cycles())}')
    from cnc_interp.client.hand_move import give_lines
    from cnc_interp.client.setup_client import setup_console
    from cnc_interp.program.notices import tell

    values = {name.lower(): value for name, value in pairs(options.words).items()}
    (end,) = give_lines([cycle.line(values)], options.namespace, options.domain)
    print(end.text())
    tell(end.notices)
    if end.answer.ok:
        with setup_console(options.namespace, options.domain) as console:
            print(console.tools_text() if cycle.name == 'tool' else console.offsets_text())
    return FINE if end.answer.ok else FAILED


def probe_rotary_command(options: argparse.Namespace) -> int:
    """Find the rotary axes of a running machine by touching one ball, from above it."""
    from cnc_interp.client.rotary_probing import BallProbing, probe_rotary_centres
    from cnc_interp.machine_model.machine import with_geometry

    wanted = BallProbing(
        ball=options.ball * MM,
        tip=options.tip * MM,
        longer=options.longer * MM,
        beside=options.beside * MM,
        feed=options.feed,
        slow=options.slow,
        primary=[angle * DEG for angle in options.primary],
        secondary=[angle * DEG for angle in options.secondary],
    )
    tell = partial(print, flush=True)
    fit, name = probe_rotary_centres(wanted, options.namespace, options.domain, tell)
    print(f'{len(fit.residuals)} touches fit within {np.abs(fit.residuals).max() / UM:.1f} um')
    print(fit.text())
    if options.out is not None:
        with_geometry(name, options.out, fit.machine)
        print(f'machine file   {options.out}')
    return FINE


def offsets_command(options: argparse.Namespace) -> int:
    """Show or change the work offsets and G92 of a running machine."""
    words = pairs(options.words)
    wanted = {'offset': options.offset.upper(), 'clear': options.clear, 'activate': options.use}
    return _do(options, 'set_offset', wanted if any(wanted.values()) else None, words)


def tools_command(options: argparse.Namespace) -> int:
    """Show or change the tool table of a running machine."""
    from cnc_interp.program.job import TOOL_SIZES
    from cnc_interp.program.setup_table import TOOL_FIELDS

    if options.from_file or options.export:
        return _tool_files(options)
    given = {name: getattr(options, name) for name in TOOL_FIELDS}
    given = {
        name: value * MM if name in TOOL_SIZES else value
        for name, value in given.items()
        if value is not None
    }
    wanted: dict[str, Any] | None = None
    if options.number is not None:
        number = min(max(options.number, 0), 2**32 - 1)
        wanted = {'number': number, 'fields': list(given), **given}
        wanted |= {'remove': options.remove, 'load': options.load}
    return _do(options, 'set_tool', wanted)


def _tool_files(options: argparse.Namespace) -> int:
    from cnc_interp.client.setup_client import setup_console, whole_tool
    from cnc_interp.core.small_files import write_whole
    from cnc_interp.program.tool_files import csv_text, tbl_text, tools_of_file

    unit = INCH if options.inch else MM
    found = tools_of_file(options.from_file, unit) if options.from_file else {}
    with setup_console(options.namespace, options.domain) as console:
        for number, tool in found.items():
            console.ask('set_tool', **whole_tool(number, tool)[1])
        if options.export:
            text = csv_text if options.export.suffix == '.csv' else tbl_text
            write_whole(options.export, text(console.tools, unit))
        print(console.tools_text())
    return FINE


def touch_off_command(options: argparse.Namespace) -> int:
    """Set a work offset so that coordinates have given values at the current position."""
    return _do(options, 'touch_off', {'offset': options.offset.upper()}, pairs(options.words))


def _do(
    options: argparse.Namespace,
    service: str,
    wanted: dict[str, Any] | None,
    words: dict[str, float] | None = None,
) -> int:
    from cnc_interp.client.setup_client import setup_console

    with setup_console(options.namespace, options.domain) as console:
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
