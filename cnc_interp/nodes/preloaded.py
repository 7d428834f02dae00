"""
Everything that the nodes need, imported once by the process that they are forked from.

Importing this module is its purpose: libraries, the nodes' own modules and the compiled kernels
are in memory afterwards, and no thread of ours runs, so that a fork is safe.
"""

import gc

from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import feedrate_node, lookahead_node, machine_node, program_node
from cnc_interp.nodes.kernel_warmup import warm_all, warm_lookahead
from cnc_interp.settings.choices import Settings

__all__ = ['feedrate_node', 'lookahead_node', 'machine_node', 'program_node']

TRANSFORM = Transform.of(Machine.load('xyzac'))
SETTINGS = Settings()
warm_lookahead(TRANSFORM, SETTINGS)
warm_all(TRANSFORM, SETTINGS.interpolation_period)
gc.collect()
gc.freeze()  # ignored by the collector from here on, so that the memory stays shared
