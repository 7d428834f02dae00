"""Messages about a whole run: its goal, machine reports, progress and result."""

import getpass
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from cnc_interp_msgs import msg
from cnc_interp_msgs.action import RunProgram
from diagnostic_msgs.msg import KeyValue

from cnc_interp.core import Refusal, SettingsError
from cnc_interp.program.blocks.block_modes import ActiveModes
from cnc_interp.program.geometry.program_coordinates import ProgramCoordinates
from cnc_interp.program.job import JobSetup, Position
from cnc_interp.run.run_phase import MachineReport
from cnc_interp.run.run_state import RunId, State
from cnc_interp.settings.option_kinds import Stage, choices
from cnc_interp.settings.options import Settings, texts_of, with_texts


def add_executed(result: RunProgram.Result, states: Sequence[msg.MachineState]) -> None:
    """Fill in the executed figures of a result; ``states``: last one of each program part."""
    for state in states:
        count, period = state.samples - state.approach_samples, state.interpolation_period
        result.cycle_time += max(0, count - 1) * period
        result.approach_time += state.approach_samples * period
        result.path_length += max(0.0, state.path_position)
        result.blocks_executed += state.sequence
        result.samples += count
        result.starvations += state.starvations
    result.positions = states[-1].commanded_positions
    result.least_buffered_time = min(state.least_buffered_time for state in states)
    result.contour_error = max(state.largest_contour_error for state in states)
    for told, name in (
        ('following_error', 'largest_following_error'),
        ('velocity_use', 'velocity_use'),
        ('acceleration_use', 'acceleration_use'),
        ('jerk_use', 'jerk_use'),
    ):
        setattr(result, told, np.max([getattr(state, name) for state in states], axis=0).tolist())


def run_feedback(state: msg.MachineState, path_length: float) -> RunProgram.Feedback:
    """Return the feedback message of a run; ``path_length``: length of the smoothed path [m]."""
    period = state.interpolation_period
    share = min(1.0, max(0.0, state.path_position / path_length))
    driven = (state.samples - state.approach_samples) * period
    left = driven * (1.0 - share) / share if share > 0.0 else math.nan
    return RunProgram.Feedback(
        sequence=state.sequence,
        line_number=state.line_number,
        progress=share,
        remaining_time=left,
        elapsed_time=state.samples * period,
    )


def in_program(state: msg.MachineState | None) -> bool:
    """Return whether a program or MDI line runs or is on hold, even if axes were jogged away."""
    if state is None:
        return False
    away = len(state.resume_positions) > 0
    return bool(state.state == msg.MachineState.RUNNING or state.may_resume or away)


def modal_state(modes: ActiveModes, program_id: str = '') -> msg.ModalState:
    fields = asdict(modes)
    return msg.ModalState(**fields.pop('frame'), **fields, program_id=program_id)


def coordinates_from(modes: msg.ModalState) -> ProgramCoordinates:
    return ProgramCoordinates(
        modes.coordinates, modes.of_tip, tuple(modes.origin), tuple(modes.turn), modes.length
    )


def run_id_of(message: Any) -> RunId:
    """Return the run id in a message. Messages without a field ``plan`` have plan 0."""
    return RunId(message.program_id, message.attempt, getattr(message, 'plan', 0))


#: Refusals by the machine that end a run with all its attempts and plans.
OF_PROGRAM = (Refusal.GIVEN_UP, Refusal.MACHINE_FAULT)


def ends(status: msg.StreamStatus, run_id: RunId) -> bool:
    """Return whether a status refuses the plan ``run_id``, or the whole run."""
    told = run_id_of(status)
    same_program = told.program_id == run_id.program_id and status.refusal_kind in OF_PROGRAM
    return bool(status.refusal_kind) and (told == run_id or same_program)


def setup_table(
    setup: JobSetup,
    file: str,
    zero: Mapping[str, float],
    program_id: str,
    in_use: Iterable[str],
    by: str,
    what: str,
) -> msg.SetupTable:
    """Return a setup as a message.

    ``zero``: workpiece zero of the machine file; ``program_id``: the run that uses this setup.
    """
    tools = [
        msg.Tool(number=number, length=tool.length, radius=tool.radius, remark=tool.remark)
        for number, tool in sorted(setup.tools.items())
    ]
    return msg.SetupTable(
        file=file,
        work_offsets=_offsets(setup.work_offsets),
        axes=list(zero),
        zero=list(zero.values()),
        active=setup.offset,
        g92=_offset('G92', setup.g92),
        g92_on=setup.g92_on,
        tools=tools,
        tool=setup.tool,
        reference_points=_offsets(setup.reference_points),
        program_id=program_id,
        in_use=sorted(in_use),
        changed_by=by,
        change=what,
        text=setup.text() if setup != JobSetup() else '',
    )


def _offsets(positions: Mapping[str, Position]) -> list[msg.Offset]:
    return [_offset(name, positions[name]) for name in sorted(positions)]


def _offset(name: str, position: Position) -> msg.Offset:
    return msg.Offset(name=name, axes=list(position), values=list(position.values()))


#: State without a number in the message -> state that is sent instead. All other states have
#: a number with the same name.
TOLD_AS = {
    State.PAUSED: State.RUNNING,
    State.FILLING: State.RUNNING,
    State.STARVING: State.STARVED,
    State.AWAY: State.JOGGING,
}
#: State -> its number in the message ``MachineState``.
NUMBERS = {state: getattr(msg.MachineState, TOLD_AS.get(state, state).name) for state in State}


def state_of(message: msg.MachineState) -> State:
    """Return the state in a message; an unknown number counts as motion."""
    if message.state == msg.MachineState.STARVED:
        return State.STARVED if message.resting else State.STARVING
    if message.state == msg.MachineState.RUNNING and message.resting:
        pauses = message.waits_for == msg.MachineState.WAITS_FOR_OVERRIDE
        return State.PAUSED if pauses else State.FILLING
    if message.state == msg.MachineState.JOGGING:
        return State.AWAY if len(message.resume_positions) else State.JOGGING
    found = (state for state, number in NUMBERS.items() if number == message.state)
    return next(found, State.RUNNING)


def machine_report(message: msg.MachineState) -> MachineReport:
    stamp = message.header.stamp
    same = ('plan_over', 'start_wanted', 'completed', 'path_position', 'message', 'functions')
    return MachineReport(
        run_id=run_id_of(message),
        state=state_of(message),
        stands=np.array(message.commanded_positions),
        time=stamp.sec + 1e-9 * stamp.nanosec,
        must_home=tuple(message.must_home),
        away=len(message.resume_positions) > 0,
        probed=message.reason == msg.MachineState.REASON_PROBE,
        **{name: getattr(message, name) for name in same},
    )


def pairs_of(settings: Settings) -> list[KeyValue]:
    return [KeyValue(key=name, value=text) for name, text in texts_of(settings).items()]


def settings_from(pairs: Iterable[KeyValue], settings: Settings) -> Settings:
    return with_texts(settings, ((pair.key, pair.value) for pair in pairs))


def goal_of(
    program: Path, settings: Settings, names: Collection[str] | None = None, text: str = ''
) -> RunProgram.Goal:
    """Return the goal that runs a program. It has all settings, or only those in ``names``."""
    wanted = [c for c in choices(settings) if names is None or c.name in names]
    texts = {c.name: c.text_with_unit(getattr(settings, c.name)) for c in wanted}
    pairs = [KeyValue(key=name, value=value) for name, value in texts.items()]
    who = user_name()
    return RunProgram.Goal(program=str(program), text=text, settings=pairs, operator_name=who)


def user_name() -> str:
    """Return the user name of this process; '' if it is unknown."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ''


def settings_of_goal(goal: RunProgram.Goal, defaults: Settings) -> Settings:
    """Return the settings of a goal: fields that are not 0 or empty, then its list of settings.

    All others are ``defaults``. Raises SettingsError if a setting is unknown or impossible, if it
    belongs to the nodes and differs from theirs, or if it is only for `plan`.
    """
    fields = goal.get_fields_and_field_types()
    given = {
        choice.name: choice.from_plain(getattr(goal, choice.name))
        for choice in choices(defaults)
        if choice.name in fields and getattr(goal, choice.name)
    }
    pairs = ((pair.key, pair.value) for pair in goal.settings)
    settings = with_texts(replace(defaults, **given), pairs, need_units=True)
    for choice in choices(defaults, Stage.MOTION, Stage.PLANNING, Stage.APPROACH):
        ours = getattr(defaults, choice.name)
        if getattr(settings, choice.name) != ours:
            told = f'the nodes were started with {choice.shown(ours)}; start them with another'
            raise SettingsError(choice.name, told)
    for choice in choices(defaults, Stage.OFFLINE):
        if getattr(settings, choice.name) != choice.default:
            raise SettingsError(choice.name, f'the nodes have only {choice.default}; use `plan`')
    return settings


def settings_of_block(block: msg.G1Block, settings: Settings) -> Settings:
    return replace(settings_from(block.settings, settings), flank_height=block.flank_height)


def loaded_program(program_id: str, name: str, text: str, settings: Settings) -> msg.LoadedProgram:
    message = msg.LoadedProgram(program_id=program_id, name=name, text=text)
    message.settings = pairs_of(settings)
    for choice in choices(settings):
        if choice.name in message.get_fields_and_field_types():
            setattr(message, choice.name, choice.plain(getattr(settings, choice.name)))
    return message
