"""Find which limit costs time: plan the same path with one kind of limit halved on all axes."""

from dataclasses import replace
from pathlib import Path

from matplotlib import pyplot as plt

import cnc_interp
from cnc_interp import Machine

program, machine = Path(__file__).with_name('five_blocks.ngc'), Machine.load('xyzac')
times = {'as it is': cnc_interp.plan(program, machine).cycle_time}
for name in ('velocity', 'acceleration', 'jerk'):
    halved = {f'max_{name}': getattr(machine, f'max_{name}') / 2}
    slower = replace(machine, limits=machine.limits.having(**halved))
    times[f'half the {name}'] = cnc_interp.plan(program, slower).cycle_time
for name, seconds in times.items():
    print(f'{name}: {seconds:.2f} s')

plt.barh(list(times), list(times.values()))
plt.xlabel('cycle time (s)')
plt.show()
