"""The modal state of a program: position, frames, feed and tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf, nan

import numpy as np

from cnc_interp.core import DEG, INCH, MINUTE, MM, FloatArray, ProgramError
from cnc_interp.machine_model.signals import FOLLOWS
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks.block_modes import NONE, ActiveModes
from cnc_interp.program.blocks.targets import TargetColumns
from cnc_interp.program.geometry.contact_normal import ContactPath
from cnc_interp.program.geometry.frames import Frames
from cnc_interp.program.geometry.target_row import COMBINED, extra_directions
from cnc_interp.program.job import JobSetup, SetupChange
from cnc_interp.program.modal.modal_words import MODES, ModalValues
from cnc_interp.program.notices import Notices
from cnc_interp.program.text.control_traits import FANUC, HEIDENHAIN, LINUXCNC, PLAIN
from cnc_interp.program.text.flow import Flow
from cnc_interp.settings.options import Settings

FARTHEST = 1e5 * MM
#: Below this F with G93 [1/min], a notice states the duration, which is over an hour.
SLOWEST = 1.0 / 60.0
#: Value of ``tcp`` while the tool is upright on a tilted plane.
ORIENTED = 'G53.1'
#: A larger turn of a rotary axis in one cutting block gives a notice [rad].
LONG_WAY = 180.0 * DEG + 1e-9
_LEAST_SCALE, _MOST_SCALE = 1e-3, 1e3  #: Limits of scales [-].
#: A smaller tilt of a plane is not shown [rad].
UPRIGHT = 1e-9
LENGTH_WITH_TCP = (
    'on LinuxCNC the tool length of tool-tip programming belongs in the machine file '
    '(tip_to_secondary_pivot_mm); set the length in the setup to 0'
)
NO_F = 'no feedrate (F) before the first G1; write F, or choose one (settings, --feed)'
NO_NEW_F = 'no feedrate (F) after the change of feed mode (G93, G94, G95); write F'


_RECORDED = tuple(name for name, mode in MODES.items() if mode.recorded)
_SHOWN = {name: mode.codes for name, mode in MODES.items() if mode.codes and mode.shown}


def words_of_state(state: ModalState) -> list[str]:
    """Return the words that set the modal state where a run starts."""
    words, frames, feed = state.active_codes(), state.frames, state.feedrate
    turning, polar = words.pop('great_circle', ''), words.pop('polar', '')
    if words['stop_always'] == 'G64' and state.contour != state.settings.contour_tolerance:
        words['stop_always'] = f'G64 P{state.contour / state.unit:.9g}'
    length = f'G43.1 Z{frames.length / state.unit:g}' if frames.length else ''
    found = [*words.values(), state.setup.active, *frame_words(frames, state.unit), length]
    found += scale_words(frames, state.unit)
    found += [state.tcp, state.radius_code, polar, turning]
    if feed is not None and state.feed_mode != 'G93':
        found.append(f'F{feed * MINUTE / state.unit:g}')
    return [word for word in found if word]


def scale_words(frames: Frames, unit: float) -> list[str]:
    words = [f'{"XYZ"[i]}{place / unit:.9g}' for i, place in sorted(frames.mirrors.items())]
    found = [f'G51.1 {" ".join(words)}'] if words else []
    if (frames.scale != 1.0).any():
        centre = (f'{x}{v / unit:.9g}' for x, v in zip('XYZ', frames.scale_centre, strict=True))
        scale = (f'{x}{v:.9f}' for x, v in zip('IJK', frames.scale, strict=True))
        found.append(f'G51 {" ".join((*centre, *scale))}')
    return found


def frame_words(frames: Frames, unit: float) -> list[str]:
    turn = frames.programmed_turn
    rotated = bool(np.any(turn != np.eye(3)))
    if not rotated and not frames.shift.any():
        return []
    places = ' '.join(
        f'{letter}{value / unit:.9g}' for letter, value in zip('XYZ', frames.shift, strict=True)
    )
    if not rotated:
        return [f'TRANS {places}']
    tilt = np.arccos(np.clip(turn[2, 2], -1.0, 1.0))
    if tilt > UPRIGHT:
        first = np.arctan2(turn[0, 2], -turn[1, 2]), tilt, np.arctan2(turn[2, 0], turn[2, 1])
    else:
        first = np.arctan2(turn[1, 0], turn[0, 0]), 0.0, 0.0
    angles = ' '.join(
        f'{letter}{angle / DEG:.9g}' for letter, angle in zip('IJK', first, strict=True)
    )
    return [f'G68.2 {places} {angles}']


class ModalState(ModalValues):
    def __init__(
        self,
        geometry: Transform,
        settings: Settings,
        setup: JobSetup,
        flow: Flow,
        notices: Notices,
    ):
        super().__init__()
        self.geometry, self.settings, self.setup = geometry, settings, setup
        self.flow, self.notices = flow, notices
        self.fault, self.demand, self.refuse_if = flow.fault, flow.demand, flow.refuse_if
        self.targets = TargetColumns(geometry, settings, flow.main.name)
        self.probed: dict[int, float] = {}  # variables of the last probe
        self.extra_letters = tuple(geometry.machine.extra_names)
        self.rotary_letters = geometry.machine.rotary_names
        self.turns = not geometry.machine.is_linear.all()  # whether the tool can be turned
        self.dialect = PLAIN
        self.unit = INCH if settings.units == 'inch' else MM
        self.centre_absolute = settings.arc_centres == 'absolute'
        #: -1 if I J K lead from the centre of an arc to its start, else 1.
        self.centre_sense = -1.0 if settings.arc_centres == 'reversed' else 1.0
        #: Whether the meaning of I J K is still unknown, so that the first arc may determine it;
        #: that arc is rejected after all unless two more arcs agree.
        self.centres_open = settings.arc_centres == 'auto'
        self.lone_arc: ProgramError | None = None
        self.agreeing = 0
        #: I J K and R of the last arc [m], which some posts do not repeat.
        self.last_centre, self.last_radius = np.full((1, 3), nan), nan
        self.great_circle = settings.interpolation == 'vector' or not self.rotary_letters
        #: G41 or G42, and the plane of the compensation; empty if it is off.
        self.radius_code = self.radius_plane = ''
        #: Whether G41 and G42 compensate along normals (CUT3DF), and the path being compensated.
        self.along_normals = False
        self.contact: ContactPath | None = None
        self.feedrate = settings.feedrate
        self.turn_rate = nan if self.feedrate is None else self.feedrate / MM * DEG
        self.contour = settings.contour_tolerance
        self.orientation = settings.orientation_tolerance
        # Position: a point (frames.py) [m], rotary axes [rad], whether words named them.
        #: Work offsets and tools of the setup that the program uses.
        self.used: set[str] = set()
        self.last_offset = setup.offset
        self.zero = geometry.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
        self.frames = Frames(setup, self.zero, self.rotary_letters)
        self.point = np.zeros(3)
        self.rotary = np.zeros(2) if self.rotary_letters else np.full(2, nan)
        self.named = 0.0
        #: Shifts of new frames that the next incremental words must include [m, rad].
        self.shifted = np.zeros(5)
        #: Offset of the tool from the programmed position after G40 [m]; None if there is none.
        self.beside: FloatArray | None = None
        self.leaves_contour = False  # whether the next motion leads away from a contour
        #: Positions of the extra axes, measured from their machine zero [m or rad].
        self.extra = self.targets.extra_start.copy()
        self._along = extra_directions(geometry.machine)
        #: Tool axis from direction words; None if rotary words came later.
        self.vector: FloatArray | None = None
        self.told_feed_of_turns = False
        #: Vector with which a spline G5 without I J begins, and end of the spline before it [m].
        self.spline_goes_on = np.full((2, 3), nan)
        #: Letters of the axes programmed since the last rejected line.
        self.placed: set[str] = set()

    def begin_targets(self) -> None:
        settings = replace(self.settings, from_line=0)
        self.targets = TargetColumns(self.geometry, settings, self.flow.main.name)

    def follow(self, before: ModalState) -> None:
        self.probed = dict(before.probed)
        for name, mode in MODES.items():
            if mode.kept:
                setattr(self, name, getattr(before, name))
        self.frames.follow(before.frames)

    def saved_values(self) -> dict[str, object]:
        values = {name: getattr(self, name) for name, mode in MODES.items() if mode.saved}
        return {**values, 'offset': self.setup.offset, 'length': self.frames.length}

    def restore_values(self, values: Mapping[str, object]) -> None:
        if values['tcp'] != self.tcp:
            self.switch_tcp(str(values['tcp']))
        for name in values.keys() & MODES.keys():
            setattr(self, name, values[name])
        self.frames.length = float(str(values['length']))
        self.aim()

    def recorded_values(self) -> tuple[object, ...]:
        frames = self.frames
        values = (getattr(self, name) for name in _RECORDED)
        return (*values, self.radius_code, self.setup.offset, *frames.shifts, frames.counts)

    def active_modes(
        self, cycle: str, offset: str, tool: int, outputs: Mapping[str, str]
    ) -> ActiveModes:
        codes = self.active_codes()
        codes.pop('motion', None)  # each block has its own
        turning, polar = codes.pop('great_circle', ''), codes.pop('polar', '')
        length = self.tcp or ('G43' if self.frames.length else 'G49')
        before = cycle, self.radius_code, *codes.values(), offset, *self.frames.shifts
        found = (*before, length, polar, turning, *outputs.values())
        shown = tuple(code for code in found if code)
        numbers = self.contour, self.orientation, self.spindle_speed, tool
        frame = self.frames.coordinates(offset, bool(self.tcp), len(self.rotary_letters))
        return ActiveModes(shown, *numbers, frame=frame)

    @property
    def feed_word(self) -> float:
        """The last F: feedrate [m/s], with G95 [m per rev/min], with G93 [1/min], or ``NONE``."""
        value = self.blocks_per_minute if self.feed_mode == 'G93' else self.feedrate
        return NONE if value is None else value

    def active_codes(self) -> dict[str, str]:
        """Return the active words of modal values, by name, in the order of the table."""
        found = {}
        for name, words in _SHOWN.items():
            value = getattr(self, name)
            if code := next((code for code, sets in words.items() if sets == value), ''):
                found[name] = code
        if not self.rotary_letters:
            del found['great_circle']
        return found

    def notice(self, key: str, text: str) -> None:
        self.notices.once(key, self.flow.line_number, f'{key}: {text}')

    def change(self, change: SetupChange) -> None:
        if change.field == 'active' and not self.targets.empty:
            self.used.add(self.setup.offset)
        if change.field == 'active' and change.value:
            self.last_offset = change.value
        after = self.setup.changed(change)
        if after != self.setup:
            self.setup = after
            self.frames.take(after)
            self.targets.change(change, self.flow.main_line)

    def demand_no_scale(self, word: str, axis: int | None = None) -> None:
        """Reject a word whose meaning is unclear while axes are mirrored or scaled."""
        if self.frames.scales and (axis is None or self.frames.factor[axis] != 1.0):
            ends = 'G50 and G50.1'
            if self.dialect is HEIDENHAIN:
                ends = 'CYCL DEF 8.1 without axes, 11.1 SCL 1, or 26.1 with factors of 1'
            raise self.fault(f'axes are mirrored or scaled; write {ends} first', word)

    def scale_of(self, value: float, word: str) -> float:
        self.demand(
            _LEAST_SCALE <= abs(value) <= _MOST_SCALE,
            f'a scale must be from {_LEAST_SCALE:g} to {_MOST_SCALE:g}',
            word,
        )
        return value

    @property
    def by_axes(self) -> bool:
        """Whether axis words are axis positions: with rotary or extra axes, but without TCP."""
        by_words = bool(self.rotary_letters or self.extra_letters) and not self.tcp
        return by_words and self.geometry.machine.arm is None

    @property
    def axes_column(self) -> float:
        """Return the value of the column AXES; on Fanuc, degrees count as millimetres of F."""
        return COMBINED if self.by_axes and self.dialect is FANUC else float(self.by_axes)

    def tell_feed_of_turns(self, point: FloatArray) -> None:
        if self.by_axes and self.dialect is PLAIN and (point != self.point).any():
            self.told_feed_of_turns = True
            self.notice(
                'F in lines with rotary motion',
                'the speed of X Y Z, as on LinuxCNC; on Fanuc degrees count as millimetres of '
                'travel, so --dialect fanuc takes longer',
            )

    @property
    def tool_axis(self) -> FloatArray:
        """Unit tool axis in W at the current rotary positions, or of direction words, (3,)."""
        if self.vector is not None:
            return self.vector
        if not self.rotary_letters:
            return np.array([0.0, 0.0, 1.0])
        return np.asarray(self.geometry.tool_axis(self.rotary[None])[0])

    @property
    def on_great_circle(self) -> bool:
        return self.great_circle and not (self.by_axes and self.rotary_letters)

    def here(self) -> FloatArray:
        """Return the position in program coordinates, shape (5,) [m, rad]."""
        rotary = self.rotary - self.frames.rotary_origin
        return np.concatenate([self.frames.program(self.point), rotary])

    def in_words(self, place: FloatArray) -> dict[str, float]:
        """Return a position, (5,) [m, rad], by axis letter, in program units and deg."""
        sizes = np.array([self.unit] * 3 + [DEG] * 2)
        return dict(zip(self.frames.letters, (place / sizes).tolist(), strict=False))

    def switch_tcp(self, word: str) -> None:
        """Switch tool-tip programming on by ``word``, or off if it is empty; no axis moves."""
        word = word or (ORIENTED if self.oriented else '')
        if bool(word) == bool(self.tcp):
            self.tcp = word
            return
        if word:
            self.check_length(word)
            if self.rotary_letters and (self.rotary.any() or self.extra.any()):
                stands = self.point + self.zero + self.extra @ self._along
                q = np.concatenate([stands, self.rotary])[None]
                self.point = self.geometry.forward(q)[0][0]
        else:
            self.rotary_of_vector()
            self.point = self.axis_positions()[:3] - self.zero
        self.tcp = word
        self.aim()

    def check_length(self, word: str) -> None:
        self.refuse_if(
            self.frames.length and (self.dialect is LINUXCNC or word == 'M428'),
            LENGTH_WITH_TCP,
            word,
        )
        if self.frames.length:
            self.notice(
                'WARNING: a tool length with tool-tip programming',
                'it is measured along the tool from the gauge point in the machine file '
                '(tip_to_secondary_pivot_mm), and uses part of the tolerances',
            )

    def aim(self) -> None:
        self.frames.along = self.tool_axis if self.tcp else np.array([0.0, 0.0, 1.0])
        self.frames.update()

    def set_oriented(self, oriented: bool) -> None:
        self.oriented = oriented and bool(self.rotary_letters)
        if self.tcp in ('', ORIENTED):
            self.switch_tcp('')

    def rotary_of_vector(self) -> None:
        """Convert the tool axis of direction words to the nearest rotary positions."""
        if self.vector is None or not self.rotary_letters:
            return
        upright = np.abs(np.cross(self.vector, self.geometry.five_axis.pole)).max() < UPRIGHT
        free = self.rotary if upright else None
        near = self.geometry.five_axis.branches(self.vector, self.rotary, free)
        self.demand(
            near, 'the machine cannot reach the tool axis; correct the tool direction', 'TRAFOOF'
        )
        self.rotary = min(near, key=lambda pair: float(np.abs(pair - self.rotary).sum()))
        self.targets.stand_at(self.rotary)
        self.vector = None

    def check_point(self, point: FloatArray) -> None:
        farthest = int(np.argmax(np.abs(point)))
        if not abs(point[farthest]) <= FARTHEST:
            raise self.fault(
                'a coordinate beyond 100,000 mm; correct it or its unit (G20, G21)',
                f'{"XYZ"[farthest]} {point[farthest] / self.unit:g}',
            )

    def tell_long_way(self, turned: FloatArray, rapid: bool) -> None:
        if rapid or not self.rotary_letters or self.targets.empty:
            return
        which = int(np.argmax(turned))
        if turned[which] > LONG_WAY and self.settings.rotary_sense == 'programmed':
            what = f'{self.rotary_letters[which]} turns by more than 180 deg in a cutting block'
            how = '--rotary-sense shortest takes the short way'
            self.notice(what, f'done as programmed; {how}')

    def feed(self, given: bool) -> tuple[float, float, float]:
        """Return feedrate [m/s], duration [s] and turn rate [rad/s] of a cutting block."""
        if self.targets.empty:
            return inf, nan, inf
        if self.feed_mode != 'G93':
            if self.feedrate is None:
                raise self.fault(NO_NEW_F if self.feed_changed else NO_F)
            if self.feed_mode == 'G94':
                return self.feedrate, nan, self.turn_rate
            self.demand(
                not self.by_surface_speed,
                'feed per revolution (G95) at a surface speed (G96); write G97 S',
                'G95',
            )
            if not self.spindle_speed > 0.0:
                raise self.fault(
                    'feed per revolution (G95) without a spindle speed; write S first', 'G95'
                )
            return self.feedrate * self.spindle_speed, nan, self.turn_rate * self.spindle_speed
        if self.blocks_per_minute is None:
            raise self.fault('no F in inverse-time feed (G93); give F in 1/min in each G1 block')
        if not given:
            self.notice('G93', 'a block without F keeps the last one')
        return nan, MINUTE / self.blocks_per_minute, nan

    def set_feed(self, value: float, word: str, unit: float) -> None:
        self.demand(0.0 < value < inf, 'the feedrate must be greater than zero', word)
        if self.feed_mode == 'G93':
            self.blocks_per_minute = value
            if value < SLOWEST:
                hours = f'{1.0 / (60.0 * value):.3g} h'
                self.notice('G93', f'{word} makes a block last {hours}; F is in blocks per minute')
        else:  # with G95 the unit is m per rev/min; the spindle speed converts it to m/s
            self.feedrate, self.turn_rate = value * unit / MINUTE, value * DEG / MINUTE

    @property
    def follows(self) -> bool:
        return FOLLOWS in self.geometry.machine.signals.words

    def tell_tapping(self, code: str) -> None:
        words = self.geometry.machine.signals.words
        told = 'feed in, feed out; the spindle is not synchronised'
        if self.follows:
            told = 'in step with the spindle; R must leave the axes room to get in step'
        elif {'M3', 'M4'} <= words.keys():
            told = 'for a floating holder: feed in, the spindle is reversed, feed out'
        self.notice(code, told)

    def axis_positions(self) -> FloatArray:
        """Return machine coordinates of X Y Z and the rotary axes, (5,) [m, rad]."""
        linear = self.point + self.zero
        if self.rotary_letters and self.tcp and (self.rotary.any() or self.extra.any()):
            linear = self.geometry.linear(self.point[None], self.rotary[None])[0]
            linear = linear - self.extra @ self._along
        return np.concatenate([linear, self.rotary])

    def why_not(self, letter: str) -> str:
        if letter in self.extra_letters:
            return f'{letter} moves in G0 and G1 blocks only; give it a block of its own'
        return f'the machine has no axis {letter}; remove the word'
