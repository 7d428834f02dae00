"""Jets: truncated Taylor arithmetic with a value and its first three Taylor coefficients.

A jet (c0, c1, c2, c3) is f(t) = c0 + c1 t + c2 t^2 + c3 t^3 + O(t^4), so a formula that is
evaluated with jets gives exact derivatives. A vector jet is a tuple of three jets.
"""

from math import atan2, cos, sin, sqrt

from cnc_interp.core.kernels import njit

Jet = tuple[float, float, float, float]
VectorJet = tuple[Jet, Jet, Jet]
Vector = tuple[float, float, float]


@njit(cache=True, nogil=True, inline='always')
def constant(a: float) -> Jet:
    return (a, 0.0, 0.0, 0.0)


@njit(cache=True, nogil=True, inline='always')
def add(a: Jet, b: Jet) -> Jet:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])


@njit(cache=True, nogil=True, inline='always')
def subtract(a: Jet, b: Jet) -> Jet:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3])


@njit(cache=True, nogil=True, inline='always')
def scale(a: Jet, x: float) -> Jet:
    """Return x a, where x is a number."""
    return (x * a[0], x * a[1], x * a[2], x * a[3])


@njit(cache=True, nogil=True, inline='always')
def multiply(a: Jet, b: Jet) -> Jet:
    return (
        a[0] * b[0],
        a[0] * b[1] + a[1] * b[0],
        a[0] * b[2] + a[1] * b[1] + a[2] * b[0],
        a[0] * b[3] + a[1] * b[2] + a[2] * b[1] + a[3] * b[0],
    )


@njit(cache=True, nogil=True, inline='always')
def divide(a: Jet, b: Jet) -> Jet:
    q0 = a[0] / b[0]
    q1 = (a[1] - q0 * b[1]) / b[0]
    q2 = (a[2] - q0 * b[2] - q1 * b[1]) / b[0]
    q3 = (a[3] - q0 * b[3] - q1 * b[2] - q2 * b[1]) / b[0]
    return (q0, q1, q2, q3)


@njit(cache=True, nogil=True, inline='always')
def square_root(a: Jet) -> Jet:
    r0 = sqrt(a[0])
    r1 = a[1] / (2.0 * r0)
    r2 = (a[2] - r1 * r1) / (2.0 * r0)
    r3 = (a[3] - 2.0 * r1 * r2) / (2.0 * r0)
    return (r0, r1, r2, r3)


@njit(cache=True, nogil=True, inline='always')
def sine_cosine(a: Jet) -> tuple[Jet, Jet]:
    s0, c0 = sin(a[0]), cos(a[0])
    s1, c1 = c0 * a[1], -s0 * a[1]
    s2 = 0.5 * (c1 * a[1]) + c0 * a[2]
    c2 = -0.5 * (s1 * a[1]) - s0 * a[2]
    s3 = (c2 * a[1] + 2.0 * c1 * a[2]) / 3.0 + c0 * a[3]
    c3 = -(s2 * a[1] + 2.0 * s1 * a[2]) / 3.0 - s0 * a[3]
    return (s0, s1, s2, s3), (c0, c1, c2, c3)


@njit(cache=True, nogil=True, inline='always')
def arctangent(y: Jet, x: Jet) -> Jet:
    """Return atan2(y, x), not both zero; its slope g follows from g (x^2 + y^2) = x y' - y x'."""
    d0 = x[0] * x[0] + y[0] * y[0]
    d1 = 2.0 * (x[0] * x[1] + y[0] * y[1])
    d2 = 2.0 * (x[0] * x[2] + y[0] * y[2]) + x[1] * x[1] + y[1] * y[1]
    n0 = x[0] * y[1] - y[0] * x[1]
    n1 = 2.0 * (x[0] * y[2] - y[0] * x[2])
    n2 = 3.0 * (x[0] * y[3] - y[0] * x[3]) + x[1] * y[2] - y[1] * x[2]
    g0 = n0 / d0
    g1 = (n1 - g0 * d1) / d0
    g2 = (n2 - g0 * d2 - g1 * d1) / d0
    return (atan2(y[0], x[0]), g0, 0.5 * g1, g2 / 3.0)


@njit(cache=True, nogil=True, inline='always')
def dot(a: VectorJet, b: VectorJet) -> Jet:
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]))


@njit(cache=True, nogil=True, inline='always')
def normalised(a: VectorJet) -> VectorJet:
    length = square_root(dot(a, a))
    return (divide(a[0], length), divide(a[1], length), divide(a[2], length))


@njit(cache=True, nogil=True, inline='always')
def rotated(axis: Vector, sine: Jet, cosine: Jet, v: VectorJet) -> VectorJet:
    """Rotate a vector jet about a unit axis, by jets of sine and cosine [B2013, Eq. 4]."""
    along = add(add(scale(v[0], axis[0]), scale(v[1], axis[1])), scale(v[2], axis[2]))
    across = (
        subtract(scale(v[2], axis[1]), scale(v[1], axis[2])),
        subtract(scale(v[0], axis[2]), scale(v[2], axis[0])),
        subtract(scale(v[1], axis[0]), scale(v[0], axis[1])),
    )
    rest = multiply(along, subtract(constant(1.0), cosine))
    return (
        add(add(multiply(v[0], cosine), multiply(across[0], sine)), scale(rest, axis[0])),
        add(add(multiply(v[1], cosine), multiply(across[1], sine)), scale(rest, axis[1])),
        add(add(multiply(v[2], cosine), multiply(across[2], sine)), scale(rest, axis[2])),
    )


@njit(cache=True, nogil=True, inline='always')
def compose(a: Jet, f: Jet) -> Jet:
    """Return the jet of a(f(t)), where ``a`` is a jet in its own parameter at the value f[0]."""
    return (
        a[0],
        a[1] * f[1],
        a[1] * f[2] + a[2] * f[1] * f[1],
        a[1] * f[3] + 2.0 * a[2] * f[1] * f[2] + a[3] * f[1] ** 3,
    )


@njit(cache=True, nogil=True, inline='always')
def by_arc_length(a: Jet, speed: Jet) -> Jet:
    """Convert a jet in u to (value, d/ds, d2/ds2, d3/ds3), where ``speed`` is the jet of ds/du."""
    v0, v1, v2 = speed[0], speed[1], speed[2]
    # The first derivative by s, with two more coefficients of its series in u.
    d0 = a[1] / v0
    d1 = (2.0 * a[2] - d0 * v1) / v0
    d2 = (3.0 * a[3] - d0 * v2 - d1 * v1) / v0
    e0 = d1 / v0
    e1 = (2.0 * d2 - e0 * v1) / v0
    return (a[0], d0, e0, e1 / v0)
