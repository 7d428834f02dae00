"""Describe a machine of your own: a head that turns about a direction between Y and Z."""

import tempfile
from pathlib import Path

from matplotlib import pyplot as plt

import cnc_interp

WAY = 'velocity_m_per_min: 30, acceleration_m_per_s2: 3, jerk_m_per_s3: 30'
TURN = 'velocity_rev_per_min: 20, acceleration_rev_per_s2: 2, jerk_rev_per_s3: 20'
FILE = f"""
name: nutating
rotary:
  primary: {{name: B, about: [0, 1, 1], carries: tool}}
  secondary: {{name: C, about: [0, 0, 1], carries: workpiece}}
  workpiece_offset_mm: [0, 0, 50]  # workpiece zero from the C axis
  secondary_offset_mm: [300, 0, 100]  # C axis in the machine
  primary_offset_mm: [0, 0, 0]
  tip_to_secondary_pivot_mm: [0, 0, 120]
  secondary_to_primary_pivot_mm: [0, 0, 180]
limits:
  X: {{{WAY}, travel_mm: [-900, 900]}}
  Y: {{{WAY}, travel_mm: [-900, 900]}}
  Z: {{{WAY}, travel_mm: [-900, 900]}}
  B: {{{TURN}}}
  C: {{{TURN}}}
"""
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder, 'nutating.yaml')
    file.write_text(FILE)
    plan = cnc_interp.plan(Path(__file__).with_name('pyramid.apt'), file)
print(plan)
print('proven:', plan.check().ok)

plt.plot(plan.setpoints.time, plan.setpoints.position[:, 3:] * 57.2958)
plt.legend(plan.machine.axis_names[3:])
plt.xlabel('time (s)')
plt.ylabel('rotary axes (deg)')
plt.show()
