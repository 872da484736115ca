"""Bézier's basic curve: two elliptic cylinders in a box, and its affine images."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.basic_curve import BasicCurve
from mitsuba_bezier.geometry.projective import point
from mitsuba_bezier.geometry.quadric_types import classify_quadric

T = np.linspace(0, 1, 41)
SHEAR = np.array([[1, 0.4, 0.2, 3], [0, 1, -0.5, 1], [0, 0, 2, 0], [0, 0, 0, 1.0]])


def boxes() -> list[BasicCurve]:
    rng = np.random.default_rng(1)
    others = [BasicCurve(rng.normal(size=3), rng.normal(size=(3, 3))) for _ in range(5)]
    return [BasicCurve(), *others]


@pytest.mark.parametrize("curve", boxes(), ids=range(6))
def test_it_is_the_intersection_of_two_elliptic_cylinders(curve):
    x = point(curve.points(T))
    for a in curve.cylinders:
        assert classify_quadric(a) == "elliptic cylinder"
        value = np.einsum("ni,ij,nj->n", x, a, x)
        terms = np.einsum("ni,ij,nj->n", np.abs(x), np.abs(a), np.abs(x))
        np.testing.assert_array_less(np.abs(value), 1e-14 * terms + 1e-15)  # rounding of the terms
    # inscribed: each touches two faces of the box along edges, where these are its polars
    faces = np.linalg.inv(curve.frame)  # rows: the planes where x, y, z are zero
    ideal_plane = faces[3]
    for a, (i, j) in zip(curve.cylinders, ((0, 1), (1, 2))):
        start, end = np.zeros(3), np.ones(3)
        start[3 - i - j] = 0.3
        for inner, plane in ((start, faces[j]), (end, faces[i] - ideal_plane)):
            touching = a @ point(curve.origin + inner @ curve.edges)
            assert apart(touching, plane) < 1e-12


@pytest.mark.parametrize("curve", boxes(), ids=range(6))
def test_it_goes_through_the_box_from_corner_to_corner(curve):
    e = curve.edges
    np.testing.assert_allclose(curve.points(0.0), curve.origin, atol=1e-14)
    np.testing.assert_allclose(curve.points(1.0), curve.origin + e.sum(axis=0), atol=1e-14)
    inner = np.linalg.solve(e.T, (curve.points(T) - curve.origin).T)
    assert inner.min() > -1e-12 and inner.max() < 1 + 1e-12
    assert (np.diff(inner, axis=1) > -1e-12).all()  # it never turns back
    # tangents along the first and the third edge, like the cubic's over the three edges
    h = 1e-5
    for step, edge in ((curve.points(h) - curve.points(0.0), e[0]),
                       (curve.points(1.0) - curve.points(1 - h), e[2])):  # fmt: skip
        away = np.cross(step, edge) / (np.linalg.norm(step) * np.linalg.norm(edge))
        assert np.linalg.norm(away) < 1e-3  # of the order of sqrt(h) at worst
    polygon = curve.polygon()
    np.testing.assert_allclose(np.diff(polygon.points(T)[[0, -1]], axis=0)[0], e.sum(axis=0))


def test_whoever_shears_the_box_shears_the_curve():
    for curve in boxes():
        image = curve.transform(SHEAR)
        np.testing.assert_allclose(
            image.points(T), curve.points(T) @ SHEAR[:3, :3].T + SHEAR[:3, 3], atol=1e-12
        )


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: BasicCurve(edges=np.ones((3, 3))), "three independent edges"),
        (lambda: BasicCurve(edges=[[1, 0, 0], [0, 1, 0], [0, 0, 0]]), "three independent edges"),
        (lambda: BasicCurve(origin=(0, 0)), "a point and three edges"),
        (lambda: BasicCurve().points(1.5), "from 0 to 1"),
        (lambda: BasicCurve().transform(np.eye(4) + np.eye(4)[[1, 2, 3, 0]] / 2), "affine map"),
        (lambda: BasicCurve().transform(np.diag([1.0, 1, 0, 1])), "full rank"),
    ],
)
def test_bad_boxes(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
