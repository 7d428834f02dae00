"""`cnc-interp urdf`: a machine as URDF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cnc_interp.command_options import FINE, command


def add_urdf_command(commands: Any) -> None:
    """Declare `urdf`."""
    urdf = command(
        commands, 'urdf', urdf_command,
        'write a machine as URDF, for robot_state_publisher, RViz and Foxglove',
        'cnc-interp urdf xyzac --out xyzac.urdf',
    )  # fmt: skip
    urdf.add_argument('machine', metavar='M', help='bundled machine or YAML file')
    urdf.add_argument('--out', type=Path, metavar='FILE', help='file to write (default: print it)')


def urdf_command(options: argparse.Namespace) -> int:
    """Write a machine as URDF."""
    from cnc_interp.description.urdf import urdf_of
    from cnc_interp.machine_model.machine import Machine

    text = urdf_of(Machine.load(options.machine))
    if options.out is None:
        print(text, end='')
    else:
        options.out.write_text(text, encoding='utf-8')
    return FINE
