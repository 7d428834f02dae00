"""text -> Block: part programs in the dialects that shops use."""

from cnc_interp.program.blocks import Blocks
from cnc_interp.program.job import JobSetup
from cnc_interp.program.options import ReadOptions, RotaryGeometry
from cnc_interp.program.reading import (
    Program,
    ProgramStream,
    open_program,
    read_program,
    read_text,
)

__all__ = [
    'Blocks',
    'JobSetup',
    'Program',
    'ProgramStream',
    'ReadOptions',
    'RotaryGeometry',
    'open_program',
    'read_program',
    'read_text',
]
