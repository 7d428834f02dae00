"""Read setpoints and feedback of the last run in a bag; learn from a compensated run."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cnc_interp_msgs.msg import MachineState

from cnc_interp.client.bag import Bag
from cnc_interp.core import FloatArray, IntArray, InterpError
from cnc_interp.drives import learning
from cnc_interp.drives.compensation import Compensation, compensated_model
from cnc_interp.machine_model.machine import Machine
from cnc_interp.wire.run_messages import run_id_of


@dataclass(frozen=True)
class RecordedFeedback:
    period: float  #: Interpolation period [s].
    #: (K, n_axes) each: setpoint and its velocity, and measured position [m, rad, per s].
    setpoint: FloatArray
    rate: FloatArray
    feedback: FloatArray
    block: IntArray  #: (K,): Block of each setpoint; 0 outside the program.
    plan: IntArray  #: (K,): Number of the plan of each setpoint.
    complete: bool  #: Whether the last setpoint ends the program.
    program_id: str  #: Id of the run.


def recorded_feedback(bag: Bag, machine: str) -> tuple[RecordedFeedback, Machine]:
    """Return the last run with motion, including its approach, and the machine.

    Raises InterpError if nothing was executed, or if setpoints or feedback are incomplete.
    """
    # A message without positions only switches outputs.
    chunks = [m for m in bag.messages('executed_setpoints') if m.positions]
    if not chunks:
        raise InterpError(f'{bag.path}: nothing was executed in this bag; record a run')
    name = run_id_of(chunks[-1]).program_id
    mine = (m for m in bag.messages('axis_feedback') if m.program_id == name and m.positions)
    actual = {m.first_sample: m for m in mine}
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
            raise InterpError(f'{bag.path}: setpoints and feedback differ; record the run again')
        parts.append(rows)
        following += len(rows[0])
    setpoint, rate, feedback = (np.concatenate(column) for column in zip(*parts, strict=True))
    loaded = Machine.load(machine)
    if setpoint.shape[1] != len(loaded.axis_names):
        raise InterpError(f'{bag.path}: was recorded on a machine with other axes than {machine}')
    plans = [np.full(len(chunk.sequences), chunk.plan) for chunk in chunks]
    return RecordedFeedback(
        float(chunks[0].period),
        setpoint,
        rate,
        feedback,
        np.concatenate([np.asarray(chunk.sequences, dtype=np.int64) for chunk in chunks]),
        np.concatenate(plans),
        bool(chunks[-1].end_of_program),
        name,
    ), loaded


#: Machine states during a run without a stop.
ON_ITS_WAY = (MachineState.IDLE, MachineState.RUNNING)
NAMES = ('machine', 'compensation', 'learnt')  #: Parameters of machine_node that are read.


@dataclass(frozen=True)
class Lesson:
    motion: learning.LearntMotion  #: What the drives use in the next run.
    #: Largest and mean error of the tip in this run [m].
    largest: float
    mean: float


def recorded_lesson(bag: Bag) -> Lesson:
    """Return what the drives can learn from the last run in a bag.

    Raises InterpError if the run was not compensated, or if it was interrupted or replanned.
    """
    told = {name: str(bag.parameters.get(f'machine_node.{name}', '')) for name in NAMES}
    name, model, learnt = (told[key] for key in NAMES)
    if not model:
        raise InterpError(
            f'{bag.path}: was recorded without compensation; record a run with --compensate MODEL'
        )
    run, machine = recorded_feedback(bag, name)
    known = compensated_model(model, machine)
    rows = _rows_of_program(bag, run)
    setpoint = learning.with_hold(run.setpoint[rows], run.period)
    feedback = run.feedback[rows][learning.start_of(run.setpoint[rows]) :]
    before = learning.learnt_for(Path(learnt), name, model, run.period) if learnt else None
    if before is not None and not np.array_equal(before.setpoint, setpoint):
        raise InterpError(
            f'{bag.path}: ran with {learnt}, which was learnt from other setpoints; learn from a '
            'run without --learnt'
        )
    lead = Compensation(known, run.period, setpoint[0]).lead
    tip = learning.measured_error(machine, run.period, lead, setpoint, feedback)[:, 0]
    error = np.array([[tip.max(), tip.mean()]])
    rate = None if before is None else before.rate
    rates = learning.learnt_rates(known, run.period, lead, setpoint, feedback, rate)
    motion = learning.LearntMotion(
        setpoint,
        rates,
        run.period,
        error if before is None else np.concatenate([before.error, error]),
        ' '.join(machine.axis_names),
        learning.hash_of(name),
        learning.hash_of(model),
    )
    return Lesson(motion, float(error[0, 0]), float(error[0, 1]))


def _rows_of_program(bag: Bag, run: RecordedFeedback) -> slice:
    """Return the rows of the program; InterpError if the run had a hold, stop or override."""
    if not run.complete:
        raise InterpError(f'{bag.path}: the run did not end as programmed; record a whole run')
    first = int(np.argmax(run.block > 0))
    whole = bool(np.all(run.block[first:] > 0) and np.all(run.plan[first:] == run.plan[-1]))
    for state in bag.messages('machine_state'):
        if state.program_id == run.program_id and state.sequence > 0:
            whole = whole and state.state in ON_ITS_WAY
            shares = {state.feed_override, state.rapid_override, state.spindle_override}
            whole = whole and shares == {1.0}
    if not whole:
        raise InterpError(
            f'{bag.path}: the run was held, stopped, or had an override; record one without'
        )
    return slice(first, len(run.block))
