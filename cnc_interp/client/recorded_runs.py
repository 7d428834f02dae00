"""Runs of programs whose bag becomes plan files, or is kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from cnc_interp.client.bag import TOPICS, Bag
from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.recorded_run import recorded_run, write_run
from cnc_interp.client.recorder import NEEDED, Recorder
from cnc_interp.client.run_console import RunConsole
from cnc_interp.client.session import RunRequest, RunResult
from cnc_interp.feedrate.plan_options import tool_warnings
from cnc_interp.machine_model.machine import Machine
from cnc_interp.processes.node_processes import Children
from cnc_interp.processes.temporary_folder import TemporaryFolder
from cnc_interp.program.notices import tell


def run_recorded(
    request: RunRequest,
    machine: Machine,
    client: OperatorClient,
    children: Children,
    started: float,
) -> list[RunResult]:
    """Run programs, record them where that is asked for, and write the plan files of ``out``.

    A limit of the error at the tool is judged by the executed setpoints, so they are recorded.
    """
    tell(tool_warnings(machine, request.settings))
    judged = request.settings.tool_error is not None
    with bag_folder(request) as folder:
        with ExitStack() as records:
            recorder = None
            if folder is not None:
                topics = NEEDED if request.record is None else TOPICS
                recorder = Recorder(client.node, folder, topics)
                records.callback(recorder.finish, client)
            with RunConsole(client, children, request, recorder) as console:
                results = console.run(machine, started)
        if folder is not None and (request.out is not None or judged):
            with Bag(folder) as bag:
                results = [written(bag, result, machine, request.out) for result in results]
    return results


def written(bag: Bag, result: RunResult, machine: Machine, out: Path | None) -> RunResult:
    """Write the plan files of a run that has ended well; return its result with their figures."""
    if not result.ok:
        return result
    run = replace(recorded_run(bag, result.program_id), name=result.program)
    with TemporaryFolder() as folder:
        summary = write_run(run, machine, out or Path(folder))
    return replace(result, tool_error=summary['tool_error'], flank_height=summary['flank_height'])


@contextmanager
def bag_folder(request: RunRequest) -> Iterator[Path | None]:
    """Yield the bag of a run: as asked for, or one for what is computed of it, or none."""
    if request.record is not None or request.out is None:
        if request.record is not None or request.settings.tool_error is None:
            yield request.record
        else:
            with TemporaryFolder() as folder:
                yield Path(folder) / 'bag'
        return
    created = not request.out.exists()
    request.out.mkdir(parents=True, exist_ok=True)
    try:
        with TemporaryDirectory(prefix='.run-', dir=request.out) as folder:
            yield Path(folder) / 'bag'
    finally:
        if created and not any(request.out.iterdir()):
            request.out.rmdir()
