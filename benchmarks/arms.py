"""
Arms: plans of seeded paths, each proven, and their chain of joints against others.

    PYTHONPATH=. python benchmarks/arms.py [--quick] [--seed N]

Each path is planned on each bundled arm with ``--spin auto`` and proven. The last line counts
plans, how many are proven and how many refused, the largest use of a limit by differences, and the
largest distance of tip and tool axis from the proof's own chain and from pinocchio, if that is
installed. The exit code is 0 if every plan is proven and the distances are below 1e-9.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import yaml

from cnc_interp.core import MM, FloatArray, InterpError
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine, arms_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.reading import open_program
from cnc_interp.proof.own_chain import OwnChain
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

SAME = 1e-9  #: Tips [m] and axes [-] of two chains differ less.
USE = 1.001  #: Largest use of a limit: an excess of up to 0.1 % is rounding, as in the proof.
COUNT = 120  #: Points of a path.


def unit(rows: FloatArray) -> FloatArray:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def dome(u: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a spiral on a sphere, the tool normal to it."""
    angle, lift = 6.0 * np.pi * u, 0.1 + 0.3 * u
    axis = np.stack([np.sin(lift) * np.cos(angle), np.sin(lift) * np.sin(angle), np.cos(lift)], 1)
    return 120.0 * size[0] * (axis - [0.0, 0.0, 1.0]), axis


def wave(u: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a line on a wavy surface, the tool normal to it."""
    x, high = 120.0 * (u - 0.5), 8.0 * size[0]
    slope = high * 0.06 * np.cos(0.06 * x)
    tip = np.stack([x, 40.0 * (size[1] - 1.0) + 0 * x, high * np.sin(0.06 * x)], 1)
    return tip, unit(np.stack([-slope, 0 * x, 1.0 + 0 * x], 1))


def zigzag(u: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rows back and forth with a tool that sways."""
    row, along = np.floor(6.0 * u * 0.999), (6.0 * u * 0.999) % 1.0
    x = 80.0 * np.where(row % 2 == 0, along, 1.0 - along) - 40.0
    lean = 0.2 * size[0] * np.sin(4.0 * np.pi * u)
    tip = np.stack([x, 8.0 * row - 20.0, 0 * x], 1)
    return tip, unit(np.stack([0 * x, np.sin(lean), np.cos(lean)], 1))


def helix(u: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a helix whose tool leans outwards."""
    angle, radius = 4.0 * np.pi * u, 30.0 * size[0]
    tip = np.stack([radius * np.cos(angle), radius * np.sin(angle), -10.0 * u], 1)
    lean = 0.15 * size[1]
    return tip, unit(np.stack([lean * np.cos(angle), lean * np.sin(angle), 1.0 + 0 * u], 1))


def corners(u: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a few long lines between places and directions that the sizes choose."""
    random = np.random.default_rng(int(1e6 * size[0]))
    tip = random.uniform(-50.0, 50.0, (8, 3)) * [1.0, 1.0, 0.4]
    lean = random.uniform(-0.25, 0.25, (8, 2))
    return tip, unit(np.hstack([lean, np.ones((8, 1))]))


FAMILIES: tuple[Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]], ...] = (
    dome,
    wave,
    zigzag,
    helix,
    corners,
)


def program(tip: FloatArray, axis: FloatArray, feed: float) -> str:
    lines = [f'FEDRAT/{feed:.1f},MMPM']
    for p, o in zip(tip, axis, strict=True):
        lines.append('GOTO/' + ','.join(f'{value:.9f}' for value in (*p, *o)))
    return '\n'.join([*lines, 'FINI', ''])


class Other:
    """Another chain of an arm: that of the proof, or of pinocchio."""

    def __init__(self, machine: Machine):
        self.machine, self.own = machine, OwnChain.of(machine)

    def gap(self, q: FloatArray) -> tuple[float, float]:
        """Return the largest distances from the proof's chain and from pinocchio [m, -]."""
        found = np.hstack(Transform.of(self.machine).forward(q))
        own = np.abs(found - np.hstack(self.own.forward(q))).max()
        return float(own), self._pinocchio(q[::50], found[::50])

    def _pinocchio(self, q: FloatArray, found: FloatArray) -> float:
        if find_spec('pinocchio') is None:
            return float('nan')
        import pinocchio

        file = arms_directory() / f'{self.machine.name}.yaml'
        content = yaml.safe_load(file.read_text())
        model = pinocchio.buildModelFromUrdf(str(file.parent / content['urdf']))
        data, frame = model.createData(), model.getFrameId(content['flange'])
        part, tool = (
            pinocchio.SE3(
                pinocchio.rpy.rpyToMatrix(*np.radians(content[key]['rpy_deg'])),
                np.array(content[key]['xyz_mm']) * MM,
            )
            for key in ('part', 'tcp')
        )
        worst = 0.0
        for row, wanted in zip(q, found, strict=True):
            pinocchio.framesForwardKinematics(model, data, row)
            pose = (part.inverse() * data.oMf[frame] * tool).homogeneous
            there = np.concatenate([pose[:3, 3], -pose[:3, 2]])
            worst = max(worst, float(np.abs(there - wanted).max()))
        return worst


def jets_per_second(machine: Machine) -> float:
    """Return how many poses a processor second get three exact derivatives, Newton included."""
    chain, count = Transform.of(machine), 20000
    assert isinstance(chain, JointChain)
    tip, axis = np.zeros(3), np.array([0.0, 0.0, 1.0])
    chain = chain.starting(chain.branches(tip, axis)[0])
    tips = np.random.default_rng(1).normal(0.0, MM, (count, 3))
    rows = tips, np.tile(axis, (count, 1)), np.tile(axis, (count, 1)), np.zeros((count, 3))
    chain.rates(*(row[:2] for row in rows))
    start = time.process_time()
    chain.rates(*rows)
    return count / (time.process_time() - start)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--quick', action='store_true', help='one path of each family')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    plans = proven = refused = blocks = 0
    use, gaps, seconds, random = 0.0, np.zeros(2), 0.0, np.random.default_rng(options.seed)
    for name in sorted(file.stem for file in arms_directory().glob('*.yaml')):
        machine = Machine.load(name)
        print(f'{name}: {jets_per_second(machine):,.0f} jets/s')
        for number in range(len(FAMILIES) * (1 if options.quick else 8)):
            family = FAMILIES[number % len(FAMILIES)]
            size, feed = random.uniform(0.7, 1.3, 2), random.uniform(600.0, 3000.0)
            text = program(*family(np.linspace(0.0, 1.0, COUNT), size), feed)
            plans += 1
            with tempfile.TemporaryDirectory() as folder:
                file, out = Path(folder, 'path.apt'), Path(folder, 'out')
                file.write_text(text)
                settings, start = Settings(spin='auto'), time.process_time()
                try:
                    stream = open_program(file, Transform.of(machine), settings)
                    summary = plan_to_files(stream, machine, out, settings)
                except InterpError as problem:
                    refused += 1
                    print(f'{name} {family.__name__}: refused: {str(problem)[-120:]}')
                    continue
                seconds, blocks = seconds + time.process_time() - start, blocks + summary['blocks']
                proof = verify_plan(out, machine)
                proven += proof.ok
                largest = max(
                    proof.use_of(k, axis) for k in proof.kinds for axis in machine.axis_names
                )
                use = max(use, largest)
                gaps = np.fmax(
                    gaps, Other(machine).gap(np.load(out / 'setpoints.npz')['position'])
                )
                print(
                    f'{name} {family.__name__}: {summary["cycle_time"]:.3f} s, use {largest:.2%}, '
                    f'{"proven" if proof.ok else "NOT proven: " + str(proof.failures[:1])}'
                )
    found = 'none' if find_spec('pinocchio') is None else f'{gaps[1]:.1e}'
    print(f'{1e3 * seconds / max(blocks, 1):.2f} ms of a processor a block, spin included')
    print(
        f'plans {plans}, proven {proven}, refused {refused}, largest use {use:.2%}, '
        f'own chain {gaps[0]:.1e}, pinocchio {found}'
    )
    sound = proven == plans and use <= USE and gaps.max() < SAME
    return 0 if sound else 1


if __name__ == '__main__':
    sys.exit(main())
