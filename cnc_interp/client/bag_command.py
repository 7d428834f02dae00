"""What `cnc-interp` does with bags: record, replay, check, report; ROS is imported when needed."""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cnc_interp.command_options import command, positive
from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.machine import Machine

if TYPE_CHECKING:
    from cnc_interp.proof.verdict import Proof


def is_bag(path: Path) -> bool:
    """Tell a bag from a folder of plan files."""
    return (path / 'metadata.yaml').is_file() or path.suffix == '.mcap'


def add_bag_commands(commands: Any) -> None:
    """Add `record` and `replay`."""
    record = command(
        commands, 'record', record_command,
        'record what running nodes say into a bag (rosbag2, MCAP), until Ctrl-C',
        'cnc-interp record out/shift1',
    )  # fmt: skip
    record.add_argument('bag', type=Path, metavar='BAG', help='folder to create')
    namespace_option(record, 'of the nodes')

    replay = command(
        commands, 'replay', replay_command,
        'show a recorded run again, or compute its setpoints again and compare them',
        'cnc-interp replay out/shift1 --compare',
    )  # fmt: skip
    replay.add_argument('bag', type=Path, metavar='BAG', help='folder of the bag')
    replay.add_argument(
        '--compare', action='store_true',
        help='compute the setpoints from the recorded blocks; exit code 0 if bit for bit the same',
    )  # fmt: skip
    replay.add_argument('--machine', metavar='M', help='another machine than the bag names')
    replay.add_argument(
        '--rate', type=positive, default=1.0, metavar='X', help='times as fast as it was (1)'
    )
    replay.add_argument('--clock', action='store_true', help='publish the time of the bag too')
    namespace_option(replay, 'to publish in')


def namespace_option(added: Any, purpose: str) -> None:
    """Add the ROS namespace."""
    added.add_argument(
        '--namespace', default='/', metavar='NS', help=f'ROS namespace {purpose} (/)'
    )


def record_command(options: Namespace) -> int:
    """Record until Ctrl-C."""
    from cnc_interp.client.recorder import record

    count = record(options.bag, options.namespace)
    print(f'{options.bag}: {count} messages')
    return 0


def replay_command(options: Namespace) -> int:
    """Compute again, or show again."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.replay import compute_again, show_again

    with Bag(options.bag) as bag:
        if not options.compare:
            count = show_again(bag, options.namespace, options.rate, options.clock)
            print(f'{options.bag}: {count} messages of {bag.duration:.1f} s shown')
            return 0
        same = True
        for comparison in compute_again(bag, options.machine or ''):
            print(comparison.text())
            same = same and comparison.ok
    return 0 if same else 1


def check_bag(path: Path, machine: str) -> Proof:
    """
    Prove what the machine executed in the last run of a bag.

    Raises
    ------
    InterpError
        If the bag cannot be read, or does not hold the whole run.

    """
    from cnc_interp.proof.verify import verify_plan

    with _plan_files_of(path, machine) as (folder, found):
        return verify_plan(folder, found)


def report_bag(path: Path, page: Path, machine: str) -> None:
    """Write the HTML page about the last run of a bag."""
    from cnc_interp.report import write_report

    with _plan_files_of(path, machine) as (folder, found):
        write_report(folder, page, found)


@contextmanager
def _plan_files_of(path: Path, machine: str) -> Iterator[tuple[Path, Machine]]:
    """Write the plan files of the last run of a bag for a while; yield their folder."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_run import recorded_run, write_run

    with Bag(path) as bag:
        run = recorded_run(bag)
    name = machine or run.machine
    if not name:
        raise InterpError(f'{path}: does not tell the machine; name it with --machine')
    found = Machine.load(name)
    with tempfile.TemporaryDirectory(prefix='cnc_interp_') as folder:
        write_run(run, found, Path(folder))
        yield Path(folder), found
