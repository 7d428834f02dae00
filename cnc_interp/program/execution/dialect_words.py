"""The table of all words: what each does in every dialect, and in which phase."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from cnc_interp.machine_model.signals import NUMBERED
from cnc_interp.program.execution import machine_words as machine
from cnc_interp.program.execution import motion_words as motion
from cnc_interp.program.execution import scaling_words as scaling
from cnc_interp.program.execution import setting_words as setting
from cnc_interp.program.execution import setup_words as setup
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.job import WORK_OFFSETS
from cnc_interp.program.modal.modal_words import MODES, SETTINGS
from cnc_interp.program.motion import bezier, probing
from cnc_interp.program.motion.tilted_plane import CODES as PLANE_CODES
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.words import BlockWords


class Phase(Enum):
    """Phase in which a word acts; within a phase, words act in the order of the block."""

    SET = 1  #: First: keys, then G codes, then M codes.
    AXES = 2  #: Takes the axis words of its block; at most one such word per block.
    MOVE = 3  #: Used by the motion of the block.
    END = 4  #: After the motion.


@dataclass(frozen=True)
class Word:
    act: Callable[[Execution, str, BlockWords], None]
    phase: Phase = Phase.SET
    #: Whether the word is allowed between G41 or G42 and G40, and in polar coordinates (G16).
    beside_contour: bool = True
    in_polar: bool = True
    takes_f: bool = False  #: Whether F in its block has another meaning than feed.


def _each(words: Iterable[str], act: Callable[..., None], **given: Any) -> dict[str, Word]:
    return {word: Word(act, **given) for word in words}


def _axes(words: Iterable[str], act: Callable[..., None], **given: bool) -> dict[str, Word]:
    return _each(words, act, phase=Phase.AXES, **{'beside_contour': False, **given})


_TCP = {
    **_each(codes.TCP_ON, setup.switch_tcp, beside_contour=False),
    **_each(codes.TCP_OFF, setting.switch_tcp_off, beside_contour=False),
}
_LENGTH = codes.LENGTH_CODES | {code for code in _TCP if code[0] == 'G'}

G: dict[str, Word] = {
    **_each(codes.HARMLESS_G, setting.no_effect),
    **_each(SETTINGS, setting.set_mode),
    **_each(MODES['polar'].codes, setting.begin_polar),
    **_each(WORK_OFFSETS, setup.choose_work_offset, beside_contour=False),
    **_each(('G54.1', 'G154'), setup.choose_extended_offset),
    **_each(_LENGTH, setup.tool_length, beside_contour=False),
    **_each(codes.RADIUS, setting.cutter_radius),
    **_each(codes.CYCLES, setting.begin_cycle, beside_contour=False),
    'G80': Word(setting.end_cycle),
    'G69': Word(setting.end_plane, beside_contour=False),
    'G53': Word(setting.nothing, Phase.MOVE, beside_contour=False),
    **_axes(('G4',), motion.dwell, beside_contour=True, takes_f=True),
    **_axes(('G65',), setting.nothing, beside_contour=True, takes_f=True),  # calls
    **_axes(('G10',), setup.write_setup),
    **_axes(('G28', 'G30'), setup.go_to_reference, in_polar=False),
    **_axes(('G28.1', 'G30.1'), setup.keep_reference),
    **_axes(('G52',), setup.shift_frame),
    **_axes(('G51', 'G51.1', 'G50', 'G50.1'), scaling.scale_or_mirror),
    **_axes(('G92',), setup.preset),
    **_axes(('G92.1', 'G92.2', 'G92.3'), setup.suspend_preset),
    **_axes(PLANE_CODES, motion.tilt),
    **_axes(('G53.3',), motion.tilt, in_polar=False),
    **_axes(('G32',), motion.thread, in_polar=False, takes_f=True),
    **_axes(('G33', 'G33.1'), motion.thread, in_polar=False),
    **_axes((codes.THREAD_CYCLE,), motion.thread),
    **_axes(probing.CODES, motion.probe),
    **_axes(('G31',), motion.probe, in_polar=False),
    **_each(codes.REFUSED_G, setting.refuse),
    'G8': Word(setting.look_ahead),
    **_axes(bezier.CODES, motion.spline, beside_contour=True),
}

M: dict[str, Word] = {
    **_each(codes.REFUSED_M, machine.refuse_function),
    **_each(codes.STATE_M, machine.save_or_restore),
    **_each((*NUMBERED, 'M66'), machine.numbered_function),
    **{code: word for code, word in _TCP.items() if code[0] == 'M'},
    **{code: Word(setting.nothing, Phase.END) for code in codes.ACTING_M},
}

#: Words of several letters; Siemens cycles are handled earlier (``motion/cycles.py``).
KEYS: dict[str, Word] = {
    **_each(codes.HARMLESS_KEYS, setting.idle_key),
    **_each(MODES['great_circle'].codes, setting.choose_interpolation),
    **_TCP,
    **_each(('TRANS', 'ATRANS', 'ROT', 'AROT'), setting.turn_frame, beside_contour=False),
    **_each(scaling.KEYS, scaling.scale_or_mirror_frame, beside_contour=False),
    **_each(('SUPA', 'G153'), setting.use_machine_coordinates, beside_contour=False),
    'CYCLE832': Word(setting.high_speed_settings),
    'CYCLE800': Word(setting.swivel, beside_contour=False),
    **_each(codes.RADIUS_KEYS, setting.choose_compensation),
    'BSPLINE': Word(setting.nothing, Phase.MOVE, beside_contour=False),
}

OTHER_G, OTHER_M = Word(setting.refuse), Word(machine.machine_function)
NOT_BESIDE_CONTOUR = {
    name for table in (G, M, KEYS) for name, word in table.items() if not word.beside_contour
}
