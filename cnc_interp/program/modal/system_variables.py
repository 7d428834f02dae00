"""System variables: numbered as on Fanuc and LinuxCNC, or named as on LinuxCNC."""

from collections.abc import Mapping

from cnc_interp.core import DEG, MINUTE, MM
from cnc_interp.program.job import ALL_OFFSETS, WORK_OFFSETS, Tool
from cnc_interp.program.modal.state import ModalState
from cnc_interp.program.text.control_traits import HEIDENHAIN, LINUXCNC

#: Modal values in Fanuc's variables from #4001 on; machine positions from #5021 on.
_GROUPS = {
    4001: 'motion',
    4002: 'plane',
    4003: 'incremental',
    4005: 'feed_mode',
    4006: 'unit',
    4010: 'retract_to_start',
    4015: 'stop_always',
}
_STANDS = 5021


def numbered(state: ModalState, tool: int, cycle: str) -> dict[int, float]:
    """Return the values of the system variables, by number."""
    if state.dialect in (LINUXCNC, HEIDENHAIN):  # whose words Fanuc has no numbers for
        return _of_linuxcnc(state, tool)
    words, offset = state.active_codes(), state.setup.offset.split(' P')
    coded = {number: words[name] for number, name in _GROUPS.items() if name in words}
    coded |= {
        4007: state.radius_code or 'G40',
        4008: state.tcp if state.tcp.startswith('G43') else 'G43' * bool(state.frames.length),
        4009: cycle or 'G80',
        4012: 'G67',
        4013: 'G96' if state.by_surface_speed else 'G97',
        4014: offset[0],
        4016: state.frames.tilt_code or 'G69',
    }
    found = {number: float((word or 'G49')[1:]) for number, word in coded.items()}
    feed, size = state.feed_word, 1.0 if state.feed_mode == 'G93' else state.unit / MINUTE
    found |= {
        4109: max(feed, 0.0) / size,
        4119: state.spindle_speed,
        4120: float(tool),
        4130: float(offset[1]) if offset[1:] else 0.0,
        5081: 0.0,
        5082: 0.0,
        5083: state.frames.length / state.unit,
    }
    for letter, value in state.in_words(state.axis_positions()).items():
        found[_STANDS + 'XYZABC'.index(letter)] = value
    return found | _of_linuxcnc(state, tool)


def _of_linuxcnc(state: ModalState, tool: int) -> dict[int, float]:
    """Return the variables of LinuxCNC (#5161 to #5428) and of Fanuc (#5001 ..., #5041 ...)."""
    setup = state.setup
    found = {
        5210: float(setup.g92_on),
        5220: 1.0 + ALL_OFFSETS.index(setup.offset),
        5400: float(tool),
        5403: state.frames.length / state.unit,
        5410: 2.0 * setup.tools.get(tool, Tool()).worn.radius / state.unit,
    }
    letters = state.frames.letters
    machine = dict(zip(letters, [*state.zero.tolist(), 0.0, 0.0], strict=False))
    none = dict.fromkeys(letters, 0.0)
    positions = {5210: none | dict(setup.g92)}
    for index, name in enumerate(WORK_OFFSETS, start=1):
        positions[5200 + 20 * index] = machine | dict(setup.work_offsets.get(name, {}))
        found[5210 + 20 * index] = setup.rotation(name) / DEG
    for base, name in ((5160, 'G28'), (5180, 'G30')):
        positions[base] = none | dict(setup.reference_points.get(name, {}))
    here = dict(zip(letters, state.here().tolist(), strict=False))
    positions |= dict.fromkeys((5419, 5000, 5040), here)
    for base, position in positions.items():
        for letter in letters:
            i = 'XYZABC'.index(letter)
            size = state.unit if i < 3 else DEG
            found[base + 1 + i] = position[letter] / size
    return found | state.probed


def named(
    state: ModalState, tool: int, chosen: int, outputs: Mapping[str, str]
) -> dict[str, float]:
    """Return the named parameters that LinuxCNC sets itself, as ``<_X>``."""
    here, machine = (state.in_words(place) for place in (state.here(), state.axis_positions()))
    motion = state.motion if state.motion is not None else 80
    found = {
        'METRIC': state.unit == MM,
        'IMPERIAL': state.unit != MM,
        'ABSOLUTE': not state.incremental,
        'INCREMENTAL': state.incremental,
        'INVERSE_TIME': state.feed_mode == 'G93',
        'UNITS_PER_MINUTE': state.feed_mode == 'G94',
        'UNITS_PER_REV': state.feed_mode == 'G95',
        'PLANE': 10.0 * int(state.plane[1:]),
        'MOTION_MODE': 10.0 * motion,
        'CCOMP': 10.0 * float(state.radius_code[1:] or 40),
        'COORD_SYSTEM': 10.0 * float(state.setup.offset[1:].split()[0]),
        'TOOL_OFFSET': bool(state.frames.length),
        'RETRACT_OLD_Z': state.retract_to_start,
        'RETRACT_R_PLANE': not state.retract_to_start,
        'IJK_ABSOLUTE_MODE': state.centre_absolute,
        'LATHE_DIAMETER_MODE': False,
        'LATHE_RADIUS_MODE': True,
        'SPINDLE_RPM_MODE': not state.by_surface_speed,
        'SPINDLE_CSS_MODE': state.by_surface_speed,
        'SPINDLE_ON': outputs.get('spindle') in ('M3', 'M4'),
        'SPINDLE_CW': outputs.get('spindle') == 'M3',
        'MIST': outputs.get('mist') == 'M7',
        'FLOOD': outputs.get('coolant') == 'M8',
        'FEED': 0.0 if state.feedrate is None else state.feedrate * MINUTE / state.unit,
        'RPM': state.spindle_speed,
        'CURRENT_TOOL': tool,
        'SELECTED_TOOL': chosen,
        'LINE': state.flow.line_number,
        'CALL_LEVEL': state.flow.depth,
        'TASK': 0.0,
        'VALUE': state.flow.returned[0],
        'VALUE_RETURNED': state.flow.returned[1],
    }
    found |= here | {f'ABS_{letter}': value for letter, value in machine.items()}
    return {f'<_{name}>': float(value) for name, value in found.items()}
