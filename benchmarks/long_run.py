"""
A long run through the real nodes while another core is busy: nothing lost, memory constant.

``PYTHONPATH=.:test/ros:test/unit python benchmarks/long_run.py --minutes 60`` runs corners and
rotations for about an hour. ``--blocks 100000`` runs short blocks at a high feed instead
(``--length`` and ``--feed`` set block length and feed), ``--program`` any other program;
``--priority 0`` runs the clock without SCHED_FIFO, ``--page-out`` does not lock its memory, and
``--period 0.25`` sets the interpolation period in ms. Every executed setpoint is checked as it is
reported: numbers without a gap; velocity, acceleration and jerk by differences. If ``cyclictest``
of rt-tests is installed, it runs beside with the same priority and shows the lateness that the
kernel causes for any thread.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import SetpointChunk, StreamStatus
from diagnostic_msgs.msg import DiagnosticArray
from nodes_under_test import NodesUnderTest
from operated import LIMITS, waves

from cnc_interp.core.axis_limits import Limits
from cnc_interp.nodes import qos
from cnc_interp.run.setpoints import BEFORE, largest_shares

#: Corners and turns that take a minute.
WAVES_A_MINUTE = 90
#: Times that memory is looked at on the way, and the share of the way after which it must be flat.
LOOKS, SETTLED = 20, 0.2
#: A turn of the program of short blocks: its radius [mm].
RADIUS = 60.0
#: Latest wake-up in the histogram of cyclictest [us].
LATEST = 100_000
TICKS = os.sysconf('SC_CLK_TCK')
BUSY = 'while True: pass'


def short_blocks(count: int, length: float, feed: float) -> str:
    """Program of blocks of one length [mm] round and round, all five axes moving; F [mm/min]."""
    u = np.arange(1, count + 1) * length / RADIUS
    x, y, z = RADIUS * (1 - np.cos(u)), RADIUS * np.sin(u), 5 * np.sin(u / 7)
    a, c = 15 + 4 * np.sin(u / 3), 30 + 20 * np.sin(u / 5)
    lines = [f'X{x[k]:.4f} Y{y[k]:.4f} Z{z[k]:.4f} A{a[k]:.4f} C{c[k]:.4f}' for k in range(count)]
    head = f'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\nG1 F{feed:g}\n'
    return head + '\n'.join(lines) + '\nM30\n'


class Usage:
    """CPU time and memory of processes, as Linux counts them."""

    def __init__(self, process_ids: dict[str, int]):
        self._ids = process_ids
        self._since = self._cpu()
        self._begin = time.monotonic()

    def _cpu(self) -> dict[str, float]:
        found = {}
        for name, number in self._ids.items():
            words = Path(f'/proc/{number}/stat').read_text().rpartition(')')[2].split()
            found[name] = (int(words[11]) + int(words[12])) / TICKS
        return found

    def memory(self) -> dict[str, float]:
        """Return the resident memory of each process [MB]."""
        page = os.sysconf('SC_PAGE_SIZE') / 1e6
        return {
            name: int(Path(f'/proc/{number}/statm').read_text().split()[1]) * page
            for name, number in self._ids.items()
        }

    def cpu(self) -> dict[str, float]:
        """Return the share of a core that each has used since the beginning [-]."""
        elapsed = time.monotonic() - self._begin
        return {name: (used - self._since[name]) / elapsed for name, used in self._cpu().items()}


class LongRun(NodesUnderTest):
    """The nodes, and figures of what goes over their topics; memory of its own stays flat."""

    def __init__(self, period: float, clock: dict[str, object]) -> None:
        own = {'interpolation_period': period}
        nodes = dict.fromkeys(('lookahead_node', 'feedrate_node'), own)
        nodes['program_node'] = own | {'program_folders': "['/']"}
        super().__init__(nodes | {'machine_node': own | clock})
        self._limits, self._period = Limits.constant(*LIMITS), period
        self.run = ''
        self._looks: list[tuple[float, dict[str, float]]] = []
        self.clock: dict[str, str] = {}
        self.scheduling = ''
        self._received: dict[tuple[int, int], int] = {}
        self._sent = 0
        self.executed = self.lost = 0
        self._last: np.ndarray | None = None
        self.use = np.zeros((3, 5))
        self.node.create_subscription(
            SetpointChunk, 'executed_setpoints', self._see_executed, qos.STREAM
        )
        self.node.create_subscription(
            StreamStatus, 'stream_status', self._see_received, qos.STATUS
        )
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._see_clock, qos.DIAGNOSTICS
        )

    def _see_received(self, status: StreamStatus) -> None:
        if status.stream == 'setpoints' and status.program_id == self.run:
            self._received[status.attempt, status.plan] = status.next_sequence

    @property
    def received(self) -> int:
        """Setpoints that the machine has received without a gap, of all plans."""
        return sum(self._received.values())

    def _see_executed(self, chunk: SetpointChunk) -> None:
        self.lost += chunk.first_sample - self.executed
        self.executed = chunk.first_sample + len(chunk.sequences)
        q = np.reshape(chunk.positions, (-1, 5))
        before = q[:1].repeat(BEFORE, 0) if self._last is None else self._last
        held = np.concatenate([before, q])
        self.use = np.maximum(self.use, largest_shares(held, self._limits, self._period))
        self._last = held[-BEFORE:]

    def _see_clock(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.hardware_id != self.namespace:
                continue
            values = {pair.key: pair.value for pair in status.values}
            if status.name == 'machine_node: clock':
                self.scheduling, self.clock = status.message, values
            elif status.name == 'feedrate_node: planning':
                self._sent = int(values['setpoints_sent'])

    def go(self, program: Path, patience: float) -> RunProgram.Result:
        """Run the program to its end and print what there is to see on the way."""
        usage = Usage({name: node.process.pid for name, node in self.children.nodes.items()})
        handle = self.start(program=str(program))
        wanted = handle.get_result_async()
        self.spin_until(lambda: (self.executed > 0 and self.loaded) or wanted.done(), patience)
        if not self.executed:
            unmoved: RunProgram.Result = wanted.result().result
            print(f'nothing moved: {unmoved.message}')
            return unmoved
        memory, began = usage.memory(), time.monotonic()
        usage = Usage({name: node.process.pid for name, node in self.children.nodes.items()})
        print('progress  ' + '  '.join(f'{name:>14}' for name in memory) + '  resident MB')
        shown = 0

        def done() -> bool:
            nonlocal shown
            self.states.clear()
            self.diagnostics.clear()
            state, length = self.peers.state, self.loaded[-1].path_length
            share = state.path_position / length if state.program_id == self.run else 0.0
            if share * LOOKS >= shown:
                shown += 1
                self._looks.append((share, usage.memory()))
                tell_memory(*self._looks[-1])
            return bool(wanted.done())

        self.run = self.loaded[-1].program_id
        self.spin_until(done, patience)
        result: RunProgram.Result = wanted.result().result
        until = time.monotonic() + 3.0  # what is told once a second
        self.spin_until(
            lambda: time.monotonic() > until and self.executed >= self.peers.state.samples
        )
        self.tell(result, usage, memory, time.monotonic() - began)
        return result

    def tell(
        self, result: RunProgram.Result, usage: Usage, memory: dict[str, float], elapsed: float
    ) -> None:
        """Print the figures of the whole run."""
        tell_memory(1.0, usage.memory())
        after, cpu = usage.memory(), usage.cpu()
        print(
            f'\nresult     {result.message}: blocks {result.blocks_sent} sent, '
            f'{result.blocks_executed} executed, {result.blocks_executed / elapsed:.0f} a second'
        )
        print(
            f'setpoints  {self._sent} sent, {self.received} received, {self.executed} executed '
            f'(stops after discarded ones included), {self.lost} lost; {elapsed:.0f} s'
        )
        print(
            f'underruns  {result.starvations}; buffer never below '
            f'{result.least_buffered_time * 1e3:.0f} ms'
        )
        print(
            'largest use of velocity, acceleration, jerk: '
            + ', '.join(f'{use:.4f}' for use in self.use.max(axis=1))
        )
        print(
            f'clock      late by p50 {self.clock["late_p50_us"]} us, p99 '
            f'{self.clock["late_p99_us"]} us, p99.9 {self.clock["late_p999_us"]} us, largest '
            f'{self.clock["late_max_us"]} us; '
            f'{self.clock["missed_periods"]} of {self.clock["periods"]} periods caught up '
            f'({self.scheduling})'
        )
        slopes = self.slopes(result.blocks_executed)
        for name, share in cpu.items():
            print(
                f'{name:<15}{share:5.0%} of a core, {memory[name]:.0f} MB at the start, '
                f'{after[name]:.0f} MB at the end; {slopes.get(name, np.nan):+.3f} MB per 1000 '
                f'blocks after {SETTLED:.0%} of the way',
                flush=True,
            )

    def slopes(self, blocks: int) -> dict[str, float]:
        """Fit how the memory of each process grows once it has settled [MB per 1000 blocks]."""
        settled = [look for look in self._looks if look[0] >= SETTLED]
        if len(settled) < 3 or not blocks:
            return {}
        done = np.array([share for share, _ in settled]) * blocks / 1000.0
        return {
            name: float(np.polyfit(done, [memory[name] for _, memory in settled], 1)[0])
            for name in settled[0][1]
        }


class Cyclictest:
    """The lateness that the kernel gives any thread, measured in the same minutes."""

    def __init__(self, priority: int, interval: float):
        path = shutil.which('cyclictest')
        scheduling = [f'-p{priority}'] if priority else ['--policy=other']
        command = (
            [path, '-m', '-q', f'-i{interval:.0f}', f'-h{LATEST}', *scheduling] if path else []
        )
        self._process = (
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) if command else None
        )

    def tell(self) -> None:
        """End it and print its figures."""
        if self._process is None:
            print('cyclictest is not installed (rt-tests)')
            return
        self._process.send_signal(signal.SIGINT)
        lines = self._process.communicate()[0].splitlines()
        rows = [line.split() for line in lines if line[:1].isdigit()]
        late, count = np.array(rows, dtype=np.int64).T
        largest = next(line.split()[-1] for line in lines if 'Max Latencies' in line)
        beyond = next(line.split()[-1] for line in lines if 'Overflows' in line)
        share = np.cumsum(count) / (count.sum() + int(beyond))
        p50, p99, p999 = (late[np.searchsorted(share, p)] for p in (0.5, 0.99, 0.999))
        print(
            f'cyclictest late by p50 {p50} us, p99 {p99} us, p99.9 {p999} us, largest '
            f'{int(largest)} us',
            flush=True,
        )


def tell_memory(share: float, memory: dict[str, float]) -> None:
    """Print a line of the table of memory."""
    print(f'{share:8.0%}  ' + '  '.join(f'{size:14.1f}' for size in memory.values()), flush=True)


def main() -> int:
    """Run what is asked for."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument('--minutes', type=float, default=60.0)
    asked.add_argument('--blocks', type=int, help='short blocks, this many, instead')
    asked.add_argument('--length', type=float, default=0.2, help='of a short block [mm]')
    asked.add_argument('--feed', type=float, default=6000.0, help='of short blocks [mm/min]')
    asked.add_argument('--busy', type=int, default=1, help='busy processes beside it')
    asked.add_argument('--priority', type=int, default=10, help='SCHED_FIFO of the clock')
    asked.add_argument('--page-out', action='store_true', help='memory of the machine node')
    asked.add_argument('--period', type=float, default=1.0, help='interpolation period [ms]')
    asked.add_argument('--program', type=Path, help='a program instead')
    options = asked.parse_args()
    if options.program:
        text = options.program.read_text(encoding='utf-8')
    elif options.blocks:
        text = short_blocks(options.blocks, options.length, options.feed)
    else:
        text = waves(max(2, round(options.minutes * WAVES_A_MINUTE)))
    clock = {'realtime_priority': options.priority, 'lock_memory': not options.page_out}
    run = LongRun(options.period * 1e-3, clock)
    kernel = Cyclictest(options.priority, options.period * 1e3)
    busy = [subprocess.Popen([sys.executable, '-c', BUSY]) for _ in range(options.busy)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / 'long.ngc'
            program.write_text(text)
            result = run.go(program, patience=10 * 60.0 * options.minutes + 3600.0)
    finally:
        kernel.tell()
        for process in busy:
            process.kill()
            process.wait()
        run.close()
    kept = run.lost == 0 and run.use.max() <= 1.001
    return 0 if result.code == RunProgram.Result.SUCCEEDED and kept else 1


if __name__ == '__main__':
    sys.exit(main())
