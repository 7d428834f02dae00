"""text -> Block: part programs in the dialects that shops use."""

from cnc_interp.program.blocks import Blocks
from cnc_interp.program.options import ReadOptions, RotaryGeometry
from cnc_interp.program.reading import Program, read_program, read_text

__all__ = ['Blocks', 'Program', 'ReadOptions', 'RotaryGeometry', 'read_program', 'read_text']
