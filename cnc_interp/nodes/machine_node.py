"""The machine node: receives ``setpoints``; its clock plays them at absolute deadlines."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import LoadedProgram, SetpointChunk
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from cnc_interp.core import InterpError, Refusal, StreamError
from cnc_interp.machine.cycle import MachineClock
from cnc_interp.machine.drive_kinds import drives_of
from cnc_interp.machine.kept_positions import keep_positions, kept_positions
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.realtime import ask_for_priority, lock_memory
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes import node_main, parameters
from cnc_interp.nodes.controls import Controls, Overrides
from cnc_interp.nodes.kernel_warmup import warm_machine
from cnc_interp.nodes.machine_topics import MachineTopics
from cnc_interp.nodes.qos import LOADED
from cnc_interp.nodes.seals import hear
from cnc_interp.nodes.streams import Inlet
from cnc_interp.run.clearance_stage import contact_by_hand
from cnc_interp.run.run_planner import JOIN_RESERVE
from cnc_interp.run.run_state import NO_RUN, Reason, RunId, State
from cnc_interp.wire.message_checks import check_chunk
from cnc_interp.wire.path_messages import JoinGate, chunk_from
from cnc_interp.wire.run_messages import run_id_of
from cnc_interp.wire.window_protocol import WindowedReceiver

WORK_PERIOD = 0.005  #: Time between two readings of the cycle's records in motion [s].
CLOCK_PERIOD = 1.0  #: Time between two reports about the clock [s].
#: States in which setpoints are rejected.
CLOSED = (State.INACTIVE, State.STOPPING, State.FAULT)
LEVELS = {
    State.FAULT: node_main.ERROR,
    State.STARVING: node_main.WARN,
    State.STARVED: node_main.WARN,
}


class MachineNode(LifecycleNode):
    def __init__(self) -> None:
        super().__init__('machine_node')
        self._values = parameters.declare(self, parameters.MACHINE_NODE)
        self._period: float = self._values['interpolation_period']
        self._published: tuple[Any, ...] = ()
        self._kept = False  # whether a power failure has written the positions
        self._clock_of_drives: MachineClock | None = None
        if self._values['autostart']:
            node_main.start_lifecycle(self)

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        return node_main.transition(self, self._configure)

    def _configure(self) -> None:
        values = self._values
        window = round(values['buffer_time'] / self._period)
        if window < 1:
            text = f'{values["buffer_time"]:g} s is less than the period, {self._period:g} s'
            raise InterpError(f'buffer_time: {text}; give at least one period')
        machine = Machine.load(values['machine'])
        warm_machine(values['machine'], self._period)
        priority = values['realtime_priority']
        # The other threads have the priority just below the clock, because a hold waits for them.
        ask_for_priority(max(priority - 1, min(priority, 1)))
        self._memory = lock_memory() if values['lock_memory'] else 'memory may be paged out'
        drives = drives_of(machine, self._period, values, self._link)
        self._playback = Playback(machine, self._period, drives, window)
        self._clock_of_drives = MachineClock(self._playback.cycle, priority)
        self._diagnostics = node_main.Diagnostics(self)
        self._gate = JoinGate(round(JOIN_RESERVE / self._period))
        self._inlet = Inlet(
            self,
            WindowedReceiver('setpoints', window, lambda _: self._has_not_begun),
            {'setpoints': SetpointChunk},
            self._check,
            self._take,
            self._see_refusal,
            self._diagnostics,
            gate=self._pass,
        )
        self._inlet.buffered_time = 0.0
        self._coming = NO_RUN  # was started, but no setpoint of it has come yet
        hear(self, LoadedProgram, 'loaded_program', self._see_program, LOADED, self._diagnostics)
        self._pace = node_main.Pace(self, WORK_PERIOD, self._work)
        self._overrides = Overrides(self, self._playback, self._diagnostics, self._pace.wake)
        told = self._diagnostics, self._give_up, self._pace.wake
        outputs = self._playback.spindle.commanded
        contact = contact_by_hand(machine, parameters.settings_of(values), outputs)
        self._controls = Controls(self, self._playback, *told, contact)
        known = np.isfinite(kept_positions(values['position_file'], machine))
        self._controls.homing.know(np.array(machine.axis_names)[known].tolist())
        given = self._overrides, self._controls.homing, self._diagnostics, self._pace.wake
        self._topics = MachineTopics(self, self._playback, values, *given)
        node_main.every(self, CLOCK_PERIOD, self._report_clock)

    def _link(self, values: Any, joints: list[str]) -> Any:
        from cnc_interp.nodes.controller_link import ControllerLink

        return ControllerLink(self.get_namespace(), values, joints)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        assert self._clock_of_drives is not None
        self._forget_positions()
        self._clock_of_drives.start()
        done = node_main.transition(self, self._playback.switch_on)
        return super().on_activate(state) if done == TransitionCallbackReturn.SUCCESS else done

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Switch the drives off and stop the clock; allowed only at rest."""
        done = node_main.transition(self, self._playback.switch_off)
        if done != TransitionCallbackReturn.SUCCESS:
            return done
        self._stop_clock()
        self._controls.homing.forget()
        return super().on_deactivate(state)

    def _keep_positions(self) -> None:
        """Save the axis positions in the file, unless they are uncertain."""
        playback, file = self._playback, self._values['position_file']
        fault = playback.state.state is State.FAULT and not playback.power_fails
        if (
            file
            and playback.state.resting
            and playback.state.state is not State.INACTIVE
            and not fault
        ):
            given = playback.feedback.position[-1], self._controls.homing.homed
            keep_positions(file, playback.axes.machine, *given)
            self._kept = True

    def _forget_positions(self) -> None:
        self._kept = False
        if self._values['position_file']:
            Path(self._values['position_file']).unlink(missing_ok=True)

    def _pass(self, chunk: SetpointChunk) -> list[SetpointChunk]:
        """Return the chunks to process now; the first ones of a joining plan wait for more."""
        self._pace.wake()
        receiver = self._inlet.receiver
        return self._gate.passed(chunk, receiver.run_id, receiver.limit)

    @property
    def _has_not_begun(self) -> bool:
        return self._playback.state.state is State.IDLE and not self._playback.plans.played

    def _check(self, chunk: SetpointChunk) -> None:
        playback, run_id, begins = self._playback, run_id_of(chunk), chunk.first_sample == 0
        playback.look()
        state = playback.state
        first = np.array(chunk.positions[: chunk.axis_count])
        if playback.plans.is_void(run_id, first if begins else None, state):
            raise StreamError(self._void(), Refusal.PLAN_OVER)
        if begins:
            playback.make_room(run_id)
        if state.state in CLOSED:
            stopped = state.state is not State.INACTIVE
            kind = Refusal.MACHINE_FAULT if stopped else Refusal.NOT_READY
            reason = state.text or 'activate it'
            raise StreamError(f'the machine is {state.state.value}: {reason}', kind)
        if begins and (axes := ' '.join(self._controls.homing.must_home)):
            raise StreamError(f'{axes} must be homed before a program starts', Refusal.NOT_READY)
        number, before = chunk.first_sample, playback.plans.buffer.newest
        if chunk.joins:
            before = playback.before_join(run_id, number)
        if begins and playback.plans.begins_elsewhere(first):
            text = 'the plan does not begin where the axes are: they moved, or machine_node was'
            raise StreamError(f'{text} started again; run the program again', Refusal.GIVEN_UP)
        check_chunk(chunk, playback.axes.machine, self._period, before)
        if chunk.joins:
            playback.join(run_id, number, chunk_from(chunk))

    def _void(self) -> str:
        plan = self._playback.plans.run_id.plan
        return f'plan {plan} ended with a stop; its later setpoints are not needed'

    def _take(self, chunk: SetpointChunk) -> None:
        playback = self._playback
        if chunk.first_sample == 0:
            self._coming = NO_RUN
            playback.begin_plan(run_id_of(chunk))
            if not playback.plans.played:
                playback.cycle.forget_lateness()  # a new run resets the figures
        if not chunk.joins:  # a chunk that joins is in the buffer already
            playback.push(chunk_from(chunk))

    def _see_refusal(self) -> None:
        """Stop on the path after the buffered setpoints, because the stream was rejected."""
        self._playback.refuse(self._inlet.receiver.refusal_text)

    def _see_program(self, program: LoadedProgram) -> None:
        if program.program_id != self._inlet.receiver.run_id.program_id:
            self._coming = RunId(program.program_id)
            self._pace.wake()

    def _give_up(self, reason: str, kind: Refusal = Refusal.GIVEN_UP) -> None:
        """Give up the current run, and a run that is being planned: it must not start later."""
        coming, self._coming = self._coming, NO_RUN
        self._refuse(self._inlet.receiver.run_id, kind, reason)
        self._refuse(coming, kind, reason)

    def _refuse(self, run_id: RunId, kind: Refusal, reason: str) -> None:
        receiver = self._inlet.receiver
        if run_id and not (run_id == receiver.run_id and receiver.refused):
            self._inlet.refuse(run_id, kind, reason)

    def _work(self) -> bool:
        """Enlarge the window by the played setpoints; publish the state if it has changed."""
        playback, receiver = self._playback, self._inlet.receiver
        playback.look()
        state, run_id = playback.state, playback.plans.run_id
        mine = run_id == receiver.run_id
        receiver.consumed = playback.plans.played_of_plan if mine else 0
        self._inlet.buffered_time = playback.plans.buffer.count * self._period
        self._topics.tell_contacts()  # before the state that depends on them
        if self._kept is not (state.state is State.FAULT and playback.power_fails):
            (self._forget_positions if self._kept else self._keep_positions)()
        if state.state is State.FAULT:
            self._give_up(state.text, Refusal.MACHINE_FAULT)
        elif mine and state.reason is Reason.PROBE and state.completed:
            self._refuse(run_id, Refusal.PROBED, 'the probe has answered')
        elif mine and state.plan_over and receiver.active:
            receiver.close(self._void())
        homed = tuple(self._controls.homing.homed)
        override = self._overrides.feed
        told = state, run_id, override, self._overrides.rapid, playback.single_block, homed
        if told != self._published:
            self._published = told
            level = LEVELS.get(state.state, node_main.OK)
            self._diagnostics.say('drives', level, state.text or state.state.value)
            self._topics.publish_state()
        self._topics.tell_signals()
        self._controls.work(override)  # results so far are published
        self._inlet.tick()
        self._topics.work()
        return self._controls.homing.active or playback.busy

    def _report_clock(self) -> None:
        self._topics.report_compensation()
        clock = self._clock_of_drives
        if clock is not None:
            said = f'{clock.scheduling}; {self._memory}'
            self._diagnostics.say(
                'clock', node_main.OK, said, **self._playback.cycle.lateness().figures()
            )

    def come_to_rest(self) -> bool:
        """Stop on the path as at a feed hold; return whether the axes rest. Call it repeatedly."""
        if self._clock_of_drives is None:
            return True
        playback = self._playback
        playback.read()
        if not (playback.state.resting or playback.state.leaves_plan):
            playback.hold()
        return playback.state.resting

    def publish_rest(self) -> None:
        self._playback.read()
        self._topics.publish_executed()
        self._topics.publish_state()

    def _stop_clock(self) -> None:
        if self._clock_of_drives is not None:
            self._clock_of_drives.stop()

    def close(self) -> None:
        if self._clock_of_drives is not None:
            self._stop_clock()
            self._clock_of_drives = None
            self._keep_positions()
            self._playback.close()


main = partial(node_main.run_node, MachineNode)
