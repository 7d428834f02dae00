"""Draw the figures of ``docs/how_it_works``, and compute the tables of the worked example.

    python docs/make_method_figures.py

writes ``docs/pictures/method_*.png`` and the tables of ``docs/how_it_works/worked_example.md``.
Needs matplotlib beside the package.
"""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from make_pictures import BLUE, INK, ORANGE, PICTURES, QUIET, STYLE
from matplotlib import pyplot as plt
from matplotlib.patches import Polygon
from scipy.interpolate import BPoly, BSpline, PPoly

import cnc_interp
from cnc_interp import Machine, Plan, PlanOptions, evaluate, plan_path, read_program
from cnc_interp.core import DEG, MM, MM_PER_MIN, MS, UM, FloatArray
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import AxisPath, septic_coefficients
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import limits_of
from cnc_interp.smoothing.segments import CORNER

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / 'examples' / 'five_blocks.ngc'
PAGE = ROOT / 'docs' / 'how_it_works' / 'worked_example.md'
CORNER_KNOTS = np.array([0, 0, 0, 0, 0.5, 1, 1, 1, 1])
COLOURS = BLUE, ORANGE, '#3f8f5b', '#8b5fb0', '#c8553d'


def sheet(rows: int, height: float) -> Any:
    """Open a figure with panels below each other."""
    return plt.subplots(rows, 1, figsize=(9.4, height), squeeze=False, sharex=True)


def save(figure: Any, name: str) -> None:
    figure.tight_layout()
    figure.savefig(PICTURES / f'method_{name}.png', dpi=110)
    plt.close(figure)


def speeds(piece: PlannedPiece, count: int = 3000) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, place [mm] and feed [mm/min] along a law."""
    time = np.linspace(0.0, piece.law.end_time, count)
    s, v, _, _ = piece.law.evaluate(time)
    return time, s / MM, v / MM_PER_MIN


def jerk_uses(path: AxisPath, piece: PlannedPiece, machine: Machine) -> tuple[FloatArray, ...]:
    time = np.linspace(0.0, piece.law.end_time, 6000)
    s, v, a, j = (row[:, None] for row in piece.law.evaluate(time))
    _, q_s, q_ss, q_sss = evaluate(path, s[:, 0])
    return s[:, 0] / MM, (q_s * j + 3 * q_ss * v * a + q_sss * v**3) / machine.max_jerk


def draw_law(path: AxisPath, piece: PlannedPiece, machine: Machine, solver: Any) -> None:
    """Draw both laws of the example, and the use of the jerk limits."""
    reference, _ = solver['reference'](path, machine)
    figure, panels = sheet(2, 5.6)
    _, s, feed = speeds(piece)
    above, below = panels[:, 0]
    above.plot(s, feed, color=BLUE, lw=1.8, label='product')
    dots = reference.s / MM, reference.v / MM_PER_MIN
    above.plot(*dots, '.', color=ORANGE, ms=3, label='reference solver')
    above.set(ylabel='feed (mm/min)', ylim=(0, 3200))
    above.legend(loc='lower center')
    s, use = jerk_uses(path, piece, machine)
    for k, name in enumerate(machine.axis_names):
        below.plot(s, 100 * use[:, k], color=COLOURS[k], lw=1.0, label=name)
    below.set(xlabel='path length (mm)', ylabel='jerk, % of its limit', xlim=(0, s[-1]))
    below.legend(ncols=5, loc='lower center')
    save(figure, 'law')


def draw_barrier(path: AxisPath, machine: Machine) -> None:
    """Draw the laws on the way of the barrier from the middle to the limits."""
    figure, panels = sheet(1, 3.4)
    shades = mpl.colormaps['viridis'](np.linspace(0.85, 0.1, 4))
    for colour, gap in zip(shades, (3.0, 0.3, 0.03, PlanOptions().gap), strict=True):
        piece = plan_path(path, machine, PlanOptions(gap=gap))
        _, s, feed = speeds(piece)
        text = f'gap {gap:g} of the time: {piece.law.end_time:.3f} s'
        panels[0, 0].plot(s, feed, color=colour, lw=1.5, label=text)
    panels[0, 0].set(xlabel='path length (mm)', ylabel='feed (mm/min)', ylim=(0, 4000))
    panels[0, 0].set(xlim=(0, s[-1]))
    panels[0, 0].legend(loc='upper center', ncols=2)
    save(figure, 'barrier')


def draw_bound(piece: PlannedPiece, machine: Machine) -> None:
    """Draw the jerk of X in one cell, the chord bound and the hull of its Bezier points."""
    path, law, widest = piece.path, piece.law, None
    begin, end = law.time, np.append(law.time[1:], law.end_time)
    for cell in np.flatnonzero(np.abs(path.cell_left[3, :, 0]) > 0.0):
        h, duration = float(np.diff(path.s[cell : cell + 2])[0]), float(end[cell] - begin[cell])
        _, v, a, j = (float(row[0]) for row in law.evaluate(begin[cell : cell + 1]))
        septic = np.empty(8)
        septic_coefficients(path.cell_left[:, cell, 0], path.cell_right[:, cell, 0], h, septic)
        way = np.polynomial.Polynomial([0.0, v / h, a / 2 / h, j / 6 / h])
        x = np.polynomial.Polynomial(septic)(way).deriv(3)
        t = np.linspace(0.0, duration, 400)
        excess = duration**2 / 8 * np.abs(x.deriv(2)(t)).max()
        if widest is None or excess > widest[0]:
            widest = excess, x, t
    assert widest is not None
    excess, x, t = widest[0] / machine.max_jerk[0], widest[1] / machine.max_jerk[0], widest[2]
    points = BPoly.from_power_basis(PPoly(x.coef[::-1, None], t[[0, -1]])).c[:, 0]
    figure, panels = sheet(1, 3.2)
    axes = panels[0, 0]
    axes.plot(t / MS, x(t), color=BLUE, lw=2, label='jerk x(t)')
    chord = np.interp(t, t[[0, -1]], x(t[[0, -1]]))
    shade = {'color': QUIET, 'alpha': 0.3, 'lw': 0, 'label': 'chord bound'}
    axes.fill_between(t / MS, chord - excess, chord + excess, **shade)
    at = np.linspace(0.0, t[-1], len(points)) / MS
    axes.plot(at, points, 'o-', color=ORANGE, ms=4, lw=0.8, label='Bezier points')
    axes.set(xlabel='time in the cell (ms)', ylabel='jerk of X / limit')
    axes.legend(loc='best')
    save(figure, 'bound')


def stops_of(path: AxisPath, piece: PlannedPiece, machine: Machine, every: float) -> list[Any]:
    """Return pairs of a time and the stop from there; places without one are left out."""
    table, found = limits_of(machine).table, []
    for time in np.arange(every, piece.law.end_time, every):
        s, v, a, _ = (float(row[0]) for row in piece.law.evaluate(np.array([time])))
        stop = stop_law(path, (s, v, a), table, 0.0)
        if stop is not None:
            found.append((float(time), stop))
    return found


def draw_stops(path: AxisPath, piece: PlannedPiece, machine: Machine) -> None:
    """Draw the planned feed over time, and the stop tails that hang from it."""
    figure, panels = sheet(1, 3.4)
    time, _, feed = speeds(piece)
    axes = panels[0, 0]
    for begin, stop in stops_of(path, piece, machine, 0.08):
        after, _, down = speeds(stop, 300)
        axes.plot(begin + after - after[0], down, color=ORANGE, lw=0.9)
    axes.plot(time, feed, color=BLUE, lw=2)
    axes.set(xlabel='time (s)', ylabel='feed (mm/min)', xlim=(0, time[-1]), ylim=(0, 3700))
    axes.plot([], [], color=BLUE, label='plan')
    axes.plot([], [], color=ORANGE, label='stop along the path, one every 80 ms')
    axes.legend(loc='upper center', ncols=2)
    save(figure, 'stops')


def draw_certificate() -> None:
    """Draw two pieces, the motion of one, and the gap that a direction proves."""
    a = np.array([[-1.2, -0.5], [0.9, -0.7], [1.1, 0.5], [-0.8, 0.8]]) + [0.0, 2.3]
    b = np.array([[-2.2, -1.4], [2.4, -1.2], [1.6, -0.2], [-1.4, 0.1]])
    pivot, turn, step = np.array([-3.0, 2.0]), 0.16, np.array([0.5, 0.12])

    def moved(t: float) -> FloatArray:
        c, s = np.cos(turn * t), np.sin(turn * t)
        return (a - pivot) @ np.array([[c, s], [-s, c]]) + pivot + t * step

    n = np.array([-0.05, -1.0]) / np.hypot(0.05, 1.0)
    cross = np.array([n[1], -n[0]])  # n x u, for u out of the picture
    w, k = turn * cross, float(step @ n - turn * cross @ pivot)
    front = max((a @ (n + w)).max() + k, (a @ (n - w)).max() - k)
    lever = np.linalg.norm(a - pivot, axis=1).max()
    rem = 2 * np.sin(turn / 2) * np.linalg.norm(step) + turn**2 / 2 * lever
    wall = -(b @ -n).max()
    figure, axes = plt.subplots(figsize=(7.6, 4.6))
    for t in np.linspace(-1, 1, 9):
        axes.add_patch(Polygon(moved(t), fc=BLUE, ec=BLUE, alpha=0.10 if abs(t) < 1 else 0.3))
    axes.add_patch(Polygon(b, fc=QUIET, ec=INK, alpha=0.6))
    along = np.array([-n[1], n[0]])
    for level, colour, text in (
        (front, BLUE, 'first order: max of both ends'),
        (front + rem, ORANGE, 'with the remainder rem'),
        (wall, INK, 'support of B'),
    ):
        line = level * n + np.outer([-3.4, 3.4], along)
        axes.plot(*line.T, color=colour, lw=1.3, ls='--', label=text)
    foot = (front + rem) * n - 2.9 * along
    axes.annotate('', foot + (wall - front - rem) * n, foot, arrowprops={'arrowstyle': '<->'})
    axes.annotate('gap', foot, (6, -16), textcoords='offset points')
    axes.set(aspect='equal', xlim=(-3.4, 3.9), ylim=(-1.6, 4.2), xticks=[], yticks=[])
    axes.text(0.0, 2.5, 'A, t from -1 to 1', ha='center')
    axes.text(0.1, -0.8, 'B', ha='center')
    axes.legend(loc='upper left', fontsize=8)
    save(figure, 'certificate')


def draw_spin() -> None:
    """Draw how near an arm is to a singular pose, over the path and the spin."""
    chain = JointChain.of(Machine.load('ur10e'))
    blocks = read_program(ROOT / 'examples' / 'pyramid.apt', chain).blocks
    part = np.linspace(0, len(blocks) - 1, 60)
    tip, axis = (
        np.stack([np.interp(part, range(len(blocks)), rows[:, k]) for k in range(3)], axis=1)
        for rows in (blocks.tip, blocks.axis)
    )
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    spins = np.arange(-180, 180, 10)
    least = np.full((len(spins), len(part)), np.nan)
    for row, spin in enumerate(spins):
        spun = chain.spun(spin * DEG)
        for column in range(len(part)):
            found = spun.branches(tip[column], axis[column])
            if len(found):
                rates = spun.pose_rates(found[0])
                rates[:3] /= spun.packed[-1, 3]
                least[row, column] = np.linalg.svd(rates, compute_uv=False)[-1]
    figure, panels = sheet(1, 3.6)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))]) / MM
    mesh = panels[0, 0].pcolormesh(way, spins, least, cmap='viridis', shading='nearest')
    figure.colorbar(mesh, label='smallest singular value of E')
    panels[0, 0].set(xlabel='path length (mm)', ylabel='spin (deg)')
    panels[0, 0].grid(visible=False)
    save(figure, 'spin')


def corner_rows(plan: Plan) -> list[int]:
    return np.flatnonzero(plan.segments.kind == CORNER).tolist()


def draw_example(plan: Plan) -> None:
    """Draw the five blocks, and the curve and control points of the second corner."""
    tip = plan.program.blocks.tip / MM
    figure, (whole, near) = plt.subplots(1, 2, figsize=(9.4, 3.8))
    for axes in (whole, near):
        axes.plot(tip[:, 0], tip[:, 1], color=QUIET, lw=1, marker='o', ms=3)
        for row in corner_rows(plan):
            points = plan.segments.bottom[row, :5] / MM
            curve = BSpline(CORNER_KNOTS, points, 3)(np.linspace(0, 1, 60))
            axes.plot(curve[:, 0], curve[:, 1], color=BLUE, lw=2)
            axes.plot(points[:, 0], points[:, 1], '.', color=ORANGE, ms=5)
        axes.set(xlabel='x (mm)', ylabel='y (mm)', aspect='equal')
    for number in range(1, len(tip)):
        middle = (tip[number] + tip[number - 1]) / 2
        whole.annotate(f'N{number}', middle[:2], (5, 5), textcoords='offset points')
    x, y = tip[2, :2]
    near.set(xlim=(x - 0.5, x + 0.8), ylim=(y - 0.7, y + 0.6))
    save(figure, 'example')


def vector(values: FloatArray, digits: int) -> str:
    return ', '.join(f'{value:.{digits}f}' for value in values)


def block_table(plan: Plan) -> list[str]:
    blocks = plan.program.blocks
    lines = ['| block | tip (mm) | tool axis | length (mm) |', '|---|---|---|---|']
    for row in range(1, len(blocks)):
        length = np.linalg.norm(blocks.tip[row] - blocks.tip[row - 1]) / MM
        tip, axis = vector(blocks.tip[row] / MM, 1), vector(blocks.axis[row], 4)
        lines.append(f'| N{row} | {tip} | {axis} | {length:.3f} |')
    return lines


def corner_table(plan: Plan) -> list[str]:
    lines = [
        '| corner | alpha (deg) | L1 (mm) | L2 before, after (mm) | contour, orientation (um) |',
        '|---|---|---|---|---|',
    ]
    for row in corner_rows(plan):
        points = plan.segments.bottom[row, :5] / MM
        before, after = points[0] - points[2], points[4] - points[2]
        lengths = [np.linalg.norm(points[k] - points[2]) for k in (1, 0, 4)]
        turn = np.degrees(np.arccos(before @ after / lengths[1] / lengths[2]))
        one, other = plan.segments.block[row]
        legs, deviation = vector(np.array(lengths[1:]), 4), plan.segments.deviation[row] / UM
        columns = f'{turn:.2f} | {lengths[0]:.4f} | {legs} | {vector(deviation, 2)}'
        lines.append(f'| N{one} to N{other} | {columns} |')
    return lines


def state_table(plan: Plan, piece: PlannedPiece) -> list[str]:
    """Tell the state in the second corner, and the jerk of each axis by its terms."""
    samples = plan.setpoints
    number = int(np.argmax(samples.block >= 3))
    path = piece.path
    s, v, a, j = (row[:1] for row in piece.law.evaluate(samples.time[number : number + 1]))
    q, q_s, q_ss, q_sss = (row[0] for row in evaluate(path, s))
    v, a, j = float(v[0]), float(a[0]), float(j[0])
    lines = [
        f'At setpoint {number} (t = {samples.time[number]:.3f} s, s = {s[0] / MM:.4f} mm): '
        f'$\\dot s$ = {v / MM_PER_MIN:.1f} mm/min, $\\ddot s$ = {a:.4f} m/s2, '
        f'$\\dddot s$ = {j:.2f} m/s3.',
        '',
        '| axis | q (mm, deg) | q_s j | 3 q_ss v a | q_sss v^3 | sum | limit |',
        '|---|---|---|---|---|---|---|',
    ]
    for k, name in enumerate(plan.machine.axis_names):
        unit = MM if plan.machine.axes[k].linear else DEG
        terms = q_s[k] * j, 3 * q_ss[k] * v * a, q_sss[k] * v**3
        values = ' | '.join(f'{term:.2f}' for term in (*terms, sum(terms)))
        lines.append(f'| {name} | {q[k] / unit:.4f} | {values} | {plan.machine.max_jerk[k]:.0f} |')
    return lines


def law_table(plan: Plan, piece: PlannedPiece) -> list[str]:
    limits, samples = plan.machine, plan.setpoints
    rows = [
        np.abs(samples.velocity).max(axis=0) / limits.max_velocity,
        np.abs(samples.acceleration).max(axis=0) / limits.max_acceleration,
        np.abs(samples.jerk).max(axis=0) / limits.max_jerk,
    ]
    lines = [f'| largest use | {" | ".join(limits.axis_names)} |', '|---|---|---|---|---|---|']
    for name, row in zip(('velocity', 'acceleration', 'jerk'), rows, strict=True):
        lines.append(f'| {name} | {" | ".join(f"{100 * use:.1f} %" for use in row)} |')
    slow = [float(samples.time[samples.block >= row][0]) for row in range(2, 6)]
    speed = piece.law.evaluate(np.array(slow))[1] / MM_PER_MIN
    lines += ['', '| corner | time (s) | feed there (mm/min) |', '|---|---|---|']
    for number, (time, feed) in enumerate(zip(slow, speed, strict=True), 1):
        lines.append(f'| N{number} to N{number + 1} | {time:.3f} | {feed:.0f} |')
    return [*lines, '', f'Cycle time {plan.cycle_time:.4f} s for {plan.length / MM:.3f} mm.']


def stop_table(path: AxisPath, piece: PlannedPiece, machine: Machine) -> list[str]:
    lines = [
        '| stop from (s) | feed (mm/min) | stop takes (s) | on the path (mm) |',
        '|---|---|---|---|',
    ]
    for time, stop in stops_of(path, piece, machine, 0.25):
        feed = piece.law.evaluate(np.array([time]))[1][0] / MM_PER_MIN
        last = stop.law.end_time - stop.law.time[0]
        way = float(stop.law.evaluate(np.array([stop.law.end_time]))[0][0] - stop.law.s[0]) / MM
        lines.append(f'| {time:.2f} | {feed:.0f} | {last:.3f} | {way:.3f} |')
    return lines


def write_page(plan: Plan, piece: PlannedPiece) -> None:
    """Write each table of the worked example between its marks."""
    tables = {
        'blocks': block_table(plan),
        'corners': corner_table(plan),
        'law': law_table(plan, piece),
        'state': state_table(plan, piece),
        'stops': stop_table(piece.path, piece, plan.machine),
    }
    text = PAGE.read_text(encoding='utf-8')
    for name, lines in tables.items():
        body = f'<!-- {name}: begin -->\n' + '\n'.join(lines) + f'\n<!-- {name}: end -->'
        text = re.sub(
            f'<!-- {name}: begin -->.*<!-- {name}: end -->',
            lambda _, to=body: to,
            text,
            flags=re.S,
        )
    PAGE.write_text(text, encoding='utf-8')


def main() -> None:
    """Draw all figures and write the page."""
    mpl.use('agg')
    solver = runpy.run_path(str(ROOT / 'examples' / '14_reference_solver.py'))
    plan = cnc_interp.plan(PROGRAM)
    (piece,) = plan.pieces
    write_page(plan, piece)
    with mpl.rc_context(STYLE):
        path, machine = solver['five_blocks']()
        draw_example(plan)
        draw_law(path, plan_path(path, machine), machine, solver)
        draw_barrier(path, machine)
        draw_bound(piece, machine)
        draw_stops(path, plan_path(path, machine), machine)
        draw_certificate()
        draw_spin()


if __name__ == '__main__':
    main()
