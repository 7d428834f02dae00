"""
How long a run takes until the machine moves, from its command and from a goal to running nodes;
and how long nodes take to find each other.

``PYTHONPATH=.:test/ros python benchmarks/start.py [--runs 10]`` prints these times. For the last
one, a node is started first and four others a while later, as in a run, where the client's node
exists before the others.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from nodes_under_test import NodesUnderTest

ROOT = Path(__file__).resolve().parents[1]
#: Nodes that look for each other, topics of each, and the longest look [s].
NODES, TOPICS, LONGEST = 5, 10, 6.0


def first_motion() -> float:
    """Return the time from the command to the first executed setpoint [s]."""
    command = [sys.executable, '-m', 'cnc_interp', 'run', 'examples/pyramid.ngc', '--json']
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout)['start_to_motion'])


def motion_after_goal(nodes: NodesUnderTest) -> float:
    """Return the time from a goal to the first state in motion, on nodes that run [s]."""
    nodes.states.clear()
    begun = time.monotonic()
    handle = nodes.start(program=str(ROOT / 'examples' / 'pyramid.ngc'))
    nodes.spin_until(
        lambda: any(
            state.state == MachineState.RUNNING
            and state.waits_for == MachineState.WAITS_FOR_NOTHING
            for state in nodes.states
        )
    )
    found = time.monotonic() - begun
    assert nodes.result_of(handle).code == RunProgram.Result.SUCCEEDED
    return found


def look(
    number: int, domain: int, begin: float, found: multiprocessing.Queue[tuple[float, float]]
) -> None:
    """Be a node from a time on; report when it and all others see each other's topics."""
    time.sleep(max(0.0, begin - time.monotonic()))
    from cnc_interp.processes.this_host import stay_on_this_host

    stay_on_this_host()
    import rclpy
    from std_msgs.msg import String

    rclpy.init(domain_id=domain)
    node = rclpy.create_node(f'node_{number}')
    names = [[f'of_{i}_{k}' for k in range(TOPICS)] for i in range(NODES)]
    own = [node.create_publisher(String, name, 10) for name in names[number]]
    others = [name for i in range(NODES) if i != number for name in names[i]]
    for name in others:
        node.create_subscription(String, name, lambda _: None, 10)
    begun = time.monotonic()
    while time.monotonic() < begun + LONGEST:
        heard = all(publisher.get_subscription_count() == NODES - 1 for publisher in own)
        if heard and all(node.count_publishers(name) for name in others):
            break
        time.sleep(0.002)
    found.put((begun, time.monotonic()))
    time.sleep(max(0.0, begun + LONGEST - time.monotonic()))
    node.destroy_node()
    rclpy.shutdown()


def discovery(delay: float) -> float:
    """Return the time until all nodes see each other, once the last one is made [s]."""
    context = multiprocessing.get_context('spawn')
    found, domain = context.Queue(), random.randrange(1, 101)
    early = time.monotonic() + 0.5
    late = early + delay
    processes = [
        context.Process(target=look, args=(i, domain, late if i else early, found))
        for i in range(NODES)
    ]
    for process in processes:
        process.start()
    times = [found.get() for _ in processes]
    for process in processes:
        process.join()
    begun, seen = zip(*times, strict=True)
    return max(seen) - max(begun)


def tell(title: str, measure: Callable[[], float], runs: int) -> None:
    """Measure some times, and print a line."""
    values = sorted(measure() for _ in range(runs))
    spread = f'{values[0]:.2f} to {values[-1]:.2f} s'
    print(f'{title:<28} median {median(values):.2f} s, {spread}, {runs} times', flush=True)


def main() -> None:
    """Print all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=10)
    runs = parser.parse_args().runs
    nodes = NodesUnderTest()
    motion_after_goal(nodes)  # leaves the tool at the end of the program
    tell('first motion after a goal', lambda: motion_after_goal(nodes), runs)
    nodes.close()
    tell('first motion after start', first_motion, runs)
    tell('nodes found, 2 s after one', lambda: discovery(2.0), runs)


if __name__ == '__main__':
    main()
