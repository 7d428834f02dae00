"""Jets against closed-form Taylor coefficients of the same formulas (by finite differences)."""

import numpy as np
import pytest

from cnc_interp.core import jet

T0 = 0.37


def taylor(f):
    """Taylor coefficients of f at T0 from a high-order polynomial fit."""
    x = np.cos(np.pi * (np.arange(15) + 0.5) / 15) * 0.1
    fit = np.polynomial.Polynomial.fit(x, f(T0 + x), 14, domain=[-0.1, 0.1])
    return fit.convert().coef[:4]


def inputs():
    """Two jets and the functions that they come from."""
    f, g = (lambda t: 1.3 + np.sin(2 * t)), (lambda t: np.exp(-t) + t**2)
    return f, g, tuple(taylor(f)), tuple(taylor(g))


@pytest.mark.parametrize(
    ('of_jets', 'of_numbers'),
    [
        (jet.add, lambda a, b: a + b),
        (jet.subtract, lambda a, b: a - b),
        (jet.multiply, lambda a, b: a * b),
        (jet.divide, lambda a, b: a / b),
        (jet.arctangent, np.arctan2),
        (lambda a, b: jet.square_root(a), lambda a, b: np.sqrt(a)),
        (lambda a, b: jet.sine_cosine(a)[0], lambda a, b: np.sin(a)),
        (lambda a, b: jet.sine_cosine(a)[1], lambda a, b: np.cos(a)),
    ],
)
def test_formula_of_jets_is_jet_of_formula(of_jets, of_numbers):
    f, g, a, b = inputs()
    assert np.allclose(of_jets(a, b), taylor(lambda t: of_numbers(f(t), g(t))), atol=1e-8)


def test_rotation_keeps_length_and_turns_by_the_angle():
    k = (0.6, 0.0, 0.8)
    angle = (0.4, 1.0, -0.3, 0.2)
    s, c = jet.sine_cosine(angle)
    v = (jet.constant(0.0), jet.constant(1.0), jet.constant(0.0))
    turned = jet.rotated(k, s, c, v)
    assert np.allclose(jet.dot(turned, turned), (1, 0, 0, 0), atol=1e-15)
    assert np.allclose(jet.dot(turned, v), c)  # v is perpendicular to k


def test_derivatives_by_arc_length_of_a_circle():
    """On a circle of radius r run at an uneven pace, |x_s| = 1, |x_ss| = 1/r, |x_sss| = 1/r^2."""
    r = 0.05
    phase = (0.2, 1.0, 0.7, -0.4)
    sine, cosine = jet.sine_cosine(phase)
    x, y = jet.scale(cosine, r), jet.scale(sine, r)
    speed = (r * phase[1], 2 * r * phase[2], 3 * r * phase[3], 0.0)
    dx, dy = jet.by_arc_length(x, speed), jet.by_arc_length(y, speed)
    sizes = [np.hypot(dx[i], dy[i]) for i in (1, 2, 3)]
    assert np.allclose(sizes, [1.0, 1 / r, 1 / r**2], rtol=1e-12)
