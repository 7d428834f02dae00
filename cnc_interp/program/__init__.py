"""Read part programs (usual dialects of G-code, CL data) and convert them to blocks."""

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
