"""Exact arcs of conics, conic matrices, five points, classification."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart, collineation, rotation

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import conics
from mitsuba_bezier.geometry import projective as pg
from mitsuba_bezier.geometry.curves import BezierCurve

S = np.linspace(0, 1, 33)
CIRCLE = np.diag([1.0, 1, -1])

seeds = pytest.mark.parametrize("seed", range(10))


def on_conic(a, points) -> float:
    """Largest x'Ax for unit vectors and a matrix of norm 1: about a relative distance."""
    x = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return float(np.abs(np.einsum("...i,ij,...j->...", x, a, x)).max() / np.linalg.norm(a))


# ---------------------------------------------------------------- arcs


@pytest.mark.parametrize("sweep", [0.1, 1.0, np.pi, 4.5, 6.2, -2.0, -5.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_ellipse_arc_is_exact(sweep, dimension):
    rng = np.random.default_rng(3)
    center, u, v = rng.normal(size=(3, dimension))
    arc = conics.ellipse_arc(center, u, v, 0.4, 0.4 + sweep)
    x = arc.points(S) - center
    cos, sin = np.linalg.lstsq(np.stack([u, v], axis=1), x.T, rcond=None)[0]
    # a half turn and more: weights down to cos(3.1) = -1 against 1, no cancellation in the points;
    # 1e-12 for the least squares of two random vectors
    np.testing.assert_allclose(cos**2 + sin**2, 1, rtol=1e-12)
    angle = np.unwrap(np.arctan2(sin, cos))
    assert angle[0] == pytest.approx(0.4, abs=1e-12)
    assert angle[-1] - angle[0] == pytest.approx(sweep, abs=1e-12)
    assert (np.diff(angle) * np.sign(sweep) > 0).all()
    assert arc.weights[1] == pytest.approx(np.cos(sweep / 2), abs=1e-15)


@pytest.mark.parametrize("arcs", [2, 3, 4, 7])
def test_whole_circle(arcs):
    parts = conics.circle((2, -1), 3, arcs)
    assert len(parts) == arcs
    for a, b in zip(parts, parts[1:] + parts[:1]):
        assert a.control_points[2].tolist() == b.control_points[0].tolist()  # closed exactly
        # and smooth: one tangent line
        assert apart(a.tangent(1.0), b.tangent(0.0)) < 1e-12
    x = np.concatenate([p.points(S[:-1]) for p in parts]) - [2, -1]
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 3, rtol=1e-14)  # rounding of one division
    turn = np.unwrap(np.arctan2(x[:, 1], x[:, 0]))
    assert turn[-1] - turn[0] > 2 * np.pi - 0.3
    if arcs > 2:
        assert all((p.weights > 0).all() for p in parts)
    else:
        assert all(pg.is_ideal(p.control_points[1]) for p in parts)


def test_curvature_of_a_circle_in_space():
    rng = np.random.default_rng(0)
    q = rotation(rng, 3)
    for arc in conics.ellipse([1, 2, 3], 2.5 * q[0], 2.5 * q[1]):
        _x, d1, d2 = arc.affine_derivatives(S, 2)
        curvature = np.linalg.norm(np.cross(d1, d2), axis=1) / np.linalg.norm(d1, axis=1) ** 3
        np.testing.assert_allclose(curvature, 1 / 2.5, rtol=1e-12)  # quotients of derivatives


def test_parabola_arcs():
    vertex, tangent, axis = np.array([[1.0, 2], [1, 0.5], [-0.3, 2]])
    arc = conics.parabola_arc(vertex, tangent, axis, -1.5, 2)
    assert arc.weights.tolist() == [1, 1, 1]
    s = -1.5 + 3.5 * S[:, None]
    np.testing.assert_allclose(arc.points(S), vertex + s * tangent + s**2 * axis, atol=1e-13)
    ray = conics.parabola_arc(vertex, tangent, axis, -1.5)
    t = S[:-1]
    s = (-1.5 + t / (1 - t))[:, None]
    expected = vertex + s * tangent + s**2 * axis
    np.testing.assert_allclose(ray.points(t), expected, rtol=1e-12, atol=1e-12)
    assert apart(ray.evaluate(1.0), pg.ideal(axis)) == 0
    # it touches the line at infinity there
    assert apart(ray.tangent(1.0), pg.IDEAL_LINE) < 1e-15


@pytest.mark.parametrize("dimension", [2, 3])
def test_hyperbola_arcs(dimension):
    center, u, v = np.random.default_rng(1).normal(size=(3, dimension))
    arc = conics.hyperbola_arc(center, u, v, -0.5, 2)
    np.testing.assert_allclose(arc.points(0), center + u * np.cosh(0.5) - v * np.sinh(0.5))
    assert arc.weights[1] > 1
    for curve in (arc, conics.hyperbola_branch(center, u, v)):
        x = curve.points(S[1:-1]) - center
        a, b = np.linalg.lstsq(np.stack([u, v], axis=1), x.T, rcond=None)[0]
        # a^2 - b^2 loses the digits of a^2, here up to 300
        np.testing.assert_allclose(a**2 - b**2, 1, rtol=1e-11)
        assert (a > 0).all()
        assert (np.diff(b) > 0).all()
    # the ends of the branch are the directions of the asymptotes, its tangents the asymptotes
    assert apart(curve.evaluate([0.0, 1.0]), pg.ideal([u - v, u + v])) < 1e-15
    line = pg.join(pg.point(center), pg.ideal(u + v))
    assert apart(curve.tangent(1.0), line) < 1e-15


# ---------------------------------------------------------------- matrices


@seeds
def test_matrix_of_an_arc(seed):
    rng = np.random.default_rng(seed)
    arc = BezierCurve(rng.normal(size=(3, 3)))
    a = conics.conic_matrix(arc)
    t = np.linspace(-3, 4, 29)
    assert on_conic(a, arc.evaluate(t)) < 1e-12  # inverse of a random frame: condition to 1e3
    # the polar of a point of the conic is its tangent
    assert apart(arc.evaluate(t) @ a, arc.tangent(t)) < 1e-10
    m = collineation(rng, 3)
    inverse = np.linalg.inv(m)
    image = conics.conic_matrix(arc.transform(m))
    assert apart(image.ravel(), (inverse.T @ a @ inverse).ravel()) < 1e-10


@seeds
def test_five_points_determine_the_conic(seed):
    rng = np.random.default_rng(seed)
    arc = BezierCurve(rng.normal(size=(3, 3)))
    points = arc.evaluate(np.array([-1, 0, 0.3, 0.8, 2])) * rng.choice([-2.0, 0.5], (5, 1))
    a = conics.conic_through_points(points)
    # five points within a sector of the conic: conditions up to 1e4
    assert apart(a.ravel(), conics.conic_matrix(arc).ravel()) < 1e-9
    # dual: five tangents determine the conic of lines, the inverse matrix
    tangents = arc.tangent(np.array([-1, 0, 0.3, 0.8, 2]))
    dual = conics.conic_through_points(tangents)
    assert apart(np.linalg.inv(dual).ravel(), a.ravel()) < 1e-7


def test_five_points_far_away_and_close_together():
    # a circle of radius 1e-3 a thousand units from the origin: its numbers have six common digits,
    # so of the 16 some 4 are left after squaring; without whitening there would be none
    t = np.array([0.1, 1, 2.5, 4, 5])
    center = np.array([1000.0, -500.0])
    points = pg.point(center + 1e-3 * np.stack([np.cos(t), np.sin(t)], axis=1))
    a = conics.conic_through_points(points)
    assert on_conic(a, points) < 1e-12
    pole = np.linalg.solve(a, pg.IDEAL_LINE)
    np.testing.assert_allclose(pg.affine(pole), center, atol=1e-6)
    three = pg.point([[0, 0], [1, 0], [3, 0], [0, 1], [2, 5]])
    pair = conics.conic_through_points(three)
    assert conics.classify_conic(pair) == "two lines"
    assert on_conic(pair, pg.point([[7, 0], [1, 3]])) < 1e-14


@seeds
def test_arc_through_three_points_of_a_conic_and_back(seed):
    rng = np.random.default_rng(seed)
    m = collineation(rng, 3)
    inverse = np.linalg.inv(m)
    a = inverse.T @ CIRCLE @ inverse
    angle = np.sort(rng.uniform(0, 2 * np.pi, 3))
    start, middle, end = (m @ [np.cos(x), np.sin(x), 1] for x in angle)
    arc = conics.conic_arc(a, start, middle, end)
    assert apart(arc.evaluate([0, 0.5, 1.0]), np.stack([start, middle, end])) < 1e-10
    assert on_conic(a, arc.evaluate(S)) < 1e-11  # angles down to 1e-2: chords as short
    assert apart(conics.conic_matrix(arc).ravel(), a.ravel()) < 1e-6  # short arcs again
    # it is the arc with the middle point in it, not its complement: preimages in between
    back = arc.evaluate(S) @ inverse.T
    seen = np.unwrap(np.arctan2(back[:, 1] / back[:, 2], back[:, 0] / back[:, 2]))
    assert abs(abs(seen[-1] - seen[0]) - (angle[2] - angle[0])) < 1e-9


@seeds
def test_every_conic_is_a_collineation_of_the_circle(seed):
    rng = np.random.default_rng(seed)
    m = collineation(rng, 3)
    inverse = np.linalg.inv(m)
    a = rng.choice([-3.0, 0.1]) * inverse.T @ CIRCLE @ inverse
    found = conics.unit_circle_to_conic(a)
    assert apart((found.T @ a @ found).ravel(), CIRCLE.ravel()) < 1e-13
    assert np.linalg.det(found) > 0
    arcs = conics.conic_arcs(a)
    for one, two in zip(arcs, arcs[1:] + arcs[:1]):
        assert on_conic(a, one.evaluate(S)) < 1e-14
        assert apart(one.evaluate(1.0), two.evaluate(0.0)) < 1e-15


def test_whole_ellipse_has_positive_weights():
    a = np.diag([1 / 4, 1.0, -1]) @ np.eye(3)
    for arc in conics.conic_arcs(a) + conics.conic_arcs(-a):
        assert (arc.weights > 0).all()
        x, y = arc.points(S).T
        np.testing.assert_allclose(x**2 / 4 + y**2, 1, rtol=1e-14)
    rng = np.random.default_rng(0)
    for _ in range(20):  # any ellipse, whatever signs the eigenvectors come with
        m = np.eye(3)
        m[:2] = rng.normal(size=(2, 3))
        inverse = np.linalg.inv(m)
        for arc in conics.conic_arcs(1e250 * inverse.T @ CIRCLE @ inverse):
            assert (arc.weights > 0).all()


CONICS = {
    "ellipse": np.diag([1, 4, -1.0]),
    "hyperbola": np.diag([1, -4, -1.0]),
    "parabola": np.array([[1, 0, 0], [0, 0, -0.5], [0, -0.5, 0]]),
    "empty": np.diag([1, 4, 1.0]),
    "two lines": np.diag([1, -1, 0.0]),
    "two parallel lines": np.diag([1, 0, -1.0]),
    "a line and the line at infinity": np.array([[0, 0, 1.0], [0, 0, 0], [1, 0, 0]]),
    "point": np.diag([1, 2, 0.0]),
    "point at infinity": np.diag([1, 0, 1.0]),
    "double line": np.diag([1, 0, 0.0]),
    "double line at infinity": np.diag([0, 0, 1.0]),
}


@pytest.mark.parametrize("name", CONICS)
@seeds
def test_classification_is_affine(name, seed):
    rng = np.random.default_rng(seed)
    m = np.eye(3)
    m[:2, :2] = collineation(rng, 2)
    m[:2, 2] = rng.normal(size=2)
    inverse = np.linalg.inv(m)
    a = rng.choice([-2.0, 5.0]) * inverse.T @ CONICS[name] @ inverse
    assert conics.classify_conic(a) == name


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: conics.ellipse_arc((0, 0), (1, 0), (2, 0), 0, 1), "independent vectors"),
        (lambda: conics.ellipse_arc((0, 0), (0, 0), (1, 0), 0, 1), "independent vectors"),
        (lambda: conics.ellipse_arc((0, 0), (1, 0), (0, 1, 0), 0, 1), "vectors of 2 or of 3"),
        (lambda: conics.ellipse_arc((0, 0), (1, 0), (0, 1), 0, 7), "full turn"),
        (lambda: conics.ellipse_arc((0, 0), (1, 0), (0, 1), 1, 1), "full turn"),
        (lambda: conics.ellipse_arc((0, np.nan), (1, 0), (0, 1), 0, 1), "finite"),
        (lambda: conics.circle((0, 0), -1), "radius"),
        (lambda: conics.circle((0, 0), 1, 1), "integer >= 2"),
        (lambda: conics.circle((0, 0), 1, 2.5), "integer >= 2"),
        (lambda: conics.circle((0, 0), None), "radius"),
        (lambda: conics.parabola_arc((0, 0), (1, 0), (0, 1), np.nan), "start"),
        (lambda: conics.parabola_arc((0, 0), (1, 0), (0, 1), 0, -np.inf), "end"),
        (lambda: conics.parabola_arc((0, 0), (1, 0), (0, 1), 2, 1), "start < end"),
        (lambda: conics.parabola_arc((0, 0), (1, 0), (1, 0), 0, 1), "independent vectors"),
        (lambda: conics.hyperbola_arc((0, 0), (1, 0), (0, 1), 1, 1), "two different"),
        (lambda: conics.conic_through_points(np.eye(3)), "shape (5, 3)"),
        (
            lambda: conics.conic_through_points([[x, 0, 1] for x in range(4)] + [[0, 1, 1]]),
            "no four on one line",
        ),
        (lambda: conics.conic_through_points([[x, x, 1] for x in range(5)]), "five on one line"),
        (
            lambda: conics.conic_through_points(
                [[0, 0, 1], [1, 0, 1], [0, 1, 1], [2, 3, 1], [4, 6, 2]]
            ),
            "five different points",
        ),
        (lambda: conics.conic_matrix(BezierCurve([[0, 0, 1], [1, 0, 1], [2, 0, 1]])), "collinear"),
        (lambda: conics.conic_matrix(BezierCurve(np.eye(4))), "degree 2"),
        (
            lambda: conics.conic_arc(CIRCLE, [1, 0, 1], [0, 1, 1], [3, 0, 1]),
            "end: expected a point",
        ),
        (lambda: conics.conic_arc(CIRCLE, [1, 0, 1], [1, 0, 1], [0, 1, 1]), "other than start"),
        (lambda: conics.conic_arc(CIRCLE, [1, 0, 1], [0, 1, 1], [1, 0, 1]), "same element"),
        (lambda: conics.conic_arc(CIRCLE, np.eye(3), [0, 1, 1], [1, 0, 1]), "one point"),
        (
            lambda: conics.conic_arc(np.diag([1.0, -1, 0]), [1, 1, 1], [2, 2, 1], [3, 3, 1]),
            "same element",
        ),
        (lambda: conics.unit_circle_to_conic(np.eye(3)), "empty"),
        (lambda: conics.unit_circle_to_conic(np.diag([1.0, -1, 0])), "two lines"),
        (lambda: conics.classify_conic(np.zeros((3, 3))), "not zero"),
        (lambda: conics.classify_conic([[1, 2, 3], [0, 1, 0], [0, 0, 1]]), "one that is not"),
        (lambda: conics.classify_conic(np.eye(4)), "3x3"),
    ],
)
def test_bad_conics(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
