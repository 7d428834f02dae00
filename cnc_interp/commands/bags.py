"""`cnc-interp record`, `replay` and `repair`: runs written into bags, and read again."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FAILED, FINE, command, positive


def add_bag_commands(commands: Any) -> None:
    record = command(
        commands, 'record', record_command,
        'record what running nodes say into a bag (rosbag2, MCAP), until Ctrl-C',
        'cnc-interp record out/shift1',
    )  # fmt: skip
    record.option('bag', 'folder to create', Path, 'BAG')
    namespace_option(record, 'of the nodes')

    replay = command(
        commands, 'replay', replay_command,
        'show a recorded run again, or compute its setpoints again and compare them',
        'cnc-interp replay out/shift1 --compare',
    )  # fmt: skip
    replay.option('bag', 'folder of the bag', Path, 'BAG')
    text = 'compute the setpoints from the recorded blocks; exit code 0 if bit for bit the same'
    replay.flag('--compare', text)
    replay.option('--machine', 'another machine than the bag names', metavar='M')
    replay.option('--rate', 'times as fast as it was (1)', positive, 'X', default=1.0)
    replay.flag('--clock', 'publish the time of the bag too')
    namespace_option(replay, 'to publish in')

    repair = command(
        commands, 'repair', repair_command,
        'write what the bag of a killed recorder holds as a sound bag',
        'cnc-interp repair out/shift1 --out out/shift1-repaired',
    )  # fmt: skip
    repair.option('bag', 'folder of the bag', Path, 'BAG')
    repair.option('--out', 'folder to create', Path, 'NEW', required=True)


def namespace_option(added: Any, purpose: str) -> None:
    added.option('--namespace', f'ROS namespace {purpose} (/)', metavar='NS', default='/')


def record_command(options: Namespace) -> int:
    from cnc_interp.client.recorder import record

    count = record(options.bag, options.namespace)
    print(f'{options.bag}: {count} messages')
    return FINE


def replay_command(options: Namespace) -> int:
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.replay import compute_again, show_again

    with Bag(options.bag) as bag:
        if not options.compare:
            count = show_again(bag, options.namespace, options.rate, options.clock)
            print(f'{options.bag}: {count} messages of {bag.duration:.1f} s shown')
            return FINE
        same = True
        for comparison in compute_again(bag, options.machine):
            print(comparison.text())
            same = same and comparison.ok
    return FINE if same else FAILED


def repair_command(options: Namespace) -> int:
    from cnc_interp.client.bag import repair

    count, duration = repair(options.bag, options.out)
    print(f'{options.out}: {count} messages of {duration:.1f} s')
    return FINE
