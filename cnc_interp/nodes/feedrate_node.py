"""The feedrate node: receives ``segments``, sends ``setpoints``; see ``planning_session.py``."""

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib import import_module
from operator import attrgetter
from threading import Thread
from typing import Any

from cnc_interp_msgs.msg import MachineState, PathSegment, PathSegmentBatch, SetpointChunk
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from cnc_interp.core import MS, FloatArray, Refusal, StreamError
from cnc_interp.feedrate.planner_tuning import tool_warnings
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import node_main, parameters
from cnc_interp.nodes.controls import OperatorInputs
from cnc_interp.nodes.kernel_warmup import warm_all, warm_clearance
from cnc_interp.nodes.peers import SenderWatch, watch_machine
from cnc_interp.nodes.planning_session import Activity, PlanningSession, PlanningTask, Received
from cnc_interp.nodes.qos import SETPOINTS
from cnc_interp.nodes.streams import Inlet, Outlet
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.notices import WARNING
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.run.setpoints import Chunk, Wait
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.wire.message_checks import check_segment
from cnc_interp.wire.path_messages import chunk_message, functions_from, segments_from
from cnc_interp.wire.run_messages import machine_report, run_id_of
from cnc_interp.wire.window_protocol import WindowedReceiver

SWITCH = 5e-4  #: Interval of Python's thread switches: the longest wait of the sending thread [s].


class PlanningThread:
    """A thread that executes one planning task at a time."""

    def __init__(self) -> None:
        sys.setswitchinterval(SWITCH)
        self.longest = 0.0  # time of the longest task since the last reading [s]
        self._executor = ThreadPoolExecutor(1, thread_name_prefix='plan')
        self._job: tuple[PlanningTask, Future[Any], float] | None = None
        self._loads_rest = False

    def load_rest(self) -> None:
        """Import toppra in a thread, because it takes a third of a second; call it in motion."""
        if not self._loads_rest:
            self._loads_rest = True
            rest = 'cnc_interp.feedrate.backward_pass'
            Thread(target=import_module, args=[rest], daemon=True).start()

    def submit(self, task: PlanningTask) -> None:
        self._job = task, self._executor.submit(task.work), time.monotonic()

    def done(self) -> tuple[PlanningTask, Callable[[], Any]] | None:
        """Return a finished task and its outcome, only once; None if there is none."""
        if self._job is None or not self._job[1].done():
            return None
        task, future, submitted = self._job
        self._job = None
        self.longest = max(self.longest, time.monotonic() - submitted)
        return task, future.result

    def close(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)


WORK_PERIOD = 0.005  #: Time between two checks for a finished planning task [s].
#: If machine_node reports its state but accepts no setpoint for this time, it does not receive
#: them [s]. On an overloaded computer, Fast DDS 2.14 may lose one direction between two processes.
DEAF = 20.0
AGAIN = 'start the nodes again, then the program'
UNHEARD = f'machine_node does not receive the setpoints; {AGAIN}'
SILENT = f'feedrate_node does not receive messages of machine_node; {AGAIN}'
WAITS = (MachineState.WAITS_FOR_SETPOINTS, MachineState.WAITS_FOR_NEW_PLAN)
DIAGNOSTICS_PERIOD = 1.0  #: Time between two diagnostics messages about the planning [s].


class FeedrateNode(LifecycleNode):
    """Plans the motion of one program after another; it is the ``Port`` of its session."""

    def __init__(self) -> None:
        super().__init__('feedrate_node')
        self._values = parameters.declare(self, parameters.FEEDRATE)
        self._active = self._moves = self._machine_waits = False
        self._heard = 0.0  # when the machine spoke, or a run began that waits for it [s]
        self._thread = PlanningThread()
        if self._values['autostart']:
            node_main.start_lifecycle(self)

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        return node_main.transition(self, self._configure)

    def _configure(self) -> None:
        values, period = self._values, self._values['interpolation_period']
        self._transform = Transform.of(Machine.load(values['machine']))
        warm_all(values['machine'], period)
        warm_clearance(self._transform.machine, parameters.settings_of(values), period)
        told = tool_warnings(self._transform.machine, parameters.settings_of(values))
        self._diagnostics = node_main.Diagnostics(self)
        if told:
            self._diagnostics.say('tool error', node_main.WARN, told[0].removeprefix(WARNING))
        self._watch = SenderWatch(
            self,
            self._diagnostics,
            'segments',
            'lookahead_node',
            values['peer_timeout'],
            heartbeat='blocks',
        )
        self.outlet = Outlet(
            self,
            'setpoints',
            SetpointChunk,
            values['resend_after'],
            self._encode,
            profile=SETPOINTS,
        )
        self._session = PlanningSession(self, period, values['plan_ahead'])
        self._inlet = Inlet(
            self,
            WindowedReceiver('segments', values['segment_window'], self._gives_way),
            {'segments': PathSegmentBatch},
            self._check,
            self._take,
            self._session.end_path,
            self._diagnostics,
            gate=attrgetter('segments'),
        )
        count = len(self._transform.machine.axis_names)
        watch_machine(self, self._see_machine, count, self._diagnostics)
        self._inputs = OperatorInputs(self)
        self._pace = node_main.Pace(self, WORK_PERIOD, self._work)
        node_main.every(self, DIAGNOSTICS_PERIOD, self._tell_planning)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        self._active = False
        return super().on_deactivate(state)

    def _see_machine(self, state: MachineState) -> None:
        report = machine_report(state)
        stands = self._transform.errors.commanded(report.stands[None])[0]
        report = replace(report, stands=stands)
        self._moves, self._heard = report.moves, time.monotonic()
        self._machine_waits = state.waits_for in WAITS or state.state == MachineState.IDLE
        if self._moves:
            self._thread.load_rest()
        self._session.see_machine(report)
        if self._inputs.see(state):
            self._work()  # settings also affect motion that is planned already

    def _gives_way(self, _: str) -> bool:
        return not self._session.executing

    def _check(self, segment: PathSegment) -> None:
        if not self._active:
            name = self.get_name()
            text = f'{name} is not active; activate it, then run the program again'
            raise StreamError(text, Refusal.NOT_READY)
        machine = self._transform.machine
        arm = machine.arm is not None
        check_segment(segment, len(machine.extra_names), machine.signals, arm)

    def _take(self, segment: PathSegment) -> None:
        self._pace.wake()
        if segment.sequence == 0:
            self._heard = time.monotonic()
            self._session.begin(run_id_of(segment), segment.continue_at)
        self._session.take(segment, segment.end_of_program)
        self._watch.hear()

    def _work(self) -> bool:
        """Send the setpoints that the window allows; then start the most urgent planning task."""
        session, outlet = self._session, self.outlet
        session.settings = self._inputs.settings
        outlet.pump()
        if (done := self._thread.done()) is not None:
            session.finish(*done, time.monotonic())
            self._tell_hits()
            outlet.pump()
        if outlet.refused:
            session.give_up(outlet.refused, outlet.refusal_text)
        if self._machine_waits and outlet.unheard > DEAF:
            session.give_up(Refusal.GIVEN_UP, UNHEARD)
        if session.activity is Activity.WAITING and time.monotonic() - self._heard > DEAF:
            session.give_up(Refusal.GIVEN_UP, SILENT)
        if (task := session.step(time.monotonic(), self._received())) is not None:
            self._thread.submit(task)
        outlet.pump()
        self._watch.look(session.wants_segments and self._inlet.receiver.active)
        self._inlet.tick()
        return not self._idle

    def _received(self) -> Received:
        outlet, peer = self.outlet, self.outlet.peer
        if peer is None:
            return Received()
        age = time.monotonic() - outlet.heard if self._moves else 0.0
        left = peer.buffered_time - age
        executed = peer.next_sequence - left / self._values['interpolation_period']
        return Received(run_id_of(peer), executed, outlet.turned_away)

    @property
    def _idle(self) -> bool:
        return self._session.activity in (Activity.NONE, Activity.ENDED)

    def _tell_planning(self) -> None:
        session, sender = self._session, self.outlet.sender
        self._diagnostics.say(
            'planning',
            node_main.OK,
            'no program' if self._idle else 'at work',
            planned_ahead_s=round(session.ready, 2),
            longest_step_ms=round(self._thread.longest / MS, 1),
            setpoints_sent=session.sent_before + sender.sent,
        )
        self._tell_hits()
        self._thread.longest = 0.0

    def _tell_hits(self) -> None:
        planner = self._session.planner
        found = planner.clearance if planner is not None else None
        if found is None or not found.hits:
            if self._values['scene']:
                stock = found.stock_text() if found is not None else ''
                values = {node_main.STOCK: stock} if stock else {}
                self._diagnostics.say('collision', node_main.OK, 'no hit', **values)
            return
        first, more = found.hits[0], len(found.hits) - 1
        text = first.text(self._transform.machine) + f' (and {more} more)' * bool(more)
        values = {node_main.BODIES: node_main.AND.join(first.bodies)}
        self._diagnostics.say('collision', node_main.WARN, text, **values)

    def make_planner(
        self, first: PathSegment, stands: FloatArray, place: float, settings: OperatorSettings
    ) -> RunPlanner:
        wanted = replace(parameters.settings_of(self._values), flank_height=first.flank_height)
        given = self._transform, wanted, self._values['chunk_time'], stands, place, settings
        return RunPlanner(*given, asks=first.attempt == 0)

    def read(self, segments: list[PathSegment]) -> tuple[PathSegments, dict[int, Wait], Functions]:
        functions = functions_from([f for segment in segments for f in segment.functions])
        return segments_from(segments), self._inputs.pauses_after(segments), functions

    def consumed(self, count: int) -> None:
        self._inlet.receiver.consume(count)

    def refuse(self, kind: Refusal, reason: str) -> None:
        self._tell_hits()
        receiver = self._inlet.receiver
        if not receiver.refused:
            self._inlet.refuse(receiver.run_id, kind, reason)

    def _encode(self, chunk: Chunk, first: int) -> SetpointChunk:
        session = self._session
        if session.planner is None:
            raise StreamError('a setpoint was requested before its run')
        period, signals = self._values['interpolation_period'], self._transform.machine.signals
        told, joins = session.planner.with_lines(chunk), 0 < first == session.joins_at
        settings = session.planner.stream.current.settings
        return chunk_message(told, session.run_id, first, period, joins, signals, settings)

    def close(self) -> None:
        """Close the node; the machine then stops by the stop tail of the last chunk sent."""
        self._active = False
        self._thread.close()


main = partial(node_main.run_node, FeedrateNode)
