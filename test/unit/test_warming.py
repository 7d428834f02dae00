"""Nothing is compiled while axes move: the warm-up reaches every kernel that a program uses."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

RUN = """
import sys
sys.path[:0] = [{here!r}, {here!r} + '/../../benchmarks']
from numba.core.dispatcher import Dispatcher
from cnc_interp.settings.options import Settings
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes.kernel_warmup import warm_all
from cnc_interp.feedrate.planning_windows import FeedPlanner
from cnc_interp.run.planning_chain import Chain
from whole_plans import Kept
from cnc_interp.run.course import LIVE
from programs import dome, zigzag

def compiled():
    return {{
        (name, key, str(signature))
        for name, module in list(sys.modules.items()) if name.startswith('cnc_interp')
        for key, value in vars(module).items() if isinstance(value, Dispatcher)
        for signature in value.overloads
    }}

machine, settings = Machine.load('xyzac'), Settings(compress={curves})
kept = Kept()
chain = Chain(machine, settings, kept)
chain._planner = FeedPlanner(machine, LIVE)
warm_all('xyzac', 0.001)
before = compiled()
stops = [i % 40 == 39 for i in range(300)]
blocks = dome(2000) if settings.compress else zigzag(3, count=300, exact_stop=stops)
for first in range(0, len(blocks), 64):
    chain.push(blocks[first : first + 64])
chain.finish()
assert len(kept.pieces) > 8
print(sorted(compiled() - before))
"""


@pytest.mark.thorough
@pytest.mark.parametrize('curves', [False, True], ids=['corners', 'curves'])
def test_a_long_program_needs_no_kernel_that_was_not_warm(curves):
    code = RUN.format(here=str(Path(__file__).parent), curves=curves)
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == '[]'
