"""Import the modules of all nodes once, in the process that forks the nodes."""

import gc
from importlib import import_module

from cnc_interp.processes.node_processes import NODES

gc.disable()  # imports leave no garbage; searching for it would take a tenth of the time
for node in NODES:
    import_module(f'cnc_interp.nodes.{node}')
import_module('cnc_interp.nodes.kernel_warmup').warm_shared()
gc.freeze()  # the collector ignores these objects from now on, so their memory stays shared
gc.enable()
