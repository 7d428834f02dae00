"""What the progress bar writes on a terminal and in a log, with a clock of the test's own."""

import io
import math

import pytest

from cnc_interp.core import progress_bar
from cnc_interp.core.progress_bar import BAR, ProgressBar, TimeLeft


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    monkeypatch.setattr(progress_bar, 'time', Clock())
    monkeypatch.setenv('TERM', 'xterm')
    return progress_bar.time


def test_short_work_shows_nothing(clock):
    log, terminal = io.StringIO(), Terminal()
    for stream in (log, terminal):
        bar = ProgressBar(stream)
        for share in (0.0, 0.5, 1.0):
            bar.show('planning', share)
        bar.end(complete=True)
        assert stream.getvalue() == ''


def test_a_log_has_a_line_for_each_ten_per_cent(clock):
    log = io.StringIO()
    show = ProgressBar(log).of('planning')
    for k in range(101):
        clock.now = 100.0 + 0.2 * k
        show(k / 100)
    lines = log.getvalue().splitlines()
    assert lines[:-1] == [f'planning {k}0%, about {20 - 2 * k} s left' for k in range(1, 10)]
    assert lines[-1] == 'planning 100%'


def test_the_remaining_time_is_not_guessed_from_the_first_moments(clock):
    terminal = Terminal()
    bar = ProgressBar(terminal)
    bar.show('planning', 0.0)
    clock.now += 2.0
    bar.show('planning', 0.0)
    clock.now += 2.0
    bar.show('planning', 0.01)
    assert 'left' not in terminal.getvalue()
    clock.now += 4.9
    bar.show('planning', 0.5)
    assert terminal.getvalue().endswith('50%  about 5 s left')


def test_the_time_left_is_true_from_a_tenth_on_though_loading_took_long(clock):
    log = io.StringIO()
    show = ProgressBar(log).of('planning')
    show(0.0)
    clock.now += 30.0
    for k in range(4, 100):
        clock.now += 0.4
        show(k / 100)
        if k % 10 == 0:
            told = float(log.getvalue().splitlines()[-1].split('about ')[1].split()[0])
            assert abs(told - 0.4 * (100 - k)) < 1.0


def test_the_time_left_follows_the_speed_of_the_later_half():
    estimate, left = TimeLeft(), math.nan
    for k in range(101):  # a slow first tenth
        left = estimate.after(2.0 * k, 0.001 * k)
    assert left == pytest.approx(200.0 * 9)
    for k in range(1, 221):
        left = estimate.after(200.0 + k, 0.1 + 0.002 * k)
    assert left == pytest.approx((1.0 - 0.54) / 0.002)


def test_a_line_covers_the_longer_one_before_and_ends_full(clock):
    terminal = Terminal()
    bar = ProgressBar(terminal)
    bar.show('running', 0.0)
    clock.now += 2.0
    bar.show('running', 0.5, 'line 1234', 100.0)
    bar.show('running', 0.6, 'line 7', 9.0)
    bar.end(complete=True)
    _, first, second, last = terminal.getvalue().split('\r')
    assert first.endswith('50%  line 1234, about 100 s left')
    assert len(second) == len(first) and second.rstrip().endswith('60%  line 7, about 9 s left')
    assert last.rstrip() == f'running [{"#" * BAR}] 100%' and last.endswith('\n')


def test_the_next_work_has_a_line_of_its_own(clock):
    terminal = Terminal()
    bar = ProgressBar(terminal)
    for work in ('checking', 'running'):
        bar.show(work, 0.0)
        clock.now += 2.0
        bar.show(work, 0.3)
    bar.end(complete=False)
    lines = terminal.getvalue().splitlines()
    assert [line.split()[0] for line in lines if line] == ['checking', 'running']


@pytest.mark.parametrize(
    ('share', 'left', 'shown'),
    [
        (0.01, 5002.0, 'work 1%'),
        (0.5, 16.0, 'work 50%, about 16 s left'),
        (0.999, 0.9, 'work 99%'),
        (0.999, 0.2, 'work 99%'),
        (1.0, 0.0, 'work 100%'),
    ],
)
def test_the_time_left_is_told_where_it_is_known(monkeypatch, share, left, shown):
    monkeypatch.setattr(progress_bar, 'PATIENCE', 0.0)
    stream = io.StringIO()
    bar = ProgressBar(stream)
    bar._steps = 1000
    bar.show('work', share, left=left)
    assert stream.getvalue().startswith(shown) and '100%, about' not in stream.getvalue()


def test_the_time_left_of_parts_counts_from_the_begin_of_the_work_which_is_shown_at_once(clock):
    """Two workers end their first parts together: the next moment says nothing of their speed."""
    log = io.StringIO()
    bar = ProgressBar(log)
    bar.start('sweeping', '12 points, 4 known before')
    assert log.getvalue() == 'sweeping 12 points, 4 known before\n'
    for clock.now, share in ((160.0, 1 / 8), (160.2, 2 / 8)):
        bar.show('sweeping', share)
    lefts = [float(line.split('about ')[1].split()[0]) for line in log.getvalue().splitlines()[1:]]
    assert lefts == [420.0, pytest.approx(180.0, abs=2.0)]
