"""Blocks kept in a file are those that were put in, whichever are asked for."""

from dataclasses import fields, replace

import numpy as np
import pytest
from programs import blocks_of

from cnc_interp.program.blocks import Blocks, BlockSpool


def random_blocks(n):
    """Rows that differ in every column, some of them control points."""
    rng = np.random.default_rng(n)
    blocks = blocks_of(rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rapid=rng.random(n) < 0.5)
    spline = rng.random(n) < 0.5
    return replace(
        blocks,
        top=np.where(spline[:, None], rng.normal(size=(n, 3)), np.nan),
        knot_interval=np.where(spline, rng.random(n), np.nan),
    )


def assert_same(a, b):
    for column in fields(Blocks):
        mine, other = getattr(a, column.name), getattr(b, column.name)
        assert (mine.dtype, mine.shape) == (other.dtype, other.shape)
        assert mine.tobytes() == other.tobytes(), column.name


def test_what_is_put_in_in_parts_comes_out_in_any_slices():
    blocks = random_blocks(1000)
    with BlockSpool() as spool:
        for first in range(0, 1000, 64):
            spool.append(blocks[first : first + 64])
            assert len(spool) == min(1000, first + 64)
            assert_same(spool[first : first + 5], blocks[first : first + 5])
        for rows in (
            slice(0, 1000),
            slice(0, 1),
            slice(999, 1000),
            slice(990, 2000),
            slice(5, 5),
            slice(7, 3),
            slice(-3, None),
        ):
            assert_same(spool[rows], blocks[rows])


def test_a_closed_spool_is_gone():
    spool = BlockSpool()
    assert len(spool) == 0
    spool.append(random_blocks(3))
    spool.close()
    with pytest.raises(ValueError, match='closed'):
        spool[0:1]
