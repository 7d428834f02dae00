"""
Random programs with known meaning: the emitted motion against the intended one.

    python benchmarks/random_programs.py [--count 5000] [--first 0] [--proof 2] [--show SEED]
        [--periods 0.25 1 4] [--json FILE]
    python benchmarks/random_programs.py --count 50 --laws

A seed chooses machine, period, tolerances, position, units and the blocks: lines, rapids, arcs and
helices in three planes, B-splines, tool-tip control on and off, tilted planes (G68.2, G53.1),
cutter compensation (G41.1), G61, G9, G64, G91, G93, dwells, tiny moves and repeated positions. The
code that writes a block also computes where it leads, without any reader of cnc_interp. Checked by
differences of the setpoints alone: limits of each axis, end and stops, that every pose is near the
programmed curves, and that every curve is followed, in order. Every ``--proof``-th program is also
written as plan files and proven by ``check``, and both readers of ``check --program`` compare its
text with its rows. Planner and checks share only the machine's forward kinematics. With
``--periods`` each program is planned at each of these periods.

The script prints every doubtful result with its seed. A table at the end says how many plans were
proven, how many ``check`` rejected although nothing else is doubtful, and how many exceed a limit.
Ranges of seeds can run side by side: ``--first 0 --count 500`` and ``--first 500 --count 500``.
``--laws`` instead evaluates the motion laws at three periods every 10 us, and prints the largest
use of each limit on each machine.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import re
import signal
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation
from whole_plans import Plan, plan_program, write_plan

from cnc_interp.core import InterpError
from cnc_interp.feedrate.motion_law import axis_motion
from cnc_interp.machine_model.machine import Machine, machines_directory
from cnc_interp.machine_model.signals import Signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.program_again import compare_with_text
from cnc_interp.proof.verify import verify
from cnc_interp.settings.options import Settings

Rows = NDArray[np.float64]
MM, DEG = 1e-3, np.pi / 180.0
PERIODS = 0.25, 0.5, 1.0, 2.0, 4.0  # [ms]
LAW_PERIODS, LAW_STEP = (0.25e-3, 1e-3, 4e-3), 1e-5  #: Of ``--laws`` [s].
SWITCHES = ('M428', 'M429'), ('M128', 'M129'), ('TRAORI', 'TRAFOOF')
PLANES = {'G17': (0, 1, 2), 'G18': (2, 0, 1), 'G19': (1, 2, 0)}
KINDS = 'line', 'rapid', 'arc', 'curve', 'stop', 'tolerance', 'feed', 'switch', 'plane', 'offset'
ODDS = 0.42, 0.10, 0.17, 0.08, 0.06, 0.05, 0.04, 0.05, 0.01, 0.02
#: Largest share of a limit that rounding makes [-]; setpoints are emitted as doubles.
USE = 1.0 + 1e-6
#: A place or an angle further off than this is doubtful [m, rad].
PLACE, ANGLE = 2e-9, 2e-9
#: Longest processor time of a program [s].
PATIENCE = 120
#: Poses known along a curve.
POSES = 401


@dataclass
class Motion:
    """What a line of a program means."""

    line: int
    #: (n, axes): Axis positions along it; of unknown ways only the last one, or none.
    q: Rows
    tolerance: tuple[float, float]  # contour and orientation [m]
    stop: bool = False
    known: bool = True
    first: int = 0  # line from which on it moves; 0 for its own
    #: Contour that the tool centre keeps away from [m], and by how much.
    contour: Rows | None = None
    radius: float = 0.0


@dataclass
class Writer:
    """Writes a program block by block, and knows what each means."""

    rng: np.random.Generator
    machine: Machine
    settings: Settings
    lines: list[str] = field(default_factory=list)
    motions: list[Motion] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.transform = Transform.of(self.machine)
        self.names = self.machine.axis_names
        self.low, self.high = self.machine.travel.T
        self.count = len(self.names)
        self.turning = [i for i in range(3, self.count) if self.names[i] in 'ABC']
        self.turning = [i for i in self.turning if self.high[i] - self.low[i] > 1e-6]
        self.zero = self.axes_of(np.zeros((1, 3)), np.zeros((1, self.count)))[0, :3]
        inch = self.rng.random() < 0.2
        self.unit, self.digits = (25.4 * MM, 8) if inch else (MM, 7)
        self.tcp = self.absolute = True
        self.tcp = bool(self.turning) and self.rng.random() < 0.5
        kind = int(self.rng.choice(3, p=[0.5, 0.25, 0.25]))
        self.on, self.off = SWITCHES[kind]
        self.siemens = kind == 2
        self.modal_stop = self.next_stops = False
        self.tolerance = self.settings.contour_tolerance, self.settings.orientation_tolerance
        self.words = np.zeros(self.count)  # of the last block: tip or axes, in m and rad
        self.timed = False

    def axes_of(self, tips: Rows, words: Rows) -> Rows:
        """Return axis positions of tips, with rotary and extra axes as in words."""
        q = words.copy()
        rotary = sum(name in 'ABC' for name in self.names)
        if rotary:
            q[:, :3] = self.transform.linear(tips, words[:, 3 : 3 + rotary])
        else:
            q[:, :3] = tips - self.transform.forward(np.zeros((1, self.count)))[0]
        if len(self.machine.extra_names):
            q[:, :3] -= words[:, 3 + rotary :] @ self.machine.extra_direction
        return q

    def meant(self, words: Rows) -> Rows:
        """Return the axis positions that words mean."""
        if self.tcp:
            return self.axes_of(words[:, :3], words)
        q = words.copy()
        q[:, :3] += self.zero
        return q

    def say(self, text: str) -> int:
        """Write a line; return its number."""
        self.lines.append(text)
        return len(self.lines)

    def number(self, value: float, size: float) -> tuple[str, float]:
        """Return a number as it is printed, and what is printed."""
        text = f'{value / size:.{self.digits}f}'
        return text, float(text) * size

    def printed(self, words: Rows, axes: list[int]) -> tuple[str, Rows]:
        """Return the words of some axes, and where they lead."""
        end, found = self.words.copy(), []
        for i in axes:
            size = DEG if self.names[i] in 'ABC' else self.unit
            from_here = 0.0 if self.absolute else self.words[i]
            text, value = self.number(words[i] - from_here, size)
            found.append(self.names[i] + text)
            end[i] = from_here + value
        return ' '.join(found), end

    def move(self, line: int, path: Rows, known: bool = True) -> None:
        """Keep what a line means: words along it."""
        self.motions.append(
            Motion(
                line, self.meant(path), self.tolerance, self.modal_stop or self.next_stops, known
            )
        )
        self.words, self.next_stops = path[-1].copy(), False

    def shares(self, end: Rows) -> Rows:
        """Return shares of a line, closer where axes turn far, shape (n, 1)."""
        turn = np.abs(end - self.words)[self.turning].max(initial=0.0)
        return np.linspace(0.0, 1.0, POSES * (1 + int(4.0 * turn)))[:, None]

    def feed(self) -> str:
        """Return the feed word of a block."""
        if self.timed:
            return f' F{np.exp(self.rng.uniform(np.log(10), np.log(300))):.3f}'
        return ''

    # --- blocks ----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Write the first blocks, up to the start pose."""
        self.say(f'{"G20" if self.unit > MM else "G21"} G90 G94 G17')
        if self.tcp:
            self.say(self.on)
        self.say(f'F{np.exp(self.rng.uniform(np.log(100), np.log(8000))) * MM / self.unit:.4f}')
        self.place()

    def place(self, known: bool = False) -> None:
        """Move to a pose by a rapid that names all axes; tell whether its start is known."""
        back, self.absolute = '' if self.absolute else 'G90 ', True
        text, end = self.printed(self.target(0.0), self.axes())
        line = self.say(f'{back}G0 {text}')
        share = self.shares(end) if known else np.ones((1, 1))
        self.move(line, self.words + share * (end - self.words), known)

    def axes(self) -> list[int]:
        """Return the axes that can be named."""
        return [i for i in range(self.count) if self.high[i] - self.low[i] > 1e-6]

    def target(self, near: float) -> Rows:
        """Return words of a random pose, near the present one with a certain chance."""
        rng, words = self.rng, self.words.copy()
        if rng.random() < near:
            words[:3] += rng.normal(size=3) * np.exp(rng.uniform(np.log(1e-5), np.log(0.02)))
            for i in self.turning:
                words[i] += rng.normal() * np.exp(rng.uniform(np.log(1e-4), np.log(0.3)))
        else:
            words[:3] = rng.uniform(-0.06, 0.06, 3)
            for i in self.turning:
                reach = 3.5 if self.high[i] - self.low[i] > 6.0 else 0.5 if self.tcp else 1.0
                words[i] = rng.choice(
                    [rng.uniform(-reach, reach), 0.0, rng.uniform(-2e-5, 2e-5)],
                    p=[0.8, 0.15, 0.05],
                )
        for i in range(3, self.count):
            if self.names[i] not in 'ABC':
                words[i] = rng.uniform(-0.02, 0.02)
        q = np.clip(self.meant(words[None])[0], self.low, self.high)
        words[3:] = q[3:]
        if not self.tcp:
            words[:3] = q[:3] - self.zero
        return words

    def line(self, code: str = 'G1', near: float = 0.6) -> None:
        """Write a line, a repeat of the present position, or a tiny move."""
        rng, chance = self.rng, self.rng.random()
        axes = [i for i in self.axes() if rng.random() < 0.6] or [0]
        words = self.target(near)
        if chance < 0.12:
            words = self.words.copy()
        elif chance < 0.22:
            words = self.words + rng.normal(size=self.count) * 10.0 ** rng.uniform(-12, -6)
        text, end = self.printed(words, axes)
        feed = self.feed() if code == 'G1' else ''
        stop = 'G9 ' if self.siemens and rng.random() < 0.2 else ''
        self.next_stops = bool(stop)
        line = self.say(f'{stop}{code} {text}{feed}')
        self.move(line, self.words + self.shares(end) * (end - self.words))

    def arc(self) -> None:
        """Write an arc or a helix, with rotary motion at times."""
        rng = self.rng
        plane = list(PLANES)[rng.integers(3)]
        a, b, c = PLANES[plane]
        sweep = rng.uniform(0.05, 6.2) * rng.choice([-1, 1])
        radius = np.exp(rng.uniform(np.log(2e-4), np.log(0.03)))
        place = rng.uniform(0.0, 2.0 * np.pi)
        arm = -radius * np.exp(1j * place)
        found = [self.number(x, self.unit) for x in (-arm.real, -arm.imag)]
        arm = -complex(found[0][1], found[1][1])
        end = -arm + arm * np.exp(1j * sweep)
        words, axes = self.words.copy(), [a, b]
        words[a] += end.real
        words[b] += end.imag
        if rng.random() < 0.3:
            words[c] += rng.uniform(-0.01, 0.01)
            axes.append(c)
        for i in self.turning:
            if rng.random() < 0.15:
                words[i] = np.clip(words[i] + rng.uniform(-0.2, 0.2), self.low[i], self.high[i])
                axes.append(i)
        text, words = self.printed(words, sorted(axes))
        turns = int(rng.integers(2, 4)) if rng.random() < 0.08 else 1
        code = 'G3' if sweep > 0 else 'G2'
        centre = f'{"IJK"[a]}{found[0][0]} {"IJK"[b]}{found[1][0]}'
        many = f' P{turns}' if turns > 1 else ''
        line = self.say(f'{plane} {code} {text} {centre}{many}{self.feed()}')
        self.say('G17')
        end = complex(words[a] - self.words[a], words[b] - self.words[b]) + arm
        turn = np.angle(end / arm * np.sign(sweep) ** 0) * np.sign(sweep) % (2.0 * np.pi)
        turn = turn + 2.0 * np.pi * (turns - 1)
        chords = np.sqrt(5.0 * abs(arm) * turn**2 / min(self.tolerance))  # within a fortieth
        share = np.linspace(0.0, 1.0, POSES * turns + int(chords))
        size = abs(arm) + share * (abs(end) - abs(arm))
        at = size * arm / abs(arm) * np.exp(1j * np.sign(sweep) * share * turn)
        path = self.words + share[:, None] * (words - self.words)
        path[:, a] = self.words[a] + (at - arm).real
        path[:, b] = self.words[b] + (at - arm).imag
        self.move(line, path)

    def curve(self) -> None:
        """Write a B-spline in X Y Z."""
        # A second BSPLINE right after a curve would continue it.
        if not self.tcp or self.timed or not self.siemens or self.motions[-1].first:
            self.arc()
            return
        rng = self.rng
        count = int(rng.integers(3, 7))
        size = np.exp(rng.uniform(np.log(5e-4), np.log(0.02)))
        if not self.absolute:
            self.say('G90')
            self.absolute = True
        self.say('BSPLINE SD=3')
        points, intervals = [self.words[:3]], []
        for _ in range(count):
            wanted = points[-1] + rng.normal(size=3) * size
            found = [self.number(x, self.unit) for x in wanted]
            points.append(np.array([value for _, value in found]))
            intervals.append(round(float(rng.uniform(0.2, 2.0)), 3))
            text = ' '.join(k + text for k, (text, _) in zip('XYZ', found, strict=True))
            line = self.say(f'{text} PL={intervals[-1]:g}')
        inner = np.cumsum(intervals[: count - 2])
        knots = np.concatenate([np.zeros(4), inner, np.full(3, inner[-1])])
        path = np.tile(self.words, (POSES, 1))
        path[:, :3] = BSpline(knots, np.array(points), 3)(np.linspace(0.0, inner[-1], POSES))
        self.move(line, path)
        self.motions[-1].first = line - count + 1

    def stop(self) -> None:
        """Switch exact stops on or off, or dwell."""
        chance = self.rng.random()
        if chance < 0.3 and self.motions:
            self.say('G4 P0.05')
            self.motions[-1].stop = True
            return
        self.modal_stop = chance < 0.7
        if self.modal_stop:
            self.say(str(self.rng.choice(['G61', 'G61.1'])))
        else:
            self.say('G64')
            self.tolerance = (
                self.settings.contour_tolerance,
                self.settings.orientation_tolerance,
            )

    def tolerances(self) -> None:
        """Write a tolerance."""
        text, value = self.number(np.exp(self.rng.uniform(np.log(3e-6), np.log(2e-4))), self.unit)
        if self.rng.random() < 0.5 or not self.siemens:
            self.say(f'G64 P{text}')
            self.modal_stop, self.tolerance = False, (value, value)
        else:
            self.say(f'CTOL={text}')
            self.tolerance = value, self.tolerance[1]

    def feeds(self) -> None:
        """Write a feed, or another kind of it."""
        if self.rng.random() < 0.3 and not self.timed:
            self.timed = True
            self.say('G93')
            return
        if self.timed:
            self.timed = False
            self.say('G94')
        self.say(f'F{np.exp(self.rng.uniform(np.log(20), np.log(20000))) * MM / self.unit:.4f}')

    def switch(self) -> None:
        """Switch tool-tip control, or between absolute and incremental words."""
        if self.turning and self.rng.random() < 0.7:
            q = self.meant(self.words[None])
            self.tcp = not self.tcp
            self.words = q[0].copy()
            self.words[:3] = self.transform.forward(q)[0][0] if self.tcp else q[0, :3] - self.zero
            self.say(self.on if self.tcp else self.off)
            self.place(known=True)
        else:
            self.absolute = not self.absolute
            self.say('G90' if self.absolute else 'G91')

    def plane(self) -> None:
        """Write lines on a tilted plane, with the tool upright on it."""
        if len(self.turning) < 2 or (not self.tcp and self.rng.random() < 0.5):
            return
        rng = self.rng
        tcp = self.tcp
        if tcp:
            self.say(self.off)
        angles = [rng.uniform(-180, 180), rng.uniform(0, 20), rng.uniform(-180, 180)]
        texts = [f'{x:.6f}' for x in angles]
        turn = Rotation.from_euler('ZXZ', [float(x) for x in texts], degrees=True).as_matrix()
        placed = [self.number(x, self.unit) for x in rng.uniform(-0.02, 0.02, 3)]
        origin = np.array([value for _, value in placed])
        self.say('G90')
        self.say(
            ' '.join(
                [
                    'G68.2',
                    *(k + text for k, (text, _) in zip('XYZ', placed)),
                    *(k + text for k, text in zip('IJK', texts)),
                ]
            )
        )
        line = self.say('G53.1')
        self.motions.append(Motion(line, np.zeros((0, self.count)), self.tolerance, known=False))
        point = None
        for step in range(int(rng.integers(2, 5))):
            local = rng.uniform(-0.02, 0.02, 3)
            found = [self.number(x, self.unit) for x in local]
            code = 'G1' if step else 'G0'
            line = self.say(
                ' '.join([code, *(k + t for k, (t, _) in zip('XYZ', found))])
                + (self.feed() if step else '')
            )
            new = origin + turn @ np.array([value for _, value in found])
            begin = new if point is None else point
            share = np.linspace(0.0, 1.0, POSES)[:, None]
            # A pose instead of axes: tips, then the tool axis; told by its width.
            poses = np.hstack([begin + share * (new - begin), np.tile(turn[:, 2], (POSES, 1))])
            self.motions.append(
                Motion(
                    line,
                    poses if step else poses[-1:],
                    self.tolerance,
                    self.modal_stop,
                    step > 0,
                )
            )
            point = new
        self.say('G69')
        if tcp:
            self.say(self.on)
        self.absolute = True
        self.place()

    def offset(self) -> None:
        """Write a contour with cutter compensation, the rotary axes at rest."""
        if self.tcp:
            return
        rng = self.rng
        diameter, printed = self.number(rng.uniform(0.5e-3, 8e-3), self.unit)
        self.say('G90')
        side = str(rng.choice(['G41.1', 'G42.1']))
        self.absolute = True
        self.say(f'{side} D{diameter}')
        corners, count = [], int(rng.integers(3, 7))
        stop = self.modal_stop
        for k in range(count):
            words = self.words.copy()
            words[:2] += rng.normal(size=2) * 0.02
            if rng.random() < 0.2:
                words[:2] = self.words[:2] + printed * np.array([0.5, 0.0])
            words = np.clip(words, -0.07, 0.07) if k < 0 else words
            text, end = self.printed(words, [0, 1])
            line = self.say(f'G1 {text}{self.feed()}')
            corners.append(end[:2].copy())
            inside = np.array(corners) if 0 < k < count - 1 else None
            self.motions.append(
                Motion(
                    line,
                    np.zeros((0, self.count)),
                    self.tolerance,
                    stop,
                    False,
                    contour=inside,
                    radius=printed / 2,
                )
            )
            self.words = end
        for motion in self.motions[-count + 1 : -1]:
            motion.contour = np.array(corners)
        self.say('G40')
        self.place()

    def program(self) -> str:
        """Write a whole program."""
        self.begin()
        for kind in self.rng.choice(KINDS, int(self.rng.integers(4, 12)), p=ODDS):
            if kind == 'rapid':
                self.line('G0', 0.2)
            elif kind == 'tolerance':
                self.tolerances()
            elif kind == 'feed':
                self.feeds()
            else:
                getattr(self, kind)()
        self.line(near=0.0)
        self.say('M2')
        return '\n'.join(self.lines) + '\n'


def made(seed: int, machines: list[str]) -> tuple[str, Writer]:
    """Return the program of a seed, and who has written it."""
    rng = np.random.default_rng([39, seed])
    # The functions of its words have a test of their own; a plan in memory does not have them.
    machine = replace(Machine.load(machines[seed % len(machines)]), signals=Signals())
    contour, orientation = np.exp(rng.uniform(np.log(2e-6), np.log(2e-4), 2))
    settings = Settings(
        contour_tolerance=float(contour),
        orientation_tolerance=float(orientation),
        interpolation_period=float(rng.choice(PERIODS)) * 1e-3,
    )
    writer = Writer(rng, machine, settings)
    return writer.program(), writer


# --- the checks ----------------------------------------------------------------------------------


@dataclass
class Emitted:
    """The setpoints, and the poses at them."""

    plan: Plan
    zero: Rows  # X Y Z of the machine where the words are zero [m]

    def __post_init__(self) -> None:
        plan = self.plan
        self.height = plan.settings.flank_height
        self.q, self.period = plan.setpoints.position, plan.settings.interpolation_period
        self.line = plan.program.blocks.line_number[plan.setpoints.block]
        held = np.concatenate([self.q[:1].repeat(3, 0), self.q, self.q[-1:].repeat(3, 0)])
        self.differences = [np.abs(np.diff(held, k, axis=0)) / self.period**k for k in (1, 2, 3)]

    def poses(self, rows: Rows) -> Rows:
        """Return tips and points at flank height, shape (n, 6) [m]."""
        if len(rows) and rows.shape[1] == 6 and self.posed(rows):
            tip, axis = rows[:, :3], rows[:, 3:]
        else:
            tip, axis = Transform.of(self.plan.machine).forward(rows)
        return np.hstack([tip, tip + self.height * axis])

    def posed(self, rows: Rows) -> bool:
        """Tell poses from positions of six axes."""
        return len(self.plan.machine.axis_names) != 6 or bool(
            np.allclose(np.linalg.norm(rows[:, 3:], axis=1), 1.0)
        )


def limits(found: Emitted) -> list[str]:
    """Check velocity, acceleration and jerk of each axis by differences, and the time."""
    machine, faults = found.plan.machine, []
    rows = machine.max_velocity, machine.max_acceleration, machine.max_jerk
    for what, change, row in zip('vaj', found.differences, rows, strict=True):
        # A position of 1 m is known to 1e-16 m, a third difference to eight times that.
        blur = 8.0 * 2.3e-16 * np.abs(found.q).max(axis=0) / found.period ** (' vaj'.index(what))
        use = (change.max(axis=0) - blur) / row
        for axis in np.flatnonzero(use > USE):
            faults.append(f'{what} of {machine.axis_names[axis]} is {use[axis]:.6f} of its limit')
    times = found.plan.setpoints.time
    if abs(times[0]) > 1e-12 or np.abs(np.diff(times) - found.period).max() > 1e-9:
        faults.append('the clock is not even')
    return faults


def distances(points: Rows, curves: list[Rows], scale: Rows) -> Rows:
    """Return how far tips and points at flank height are from their curves [tolerances]."""
    worst = np.zeros(len(points))
    for part in (slice(0, 3), slice(3, 6)):
        best = np.full(len(points), np.inf)
        for curve in curves:
            a = curve[:-1, part]
            at, way = points[:, None, part] - a, curve[1:, part] - a
            share = (at * way).sum(axis=2) / np.maximum((way**2).sum(axis=1), 1e-300)
            off = at - np.clip(share, 0.0, 1.0)[..., None] * way
            best = np.minimum(best, np.sqrt((off**2).sum(axis=2).min(axis=1)))
        worst = np.maximum(worst, best / scale[part.start])
    return worst


def thinned(poses: Rows) -> Rows:
    """Return a curve of poses by two where it is straight."""
    share = np.linspace(0.0, 1.0, len(poses))[:, None]
    straight = poses[0] + share * (poses[-1] - poses[0])
    return poses[[0, -1]] if np.abs(poses - straight).max() < 1e-10 else poses


def path(found: Emitted, motions: list[Motion]) -> list[str]:
    """Check that each setpoint is beside the programmed curves, within the tolerances."""
    faults = []
    curves = [thinned(found.poses(motion.q)) if len(motion.q) else None for motion in motions]
    emitted = found.poses(found.q)

    def beside(k: int, step: int) -> list[int]:
        """Return the motions before or after one, up to one that is longer than tolerances."""
        some = []
        while 0 <= (k := k + step) < len(motions):
            some.append(k)
            curve = curves[k]
            long = curve is not None and np.ptp(curve, axis=0).max() > 4.0 * max(
                max(each.tolerance) for each in motions
            )
            if long or curve is None:
                break
        return some

    for k, motion in enumerate(motions):
        first = motion.first or motion.line
        rows = np.flatnonzero((found.line >= first) & (found.line <= motion.line))
        if not motion.known or not len(rows):
            continue
        rows = rows[:: max(1, len(rows) // 300)]
        for i in (k - 1, k + 1):  # a corner with a way that is not known is not judged
            if 0 < i < len(motions) and curves[i] is None:
                joint = curves[k][0 if i < k else -1]
                off = np.linalg.norm(emitted[rows] - joint, axis=1)
                rows = rows[off > 8.0 * max(motion.tolerance)]
        if not len(rows):
            continue
        near = [*beside(k, -1), k, *beside(k, 1)]
        scale = np.repeat(np.max([motions[i].tolerance for i in near], axis=0), 3)
        off = distances(
            emitted[rows], [c for i in near if (c := curves[i]) is not None and len(c) > 1], scale
        )
        if off.max() > 1.0 + 1e-3:
            worst = int(np.argmax(off))
            faults.append(
                f'line {motion.line}: setpoint {rows[worst]} is {off[worst]:.4f} '
                f'tolerances from the program'
            )
    return faults


def order(found: Emitted, motions: list[Motion]) -> list[str]:
    """Check that all curves are run through one after the other, with the stops of the text."""
    faults, index = [], 0
    emitted = found.poses(found.q)
    speed = found.differences[0][3:] if len(found.q) > 1 else found.differences[0][2:]
    limit = found.plan.machine
    slow = (speed[: len(found.q)] / (limit.max_jerk * found.period**2)).max(axis=1)
    # Between setpoints the path bends by at most this [m], at flank height more.
    arms = 1.0 + found.height + np.abs(emitted).max() * 4.0
    sag = arms * float(limit.max_acceleration.max()) * found.period**2 / 4.0
    jump = arms * float(limit.max_jerk.max()) * found.period**3
    for motion in motions:
        if not len(motion.q):
            continue
        poses = found.poses(motion.q)
        marks = poses[np.unique(np.linspace(0, len(poses) - 1, 6).astype(int))]
        marks = marks[-1:] if not motion.known else marks
        for mark in marks:
            # Both points are near their marks at different places of a rounded corner.
            room = np.repeat(loosest_of(motions, motion) * 1.5 + sag + PLACE, 3)
            off = to_polyline(emitted[index:], mark, room)
            near = np.flatnonzero(off <= 1.0)
            if not len(near):
                faults.append(
                    f'line {motion.line}: not reached after setpoint {index}, '
                    f'{off.min():.4g} of what is allowed'
                )
                return faults
            index += int(near[0])
        if motion.stop:
            away = np.linalg.norm(emitted[index:] - poses[-1], axis=1)
            rests = np.flatnonzero((away < jump + PLACE) & (slow[index:] <= 1.0))
            if not len(rests):
                faults.append(f'line {motion.line}: does not stop, {away.min():.3g} m')
                return faults
            index += int(rests[0])
    return faults


def loosest_of(motions: list[Motion], motion: Motion) -> Rows:
    """Return the largest tolerances of a motion and both beside it."""
    k = motions.index(motion)
    near = motions[max(k - 1, 0) : k + 2]
    return np.asarray(np.max([each.tolerance for each in near], axis=0))


def to_polyline(points: Rows, mark: Rows, room: Rows) -> Rows:
    """Return how far each leg of a polyline passes from a point [of the room]."""
    a = points / room
    way = np.diff(a, axis=0, append=a[-1:])
    at = mark / room
    share = ((at - a) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300)
    off = at - a - np.clip(share, 0.0, 1.0)[:, None] * way
    return np.asarray(np.linalg.norm(off.reshape(-1, 2, 3), axis=2).max(axis=1))


def ends(found: Emitted, motions: list[Motion]) -> list[str]:
    """Check where the program ends."""
    last = motions[-1].q[-1]
    off = np.abs(found.q[-1] - last)
    room = np.where([name in 'ABC' for name in found.plan.machine.axis_names], ANGLE, PLACE)
    wrong = np.flatnonzero(off > room * 5.0)
    return [f'{found.plan.machine.axis_names[i]} ends {off[i]:.3g} off' for i in wrong]


def contours(found: Emitted, motions: list[Motion]) -> list[str]:
    """Check that the compensated tool keeps off its contour."""
    faults = []
    for motion in motions:
        rows = np.flatnonzero(found.line == motion.line)
        if motion.contour is None or len(rows) < 4:
            continue
        a, way = motion.contour[:-1], np.diff(motion.contour, axis=0)
        square = np.maximum((way**2).sum(axis=1), 1e-300)
        words = found.q[rows, :2] - found.zero[:2]
        share = np.clip(((words[:, None] - a) * way).sum(axis=2) / square, 0.0, 1.0)
        off = np.linalg.norm(words[:, None] - a - share[..., None] * way, axis=2).min(axis=1)
        allowed = motion.radius - 2.2 * max(motion.tolerance) - 1e-8
        if off.min() < allowed:
            faults.append(f'line {motion.line}: the cutter is {allowed - off.min():.3g} m inside')
    return faults


def proven(plan: Plan, text: str, folder: Path) -> tuple[list[str], str]:
    """Prove the plan files and compare the text with them; return faults, and who compared."""
    program = folder / 'part.ngc'
    program.write_text(text)
    write_plan(plan, folder / 'plan')
    files = read_plan(folder / 'plan')
    faults = list(verify(files, plan.machine).failures)
    try:
        agreed = compare_with_text(files, plan.machine, program)
    except InterpError as reason:
        return faults, 'by none: ' + re.sub(r'[-\d.]+|/\S+', '#', str(reason))[:60]
    both = "LinuxCNC's rs274 to" in agreed.readers, 'second reader of plain' in agreed.readers
    told = {(True, True): 'by both', (True, False): 'by rs274'}.get(both, 'by the plain one')
    if not both[0]:
        told += ' since ' + re.sub(r'[-\d.]+|/\S+', '#', agreed.readers)[:70]
    return [*faults, *(f'--program: {each}' for each in agreed.faults)], told


@dataclass
class Result:
    """What came of a program at a period: ``what`` in a word, doubts, and who compared it."""

    what: str
    exceeded: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    unproven: list[str] = field(default_factory=list)
    compared: str = ''

    @property
    def texts(self) -> list[str]:
        """Return all that is wrong, one line each."""
        return [*self.exceeded, *self.doubts, *(f'not proven: {each}' for each in self.unproven)]


def tried(text: str, writer: Writer, proof: bool, folder: Path) -> Result:
    """Plan a program and check it."""
    try:
        program = read_text(text, 'p.ngc', writer.transform, writer.settings)
        plan = plan_program(program, writer.machine, writer.settings)
    except InterpError as problem:
        return Result('refused', doubts=[str(problem)])
    found = Emitted(plan, writer.zero)
    result = Result('sound', exceeded=limits(found))
    for check in (ends, order, path, contours):
        result.doubts += check(found, writer.motions)
    if proof:
        result.unproven, result.compared = proven(plan, text, folder)
    result.what = 'doubtful' if result.texts else 'sound'
    return result


def law_use(plan: Plan) -> Rows:
    """Return the largest use of velocity, acceleration, jerk and feed by a law at any instant."""
    most = np.zeros(4)
    for piece in plan.pieces:
        law, instants = piece.law, np.arange(piece.law.time[0], piece.law.end_time, LAW_STEP)
        for at in np.array_split(instants, len(instants) // 100_000 + 1):
            q, *derivatives = axis_motion(piece.path, law, at)[:4]
            limits = plan.machine.limits.along(q)
            for k, values in enumerate(derivatives):
                most[k] = max(most[k], float((np.abs(values) / limits[k]).max(initial=0.0)))
            feed = piece.path.cell_feed[law.cell[law.piece_at(at)]]
            most[3] = max(most[3], float((law.evaluate(at)[1] / feed).max(initial=0.0)))
    return most


def laws(seeds: range, machines: list[str]) -> None:
    """Print the largest use of each limit by the laws of random programs on each machine."""
    most: dict[tuple[str, float], Rows] = {}
    for seed in seeds:
        text, writer = made(seed, machines)
        for period in LAW_PERIODS:
            settings = replace(writer.settings, interpolation_period=period)
            try:
                program = read_text(text, 'p.ngc', writer.transform, settings)
                use = law_use(plan_program(program, writer.machine, settings))
            except InterpError as problem:
                print(f'{seed} {writer.machine.name}: {problem}')
                continue
            if (use > 1.0).any():
                print(f'{seed} {writer.machine.name} {period * 1e3} ms is beyond a limit: {use}')
            key = writer.machine.name, period
            most[key] = np.maximum(most.get(key, np.zeros(4)), use)
    print('machine            ms  velocity  acceleration  jerk      feed')
    for (name, period), use in sorted(most.items()):
        print(f'{name:16} {period * 1e3:4} ' + '  '.join(f'{value:.6f}' for value in use))


def too_long(number: int, frame: FrameType | None) -> None:
    """End a program that takes too long."""
    raise TimeoutError(f'more than {PATIENCE} s of the processor')


def main() -> None:
    """Try programs; print what is doubtful, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=5000)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--proof', type=int, default=2, help='prove and compare each so many')
    parser.add_argument('--show', type=int, help='print the program of a seed, and what it does')
    parser.add_argument('--periods', type=float, nargs='+', default=[], metavar='MS')
    parser.add_argument('--json', type=Path, help='write the table, to add up shards')
    parser.add_argument('--laws', action='store_true', help='evaluate the motion laws instead')
    options = parser.parse_args()
    machines = sorted(path.stem for path in machines_directory().glob('*.yaml'))
    if options.show is not None:
        text, writer = made(options.show, machines)
        print(f'{writer.machine.name}, {writer.settings}\n{text}')
        options.first, options.count, options.proof = options.show, 1, 1
    if options.laws:
        laws(range(options.first, options.first + options.count), machines)
        return
    counts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    signal.signal(signal.SIGPROF, too_long)
    begun = time.process_time()
    seeds = range(options.first, options.first + options.count)
    with contextlib.suppress(KeyboardInterrupt), tempfile.TemporaryDirectory() as folder:
        for seed, period in itertools.product(seeds, options.periods or [None]):
            text, writer = made(seed, machines)
            if period is not None:
                writer.settings = replace(writer.settings, interpolation_period=period * 1e-3)
            proof = seed % options.proof == 0
            signal.setitimer(signal.ITIMER_PROF, PATIENCE)
            try:
                result = tried(text, writer, proof, Path(folder))
            except Exception:
                result = Result('traceback', doubts=traceback.format_exc().splitlines()[-7:])
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            counts['programs'] += 1
            counts[result.what] += 1
            counts['beyond a limit'] += bool(result.exceeded)
            if result.compared:
                counts['proven'] += not result.unproven
                counts['wrongly rejected'] += result.texts == [
                    f'not proven: {each}' for each in result.unproven
                ] and bool(result.unproven)
                counts['proven, but doubtful'] += not result.unproven and bool(result.texts)
                reasons[f'compared {result.compared}'] += 1
            if result.what == 'refused':
                said = re.sub(r'[-+]?\d[\d.e+-]*', '#', result.texts[0])
                reasons[f'refused: {said[:90]}'] += 1
            for text in result.unproven:
                reasons['not proven: ' + re.sub(r'[-+]?\d[\d.e+-]*', '#', text)[:60]] += 1
            if result.what != 'sound':
                at = f'{writer.settings.interpolation_period * 1e3:g} ms'
                name = f'{writer.machine.name} {at}'
                print(seed, name, result.what, *result.texts[-7:], sep='\n  ', flush=True)
    table = counts | {'all [CPU s]': round(time.process_time() - begun)}
    print(json.dumps(table))
    for reason, times in reasons.most_common():
        print(f'{times:6} {reason}')
    if options.json:
        options.json.write_text(json.dumps({'counts': table, 'reasons': reasons}))


if __name__ == '__main__':
    main()
