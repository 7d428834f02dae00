"""
Memory and waiting time of program_node, the real process, for programs of any length.

    python benchmarks/long_programs.py [LINES ...]

Writes a program of so many lines (250,000 and 1,000,000), has program_node run it, and takes its
first 100,000 blocks in place of the other nodes as fast as they come. Prints a table: size of the
file, time from the goal to the first block (all lines are read and checked before), checking
speed, blocks taken per second, and the most memory that the process held: before the goal, at the
first block, and at the last one taken.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1BlockBatch, MachineState, StreamStatus
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from cnc_interp.client.session import nodes_file
from cnc_interp.nodes import qos
from cnc_interp.nodes.seals import SealedPublisher
from cnc_interp.processes.this_host import stay_on_this_host

LENGTHS = (250_000, 1_000_000)
#: Rows of the raster: so many lines of 0.4 mm, to and fro over a wave.
ROW, STEP, WINDOW = 500, 0.4, 512
MOST_TAKEN = 100_000


def write_program(path: Path, lines: int) -> None:
    """Write a 5-axis raster, tool axes within 20 deg of vertical."""
    with path.open('w', encoding='ascii') as file:
        file.write('G21 G90 G94 F3000\nTRAORI\nG0 X0 Y0 Z20 A10 C0\n')
        for k in range(lines - 4):
            row, along = divmod(k, ROW)
            along = ROW - 1 - along if row % 2 else along
            wave = abs(along % 200 - 100) / 100
            place = f'X{STEP * along:.3f} Y{0.05 * (row % 1000):.3f} Z{3 * wave * wave:.4f}'
            file.write(f'G1 {place} A{10 + 5 * wave:.4f} C{20 * wave:.4f}\n')
        file.write('M30\n')


class Taker:
    """Stands in for the other nodes: an idle machine, and a look-ahead that takes every block."""

    def __init__(self, namespace: str, domain: int):
        stay_on_this_host()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node('taker', namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._status = SealedPublisher(self.node, StreamStatus, 'stream_status', qos.STATUS)
        self._state = SealedPublisher(self.node, MachineState, 'machine_state', qos.STATE)
        self.node.create_subscription(G1BlockBatch, 'block_batches', self._take, qos.STREAM)
        self.node.create_timer(0.2, self._tell)
        self.action = ActionClient(self.node, RunProgram, 'run_program')
        self.taken, self.first, self.ended = 0, 0.0, False
        self._program = ''

    def _take(self, batch: G1BlockBatch) -> None:
        for block in batch.blocks:
            if block.sequence == 0:
                self._program, self.first = block.program_id, time.monotonic()
                self.taken = 0
            if block.sequence == self.taken:
                self.taken += 1
                self.ended = block.end_of_program
        self._tell()

    def _tell(self) -> None:
        for stream in ('blocks', 'segments', 'setpoints'):
            own = stream == 'blocks'
            self._status.publish(
                StreamStatus(
                    stream=stream,
                    program_id=self._program,
                    next_sequence=self.taken if own else 0,
                    window_limit=self.taken + WINDOW if own else WINDOW,
                )
            )
        idle = MachineState(state=MachineState.IDLE, interpolation_period=0.001)
        idle.feed_override = idle.rapid_override = idle.spindle_override = 1.0
        self._state.publish(idle)

    def until(self, done: Callable[[], bool], patience: float = 3600.0) -> None:
        """Serve ROS until something is done."""
        deadline = time.monotonic() + patience
        while not done():
            if time.monotonic() > deadline:
                raise TimeoutError
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self.action.destroy()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


def most_memory(process: int) -> float:
    """Return the most memory that a process ever held [MB]."""
    for line in Path(f'/proc/{process}/status').read_text(encoding='ascii').splitlines():
        if line.startswith('VmHWM'):
            return int(line.split()[1]) / 1024
    return 0.0


def measure(lines: int, folder: Path) -> str:
    """Run one program; returns a row of the table."""
    program = folder / 'long.ngc'
    write_program(program, lines)
    namespace, domain = f'/long_{uuid.uuid4().hex[:8]}', 1 + os.getpid() % 100
    command = [sys.executable, '-m', 'cnc_interp.nodes', 'program_node', '--ros-args']
    command += ['-r', f'__ns:={namespace}', '--params-file', str(nodes_file())]
    command += ['-p', f"program_folders:=['{program}']"]
    command += ['-p', 'resend_after:=10.0']  # nothing is lost here, the taker may be slow
    environment = os.environ | {'ROS_DOMAIN_ID': str(domain)}
    taker = Taker(namespace, domain)
    with subprocess.Popen(command, env=environment) as node:
        try:
            taker.until(taker.action.server_is_ready)
            before = most_memory(node.pid)
            started = time.monotonic()
            goal = RunProgram.Goal(program=str(program))
            taker.action.send_goal_async(goal)
            taker.until(lambda: taker.first > 0.0)
            checked = most_memory(node.pid)
            taker.until(lambda: taker.ended or taker.taken >= MOST_TAKEN)
            sending, waiting = time.monotonic() - taker.first, taker.first - started
            end = most_memory(node.pid)
        finally:
            node.terminate()
            taker.close()
    size = program.stat().st_size / 1e6
    return (
        f'| {lines:,} | {size:.0f} | {waiting:.1f} | {lines / waiting:,.0f} '
        f'| {taker.taken / sending:,.0f} | {before:.0f} | {checked:.0f} | {end:.0f} |'
    )


def main() -> None:
    """Print the table."""
    lengths = [int(word) for word in sys.argv[1:]] or LENGTHS
    print(
        '| lines | MB | first block after [s] | lines/s | blocks taken/s '
        '| memory before [MB] | first block | last taken |'
    )
    print('|--:|--:|--:|--:|--:|--:|--:|--:|')
    with tempfile.TemporaryDirectory() as folder:
        for lines in lengths:
            print(measure(lines, Path(folder)), flush=True)


if __name__ == '__main__':
    main()
