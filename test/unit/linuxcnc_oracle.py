"""Blocks of our reader against LinuxCNC's interpreter (``rs274``), as `check --program` does."""

from dataclasses import replace

import numpy as np

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_program
from cnc_interp.proof.compared_moves import RowsByPlace
from cnc_interp.proof.linuxcnc_reader import LinuxCNCError, Setup, read_by_linuxcnc
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.settings.options import Settings

#: Public programs that LinuxCNC reads: the machine for their words, and whether only to a part.
PROGRAMS = {
    'camotics-heart': ('xyz', False),
    'cnclite-blend-mpf': ('xyz', False),
    'fanuc-test-g91': ('xyz', False),
    'linuxcnc-cds': ('xyz', False),
    'linuxcnc-impeller-xyzac': ('xyzac', False),
    'linuxcnc-stellabee': ('xyz', False),
    'mach-pulley-r-arcs': ('xyz', False),
    'nist-box-op5': ('xyz', True),
    'opencn-congee-5x': ('xyzbc', False),
    'pycam-sample': ('xyz', False),
    'qtpyvcp-bezel': ('xyz', False),
    'solidcam-4x-rotx': ('xyza', False),
    'ugs-gates': ('xyz', False),
}


def motions_of(path, machine, rows, lengths=None, partly=False):
    """Yield LinuxCNC's motions; also those before it stops, where it reads only a part."""
    text = path.read_text('utf-8-sig', errors='replace')
    try:
        setup = Setup(tool_lengths=lengths or {})
        yield from read_by_linuxcnc(text, machine.axis_names, False, rows, setup)
    except LinuxCNCError:
        if not partly:
            raise


def columns_of(blocks):
    """Return the columns of a plan of blocks."""
    return {'extra_axes': np.zeros((len(blocks), 0))} | block_columns(blocks)


def judged(path, machine_name, partly, tools=None):
    """Compare a file; machine coordinates are LinuxCNC's: zero at the workpiece zero."""
    machine = replace(Machine.load(machine_name), offsets=np.zeros((3, 3)))
    at_zero = {f'G{number}': dict.fromkeys('XYZ', 0.0) for number in range(54, 60)}
    lengths = {number: length / 1e3 for number, length in (tools or {}).items()}
    setup = JobSetup(at_zero, {number: Tool(length) for number, length in lengths.items()})
    blocks = read_program(path, Transform.of(machine), Settings(feedrate=0.05), setup).blocks
    moves = motions_of(path, machine, len(blocks), lengths, partly)
    found = RowsByPlace(columns_of(blocks), machine).follow(moves)
    beyond = tuple(fault for fault in found.faults if not (partly and 'no motion of' in fault))
    return replace(found, faults=beyond)
