"""The feed that a control reaches on short blocks, and the stops at rapids."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import brentq

from cnc_interp.machine_model.machine import Machine, from_mapping
from cnc_interp.machine_model.machine_entries import BlockPace
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, read_text
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.pace import Pacer

XYZ = Transform.of(Machine.load('xyz'))
PACE = BlockPace(jump=3e-3, block_time=1e-3, jerk=20.0, stops_at_rapids=True)


def polygon(turn, chord, feed=6000, count=40):
    """Chords [mm] that turn by an angle [deg], in the plane, after a rapid."""
    angle = np.radians(turn) * np.arange(count)
    points = np.cumsum(chord * np.column_stack([np.cos(angle), np.sin(angle)]), axis=0)
    lines = [f'X{x:.6f} Y{y:.6f}' for x, y in points]
    text = '\n'.join(['G21 G90', 'G0 X0 Y0 Z0', f'G1 F{feed}', *lines, 'M2', ''])
    return read_text(text, 'p.ngc', XYZ, Settings()).blocks


def paced(blocks, pace=PACE, size=1000):
    pacer = Pacer(pace, Settings())
    parts = [pacer.push(blocks[k : k + size]) for k in range(0, len(blocks), size)]
    return Blocks.concatenate([*parts, pacer.finish()])


@pytest.mark.parametrize(('turn', 'chord'), [(5.0, 0.5), (18.0, 0.3), (10.0, 2.0)])
def test_a_chord_takes_as_long_as_rising_and_falling_with_the_jerk(turn, chord):
    """Rise and fall of the speed are summed over time here."""
    feed = paced(polygon(turn, chord)).feedrate[10]
    v = PACE.jump / np.linalg.norm([np.cos(np.radians(turn)) - 1.0, np.sin(np.radians(turn))])

    def way(x):
        quarter = np.linspace(0.0, x, 20001)
        speed = v + 0.5 * PACE.jerk * quarter**2
        peak = 2.0 * speed[-1] - v
        return 2.0 * (trapezoid(speed, quarter) + trapezoid(v + peak - speed, quarter))

    x = brentq(lambda x: way(x) - 1e-3 * chord, 1e-6, 1.0)
    assert feed == pytest.approx(1e-3 * chord / (4.0 * x), rel=1e-4)


def test_chords_beside_a_straight_count_by_their_share_of_the_path():
    """A bend of ten chords between straights: the turn is the mean over 1 mm on both sides."""
    angle = np.radians(np.concatenate([[0.0] * 3, np.arange(9.0, 190.0, 18.0), [180.0] * 3]))
    length = np.concatenate([[9.0] * 3, np.full(len(angle) - 6, 0.27), [9.0] * 3])
    points = np.cumsum(length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]), axis=0)
    lines = [f'X{x:.6f} Y{y:.6f}' for x, y in points]
    text = '\n'.join(['G21 G90', 'G0 X0 Y0 Z0', 'G1 F6000', *lines, 'M2', ''])
    feed = paced(read_text(text, 's.ngc', XYZ, Settings()).blocks).feedrate[-len(angle) :]
    place, turn = np.cumsum(length), np.abs(np.diff(angle))
    for k in range(3, len(angle) - 3):
        near = place[k] - 0.5 * length[k] + np.linspace(-1.0, 1.0, 200001)
        block = np.searchsorted(place, near)
        density = 0.5 * (turn[block - 1] + turn[block]) / length[block]
        even = paced(polygon(np.degrees(density.mean() * length[k]), length[k])).feedrate[20]
        assert feed[k] == pytest.approx(even, rel=2e-3)
    assert feed[3] > 1.5 * feed[len(angle) // 2]


def test_a_block_takes_its_least_time_and_arcs_and_slow_feeds_stay():
    slow = replace(PACE, block_time=0.02)
    assert paced(polygon(0.0, 0.3), slow).feedrate[10] == pytest.approx(0.3e-3 / 0.02)
    crawl = polygon(5.0, 0.5, feed=300)
    assert np.array_equal(paced(crawl).feedrate, crawl.feedrate)
    text = 'G21 G90\nG0 X0 Y0 Z0\nG1 X30 F6000\nG3 X30 Y20 J10\nG1 X0\nM2\n'
    arc = read_text(text, 'a.ngc', XYZ, Settings()).blocks
    assert len(arc) > 10 and np.array_equal(paced(arc).feedrate, arc.feedrate)


def test_the_blocks_of_a_loop_that_repeats_one_line_are_no_arc():
    loop = 'G21\nG0 X0 Y0 Z0\nG91\n#1=0\no1 while [#1 lt 30]\nG1 X0.3 Y[0.1*#1] F6000\n#1=[#1+1]\n'
    blocks = read_text(f'{loop}o1 endwhile\nM2\n', 'loop.ngc', XYZ, Settings()).blocks
    listed = replace(blocks, line_number=np.arange(len(blocks)))
    feed = paced(blocks).feedrate
    assert (feed[2:-1] < blocks.feedrate[2:-1]).any()
    assert np.array_equal(feed, paced(listed).feedrate)


@pytest.mark.parametrize('size', [1, 2, 3, 7])
def test_the_feeds_do_not_depend_on_how_the_blocks_arrive(size):
    blocks = Blocks.concatenate([polygon(5.0, 0.5), polygon(12.0, 0.2)])
    blocks = replace(blocks, exact_stop=blocks.exact_stop | (np.arange(len(blocks)) % 17 == 9))
    whole, parts = paced(blocks), paced(blocks, size=size)
    assert len(parts) == len(blocks)
    assert np.array_equal(whole.feedrate, parts.feedrate)
    assert np.array_equal(whole.exact_stop, parts.exact_stop)


def test_rows_wait_for_no_more_than_one_row_behind_a_rest():
    """So a program in single block, where every line ends at rest, is not held back."""
    blocks = polygon(12.0, 0.2)
    resting = replace(blocks, exact_stop=np.ones(len(blocks), dtype=bool))
    assert len(Pacer(PACE, Settings()).push(resting)) == len(blocks) - 1
    assert len(Pacer(PACE, Settings()).push(blocks)) < len(blocks) - 1


def test_the_tool_rests_where_a_rapid_begins_or_ends():
    text = 'G21 G90\nG0 X0 Y0 Z0\nG1 X9 F900\nX9 Y9\nG0 X20\nG1 Y30\nX0\nM2\n'
    blocks = read_text(text, 'r.ngc', XYZ, Settings()).blocks
    stops = paced(blocks).line_number[paced(blocks).exact_stop]
    assert {4, 5} <= set(stops.tolist()) and not {3, 6} & set(stops.tolist())
    free = paced(blocks, replace(PACE, stops_at_rapids=False))
    assert np.array_equal(free.exact_stop, blocks.exact_stop)


def test_keys_that_cannot_be_meant_are_refused():
    limits = {'velocity_m_per_min': 30.0, 'acceleration_m_per_s2': 3.0, 'jerk_m_per_s3': 30.0}
    content = {'limits': dict.fromkeys('XYZ', limits)}
    both = {'velocity_jump_mm_per_s': 3.0, 'block_time_ms': 2.0}
    assert from_mapping(content | {'look_ahead': both}).pace == BlockPace(3e-3, 2e-3, 30.0)
    for key, value in (
        ('look_ahead', {'block_time_ms': 2.0}),
        ('look_ahead', both | {'stops_at_rapids': 1}),
        ('look_ahead', both | {'block_time_ms': -1.0}),
        ('standstill', {'tool_change': 2.0}),
        ('standstill', {'tool_change_s': 'long'}),
    ):
        with pytest.raises(Exception, match=key):
            from_mapping(content | {key: value})
