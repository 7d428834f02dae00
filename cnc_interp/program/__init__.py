"""Read part programs in the usual dialects of G-code, and as CL data, into blocks."""

from cnc_interp.program.blocks import Blocks
from cnc_interp.program.job import JobSetup, Tool
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
    'Tool',
    'open_program',
    'read_program',
    'read_text',
]
