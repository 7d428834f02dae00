"""
Arms: plans along random paths, chosen spins against constant ones, lines through the wrist.

    PYTHONPATH=. python benchmarks/arms.py [--quick] [--seed N]

There are ten arms: the two bundled ones, and eight derived from them with other sizes and other
tool tilts. Each path is planned with ``--spin auto`` and proven; some are also planned with eight
constant spins. Lines of 0.6 m lead through poses with |J5| below 2 deg; at both ends |J5| is above
5 deg and the spin is the same. Only lines count that an arm could follow with this spin if it had
any amount of time. The last line prints the counts. The exit code is 0 only if

- every plan is proven, and no limit is exceeded by more than rounding;
- tips and tool axes equal those of the proof's chain (and of pinocchio, if installed);
- no chosen spin is slower than the best constant one, and on average it saves 2 % of their median;
- enough lines are passed without a stop.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import yaml

from cnc_interp.core import DEG, MM, BlockError, FloatArray, InterpError
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model import chain_kernels
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine, arm_of, arms_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.reading import open_program
from cnc_interp.proof.own_chain import OwnChain
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.path_chain import PathChain
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

SAME = 1e-9  #: Tips [m] and axes [-] of two chains differ less.
USE = 1.0  #: Largest use of a limit.
COUNT = 120  #: Points of a path.
#: Least share of lines passed at 45 and 10 deg, and how far the joints may jump there [rad, 1/m].
LINES, JUMP = (0.98, 0.85), 1e-6
SAVES, SLOWER = 0.02, 1e-4  #: Of the time of constant spins: of the median, and of the best one.


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


def arms(folder: Path, count: int, seed: int) -> Iterator[tuple[Machine, Path]]:
    """Yield arms of six joints and their files: the bundled ones, then others made of them."""
    random = np.random.default_rng(seed)
    shutil.copytree(arms_directory(), folder, dirs_exist_ok=True)
    names = sorted(
        file.stem for file in folder.glob('*.yaml') if len(Machine.load(file).axes) == 6
    )
    for number in range(count):
        name, file = names[number % len(names)], folder / f'made_{number}.yaml'
        content = yaml.safe_load((folder / f'{name}.yaml').read_text())
        drawn = (1.0, 0.0) if number < len(names) else random.uniform((0.8, -15), (1.3, 15))
        scale, lean = map(float, drawn)  # no NumPy scalars, which YAML cannot write
        robot = ElementTree.parse(folder / content['urdf'])
        for origin in robot.iter('origin'):
            xyz = [scale * float(word) for word in origin.get('xyz', '0 0 0').split()]
            origin.set('xyz', ' '.join(map(repr, xyz)))
        robot.write(file.with_suffix('.urdf'))
        content |= {'name': f'{name}_{number}', 'urdf': f'made_{number}.urdf'}
        content['part']['xyz_mm'] = [scale * x for x in content['part']['xyz_mm']]
        content['tcp']['rpy_deg'][1] += lean
        file.write_text(yaml.safe_dump(content))
        yield Machine.load(file), file


class Other:
    """Another chain of an arm: that of the proof, or of pinocchio."""

    def __init__(self, machine: Machine, file: Path):
        self.machine, self.file, self.own = machine, file, OwnChain.of(machine)

    def gap(self, q: FloatArray) -> tuple[float, float]:
        """Return the largest distances from the proof's chain and from pinocchio [m, -]."""
        found = np.hstack(Transform.of(self.machine).forward(q))
        own = np.abs(found - np.hstack(self.own.forward(q))).max()
        return float(own), self._pinocchio(q[::50], found[::50])

    def _pinocchio(self, q: FloatArray, found: FloatArray) -> float:
        if find_spec('pinocchio') is None:
            return float('nan')
        import pinocchio

        content = yaml.safe_load(self.file.read_text())
        model = pinocchio.buildModelFromUrdf(str(self.file.parent / content['urdf']))
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


def turned(machine: Machine, **changes: object) -> Machine:
    return replace(machine, arm=replace(arm_of(machine), **changes))  # type: ignore[arg-type]


def spin_of(chain: JointChain, q: FloatArray, axis: FloatArray) -> float:
    """Return the spin of joints: how far their side is turned from part X (arms.md)."""
    side, x = np.array(chain_kernels.posture(chain.packed, q)[0][1]), np.array([1.0, 0.0, 0.0])
    x = x - axis[0] / (1.0 + axis[2]) * (axis + [0.0, 0.0, 1.0])
    return float(np.arctan2(np.cross(x, side) @ axis, x @ side))


def wrist_lines(machine: Machine, tilt: float, count: int, seed: int) -> tuple[int, int, float]:
    """Return how many of so many lines through the wrist are passed, refused, and jumps [rad]."""
    random, arm = np.random.default_rng(seed), arm_of(machine)
    last = arm.lines[-1, :3]
    across = np.cross(last, [0.0, 1.0, 0.3])
    across /= np.linalg.norm(across)
    axis = -(np.cos(tilt) * last + np.sin(tilt) * across)
    tip = arm.lines[-1, 3:] + 0.2 * last + 0.1 * across
    tool = np.array([tip, unit(np.cross(axis, last)[None])[0], axis])
    base, home = JointChain.of(turned(machine, tool=tool)), arm.home
    passed, refused, jump, settings = 0, 0, 0.0, Settings()
    while passed + refused < count:
        q = home + random.uniform(-0.5, 0.5, 6)
        q[3], q[4] = random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0) * DEG
        tip, axis = (rows[0] for rows in base.forward(q[None]))
        if axis[2] < -0.7:
            continue
        chain, way = base.spun(spin_of(base, q, axis)), unit(random.normal(size=(1, 3)))
        tips = tip + np.linspace(-0.3, 0.3, 8001)[:, None] * way
        axes = np.tile(axis, (len(tips), 1))
        back, _ = chain_kernels.followed(chain.packed, tips[4000::-1].copy(), axes[:4001], q)
        if len(back) < 4001:
            continue
        on, _ = chain_kernels.followed(chain.packed, tips, axes, back[-1])
        low, high = chain.machine.travel.T
        ends = on[[0, -1], 4]
        if len(on) < len(tips) or np.abs(ends).min() < 5.0 * DEG:
            continue
        if ((on < low) | (on > high)).any():
            continue
        blocks = Blocks(
            tip=tips[[0, -1]],
            axis=axes[:2],
            rotary=np.full((2, 2), np.nan),
            feedrate=np.full(2, 0.6),
            duration=np.full(2, np.nan),
            rapid=np.zeros(2, dtype=np.bool_),
            exact_stop=np.zeros(2, dtype=np.bool_),
            contour_tolerance=np.full(2, 0.02 * MM),
            orientation_tolerance=np.full(2, 0.02 * MM),
            line_number=np.arange(1, 3),
            extra=np.zeros((2, 0)),
        )
        path_chain = PathChain(chain.starting(back[-1]), settings)
        try:
            parts = [path_chain.push(blocks).path, path_chain.finish().path]
        except BlockError as problem:
            assert problem.line_number == 2
            refused += 1
            continue
        path = AxisPath.join([part for part in parts if part is not None])
        stops = path.stop[1:-1].any()
        passed, refused = passed + (not stops), refused + stops
        steps = np.abs(path.cell_left[:3, 1:] - path.cell_right[:3, :-1])
        jump = max(jump, float(steps.max(initial=0.0)))
    return passed, refused, jump


def planned(file: Path, machine: Machine, out: Path, spin: str) -> float:
    """Plan a program; return its time [s]."""
    settings = Settings(spin=spin)
    stream = open_program(file, Transform.of(machine), settings)
    return float(plan_to_files(stream, machine, out, settings)['cycle_time'])


def constants(file: Path, machine: Machine, out: Path) -> list[float]:
    """Return the times of a program with those of eight constant spins that it allows [s]."""
    found = []
    for k in range(8):
        with suppress(InterpError):
            found.append(planned(file, turned(machine, spin=k * 45.0 * DEG), out, 'fixed'))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--quick', action='store_true', help='a seeded share')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    count, each, compared, lines = (2, 3, 3, 25) if options.quick else (10, 40, 8, 50)
    plans = proven = refused = setpoints = slower = 0
    use, gaps, seconds, random = 0.0, np.zeros(2), 0.0, np.random.default_rng(options.seed)
    saved, through = list[float](), {45.0: np.zeros(3), 10.0: np.zeros(3)}
    with tempfile.TemporaryDirectory() as folder:
        for machine, own in arms(Path(folder), count, options.seed):
            name, file, out = machine.name, Path(folder, 'path.apt'), Path(folder, 'out')
            print(f'{name}: {jets_per_second(machine):,.0f} jets/s')
            for number in range(each):
                family = FAMILIES[number % len(FAMILIES)]
                size, feed = random.uniform(0.7, 1.3, 2), random.uniform(600.0, 9000.0)
                file.write_text(program(*family(np.linspace(0.0, 1.0, COUNT), size), feed))
                plans, start = plans + 1, time.process_time()
                try:
                    chosen = planned(file, machine, out, 'auto')
                except InterpError as problem:
                    refused += 1
                    print(f'{name} {family.__name__}: refused: {str(problem)[-120:]}')
                    continue
                seconds += time.process_time() - start
                proof = verify_plan(out, machine)
                position = np.load(out / 'setpoints.npz')['position']
                proven, setpoints = proven + proof.ok, setpoints + len(position)
                shares = [
                    proof.use_of(k, axis) for k in proof.kinds for axis in machine.axis_names
                ]
                use, gaps = max(use, *shares), np.fmax(gaps, Other(machine, own).gap(position))
                verdict = 'proven' if proof.ok else f'NOT proven: {proof.failures[:1]}'
                print(
                    f'{name} {family.__name__}: {chosen:.3f} s, use {max(shares):.2%}, {verdict}'
                )
                if number < compared:
                    fixed = constants(file, machine, out)
                    slower += chosen > (1.0 + SLOWER) * min(fixed, default=np.inf)
                    saved.append(1.0 - chosen / float(np.median(fixed or [chosen])))
                    print(f'  constants: {" ".join(f"{one:.3f}" for one in fixed)}')
            for tilt, found in through.items():
                passes = np.array(wrist_lines(machine, tilt * DEG, lines, options.seed))
                found[:] = [*(found + passes)[:2], max(found[2], passes[2])]
                print(f'{name}: {passes[0]:g} of {lines} lines through the wrist at {tilt:g} deg')
    shares = [found[0] / found[:2].sum() for found in through.values()]
    jump = max(found[2] for found in through.values())
    pin = 'not installed' if find_spec('pinocchio') is None else f'{gaps[1]:.1e}'
    mean, median = float(np.mean(saved)), float(np.median(saved))
    print(f'{1e3 * seconds / max(plans * COUNT, 1):.2f} ms of a processor a block, spin included')
    print(
        f'plans {plans}, proven {proven}, refused {refused}, setpoints {setpoints}, largest use '
        f'{use:.2%}, own chain {gaps[0]:.1e}, pinocchio {pin}; spins slower than a constant '
        f'{slower} of {len(saved)}, {mean:.1%} faster than their median on average and '
        f'{median:.1%} in the median path; lines passed {shares[0]:.1%} at 45 deg and '
        f'{shares[1]:.1%} at 10 deg, largest jump {jump:.0e}'
    )
    sound = proven == plans and use <= USE and gaps.max() < SAME and not slower and jump < JUMP
    return 0 if sound and mean >= SAVES and shares[0] >= LINES[0] and shares[1] >= LINES[1] else 1


if __name__ == '__main__':
    sys.exit(main())
