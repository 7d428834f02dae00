"""Convert rows of targets to blocks, with the functions and modal states of the program."""

from cnc_interp.program.blocks.block_table import (
    AXES_LINEAR,
    GO_ON,
    OPEN_CORNER,
    OPTIONAL_STOP,
    POSES,
    ROTARY_LINEAR,
    ROUND_CORNER,
    STOP,
    STOP_CORNER,
    WITHIN_MOTION,
    Blocks,
    BlockSpool,
)

__all__ = [
    'AXES_LINEAR',
    'GO_ON',
    'OPEN_CORNER',
    'OPTIONAL_STOP',
    'POSES',
    'ROTARY_LINEAR',
    'ROUND_CORNER',
    'STOP',
    'STOP_CORNER',
    'WITHIN_MOTION',
    'BlockSpool',
    'Blocks',
]
