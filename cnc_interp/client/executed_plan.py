"""What the machine executed as plan files: `cnc-interp check` proves it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.core.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import read_program
from cnc_interp.run.chain import plan_program, write_plan
from cnc_interp.run.chunk import part_of
from cnc_interp.run.interpolator import Setpoints
from cnc_interp.wire.chunk_messages import setpoints_from

if TYPE_CHECKING:
    from cnc_interp.client.session import RunRequest


def executed(chunks: list[SetpointChunk]) -> Setpoints:
    """
    Join what was executed in one run, the approach left out; time counts from the program's start.

    Raises
    ------
    StreamError
        If a setpoint is missing.

    """
    parts, following = [], None
    for chunk in sorted(chunks, key=lambda chunk: chunk.first_sample):
        if following is not None and chunk.first_sample > following:
            raise StreamError(f'setpoints {following} to {chunk.first_sample - 1} were not heard')
        following = chunk.first_sample + len(chunk.sequences)
        parts.append(setpoints_from(chunk))
    if not parts:
        raise StreamError('nothing was executed; run the program again')
    heard = Setpoints.concatenate(parts)
    first = int(np.searchsorted(heard.block, 1))
    program = part_of(heard, first, len(heard))
    time = np.arange(len(program)) * chunks[0].period
    return replace(program, time=time)


def write_received(
    request: RunRequest, machine: Machine, chunks: list[SetpointChunk], directory: Path
) -> None:
    """Write plan files with the executed setpoints; blocks and path are read and planned anew."""
    program = read_program(request.program, Transform.of(machine), request.settings)
    plan = plan_program(program, machine, request.settings)
    write_plan(replace(plan, setpoints=executed(chunks)), directory)
