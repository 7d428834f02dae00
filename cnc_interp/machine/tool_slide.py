"""Motion of the tool along its axis by hand: X Y Z or an arm's joints follow one coordinate x.

The joints of an arm follow a curve q(x), whose first three derivatives give the limits of x. The
lowest limits along the travel apply. The travel of x ends before a joint leaves its travel. It
also ends where a joint would move much faster than at the start, as near a singular pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import MM, FloatArray, StreamError
from cnc_interp.core.axis_limits import Limits
from cnc_interp.core.jet import constant
from cnc_interp.machine.slides import THERE, Slides
from cnc_interp.machine_model.chain_kernels import NO_JOINT, joint_jets
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine, arm_of
from cnc_interp.machine_model.transform_port import Transform, tool_line

STEPS = 200  #: Number of points on each side of x = 0 at which q(x) is computed before the motion.
#: Largest joint rate dq/dx over that at the start; and share of the limits that is used, because
#: q(x) is computed only at some points [-].
FASTER, MARGIN = 2.0, 0.9


def along_tool(machine: Machine, stands: FloatArray) -> Slides:
    """Return the slide along the tool axis; x = 0 at the nominal axis positions ``stands``."""
    transform = Transform.of(machine)
    if isinstance(transform, JointChain):
        return ArmSlide.of(transform, stands)
    line, axes = tool_line(transform, stands), Slides.of_axes(machine)
    moves = line.direction != 0.0
    part = np.abs(line.direction[moves])
    rows = (axes.limits.by_order[:, moves] / part).min(axis=1, keepdims=True)
    return replace(
        axes,
        origin=np.array(stands, dtype=float),
        direction=line.direction[None, :],
        limits=Limits.constant(*rows).having(travel=line.travel[None]),
    )


@dataclass(frozen=True, eq=False)
class ArmSlide(Slides):
    chain: JointChain  #: The arm with the spin that the tool keeps.
    tip: FloatArray  #: (3,): Tip at x = 0 [m].
    axis: FloatArray  #: (3,): Tool axis, along which x is measured.
    places: FloatArray  #: (k,): Values of x at which the joints are known [m].
    known: FloatArray  #: (k, n): Joints at these values [rad].

    @staticmethod
    def of(chain: JointChain, stands: FloatArray) -> ArmSlide:
        """Return the slide of an arm's tool; x = 0 at joint positions ``stands`` (n,) [rad]."""
        limits = chain.machine.limits.lowest
        chain = chain.spun(chain.spin_at(stands))
        tip, axis = (rows[0] for rows in chain.forward(stands[None]))
        step = arm_of(chain.machine).reach / STEPS
        sense, (low, high) = chain.sense(stands), chain.machine.travel.T
        here, _ = _jets(chain, tip, axis, 0.0, stands, sense)
        ways = {0.0: here}
        fastest = FASTER * np.abs(here[1] / limits.max_velocity).max()
        for side in (-step, step):
            near = stands
            for k in range(1, STEPS + 1):
                jets, measure = _jets(chain, tip, axis, side * k, near, sense)
                near = jets[0]
                inside = ((near >= low) & (near <= high)).all()
                too_fast = np.abs(jets[1] / limits.max_velocity).max() > fastest
                if measure <= chain.least or not inside or too_fast:
                    break
                ways[side * k] = jets
        places = np.array(sorted(ways))
        jets = np.array([ways[float(x)] for x in places])
        # q_x v, q_x a + q_xx v^2, and q_x j + 3 q_xx v a + q_xxx v^3: equal shares for each sum
        v, a, j = limits.by_order
        first = np.abs(jets[:, 1])
        second, third = np.abs(jets[:, 2]) * 2.0, np.abs(jets[:, 3]) * 6.0
        velocity = 1.0 / max(
            float((first / v).max()),
            float(np.sqrt(2.0 * second / a).max()),
            float(np.cbrt(3.0 * third / j).max()),
        )
        acceleration = 1.0 / max(
            float((2.0 * first / a).max()), float((9.0 * velocity * second / j).max())
        )
        jerk = 1.0 / float((3.0 * first / j).max())
        rows = (MARGIN * np.array([[velocity], [acceleration], [jerk]])).tolist()
        travel = places[None, [0, -1]]
        own = Limits.constant(*map(np.array, rows)).having(travel=travel)
        origin, direction = np.array(stands), here[None, 1]
        return ArmSlide(origin, direction, own, chain, tip, axis, places, jets[:, 0])

    def nominal(self, x: FloatArray) -> FloatArray:
        return self._follow(x)[:, 0]

    def coordinates(self, q: FloatArray) -> FloatArray:
        return (self.chain.forward(q[None])[0] - self.tip) @ self.axis

    def motion(self, rows: FloatArray, jerk: FloatArray) -> FloatArray:
        (x, v, a), j = rows.swapaxes(0, 1), jerk
        taylor = self._follow(x) * np.array([1.0, 1.0, 2.0, 6.0])[:, None]
        q, first, second, third = taylor.swapaxes(0, 1)
        return np.stack(
            [
                q,
                first * v,
                first * a + second * v**2,
                first * j + 3.0 * second * v * a + third * v**3,
            ]
        )

    def _follow(self, x: FloatArray) -> FloatArray:
        """Return q and three more Taylor coefficients of q(x) at x (k, 1); shape (k, 4, n)."""
        low, high = self.places[[0, -1]]
        if x.min(initial=low) < low - THERE or x.max(initial=high) > high + THERE:
            ends = f'{low / MM:z.1f} to {high / MM:z.1f} mm'
            raise StreamError(f'the arm can move its tool from {ends} along its axis from here')
        found = np.empty((len(x), 4, len(self.origin)))
        for row, place in enumerate(x[:, 0].tolist()):
            near = np.array([np.interp(place, self.places, column) for column in self.known.T])
            found[row] = _jets(self.chain, self.tip, self.axis, place, near, 0.0)[0]
        return found


def _jets(
    chain: JointChain,
    tip: FloatArray,
    axis: FloatArray,
    x: float,
    near: FloatArray,
    sense: float,
) -> tuple[FloatArray, float]:
    (place,), (along,) = chain.seen((tip + x * axis)[None], axis[None], near[None, ARM:])
    p, o = place.tolist(), along.tolist()
    way = tuple((at, rate, 0.0, 0.0) for at, rate in zip(p, o, strict=True))
    still = tuple((value, 0.0, 0.0, 0.0) for value in o)
    lead = constant(chain.spin)
    found, measure = joint_jets(chain.packed, way, still, near[:ARM], sense, NO_JOINT, lead)
    rests = np.outer([1.0, 0.0, 0.0, 0.0], near[ARM:])
    return np.hstack([found, rests]), float(measure)
