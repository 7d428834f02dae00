"""Times of a program by tool and operation: what the table says is what the lines must take."""

import json

import pytest

from cnc_interp.commands.cli import main

MACHINE = """name: known
signals: milling
limits:
  X: {velocity_m_per_min: 24, acceleration_m_per_s2: 5, jerk_m_per_s3: 500}
  Y: {velocity_m_per_min: 24, acceleration_m_per_s2: 5, jerk_m_per_s3: 500}
  Z: {velocity_m_per_min: 24, acceleration_m_per_s2: 5, jerk_m_per_s3: 500}
look_ahead: {velocity_jump_mm_per_s: 2.5, block_time_ms: 1.0, scatter_percent: 2.0}
standstill:
  tool_change_s: 5.0
  spindle_start_s: 2.0
  spindle_stop_s: 1.0
  spindle_speed_rev_per_min: 4000
"""
PROGRAM = """G21 G90 G94
T3 M6
S4000 M3
G0 X0 Y0 Z50
(ROUGH)
G1 X200 F1200
G4 P2
(FINISH)
G1 X-200 F2400
M5
T7 M6
G0 X100
G0 X-100
M0
G1 Y60 F600
M30
"""


@pytest.fixture
def place(tmp_path):
    (tmp_path / 'm.yaml').write_text(MACHINE)
    (tmp_path / 'p.ngc').write_text(PROGRAM)
    return tmp_path


def estimate(place, capsys, *more):
    words = ['estimate', str(place / 'p.ngc'), '--machine', str(place / 'm.yaml'), '--json', *more]
    assert main([*words, '--workers', '1']) == 0
    return json.loads(capsys.readouterr().out)


def test_times_by_tool_are_those_of_its_lines(place, capsys):
    found = estimate(place, capsys)
    first, second = found['tools']
    assert (first['line'], first['tool']) == (2, 3) and (second['line'], second['tool']) == (11, 7)
    assert first['change_s'] == second['change_s'] == pytest.approx(5.0)
    assert first['dwell_s'] == pytest.approx(2.0)
    assert first['spindle_s'] == pytest.approx(2.0 + 1.0)
    # 200 mm at 20 mm/s, 400 mm at 40 mm/s; reaching the feed takes less than 0.1 s of each
    assert first['cutting_s'] == pytest.approx(10.0 + 10.0, abs=0.2) and first['cutting_s'] > 20.0
    names = [(one['name'], one['line']) for one in first['operations']]
    assert names == [('ROUGH', 6), ('FINISH', 9)]
    assert [one['motion_s'] for one in first['operations']] == pytest.approx([10.0, 10.0], abs=0.1)
    assert second['cutting_s'] == pytest.approx(6.0, abs=0.1)
    parts = 'cutting_s', 'rapid_s', 'dwell_s', 'spindle_s'
    for one in found['tools']:
        assert one['time_s'] == pytest.approx(sum(one[part] for part in parts))
    total = sum(one['time_s'] + one['change_s'] for one in found['tools'])
    assert found['total_s'] == pytest.approx(total) and found['stops'] == 1
    motion = sum(one['cutting_s'] + one['rapid_s'] for one in found['tools'])
    assert found['half_width_s'] == pytest.approx(0.02 * motion)


def test_slow_spindles_start_sooner_and_taps_reverse_twice(place, capsys):
    """At constant power the time grows with the square of the speed; each hole has two turns."""
    lines = ['G21 G90 G94', 'T8 M6', 'S1000 M3', 'G0 X0 Y0 Z10', 'G98 G84 Z-7 R2 F1000']
    (place / 'p.ngc').write_text('\n'.join([*lines, 'X10', 'X20', 'G80', 'M5', 'M30', '']))
    found = estimate(place, capsys, '--dialect', 'fanuc')
    (only,) = found['tools']
    assert only['spindle_s'] == pytest.approx((2.0 + 1.0) / 16 + 3 * 2 * 0.2)
    assert found['other_spindle_speeds'] == [1000.0]
    assert found['half_width_s'] > 0.5 * only['spindle_s']


def test_the_plan_files_tell_the_same(place, capsys):
    found = estimate(place, capsys)
    words = ['plan', str(place / 'p.ngc'), '--machine', str(place / 'm.yaml')]
    assert main([*words, '--json', '--out', str(place / 'out')]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['tools'] == found['tools']
    planned = summary['cycle_time'] + summary['standstill']
    assert planned == pytest.approx(found['total_s'], abs=1e-6)


def test_overrides_change_what_they_are_for(place, capsys):
    usual = estimate(place, capsys)['tools'][0]
    slow = estimate(place, capsys, '--feed-override', '50', '--rapid-override', '25')['tools']
    assert slow[0]['cutting_s'] == pytest.approx(2.0 * usual['cutting_s'], rel=0.02)
    assert slow[0]['dwell_s'] == usual['dwell_s']
    # 300 mm and 200 mm of rapids at 100 mm/s
    assert slow[1]['rapid_s'] == pytest.approx(5.0, abs=0.2)
    assert main(['estimate', str(place / 'p.ngc'), '--feed-override', '400']) == 2
    line = capsys.readouterr().err
    assert 'feed_override' in line and line.count('\n') == 1
