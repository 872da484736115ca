"""Points, lines, planes; join and meet; cross ratios; collineations."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart, collineation
from hypothesis import given, settings
from hypothesis import strategies as st

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import collineations as col
from mitsuba_bezier.geometry import cross_ratio as cr
from mitsuba_bezier.geometry import projective as pg

# Rounding of a few products of unit vectors is some 1e-15; random elements come as close to
# dependent as 1e-2 now and then, which divides the result by that. 1e-12 leaves a factor 10.
CLOSE = 1e-12

seeds = pytest.mark.parametrize("seed", range(10))


# ---------------------------------------------------------------- elements


def test_points_weights_and_infinity():
    p = pg.point([1, 2, 3], 2)
    assert p.tolist() == [2, 4, 6, 2]
    assert pg.affine(p).tolist() == [1, 2, 3]
    assert pg.ideal([1, 2]).tolist() == [1, 2, 0]
    assert pg.is_ideal([[1, 2, 0], [1, 2, 1]]).tolist() == [True, False]
    # the ideal plane holds exactly the ideal points
    assert pg.incidence(pg.ideal([1, 2, 3]), pg.IDEAL_PLANE) == 0
    assert pg.incidence(pg.point([1, 2, 3]), pg.IDEAL_PLANE) > 0.1


def test_what_is_ideal():
    o, x, far = pg.point([0, 0, 0]), pg.point([1, 2, 3]), pg.ideal([1, 2, 3])
    # lines of space: only those in the plane at infinity, which hold ideal points alone
    lines = [pg.meet([1, 2, 3, 4], pg.IDEAL_PLANE), pg.join(o, x), pg.join(x, far)]
    assert pg.is_ideal(lines).tolist() == [True, False, False]
    assert pg.is_ideal(pg.line_points(lines[0])).all()
    # planes, and lines of the plane; the same numbers as a point are the origin
    planes = [pg.IDEAL_PLANE, -7 * pg.IDEAL_PLANE, [0, 0, 1, -5], [0, 0, 1e-13, 1], [1, 0, 0, 0]]
    assert pg.is_ideal(planes, dual=True).tolist() == [True, True, False, True, False]
    assert pg.is_ideal([pg.IDEAL_LINE, [1, 1, 0]], dual=True).tolist() == [True, False]
    assert not pg.is_ideal(pg.IDEAL_PLANE) and not pg.is_ideal(pg.IDEAL_LINE)
    assert pg.is_ideal([0, 0, 1e-3, 1], tolerance=1e-2, dual=True)
    # as computed elements have it: the join of three ideal points, of a size of its own
    a, b, c = pg.ideal([[3e5, 1, 2], [1, 2e5, 7], [4, 1, 1e-3]])
    assert pg.is_ideal(pg.join(a, b, c), dual=True) and pg.is_ideal(pg.join(a, b))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: pg.affine([1, 2, 0.0]), "ideal point"),
        (lambda: pg.point([1, 2], 0), "other than 0"),
        (lambda: pg.point([1, np.nan]), "finite"),
        (lambda: pg.point([[1, 2], [3, 4]], [1, 2, 3]), "weight"),
        (lambda: pg.point("ab"), "numbers"),
        (lambda: pg.point([1j, 2]), "real numbers"),
        (lambda: pg.join(np.ones((2, 4)), np.ones((3, 4))), "broadcast"),
        (lambda: pg.incidence(np.ones((2, 4)), np.ones((3, 4))), "broadcast"),
        (lambda: pg.point(3.0), "coordinates"),
        (lambda: pg.ideal([0, 0, 0]), "zero vector"),
        (lambda: pg.join([1, 2, 3], [2, 4, 6]), "the same element twice"),
        (lambda: pg.join([1, 2, 3, 1], [-1, -2, -3, -1]), "the same element twice"),
        (lambda: pg.join([0, 0, 0, 1], [1, 0, 0, 1], [2, 0, 0, 1]), "a point on it"),
        (lambda: pg.meet([1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0]), "a plane through it"),
        (lambda: pg.join([1, 2, 3], [0, 0, 0]), "zero vector"),
        (lambda: pg.join([1, 2, np.inf], [0, 1, 0]), "finite"),
        (lambda: pg.join([1, 2, 3], [1, 2, 3, 4]), "lengths (3, 4)"),
        (lambda: pg.join([1, 2, 3, 4]), "lengths (4,)"),
        (lambda: pg.join([1, 2, 3, 4, 5], [1, 2, 3, 4, 6]), "3 or 4 or 6"),
        (lambda: pg.join("ab", [1, 2, 3]), "numbers"),
        (lambda: pg.join([1, 0, 0, 1, 0, 0], [1, 2, 3, 4]), "d.m = 0"),
        (lambda: pg.join([1, 0, 0, 0, 0, 0], [0, 1, 0, 1, 0, 0]), "skew"),
        (lambda: pg.meet([1, 0, 0, 0, 0, 0], [2, 0, 0, 0, 0, 0]), "the same line twice"),
        (lambda: pg.incidence([1, 2, 3], [1, 2, 3, 4]), "length 3"),
    ],
)
def test_bad_elements(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)


# ---------------------------------------------------------------- join and meet


@seeds
def test_join_and_meet_in_the_plane(seed):
    p, q, r = np.random.default_rng(seed).normal(size=(3, 50, 3))
    line = pg.join(p, q)
    # the vectors are products of those they are incident with: rounding only
    assert max(pg.incidence(line, p).max(), pg.incidence(line, q).max()) < 1e-14
    assert apart(pg.meet(pg.join(p, q), pg.join(p, r)), p) < CLOSE


@seeds
def test_join_and_meet_in_space(seed):
    rng = np.random.default_rng(seed)
    p, q, r, s = rng.normal(size=(4, 50, 4))
    line = pg.join(p, q)
    plane = pg.join(p, q, r)
    for x in (p, q, r):
        assert pg.incidence(plane, x).max() < 1e-14  # rounding of two products
    # three ways to the same plane
    assert apart(pg.join(line, r), plane) < CLOSE
    assert apart(pg.join(r, line), plane) < CLOSE
    assert apart(pg.join(line, pg.join(p, r)), plane) < CLOSE
    # and three to the same point
    other, third = pg.join(p, q, s), pg.join(p, r, s)
    assert apart(pg.meet(plane, other), line) < CLOSE
    assert apart(pg.meet(plane, other, third), p) < 100 * CLOSE  # three nearly dependent planes
    assert apart(pg.meet(line, third), p) < 100 * CLOSE
    assert apart(pg.meet(line, pg.join(p, r)), p) < CLOSE
    # lines that meet, and lines that do not
    assert pg.incidence(line, pg.join(p, r)).max() < 1e-14
    assert pg.incidence(line, pg.join(r, s)).min() > 1e-9


@seeds
def test_plucker_matrix_and_points_of_a_line(seed):
    rng = np.random.default_rng(seed)
    p, q, e = rng.normal(size=(3, 4))
    line = pg.join(p, q)
    matrix = pg.plucker_matrix(line)
    # the same three products each, in another order of summation
    np.testing.assert_allclose(matrix, np.outer(p, q) - np.outer(q, p), atol=1e-15)
    np.testing.assert_allclose(matrix @ e, pg.meet(line, e), atol=1e-14)
    for x in (line, np.concatenate([np.zeros(3), rng.normal(size=3)])):  # finite and ideal
        a, b = pg.line_points(x)
        assert apart(pg.join(a, b), x) < CLOSE
        # foot of the perpendicular and direction, or two directions: rounding
        assert abs(a @ b) < 1e-14 * np.linalg.norm(a) * np.linalg.norm(b)


def test_signs():
    o, x, y = pg.point([0, 0, 0]), pg.point([1, 0, 0]), pg.point([0, 1, 0])
    assert pg.join(o, x).tolist() == [1, 0, 0, 0, 0, 0]
    assert pg.join(pg.point([0, 0, 1]), pg.point([1, 0, 1])).tolist() == [1, 0, 0, 0, 1, 0]
    assert pg.join(o, x, y).tolist() == [0, 0, 1, 0]
    assert pg.meet([1, 0, 0, 0], [0, 1, 0, 0])[:3].tolist() == [0, 0, 1]
    assert pg.meet([1, 0, 0, -1], [0, 1, 0, -2], [0, 0, 1, -3]).tolist() == [1, 2, 3, 1]
    # plane: the line through (0,0) and (1,0) has its positive side where y > 0
    assert pg.join([0, 0, 1], [1, 0, 1]) @ [0, 1, 1] > 0


def test_factors_of_any_size():
    p, q, r = np.random.default_rng(0).normal(size=(3, 4))
    plane = pg.join(p, q, r)
    for factor in (1e-200, 1e-300, 1e200, 1e300):
        assert apart(pg.join(factor * p, q, factor * r), plane) < 1e-15
        assert pg.incidence(factor * p, plane / factor) < 1e-15
        # a pair of numbers (1, 3) of coordinates 0, 1, ∞ has the cross ratio 1/3
        value = cr.cross_ratio([factor, 0], [1, 1], [factor, 3 * factor], [0, 1])
        assert value == pytest.approx(1 / 3, rel=1e-14)


def test_parallels_meet_at_infinity():
    a = pg.join(pg.point([0, 0, 0]), pg.point([1, 2, 3]))
    b = pg.join(pg.point([1, 0, 0]), pg.point([2, 2, 3]))
    assert apart(pg.meet(a, b), pg.ideal([1, 2, 3])) < 1e-14
    line = pg.meet([0, 0, 1, 0], [0, 0, 1, -1])  # two parallel planes
    assert line[:3].tolist() == [0, 0, 0]
    assert apart(pg.join(line, pg.point([5, 5, 7])), np.array([0, 0, 1, -7])) < 1e-14


# ---------------------------------------------------------------- cross ratio


def _pencil(rng, c, count=50):
    """Four elements a + x d of a pencil, with their exact cross ratio by the definition."""
    # columns of matrices of condition at most 4: far from parallel
    a, d = np.moveaxis([collineation(rng, c)[:, :2] for _ in range(count)], 2, 0)[:, :, None]
    x = rng.permuted(np.arange(4.0) + rng.uniform(-0.3, 0.3, (count, 4)), axis=1)
    vectors = (a + x[..., None] * d) * rng.choice([-2.0, 0.5, 3.0], (count, 4, 1))
    value = (x[:, 1] - x[:, 0]) * (x[:, 3] - x[:, 2])
    value = value / ((x[:, 2] - x[:, 0]) * (x[:, 3] - x[:, 1]))
    return np.moveaxis(vectors, 1, 0), value


@pytest.mark.parametrize("c", [2, 3, 4])
@seeds
def test_cross_ratio_is_invariant(seed, c):
    rng = np.random.default_rng(100 * seed + c)
    (p0, p1, p2, p3), value = _pencil(rng, c)
    # neighbours on the line may be 0.1 apart, which costs a digit in each bracket
    np.testing.assert_allclose(cr.cross_ratio(p0, p1, p2, p3), value, rtol=1e-11)
    m = collineation(rng, c)
    image = [col.transform_points(m, p) for p in (p0, p1, p2, p3)]
    np.testing.assert_allclose(cr.cross_ratio(*image), value, rtol=1e-11)
    # planes in a pencil, or lines of the plane, under the same collineation
    if c > 2:
        image = [col.transform_hyperplanes(m, p) for p in (p0, p1, p2, p3)]
        np.testing.assert_allclose(cr.cross_ratio(*image), value, rtol=1e-11)


@seeds
def test_cross_ratio_of_a_section_is_that_of_the_pencil(seed):
    rng = np.random.default_rng(seed)
    # four planes through a line, cut by a line, and joined from a point of a plane
    planes, value = _pencil(rng, 4)
    p, q = rng.normal(size=(2, 50, 4))
    line = pg.join(p, q)
    points = [pg.meet(line, e) for e in planes]
    np.testing.assert_allclose(cr.cross_ratio(*points), value, rtol=1e-9)  # two constructions
    # four lines in space through one point and in one plane: Plücker vectors of a pencil
    eye = rng.normal(size=(50, 4))
    np.testing.assert_allclose(cr.cross_ratio(*[pg.join(eye, x) for x in points]), value, rtol=1e-8)


@seeds
def test_cross_ratio_survives_central_projection(seed):
    rng = np.random.default_rng(seed)
    points, value = _pencil(rng, 4)
    m = col.central_projection(rng.normal(size=4), rng.normal(size=4))
    image = [x @ m.T for x in points]
    # the projection may shorten the line by 1e-3
    np.testing.assert_allclose(cr.cross_ratio(*image), value, rtol=1e-9)


def test_cross_ratio_definition_and_limits():
    a, one, inf = [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]
    assert cr.cross_ratio(a, one, [1, 4], inf) == pytest.approx(1 / 4, rel=1e-15)
    assert cr.cross_ratio(a, one, one, inf) == pytest.approx(1, rel=1e-15)
    assert cr.cross_ratio(a, one, a, inf) == np.inf
    assert cr.cross_ratio(a, a, one, inf) == 0
    with pytest.raises(GeometryError, match="three equal"):
        cr.cross_ratio(a, a, a, inf)
    with pytest.raises(GeometryError, match="one pencil"):
        cr.cross_ratio(*np.eye(3), [1, 1, 1])
    with pytest.raises(GeometryError, match="one kind"):
        cr.cross_ratio(a, one, inf, [1, 2, 3])
    with pytest.raises(GeometryError, match="zero vector"):
        cr.cross_ratio(a, one, inf, [0, 0])


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2, 3, 4]), st.floats(-20, 20))
def test_point_from_cross_ratio_has_it(seed, c, value):
    rng = np.random.default_rng(seed)
    a, d = collineation(rng, c)[:, :2].T
    b = a * rng.uniform(0.5, 2) + d * rng.choice([-1.5, 0.7])
    x = cr.point_from_cross_ratio(a, b, d, value)
    # up to 20 times the rounding of brackets, where c is within 1/20 of an end
    assert cr.cross_ratio(a, b, x, d) == pytest.approx(value, rel=1e-10, abs=1e-10)


def test_point_from_cross_ratio_at_the_ends_and_bad_input():
    a, b, d = np.array([[1.0, 0, 1], [2, 0, 1], [5, 0, 1]])
    assert apart(cr.point_from_cross_ratio(a, b, d, 0.0), d) < 1e-14
    assert apart(cr.point_from_cross_ratio(a, b, d, (1.0, 0.0)), a) < 1e-14
    for arguments, says in [
        ((a, b, d, None), "value"),
        ((np.ones((2, 3)), np.ones((3, 3)), d, 1.0), "broadcast"),
        ((a, b, a, 2.0), "two different"),
        ((a, a, d, 2.0), "other than a and d"),
        ((a, d, d, 2.0), "other than a and d"),
        ((a, [0, 1, 1.0], d, 2.0), "outside"),
        ((a, b, d, np.nan), "value"),
        ((a, b, d, (0.0, 0.0)), "value"),
    ]:
        with pytest.raises(GeometryError, match=says):
            cr.point_from_cross_ratio(*arguments)


def test_affine_ratio():
    a, b, c = (pg.point([x, 1.0, 2 * x], w) for x, w in ((0.0, 1), (1.0, -3), (4.0, 2)))
    assert cr.affine_ratio(a, b, c) == pytest.approx(1 / 3, rel=1e-14)
    assert cr.affine_ratio(b, a, c) == pytest.approx(-1 / 4, rel=1e-14)
    # minus the cross ratio with the point at infinity of the line
    far = pg.ideal([1.0, 0.0, 2.0])
    assert cr.cross_ratio(a, b, far, c) == pytest.approx(-1 / 3, rel=1e-14)
    with pytest.raises(GeometryError, match="triangle"):
        cr.affine_ratio([0, 0, 1], [1, 0, 1], [1, 1, 1])
    with pytest.raises(GeometryError, match="two different points"):
        cr.affine_ratio([0, 0, 1], [1, 0, 1], [1, 0, 1])


# ---------------------------------------------------------------- collineations


@pytest.mark.parametrize("c", [2, 3, 4])
@seeds
def test_collineation_from_points(seed, c):
    rng = np.random.default_rng(10 * seed + c)
    m = collineation(rng, c)
    for count in (c + 1, c + 2, 3 * c):
        source = rng.normal(size=(count, c))
        target = (source @ m.T) * rng.choice([-3.0, 0.2, 1.0], (count, 1))
        found = col.collineation(source, target)
        # frames of random points have conditions up to 1e3
        assert apart(found.ravel(), m.ravel()) < 1e-11
        assert apart(source @ found.T, target) < 1e-11
        assert np.linalg.norm(found) == pytest.approx(1)


def test_least_squares_collineation_averages_noise():
    rng = np.random.default_rng(5)
    m = collineation(rng, 3)
    source = np.concatenate([rng.uniform(-1, 1, (400, 2)), np.ones((400, 1))], axis=1)
    noisy = pg.point(pg.affine(source @ m.T) + rng.normal(scale=1e-4, size=(400, 2)))
    keep = np.abs((source @ m.T)[:, 2]) > 0.3  # far from the vanishing line
    found = col.collineation(source[keep], noisy[keep])
    # noise 1e-4 in each of some 300 points: 1e-4 / sqrt(300) times a condition of order 10
    assert apart(found.ravel(), m.ravel()) < 1e-4
    assert apart(found.ravel(), m.ravel()) > 1e-8  # the noise did enter
    # any affine change of the target leaves the fit as it is: least squares after whitening
    shift = np.array([[1, 0, 1000.0], [0, 1, -500], [0, 0, 1]])
    moved = col.collineation(source[keep], noisy[keep] @ shift.T)
    again = np.linalg.inv(shift) @ moved
    assert apart(again.ravel(), m.ravel()) < 1e-4


@pytest.mark.parametrize(
    ("source", "says"),
    [
        (np.eye(4)[:, :3][:3], "N >= 4"),
        ([[1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 1, 1]], "general position"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], "general position"),
        ([[1, 0, 1], [0, 1, 1], [0, 0, 1], [0, 0, 0]], "zero vector"),
        ([[1, 0, 1], [2, 0, 1], [3, 0, 1], [4, 0, 1], [5, 0, 1]], "span"),
        ([[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]], "determine"),
    ],
)
def test_bad_point_pairs(source, says):
    target = np.random.default_rng(0).normal(size=np.shape(source))
    with pytest.raises(GeometryError, match=says):
        col.collineation(source, source if says == "determine" else target)


@seeds
def test_incidence_is_kept(seed):
    rng = np.random.default_rng(seed)
    m = collineation(rng, 4)
    p, q, r = rng.normal(size=(3, 20, 4))
    image = [col.transform_points(m, x) for x in (p, q, r)]
    assert apart(col.transform_lines(m, pg.join(p, q)), pg.join(*image[:2])) < CLOSE
    # with sign: the factor is det(M) M^-T
    np.testing.assert_allclose(
        col.transform_hyperplanes(m, pg.join(p, q, r)), pg.join(*image), atol=1e-12
    )


@pytest.mark.parametrize("c", [3, 4])
@seeds
def test_central_projection(seed, c):
    rng = np.random.default_rng(10 * seed + c)
    center, plane = rng.normal(size=(2, c))
    points = rng.normal(size=(30, c))
    m = col.central_projection(center, plane)
    image = points @ m.T
    assert pg.incidence(image, plane).max() < 1e-13  # image may be short by 1e-2
    assert apart(image @ m.T, image) < CLOSE  # projecting twice is projecting once
    assert apart(pg.meet(pg.join(center, points), plane), image) < 1e-11
    assert np.linalg.matrix_rank(m) == c - 1
    np.testing.assert_allclose(m @ center, 0, atol=1e-15)


@seeds
def test_homology(seed):
    rng = np.random.default_rng(seed)
    center, plane, x = rng.normal(size=(3, 4))
    m = col.homology(center, plane, 0.3)
    y = m @ x
    foot = col.central_projection(center, plane) @ x
    assert apart(m @ foot, foot) < CLOSE
    assert apart(m @ center, center) < CLOSE
    assert cr.cross_ratio(center, x, y, foot) == pytest.approx(0.3, rel=1e-10)


def test_bad_collineations():
    with pytest.raises(GeometryError, match="full rank"):
        col.transform_points(np.ones((4, 4)), [1, 2, 3, 4])
    with pytest.raises(GeometryError, match="4x4"):
        col.transform_hyperplanes(np.eye(3), [1, 2, 3, 4])
    with pytest.raises(GeometryError, match="not on the axis"):
        col.central_projection([0, 0, 0, 1], [0, 0, 1, 0])
    with pytest.raises(GeometryError, match="shapes"):
        col.central_projection([0, 0, 1], [0, 0, 1, 0])
    with pytest.raises(GeometryError, match="factor"):
        col.homology([0, 0, 1, 1], [0, 0, 1, 0], 0.0)
