"""Setpoints and feedback of the last run in a bag, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.client.bag import Bag
from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.wire.run_messages import run_id_of


@dataclass(frozen=True)
class RecordedFeedback:
    """What the drives were told and what they did."""

    period: float  #: Interpolation period [s].
    #: (K, n_axes): Commanded position and velocity, measured position [m, rad, per s].
    setpoint: FloatArray
    rate: FloatArray
    feedback: FloatArray
    block: IntArray  #: (K,): Block of each setpoint; 0 beside the program.
    plan: IntArray  #: (K,): Number of the plan of each setpoint.
    complete: bool  #: Whether the last setpoint is that of the end of the program.
    program_id: str  #: The run.


def recorded_feedback(bag: Bag) -> RecordedFeedback:
    """Read the last run in which the machine moved, its approach included.

    Raises InterpError if nothing was executed, or setpoints or feedback are not complete.
    """
    chunks = bag.read('executed_setpoints')
    if not chunks:
        raise InterpError(f'{bag.path}: nothing was executed in this bag; record a run')
    name = run_id_of(chunks[-1]).program_id
    actual = {m.first_sample: m for m in bag.messages('axis_feedback') if m.program_id == name}
    chunks = sorted((m for m in chunks if m.program_id == name), key=lambda m: m.first_sample)
    parts, following = [], chunks[0].first_sample
    for chunk in chunks:
        told = actual.get(chunk.first_sample)
        if chunk.first_sample != following or told is None:
            raise InterpError(
                f'{bag.path}: feedback of setpoint {following} was not recorded; record the run '
                'again (cnc-interp run PROGRAM --record BAG)'
            )
        columns = (chunk.positions, chunk.velocities, told.positions)
        rows = [np.reshape(column, (-1, chunk.axis_count)) for column in columns]
        if chunk.period != chunks[0].period or len({len(each) for each in rows}) != 1:
            raise InterpError(
                f'{bag.path}: setpoints and feedback do not fit; record the run again'
            )
        parts.append(rows)
        following += len(rows[0])
    setpoint, rate, feedback = (np.concatenate(column) for column in zip(*parts, strict=True))
    plans = [np.full(len(chunk.sequences), chunk.plan) for chunk in chunks]
    return RecordedFeedback(
        float(chunks[0].period), setpoint, rate, feedback,
        np.concatenate([np.asarray(chunk.sequences, dtype=np.int64) for chunk in chunks]),
        np.concatenate(plans), bool(chunks[-1].end_of_program), name,
    )  # fmt: skip
