"""
Everything that the nodes need, imported once by the process that they are forked from.

Importing this module is its purpose: libraries, the nodes' own modules and the compiled kernels
are in memory afterwards, and no thread of ours runs, so that a fork is safe.
"""

import gc

from cnc_interp.nodes import feedrate_node, lookahead_node, machine_node, program_node
from cnc_interp.nodes.kernel_warmup import warm_shared

__all__ = ['feedrate_node', 'lookahead_node', 'machine_node', 'program_node']

warm_shared()
gc.collect()
gc.freeze()  # the collector ignores these objects from now on, so their memory stays shared
