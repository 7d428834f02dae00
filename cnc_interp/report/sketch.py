"""The feed profile of a plan as a few lines of text for the terminal."""

from pathlib import Path

import numpy as np

from cnc_interp.core import MM_PER_MIN, FloatArray

#: Eighths of a character cell, and their substitutes on an ASCII terminal.
EIGHTHS, PLAIN = ' ▁▂▃▄▅▆▇█', ' ...::::#'
ROWS = 4
MARGIN = 15


def feed_sketch(directory: Path, width: int, unicode: bool) -> str:
    """Draw the mean speed of the tip in each column: ``ROWS`` lines, and one of times."""
    with np.load(directory / 'setpoints.npz') as run:
        time, s = run['time'], run['s']
    count = max(10, width - MARGIN)
    edges = np.linspace(time[0], time[-1], count + 1)
    span = max(time[-1] - time[0], 1e-9)
    feed = np.diff(np.interp(edges, time, s)) * count / span
    top = float(feed.max(initial=0.0))
    picture = bars(feed / top if top > 0.0 else feed, EIGHTHS if unicode else PLAIN)
    labels = ['feed', 'mm/min', *[''] * (ROWS - 2)]
    marks = [f'{top / MM_PER_MIN:.0f}', *[''] * (ROWS - 2), '0']
    lines = [
        f'{label:<7}{mark:>6} ' + row
        for label, mark, row in zip(labels, marks, picture, strict=True)
    ]
    end = f'{span:.1f} s'
    lines.append(' ' * (MARGIN - 1) + f'0 s{end:>{count - 3}}')
    return '\n'.join(line.rstrip() for line in lines)


def bars(shares: FloatArray, steps: str) -> list[str]:
    levels = np.round(shares * ROWS * (len(steps) - 1)).astype(int)
    full = len(steps) - 1
    return [
        ''.join(steps[k] for k in np.clip(levels - row * full, 0, full))
        for row in reversed(range(ROWS))
    ]
