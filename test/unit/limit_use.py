"""How much of the limits of the axes a motion uses, by differences of its setpoints."""

import numpy as np


def limit_use(q, limits, start=None, period=1e-3, cut=False, late=False):
    """
    Return the largest use of velocity, acceleration and jerk of any axis, from rest to rest.

    The axes rest at ``start``, or at the first setpoint unless the record is late, and after the
    last one unless it is cut.
    """
    first = q[0] if start is None else start
    before, after = (0 if late else 3), (0 if cut else 3)
    held = np.concatenate([np.tile(first, (before, 1)), q, q[-1:].repeat(after, axis=0)])
    return max(
        (np.abs(np.diff(held, order, axis=0)) / period**order / limit).max()
        for order, limit in enumerate(limits, start=1)
    )
