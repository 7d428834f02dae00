"""The targets of single blocks, from their words and the modal state."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf, nan, pi

import numpy as np

from cnc_interp.core import DEG, MINUTE, MM, DependsOn, FloatArray, ProgramError
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.machine_entries import POSITIONERS
from cnc_interp.machine_model.signals import FOLLOWS, FREE, THREAD
from cnc_interp.program.blocks.functions import acting
from cnc_interp.program.geometry.arcs import FAULTS, PLANES, Corner
from cnc_interp.program.geometry.contact_normal import ContactPath, ToolShape
from cnc_interp.program.geometry.target_row import NO_ARC
from cnc_interp.program.modal.state import FARTHEST
from cnc_interp.program.motion.arc_targets import ArcTargets
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import LINUXCNC
from cnc_interp.program.text.words import BlockWords

NO_CORNER = Corner('', 0.0)
SAME_PLACE = 1e-12  #: Points that differ by less are the same [m].
SAME_AXIS = 1e-9  #: Two directions agree if their cosine is 1 within this [-].
_TWO_MEANINGS = (
    'machine coordinates with tool-tip programming on: axis positions on Fanuc, tip positions on '
    'LinuxCNC; switch it off first (TRAFOOF, G49)'
)
_SHORT = 1e-6  #: Distance from the end of travel at which a retract ends [m].
MOST_TURN = 1e3 * 360.0 * DEG
#: Shares of the contour tolerance while the tool length turns: of the gauge point, and of the
#: turn; chords use the rest [-].
OF_GAUGE_POINT, OF_TURN = 0.5, 0.4


class Mover(ArcTargets):
    corner = NO_CORNER  #: Corner at the end of the next line.
    #: A line held until the next one is read: corner, place in the text, start [m] and row.
    held: tuple[Corner, ProgramError, FloatArray, tuple[float, ...], int] | None = None

    def move(self, words: BlockWords, feed_given: bool, machine: bool = False) -> None:
        """Move to the position in the axis words of a block, and remove these words.

        ``machine``: whether they are machine coordinates (G53, G153, SUPA).
        """
        arc_words = self._take_arc(words)
        named = self._has_axes(words)
        if not named and arc_words is None and self._take_vector(words) is None:
            return
        if self.motion is None:
            raise self.fault('axis words before G0 or G1; write G0 or G1 first')
        self.refuse_if(
            self.leaves_contour and self.motion >= 2,
            'the motion after G40 must be a line; write G1 before the arc',
        )
        if self.targets.empty and self._begins_here(words):
            self.go(self.point, self.rotary, rapid=True)
        vector = self._vector_of(words, arc_words)
        if self.contact is not None:
            self.demand(
                arc_words is None, 'arcs have no contact normals; post lines', self.radius_code
            )
            self.contact.take(words, self.frames.turn, self._contact_fault)
        by_machine = self.machine_words(words) if machine else ''
        if machine:
            target, point = self.here(), self.machine_target(words)
        else:
            letters = words.values.keys() & set('XYZ')
            target = self.target(words)
            if (angle := dict(words.sets).get('ANG')) is not None:
                self._end_at_angle(target, letters, angle * DEG)
            point = self.frames.point(target[:3])
        rotary = self._rotary_target(words, target, machine)
        self._carry(words, machine, point)
        arc: tuple[float, ...] = NO_ARC
        if self.motion >= 2 and arc_words is not None:
            self.demand(
                not machine, 'arcs cannot be given in machine coordinates; write G0 or G1', 'G53'
            )
            arc = self._arc(target, arc_words)
        elif self.motion >= 2:
            raise self.fault(FAULTS[1])
        self.go(point, rotary, vector, arc, feed_given)
        if by_machine:
            self.switch_tcp(by_machine)

    def _begins_here(self, words: BlockWords) -> bool:
        """Return whether the first block is a cutting motion from the current tool position."""
        usual = 'IC' if self.incremental else ''
        letters = words.values.keys() & {'X', 'Y', 'Z', *self.rotary_letters}
        counts = any(words.ways.get(letter, usual) == 'IC' for letter in letters)
        return (self.motion == 1 and counts) or self.motion in (2, 3)

    def _end_at_angle(self, target: FloatArray, letters: set[str], angle: float) -> None:
        a, b, _ = PLANES[self.plane]
        given, wanted = (a, b) if 'XYZ'[a] in letters else (b, a)
        here, slope = self.here(), np.tan(angle) if given == a else 1.0 / np.tan(angle)
        self.demand(
            len({'XYZ'[a], 'XYZ'[b]} & letters) == 1 and abs(slope) < 1e9,
            'give one word of the end in the plane, not along the angle',
            'ANG',
        )
        target[wanted] = here[wanted] + (target[given] - here[given]) * slope

    def stand_at(self, q: FloatArray) -> None:
        if (arm := self.geometry.machine.arm) is not None:
            (point,), (axis,) = self.geometry.forward(q[None])
            self.extra[: len(arm.further)] = q[ARM:]
            self.go(point, self.rotary, axis, rapid=True)
            return
        own = 3 + len(self.rotary_letters)
        self.extra[: len(q) - own] = q[own:]
        rotary = q[3:own] if self.rotary_letters else self.rotary
        point = q[:3] - self.zero
        if self.tcp:
            stands = np.concatenate([q[:3] + self.extra @ self._along, rotary])
            point = self.geometry.forward(stands[None])[0][0]
        self.named, self.rotary = float(bool(self.rotary_letters)), rotary
        self.aim()
        self.go(point, rotary, rapid=True)

    def go_to(self, place: FloatArray, feed_given: bool = True, rapid: bool | None = None) -> None:
        """Add a target in program coordinates, shape (5,) [m, rad]."""
        rotary = place[3:] + self.frames.rotary_origin if self.rotary_letters else self.rotary
        self.go(self.frames.point(place[:3]), rotary, feed_given=feed_given, rapid=rapid)

    def draw_back(self, distance: float | None, feed: float) -> None:
        """Retract the tool by ``distance`` [m] or to the end of travel; ``feed`` 0: a rapid."""
        self.rotary_of_vector()
        tips = np.stack([self.tool_axis, np.zeros(3), self.point])
        top, tip, q = self.geometry.linear(tips, np.tile(np.nan_to_num(self.rotary), (3, 1)))
        along = top - tip
        q = self.point + self.zero if self.by_axes else q - self.extra @ self._along
        low, high = self.geometry.machine.travel[:3].T
        moves = np.abs(along) > SAME_AXIS
        room = ((np.where(along > 0.0, high, low) - q) / np.where(moves, along, nan))[moves].min()
        if distance is None and not room < inf:
            raise self.fault(
                'no travel in the machine file limits the retract; write M140 MB 50', 'MB MAX'
            )
        distance = max(room - _SHORT, 0.0) if distance is None else distance
        point = self.point + distance * (along if self.by_axes else self.tool_axis)
        if self.targets.empty or not feed:
            self.turn_to(point, self.rotary)
            return
        kept, self.feedrate = self.feedrate, feed
        self.go(point, self.rotary, rapid=False)
        self.feedrate = kept

    def begin_radius(self, code: str, distance: float) -> None:
        self.demand(not self.targets.empty, 'move to a position beside the contour first', code)
        frame = self.frames.plane(*PLANES[self.plane][:2])
        self.refuse_if(
            (self.vector is not None or (self.rotary_letters and self.tcp))
            and abs(self.tool_axis @ frame[:, 2]) < 1.0 - SAME_AXIS,
            'the tool does not stand upright on the plane of the contour',
            code,
        )
        self.radius_code, self.radius_plane = code, self.plane
        if distance:
            told = self._tell_gouge if self.dialect is LINUXCNC else None
            self.targets.begin_radius(distance, frame, self.dialect.own_entry, told)

    def _tell_gouge(self, gouge: ProgramError) -> None:
        """Give a notice of a gouge so far along the contour that LinuxCNC does not detect it."""
        text = f'{gouge.message}; LinuxCNC does not look so far ahead'
        self.notices.once('gouge', gouge.line_number, f'WARNING: {text}')

    def begin_contact(self, code: str, cutter: ToolShape) -> None:
        """Treat the following points as cutter contact points (G41.2, G42.2)."""
        self.demand(not self.targets.empty, 'move to a position beside the part first', code)
        self.demand(
            not self.by_axes, f'needs tool-tip programming; write {codes.TCP_ON_WORDS}', code
        )
        self.demand(
            self.tcp != 'G43.5',
            'with G43.5 I J K are the tool direction; use G43.4, or A5= B5= C5=',
            code,
        )
        self.radius_code, self.radius_plane = code, self.plane
        self.contact = ContactPath(cutter)

    def _contact_fault(self, text: str) -> ProgramError:
        return self.fault(text, self.radius_code)

    def end_radius(self) -> None:
        """End the compensation here; after contact normals the next block ends as written."""
        self.end_corner()
        self.leaves_contour = bool(self.radius_code) and self.contact is None
        if self.contact is not None:
            self.contact, self.radius_code, self.radius_plane = None, '', ''
        elif self.radius_code:
            self.radius_code = self.radius_plane = ''
            stands = self.targets.end_radius()
            if self.dialect is not LINUXCNC:
                # Moves along the tool stay beside the contour. Others lead to programmed places.
                self.beside, self.point = stands - self.point, stands

    def turn_to(self, point: FloatArray, rotary: FloatArray) -> None:
        """Add a rapid as if axis words commanded it; before any motion, set the start instead."""
        self.named = float(bool(self.rotary_letters))
        if self.targets.empty:
            self.point, self.rotary = point, rotary
            self._turn_length()
        else:
            self.go(point, rotary, rapid=True)

    def act(self, word: str, given: Mapping[str, float]) -> None:
        signals = self.geometry.machine.signals
        for moment in acting(signals, [word], given, self.fault):
            for step in moment:
                self.targets.change(step, self.flow.main_line)

    def in_step(self, code: str, point: FloatArray, pitch: float, comes_back: bool) -> None:
        """Move to a point, or there and back, in step with the spindle; ``pitch`` per turn [m]."""
        self.refuse_if(
            self.by_surface_speed or not self.spindle_speed > 0.0,
            'needs S, the speed in rev/min',
            code,
        )
        self.demand(
            self.vector is None,
            'needs a tool axis given by rotary words before, not by a direction',
            code,
        )
        start, rotary = self.point, self.rotary
        way = point - start
        if self.tcp:
            ends = np.stack([start, point]), np.tile(rotary, (2, 1))
            way = np.diff(self.geometry.linear(*ends), axis=0)[0]
        turns = float(np.linalg.norm(way)) / pitch
        self.demand(turns > 0.0, 'needs a motion', code)
        told = *way / turns / MM, -turns if comes_back else turns
        self.act(FOLLOWS, dict(zip(THREAD, told, strict=True)))
        kept = self.feed_mode, self.feedrate
        self.feed_mode, self.feedrate = 'G94', pitch * self.spindle_speed / MINUTE
        for place in (point, start)[: 1 + comes_back]:
            self.go(place, rotary, rapid=False)
            self.targets.stop_here()
        self.feed_mode, self.feedrate = kept
        self.act(FREE, {})

    def _turn_length(self) -> None:
        """Make the tool length turn with the tool, so that the programmed tip stays in place."""
        frames = self.frames
        if self.tcp and frames.length and np.abs(self.tool_axis - frames.along).max() > SAME_AXIS:
            if self.held is not None or self.corner.size:
                raise self.fault(
                    'the corner cannot adjoin a turn of the tool; post it as moves', 'RND'
                )
            before = frames.along
            self.aim()
            self.point = self.point + frames.length * (frames.along - before)

    def _has_axes(self, words: BlockWords) -> bool:
        for letter in 'ABC':
            if letter in words.values and letter not in self.rotary_letters:
                axes = ' '.join(self.geometry.machine.axis_names)
                raise self.fault(
                    f'the machine has no axis {letter}, only {axes}; remove the word',
                    letter,
                    DependsOn.LINE,
                )
        letters = ('X', 'Y', 'Z', *self.rotary_letters, *self.extra_letters)
        return any(letter in words.values for letter in letters)

    def target(self, words: BlockWords) -> FloatArray:
        if self.beside is not None and not set('XYZ').isdisjoint(words.values):
            along = 'XYZ'[PLANES[self.plane][2]]
            if set('XYZ') & words.values.keys() != {along}:
                self.point, self.beside = self.point - self.beside, None
        here = self.here()
        target = here.copy()
        if self.polar:
            self._from_polar(words, here)
        for i, value in words.take(self.frames.letters).items():
            letter, size = self.frames.letters[i], self.unit if i < 3 else DEG
            way = words.ways.get(letter, 'IC' if self.incremental else '')
            if way == 'IC':
                target[i] = here[i] + self.shifted[i] + value * size
            else:
                target[i] = value * size
                self.placed.add(letter)
            if i >= 3:
                target[i] = self._turned(float(here[i]), float(target[i]), way)
            self.shifted[i] = 0.0
        return target

    def _from_polar(self, words: BlockWords, here: FloatArray) -> None:
        a, b, _ = PLANES[self.plane]
        letters = 'XYZ'[a], 'XYZ'[b]
        if words.values.keys().isdisjoint(letters):
            return
        if self.incremental and letters[0] in words.values:
            raise self.fault(
                'under G91 the radius of G16 counts from the tool; write it with G90',
                words.texts[letters[0]],
            )
        radius, angle = np.hypot(here[a], here[b]), np.arctan2(here[b], here[a])
        radius = words.values.get(letters[0], radius / self.unit)
        if letters[1] in words.values:
            angle = angle * self.incremental + words.values[letters[1]] * DEG
        for letter, value in zip(letters, (np.cos(angle), np.sin(angle)), strict=True):
            words.values[letter], words.ways[letter] = float(radius * value), 'AC'

    def extra_target(self, words: BlockWords, machine: bool) -> FloatArray:
        target = self.extra.copy()
        for i, value in words.take(self.extra_letters).items():
            letter = self.extra_letters[i]
            way = words.ways.get(letter, 'IC' if self.incremental and not machine else '')
            size = DEG if letter in POSITIONERS else self.unit
            target[i] = value * size + (target[i] if way == 'IC' else 0.0)
            self.demand(
                abs(target[i]) <= FARTHEST, 'a coordinate beyond 100,000 mm', f'{letter}{value:g}'
            )
        return target

    def _carry(self, words: BlockWords, machine: bool, point: FloatArray) -> None:
        before, self.extra = self.extra, self.extra_target(words, machine)
        turned = np.flatnonzero(self.extra != before)
        rests = not self.motion or (np.abs(point - self.point) > SAME_PLACE).any()
        for letter in [] if rests else [self.extra_letters[k] for k in turned]:
            self.refuse_if(
                letter in POSITIONERS, 'F has no meaning while the tip rests; write G0', letter
            )

    def _turned(self, here: float, angle: float, way: str) -> float:
        if way == 'DC' or (self.settings.rotary_sense == 'shortest' and way in ('', 'AC')):
            return angle - 2.0 * pi * round((angle - here) / (2.0 * pi))
        if way == 'ACP':
            return here + (angle - here) % (2.0 * pi)
        if way == 'ACN':
            return here - (here - angle) % (2.0 * pi)
        return angle

    def machine_words(self, words: BlockWords) -> str:
        """Decide the meaning of machine coordinates while X Y Z are tool tips.

        If they are axis positions, switch tool-tip programming off, and return the word that
        switches it on again.
        """
        turned = self.vector is not None or bool(self.rotary.any() or self.extra.any())
        turned = turned or any(words.values.get(letter) for letter in self.rotary_letters)
        if self.tcp and turned:
            self.refuse_if(not self.dialect.is_sure or self.oriented, _TWO_MEANINGS)
            if self.dialect.machine_axes:
                word = self.tcp
                self.switch_tcp('')
                return word
        if not self.rotary_letters and not self.zero.any():
            self.notice('machine coordinates', 'on this machine their zero is the workpiece zero')
        return ''

    def machine_target(self, words: BlockWords) -> FloatArray:
        point = self.point.copy()
        for i, value in words.take('XYZ').items():
            self.shifted[i] = 0.0
            point[i] = value * self.unit - self.zero[i]
        return point

    def _rotary_target(self, words: BlockWords, target: FloatArray, machine: bool) -> FloatArray:
        if not self.rotary_letters:
            return self.rotary
        rotary = target[3:] + self.frames.rotary_origin
        if machine:
            for i, value in words.take(self.rotary_letters).items():
                rotary[i] = value * DEG
                self.named = 1.0
        elif any(letter in words.texts for letter in self.rotary_letters):
            self.named = 1.0
        return np.asarray(rotary)

    def go(
        self,
        point: FloatArray,
        rotary: FloatArray,
        vector: FloatArray | None = None,
        arc: tuple[float, ...] = NO_ARC,
        feed_given: bool = True,
        rapid: bool | None = None,
    ) -> None:
        """Add a target [m, rad]; ``vector``: from direction words; ``rapid`` None: by G0 to G3."""
        if self.rotary_letters and not np.abs(rotary).max() <= MOST_TURN:
            which = int(np.argmax(np.abs(rotary)))
            raise self.fault(
                'a rotary axis beyond 1000 turns; correct the angle',
                f'{self.rotary_letters[which]}{rotary[which] / DEG:g}',
            )
        rapid = self.motion == 0 if rapid is None else rapid
        self.leaves_contour = False
        feed = (inf, nan, inf) if rapid else self.feed(feed_given)
        self.tell_long_way(np.abs(rotary - self.rotary), rapid)
        if not (rapid or self.told_feed_of_turns or (rotary == self.rotary).all()):
            self.tell_feed_of_turns(point)
        before = self.point
        self.point, self.rotary = point, rotary
        if vector is not None:
            self.vector = vector
        elif self.named and self.vector is not None and not self.tcp:
            self.vector = None
        self._turn_length()
        place = self.point
        if self.contact is not None:
            place = self.contact.tip(place, self.tool_axis, not rapid, self._contact_fault)
        self.check_point(place)
        axis = (nan, nan, nan) if self.rotary_letters else (0.0, 0.0, 1.0)
        named, circle = self.named, self.on_great_circle
        if self.vector is not None:
            axis, named, circle = tuple(self.vector), 0.0, True
        feedrate, duration, turn_rate = feed
        row = (
            *place,
            *axis,
            *rotary,
            named,
            float(circle),
            feedrate,
            duration,
            rapid,
            self.stop_always or self.stop_once,
            *self.tolerances(),
            self.flow.main_line,
            self.axes_column,
            turn_rate,
            *arc,
            *self.extra,
        )
        self.targets.length = self.frames.length if self.tcp else 0.0
        if self.held is not None:
            before = self._make_corner(place, rapid or arc is not NO_ARC)
        corner, self.corner = self.corner, self.corner if self.corner.modal else NO_CORNER
        if corner.size and not rapid and arc is NO_ARC and not self.targets.empty:
            fault, changed = self.flow.fault('', corner.kind), self.targets.changed
            corner = replace(corner, size=corner.size * self._scale_in_plane(self.plane))
            self.held = corner, fault, before, row, changed
        elif corner.size and not corner.modal:
            raise self.fault('belongs at the end of a G1 line', corner.kind)
        else:
            self.targets.add(row)

    def tolerances(self) -> tuple[float, float]:
        """Return the tolerances of a target [m], smaller while the tool length turns."""
        if not (self.tcp and self.frames.length):
            return self.contour, self.orientation
        lever = abs(self.frames.length) / self.settings.flank_height
        return OF_GAUGE_POINT * self.contour, min(self.orientation, OF_TURN * self.contour / lever)

    def _make_corner(self, after: FloatArray, is_other: bool) -> FloatArray:
        assert self.held is not None
        corner, fault, before, row, changed = self.held
        self.held = None
        frame = self.frames.plane(*PLANES[self.plane][:2])

        def at_line(message: str, word: str) -> ProgramError:
            return ProgramError(message, fault.source, fault.line_number, word)

        vertex, joint = np.array(row[:3]), None
        if not (is_other and corner.modal):
            joint = corner.joint(before, vertex, vertex if is_other else after, frame, at_line)
        if joint is None:
            self.targets.add(row, changed)
            return np.array(row[:3])
        first, last, arc = joint
        self.targets.add((*first, *row[3:]), changed)
        self.targets.add((*last, *row[3:-10], *arc, *row[-3:]), changed)
        return last

    def switch_tcp(self, word: str) -> None:
        self.end_corner()
        super().switch_tcp(word)

    def end_corner(self) -> None:
        self.corner = NO_CORNER
        if self.held is not None:
            self._make_corner(self.point, is_other=True)

    def _take_arc(self, words: BlockWords) -> BlockWords | None:
        if self.motion is None or self.motion < 2:
            return None
        taken = BlockWords(g=[code for code in words.g if code in ('G2', 'G3')])
        for i, value in words.take('IJKRP').items():
            taken.values['IJKRP'[i]] = value
            taken.ways['IJKRP'[i]] = words.ways.get('IJKRP'[i], '')
        return taken if taken.values or self._has_axes(words) else None

    def _take_vector(self, words: BlockWords) -> tuple[float, float, float] | None:
        names = {name: value for name, value in words.sets if name in ('A3', 'B3', 'C3')}
        if names:
            return tuple(float(names.get(name, 0.0)) for name in ('A3', 'B3', 'C3'))  # type: ignore[return-value]
        if self.tcp == 'G43.5' and any(letter in words.values for letter in 'IJK'):
            return tuple(words.values.get(letter, 0.0) for letter in 'IJK')  # type: ignore[return-value]
        return None

    def _vector_of(self, words: BlockWords, arc_words: BlockWords | None) -> FloatArray | None:
        given = self._take_vector(words)
        if given is None:
            if any(letter in words.values for letter in self.rotary_letters):
                self.rotary_of_vector()
            return None
        if not self.tcp:
            why = 'a tool direction needs tool-tip programming'
            raise self.fault(f'{why}; write {codes.TCP_ON_WORDS}', 'A3')
        self.demand(
            not any(letter in words.values for letter in self.rotary_letters),
            'a tool direction and rotary words in one block; keep one of them',
        )
        if arc_words is None:
            words.take('IJK')
        length = float(np.linalg.norm(given))
        self.demand(length > 1e-6, 'the tool direction is zero; correct A3, B3, C3 or I, J, K')
        return np.asarray(self.frames.turn @ (np.array(given) / length))
