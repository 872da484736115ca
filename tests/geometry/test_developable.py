"""Developable surfaces from control planes."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart, collineation

from mitsuba_bezier.errors import GeometryError, NetError
from mitsuba_bezier.geometry import projective as pg
from mitsuba_bezier.geometry.developable import (
    DevelopableSurface,
    developable_residual,
    gaussian_curvature,
)
from mitsuba_bezier.geometry.tensor import tensor_to_triangles

T = np.linspace(0, 1, 11)
BOTTOM, TOP = np.array([0, 0, 1.0, 0]), np.array([0, 0, 1.0, -1])

degrees = pytest.mark.parametrize("degree", [2, 3, 4, 5])
seeds = pytest.mark.parametrize("seed", range(4))


def ribbon(degree: int, seed: int = 0) -> DevelopableSurface:
    """Planes that turn about the vertical by less than half a turn: a well-shaped ribbon."""
    rng = np.random.default_rng([degree, seed])
    angle = np.linspace(0.2, 2.4, degree + 1)
    normal = np.stack([np.cos(angle), np.sin(angle), rng.uniform(-0.3, 0.3, degree + 1)], axis=1)
    offset = rng.uniform(0.8, 1.2, (degree + 1, 1))
    return DevelopableSurface(np.concatenate([normal, -offset], axis=1))


@degrees
@seeds
def test_trace_planes_rulings_and_tangent_planes(degree, seed):
    surface = ribbon(degree, seed)
    net = surface.net(BOTTOM, TOP)
    assert net.shape == (2 * degree - 1, 2, 4)
    rulings, planes = surface.ruling(T), surface.tangent_plane(T)
    for side, trace_plane in enumerate((BOTTOM, TOP)):
        trace = surface.trace(trace_plane)
        assert trace.degree == 2 * degree - 2
        x = trace.evaluate(T)
        # polynomials of degree 8 in vectors of order 1: rounding 1e-15, two digits of margin
        assert apart(net[0, side], trace.control_points[0]) < 1e-15
        assert pg.incidence(x, trace_plane).max() < 1e-13
        assert pg.incidence(x, planes).max() < 1e-13
        assert apart(x, pg.meet(rulings, trace_plane)) < 1e-12
        assert pg.incidence(trace.tangent(T)[:, None], rulings[:, None]).max() < 1e-12
    coefficients = surface.ruling_coefficients
    assert coefficients.shape == (2 * degree - 1, 6)
    np.testing.assert_allclose(coefficients[[0, -1]], rulings[[0, -1]], atol=1e-14)


@degrees
@seeds
def test_gaussian_curvature_is_zero(degree, seed):
    surface = ribbon(degree, seed)
    triangles = surface.patch(BOTTOM, TOP)
    assert triangles.degree == 2 * degree - 1
    assert len(triangles) == 2
    rng = np.random.default_rng(seed)
    uv = rng.dirichlet([1, 1, 1], 50)[:, :2]
    for p in (0, 1):
        d = triangles.differential(p, uv)
        k = gaussian_curvature(d)
        # against the squared mean-type curvature of the same points: second derivatives of a
        # rational patch of degree 9 are good to 1e-10 of their size
        n = np.cross(d.dp_du, d.dp_dv)
        area = np.linalg.norm(n, axis=1)
        second = [np.abs((n * x).sum(axis=1)) for x in (d.d2p_duu, d.d2p_duv, d.d2p_dvv)]
        scale = np.max(second, axis=0) ** 2 / area**4
        assert np.abs(k / scale).max() < 1e-9
        assert scale.min() > 1e-4  # the ribbon is curved; zero is not trivial
    # the check sees a ruled surface that is not developable
    twisted = surface.net(BOTTOM, TOP)
    twisted[1, 1, 0] += 0.3 * twisted[1, 1, 3]
    d = tensor_to_triangles(twisted).differential(0, uv)
    assert np.abs(gaussian_curvature(d)).max() > 1e-4


@degrees
@seeds
def test_exact_developability(degree, seed):
    surface = ribbon(degree, seed)
    net = surface.net(BOTTOM, TOP)
    # tangents of both boundaries at equal t meet: a polynomial of degree up to 32 vanishes
    assert developable_residual(net) < 1e-13
    m = collineation(np.random.default_rng(seed), 4)
    assert developable_residual(net @ m.T) < 1e-13  # projectively invariant
    net[1, 1, 0] += 1e-3 * net[1, 1, 3]
    assert developable_residual(net) > 1e-6
    assert developable_residual(np.random.default_rng(seed).normal(size=(4, 2, 4))) > 1e-3


def test_curvature_of_known_surfaces():
    from mitsuba_bezier.geometry.covers import sphere

    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]
    ball = sphere(radius=2.0)
    # second derivatives of the quartic octant, of size 10: rounding 1e-13
    np.testing.assert_allclose(gaussian_curvature(ball.differential(0, uv)), 1 / 4, rtol=1e-11)
    # z = x y is ruled: K = -1 / (1 + x^2 + y^2)^2
    saddle = tensor_to_triangles([[[0, 0, 0, 1], [0, 1, 0, 1]], [[1, 0, 0, 1], [1, 1, 1, 1]]])
    d = saddle.differential(0, uv)
    expected = -1 / (1 + d.p[:, 0] ** 2 + d.p[:, 1] ** 2) ** 2
    np.testing.assert_allclose(gaussian_curvature(d), expected, rtol=1e-12)


@pytest.mark.parametrize("degree", [3, 4, 5])
@seeds
def test_regression_curve(degree, seed):
    surface = ribbon(degree, seed)
    curve = surface.regression_curve()
    assert curve.degree == 3 * degree - 6
    rulings = surface.ruling(T)
    # the rulings are the tangents; where the curve is nearly a cusp these lose half the digits
    assert apart(curve.tangent(T), rulings) < 1e-7
    assert apart(curve.osculating_plane(T), surface.tangent_plane(T)) < 1e-6
    assert surface.apex() is None


@seeds
def test_cone_and_cylinder(seed):
    cone = ribbon(2, seed)  # three planes always meet
    apex = cone.apex()
    assert pg.incidence(cone.tangent_plane(T), apex).max() < 1e-14
    assert all(ribbon(2, 10 * seed + k).apex()[3] > 0 for k in range(10))
    with pytest.raises(GeometryError, match="cone or cylinder"):
        cone.regression_curve()
    net = np.random.default_rng(seed).normal(size=(5, 4))
    net[:, 2] = 0  # normals are horizontal: a vertical cylinder
    cylinder = DevelopableSurface(net)
    assert apart(cylinder.apex(), np.array([0, 0, 1, 0])) < 1e-12
    net[:, 2] = 0.3
    net[:, 3] = -(net[:, :3] @ [1, 2, 3])  # through (1, 2, 3)
    assert apart(DevelopableSurface(net).apex(), np.array([1, 2, 3, 1])) < 1e-12


def test_quarter_of_a_round_cone():
    # x^2 + y^2 = (1 - z)^2 has the tangent planes (cos a, sin a, 1, -1); as a rational quadratic
    # from a = 0 to a = pi/2 they have the weights 1, cos 45, 1
    h = np.sqrt(0.5)
    surface = DevelopableSurface([[1, 0, 1, -1], [h, h, h, -h], [0, 1, 1, -1]])
    assert apart(surface.apex(), np.array([0, 0, 1, 1])) < 1e-15
    patch = surface.patch(BOTTOM, [0, 0, 1, -0.5])
    rng = np.random.default_rng(0)
    for p in (0, 1):
        x, y, z = patch.points(p, rng.dirichlet([1, 1, 1], 30)[:, :2]).T
        np.testing.assert_allclose(np.hypot(x, y), 1 - z, rtol=1e-13)  # degree 3: rounding
        assert ((x >= 0) & (y >= 0) & (z > 0) & (z < 0.5)).all()


def test_finite_rulings_whatever_the_signs_of_the_planes():
    surface = ribbon(3)
    for e, f in ((BOTTOM, TOP), (-BOTTOM, TOP), (BOTTOM, -TOP), (-BOTTOM, -TOP)):
        net = surface.net(e, f)
        x = surface.patch(e, f).points(0, [[0.3, 0.3], [0.5, 0.1]])
        assert (x[:, 2] > 0).all()
        assert (x[:, 2] < 1).all()  # between the planes
        assert (net[..., 3] > 0).all()


def test_collineation_of_the_planes():
    surface = ribbon(4)
    m = collineation(np.random.default_rng(0), 4)
    inverse = np.linalg.inv(m)
    image = DevelopableSurface(surface.control_planes @ inverse)
    a = surface.trace(BOTTOM).evaluate(T) @ m.T
    b = image.trace(BOTTOM @ inverse).evaluate(T)
    assert apart(a, b) < 1e-12


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda s: DevelopableSurface(np.eye(4)[:2]), NetError, "n >= 2"),
        (lambda s: DevelopableSurface(np.full((4, 4), np.nan)), GeometryError, "finite"),
        (lambda s: DevelopableSurface("ab"), GeometryError, "numbers"),
        (
            lambda s: DevelopableSurface([[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0]]),
            GeometryError,
            "one pencil",
        ),
        (lambda s: s.net(BOTTOM, 2 * BOTTOM), GeometryError, "same element"),
        (lambda s: s.trace(np.zeros(4)), GeometryError, "zero vector"),
        (lambda s: s.trace([0, 0, 1]), GeometryError, "4 numbers"),
        (lambda s: s.trace(np.eye(4)), GeometryError, "one plane"),
        (lambda s: s.trace(s.tangent_plane(0.3)), GeometryError, "t = 0.3"),
        (lambda s: s.trace(s.control_planes[0]), GeometryError, "t = 0"),
        (lambda s: s.trace(s.control_planes[-1]), GeometryError, "t = 1"),
        (lambda s: developable_residual(np.zeros((3, 3, 4))), NetError, "shape (m+1, 2, 4)"),
    ],
)
def test_bad_input(call, error, says):
    with pytest.raises(error) as caught:
        call(ribbon(3))
    assert says in str(caught.value)


def test_plane_through_the_apex_is_refused():
    cone = ribbon(2)
    apex = cone.apex()
    plane = pg.join(apex, pg.point([5.0, 1, 0.3]), pg.point([4.0, -3, 2]))
    with pytest.raises(GeometryError, match="apex"):
        cone.trace(plane)


def test_singular_points_are_refused():
    flat = tensor_to_triangles([[[0, 0, 0, 1], [1, 0, 0, 1]], [[0, 0, 0, 1], [2, 0, 0, 1]]])
    with pytest.raises(GeometryError, match="singular"):
        gaussian_curvature(flat.differential(0, [[0.3, 0.3]]))
