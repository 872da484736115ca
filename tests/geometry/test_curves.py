"""Rational Bézier curves; evaluation by cross ratios; theorems on tangents."""

from __future__ import annotations

import itertools
from math import comb

import numpy as np
import pytest
from geometry_cases import apart, collineation
from hypothesis import given, settings
from hypothesis import strategies as st

from mitsuba_bezier.errors import GeometryError, NetError
from mitsuba_bezier.geometry import cross_ratio as cr
from mitsuba_bezier.geometry import projective as pg
from mitsuba_bezier.geometry.collineations import central_projection
from mitsuba_bezier.geometry.curves import BezierCurve, bernstein_product
from mitsuba_bezier.geometry.farin import (
    cross_ratio_scheme,
    curve_from_farin_points,
    evaluate_by_cross_ratios,
)
from mitsuba_bezier.geometry.tangents import four_tangent_cross_ratios, three_tangent_ratios

T = np.linspace(-0.3, 1.3, 17)  # also outside the segment

#: Degree up to 8, on [-0.3, 1.3]: the Bernstein sum has condition 1.6^8 = 43 there, so a few
#: roundings of 1e-16 become 1e-14; 1e-12 leaves room for derivatives and several steps.
CLOSE = 1e-12

cases = pytest.mark.parametrize(("degree", "c"), list(itertools.product([1, 2, 3, 5, 8], [3, 4])))


def random_curve(degree: int, c: int, seed: int = 0, kind: str = "mixed") -> BezierCurve:
    """Weights of both signs, or positive; for "mixed" one control point lies at infinity."""
    rng = np.random.default_rng([degree, c, seed])
    net = rng.normal(size=(degree + 1, c))
    if kind == "positive":
        net[:, -1] = rng.uniform(0.5, 2, degree + 1)
    elif degree > 1:
        net[1, -1] = 0
    return BezierCurve(net)


# ---------------------------------------------------------------- evaluation


@cases
def test_de_casteljau_is_the_bernstein_sum(degree, c):
    curve = random_curve(degree, c)
    basis = np.array(
        [[comb(degree, i) * (1 - t) ** (degree - i) * t**i for i in range(degree + 1)] for t in T]
    )
    np.testing.assert_allclose(curve.evaluate(T), basis @ curve.control_points, atol=CLOSE)
    assert curve.evaluate(0.0).tolist() == curve.control_points[0].tolist()
    assert curve.evaluate(1.0).tolist() == curve.control_points[-1].tolist()
    assert [len(level) for level in curve.de_casteljau(0.3)] == list(range(degree + 1, 0, -1))
    assert curve.evaluate(T.reshape(1, -1)).shape == (1, len(T), c)


@cases
def test_collineation_of_the_net_is_collineation_of_the_curve(degree, c):
    curve = random_curve(degree, c)
    m = collineation(np.random.default_rng(degree), c)
    np.testing.assert_allclose(curve.transform(m).evaluate(T), curve.evaluate(T) @ m.T, atol=CLOSE)


@cases
def test_projection_is_the_curve_of_the_projected_points(degree, c):
    rng = np.random.default_rng(degree)
    curve = random_curve(degree, c)
    center, plane = rng.normal(size=(2, c))
    m = central_projection(center, plane)
    image = curve.project(m)
    # the construction with lines through the centre, point by point
    expected = pg.meet(pg.join(center, curve.evaluate(T)), plane)
    assert apart(image.evaluate(T), expected) < 1e-10  # points may come near the centre
    assert pg.incidence(image.evaluate(T), plane).max() < 1e-12
    if c == 4:  # onto picture coordinates by a 3x4 matrix
        a = rng.normal(size=(3, 4))
        picture = curve.project(a)
        assert picture.dimension == 2
        np.testing.assert_allclose(picture.evaluate(T), curve.evaluate(T) @ a.T, atol=CLOSE)


@cases
def test_derivatives(degree, c):
    curve = random_curve(degree, c, kind="positive")
    t = np.linspace(0.1, 0.9, 5)
    h = 1e-5
    homogeneous = curve.derivatives(t, 3)
    euclidean = curve.affine_derivatives(t, 3)
    np.testing.assert_allclose(homogeneous[0], curve.evaluate(t), atol=CLOSE)
    np.testing.assert_allclose(euclidean[0], curve.points(t), atol=CLOSE)
    for k in range(3):  # central differences: h^2 times the fourth or fifth derivative, below 1e5
        for d, order in ((homogeneous, curve.derivatives), (euclidean, curve.affine_derivatives)):
            difference = (order(t + h, k)[k] - order(t - h, k)[k]) / (2 * h)
            scale = 1 + np.abs(d[k + 1]).max()
            np.testing.assert_allclose(difference / scale, d[k + 1] / scale, atol=2e-6)
    if degree < 3:
        assert not homogeneous[3].any()


@cases
def test_tangent(degree, c):
    curve = random_curve(degree, c)
    value, first = curve.derivatives(T, 1)
    assert apart(curve.tangent(T), pg.join(value, first)) < 1e-10  # points 1e-2 apart
    if c == 4 and degree >= 2:
        second = curve.derivatives(T, 2)[2]
        plane = curve.osculating_plane(T)
        assert apart(plane, pg.join(value, first, second)) < 1e-9


# ---------------------------------------------------------------- new curves


@cases
def test_split_subcurve_elevate_reverse(degree, c):
    curve = random_curve(degree, c)
    s = np.linspace(0, 1, 7)
    left, right = curve.split(0.3)
    np.testing.assert_allclose(left.evaluate(s), curve.evaluate(0.3 * s), atol=CLOSE)
    np.testing.assert_allclose(right.evaluate(s), curve.evaluate(0.3 + 0.7 * s), atol=CLOSE)
    np.testing.assert_allclose(
        left.control_points, curve.subcurve(0.0, 0.3).control_points, atol=CLOSE
    )
    outside = curve.subcurve(0.8, 1.4)
    np.testing.assert_allclose(outside.evaluate(s), curve.evaluate(0.8 + 0.6 * s), atol=CLOSE)
    np.testing.assert_allclose(curve.elevate(3).evaluate(T), curve.evaluate(T), atol=CLOSE)
    assert curve.elevate(3).degree == degree + 3
    np.testing.assert_allclose(curve.reverse().evaluate(T), curve.evaluate(1 - T), atol=CLOSE)


@cases
def test_blossom(degree, c):
    curve = random_curve(degree, c)
    rng = np.random.default_rng(3)
    arguments = rng.uniform(-1, 2, degree)
    value = curve.blossom(*arguments)
    np.testing.assert_allclose(curve.blossom(*arguments[::-1]), value, atol=CLOSE)  # symmetric
    np.testing.assert_allclose(curve.blossom(*[0.4] * degree), curve.evaluate(0.4), atol=CLOSE)
    # affine in each argument
    other = arguments.copy()
    other[0] += 1.0
    between = arguments.copy()
    between[0] += 0.25
    expected = 0.75 * value + 0.25 * curve.blossom(*other)
    np.testing.assert_allclose(curve.blossom(*between), expected, atol=CLOSE)
    # the point at the parameter infinity is the leading coefficient
    far = curve.blossom(*[(-1.0, 1.0)] * degree)
    np.testing.assert_allclose(far, np.diff(curve.control_points, n=degree, axis=0)[0], atol=CLOSE)


@cases
def test_reparametrize(degree, c):
    curve = random_curve(degree, c)
    for factor in (0.3, 4.0):
        s = np.linspace(0, 1, 9)
        t = s * factor / (1 - s + s * factor)
        assert apart(curve.reparametrize(factor).evaluate(s), curve.evaluate(t)) < 1e-11
    # negative: the complementary segment, t outside [0, 1]
    s = np.linspace(0.1, 0.4, 5)
    t = -s / (1 - 2 * s)
    assert apart(curve.reparametrize(-1).evaluate(s), curve.evaluate(t)) < 1e-11


def test_product():
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    product = bernstein_product(a, b[:3], np.cross)
    assert product.shape == (7, 3)
    value = [BezierCurve(x).evaluate(T) for x in (a, b[:3], product)]
    np.testing.assert_allclose(np.cross(value[0], value[1]), value[2], atol=CLOSE)


def test_from_points():
    curve = BezierCurve.from_points([[0, 0], [1, 2], [3, 0]], [1, 2, 1])
    assert curve.control_points[1].tolist() == [2, 4, 2]
    np.testing.assert_allclose(curve.points(0.5), [(0 + 4 + 3) / 6, 8 / 6])  # by hand
    assert curve == BezierCurve(curve.control_points)
    assert curve != curve.reverse()
    assert repr(curve) == "BezierCurve(degree 2, dimension 2)"
    with pytest.raises(ValueError, match="read-only"):
        curve.control_points[0] = 0


def test_a_point_at_infinity_is_reached():
    curve = BezierCurve([[0, 0, 1], [1, 1, 1], [1, 0, 0]])
    assert pg.is_ideal(curve.evaluate(1.0))
    with pytest.raises(GeometryError, match="ideal"):
        curve.points([0.5, 1.0])


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda c: BezierCurve([[1, 2, 3]]), NetError, "n >= 1"),
        (lambda c: BezierCurve(np.zeros((3, 2))), NetError, "shape (3, 2)"),
        (lambda c: BezierCurve([[1, 2, 3], [1, np.nan, 1]]), NetError, "nan at row 1"),
        (lambda c: BezierCurve(np.zeros((3, 3))), NetError, "zero vectors"),
        (lambda c: BezierCurve([[1, 2, "x"]]), NetError, "array of numbers"),
        (lambda c: BezierCurve.from_points([[1, 2], [3, 4]], [1, 2, 3]), NetError, "2 weights"),
        (lambda c: BezierCurve.from_points([1, 2]), NetError, "points"),
        (lambda c: c.evaluate(np.nan), GeometryError, "finite"),
        (lambda c: c.evaluate("a"), GeometryError, "numbers"),
        (lambda c: c.derivatives(0.5, -1), GeometryError, "order"),
        (lambda c: c.blossom(0.5), GeometryError, "2 of them"),
        (lambda c: c.blossom(0.5, (0, 0)), GeometryError, "not (0, 0)"),
        (lambda c: c.subcurve(0.5, 0.5), GeometryError, "two different"),
        (lambda c: c.elevate(-1), GeometryError, "times"),
        (lambda c: c.elevate(1.5), GeometryError, "times"),
        (lambda c: c.split("a"), GeometryError, "t: expected numbers"),
        (lambda c: c.split([0.2, 0.3]), GeometryError, "one number"),
        (lambda c: c.reparametrize(None), GeometryError, "factor"),
        (lambda c: BezierCurve.from_points([[0, 0], [1]]), GeometryError, "points"),
        (lambda c: c.reparametrize(0), GeometryError, "factor"),
        (lambda c: c.transform(np.ones((3, 3))), GeometryError, "full rank"),
        (lambda c: c.transform(np.eye(4)), GeometryError, "3x3"),
        (lambda c: c.project(np.eye(4)), GeometryError, "(3 or 4, 3)"),
        (lambda c: c.project(np.zeros((3, 3))), GeometryError, "centre"),
        (lambda c: c.osculating_plane(0.5), GeometryError, "space curve"),
        (lambda c: BezierCurve([[0, 0, 1]] * 3).tangent(0.5), GeometryError, "same element"),
    ],
)
def test_bad_input(call, error, says):
    with pytest.raises(error) as caught:
        call(BezierCurve([[0, 0, 1], [1, 2, 1], [2, 0, 1]]))
    assert says in str(caught.value)


# ---------------------------------------------------------------- cross ratios


@settings(max_examples=150, derandomize=True, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    degree=st.integers(1, 7),
    c=st.sampled_from([3, 4]),
    t=st.floats(0, 1),
)
def test_menelaus_is_de_casteljau(seed, degree, c, t):
    """Whatever the multiples in which the points come, and after any collineation."""
    rng = np.random.default_rng(seed)
    net = rng.normal(size=(degree + 1, c))
    net[:, -1] = rng.uniform(0.2, 2, degree + 1)  # positive weights: no leg shrinks to a point
    curve = BezierCurve(net)
    points = net * rng.choice([-2.0, 0.5, 1.0], (degree + 1, 1))
    farin = curve.farin_points() * rng.choice([-0.3, 1.0, 4.0], (degree, 1))
    expected = curve.evaluate(t)
    # the legs of random polygons shrink to 1e-2 or so at some level: two digits
    assert apart(evaluate_by_cross_ratios(points, farin, t), expected) < 1e-11
    m = collineation(rng, c)
    image = evaluate_by_cross_ratios(points @ m.T, farin @ m.T, t)
    assert apart(image, expected @ m.T) < 1e-11


@pytest.mark.parametrize("c", [3, 4])
def test_every_level_has_its_cross_ratio_and_its_meets(c):
    curve = random_curve(5, c, kind="positive")
    t = 0.35
    scheme = cross_ratio_scheme(curve.control_points, curve.farin_points(), t)
    assert [len(b) for b, _q in scheme] == [6, 5, 4, 3, 2, 1]
    for (b, q), (b1, q1) in itertools.pairwise(scheme):
        ratio = cr.cross_ratio(b[:-1], q, b1, b[1:])
        np.testing.assert_allclose(ratio, (1 - t) / t, rtol=1e-11)  # brackets lose two digits
        if len(q1):  # the next Farin points as meets of lines
            legs, chords = pg.join(b1[:-1], b1[1:]), pg.join(q[:-1], q[1:])
            assert apart(pg.meet(legs, chords), q1) < 1e-10  # two constructions with lines
    for (b, q), level in zip(scheme, curve.de_casteljau(t)):
        assert apart(b, level) < CLOSE
        if len(q):
            assert apart(q, level[:-1] + level[1:]) < CLOSE


def test_collinear_polygons_and_control_vectors():
    # three control points on a line, where the meet of lines is not defined
    curve = BezierCurve([[0, 0, 1], [2, 2, 2], [5, 5, 1], [1, 0, 0]])
    for t in (0.0, 0.2, 0.9, 1.0):
        value = evaluate_by_cross_ratios(curve.control_points, curve.farin_points(), t)
        assert apart(value, curve.evaluate(t)) < CLOSE


@cases
def test_curve_from_farin_points(degree, c):
    curve = random_curve(degree, c)
    rng = np.random.default_rng(1)
    factor = rng.choice([-2.0, 0.5], (degree + 1, 1))
    factor[0] = 1
    again = curve_from_farin_points(
        curve.control_points * factor, curve.farin_points() * rng.choice([3.0, -1.0], (degree, 1))
    )
    np.testing.assert_allclose(again.control_points, curve.control_points, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    ("points", "farin", "t", "says"),
    [
        ([[0, 0, 1], [1, 0, 1]], [[1, 1, 1]], 0.5, "outside"),
        ([[0, 0, 1], [1, 0, 1]], [[0, 0, 1]], 0.5, "end of a leg"),
        ([[0, 0, 1], [0, 0, 2]], [[0, 0, 1]], 0.5, "two different"),
        ([[0, 0, 1], [1, 0, 1]], [[1, 0, 2], [1, 0, 2]], 0.5, "n Farin points"),
        ([[0, 0, 1], [1, 0, 1]], [[1, 0, 2]], [0.5, 0.6], "one number"),
        ([[0, 0, 1], [0, 0, 0]], [[1, 0, 2]], 0.5, "zero vector"),
    ],
)
def test_bad_farin_points(points, farin, t, says):
    with pytest.raises(GeometryError, match=says):
        evaluate_by_cross_ratios(points, farin, t)


# ---------------------------------------------------------------- tangents


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("c", [3, 4])
def test_three_tangents_of_a_parabola(seed, c):
    rng = np.random.default_rng(seed)
    net = rng.normal(size=(3, c))
    net[:, -1] = 1
    r, s, t = np.sort(rng.uniform(-1, 2, 3))
    # a parabola whose parameter is affine: the ratios are those of the parameters
    ratios = three_tangent_ratios(BezierCurve(net), r, s, t)
    np.testing.assert_allclose(ratios, (s - r) / (t - s), rtol=1e-9)  # tangents may be 1e-2 apart
    # the same parabola with a rational parameter: still three equal ratios
    rational = BezierCurve(net).reparametrize(1.7)
    ratios = three_tangent_ratios(rational, 0.1, 0.4, 0.8)
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-10)
    # another conic: not equal
    net[1] *= 1.5
    ratios = three_tangent_ratios(BezierCurve(net), 0.1, 0.4, 0.8)
    assert np.ptp(ratios) > 1e-2 * np.abs(ratios).max()


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("c", [3, 4])
def test_four_tangents_of_a_conic(seed, c):
    rng = np.random.default_rng(seed)
    curve = BezierCurve(rng.normal(size=(3, c)))
    t = np.array([0.0, 0.3, 0.55, 1.0])
    expected = cr.cross_ratio(*np.stack([1 - t, t], axis=1))
    moving = np.append(rng.uniform(-1, 2, 5), t)  # the fixed tangents themselves as well
    ratios = four_tangent_cross_ratios(curve, t, moving)
    np.testing.assert_allclose(ratios, expected, rtol=1e-8)  # meets of tangents 1e-3 apart
    # of a cubic the theorem does not hold, and the function refuses it
    with pytest.raises(GeometryError, match="degree 2"):
        four_tangent_cross_ratios(curve.elevate(), t, moving)


def test_tangent_theorems_refuse_degenerate_input():
    line = BezierCurve([[0, 0, 1], [1, 0, 1], [2, 0, 1]])
    good = BezierCurve([[0, 0, 1], [1, 1, 1], [2, 0, 1]])
    with pytest.raises(GeometryError, match="on a line"):
        three_tangent_ratios(line, 0, 0.5, 1)
    with pytest.raises(GeometryError, match="zero vector"):
        three_tangent_ratios(BezierCurve([[0, 0, 1], [0, 0, 0], [2, 0, 1]]), 0, 0.5, 1)
    with pytest.raises(GeometryError, match="same element"):
        three_tangent_ratios(good, 0, 0, 1)
    with pytest.raises(GeometryError, match="four different"):
        four_tangent_cross_ratios(good, [0, 0.5, 0.5, 1], 0.2)
