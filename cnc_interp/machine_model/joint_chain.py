"""``Transform`` of an arm: a chain of joints from the part to the tool.

A path determines five of six degrees of freedom. The sixth is the *spin*, the rotation of the tool
about its own axis. At spin 0, the side of the tool is part X after the smallest rotation that
turns part Z into the tool axis. See docs/how_it_works/arms.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

import numpy as np

from cnc_interp.core import DEG, BlockError, FloatArray, MachineError, SingularityError, jet
from cnc_interp.machine_model import chain_kernels as kernel
from cnc_interp.machine_model.error_map import NO_ERRORS, ErrorMap
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.machine import Machine, arm_of

SEEDS = 128  #: Number of start points from which Newton's method searches configurations.
SAME = 1e-6  #: Solutions that differ by less than this are the same [rad].
CLOSE = 1e-4  #: Accuracy of the nearest singular pose [rad].
#: A joint takes part in the singular motion if its rate is this share of the largest one [-].
SHARE = 0.35
#: Joint distances from a pose at which singular poses are searched [rad].
NEARBY = np.linspace(0.0, 30.0, 121) * DEG


@dataclass(frozen=True)
class JointChain:
    machine: Machine  #: The machine.
    packed: FloatArray  #: (n + 2, 7): Geometry of the arm, see ``chain_kernels.py``.

    @staticmethod
    def of(machine: Machine) -> JointChain:
        arm, n = arm_of(machine), ARM
        packed = np.zeros((len(arm.lines) + 2, 7))
        packed[:n, :6], packed[n, :6] = arm.lines[:n], arm.tool[:2].ravel()
        packed[n + 1, :3] = arm.tool[2]
        packed[kernel.BESIDE :, :6] = arm.lines[n:]
        packed[kernel.BESIDE :, kernel.SLIDES] = machine.is_linear[n:]
        packed[n + 1, kernel.REACH] = arm.reach
        packed[n + 1, kernel.SPIN] = arm.spin
        return JointChain(machine, packed)

    @property
    def five_axis(self) -> FiveAxis:
        raise MachineError(f'{self.machine.name} is an arm; this needs a machine with X Y Z')

    @property
    def errors(self) -> ErrorMap:
        return NO_ERRORS

    @property
    def spin(self) -> float:
        return float(self.packed[ARM + 1, kernel.SPIN])

    def spun(self, spin: float) -> JointChain:
        packed = self.packed.copy()
        packed[ARM + 1, kernel.SPIN] = spin
        return replace(self, packed=packed)

    def spin_at(self, q: FloatArray) -> float:
        """Return the spin of the tool at joint positions (n,) [rad]."""
        side, axis = np.array(kernel.posture(self.packed, q[:ARM])[0][1:])
        still = jet.constant(axis[0]), jet.constant(axis[1]), jet.constant(axis[2])
        x = np.array(kernel.side_jets(still, jet.constant(0.0)))[:, 0]
        return float(np.arctan2(np.cross(x, side) @ axis, x @ side))

    def reached(self, tip: FloatArray, axis: FloatArray, stands: FloatArray) -> FloatArray:
        """Return the joint positions (n,) nearest to ``stands`` at which the tool has a pose.

        The tool keeps its spin, and further joints do not move. Raises BlockError if no
        configuration reaches the pose.
        """
        return self.standing(stands).start(tip, axis, 0)[0]

    def standing(self, q: FloatArray) -> JointChain:
        """Return this chain with home at joint positions ``q`` (n,), and with their spin."""
        return self.spun(self.spin_at(q)).starting(q)

    def starting(self, home: FloatArray) -> JointChain:
        """Return this chain with another home (n,) [rad], near which paths begin."""
        arm = replace(arm_of(self.machine), home=home)
        return replace(self, machine=replace(self.machine, arm=arm))

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        return kernel.forward(self.packed, np.ascontiguousarray(q, dtype=float))

    def rates(
        self, tip: FloatArray, axis: FloatArray, step: FloatArray, turn: FloatArray
    ) -> FloatArray:
        home, n = arm_of(self.machine).home, ARM
        rows = [np.ascontiguousarray(rows) for rows in (tip, axis, step, turn)]
        return np.asarray(kernel.rates(self.packed, home[:n], home[n:], *rows))

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """Return X Y Z of programs; on an arm they are the tool tip in W."""
        return np.asarray(tip)

    def counted(self, q: FloatArray, tip: FloatArray) -> FloatArray:
        return np.concatenate([tip, q[ARM:]])

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        return self.five_axis.tool_axis(rotary)

    def seen(
        self, tip: FloatArray, axis: FloatArray, beside: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return m tips and tool axes relative to the arm; ``beside`` (m, k): further joints."""
        return kernel.seen(self.packed, tip, axis, np.ascontiguousarray(beside), False)

    def followed(
        self, tip: FloatArray, axis: FloatArray, beside: FloatArray, start: FloatArray
    ) -> tuple[FloatArray, float]:
        """Follow m poses with further joints ``beside`` (m, k); see ``chain_kernels.followed``."""
        seen = self.seen(tip, axis, beside)
        q, least = kernel.followed(self.packed, *seen, start[:ARM])
        return np.hstack([q, beside[: len(q)]]), least

    def branches(
        self, tip: FloatArray, axis: FloatArray, beside: FloatArray | None = None
    ) -> FloatArray:
        """Return the joints of all configurations that reach a pose, the nearest to home first.

        Further joints are at ``beside`` (k,), by default at home. Each joint has the whole turns
        that bring it nearest to home within its travel. Singular configurations are left out.
        """
        home, n = arm_of(self.machine).home, ARM
        home, beside = home[:n], home[n:] if beside is None else beside
        low, high = self.machine.travel[:n].T
        (tip,), (axis,) = self.seen(tip[None], axis[None], beside[None])
        spread = np.random.default_rng(1).uniform(-pi, pi, (SEEDS, n))
        found, measure = kernel.solutions(self.packed, tip, axis, np.vstack([home, spread]))
        found = found[measure > self.least]
        found += 2.0 * pi * np.round((home - found) / (2.0 * pi))
        found -= 2.0 * pi * np.ceil((found - high) / (2.0 * pi)).clip(0.0)
        found += 2.0 * pi * np.ceil((low - found) / (2.0 * pi)).clip(0.0)
        found = found[((found >= low) & (found <= high)).all(axis=1)]
        found = found[np.argsort(np.abs(found - home).max(axis=1), kind='stable')]
        kept = list[FloatArray]()
        for q in found:
            if all(np.abs(q - other).max() > SAME for other in kept):
                kept.append(q)
        arm = np.array(kept).reshape(-1, n)
        return np.hstack([arm, np.tile(beside, (len(arm), 1))])

    @property
    def least(self) -> float:
        """Smallest allowed measure of the distance of a path from singular poses [-]."""
        return float(np.sin(self.machine.singular_cone)) ** 2

    def sense(self, q: FloatArray, leads: int = kernel.NO_JOINT) -> float:
        """Return the sign of the determinant of ``pose_rates``; it is constant on a path."""
        return float(np.sign(np.linalg.det(self.pose_rates(q, leads))))

    def pose_rates(self, q: FloatArray, leads: int = kernel.NO_JOINT) -> FloatArray:
        """Return the Jacobian (6, n) of the pose; the spin replaces joint ``leads``, if given."""
        tool, rates = kernel.posture(self.packed, q[:ARM])
        if leads != kernel.NO_JOINT:
            rates[:3, leads], rates[3:, leads] = 0.0, tool[2]
        return rates

    def start(
        self, tip: FloatArray, axis: FloatArray, line: int, beside: FloatArray | None = None
    ) -> tuple[FloatArray, float]:
        """Return the joints (n,) [m, rad] at a start pose, and ``sense`` there.

        ``beside``: as in ``branches``.
        """
        found = self.branches(tip, axis, beside)
        if not len(found):
            raise BlockError(
                f'no configuration of {self.machine.name} reaches this pose within the '
                f'travel of its joints at spin {self.spin / DEG:g} deg; move the part, or turn '
                'the tool (spin_deg, --spin auto)',
                line,
            )
        return found[0], self.sense(found[0])

    def refusal(self, q: FloatArray, line: int, singular: bool) -> BlockError:
        """Return the error at a pose: out of reach, or a singular pose near ``q``."""
        if not singular:
            return BlockError(
                f'beyond the reach of {self.machine.name} at spin {self.spin / DEG:g} deg; move '
                'the part, tilt the tool, or turn it (--spin auto)',
                line,
            )
        rates, sense = self.pose_rates(q), self.sense(q)
        nearest, joint, there = np.inf, 0, 0.0
        for k, sign in np.ndindex(ARM, 2):
            along = (1.0 - 2.0 * sign) * np.eye(len(q))[k]
            passed = np.array([self.sense(q + way * along) != sense for way in NEARBY])
            if not passed.any() or NEARBY[passed.argmax()] >= nearest + NEARBY[1]:
                continue
            low, high = NEARBY[passed.argmax() - 1 : passed.argmax() + 1]
            while high - low > CLOSE:
                middle = 0.5 * (low + high)
                beyond = self.sense(q + middle * along) != sense
                low, high = (low, middle) if beyond else (middle, high)
            if high < nearest:
                nearest, joint, there = high, k, float(q[k] + high * along[k])
        turn = np.abs(np.linalg.svd(rates)[2][-1])
        against = [self.machine.axis_names[k] for k in np.flatnonzero(turn > SHARE * turn.max())]
        name = self.machine.axis_names[joint]
        gap = f'within {nearest / DEG:.2g} deg of {there / DEG:z.1f}'
        return SingularityError(
            f'{name} comes {gap}, a singular pose, where {" and ".join(against)} turn against '
            'each other; tilt the tool from the flange, turn it (--spin auto), or move the part',
            line,
            name,
        )
