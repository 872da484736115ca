"""Dual Bézier curves: envelopes of lines and planes, point form and line form."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from geometry_cases import apart, collineation

from mitsuba_bezier.errors import GeometryError, NetError
from mitsuba_bezier.geometry import projective as pg
from mitsuba_bezier.geometry.conics import conic_matrix
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.duality import DualBezierCurve, dual_form

T = np.linspace(-0.2, 1.2, 15)

# Products of two or three curves of degree 5 in random vectors: where these are 1e-2 from
# dependent two digits are lost, squared in a round trip
CLOSE = 1e-10

plane_degrees = pytest.mark.parametrize(
    ("degree", "seed"), list(itertools.product([2, 3, 4, 6], range(4)))
)
space_degrees = pytest.mark.parametrize(
    ("degree", "seed"), list(itertools.product([3, 4, 6], range(4)))
)


def net(degree: int, c: int, seed: int) -> np.ndarray:
    return np.random.default_rng([degree, c, seed]).normal(size=(degree + 1, c))


@plane_degrees
def test_envelope_of_lines(degree, seed):
    lines = DualBezierCurve(net(degree, 3, seed))
    envelope = lines.point_form()
    assert envelope.degree == 2 * degree - 2
    x = envelope.evaluate(T)
    assert pg.incidence(x, lines.evaluate(T)).max() < CLOSE
    # the line touches there: it is the tangent of the envelope
    assert apart(envelope.tangent(T), lines.evaluate(T)) < 1e-8
    # the same point by de Casteljau's lines, and with the same factor
    np.testing.assert_allclose(lines.contact(T), x, atol=1e-10)


@plane_degrees
def test_tangents_of_a_plane_curve(degree, seed):
    curve = BezierCurve(net(degree, 3, seed))
    lines = dual_form(curve)
    assert lines.degree == 2 * degree - 2
    np.testing.assert_allclose(lines.evaluate(T), curve.tangent(T), atol=1e-10)
    # and back: the contact of the tangents are the points of the curve
    assert apart(lines.contact(T), curve.evaluate(T)) < 1e-7
    back = lines.point_form()
    assert back.degree == 2 * (2 * degree - 2) - 2
    assert apart(back.evaluate(T), curve.evaluate(T)) < 1e-6  # degree 18, products of products


def test_conics_are_their_own_duals():
    curve = BezierCurve(net(2, 3, 5))
    lines = dual_form(curve)
    again = lines.point_form()
    assert again.degree == 2
    assert apart(again.control_points.ravel(), curve.control_points.ravel()) < 1e-12
    # the matrix of the conic of lines is the inverse
    a = conic_matrix(curve)
    b = conic_matrix(BezierCurve(lines.control_elements))
    assert apart(np.linalg.inv(b).ravel(), a.ravel()) < 1e-9  # two inverses


@space_degrees
def test_regression_curve_of_planes(degree, seed):
    planes = DualBezierCurve(net(degree, 4, seed))
    curve = planes.point_form()
    assert curve.degree == 3 * degree - 6
    x = curve.evaluate(T)
    assert pg.incidence(x, planes.evaluate(T)).max() < CLOSE
    np.testing.assert_allclose(planes.contact(T), x, atol=1e-9)
    # the planes osculate it and the rulings touch it
    rulings = planes.ruling(T)
    assert apart(curve.tangent(T), rulings) < 1e-6  # where the curve is nearly a cusp
    assert apart(curve.osculating_plane(T), planes.evaluate(T)) < 1e-5


@space_degrees
def test_osculating_planes_of_a_space_curve(degree, seed):
    curve = BezierCurve(net(degree, 4, seed))
    planes = dual_form(curve)
    assert planes.degree == 3 * degree - 6
    np.testing.assert_allclose(planes.evaluate(T), curve.osculating_plane(T), atol=1e-10)
    assert apart(planes.ruling(T), curve.tangent(T)) < 1e-6
    assert apart(planes.contact(T), curve.evaluate(T)) < 1e-5  # degrees to 12, then three meets
    if degree == 3:  # space cubics are self-dual, like conics
        again = planes.point_form().control_points
        assert apart(again.ravel(), curve.control_points.ravel()) < 1e-10


@pytest.mark.parametrize("c", [3, 4])
def test_collineations(c):
    lines = DualBezierCurve(net(4, c, 0))
    m = collineation(np.random.default_rng(1), c)
    image = lines.transform(m)
    assert apart(image.contact(T), lines.contact(T) @ m.T) < CLOSE
    assert apart(image.point_form().evaluate(T), lines.contact(T) @ m.T) < CLOSE


@pytest.mark.parametrize("c", [3, 4])
def test_split_and_elevate(c):
    lines = DualBezierCurve(net(4, c, 0))
    left, right = lines.split(0.4)
    s = np.linspace(0, 1, 5)
    np.testing.assert_allclose(left.evaluate(s), lines.evaluate(0.4 * s), atol=1e-14)
    np.testing.assert_allclose(right.evaluate(s), lines.evaluate(0.4 + 0.6 * s), atol=1e-14)
    assert apart(lines.elevate().contact(T), lines.contact(T)) < CLOSE
    assert lines.elevate().degree == 5
    assert lines.dimension == c - 1


def test_unit_circle_from_three_control_lines():
    # the tangents x = 1 and y = 1 of a quarter circle; between them the chord of contact
    middle = np.array([1, 1, -1.0])
    quarter = BezierCurve([[1, 0, 1], np.array([1, 1, 1]) / np.sqrt(2), [0, 1, 1]])
    lines = dual_form(quarter)
    assert apart(lines.control_elements[0], np.array([1, 0, -1])) < 1e-15
    assert apart(lines.control_elements[1], middle) < 1e-15
    assert apart(lines.control_elements[2], np.array([0, 1, -1])) < 1e-15
    line = lines.evaluate(T)  # tangents of the unit circle are at distance 1 from the origin
    np.testing.assert_allclose(line[:, 2] ** 2, line[:, 0] ** 2 + line[:, 1] ** 2, rtol=1e-13)


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda: DualBezierCurve(np.zeros((3, 3))), NetError, "control_elements"),
        (lambda: DualBezierCurve(np.zeros((3, 5))), NetError, "shape (3, 5)"),
        (lambda: DualBezierCurve(net(1, 3, 0)).point_form(), GeometryError, "at least 2"),
        (lambda: DualBezierCurve(net(2, 4, 0)).point_form(), GeometryError, "at least 3"),
        (lambda: DualBezierCurve(net(1, 4, 0)).contact(0.5), GeometryError, "at least 2"),
        (lambda: DualBezierCurve(net(3, 3, 0)).ruling(0.5), GeometryError, "curve of planes"),
        (lambda: DualBezierCurve(net(3, 3, 0)).transform(np.eye(4)), GeometryError, "3x3"),
        (lambda: dual_form(BezierCurve(net(1, 3, 0))), GeometryError, "at least 2"),
        (lambda: dual_form(BezierCurve(net(2, 4, 0))), GeometryError, "at least 3"),
        (
            lambda: dual_form(BezierCurve([[0, 0, 1], [1, 1, 1], [2, 2, 1]])),
            GeometryError,
            "in a line",
        ),
        (
            lambda: dual_form(BezierCurve(np.c_[net(3, 3, 0), np.zeros(4)])),
            GeometryError,
            "in a plane",
        ),
        (
            lambda: DualBezierCurve([[1, 0, 0], [0, 1, 0], [1, 1, 0]]).point_form(),
            GeometryError,
            "through one point",
        ),
        (
            lambda: DualBezierCurve(np.c_[net(3, 3, 0), np.zeros(4)]).point_form(),
            GeometryError,
            "through one point",
        ),
    ],
)
def test_bad_input(call, error, says):
    with pytest.raises(error) as caught:
        call()
    assert says in str(caught.value)
