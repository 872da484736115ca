"""B-splines and NURBS: knot insertion, Bézier segments, surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import GeometryError, NetError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.projective import affine
from mitsuba_bezier.geometry.spline_surfaces import BSplineSurface
from mitsuba_bezier.geometry.splines import BSplineCurve, basis_functions, uniform_knots

# A few roundings of combinations of points of size 1
EXACT = 1e-12


def curve(seed: int, degree: int = 3, clamped: bool = True) -> BSplineCurve:
    rng = np.random.default_rng([seed, degree])
    m = degree + 1 + seed
    inner = np.sort(rng.uniform(0, 1, m - degree - 1))
    if seed > 2:
        inner[1] = inner[0]  # a double knot
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    if not clamped:
        knots = np.sort(rng.uniform(0, 1, m + degree + 1))
    net = np.concatenate([rng.normal(size=(m, 3)), rng.uniform(0.5, 2, (m, 1))], axis=1)
    return BSplineCurve(net, knots, degree)


CASES = [
    (seed, degree, clamped)
    for seed in (0, 1, 4)
    for degree in (1, 2, 3, 5)
    for clamped in (True, False)
    if not (seed > 2 and degree == 1)
]
cases = pytest.mark.parametrize(("seed", "degree", "clamped"), CASES)


def inside(c: BSplineCurve, count: int = 25) -> np.ndarray:
    return np.linspace(*c.domain, count)


@cases
def test_basis_functions(seed, degree, clamped):
    c = curve(seed, degree, clamped)
    t = inside(c)
    n = basis_functions(c.knots, degree, t)
    assert n.shape == (25, len(c.control_points))
    assert n.min() > -1e-15
    np.testing.assert_allclose(n.sum(axis=1), 1, rtol=1e-13)
    assert ((n != 0).sum(axis=1) <= degree + 1).all()
    for s in t:  # de Boor's scheme says the same
        np.testing.assert_allclose(c.de_boor(s)[-1][0], c.evaluate(s), atol=EXACT)
        np.testing.assert_allclose(c.blossom([s] * degree, s), c.evaluate(s), atol=EXACT)


@cases
def test_knot_insertion_keeps_the_curve(seed, degree, clamped):
    c = curve(seed, degree, clamped)
    t = inside(c)
    more = c
    for s in (0.31, 0.62, 0.62)[: 3 if degree > 1 else 2]:
        a, b = c.domain
        more = more.insert_knot(a + s * (b - a))
    assert len(more.control_points) == len(c.control_points) + (3 if degree > 1 else 2)
    np.testing.assert_allclose(more.evaluate(t), c.evaluate(t), atol=EXACT)


@cases
def test_bezier_segments_are_the_curve(seed, degree, clamped):
    c = curve(seed, degree, clamped)
    knots = np.unique(c.knots)
    knots = knots[(knots >= c.domain[0]) & (knots <= c.domain[1])]
    pieces = c.to_bezier()
    assert len(pieces) == len(knots) - 1
    s = np.linspace(0, 1, 11)
    for piece, a, b in zip(pieces, knots[:-1], knots[1:]):
        np.testing.assert_allclose(piece.evaluate(s), c.evaluate(a + s * (b - a)), atol=EXACT)
        assert piece.degree == degree
    # the same by inserting knots up to n times (Boehm): Bézier points in a row
    if clamped:
        full = c
        for k in knots[1:-1]:
            missing = degree - int((c.knots == k).sum())
            full = full.insert_knot(k, missing) if missing else full
        joined = np.concatenate(
            [p.control_points[: -1 if p is not pieces[-1] else None] for p in pieces]
        )
        np.testing.assert_allclose(full.control_points, joined, atol=EXACT)


def test_a_circle_is_a_nurbs_curve():
    r = np.sqrt(0.5)
    x = [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]]
    w = [1, r, 1, r, 1, r, 1, r, 1]
    circle = BSplineCurve.from_points(x, w, [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4], 2)
    t = np.linspace(0, 4, 33)
    np.testing.assert_allclose(np.linalg.norm(circle.points(t), axis=1), 1, rtol=1e-14)
    assert [p.degree for p in circle.to_bezier()] == [2] * 4
    # a collineation and a projection act on control points
    m = np.array([[2, 1, 0], [0, 1, 1], [0.1, 0.2, 1]])
    np.testing.assert_allclose(circle.transform(m).evaluate(t), circle.evaluate(t) @ m.T)


def test_clamped_knots_by_default():
    c = BSplineCurve.from_points([[0, 0], [1, 2], [3, 2], [4, 0], [5, 1]])
    assert c.knots.tolist() == [0, 0, 0, 0, 0.5, 1, 1, 1, 1]
    np.testing.assert_allclose(c.points([0.0, 1.0]), [[0, 0], [5, 1]])
    assert uniform_knots(4, 3).tolist() == [0] * 4 + [1] * 4
    # twice continuous at the knot: the second differences of Bézier segments agree
    a, b = (p.control_points for p in c.to_bezier())
    np.testing.assert_allclose(np.diff(a, 2, axis=0)[-1], np.diff(b, 2, axis=0)[0], atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_surfaces(seed):
    rng = np.random.default_rng(seed)
    net = np.concatenate([rng.normal(size=(6, 5, 3)), rng.uniform(0.5, 2, (6, 5, 1))], axis=-1)
    knots = ([0, 0, 0, 0, 0.3, 0.7, 1, 1, 1, 1], [0, 0, 0, 0.4, 0.4, 1, 1, 1])
    s = BSplineSurface(net, knots, (3, 2))
    st = rng.uniform(0, 1, (30, 2))
    # by curves of curves
    for a, b in st[:5]:
        across = [BSplineCurve(row, knots[1], 2).evaluate(b) for row in net]
        np.testing.assert_allclose(
            BSplineCurve(across, knots[0], 3).evaluate(a), s.evaluate([a, b]), atol=EXACT
        )
    for more in (s.insert_knot(0.5, 0), s.insert_knot(0.6, 1, 2), s.insert_knot(0.3, 0)):
        np.testing.assert_allclose(more.evaluate(st), s.evaluate(st), atol=EXACT)
    nets = s.to_bezier()
    assert nets.shape == (3, 2, 4, 3, 4)
    triangles = s.to_triangles()
    assert len(triangles) == 12 and triangles.degree == 5
    cuts = [np.array([0, 0.3, 0.7, 1]), np.array([0, 0.4, 1])]
    for i, j in np.ndindex(3, 2):
        uv = rng.dirichlet([1, 1, 1], 8)[:, :2]
        size = [cuts[0][i + 1] - cuts[0][i], cuts[1][j + 1] - cuts[1][j]]
        at = [cuts[0][i], cuts[1][j]] + uv * size
        own = affine(triangles.evaluate(2 * (2 * i + j), uv))
        np.testing.assert_allclose(own, s.points(at), atol=1e-11)


def test_a_surface_of_revolution_is_exact():
    r = np.sqrt(0.5)
    ring = np.array([[1, 0, 1], [1, 1, r], [0, 1, 1], [-1, 1, r], [-1, 0, 1],
                     [-1, -1, r], [0, -1, 1], [1, -1, r], [1, 0, 1]])  # fmt: skip
    heights = [(1, -1), (1, 1)]
    x = [[[R * x, R * y, z] for R, z in heights] for x, y, _w in ring]
    w = [[c[2]] * 2 for c in ring]
    knots = [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4], [0, 0, 1, 1]
    cylinder = BSplineSurface.from_points(x, w, knots, (2, 1))
    assert np.isclose(cylinder.to_triangles().area().sum(), 4 * np.pi, rtol=1e-9)


# ---------------------------------------------------------------- Bernstein polynomials


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7])
def test_bernstein_polynomials(n):
    rng = np.random.default_rng(n)
    t, uvw = rng.uniform(0, 1, 20), rng.dirichlet([1, 1, 1], 20)
    one, three = bernstein.univariate(n, t), bernstein.trivariate(n, uvw)
    assert one.shape == (20, n + 1) and three.shape == (20, (n + 1) * (n + 2) // 2)
    for b in (one, three):
        assert b.min() >= 0
        np.testing.assert_allclose(b.sum(axis=-1), 1, rtol=1e-13)
    np.testing.assert_allclose(three, bernstein.trivariate(n, uvw[:, :2]), atol=1e-14)
    # on an edge those of three variables are those of one
    edge = bernstein.trivariate(n, np.stack([1 - t, t, 0 * t], axis=-1))
    rows = [bernstein.row(n, n - k, k) for k in range(n + 1)]
    np.testing.assert_allclose(edge[:, rows], one, atol=1e-15)
    # the recursion that de Casteljau's algorithm is
    if n:
        low = bernstein.univariate(n - 1, t)
        up = np.zeros_like(one)
        up[:, :-1] += (1 - t[:, None]) * low
        up[:, 1:] += t[:, None] * low
        np.testing.assert_allclose(one, up, atol=1e-15)
    # homogeneous of degree n in three variables
    np.testing.assert_allclose(bernstein.trivariate(n, 2 * uvw), 2.0**n * three, rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_de_casteljau_over_the_triangle(n):
    from mitsuba_bezier import BezierTriangles

    rng = np.random.default_rng(n)
    patch = BezierTriangles(rng.normal(size=(2, bernstein.size(n), 4)))
    uv = rng.uniform(-0.5, 1.5, (7, 2))  # also outside of the triangle
    for at in uv:
        scheme = patch.de_casteljau(1, at)
        assert [len(level) for level in scheme] == [bernstein.size(k) for k in range(n, -1, -1)]
        np.testing.assert_allclose(scheme[-1][0], patch.evaluate(1, [at])[0], atol=1e-11)
        np.testing.assert_allclose(patch.blossom(1, *[at] * n), scheme[-1][0], atol=1e-11)
        # the last three points span the tangent plane
        value, du, dv = patch.partials(1, [at], order=1)
        rows = np.vstack([scheme[-2], value, du, dv])
        assert np.linalg.svd(rows / np.linalg.norm(rows, axis=1)[:, None])[1][3] < 1e-9
    # symmetric, affine in each argument, and control points at the corners
    arguments = rng.dirichlet([1, 1, 1], n)
    for _ in range(3):
        np.testing.assert_allclose(
            patch.blossom(0, *rng.permutation(arguments)), patch.blossom(0, *arguments), atol=EXACT
        )
    corners = np.eye(3)
    for row, ijk in enumerate(bernstein.multi_indices(n)):
        chosen = np.repeat(corners, ijk, axis=0)
        np.testing.assert_allclose(
            patch.blossom(0, *chosen), patch.control_points[0, row], atol=1e-15
        )
    # the net over another triangle is its blossom at that one's corners
    other = rng.dirichlet([1, 1, 1], 3)
    part = patch.subtriangle(other).control_points[1]
    for row, ijk in enumerate(bernstein.multi_indices(n)):
        chosen = np.repeat(other, ijk, axis=0)
        np.testing.assert_allclose(patch.blossom(1, *chosen), part[row], atol=EXACT)


NET = [[0, 0, 1], [1, 0, 1], [2, 1, 1], [3, 0, 1]]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: BSplineCurve(NET, degree=4), "more than 4"),
        (lambda: BSplineCurve(NET, [0, 1, 2], 2), "7 knots for 4 control points"),
        (lambda: BSplineCurve(NET, [0, 0, 0, 2, 1, 1, 1], 2), "do not fall"),
        (lambda: BSplineCurve(NET, [0] * 7, 2), "positive length"),
        (lambda: BSplineCurve([*NET, *NET[:2]], [0, 0, 0, 1, 1, 1, 2, 2, 2], 2), "at most 2 times"),
        (lambda: BSplineCurve(NET).evaluate(1.5), "from 0 to 1"),
        (lambda: BSplineCurve(NET).blossom([0.5], 0.5), "3 of them"),
        (lambda: BSplineCurve(NET, degree=2).insert_knot(0.5, 3), "multiplicity below 2"),
        (lambda: BSplineCurve(NET, degree=2).insert_knot(2.0), "from 0 to 1"),
        (lambda: BSplineCurve(NET, degree=0), "integer >= 1"),
        (lambda: BSplineCurve([[0, np.nan, 1]] * 4), "finite numbers"),
        (lambda: BSplineSurface(np.ones((4, 4, 3))), "control_points"),
        (lambda: BSplineSurface(np.ones((4, 4, 4)), degrees=(3, 4)), "more than 3 x 4"),
        (lambda: BSplineSurface(np.ones((4, 4, 4)), degrees=3), "a pair of degrees"),
        (lambda: BSplineSurface(np.ones((4, 4, 4)), [[0, 1]]), "a pair of knot vectors"),
        (lambda: BSplineSurface(np.ones((4, 4, 4)), [[0, 1], [0, 1]]), "knots[0]"),
        (lambda: BSplineSurface(np.ones((4, 4, 4))).insert_knot(0.5, 2), "0 or 1"),
        (lambda: bernstein.univariate(-1, 0.5), "a degree"),
        (lambda: bernstein.trivariate(2, [1, 2, 3, 4]), "two or three variables"),
    ],
)
def test_bad_splines(call, says):
    with pytest.raises((GeometryError, NetError)) as caught:
        call()
    assert says in str(caught.value)
