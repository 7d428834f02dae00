"""
Everything that the nodes need, imported once by the process that they are forked from.

Importing this module is its purpose: libraries, the nodes' own modules and the compiled kernels
are in memory afterwards, and no thread of ours runs, so that a fork is safe.
"""

import gc
from importlib import import_module

from cnc_interp.processes.node_processes import NODES

gc.disable()  # nothing is thrown away here; to look for it would take a tenth of the time
for node in NODES:
    import_module(f'cnc_interp.nodes.{node}')
import_module('cnc_interp.nodes.kernel_warmup').warm_shared()
gc.freeze()  # the collector ignores these objects from now on, so their memory stays shared
gc.enable()
