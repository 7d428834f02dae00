"""Modules that every task needs, imported once by the process that forks the workers."""

import gc

from cnc_interp.batch import sweep as sweep
from cnc_interp.batch.task import Model, Verdict
from cnc_interp.batch.task_work import carry_out, tiny_task
from cnc_interp.feedrate import backward_pass as backward_pass
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.settings.options import DEFAULT_MACHINE

text = find_machine_file(DEFAULT_MACHINE).read_text(encoding='utf-8')
row = carry_out(tiny_task(Model(DEFAULT_MACHINE, text, ''))).row
assert row.verdict is Verdict.PROVEN, row
gc.collect()
gc.freeze()  # the collector ignores these objects from now on, so their memory stays shared
