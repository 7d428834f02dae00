"""Tool axes beside the pole by rounding: put on it within the tolerance, however they arrive."""

from dataclasses import fields, replace

import numpy as np
import pytest
from programs import blocks_of

from cnc_interp.core.units import MM, UM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.pole import Upright

HEIGHT = 30.0 * MM
XYZAC = traits_of(Transform.of(Machine.load('xyzac')))


def nearly_upright(amplitude, count=12):
    """A straight way; the tool axes beside the pole by a random angle [rad]."""
    beside = np.random.default_rng(3).normal(size=(count, 2)) * amplitude
    axis = np.c_[beside, np.ones(count)]
    tip = np.arange(count)[:, None] * np.array([[1.0, 0.0, 0.0]]) * MM
    return blocks_of(tip, axis / np.linalg.norm(axis, axis=1)[:, None])


def moved_to_pole(blocks, batch=None, machine=XYZAC):
    """The blocks, pushed in batches."""
    upright, step = Upright(machine, HEIGHT), batch or len(blocks)
    parts = [upright.push(blocks[i : i + step]) for i in range(0, len(blocks), step)]
    last = upright.finish()
    return Blocks.concatenate(parts if last is None else [*parts, last])


def away(blocks):
    """Distance of the tool axes from the pole at flank height [m]."""
    return HEIGHT * np.hypot(*blocks.axis[:, :2].T)


@pytest.mark.parametrize('amplitude', [1e-9, 1e-6])
@pytest.mark.parametrize('tolerance', [1.0 * UM, 20.0 * UM])
def test_what_is_moved_is_taken_from_the_tolerance(amplitude, tolerance):
    blocks = nearly_upright(amplitude)
    allowed = np.full(len(blocks), tolerance)
    allowed[7] = 1e-3 * UM
    blocks = replace(blocks, orientation_tolerance=allowed)
    made = moved_to_pole(blocks)
    moved = np.linalg.norm(HEIGHT * (made.axis - blocks.axis), axis=1)
    most = np.minimum(0.05 * allowed, 0.5 * UM)
    most[:-1] = np.minimum(most[:-1], most[1:])
    assert (moved <= most).all()
    rests = np.zeros(len(blocks), dtype=bool)
    rests[[0, -1]] = True
    near = (away(blocks) <= most) & ~rests
    assert near.any() and (made.orientation_tolerance > 0.9 * allowed).all()
    assert (away(made)[near] == 0.0).all() and (made.axis[~near] == blocks.axis[~near]).all()
    # A leg deviates by no more than its ends.
    left = blocks.orientation_tolerance - made.orientation_tolerance
    assert (left >= moved - 1e-15).all() and (left[1:] >= moved[:-1] - 1e-15).all()


@pytest.mark.parametrize('batch', [1, 5])
def test_it_does_not_depend_on_how_the_blocks_arrive(batch):
    blocks = nearly_upright(1e-6)
    whole, parts = moved_to_pole(blocks), moved_to_pole(blocks, batch)
    for column in fields(Blocks):
        np.testing.assert_array_equal(getattr(whole, column.name), getattr(parts, column.name))


@pytest.mark.parametrize('batch', [1, None])
def test_the_tool_stands_as_programmed_at_stops_and_before_splines(batch):
    blocks = nearly_upright(1e-6)
    knots = np.full(len(blocks), np.nan)
    knots[8:] = 1.0
    stop = np.arange(len(blocks)) == 4
    top = np.where(np.isfinite(knots)[:, None], blocks.tip + HEIGHT * blocks.axis, np.nan)
    made = moved_to_pole(replace(blocks, exact_stop=stop, knot_interval=knots, top=top), batch)
    kept = [0, 4, 7, *range(8, len(blocks))]
    assert (made.axis[kept] == blocks.axis[kept]).all()
    assert (away(made)[[1, 2, 3, 5, 6]] == 0.0).all()


def test_words_and_machines_without_a_pole_keep_their_tool_axes():
    blocks = nearly_upright(1e-6)
    named = replace(blocks, rotary=np.zeros((len(blocks), 2)))
    three = traits_of(Transform.of(Machine.load('vmc')))
    for made in (moved_to_pole(named), moved_to_pole(blocks, machine=three)):
        np.testing.assert_array_equal(made.axis, blocks.axis)
        assert (made.orientation_tolerance == blocks.orientation_tolerance).all()
