"""Compare the executed setpoints of a run with everything else in its record.

Every executed setpoint must agree, bit for bit, with the next one that was sent to the machine, or
with the next one of the current stop tail. Motion by hand at a hold or after a stop is excluded,
because it was not sent as setpoints. Its limits are checked separately.
"""

from bisect import bisect_right
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import G1Block, MachineState, SetpointChunk

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_run import RecordedRun
from cnc_interp.client.sent_setpoints import SentSetpoints, rows_of
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.error_map import ErrorMap
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import FOLLOWS
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.wire.run_messages import run_id_of

#: Values of ``wait`` of chunks after which the machine waits for cycle_start.
OPERATOR_WAITS = (SetpointChunk.PROGRAM_STOP, SetpointChunk.OPTIONAL_STOP, SetpointChunk.APPROACH)
#: Tolerance of a contact position, because axes accelerate within its period [m, rad].
AT_CONTACT = 1e-6
S, BLOCK, LINE = -3, -2, -1  #: Columns of ``rows_of``.
#: A plan must use overrides that were reported at most this long before its setpoints [s].
OBEYED = 1.5


class Follower:
    """Compares executed setpoints with sent ones; ``faults`` has at most one fault per plan."""

    def __init__(self, sent: SentSetpoints):
        self._sent = sent
        self.faults: list[str] = []
        self.run_id = NO_RUN  #: Plan that is being executed.
        self.count = 0  #: Number of executed setpoints.
        #: Counts of executed setpoints at which the machine waited for cycle_start.
        self.waits: list[int] = []
        self.ended = False  #: Whether the last setpoint ends the program.
        self._number = 0  # of the next setpoint of the plan
        self._tail: FloatArray | None = None  # the rest of the stop tail
        self._by_hand = self._lost = False  # how far the plan is compared
        self._rests = True
        self._wait = SetpointChunk.NOTHING  # of the chunk whose last setpoint came

    def take(self, message: SetpointChunk) -> None:
        rows, run_id = rows_of(message), run_id_of(message)
        if run_id != self.run_id and len(rows):
            if self._by_hand and not self._rests and rows[0, BLOCK] == 0:
                self.run_id, self._number = run_id, 0  # void: the motion by hand continues
            else:
                self._begin(run_id)
        axes = message.axis_count
        while len(rows):
            if self._wait in OPERATOR_WAITS:
                self.waits.append(self.count)
            self._wait, self.ended = SetpointChunk.NOTHING, False
            taken = len(rows) if self._lost else self._step(rows)
            if taken:
                self._rests = not rows[taken - 1, axes : 2 * axes].any()
            self.count, rows = self.count + taken, rows[taken:]

    def _begin(self, run_id: RunId) -> None:
        joins = self._sent.joins.get(run_id)
        if joins is None:
            self._close()
        elif not self._lost and (self._number != joins or self._tail is not None):
            self._fault(f'plan {run_id.plan} did not join at setpoint {joins}')
        self.run_id, self._number = run_id, joins or 0
        self._tail, self._by_hand, self._lost = None, False, False

    def _close(self) -> None:
        """Check that the preceding plan ended at rest, with a complete stop tail if any."""
        if not self._lost and (not self._rests or (self._tail is not None and len(self._tail))):
            self._fault('the machine left it in motion')

    def close(self, cut: bool, at_rest: bool = False) -> None:
        if at_rest or not cut:
            self._close()
        if not (cut or self._lost or self.ended):
            self._fault('it did not reach the end that was sent')

    def _step(self, rows: FloatArray) -> int:
        """Return how many leading rows agree with one source; after 0, call again for the next."""
        if self._by_hand:
            by_hand = rows[:, BLOCK] == 0
            count = len(rows) if by_hand.all() else int(np.argmin(by_hand))
            if not count:
                self._fault('it continued after motion by hand, without a new plan', rows[0])
            return count
        if self._tail is not None:
            found, self._tail = self._tail, self._tail[len(rows) :]
            same = _leading(rows, found)
            if same < min(len(rows), len(found)):
                self._astray(rows[same])
            self._by_hand = not len(self._tail)
            return same
        message = self._sent.at(self.run_id, self._number)
        if message is not None:
            expected = rows_of(message)[self._number - message.first_sample :]
            same = _leading(rows, expected)
            self._number += same
            if same == len(expected):
                self._wait, self.ended = message.wait, message.end_of_program
            if same:
                return same
        self._tail = self._sent.tail(self.run_id, self._number, rows[0])
        if self._tail is None:
            # A plan that arrived meanwhile may be void: none of its setpoints is executed.
            self._by_hand = self._rests and self.count > 0 and rows[0, BLOCK] == 0
            if not self._by_hand:
                self._astray(rows[0])
        return 0

    def _astray(self, row: FloatArray) -> None:
        missing = self._sent.at(self.run_id, self._number) is None
        text = 'was not recorded as sent' if missing else 'differs from the setpoint sent'
        self._fault(f'setpoint {self._number} was executed, but {text}', row)

    def _fault(self, text: str, row: FloatArray | None = None) -> None:
        where = '' if row is None else f' (line {row[LINE]:.0f}, executed as number {self.count})'
        self.faults.append(f'plan {self.run_id.plan}: {text}{where}')
        self._lost = True


def _leading(rows: FloatArray, expected: FloatArray) -> int:
    """Return how many leading rows equal the expected ones."""
    n = min(len(rows), len(expected))
    if rows.shape[1] != expected.shape[1]:
        return 0
    same = (rows[:n] == expected[:n]).all(axis=1)
    return n if same.all() else int(np.argmin(same))


def faults_of(bag: Bag, run: RecordedRun, machine: Machine) -> list[str]:
    """Return all faults: executed setpoints against sent ones, and against machine reports."""
    sent = run.sent
    errors = Transform.of(machine).errors
    follower, told = Follower(sent), ToldStates(bag, run, errors)
    feedback = FeedbackRecord(bag, run, errors)
    for message in run.executed():
        rows = rows_of(message)
        told.compare(follower.count, rows, message.axis_count)
        settings = sent.settings.get(run_id_of(message))
        if settings is not None:
            told.compare_overrides(follower.count, rows, settings)
        feedback.compare(message)
        follower.take(message)
    follower.close(bool(run.cut), run.by_operator)
    faults = [*sent.faults, *follower.faults, *told.faults(follower, run), *feedback.faults]
    faults += _faults_of_functions(bag, run, machine)
    return [*faults, *_faults_of_program(bag, run)]


class ToldStates:
    """Recorded machine states; each must agree with the setpoints executed until then."""

    def __init__(self, bag: Bag, run: RecordedRun, errors: ErrorMap):
        self._errors = errors
        states = [m for m in bag.messages('machine_state') if m.program_id == run.program_id]
        self._states = sorted(states, key=lambda state: int(state.samples))
        self._next, self._threads = 0, bool(run.followed)  # the first state not compared yet
        self._obeyed = round(OBEYED / run.period)
        # What the machine reported before the run is valid until it reports something else.
        before = None
        for message in bag.messages('machine_state'):
            if message.program_id == run.program_id:
                break
            before = message
        told = self._states if before is None else [before, *self._states]
        self._told = [(s.feed_override, s.spindle_override) for s in told]
        self._told_at = [int(s.samples) for s in told]
        if before is not None:
            self._told_at[0] = 0
        self._too_fast = ''
        self._stops = [b.sequence for b in run.blocks if b.program_stop == G1Block.STOP]
        self._block = 0  # the last one of the program
        self._passed: list[tuple[int, int]] = []  # M0 by block, and setpoints executed then
        self._wrong: list[str] = []

    def compare(self, count: int, rows: FloatArray, axes: int) -> None:
        """Compare setpoints ``rows`` with the machine states reported during their execution."""
        for block, number in zip(*self._changes(rows[:, BLOCK], count), strict=True):
            if self._block > 0:
                crossed = [stop for stop in self._stops if self._block <= stop < block]
                self._passed += [(stop, number) for stop in crossed]
            self._block = max(self._block, block)
        while self._next < len(self._states):
            state = self._states[self._next]
            if state.samples > count + len(rows):
                return
            self._next += 1
            if state.samples <= count or len(state.resume_positions):
                continue  # before the first setpoint, or moved by hand away from the path
            row = rows[state.samples - count - 1]
            place = state.sequence, state.line_number, state.path_position
            same = place == (row[BLOCK], row[LINE], row[S])
            # In a thread the axes move, but their setpoints are counted only at its end.
            same &= self._threads or np.array_equal(
                state.commanded_positions, self._errors.nominal(row[None, :axes])[0]
            )
            if not same and not self._wrong:
                text = f'the machine_state after {state.samples} setpoints disagrees with'
                self._wrong.append(f'{text} the executed setpoint')

    def compare_overrides(self, count: int, rows: FloatArray, plan: OperatorSettings) -> None:
        """Check that a plan uses no larger overrides than those reported shortly before it."""
        first = max(bisect_right(self._told_at, count - self._obeyed) - 1, 0)
        last = bisect_right(self._told_at, count + len(rows))
        told = self._told[first:last]
        if self._too_fast or not told or not (rows[:, BLOCK] > 0).any():
            return
        names = ('feed', plan.override), ('spindle', plan.spindle)
        for (name, share), values in zip(names, zip(*told, strict=True), strict=True):
            if share > max(values):
                self._too_fast = (
                    f'line {rows[0, LINE]:.0f}: its plan has a {name} override of {share:.1%}, '
                    f'but in the {OBEYED:g} s before it the machine reported {max(values):.1%} '
                    'at most'
                )

    def _changes(self, block: FloatArray, count: int) -> tuple[list[int], list[int]]:
        at = np.flatnonzero(np.diff(block, prepend=self._block))
        return block[at].astype(int).tolist(), (at + count).tolist()

    def faults(self, follower: Follower, run: RecordedRun) -> list[str]:
        if not self._states:
            return ['the record has no machine_state of the run: its stops cannot be proven']
        held = {int(s.samples) for s in self._states if s.state == MachineState.HELD}
        stops = {number: f'line {run.blocks[stop].line_number}' for stop, number in self._passed}
        stops |= {number: f'setpoint {number}' for number in follower.waits if number not in stops}
        faults = [
            f'the machine did not wait for cycle_start after {place}'
            for number, place in stops.items()
            if number not in held
        ]
        faults += [self._too_fast] if self._too_fast else []
        if run.cut:
            return [*self._wrong, *faults]
        if {int(s.samples) for s in self._states if s.completed} != {follower.count}:
            faults.append('no machine_state completes the run with its last executed setpoint')
        if (counted := int(self._states[-1].samples)) > follower.count:
            text = f'a machine_state counts {counted} executed setpoints'
            faults.append(f'{text}, the record has {follower.count}')
        return [*self._wrong, *faults]


class FeedbackRecord:
    """Recorded actual positions: one for each executed setpoint, and those of probe contacts."""

    def __init__(self, bag: Bag, run: RecordedRun, errors: ErrorMap):
        self._errors = errors
        mine = bag.spooled('axis_feedback').where(lambda m: m.program_id == run.program_id)
        self._rows = mine
        self._places = {(run_id_of(m), m.first_sample): k for k, m in enumerate(mine)}
        contacts = (m for m in bag.messages('probe_contact') if m.program_id == run.program_id)
        self._contacts: list[Any] = [[m, np.inf] for m in contacts]
        self._last = np.zeros((0, 0))
        self._missing = -1

    def compare(self, message: SetpointChunk) -> None:
        count = len(message.sequences)
        place = self._places.get((run_id_of(message), message.first_sample))
        if not count:
            return
        positions = () if place is None else self._rows[place].positions
        if len(positions) != len(message.positions):
            self._missing = message.first_sample if self._missing < 0 else self._missing
            self._last = np.zeros((0, 0))
            return
        if not self._contacts:
            return
        rows = self._errors.nominal(np.reshape(positions, (count, -1)))
        way = np.concatenate([self._last, rows]) if len(self._last) else rows
        self._last = rows[-1:]
        for contact in self._contacts:
            point = np.asarray(contact[0].positions)
            if len(point) == way.shape[1]:
                contact[1] = min(contact[1], _distance(way, point))

    @property
    def faults(self) -> list[str]:
        lacks = f'the record lacks axis_feedback of executed setpoints from {self._missing} on'
        return ([lacks] if self._missing >= 0 else []) + [
            f'line {contact.line_number}: the axes never passed the recorded contact of the '
            f'probe ({distance:.3g} m or rad away from their path)'
            for contact, distance in self._contacts
            if not distance <= AT_CONTACT
        ]


def _distance(way: FloatArray, point: FloatArray) -> float:
    """Return the distance of a point from a polyline: its largest coordinate."""
    step = np.diff(way, axis=0, append=way[-1:])
    length = np.maximum((step**2).sum(axis=1), 1e-300)
    share = np.clip(((point - way) * step).sum(axis=1) / length, 0.0, 1.0)
    return float(np.abs(way + share[:, None] * step - point).max(axis=1).min())


def _faults_of_functions(bag: Bag, run: RecordedRun, machine: Machine) -> list[str]:
    """Return faults: the functions in segments and setpoints must be those of the program."""
    sent = [function for block in run.blocks for function in block.functions]
    topics = {
        'segments': iter(run.segments),
        'setpoints': (m for m in bag.messages('setpoints') if m.program_id == run.program_id),
    }
    faults = []
    for topic, found in topics.items():
        functions = [f for message in found for f in message.functions]
        wrong = [f.number for f in functions if f.number >= len(sent) or f != sent[f.number]]
        missing = set(range(len(sent))) - {f.number for f in functions}
        if wrong or (missing and not run.cut):
            number = wrong[0] if wrong else min(missing)
            faults.append(f'the {topic} lack function {number} of the blocks, or change it')
    words = machine.signals.words
    if FOLLOWS in words:
        first = words[FOLLOWS].start
        begun = {f.sequence for c in run.executed() for f in c.functions if f.step == first}
        lacking = begun - {m.sequence for m in run.followed}
        if lacking and not run.cut:
            line = run.blocks[min(lacking)].line_number
            faults.append(f'line {line} is not proven: the record lacks its followed_spindle')
    return faults


def _faults_of_program(bag: Bag, run: RecordedRun) -> list[str]:
    """Return faults: the loaded program must agree with the blocks that were sent."""
    loaded = [m for m in bag.messages('loaded_program') if m.program_id == run.program_id]
    if not loaded:
        return ['the record has no loaded_program of the run; record from before the start']
    settings, height = run.blocks[0].settings, run.flank_height
    same = all(m.settings == settings and m.flank_height == height for m in loaded)
    return [] if same else ['loaded_program has other settings than the first block']
