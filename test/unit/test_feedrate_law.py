"""Motion law, feed limit, and the exact subdivision of paths."""

from __future__ import annotations

import numpy as np
from feedrate_paths import XYZAC, line_path, polyline_path

from cnc_interp.feedrate.limit_use import feed_limit
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.kinematics.axis_path import AxisPath, evaluate, refine

CORNER = np.array([[0, 0, 0], [0.02, 0, 0], [0.02, 0.015, 0], [0.035, 0.02, 0.01]], dtype=float)


def three_pieces() -> MotionLaw:
    duration = np.array([0.1, 0.2, 0.1])
    jerk = np.array([4.0, -2.0, 1.0])
    s, v, a = [0.0], [0.0], [0.0]
    for t, j in zip(duration, jerk, strict=True):
        s.append(s[-1] + v[-1] * t + a[-1] * t**2 / 2 + j * t**3 / 6)
        v.append(v[-1] + a[-1] * t + j * t**2 / 2)
        a.append(a[-1] + j * t)
    time = np.concatenate([[0.0], np.cumsum(duration)])[:-1]
    state = [np.array(x[:-1]) for x in (s, v, a)]
    return MotionLaw(time, duration, *state, jerk, np.arange(3))


def test_law_derivatives_agree_with_central_differences():
    law = three_pieces()
    t = np.linspace(0.001, 0.399, 57)
    step = 1e-5
    before, now, after = (law.evaluate(t + k * step) for k in (-1, 0, 1))
    for order in range(3):
        slope = (after[order] - before[order]) / (2 * step)
        np.testing.assert_allclose(slope, now[order + 1], atol=1e-4)


def test_law_rests_outside_its_time():
    law = three_pieces()
    s = law.evaluate(np.array([-1.0, 0.0, 9.0]))[0]
    assert s[0] == s[1] == 0.0
    assert s[2] == law.evaluate(np.array([law.end_time]))[0][0]


def test_lookup_by_known_piece_gives_the_same():
    law = three_pieces()
    t = np.linspace(0, law.end_time, 31)
    for plain, known in zip(law.evaluate(t), law.evaluate(t, law.piece_at(t)), strict=True):
        np.testing.assert_array_equal(plain, known)


def test_pieces_of_a_plan_fit_together_to_rounding():
    law = plan_path(polyline_path(CORNER), XYZAC).law
    t = law.duration
    s = law.s + t * (law.s_dot + t * (law.s_ddot / 2 + t * law.jerk / 6))
    v = law.s_dot + t * (law.s_ddot + t * law.jerk / 2)
    a = law.s_ddot + t * law.jerk
    np.testing.assert_allclose(s[:-1], law.s[1:], atol=1e-16)
    np.testing.assert_allclose(v[:-1], law.s_dot[1:], atol=1e-15)
    np.testing.assert_allclose(a[:-1], law.s_ddot[1:], atol=1e-13)
    assert law.s_dot[0] == law.s_ddot[0] == 0.0
    assert abs(v[-1]) < 1e-12 and abs(a[-1]) < 1e-9


def test_feed_limit_is_the_smallest_of_equation_10_on_both_sides():
    path = polyline_path(CORNER, feed=np.array([0.05, 0.03, 0.04]))
    limit = feed_limit(path, XYZAC)
    for i in range(len(path.s)):
        bounds = []
        for jets, cell in ((path.cell_left, i), (path.cell_right, i - 1)):
            if not 0 <= cell < len(path.s) - 1:
                continue
            bounds.append(path.cell_feed[cell])
            for k in range(5):
                q_s, q_ss, q_sss = np.abs(jets[1:, cell, k])
                bounds.append(XYZAC.max_velocity[k] / q_s if q_s else np.inf)
                bounds.append(np.sqrt(XYZAC.max_acceleration[k] / q_ss) if q_ss else np.inf)
                bounds.append(np.cbrt(XYZAC.max_jerk[k] / q_sss) if q_sss else np.inf)
        assert np.isclose(limit[i], min(bounds), rtol=1e-12)


def test_refining_does_not_move_the_path():
    path = polyline_path(CORNER)
    rng = np.random.default_rng(4)
    fine = refine(path, rng.uniform(0, path.s[-1], 200))
    s = rng.uniform(0, path.s[-1], 500)
    for scale, coarse_value, fine_value in zip(
        (1e-15, 1e-11, 1e-6, 1e-1), evaluate(path, s), evaluate(fine, s), strict=True
    ):
        size = np.maximum(1.0, np.abs(coarse_value))
        assert np.max(np.abs(coarse_value - fine_value) / size) < 100 * scale
    assert fine.stop.sum() == path.stop.sum()


def test_tiny_cells_of_a_straight_line_have_no_third_derivative():
    """Rounding of q, blown up by 210/h^3, once looked like jerk at full speed."""
    path = line_path(0.5)
    fine = refine(path, 0.2 + 1e-8 * np.arange(1, 6))
    at = 0.2 + 1e-8 * (np.arange(1, 5) + 0.37)
    assert np.max(np.abs(evaluate(fine, at)[3])) < 1e-6


def test_axes_that_move_far_in_nanometres_meet_from_cell_to_cell():
    """A tip that hardly moves while the tool turns: 1 mm of an axis in 0.3 um of s."""
    wave, h = 1e7, 2.0**-24  # half a radian of the wave a cell
    s = h * np.arange(9)
    jet = np.stack([np.sin(wave * s + k * np.pi / 2) * 1e-3 * wave**k for k in range(4)])
    jet = jet[..., None]
    steady = np.tile([[0.0, 0.0, 1.0]], (9, 1))
    path = AxisPath(
        s,
        jet[:, :-1].copy(),
        jet[:, 1:].copy(),
        0.0 * steady,
        steady,
        np.ones(8),
        np.zeros(8, np.int64),
        np.zeros(9, bool),
    )
    just_before = evaluate(path, s[1:] - 1e-9 * h, np.arange(8))[0]
    assert np.abs(just_before - jet[0, 1:]).max() < 3e-12


def test_finer_options_halve_the_cells_and_keep_the_rest():
    plain = PlanOptions()
    finer = plain.finer()
    for name, value in vars(plain).items():
        if name in ('cell_time', 'share', 'bend', 'step'):
            assert np.array_equal(2.0 * np.array(getattr(finer, name)), value), name
        elif name != 'below_ceiling':
            assert getattr(finer, name) == value, name
    assert finer.below_ceiling
