"""Pole and polar, conjugate points, polar reciprocals."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from geometry_cases import apart, collineation

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import polarity as po
from mitsuba_bezier.geometry.conics import conic_arcs, conic_matrix
from mitsuba_bezier.geometry.cross_ratio import cross_ratio
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.duality import DualBezierCurve
from mitsuba_bezier.geometry.projective import IDEAL_LINE, incidence, join, meet, point

seeds = pytest.mark.parametrize("seed", range(5))
T = np.linspace(0, 1, 9)


def conic(seed: int, c: int = 3) -> np.ndarray:
    m = np.linalg.inv(collineation(np.random.default_rng(seed), c))
    return m.T @ np.diag([*[1.0] * (c - 1), -1.0]) @ m


@pytest.mark.parametrize(("seed", "c"), list(itertools.product(range(5), (3, 4))))
def test_pole_and_polar(seed, c):
    a, rng = conic(seed, c), np.random.default_rng([seed, c])
    p, q = rng.normal(size=(2, 7, c))
    # matrices of condition 16 at most, squared: three digits of sixteen
    assert apart(po.pole(a, po.polar(a, p)), p) < 1e-12
    # q on the polar of p exactly if p on that of q
    line = join(p, q)
    other = po.conjugate_point(a, p, line)
    assert po.conjugacy(a, p, other).max() < 1e-12
    assert incidence(p, po.polar(a, other)).max() < 1e-12
    # the conjugate points of a secant are harmonic to those where it meets the conic
    for x, y, own in zip(p, other, line):
        ends = po.line_intersections(a, own)
        if len(ends) == 2:
            assert abs(cross_ratio(ends[0], x, y, ends[1]) + 1) < 1e-9
            assert abs(np.einsum("ki,ij,kj->k", ends, a, ends)).max() < 1e-12 * np.abs(a).max()


@seeds
def test_tangents_touch_where_the_polar_meets(seed):
    a = conic(seed)
    m = collineation(np.random.default_rng(seed), 3)
    outside = m @ [3.0, 0.5, 1.0]
    lines = po.tangents_from(a, outside)
    assert len(lines) == 2
    assert incidence(lines, outside).max() < 1e-12
    ends = po.line_intersections(a, po.polar(a, outside))
    touch = po.pole(a, lines)  # the pole of a tangent is its point of contact
    assert min(apart(ends, touch), apart(ends, touch[::-1])) < 1e-9
    assert len(po.tangents_from(a, m @ [0.2, 0.1, 1.0])) == 0
    assert len(po.line_intersections(a, po.polar(a, m @ [0.2, 0.1, 1.0]))) == 0
    assert len(po.tangents_from(np.diag([1.0, 1, -1]), [1, 0, 1])) == 1  # on the conic


@pytest.mark.parametrize(("seed", "degree"), list(itertools.product(range(3), (2, 3, 4))))
def test_polar_reciprocal_of_a_curve(seed, degree):
    curve = BezierCurve(np.random.default_rng([seed, degree]).normal(size=(degree + 1, 3)))
    p = po.Polarity(conic(seed))
    lines = p.reciprocal(curve)
    assert isinstance(lines, DualBezierCurve)
    image = p.reciprocal_curve(curve)
    assert image.degree == 2 * degree - 2
    # its points are the poles of the tangents; products of two curves in generic position
    assert apart(image.evaluate(T), p.pole(curve.tangent(T))) < 1e-8
    assert apart(image.tangent(T), p.polar(curve.evaluate(T))) < 1e-6
    # a point of contact is on the polar of the curve's point
    assert po.conjugacy(p.matrix, curve.evaluate(T), image.evaluate(T)).max() < 1e-10
    # twice, the curve is back
    assert p.reciprocal(lines).control_points == pytest.approx(curve.control_points, abs=1e-12)


@seeds
def test_the_reciprocal_of_a_conic_is_one(seed):
    a, b = conic(seed), conic(seed + 100)
    p = po.Polarity(a)
    for arc in conic_arcs(b):
        found = conic_matrix(p.reciprocal_curve(arc))
        assert apart(found.ravel(), (a @ np.linalg.inv(b) @ a).ravel()) < 1e-9
    # and its own, if it is that of the polarity
    own = conic_arcs(a)[0]
    assert apart(conic_matrix(p.reciprocal_curve(own)).ravel(), a.ravel()) < 1e-10


def test_a_space_curve_goes_to_the_edge_of_regression():
    rng = np.random.default_rng(3)
    curve = BezierCurve(rng.normal(size=(4, 4)))
    p = po.Polarity(conic(2, 4))
    image = p.reciprocal_curve(curve)
    assert image.degree == 3
    assert apart(image.evaluate(T), p.pole(curve.osculating_plane(T))) < 1e-8


def test_the_centre_is_the_pole_of_the_ideal_line():
    a = np.array([[1, 0, -2.0], [0, 4, -4], [-2, -4, 3]])
    assert apart(po.pole(a, IDEAL_LINE), [2, 1, 1]) < 1e-15
    assert apart(meet(po.polar(a, [1, 0, 0]), po.polar(a, [0, 1, 0])), point([2, 1])) < 1e-15


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: po.pole(np.diag([1.0, -1, 0]), [1, 0, 0]), "a pair of lines"),
        (lambda: po.Polarity(np.diag([1.0, 1, -1, 0])), "cone or pair of planes"),
        (lambda: po.polar(np.diag([1.0, -1, 0]), [0, 0, 1]), "the vertex"),
        (lambda: po.conjugacy(np.diag([1.0, -1, 0]), [0, 0, 1], [1, 0, 0]), "the vertex"),
        (lambda: po.polar(np.ones((3, 4)), [0, 0, 1]), "3x3 or 4x4"),
        (lambda: po.polar([[1, 2, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 1]), "one that is not"),
        (lambda: po.polar(np.eye(3), [0, 0, 0, 1]), "of 3 numbers"),
        (lambda: po.line_intersections(np.diag([1.0, -1, 0]), [1, 1, 0]), "does not lie on A"),
        (lambda: po.line_intersections(np.eye(3), np.eye(3)), "one line"),
        (lambda: po.tangents_from(np.diag([1.0, 1, 1, -1]), [1, 0, 0, 1]), "a conic"),
        (lambda: po.Polarity(np.eye(3)).reciprocal(BezierCurve(np.eye(4))), "of dimension 2"),
        (
            lambda: po.Polarity(np.eye(3)).reciprocal_curve(
                BezierCurve([[0, 0, 1], [1, 0, 1], [2, 0, 1]])
            ),
            "through one point",
        ),
    ],
)
def test_bad_polarities(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
