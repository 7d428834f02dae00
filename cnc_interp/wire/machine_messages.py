"""Build the messages of machine_node: state, joints, and executed setpoints."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from cnc_interp_msgs import msg
from sensor_msgs.msg import JointState

from cnc_interp.machine.axis_motion import Recording
from cnc_interp.machine.playback import Executed, Playback
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import Signals
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.wire.path_messages import act_message, packed, setpoint_fields
from cnc_interp.wire.run_messages import NUMBERS


def joint_state(feedback: Recording, machine: Machine, stamp: Any) -> JointState:
    message = JointState(
        name=list(machine.joint_names),
        position=feedback.position[-1].tolist(),
        velocity=feedback.velocity[-1].tolist(),
    )
    message.header.stamp = stamp
    message.header.frame_id = 'base_link'
    return message


def executed_setpoints(
    playback: Playback, period: float
) -> list[tuple[msg.SetpointChunk, msg.AxisFeedback]]:
    """Return setpoints and feedback executed since the last call, numbered within the run."""
    stretches = [playback.executed.popleft() for _ in range(len(playback.executed))]
    queue = playback.switching.switched
    switched = [queue.popleft() for _ in range(len(queue))]
    plans = groupby(stretches, key=lambda executed: executed.run_id)
    found = [_executed_of_plan(list(executed), period) for _, executed in plans]
    signals, axes = playback.axes.machine.signals, len(playback.axes.machine.axis_names)
    for run_id, acts in groupby(switched, key=lambda act: act[0]):
        same = (chunk for chunk, _ in found if chunk.program_id == run_id.program_id)
        chunk = next(same, None)
        if chunk is None:  # set at rest: no setpoint was executed
            common = {**vars(run_id), 'period': period, 'axis_count': axes}
            chunk = msg.SetpointChunk(**common, first_sample=playback.plans.played)
            found.append((chunk, msg.AxisFeedback(**common, first_sample=playback.plans.played)))
        chunk.functions = [
            *chunk.functions,
            *(act_message(act, sample, signals) for _, act, sample in acts),
        ]
    return found


def followed_spindle(playback: Playback) -> Iterator[msg.FollowedSpindle]:
    """Yield the motion in step with the spindle since the last call: a message per source line."""
    found = [playback.followed.popleft() for _ in range(len(playback.followed))]
    for (run_id, block), parts in groupby(found, lambda each: (each.run_id, each.block)):
        each = list(parts)
        yield msg.FollowedSpindle(
            program_id=run_id.program_id,
            sequence=block,
            line_number=each[-1].line,
            ramp=each[-1].ramp,
            later=each[-1].later,
            angles=np.concatenate([part.angle for part in each]).tolist(),
            positions=packed(np.concatenate([part.position for part in each])),
        )


def _executed_of_plan(
    executed: list[Executed], period: float
) -> tuple[msg.SetpointChunk, msg.AxisFeedback]:
    first = executed[0]
    samples = Setpoints.concatenate([stretch.rows for stretch in executed])
    common = {
        **vars(first.run_id),
        'first_sample': first.number,
        'period': period,
        'axis_count': samples.position.shape[1],
    }
    actual = np.concatenate([stretch.actual for stretch in executed])
    setpoints = msg.SetpointChunk(
        **common,
        **setpoint_fields(samples),
        end_of_program=executed[-1].ends,
    )
    return setpoints, msg.AxisFeedback(**common, positions=packed(actual))


#: Fields of the message ``MachineState`` that are copied from ``RunState``.
OF_RUN = (
    'waits_for',
    'reason',
    'resting',
    'may_resume',
    'plan_over',
    'start_wanted',
    'completed',
)
OF_FIGURES = ('approach_samples', 'largest_contour_error', 'starvations')


def machine_state(playback: Playback, period: float) -> msg.MachineState:
    axes, run, feedback, figures = (
        playback.axes,
        playback.state,
        playback.feedback,
        playback.figures,
    )
    last = playback.last
    least = figures.least_buffered
    recent = axes.take_recent_use()
    speed, angle = playback.spindle.turning(playback.drives.inputs, playback.drives.outputs)
    message = msg.MachineState(
        **{name: getattr(run, name) for name in OF_RUN},
        **{name: getattr(figures, name) for name in OF_FIGURES},
        single_block=playback.single_block,
        **vars(playback.plans.run_id),
        functions=playback.switching.functions,
        state=NUMBERS[run.state],
        interpolation_period=period,
        samples=playback.plans.played,
        sequence=last.block if last else 0,
        line_number=last.line if last else 0,
        path_position=last.s if last else 0.0,
        resume_positions=axes.nominal(playback.plans.away).tolist(),
        positions=axes.nominal(feedback.position[-1]).tolist(),
        commanded_positions=axes.nominal(feedback.setpoint[-1]).tolist(),
        tip=feedback.tip[-1],
        axis=feedback.axis[-1],
        following_error=feedback.following_error[-1].tolist(),
        largest_following_error=figures.largest_following_error.tolist(),
        contour_error=float(feedback.contour_error[-1]),
        velocity_use=axes.largest_use[0].tolist(),
        acceleration_use=axes.largest_use[1].tolist(),
        jerk_use=axes.largest_use[2].tolist(),
        feedrate=float(feedback.feedrate[-1]),
        recent_velocity_use=recent[0].tolist(),
        recent_acceleration_use=recent[1].tolist(),
        recent_jerk_use=recent[2].tolist(),
        buffered_time=playback.plans.buffer.count * period,
        least_buffered_time=least * period if np.isfinite(least) else np.nan,
        spindle_speed=speed,
        spindle_angle=angle,
        message=run.text,
    )
    message.header.frame_id = 'workpiece'
    return message


def signals_message(
    signals: Signals, outputs: Sequence[float], inputs: Sequence[float]
) -> msg.MachineSignals:
    """Return outputs and inputs as a message. Numeric inputs are left out: they always change."""
    told = [k for k, signal in enumerate(signals.inputs) if not signal.is_number]
    return msg.MachineSignals(
        outputs=[signal.name for signal in signals.wires],
        output_values=list(outputs),
        output_is_number=[signal.is_number for signal in signals.wires],
        inputs=[signals.inputs[k].name for k in told],
        input_values=[inputs[k] for k in told],
    )
