"""One period of the cycle, compiled: choose a setpoint, step the drives, record both."""

from typing import NamedTuple

import numpy as np
from numba import carray, types

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import cfunc, njit
from cnc_interp.core.native import NANOSECONDS, call_drives, fence, pointer, sleep_until, time_now
from cnc_interp.machine import spindle as spin
from cnc_interp.machine.realtime import note_catching_up, note_lateness
from cnc_interp.machine.spindle import Spindle

#: What the cycle plays; with FOLLOW, a line in step with the spindle.
REST, CHUNK, TAIL, FOLLOW = range(4)
#: Events of a period: bits of a record.
STARVED, ENDED, WAITED, REFUSED, FAILED, ALARMED, PROBED, ASTRAY = (1 << k for k in range(8))
ALARM_SHIFT = 8  #: In the events of an ALARMED record, the number of the alarm begins at this bit.
#: Words that Python writes and the cycle reads ...
QUIT, LEAVE, HALT, START, FIRST, READ, FORGET, MUTE = range(8)
#: ... and words that the cycle writes.
HALTED, STARTED, SOURCE, SERIAL, ROW, RECORDED, FORGOTTEN, ALARM, WORDS = range(8, 17)
#: Columns of a descriptor: positions, velocities and count of a chunk; its switches (row, output,
#: value) and their count; the same for its stop tail; whether the machine rests after it; the next
#: chunk; the speeds of the tip on chunk and tail, or 0 if no output follows them.
POSITIONS, VELOCITIES, COUNT, SWITCHES, SWITCH_COUNT, TAIL_COLUMNS = range(6)
RESTS, NEXT, SPEEDS, TAIL_SPEEDS, COLUMNS = range(10, 15)
NONE = -1  #: No next chunk yet.
#: After a longer stall of the computer the clock restarts instead of catching up [ns].
LONGEST_CATCH_UP = 500_000_000
AT_LIMIT = 1000  #: Alarm number of the first limit switch; the others follow.
CALM = 1000  #: Number of steps at rest after which several periods pass in one call.


class SpeedOutputs(NamedTuple):
    """Outputs that follow the speed of the tip."""

    number: IntArray  #: (k,): Numbers of these outputs.
    only_with: IntArray  #: (k,): Output that must be on for each; -1 if none.
    table: FloatArray  #: (k, 2, P): Speeds [m/s], and shares of the commanded value [-].


class Memory(NamedTuple):
    """Memory that the cycle shares with Python threads."""

    control: IntArray  #: (WORDS,): Commands and state.
    chunks: IntArray  #: (slots, COLUMNS): Descriptors of chunks, by ``serial % slots``.
    travel: FloatArray  #: (n_axes, 2): Smallest and largest setpoint [m, rad].
    jump: FloatArray  #: (n_axes,): Largest step between two setpoints [m, rad].
    setpoint: FloatArray  #: (2, n_axes): Commanded position and velocity [m, rad, per s].
    #: (4, n_axes): Actual position and velocity, the setpoint that they answer, and the delay that
    #: the drives request; see ``drives.CycleDrives`` [m, rad, per s].
    feedback: FloatArray
    drives: FloatArray  #: Memory of the drives.
    #: (n_outputs,): Outputs to the drives, which the cycle derives from commanded values.
    outputs: FloatArray
    inputs: FloatArray  #: (n_inputs,): Inputs, written by the drives.
    probe: IntArray  #: The numbers of the output ``ARMED`` and of the input ``PROBE``; or (0,).
    spindle: Spindle
    by_speed: SpeedOutputs
    #: (m, 4): Limit switches: input, axis, side (-1 or 1), and whether it is watched.
    switches: IntArray
    stands: FloatArray  #: (n_axes,): Start of a line in step with the spindle [m, rad].
    records: IntArray  #: (count, 4): Source, serial number, row and events of a period.
    #: (count, 5, n_axes): Actual position, velocity, setpoint answered, setpoint; in the last row
    #: the angle of the spindle comes first.
    measured: FloatArray
    late: IntArray  #: (RECORD,): Histogram of the clock, see ``realtime.Lateness``.


@njit(cache=True, nogil=True)
def _choose(memory: Memory) -> int:
    """Choose what is played in this period; return its events."""
    control, chunks = memory.control, memory.chunks
    source, serial, row = control[SOURCE], control[SERIAL], control[ROW] + 1
    events = 0
    if control[HALTED] != control[HALT]:
        control[HALTED], source = control[HALT], REST
    if source == REST and control[STARTED] != control[START]:
        control[STARTED] = control[START]
        source, serial, row = CHUNK, control[FIRST], 0
        if _begins_to_follow(memory):
            source = FOLLOW
    while source == CHUNK or source == TAIL:
        slot = serial % len(chunks)
        if row < chunks[slot, COUNT + (TAIL_COLUMNS if source == TAIL else 0)]:
            break
        if source == TAIL:
            source = REST
            events |= ENDED
        elif control[LEAVE]:
            source, row = TAIL, 0
        elif chunks[slot, RESTS]:
            source = REST
            events |= WAITED
        elif chunks[slot, NEXT] != NONE:
            serial, row = chunks[slot, NEXT], 0
        else:
            source, row = TAIL, 0
            events |= STARVED
    control[SOURCE], control[SERIAL], control[ROW] = source, serial, row
    return events


@njit(cache=True, nogil=True)
def _take_setpoint(memory: Memory) -> bool:
    """Make the chosen row the setpoint; return False if it is invalid and the last one is held."""
    control, setpoint = memory.control, memory.setpoint
    descriptor, n = memory.chunks[control[SERIAL] % len(memory.chunks)], setpoint.shape[1]
    shift = TAIL_COLUMNS if control[SOURCE] == TAIL else 0
    shape = (descriptor[COUNT + shift], n)
    position = carray(pointer(np.uintp(descriptor[POSITIONS + shift])), shape)[control[ROW]]
    velocity = carray(pointer(np.uintp(descriptor[VELOCITIES + shift])), shape)[control[ROW]]
    for i in range(n):
        inside = memory.travel[i, 0] <= position[i] <= memory.travel[i, 1]
        near = abs(position[i] - setpoint[0, i]) <= memory.jump[i]
        if not (inside and near and abs(velocity[i]) < np.inf):
            return False
    for i in range(n):
        setpoint[0, i], setpoint[1, i] = position[i], velocity[i]
    return True


@njit(cache=True, nogil=True)
def _switch(memory: Memory) -> None:
    control = memory.control
    descriptor = memory.chunks[control[SERIAL] % len(memory.chunks)]
    shift = TAIL_COLUMNS if control[SOURCE] == TAIL else 0
    count = descriptor[SWITCH_COUNT + shift]
    if count == 0 or control[MUTE]:
        return
    switches = carray(pointer(np.uintp(descriptor[SWITCHES + shift])), (count, 3))
    for i in range(count):
        if switches[i, 0] == control[ROW]:
            memory.spindle.commanded[int(switches[i, 1])] = switches[i, 2]


@njit(cache=True, nogil=True)
def _begins_to_follow(memory: Memory) -> bool:
    """Return whether a line in step with the spindle begins, and prepare it if so."""
    spindle, control = memory.spindle, memory.control
    states = spindle.places.states
    if states < 0 or spindle.commanded[states + spin.TURNS] == 0:
        return False
    memory.stands[:] = memory.setpoint[0]
    control[SOURCE], control[SERIAL], control[ROW] = CHUNK, control[FIRST], 0
    _switch(memory)
    spindle.state[0].mode, spindle.state[0].waited = spin.SETTLES, 0.0
    return True


@njit(cache=True, nogil=True)
def _follow(memory: Memory) -> int:
    """Make a setpoint in step with the spindle; return the events at the end of the line."""
    spindle, control = memory.spindle, memory.control
    state = spindle.state[0]
    mode = state.mode
    if mode not in (spin.AT_REST, spin.DONE):
        spin.follow(spindle, memory.setpoint, memory.stands)
        for i in range(3):
            if not memory.travel[i, 0] <= memory.setpoint[0, i] <= memory.travel[i, 1]:
                spin.give_up(spindle, 4 * spin.STEPS + i)
        return 0
    control[SOURCE] = REST
    spindle.commanded[spindle.places.states + spin.TURNS] = 0.0
    if state.cause:
        return ASTRAY
    return WAITED if mode == spin.DONE else ENDED


@njit(cache=True, nogil=True)
def _probe_answers(memory: Memory) -> bool:
    """Return whether the watched probe has reached the awaited state; it is then unwatched."""
    if len(memory.probe) == 0:
        return False
    armed = memory.spindle.commanded[memory.probe[0]]
    touches = memory.inputs[memory.probe[1]] != 0.0
    if armed == 0.0 or touches != (armed == 1.0):
        return False
    memory.spindle.commanded[memory.probe[0]] = 0.0
    return True


@njit(cache=True, nogil=True)
def _tip_speed(memory: Memory) -> float:
    """Return the speed of the tip over the workpiece at the setpoint of this period [m/s]."""
    control = memory.control
    descriptor = memory.chunks[control[SERIAL] % len(memory.chunks)]
    tail = control[SOURCE] == TAIL
    address = descriptor[TAIL_SPEEDS if tail else SPEEDS]
    if control[SOURCE] == REST:
        return 0.0
    if control[SOURCE] == FOLLOW or address == 0:
        return float(np.sqrt(np.sum(memory.setpoint[1, :3] ** 2)))
    count = descriptor[COUNT + (TAIL_COLUMNS if tail else 0)]
    return float(carray(pointer(np.uintp(address)), (count,))[control[ROW]])


@njit(cache=True, nogil=True)
def _follow_speed(memory: Memory) -> None:
    """Set outputs to the share of their commanded value that the speed of the tip gives."""
    outputs, speed = memory.outputs, _tip_speed(memory)
    for k, number in enumerate(memory.by_speed.number):
        only = memory.by_speed.only_with[k]
        if only < 0 or outputs[only] != 0.0:
            speeds, shares = memory.by_speed.table[k]
            outputs[number] *= np.interp(speed, speeds, shares)


@njit(cache=True, nogil=True)
def _limit_met(memory: Memory) -> int:
    """Return the alarm number if an axis moves further into its limit switch, else 0."""
    for k in range(len(memory.switches)):
        number, axis, side, watched = memory.switches[k]
        onward = memory.setpoint[1, axis] * side > 0.0
        if watched and onward and memory.inputs[number] != 0.0:
            return AT_LIMIT + k
    return 0


@njit(cache=True, nogil=True)
def advance(memory: Memory, step: int) -> None:
    control, records = memory.control, memory.records
    events = _choose(memory)
    source = control[SOURCE]
    if source == FOLLOW:
        events |= _follow(memory)
        source = control[SOURCE]
    elif source != REST:
        if _take_setpoint(memory):
            _switch(memory)
        else:
            events |= REFUSED
            control[SOURCE] = REST
    if control[SOURCE] == REST:
        memory.setpoint[1] = 0.0
    spin.set_outputs(memory.spindle, memory.outputs, memory.setpoint[0, 0])
    if len(memory.by_speed.number):
        _follow_speed(memory)
    memory.feedback[2], memory.feedback[3] = memory.setpoint[0], 0.0
    fault = call_drives(
        np.uintp(step),
        memory.drives.ctypes.data,
        memory.setpoint.ctypes.data,
        memory.feedback.ctypes.data,
        memory.setpoint.shape[1],
    )
    spin.see_angle(memory.spindle, memory.outputs, memory.inputs, 1 + int(memory.feedback[3, 1]))
    if fault > 0 and source != REST:
        events |= FAILED
        control[SOURCE], control[ROW] = REST, fault
    if fault < 0 and (fault != control[ALARM] or source == CHUNK):
        events |= ALARMED | (-fault << ALARM_SHIFT)
        control[LEAVE] = 1  # takes the stop tail of this chunk
    control[ALARM] = min(fault, 0)
    limit = _limit_met(memory) if control[SOURCE] == CHUNK else 0
    if limit:
        events |= ALARMED | (limit << ALARM_SHIFT)
        control[LEAVE] = 1
    if control[SOURCE] in (CHUNK, TAIL) and _probe_answers(memory):
        events |= PROBED
        control[LEAVE] = 1
    count = control[RECORDED]
    if source == REST and events == 0 and count - control[READ] >= len(records) - 1:
        return  # nobody reads, nothing moves
    slot = count % len(records)
    records[slot, 0], records[slot, 1] = source, control[SERIAL]
    records[slot, 2], records[slot, 3] = control[ROW], events
    memory.measured[slot, :3] = memory.feedback[:3]
    memory.measured[slot, 3] = memory.setpoint[0]
    if memory.spindle.places.angle >= 0:
        memory.measured[slot, 4, 0] = memory.inputs[memory.spindle.places.angle]
    fence()
    control[RECORDED] = count + 1


@njit(cache=True, nogil=True)
def run_periods(memory: Memory, step: int, period: int, together: int) -> None:
    """Advance every ``period`` [ns] until QUIT; drives with their own clock may shift periods.

    At rest, drives are called once in ``together`` periods unless the spindle turns.
    """
    control, spec = memory.control, np.zeros(2, dtype=np.int64)
    due, calm = time_now(spec), 0
    while control[QUIT] == 0:
        due += period * (together if calm > CALM else 1)
        if control[FORGOTTEN] != control[FORGET]:
            control[FORGOTTEN] = control[FORGET]
            memory.late[:] = 0
        now = time_now(spec)
        if now < due:
            sleep_until(due, spec)
            note_lateness(memory.late, time_now(spec) - due)
        else:
            note_catching_up(memory.late, now - due)
            if now - due > LONGEST_CATCH_UP:
                due = now
        advance(memory, step)
        turns = abs(memory.spindle.state[0].rate) > spin.SLOWEST
        calm = calm + 1 if control[SOURCE] == REST and not turns else 0
        due += np.int64(memory.feedback[3, 0] * NANOSECONDS)


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def follow_ideally(_memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Put the axes at their setpoints, in place of drives that Python feeds."""
    wanted, actual = carray(pointer(setpoint), 2 * n), carray(pointer(feedback), 2 * n)
    for i in range(2 * n):
        actual[i] = wanted[i]
    return 0
