"""Faces of STEP files: surfaces against closed forms, and one line for what is not read."""

import json
import os
import signal

import numpy as np
import pytest
from tiers import few_of

from cnc_interp.cam.shapes import BSplineSurface, RationalSurface
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.cam.surface_file import read_part
from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import BAD_INPUT, FINE
from cnc_interp.core import DEG, INCH, MM

METRE = '(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT($,.METRE.))'
MILLIMETRE = METRE.replace('$', '.MILLI.')
RADIAN = '(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))'
QUARTER = np.array([[[1, 0, z], [1, 1, z], [0, 1, z]] for z in (0, 1, 3)], float).swapaxes(0, 1)
QUARTER_WEIGHTS = np.outer([1.0, np.sqrt(0.5), 1.0], np.ones(3))


class Part:
    """Writes a STEP file, lengths in the file's unit."""

    def __init__(self, unit=MILLIMETRE):
        self.lines, self.faces, self.places = [], [], {}
        self.unit(unit)

    def add(self, text):
        self.lines.append(f'#{len(self.lines) + 1}={text};')
        return f'#{len(self.lines)}'

    def unit(self, text):
        length, angle = self.add(text), self.add(RADIAN)
        self.context = self.add(
            '(GEOMETRIC_REPRESENTATION_CONTEXT(3)'
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle}))REPRESENTATION_CONTEXT('',''))"
        )

    def point(self, p, keyword='CARTESIAN_POINT'):
        return self.add(f"{keyword}('',{self.all(float(x) for x in p)})")

    def frame(self, origin=(0, 0, 0), z=(0, 0, 1), x=(1, 0, 0)):
        z, x = self.point(z, 'DIRECTION'), self.point(x, 'DIRECTION')
        return self.add(f"AXIS2_PLACEMENT_3D('',{self.point(origin)},{z},{x})")

    def vertex(self, p):
        vertex = self.add(f"VERTEX_POINT('',{self.point(p)})")
        self.places[vertex] = np.array(p, float)
        return vertex

    def edge(self, a, b, curve, sense='T', along='T'):
        edge = self.add(f"EDGE_CURVE('',{a},{b},{curve},.{sense}.)")
        return self.add(f"ORIENTED_EDGE('',*,*,{edge},.{along}.)")

    def line(self, a, b):
        start, end = self.places[a], self.places[b]
        along = self.point((end - start) / np.linalg.norm(end - start), 'DIRECTION')
        vector = self.add(f"VECTOR('',{along},1.)")
        return self.edge(a, b, self.add(f"LINE('',{self.point(start)},{vector})"))

    def circle(self, a, b, frame, radius, sense='T', along='T'):
        curve = self.add(f"CIRCLE('',{frame},{radius!r})")
        return self.edge(a, b, curve, sense, along)

    def bound(self, *edges, sense='T'):
        loop = self.add(f"EDGE_LOOP('',{self.all(edges)})")
        return self.add(f"FACE_OUTER_BOUND('',{loop},.{sense}.)")

    def polygon(self, points):
        ends = [self.vertex(p) for p in points]
        return self.bound(*(self.line(*pair) for pair in zip(ends, ends[1:] + ends[:1])))

    def border(self, knots, points, degree, weights=None):
        """Bound a whole spline patch by the splines along its border."""
        weights = np.ones(points.shape[:2]) if weights is None else weights
        ends = [self.vertex(p) for p in corners(points)]
        rows = [(0, np.s_[:, 0]), (1, np.s_[-1]), (0, np.s_[:, -1]), (1, np.s_[0])]
        edges = []
        for k, (axis, row) in enumerate(rows):
            curve = self.curve(knots[axis], points[row], degree[axis], weights[row])
            a, b = ends[k], ends[(k + 1) % 4]
            edges.append(self.edge(a, b, curve) if k < 2 else self.edge(b, a, curve, 'T', 'F'))
        return self.bound(*edges)

    def curve(self, knots, points, degree, weights):
        values, counts = np.unique(knots, return_counts=True)
        shape = f'{degree},{self.all(map(self.point, points))},.UNSPECIFIED.,.F.,.F.'
        tail = ','.join(self.all(map(repr, x.tolist())) for x in (counts, values))
        return self.add(
            f'(BOUNDED_CURVE()B_SPLINE_CURVE({shape})B_SPLINE_CURVE_WITH_KNOTS({tail},'
            '.UNSPECIFIED.)CURVE()GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_CURVE('
            f"{self.all(map(repr, weights.tolist()))})REPRESENTATION_ITEM(''))"
        )

    def face(self, surface, *bounds, sense='T'):
        face = self.add(f"ADVANCED_FACE('',{self.all(bounds)},{surface},.{sense}.)")
        self.faces.append(face)
        return face

    def spline(self, knots, points, degree, weights=None):
        net = self.all(self.all(self.point(p) for p in row) for row in points)
        values, counts = zip(*(np.unique(t, return_counts=True) for t in knots), strict=True)
        shape = f'{degree[0]},{degree[1]},{net},.UNSPECIFIED.,.F.,.F.,.U.'
        tail = ','.join(self.all(map(repr, x.tolist())) for x in (*counts, *values))
        if weights is None:
            return self.add(f"B_SPLINE_SURFACE_WITH_KNOTS('',{shape},{tail},.UNSPECIFIED.)")
        return self.add(
            f'(BOUNDED_SURFACE()B_SPLINE_SURFACE({shape})B_SPLINE_SURFACE_WITH_KNOTS({tail},'
            '.UNSPECIFIED.)GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_SURFACE('
            f'{self.all(self.all(map(repr, row.tolist())) for row in weights)})'
            "REPRESENTATION_ITEM('a;b'' /* #1 ')SURFACE())"
        )

    def product(self, shape):
        """Say that a representation is the shape of a product, as every CAD system does."""
        application = self.add("APPLICATION_CONTEXT('')")
        context = self.add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
        product = self.add(f"PRODUCT('part','part','',({context}))")
        version = self.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        stage = self.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
        definition = self.add(f"PRODUCT_DEFINITION('design','',{version},{stage})")
        part = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
        self.add(f'SHAPE_DEFINITION_REPRESENTATION({part},{shape})')

    @staticmethod
    def all(items):
        return f'({",".join(map(str, items))})'

    def write(self, path):
        shell = self.add(f"OPEN_SHELL('',{self.all(self.faces)})")
        model = self.add(f"SHELL_BASED_SURFACE_MODEL('',({shell}))")
        shape = self.add(f"MANIFOLD_SURFACE_SHAPE_REPRESENTATION('',({model}),{self.context})")
        self.product(shape)
        head = (
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
            "FILE_NAME('it''s; #1=PLANE(','',(''),(''),'','','');\n"
            "FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n"
        )
        body = '\n/* a comment; #1=PLANE( */ '.join(self.lines)
        path.write_text(f'{head}{body}\nENDSEC;\nEND-ISO-10303-21;\n')
        return path


def read_surface(path, number=None):
    """Read a face, about which there is nothing to note."""
    notes = []
    part = read_part(path, [] if number is None else [number], notes.append)
    assert notes == []
    (surface,) = part.surfaces.values()
    return surface


def wavy():
    """Knots with multiplicities, degrees 3 and 2, control points [mm]."""
    knots = np.array([0, 0, 0, 0, 0.3, 0.5, 0.5, 1, 1, 1, 1]), np.array([2, 2, 2, 3, 5, 5, 5.0])
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.linspace(-9, 9, 7), np.linspace(-6, 6, 4), indexing='ij')
    return knots, np.stack([x, y, rng.uniform(0, 1, x.shape)], axis=-1), (3, 2)


def corners(points):
    return [points[0, 0], points[-1, 0], points[-1, -1], points[0, -1]]


def assert_same(found, expected):
    assert found.domain == expected.domain
    u, v = expected.grid(15, 13)
    for name in ('position', 'd_u', 'd_v', 'normal', 'n_u', 'n_v'):
        a, b = getattr(found.at(u, v), name), getattr(expected.at(u, v), name)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * max(1.0, np.abs(b).max()))


@pytest.mark.thorough
@pytest.mark.parametrize('sense', ['T', 'F'])
@pytest.mark.parametrize('weights', [None, 1.0, 2.0])
def test_spline_face_is_the_spline(sense, weights, tmp_path):
    knots, points, degree = wavy()
    part = Part()
    given = None if weights is None else np.full(points.shape[:2], weights)
    surface = part.spline(knots, points, degree, given)
    part.face(surface, part.border(knots, points, degree), sense=sense)
    found = read_surface(part.write(tmp_path / 'a.STEP'))
    assert_same(found, BSplineSurface(knots, points * MM, degree, sense == 'F'))


@pytest.mark.thorough
def test_trimmed_spline_face_is_the_part_within_its_boundary(tmp_path):
    """A plane net: u and v are x and y, and the boundary is a triangle with a hole."""
    knots = np.array([-9, -9, -9, -9, 9, 9, 9, 9.0]), np.array([-6, -6, -6, -6, 6, 6, 6, 6.0])
    x, y = np.meshgrid(np.linspace(-9, 9, 4), np.linspace(-6, 6, 4), indexing='ij')
    points = np.stack([x, y, 0 * x], axis=-1)
    part = Part()
    triangle = part.polygon([(-8, -5, 0), (8, -5, 0), (0, 5, 0)])
    ends = part.vertex((1, -2, 0))
    hole = part.bound(part.circle(ends, ends, part.frame((0, -2, 0), (0, 0, -1)), 1.0))
    part.face(part.spline(knots, points, (3, 3)), triangle, hole.replace('OUTER_', ''))
    found = read_surface(part.write(tmp_path / 'a.stp'))
    np.testing.assert_allclose(found.domain, [[-8, 8], [-5, 5]], atol=1e-9)
    u, v = found.grid(81, 101)
    np.testing.assert_allclose(
        found.at(u, v).position / MM, np.stack([u, v, 0 * u], axis=-1), atol=1e-9
    )
    edge = 0.8 * (8 - np.abs(u)) / 0.8 * 10 / 8 - 5 - v
    away = np.minimum(edge, np.hypot(u, v + 2) - 1)
    sure = np.abs(away) > 0.01
    assert (found.contains(u, v) == (away > 0))[sure].all()


@pytest.mark.thorough
def test_rational_spline_is_a_cylinder(tmp_path):
    knots = (np.array([0, 0, 0, 1, 1, 1.0]),) * 2
    part = Part()
    surface = part.spline(knots, 20 * QUARTER, (2, 2), QUARTER_WEIGHTS)
    part.face(surface, part.border(knots, 20 * QUARTER, (2, 2), QUARTER_WEIGHTS))
    found = read_surface(part.write(tmp_path / 'a.step'))
    point = found.at(*found.grid(9, 9))
    radial = point.position * [1, 1, 0] / (20 * MM)
    np.testing.assert_allclose(np.linalg.norm(radial, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(point.normal, radial, atol=1e-12)
    low, high = point.principal_curvatures()
    np.testing.assert_allclose(low, 0.0, atol=1e-9)
    np.testing.assert_allclose(high, 50.0, atol=1e-9)
    assert_same(found, RationalSurface(knots, 20 * MM * QUARTER, QUARTER_WEIGHTS, (2, 2)))


@pytest.mark.thorough
def test_straight_direction_of_degree_1_is_raised(tmp_path):
    knots, points, _ = wavy()
    straight = points[:, [0, 3]]
    part = Part()
    both = knots[0], np.array([0, 0, 2, 2.0])
    part.face(part.spline(both, straight, (3, 1)), part.border(both, straight, (3, 1)))
    found = read_surface(part.write(tmp_path / 'a.step'))
    u, v = found.grid(9, 9)
    line = BSplineSurface(
        (knots[0], np.array([0, 0, 0, 2, 2, 2.0])),
        MM * np.stack([straight[:, 0], straight.mean(axis=1), straight[:, 1]], axis=1),
        (3, 2),
    )
    assert_same(found, line)
    middle = 0.5 * (found.at(u[:, :1], v[:, :1]).position + found.at(u[:, :1], v[:, -1:]).position)
    np.testing.assert_allclose(found.at(u, v).position[:, 4:5], middle, atol=1e-15)


def inch(part):
    millimetre = part.add(MILLIMETRE)
    measure = part.add(f'LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),{millimetre})')
    return f"(CONVERSION_BASED_UNIT('INCH',{measure})LENGTH_UNIT()NAMED_UNIT($))"


@pytest.mark.thorough
@pytest.mark.parametrize(('name', 'length'), [('mm', MM), ('m', 1.0), ('inch', INCH)])
def test_units_are_those_of_the_file(name, length, tmp_path):
    part = Part(METRE if name == 'm' else MILLIMETRE)
    if name == 'inch':
        part.lines = []
        part.unit(inch(part))
    surface = part.add(f"PLANE('',{part.frame((1, 2, 3))})")
    part.face(surface, part.polygon([(0, 0, 3), (2, 0, 3), (2, 4, 3), (0, 4, 3)]))
    found = read_surface(part.write(tmp_path / 'a.step'))
    np.testing.assert_allclose(found.domain, np.array([[-1, 1], [-2, 2]]) * length, atol=1e-15)
    place = found.at(*found.grid(2, 2)).position[1, 0]
    np.testing.assert_allclose(place, np.array([2, 0, 3]) * length, atol=1e-15)


AXES = np.array([[0.0, 0.6, 0.8], [0.0, -0.8, 0.6], [1.0, 0.0, 0.0]])
ORIGIN = np.array([3.0, -4.0, 5.0])


def rounded(u, v, ring, radius):
    """The torus of the standard about AXES[2]; a sphere where ring is 0 [mm]."""
    x, y, z = AXES
    out = np.multiply.outer(np.cos(u), x) + np.multiply.outer(np.sin(u), y)
    far = (ring + radius * np.cos(v))[..., None]
    return ORIGIN + far * out + radius * np.multiply.outer(np.sin(v), z)


def rounded_face(kind, u, v, sense):
    """A face between lines of constant parameter; a cylinder has v as a length."""
    part = Part()
    frame = part.frame(ORIGIN, AXES[2], AXES[0])
    ring, radius = {'CYLINDRICAL': (0.0, 20.0), 'SPHERICAL': (0.0, 20.0)}.get(kind, (30.0, 20.0))

    def at(a, b):
        if kind == 'CYLINDRICAL':
            return rounded(np.array(a), np.array(0.0), 0.0, radius) + b * AXES[2]
        return rounded(np.array(a), np.array(b), ring, radius)

    ends = [
        part.vertex(at(a, b)) for a, b in ((u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1]))
    ]
    edges = []
    for k, b in ((0, v[0]), (2, v[1])):
        far, height = (
            (radius, b)
            if kind == 'CYLINDRICAL'
            else (ring + radius * np.cos(b), radius * np.sin(b))
        )
        circle = part.frame(ORIGIN + height * AXES[2], AXES[2], AXES[1])
        # The second edge of each kind is written from its end, as where another face uses it.
        order = (ends[0], ends[1], 'T', 'T') if k == 0 else (ends[3], ends[2], 'T', 'F')
        edges.append(part.circle(*order[:2], circle, float(far), *order[2:]))
        a = u[1 - k // 2]
        if kind == 'CYLINDRICAL':
            edges.append(part.line(ends[k + 1], ends[(k + 2) % 4]))
            continue
        out = np.cos(a) * AXES[0] + np.sin(a) * AXES[1]
        meridian = part.frame(ORIGIN + ring * out, np.cross(out, AXES[2]), out)
        order = (ends[1], ends[2], 'T', 'T') if k == 0 else (ends[0], ends[3], 'T', 'F')
        edges.append(part.circle(*order[:2], meridian, radius, *order[2:]))
    numbers = f'{ring!r},{radius!r}' if ring else f'{radius!r}'
    part.face(
        part.add(f"{kind}_SURFACE('',{frame},{numbers})"),
        part.bound(*edges, sense=sense),
        sense=sense,
    )
    return part


@pytest.mark.thorough
@pytest.mark.parametrize('sense', ['T', 'F'])
@pytest.mark.parametrize(
    ('kind', 'u', 'v'),
    [
        ('CYLINDRICAL', (-20 * DEG, 65 * DEG), (-3.0, 12.0)),
        ('CYLINDRICAL', (100 * DEG, 310 * DEG), (1.0, 2.0)),
        ('SPHERICAL', (150 * DEG, 230 * DEG), (-10 * DEG, 50 * DEG)),
        ('TOROIDAL', (10 * DEG, 80 * DEG), (-30 * DEG, 40 * DEG)),
        ('TOROIDAL', (160 * DEG, 250 * DEG), (120 * DEG, 220 * DEG)),
    ],
)
def test_round_faces_are_those_of_the_standard(kind, u, v, sense, tmp_path):
    part = rounded_face(kind, u, v, sense)
    found = read_surface(part.write(tmp_path / 'a.step'))
    first, second = found.grid(11, 9)
    turns = np.round((first[0, 0] - u[0]) / (2 * np.pi)) * 2 * np.pi
    around = np.round((second[0, 0] - v[0]) / (2 * np.pi)) * 2 * np.pi
    along = MM if kind == 'CYLINDRICAL' else 1.0
    np.testing.assert_allclose(first[[0, -1], 0] - turns, u, atol=1e-12)
    np.testing.assert_allclose(second[0, [0, -1]] - around, np.array(v) * along, atol=1e-12)
    point = found.at(first, second)
    if kind == 'CYLINDRICAL':
        expected = rounded(first, 0 * first, 0.0, 20.0) + np.multiply.outer(second / MM, AXES[2])
        centre = ORIGIN + np.multiply.outer(second / MM, AXES[2])
    else:
        ring = 30.0 if kind == 'TOROIDAL' else 0.0
        expected = rounded(first, second, ring, 20.0)
        centre = rounded(first, 0 * first, ring, 0.0)
    np.testing.assert_allclose(point.position, expected * MM, atol=1e-12)
    outward = (expected - centre) / 20.0 * (1 if sense == 'T' else -1)
    np.testing.assert_allclose(point.normal, outward, atol=1e-12)


@pytest.mark.thorough
def test_disc_is_round(tmp_path):
    part = Part()
    frame = part.frame((5, 0, 1), (0, 0, -1), (0.6, 0.8, 0))
    end = part.vertex((5 - 7 * 0.28, 7 * 0.96, 1))
    loop = part.bound(part.circle(end, end, part.frame((5, 0, 1)), 7.0))
    part.face(part.add(f"PLANE('',{frame})"), loop)
    found = read_surface(part.write(tmp_path / 'a.step'))
    np.testing.assert_allclose(found.domain, [[-7 * MM, 7 * MM]] * 2, atol=2e-6)
    u, v = found.grid(101, 101, 1 * MM)
    away = 7 * MM - np.hypot(u, v)
    sure = np.abs(away) > 3e-6
    assert (found.contains(u, v) == (away > 0.0))[sure].all()
    np.testing.assert_allclose(found.at(*found.grid(2, 2)).normal[..., 2], -1.0)


SQUARE = [(0, 0, 0), (8, 0, 0), (8, 6, 0), (0, 6, 0), (0, 0, 0)]


@pytest.mark.thorough
@pytest.mark.parametrize('form', ['plain', 'trimmed', 'rational'])
@pytest.mark.parametrize(('sense', 'highest'), [('T', 0.0), ('F', 6.0)])
def test_spline_edges_run_with_or_against_their_curve(form, sense, highest, tmp_path):
    """From (0, 0) to (8, 0) along the first side of a closed curve, or the long way round."""
    part = Part()
    knots, weights = np.array([0, 0, 1, 2, 3, 4, 4.0]), np.ones(5)
    if form == 'rational':
        weights = np.array([1.0, 0.5, 1.0, 0.7, 1.0])
    curve = part.curve(knots, np.array(SQUARE, float), 1, weights)
    if form == 'trimmed':
        ends = '(PARAMETER_VALUE(0.)),(PARAMETER_VALUE(4.))'
        curve = part.add(f"TRIMMED_CURVE('',{curve},{ends},.T.,.PARAMETER.)")
    ends = [part.vertex(p) for p in ((0, 0, 0), (8, 0, 0), (4, -2, 0))]
    edges = [part.edge(*ends[:2], curve, sense), part.line(*ends[1:]), part.line(ends[2], ends[0])]
    part.face(part.add(f"PLANE('',{part.frame()})"), part.bound(*edges))
    found = read_surface(part.write(tmp_path / 'a.step'))
    np.testing.assert_allclose(found.domain, np.array([[0, 8], [-2, highest]]) * MM, atol=1e-15)


def border_about_z(part, low, high):
    """Bound a face about z from z = 0 to 6 mm, u from -0.4 to 0.7, by its radii there."""
    ends = [
        part.vertex((r * np.cos(u), r * np.sin(u), z))
        for u, r, z in ((-0.4, low, 0), (0.7, low, 0), (0.7, high, 6), (-0.4, high, 6))
    ]
    below, above = (part.frame((0, 0, z)) for z in (0, 6))
    return part.bound(
        part.circle(ends[0], ends[1], below, low),
        part.line(ends[1], ends[2]),
        part.circle(ends[3], ends[2], above, high, 'T', 'F'),
        part.line(ends[3], ends[0]),
    )


def cone(part):
    angle = float(np.arctan(0.5))
    surface = part.add(f"CONICAL_SURFACE('',{part.frame()},10.,{angle!r})")
    part.face(surface, border_about_z(part, 10.0, 13.0))


def extruded_circle(part):
    vector = part.add(f"VECTOR('',{part.point((0, 0, 1), 'DIRECTION')},1.)")
    circle = part.add(f"CIRCLE('',{part.frame()},10.)")
    surface = part.add(f"SURFACE_OF_LINEAR_EXTRUSION('',{circle},{vector})")
    part.face(surface, border_about_z(part, 10.0, 10.0))


def turned_line(part):
    vector = part.add(f"VECTOR('',{part.point((0.5, 0, 1), 'DIRECTION')},1.)")
    line = part.add(f"LINE('',{part.point((10, 0, 0))},{vector})")
    z = part.point((0, 0, 1), 'DIRECTION')
    axis = part.add(f"AXIS1_PLACEMENT('',{part.point((0, 0, 0))},{z})")
    surface = part.add(f"SURFACE_OF_REVOLUTION('',{line},{axis})")
    part.face(surface, border_about_z(part, 10.0, 13.0))


@pytest.mark.thorough
@pytest.mark.parametrize('make', few_of(3, (cone, extruded_circle, turned_line)))
def test_other_surfaces_become_exact_rational_patches(make, tmp_path):
    part = Part()
    make(part)
    found = read_surface(part.write(tmp_path / 'a.step'))
    point = found.at(*found.grid(11, 9))
    x, y, z = np.moveaxis(point.position / MM, -1, 0)
    slope = 0.0 if make is extruded_circle else 0.5
    radius = 10.0 + slope * z
    np.testing.assert_allclose(np.hypot(x, y), radius, atol=1e-11)
    normal = np.stack([x / radius, y / radius, np.full_like(z, -slope)], axis=-1)
    normal /= np.hypot(1.0, slope)
    np.testing.assert_allclose(point.normal, normal, atol=1e-12)
    low, high = point.principal_curvatures()
    np.testing.assert_allclose(low, 0.0, atol=1e-7)
    np.testing.assert_allclose(high, 1.0 / (np.hypot(1.0, slope) * radius * MM), rtol=1e-9)
    turn = np.arctan2(y, x)
    np.testing.assert_allclose([turn.min(), turn.max()], [-0.4, 0.7], atol=1e-11)
    np.testing.assert_allclose([z.min(), z.max()], [0.0, 6.0], atol=1e-11)


def two_faces():
    part = Part()
    points = [(0, 0, 0), (30, 0, 0), (30, 20, 0), (0, 20, 0)]
    part.face(part.add(f"PLANE('',{part.frame()})"), part.polygon(points))
    knots, net, degree = wavy()
    part.face(part.spline(knots, net, degree), part.border(knots, net, degree))
    offset_plane(part)
    return part


@pytest.mark.thorough
def test_several_faces_are_listed(tmp_path):
    path = two_faces().write(tmp_path / 'a.step')
    with pytest.raises(SurfaceError, match='choose one of 3 faces with --face N') as listed:
        read_surface(path)
    _, *lines = str(listed.value).splitlines()
    assert lines[0].split() == ['1', 'plane,', '30', 'x', '20', 'mm']
    assert '2  B-spline, 18.' in lines[1]
    assert 'offset surface, cannot be used: ' in lines[2]
    assert_same(read_surface(path, 2), BSplineSurface(wavy()[0], wavy()[1] * MM, (3, 2)))
    for number in (0, 4):
        with pytest.raises(SurfaceError, match=f'no face {number}; .* from 1 to 3'):
            read_surface(path, number)


def changed(old, new):
    def change(text):
        assert old in text
        return text.replace(old, new)

    return change


@pytest.mark.thorough
@pytest.mark.parametrize(
    ('change', 'says'),
    [
        (lambda text: text[:-60], 'is not a complete STEP file'),
        (lambda text: text[: text.index("FILE_NAME('it") + 14], 'is not a complete STEP file'),
        (lambda text: '{"kind": "plane"}', 'is not a complete STEP file'),
        (changed('LENGTH_UNIT', 'MASS_UNIT'), 'has no unit of length (LENGTH_UNIT)'),
        (changed('SHAPE_DEFINITION_REPRESENTATION', 'OTHER'), 'holds no shape of a product'),
        (changed('ADVANCED_FACE', 'OTHER_FACE'), 'OpenShell: '),
        (changed('(4,1,2,4)', '(4,1,2,3)'), 'BSplineSurfaceWithKnots: Surface has not been'),
        (changed("'',3,2,((#", "'',3,1,((#"), 'BSplineSurfaceWithKnots: Surface has not been'),
        (changed("'',3,2,((#4,", "'',3,2,((#99999,"), 'BSplineSurfaceWithKnots: '),
        (changed("'',3,2,((#4,", "'',3,2,((#1,"), 'BSplineSurfaceWithKnots: '),
        (changed("CARTESIAN_POINT('',(-9.0,", "CARTESIAN_POINT('',(-9.0e999,"), 'not finite'),
        (changed("CARTESIAN_POINT('',(-9.0,", "CARTESIAN_POINT('',(&,"), 'CartesianPoint: '),
        (changed("CARTESIAN_POINT('',(-9.0,", "CARTESIAN_POINT('',("), 'has not been created'),
        (changed("#4=CARTESIAN_POINT('',", f"#4=CARTESIAN_POINT('',{'(' * 5000}"), 'is not a c'),
        (changed('EDGE_LOOP', 'VERTEX_LOOP'), 'VertexLoop: '),
    ],
)
def test_wrong_files_get_one_line(change, says, tmp_path, capsys):
    knots, points, degree = wavy()
    part = Part()
    part.face(part.spline(knots, points, degree), part.border(knots, points, degree))
    path = part.write(tmp_path / 'a.step')
    path.write_text(change(path.read_text()))
    assert main(['cam', 'iso-scallop', str(path), '--out', str(tmp_path / 'out')]) == BAD_INPUT
    error = capsys.readouterr().err
    assert says in error and error.count('\n') == 1
    assert str(path) in error or says == 'not finite'


def line_as_a_face(part):
    part.face(part.add(f"PLANE('',{part.frame()})"), part.polygon(SQUARE[:2]))


def offset_plane(part):
    plane = part.add(f"PLANE('',{part.frame()})")
    raised = [(x, y, 1) for x, y, _ in SQUARE[:4]]
    part.face(part.add(f"OFFSET_SURFACE('',{plane},1.,.F.)"), part.polygon(raised))


def whole_cylinder(part):
    end = part.vertex((5, 0, 0)), part.vertex((5, 0, 9))
    circles = [
        part.circle(e, e, part.frame((0, 0, z)), 5.0, 'T', s)
        for e, z, s in ((end[0], 0, 'T'), (end[1], 9, 'F'))
    ]
    loop = part.bound(circles[0], part.line(*end), circles[1], part.line(*end[::-1]))
    part.face(part.add(f"CYLINDRICAL_SURFACE('',{part.frame()},5.)"), loop)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ('make', 'says'),
    [
        (offset_plane, 'offset surface is not supported'),
        (line_as_a_face, 'no width in u or v'),
        (whole_cylinder, 'is closed around its axis'),
        (
            lambda part: part.face(part.add(f"SPHERICAL_SURFACE('',{part.frame()},5.)")),
            'is closed around its axis',
        ),
    ],
)
def test_faces_that_cannot_be_used_are_named(make, says, tmp_path):
    part = Part()
    make(part)
    with pytest.raises(SurfaceError, match=says) as fault:
        read_surface(part.write(tmp_path / 'a.step'))
    assert str(fault.value).startswith(str(tmp_path / 'a.step: face 1: '))


@pytest.mark.thorough
def test_oblique_cut_of_a_cylinder_spans_its_highest_and_lowest_point(tmp_path):
    part = Part()
    ends = [part.vertex(p) for p in ((5, 0, 0), (0, 5, 0), (0, 5, 8), (5, 0, 3))]
    size = np.hypot(5.0, 5.0)  # the plane z = 3 + y
    ellipse = part.add(
        f"ELLIPSE('',{part.frame((0, 0, 3), (0, -1, 1), (0, 1, 1))},{float(size)!r},5.)"
    )
    edges = [
        part.circle(*ends[:2], part.frame(), 5.0),
        part.line(*ends[1:3]),
        part.edge(ends[3], ends[2], ellipse, 'T', 'F'),
        part.line(ends[3], ends[0]),
    ]
    part.face(part.add(f"CYLINDRICAL_SURFACE('',{part.frame()},5.)"), part.bound(*edges))
    found = read_surface(part.write(tmp_path / 'a.step'))
    np.testing.assert_allclose(found.domain, [[0, 0.5 * np.pi], [0, 8 * MM]], atol=1e-7)
    inside = found.contains(*found.grid(201, 201))
    assert 0.2 < inside.mean() < 0.9


def test_missing_library_is_named_with_what_to_install(monkeypatch, tmp_path):
    (tmp_path / 'OCP.py').write_text('')  # a module without what is needed
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    path = two_faces().write(tmp_path / 'a.step')
    with pytest.raises(SurfaceError, match='pip install cadquery-ocp-novtk'):
        read_surface(path, 1)


@pytest.mark.thorough
def test_nothing_is_imported_from_the_folder_of_the_user(monkeypatch, tmp_path):
    (tmp_path / 'OCP.py').write_text('raise SystemExit(3)\n')
    monkeypatch.chdir(tmp_path)
    assert read_surface(two_faces().write(tmp_path / 'a.step'), 1) is not None


@pytest.mark.parametrize(
    ('end', 'says'),
    [
        (signal.SIGSEGV, 'it ended by SIGSEGV'),
        pytest.param(
            signal.SIGXCPU,
            'reading it takes too long for a file of its size',
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_a_reader_that_dies_is_one_line(end, says, monkeypatch, tmp_path):
    (tmp_path / 'OCP.py').write_text(f'import os\nos.kill(os.getpid(), {int(end)})\n')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    with pytest.raises(SurfaceError, match=says) as fault:
        read_surface(two_faces().write(tmp_path / 'a.step'), 1)
    assert '\n' not in str(fault.value)


@pytest.mark.thorough
def test_time_and_memory_of_a_file_are_limited(monkeypatch, tmp_path):
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    path = two_faces().write(tmp_path / 'a.step')
    (tmp_path / 'OCP.py').write_text('kept = [bytes(1 << 20) for _ in range(1 << 13)]\n')
    with pytest.raises(SurfaceError, match='more than a file of this size can contain'):
        read_surface(path, 1)
    (tmp_path / 'OCP.py').write_text('while True:\n    pass\n')
    with pytest.raises(SurfaceError, match='reading it takes too long for a file of its size'):
        read_surface(path, 1)


@pytest.mark.parametrize('kinds', few_of(2, [[], ['step', 'json']]))
def test_face_makes_the_program_of_the_same_surface_in_json(kinds, tmp_path, capsys):
    knots, points, degree = wavy()
    points = points[:, ::-1] * [1.0, 1.0, 0.1]
    part = Part()
    part.face(part.spline(knots, points, degree), part.border(knots, points, degree), sense='F')
    files = {'step': part.write(tmp_path / 'a.step'), 'json': tmp_path / 'a.json'}
    files['json'].write_text(
        json.dumps(
            {
                'kind': 'bspline',
                'knots_u': knots[0].tolist(),
                'knots_v': knots[1].tolist(),
                'points_mm': points.tolist(),
                'degree': degree,
                'flip': True,
            }
        )
    )
    options = ['--stepover', '4', '--json']
    assert_same(*map(read_surface, files.values()))
    for kind in kinds:
        command = ['cam', 'iso-scallop', str(files[kind]), *options, '--out', str(tmp_path / kind)]
        assert main(command) == FINE, capsys.readouterr().err
    programs = [(tmp_path / kind / 'program.mpf').read_text() for kind in kinds]
    assert len(set(programs)) <= 1 and all(text.count('BSPLINE') > 1 for text in programs)
    command = ['cam', 'iso-scallop', str(files['json']), '--face', '1', '--out', str(tmp_path)]
    capsys.readouterr()
    assert main(command) == BAD_INPUT
    assert '--face is for STEP files' in capsys.readouterr().err


def step_of_two_planes():
    """A floor of 24 x 16 mm, a wall on its far side, and a terrace above the wall."""
    part = Part()
    for origin, z, x, size in (
        ((0, 0, 0), (0, 0, 1), (1, 0, 0), (24, 16)),
        ((24, 0, 0), (-1, 0, 0), (0, 1, 0), (16, 6)),
        ((24, 0, 6), (0, 0, 1), (1, 0, 0), (12, 16)),
    ):
        y = np.cross(z, x)
        corners = [
            np.array(origin) + a * np.array(x) + b * y
            for a, b in ((0, 0), (size[0], 0), size, (0, size[1]))
        ]
        if z == (-1, 0, 0):
            corners = [p * [1, 1, -1] for p in corners]
        part.face(part.add(f"PLANE('',{part.frame(origin, z, x)})"), part.polygon(corners))
    return part


@pytest.mark.thorough
def test_several_faces_in_one_program_spare_each_other(tmp_path, capsys):
    file = str(step_of_two_planes().write(tmp_path / 'a.step'))
    said = {}
    for name, more in (('spared', ()), ('ignored', ('--ignore-neighbours',))):
        command = ['cam', 'iso-scallop', file, '--face', '1', '3', '--stepover', '2.5', '--json']
        options = ['--simulate', '--spacing', '0.3', '--out', str(tmp_path / name), *more]
        assert main([*command, *options]) == FINE, capsys.readouterr().err
        out, err = capsys.readouterr()
        said[name] = json.loads(out), err
    floor, terrace = said['spared'][0]['faces']
    assert (floor['face'], terrace['face']) == (1, 3)
    assert 'face 1: ' in said['spared'][1] and 'would enter other faces' in said['spared'][1]
    assert floor['milled_length'] < said['ignored'][0]['faces'][0]['milled_length'] - 8 * MM
    assert terrace['programmed']['highest'] < 10.3e-6 and terrace['programmed']['uncut'] == 0.0
    command = ['cam', 'simulate', str(tmp_path / 'spared' / 'program.mpf'), '--surface', file]
    lowest = {}
    for name in said:
        command[2] = str(tmp_path / name / 'program.mpf')
        code = main([*command, '--face', '2', '--margin', '0.2', '--spacing', '0.2', '--json'])
        out, err = capsys.readouterr()
        assert code == FINE or 'does not cut' in err  # the wall may be out of reach altogether
        lowest[name] = json.loads(out)['programmed']['lowest'] if code == FINE else 1.0
    assert lowest['spared'] > -12e-6 and lowest['ignored'] < -0.3 * MM


@pytest.mark.thorough
@pytest.mark.parametrize(
    ('words', 'says'),
    [
        (['--face', '1', '1'], 'face 1 is named twice'),
        (['--face', '1', '4'], 'there is no face 4; the faces are numbered from 1 to 3'),
        (['--face', '1', '3', '--corner-radius', '6.5'], 'face 1: the strip of a ball mill'),
    ],
)
def test_choices_of_faces_that_do_not_fit_get_one_line(words, says, tmp_path, capsys):
    file = str(step_of_two_planes().write(tmp_path / 'a.step'))
    command = ['cam', 'iso-scallop', file, *words, '--stepover', '2.5', '--out', str(tmp_path)]
    assert main(command) == BAD_INPUT
    error = capsys.readouterr().err
    (line,) = [x for x in error.splitlines() if not x.startswith('passes')]
    assert says in line
