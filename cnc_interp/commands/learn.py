"""`cnc-interp learn`: what a compensated run teaches for the next run of its program."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.command_options import FINE, command
from cnc_interp.core.units import UM


def add_learn_command(commands: Any) -> None:
    """Declare `learn`."""
    learn = command(
        commands, 'learn', learn_command,
        'learn from a recorded, compensated run how to follow the same program better',
        'cnc-interp learn out/bag --out out/learnt.npz',
    )  # fmt: skip
    learn.add_argument(
        'bag', type=Path, metavar='BAG', help='bag of a run with --compensate, with its feedback'
    )
    learn.add_argument(
        '--out', type=Path, required=True, metavar='FILE',
        help='file to write, for `run PROGRAM --compensate MODEL --learnt FILE`',
    )  # fmt: skip


def learn_command(options: Namespace) -> int:
    """Learn from a recorded run."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_lesson import recorded_lesson

    with Bag(options.bag) as bag:
        lesson = recorded_lesson(bag)
    lesson.motion.save(options.out)
    print('run   tip, largest   tip, mean')
    for number, (largest, mean) in enumerate(lesson.motion.error / UM, 1):
        print(f'{number:3d}   {largest:9.1f} um   {mean:6.2f} um')
    print(f'runs learnt    {len(lesson.motion.error)}')
    print(f'written        {options.out}')
    return FINE
