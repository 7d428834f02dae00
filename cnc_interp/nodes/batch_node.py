"""The batch node: action ``plan_batch`` plans many programs while a machine may be running."""

import re
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from cnc_interp_msgs.action import PlanBatch
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from cnc_interp.batch.batch_page import write_page, write_tables
from cnc_interp.batch.batch_run import Progress, Store, run_batch
from cnc_interp.batch.processes import Processes, total_memory
from cnc_interp.batch.task import Jobs, TaskOutcome, Verdict, programs_of
from cnc_interp.core import InterpError
from cnc_interp.core.progress_bar import TimeLeft
from cnc_interp.core.small_files import require_allowed, require_inside
from cnc_interp.nodes import parameters
from cnc_interp.nodes.node_main import end_goal, every, run_node
from cnc_interp.settings.options import with_texts

FEEDBACK = 0.2  #: Time between two feedback messages of the action [s].
NAME = re.compile(r'\w[\w. -]{0,99}')  #: Allowed names of batch folders.


class BatchNode(Node):
    """Plans one batch at a time, in processes of the lowest priority."""

    def __init__(self) -> None:
        super().__init__('batch_node')
        self._values = parameters.declare(self, parameters.BATCH)
        self._settings = parameters.settings_of(self._values)
        self._stop = threading.Event()
        workers, memory = self._values['workers'], total_memory() / self._values['workers']
        longest = self._values['longest_planning']
        self._processes = Processes(workers, memory, longest, self._stop.is_set)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix='batch')
        self._handle: Any = None  # the goal that is carried out
        self._progress = Progress(0, 0, 0, 0.0)
        self._time_left = TimeLeft()
        self._server = ActionServer(
            self,
            PlanBatch,
            'plan_batch',
            lambda _: PlanBatch.Result(),
            goal_callback=lambda _: GoalResponse.ACCEPT,
            handle_accepted_callback=self._accept,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        every(self, FEEDBACK, self._work)

    def _accept(self, handle: Any) -> None:
        if self._handle is not None:
            busy = 'a batch is running; wait for its end, or cancel it'
            end_goal(handle, PlanBatch.Result(message=busy), succeeded=False)
            return
        self._handle, self._time_left = handle, TimeLeft()
        self._progress = Progress(0, 0, 0, 0.0)
        self._stop.clear()
        self._result = self._thread.submit(self._planned, handle.request)

    def _work(self) -> None:
        handle = self._handle
        if handle is None:
            return
        if handle.is_cancel_requested:
            self._stop.set()
        if not self._result.done():
            now = self._progress
            handle.publish_feedback(
                PlanBatch.Feedback(
                    done=now.done,
                    total=now.total,
                    progress=now.share,
                    remaining_time=self._time_left.after(time.monotonic(), now.share),
                )
            )
            return
        self._handle = None
        try:
            result = self._result.result()
        except (InterpError, OSError) as problem:
            result = PlanBatch.Result(message=str(problem))
        end_goal(handle, result, result.success)

    def _planned(self, goal: PlanBatch.Goal) -> PlanBatch.Result:
        folder = self._values['batch_folder']
        if not folder:
            raise InterpError('batch_node was started without batch_folder; give it one')
        if not NAME.fullmatch(goal.name):
            raise InterpError(
                'name: may have at most 100 letters, digits, dots, blanks and dashes'
            )
        folders = self._values['program_folders']
        programs = [require_inside(Path(program), folders) for program in goal.programs]
        for program, _ in programs_of(programs):  # a link in a folder may lead out of it
            require_allowed(program, folders)
        machines = list(goal.machines) or [self._values['machine']]
        for machine in goal.machines:
            if Path(machine).exists():  # not a bundled one
                require_allowed(Path(machine), folders)
        asked = ((pair.key, pair.value) for pair in goal.settings)
        settings = with_texts(self._settings, asked, need_units=True)
        if settings.setup != self._settings.setup and settings.setup is not None:
            require_allowed(settings.setup, folders)
        jobs = Jobs(programs, machines, settings, folders=folders)
        out = Path(folder) / goal.name
        note = partial(setattr, self, '_progress')
        store, workers = Store(out / 'results', TaskOutcome.of_json), self._values['workers']
        results = run_batch(jobs, self._processes, store, note, workers)
        table, *_ = write_tables(results, None, out)
        write_page(results, None, out / 'batch.html')
        counts = Counter(outcome.row.verdict for _, outcome in results)
        told = ', '.join(f'{counts[verdict]} {verdict}' for verdict in Verdict if counts[verdict])
        return PlanBatch.Result(
            success=True,
            message=told,
            table=str(table),
            total=len(results),
            proven=counts[Verdict.PROVEN],
            refused=counts[Verdict.REFUSED],
            cycle_time=sum(outcome.row.cycle_time or 0.0 for _, outcome in results),
        )

    def close(self) -> None:
        self._stop.set()
        self._thread.shutdown()


main = partial(run_node, BatchNode, urgent=False)
