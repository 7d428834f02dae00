"""An axis path from arrays of axis positions; apart, because no program needs scipy's splines."""

import numpy as np
from scipy.interpolate import make_interp_spline

from cnc_interp.core import FloatArray, InterpError
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform

DEGREE = 5  #: q_ss and q_sss are continuous, as a motion within jerk limits needs.


def axis_path_from(
    q: FloatArray, s: FloatArray, machine: Machine, feedrate: float = np.inf
) -> AxisPath:
    """Return the smooth path from rest to rest through axis positions, by quintic splines.

    Its error is of the sixth order in the distance of the points; at corners it overshoots.

    Parameters
    ----------
    q : FloatArray
        (N, n_axes): axis positions, N >= 6 [m, rad].
    s : FloatArray
        (N,): increasing, usually the path length of the tool tip [m].
    feedrate : float
        Largest ds/dt [m/s].

    Raises
    ------
    InterpError
        The arrays do not fit.

    """
    q, s = np.array(q, dtype=float), np.array(s, dtype=float)
    axes = len(machine.axis_names)
    if s.ndim != 1 or q.shape != (len(s), axes):
        raise InterpError(f'q must have shape ({s.size}, {axes}): a row for each s, of all axes')
    if len(s) <= DEGREE:
        raise InterpError(f'{len(s)} points: a quintic spline needs {DEGREE + 1} or more')
    if not (np.isfinite(q).all() and np.isfinite(s).all() and (np.diff(s) > 0.0).all()):
        raise InterpError('q and s must be finite numbers, and s must increase')
    spline = make_interp_spline(s, q, k=DEGREE)
    jets = np.stack([spline(s, nu) for nu in range(4)])
    jets[0] = q
    tip, axis = Transform.of(machine).forward(q)
    stop = np.zeros(len(s), dtype=np.bool_)
    stop[[0, -1]] = True
    return AxisPath(
        s=s, cell_left=jets[:, :-1].copy(), cell_right=jets[:, 1:].copy(), tip=tip, axis=axis,
        cell_feed=np.full(len(s) - 1, feedrate), cell_block=np.zeros(len(s) - 1, dtype=np.int64),
        stop=stop,
    )  # fmt: skip
