"""The history of runs: how a run spends its time, and a file that survives what happens to it."""

import csv

import pytest

from cnc_interp.core import InterpError
from cnc_interp.run.run_history import COLUMNS, TAIL, RunHistory, RunTimes
from cnc_interp.run.run_state import State


def row(number, **more):
    return dict.fromkeys(COLUMNS, '') | {'program': f'{number}.ngc'} | more


def test_the_time_of_holds_is_counted_and_each_hold_and_alarm_once():
    times = RunTimes(100.0)
    for now, state in (
        (100.0, State.RUNNING),
        (110.0, State.HOLDING),  # feed hold
        (110.5, State.HELD),
        (112.0, State.AWAY),  # jogged away and back: the same hold
        (115.0, State.HELD),
        (116.0, State.RUNNING),
        (120.0, State.PAUSED),  # feed override 0
        (121.0, State.RUNNING),
        (122.0, State.STARVING),
        (122.5, State.STARVED),
        (123.0, State.RUNNING),
        (130.0, State.STOPPING),
        (130.2, State.FAULT),
    ):
        times.see(state, now)
    assert (times.holds, times.alarms) == (2, 2)
    assert times.held == pytest.approx(6.0 + 1.0)


def test_rows_are_read_by_any_csv_reader_whatever_their_texts_contain(tmp_path):
    history = RunHistory(str(tmp_path / 'new folder' / 'runs.csv'))
    assert history.latest(5) == []
    strange = 'a, "b"\nand c;\té'
    for number in range(3):
        history.append(row(number, message=strange))
    with history.file.open(newline='', encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    assert [one['program'] for one in rows] == ['0.ngc', '1.ngc', '2.ngc']
    assert {one['message'] for one in rows} == {'a, "b" and c; é'}
    assert history.latest(2) == rows[:0:-1] and len(history.latest(9)) == 3


def test_a_row_that_was_cut_off_spoils_no_other_and_a_long_file_is_read_from_its_end(tmp_path):
    history = RunHistory(str(tmp_path / 'runs.csv'))
    history.append(row(1))
    with history.file.open('a') as file:
        file.write('2026-11-29,xyz')  # the power failed
    history.append(row(2))
    assert [one['program'] for one in history.latest(9)] == ['2.ngc', '1.ngc']
    many = 2 * TAIL // 100
    with history.file.open('a') as file:
        file.writelines(f'{"x" * 87}{"," * (len(COLUMNS) - 1)}\n' for _ in range(many))
    history.append(row(3))
    latest = history.latest(many)
    assert latest[0]['program'] == '3.ngc' and 1 < len(latest) < many


def test_a_history_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(InterpError, match='this run is not in the history'):
        RunHistory(str(tmp_path / 'file' / 'runs.csv')).append(row(1))
