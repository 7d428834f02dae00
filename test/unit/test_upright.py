"""Tool axes beside the pole by rounding: put on it within the tolerance, however they arrive."""

from dataclasses import fields, replace

import numpy as np
import pytest
from programs import blocks_of

from cnc_interp.core.units import MM, UM
from cnc_interp.kinematics.axis_rates import traits_of
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.upright import Upright

HEIGHT = 30.0 * MM
XYZAC = traits_of(Transform.of(Machine.load('xyzac')))


def nearly_upright(amplitude, count=12):
    """A straight way; the tool axes beside the pole by a random angle [rad]."""
    beside = np.random.default_rng(3).normal(size=(count, 2)) * amplitude
    axis = np.c_[beside, np.ones(count)]
    tip = np.arange(count)[:, None] * np.array([[1.0, 0.0, 0.0]]) * MM
    return blocks_of(tip, axis / np.linalg.norm(axis, axis=1)[:, None])


def away(blocks):
    """Distance of the tool axes from the pole at flank height [m]."""
    return HEIGHT * np.hypot(*blocks.axis[:, :2].T)


@pytest.mark.parametrize('amplitude', [1e-9, 1e-6])
@pytest.mark.parametrize('tolerance', [1.0 * UM, 20.0 * UM])
def test_what_is_moved_is_taken_from_the_tolerance(amplitude, tolerance):
    blocks = nearly_upright(amplitude)
    blocks = replace(blocks, orientation_tolerance=np.full(len(blocks), tolerance))
    made = Upright(XYZAC, HEIGHT).push(blocks)
    moved = np.linalg.norm(HEIGHT * (made.axis - blocks.axis), axis=1)
    assert (moved <= 0.05 * tolerance).all() and (moved <= 0.5 * UM).all()
    rests = blocks.exact_stop.copy()
    rests[0] = True
    near = (away(blocks) <= 0.05 * tolerance) & (away(blocks) <= 0.5 * UM) & ~rests
    assert near.any()
    assert (away(made)[near] == 0.0).all() and (made.axis[~near] == blocks.axis[~near]).all()
    # A leg deviates by no more than its ends.
    left = blocks.orientation_tolerance - made.orientation_tolerance
    assert (left >= moved - 1e-15).all() and (left[1:] >= moved[:-1] - 1e-15).all()


def test_it_does_not_depend_on_how_the_blocks_arrive():
    blocks, one_by_one = nearly_upright(1e-6), Upright(XYZAC, HEIGHT)
    whole = Upright(XYZAC, HEIGHT).push(blocks)
    parts = Blocks.concatenate([one_by_one.push(blocks[i : i + 1]) for i in range(len(blocks))])
    for column in fields(Blocks):
        np.testing.assert_array_equal(getattr(whole, column.name), getattr(parts, column.name))


def test_words_and_machines_without_a_pole_keep_their_tool_axes():
    blocks = nearly_upright(1e-6)
    named = replace(blocks, rotary=np.zeros((len(blocks), 2)))
    three = traits_of(Transform.of(Machine.load('vmc')))
    for made in (Upright(XYZAC, HEIGHT).push(named), Upright(three, HEIGHT).push(blocks)):
        np.testing.assert_array_equal(made.axis, blocks.axis)
        assert (made.orientation_tolerance == blocks.orientation_tolerance).all()
