"""Score a feed law on the problem set: put yours in place of `trapezoid`."""

import numpy as np
from matplotlib import pyplot as plt

from cnc_interp import evaluate, problems

PERIOD = 1e-3  # [s]
BOX = np.full(30, 1 / 30)


def trapezoid(path, limits, slower):
    """Sample s(t) at half the limits, smoothed by two moving averages over 30 ms, as q(t)."""
    cells = np.linspace(0, 1, len(path.s))
    s = np.interp(np.linspace(0, 1, 30 * len(path.s)), cells, path.s)
    q1, q2, q3 = (abs(q) + 1e-9 for q in evaluate(path, s)[1:])
    top = [
        limits.max_velocity / q1,
        (limits.max_acceleration / q2 / 2) ** (1 / 2),
        (limits.max_jerk / q3 / 4) ** (1 / 3),
    ]
    squared = (np.minimum(np.min(top, axis=(0, 2)), path.cell_feed.min()) / slower) ** 2
    gain = (limits.max_acceleration / q1).min(axis=1)[1:] * np.diff(s) / slower**2
    squared[[0, -1]] = 0
    for i in range(len(gain)):
        squared[i + 1] = min(squared[i + 1], squared[i] + gain[i])
    for i in reversed(range(len(gain))):
        squared[i] = min(squared[i], squared[i + 1] + gain[i])
    v = np.sqrt(squared)
    t = np.cumsum([0, *(2 * np.diff(s) / (v[1:] + v[:-1]))])
    at = np.pad(np.interp(np.arange(0, t[-1] + PERIOD, PERIOD), t, s), 60, mode='edge')
    return evaluate(path, np.convolve(np.convolve(at, BOX, 'valid'), BOX, 'valid'))[0]


def scored(case):
    """Slow the law until every limit holds; a path is cut where the motion must rest."""
    for slower in 1.15 ** np.arange(40):
        parts = [trapezoid(part, case.limits, slower) for part in problems.stretches(case.path)]
        found = problems.score(case, np.concatenate(parts), PERIOD)
        if found.kept:
            break
    return found


if __name__ == '__main__':
    names = 'corner of 90 deg', 'circle of 40 mm', 'random 5-axis 0'
    results = [scored(problems.problem(name)) for name in names]
    for name, result in zip(names, results, strict=True):
        print(f'{name}: {result.ratio:.2f} times the optimum, {result.use:.0%} of a limit')
    plt.barh(names, [result.ratio for result in results])
    plt.xlabel('cycle time / optimum')
    plt.tight_layout()
    plt.show()
