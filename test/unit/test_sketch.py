"""The quick look: a feed profile in text says what the setpoints do."""

import numpy as np

from cnc_interp.commands.cli import main
from cnc_interp.core import MM_PER_MIN
from cnc_interp.report.sketch import EIGHTHS, MARGIN, ROWS, feed_sketch


def write(directory, feed):
    """Setpoints at 1 ms that drive the given feeds [m/s]."""
    s = np.concatenate([[0.0], np.cumsum(feed) * 1e-3])
    np.savez(directory / 'setpoints.npz', time=np.arange(len(s)) * 1e-3, s=s)


def heights(picture):
    """Heights of the columns, in eighths."""
    rows = [line[MARGIN - 1 :] for line in picture.splitlines()[:ROWS]]
    width = max(map(len, rows))
    return sum(np.array([EIGHTHS.index(c) for c in row.ljust(width)]) for row in rows)


def test_columns_are_as_high_as_the_feed(tmp_path):
    feed = np.interp(np.arange(4000), [0, 1000, 3000, 4000], [0, 0.05, 0.05, 0.025])
    write(tmp_path, feed)
    picture = feed_sketch(tmp_path, 80 + MARGIN, unicode=True)
    mean = feed.reshape(80, 50).mean(axis=1)
    assert np.abs(heights(picture) - 8 * ROWS * mean / 0.05).max() <= 0.5 + 1e-6
    assert '3000' in picture.splitlines()[0] and picture.endswith('4.0 s')


def test_ascii_alone_where_the_terminal_knows_no_more(tmp_path):
    write(tmp_path, np.full(500, 1000 * MM_PER_MIN))
    assert feed_sketch(tmp_path, 60, unicode=False).isascii()


def test_a_tool_that_stands_still_is_drawn(tmp_path):
    write(tmp_path, np.zeros(20))
    assert feed_sketch(tmp_path, 60, unicode=True).splitlines()[0].endswith('0')


def test_plan_shows_it_when_asked(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv('TERM', 'xterm')
    program = tmp_path / 'line.ngc'
    program.write_text('G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X20 F3000\nM30\n')
    words = ['plan', str(program), '--out', str(tmp_path / 'plan')]
    assert main(words) == 0
    assert '█' not in capsys.readouterr().out  # plain text in a log
    assert main([*words, '--look']) == 0
    assert '█' in capsys.readouterr().out
    monkeypatch.setenv('TERM', 'dumb')  # inside an editor
    assert main([*words, '--look']) == 0
    shown = capsys.readouterr().out
    assert '####' in shown and shown.isascii()
