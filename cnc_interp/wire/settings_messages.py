"""Settings <-> the names and texts in goals, in ``loaded_program`` and in block 0."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1Block, LoadedProgram
from diagnostic_msgs.msg import KeyValue

from cnc_interp.core.errors import SettingsError
from cnc_interp.settings.option_kinds import Stage, choices
from cnc_interp.settings.options import Settings, texts_of, with_texts


def pairs_of(settings: Settings) -> list[KeyValue]:
    return [KeyValue(key=name, value=text) for name, text in texts_of(settings).items()]


def settings_from(pairs: Iterable[KeyValue], settings: Settings) -> Settings:
    """Return settings with the choices of a message; raises SettingsError on a bad one."""
    return with_texts(settings, ((pair.key, pair.value) for pair in pairs))


def goal_of(
    program: Path, settings: Settings, names: Collection[str] | None = None, text: str = ''
) -> RunProgram.Goal:
    """Return the goal that runs a program with settings: those of some names, or all."""
    wanted = [c for c in choices(settings) if names is None or c.name in names]
    pairs = [
        KeyValue(key=c.name, value=c.text_with_unit(getattr(settings, c.name))) for c in wanted
    ]
    return RunProgram.Goal(program=str(program), text=text, settings=pairs)


def settings_of_goal(goal: RunProgram.Goal, defaults: Settings) -> Settings:
    """Return the settings that a goal asks for: its fields unless 0 or empty, then its list.

    Raises SettingsError if a choice is unknown or not possible, belongs to the nodes and differs
    from theirs, or is only for `plan`.
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


def settings_of_block(block: G1Block, settings: Settings) -> Settings:
    """Return the settings of a run from its block 0; raises SettingsError on a bad one."""
    return replace(settings_from(block.settings, settings), flank_height=block.flank_height)


def loaded_program(program_id: str, name: str, text: str, settings: Settings) -> LoadedProgram:
    """Return the message about a program that is about to run; its path length is still open."""
    message = LoadedProgram(
        program_id=program_id, name=name, text=text, settings=pairs_of(settings)
    )
    for choice in choices(settings):
        if choice.name in message.get_fields_and_field_types():
            setattr(message, choice.name, choice.plain(getattr(settings, choice.name)))
    return message
