"""Each block keeps its own tolerance where tolerances change in the middle of a program."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import few_of
from whole_plans import plan_program, write_plan

from cnc_interp.core import UM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify
from cnc_interp.run.path_chain import PathChain, segments_of
from cnc_interp.run.plan_figures import ToleranceUse
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import SPLINE

MACHINE = Machine.load('xyzac')
#: Tolerances in the order in which they hold [mm], and after how many blocks each ends.
CHANGES = {
    'smaller': ((0.1, 0.01), 20),
    'larger': ((0.01, 0.1), 20),
    'a little': ((0.02, 0.015), 20),
    'narrow place': ((0.05, 0.002, 0.05), 15),
    'every fifth block': ((0.05, 0.01) * 5, 5),
    'every block': ((0.05, 0.02) * 25, 1),
    'a staircase': ((0.1, 0.05, 0.02, 0.01, 0.005), 10),
    'a factor of 1000': ((0.5, 0.0005), 20),
}


def points_of(shape):
    """Return tips [mm] and rotary words [deg] of 50 blocks of about 1 mm, or of 5 mm."""
    k = np.arange(51.0)
    rotary = np.column_stack([10.0 + 0 * k, 0 * k])
    if shape == 'arc':
        return np.column_stack([20 * np.sin(k / 20), 20 - 20 * np.cos(k / 20), 0 * k]), rotary
    if shape == 'arc with turning tool':
        turned = np.column_stack([10 + 5 * np.sin(k / 12), 0.6 * k])
        return np.column_stack([20 * np.sin(k / 20), 20 - 20 * np.cos(k / 20), 0 * k]), turned
    if shape == 'noise':
        noise = np.random.default_rng(7).normal(0.0, 0.003, (51, 3))
        return np.column_stack([k, 0 * k, 0 * k]) + noise, rotary
    zigzag = np.column_stack([5.0 * k, 3.0 * (k % 2), 0 * k])  # corners of long blocks
    return zigzag - [120.0, 0.0, 0.0], np.column_stack([10 + k % 3, 0 * k])


def text_of(shape, change):
    """Write the program."""
    tolerances, length = CHANGES[change]
    tip, rotary = points_of(shape)
    lines = ['G21 G90 TRAORI']
    for k, (p, r) in enumerate(zip(tip, rotary, strict=True)):
        if k % length == 0 and k // length < len(tolerances):
            lines.append(f'G64 P{tolerances[k // length]:g}')
        words = ' '.join(f'{n}{v:.6f}' for n, v in zip('XYZAC', [*p, *r], strict=True))
        lines.append(f'{"G0" if k == 0 else "G1"} {words} F1500')
    return '\n'.join(lines)


@pytest.mark.parametrize(
    ('change', 'shape', 'compress'),
    few_of(9, CHANGES, ('arc', 'arc with turning tool', 'noise', 'corners'), (True, False)),
)
def test_every_block_keeps_its_tolerance(change, shape, compress, tmp_path):
    settings = replace(Settings(), compress=compress)
    program = read_text(text_of(shape, change), 'a.ngc', Transform.of(MACHINE), settings)
    assert len(np.unique(program.blocks.contour_tolerance[1:])) == len(set(CHANGES[change][0]))
    write_plan(plan_program(program, MACHINE, settings), tmp_path)
    proof = verify(read_plan(tmp_path), MACHINE)
    assert proof.ok, proof.failures


@pytest.mark.parametrize(
    ('shape', 'tolerance'),
    few_of(4, ('arc', 'arc with turning tool', 'corners'), (1.0, 0.3, 0.1)),
)
def test_uniform_tolerances_of_a_micrometre_and_less(shape, tolerance, tmp_path):
    text = text_of(shape, 'smaller').replace('G64 P0.1\n', f'G64 P{tolerance * 1e-3:g}\n')
    text = text.replace('G64 P0.01\n', '')
    program = read_text(text, 'a.ngc', Transform.of(MACHINE), Settings())
    assert program.blocks.contour_tolerance[1:] == pytest.approx(tolerance * UM)
    write_plan(plan_program(program, MACHINE), tmp_path)
    proof = verify(read_plan(tmp_path), MACHINE)
    assert proof.ok, proof.failures


@pytest.mark.parametrize('change', few_of(3, CHANGES))
def test_segments_are_the_same_however_blocks_arrive(change):
    transform = Transform.of(MACHINE)
    text = text_of('arc with turning tool', change)
    blocks = read_text(text, 'a.ngc', transform, Settings()).blocks
    found = []
    for size in (1, 3, 100):
        chain = PathChain(transform, Settings())
        parts = [chain.push(blocks[k : k + size]) for k in range(0, len(blocks), size)]
        parts.append(chain.finish())
        found.append(np.concatenate([part.segments.bottom for part in parts]))
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)


@pytest.mark.parametrize('change', ['smaller', 'larger'])
def test_a_curve_crosses_a_border_of_tolerance(change):
    transform = Transform.of(MACHINE)
    blocks = read_text(text_of('arc', change), 'a.ngc', transform, Settings()).blocks
    segments = segments_of(blocks[1:], transform, Settings())  # without the way to the arc
    assert (segments.kind == SPLINE).all() and not segments.stop[:-1].any()
    use = ToleranceUse()
    use.blocks(blocks[1:])
    use.segments(segments)
    assert (use.largest <= 1.0).all()
