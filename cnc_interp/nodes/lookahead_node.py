"""The look-ahead node: receives ``blocks`` or ``block_batches``, and sends ``segments``."""

from collections import deque
from functools import partial
from math import inf

from cnc_interp_msgs.msg import Function, G1Block, G1BlockBatch, PathSegment, PathSegmentBatch
from rclpy.node import Node

from cnc_interp.core import InterpError, Refusal
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.kernel_warmup import warm_lookahead
from cnc_interp.nodes.node_main import Diagnostics, Pace, run_node
from cnc_interp.nodes.peers import SenderWatch
from cnc_interp.nodes.streams import Inlet, Outlet
from cnc_interp.run.path_chain import smoother_of
from cnc_interp.run.run_state import RunId
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.wire.message_checks import check_block
from cnc_interp.wire.path_messages import blocks_from, blocks_of, segment_messages
from cnc_interp.wire.run_messages import run_id_of, settings_of_block
from cnc_interp.wire.window_protocol import WindowedReceiver

BATCH = 256  #: Largest number of blocks that are smoothed in one call.


class SmoothingRun:
    """The smoothing of one run."""

    def __init__(self, first: G1Block, smoother: PathSmoother):
        self.run_id: RunId = run_id_of(first)
        self.blocks: deque[G1Block] = deque()
        self.complete = False  # the last block of the program is smoothed
        self._smoother: PathSmoother | None = smoother
        self._flank_height, self._continue_at = first.flank_height, first.continue_at
        self._sequence = 0
        self._newest: PathSegments | None = None  # held back: it may be the last one
        self._program_stops: dict[int, int] = {}  # by block
        self._functions: deque[Function] = deque()

    @property
    def can_smooth(self) -> bool:
        return self._smoother is not None and bool(self.blocks)

    def take(self, block: G1Block) -> None:
        self.blocks.append(block)
        self._functions.extend(block.functions)
        if block.program_stop:
            self._program_stops[block.sequence] = block.program_stop

    def smooth(self) -> tuple[int, list[PathSegment]]:
        """Smooth the next batch; return its number of blocks, and the segments that are final."""
        assert self._smoother is not None
        batch = [self.blocks.popleft() for _ in range(min(BATCH, len(self.blocks)))]
        self.complete = batch[-1].end_of_program
        return len(batch), self._complete(self._smoother.push(blocks_from(batch)))

    def end(self) -> tuple[list[PathSegment], str]:
        """End the path at rest after the last valid block; return last segments and a fault."""
        if self._smoother is None:
            return [], ''
        smoother, self._smoother = self._smoother, None
        messages, problem = [], ''
        try:
            if self.blocks:
                messages += self._complete(smoother.push(blocks_from(list(self.blocks))))
            messages += self._complete(smoother.finish())
        except InterpError as fault:
            problem = str(fault)
        self.blocks.clear()
        if self._newest is not None:
            messages += self._messages(self._newest, end=True)
            self._newest = None
        return messages, problem

    def _complete(self, segments: PathSegments) -> list[PathSegment]:
        if not len(segments):
            return []
        if self._newest is not None:
            segments = PathSegments.concatenate([self._newest, segments])
        self._newest = segments[-1:]
        return self._messages(segments[:-1], end=False)

    def _messages(self, segments: PathSegments, end: bool) -> list[PathSegment]:
        messages = segment_messages(segments, self.run_id, self._sequence, self._flank_height, end)
        self._sequence += len(messages)
        for message in messages:
            if message.sequence == 0:
                message.continue_at = self._continue_at
            last = end and message is messages[-1]
            message.functions = self._functions_until(inf if last else message.last_block)
            if message.stop:  # M0 where several meet there
                passed = [k for k in self._program_stops if k <= message.last_block]
                kinds = (self._program_stops.pop(k) for k in passed)
                message.program_stop = min(kinds, default=G1Block.GO_ON)
        return messages

    def _functions_until(self, block: float) -> list[Function]:
        found = []
        while self._functions and self._functions[0].sequence <= block:
            found.append(self._functions.popleft())
        return found


WORK_PERIOD = 0.01  #: Time between two checks for work during a run [s].
MOST_WAITING = 1024  #: If more segments wait to be sent, smoothing pauses.
MOST_TOGETHER = 32  #: Largest number of segments in one message.


class LookaheadNode(Node):
    def __init__(self) -> None:
        super().__init__('lookahead_node')
        self._values = values = parameters.declare(self, parameters.LOOKAHEAD)
        self._transform = Transform.of(Machine.load(values['machine']))
        self._settings = parameters.settings_of(values)
        warm_lookahead(values['machine'])
        self._run: SmoothingRun | None = None
        self._diagnostics = Diagnostics(self)
        told, timeout = self._diagnostics, values['peer_timeout']
        self._watch = SenderWatch(self, told, 'blocks', 'program_node', timeout)
        self._outlet = Outlet(
            self,
            'segments',
            PathSegmentBatch,
            values['resend_after'],
            lambda segments, _: PathSegmentBatch(segments=segments),
        )
        machine = self._transform.machine
        check = partial(
            check_block,
            extra_count=len(machine.extra_names),
            signals=machine.signals,
            spins=machine.arm is not None,
        )
        self._inlet = Inlet(
            self,
            # program_node sends one program after another.
            WindowedReceiver('blocks', values['block_window'], 'block_batches'.__eq__),
            {'blocks': G1Block, 'block_batches': G1BlockBatch},
            check,
            self._take,
            self._end,
            self._diagnostics,
            gate=self._blocks_of,
        )
        self._pace = Pace(self, WORK_PERIOD, self._work)

    def _blocks_of(self, message: G1Block | G1BlockBatch) -> list[G1Block]:
        """Return the blocks of a message. An empty message only shows that the sender is alive."""
        self._watch.hear()
        return blocks_of(message)

    def _take(self, block: G1Block) -> None:
        self._pace.wake()
        if block.sequence == 0:
            settings = settings_of_block(block, self._settings)
            self._run = SmoothingRun(block, smoother_of(self._transform, settings))
            self._outlet.sender.begin(self._run.run_id)
        if self._run is None:
            return
        self._run.take(block)
        if len(self._run.blocks) >= BATCH:
            self._work()

    def _work(self) -> bool:
        """Smooth a batch if few segments wait, and send as many as the window allows."""
        run, receiver, outlet = self._run, self._inlet.receiver, self._outlet
        outlet.pump()
        if outlet.refused and receiver.active:
            self._inlet.refuse(receiver.run_id, outlet.refused, outlet.refusal_text)
        waits = run is None or not run.blocks
        self._watch.look(receiver.active and waits)
        if run is not None and run.can_smooth and outlet.sender.unsent <= MOST_WAITING:
            self._smooth(run)
        self._inlet.tick()
        return receiver.active or not outlet.sender.all_acknowledged

    def _smooth(self, run: SmoothingRun) -> None:
        try:
            count, segments = run.smooth()
        except InterpError as problem:
            self._inlet.refuse(run.run_id, Refusal.BAD_PATH, str(problem))
            return
        self._send(segments)
        self._inlet.receiver.consume(count)
        if run.complete:
            self._end()

    def _end(self) -> None:
        if self._run is None:
            return
        segments, problem = self._run.end()
        self._send(segments)
        if problem:
            self._inlet.refuse(self._run.run_id, Refusal.BAD_PATH, problem)

    def _send(self, segments: list[PathSegment]) -> None:
        for first in range(0, len(segments), MOST_TOGETHER):
            together = segments[first : first + MOST_TOGETHER]
            self._outlet.sender.put(together, len(together))
        self._outlet.pump()


main = partial(run_node, LookaheadNode)
