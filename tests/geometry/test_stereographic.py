"""Stereographic projection and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart, collineation

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.projective import affine, incidence, join, point
from mitsuba_bezier.geometry.stereographic import StereographicProjection

SPHERE = np.diag([1.0, 1, 1, -1])
RULED = np.diag([1.0, 1, -1, -1])
BOWL = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])


def cases() -> list[StereographicProjection]:
    out = [
        StereographicProjection(),
        StereographicProjection(RULED, [1, 0, 0, 1], [1, 0, 0, 2]),
        StereographicProjection(BOWL, [0, 0, 1, 0], [0, 0, 1, 0]),  # along the axis
    ]
    for seed, a in enumerate((SPHERE, RULED, BOWL)):
        rng = np.random.default_rng(seed)
        m = collineation(rng, 4)
        back = np.linalg.inv(m)
        center = m @ {0: [0, 0.6, 0.8, 1], 1: [1, 0, 0, 1], 2: [1, 1, 2, 1]}[seed]
        out.append(StereographicProjection(back.T @ a @ back, center, rng.normal(size=4)))
    return out


@pytest.mark.parametrize("case", range(6))
def test_forth_and_back(case):
    s = cases()[case]
    rng = np.random.default_rng(case)
    basis = np.linalg.svd(s.plane[None])[2][1:]  # three points of the plane
    p = rng.normal(size=(30, 3)) @ basis
    x = s.inverse(p)
    value = np.abs(np.einsum("ni,ij,nj->n", x, s.matrix, x))
    assert (value < 1e-13 * np.einsum("ni,ni->n", x, x) * np.abs(s.matrix).max()).all()
    # two steps of products: a digit where a point comes near to the centre
    assert apart(s.forward(x), p) < 1e-9
    assert incidence(s.forward(x), s.plane).max() < 1e-12
    # on the lines from the centre
    lines = join(s.center, p)
    assert apart(join(s.center, x), lines) < 1e-7


@pytest.mark.parametrize("case", range(6))
def test_triangles_become_quadratic_patches(case):
    s = cases()[case]
    rng = np.random.default_rng(case)
    basis = np.linalg.svd(s.plane[None])[2][1:]
    corners = rng.normal(size=(3, 3)) @ basis
    uvw = rng.dirichlet([1, 1, 1], 20)
    patch = s.triangle(corners)
    assert patch.degree == 2
    assert apart(patch.evaluate(0, uvw[:, :2]), s.inverse(uvw @ corners)) < 1e-9


def test_circles_stay_circles_and_angles_angles():
    s = StereographicProjection()
    rng = np.random.default_rng(2)
    for _ in range(10):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        u = np.linalg.svd(normal[None])[2][1:]
        height = rng.uniform(-0.7, 0.7)
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        x = height * normal + np.sqrt(1 - height**2) * (
            np.stack([np.cos(angle), np.sin(angle)], axis=1) @ u
        )
        image = affine(s.forward(point(x)))[:, :2]
        # the circle through three of its points holds all
        rows = np.column_stack([2 * image, np.ones(12)])
        rest = np.linalg.lstsq(rows, (image**2).sum(axis=1), rcond=None)
        size = np.abs(image).max()
        assert np.abs(rows @ rest[0] - (image**2).sum(axis=1)).max() < 1e-11 * (1 + size) ** 2
    # the angle of two curves through a point, by differences of second order
    p = rng.normal(size=(5, 2))
    h = 1e-5
    for x in p:
        plane = np.array([[1.0, 0], [np.cos(0.7), np.sin(0.7)]])
        ends = [affine(s.inverse(point(np.append(x + t * d, 0)))) for d in plane for t in (h, -h)]
        a, b = ends[0] - ends[1], ends[2] - ends[3]
        cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
        assert abs(cosine - np.cos(0.7)) < 1e-8


def test_what_the_map_does_with_the_tangent_plane():
    s = StereographicProjection()
    assert apart(s.inverse([1, 2, 1, 1]), s.center) < 1e-15  # a point of z = 1
    assert apart(s.inverse([1, 2, 0, 0]), s.center) < 1e-15  # an ideal point of the plane


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: StereographicProjection(center=[0, 0, 2, 1]), "a point on the quadric"),
        (lambda: StereographicProjection(plane=[0, 0, 1, -1]), "without the centre"),
        (
            lambda: StereographicProjection(np.diag([1.0, 1, -1, 0]), [0, 0, 0, 1], [0, 0, 1, -1]),
            "its vertex",
        ),
        (lambda: StereographicProjection(center=np.eye(4)), "one point and one plane"),
        (lambda: StereographicProjection(np.eye(3)), "A: expected"),
        (lambda: StereographicProjection().forward([0, 0, 0, 1]), "points of the quadric"),
        (lambda: StereographicProjection().forward([0, 0, 1, 1]), "other than the centre"),
        (lambda: StereographicProjection().inverse([0, 0, 2, 2]), "once more"),
    ],
)
def test_bad_projections(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
