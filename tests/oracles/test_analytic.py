"""Closed-form intersections against implicit equations, exact arithmetic and numpy.roots."""

from __future__ import annotations

from fractions import Fraction
from math import isqrt

import numpy as np
import pytest

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.oracles import analytic


def rays(seed: int, count: int, distance: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(count, 3))
    o *= distance / np.linalg.norm(o, axis=1)[:, None]
    return o, (rng.uniform(-1.5, 1.5, (count, 3)) - o) * rng.uniform(0.3, 3, (count, 1))


def points(hits: analytic.AnalyticHits, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    t = np.where(np.isfinite(hits.t), hits.t, 0.0)
    return o[:, None] + t[..., None] * d[:, None]


def radial(x: np.ndarray, point: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = axis / np.linalg.norm(axis)
    along = (x - point) @ a
    return np.linalg.norm(x - point - along[..., None] * a, axis=-1), along


P, A = np.array([0.2, -0.1, 0.3]), np.array([1.0, 2.0, -1.0])
M = np.diag([1.0, 2.0, -3.0, -0.5])  # a hyperboloid of one sheet

SURFACES = {
    "sphere": (
        lambda o, d: analytic.sphere(P, 1.2, o, d),
        lambda x: np.linalg.norm(x - P, axis=-1) - 1.2,
        {0, 2},
    ),
    "plane": (
        lambda o, d: analytic.plane(P, A, o, d),
        lambda x: (x - P) @ A / np.linalg.norm(A),
        {1},
    ),
    "cylinder": (
        lambda o, d: analytic.cylinder(P, A, 0.7, o, d),
        lambda x: radial(x, P, A)[0] - 0.7,
        {0, 2},
    ),
    "cone": (
        lambda o, d: analytic.cone(P, A, 0.6, o, d),
        lambda x: radial(x, P, A)[0] - 0.6 * np.abs(radial(x, P, A)[1]),
        {0, 2},
    ),
    "quadric": (
        lambda o, d: analytic.quadric(M, o, d),
        lambda x: ((x**2) @ [1.0, 2.0, -3.0] - 0.5) / np.maximum(1.0, (x**2).sum(axis=-1)),
        {0, 2},
    ),
    "torus": (
        lambda o, d: analytic.torus(P, A, 1.0, 0.4, o, d),
        lambda x: np.hypot(radial(x, P, A)[0] - 1.0, radial(x, P, A)[1]) - 0.4,
        {0, 2, 4},
    ),
}


@pytest.mark.parametrize("name", SURFACES)
def test_hits_lie_on_the_surface_and_misses_do_not_cross_it(name: str) -> None:
    intersect, implicit, counts = SURFACES[name]
    o, d = rays(1, 3000)
    hits = intersect(o, d)
    finite = np.isfinite(hits.t)
    x = points(hits, o, d)
    size = 1 + np.linalg.norm(x, axis=-1)
    # rounding of o + t d, and of a quartic for the torus
    assert (np.abs(implicit(x)) / size)[finite].max() < 1e-11
    assert set(np.unique(finite.sum(axis=1))) <= counts
    assert (hits.t[:, 1:] >= hits.t[:, :-1]).all()
    # sign changes along the line, counted on samples, are never more than the roots found
    s = np.linspace(-6, 6, 4001)
    value = implicit(o[:300, None] + s[:, None] * d[:300, None])
    changes = (np.diff(np.sign(value), axis=1) != 0).sum(axis=1)
    found = (np.abs(hits.t[:300]) < 6).sum(axis=1)
    if name == "cone":  # at the apex |along| has a kink, not a root: compare in both directions
        assert (found >= changes).all() and (found - changes <= 1).mean() > 0.9
    else:
        assert (changes <= found).all() and (changes == found).mean() > 0.95
    # normals: of length 1 and along the gradient
    h = 1e-6
    gradient = np.stack([implicit(x + h * e) - implicit(x - h * e) for e in np.eye(3)], axis=-1)
    gradient /= np.linalg.norm(gradient, axis=-1, keepdims=True)
    cosine = (gradient * hits.normals).sum(axis=-1)[finite]
    np.testing.assert_allclose(np.abs(cosine), 1, atol=1e-6)  # h^2 and rounding / h
    if name != "plane":
        assert (cosine > 0).all()


def test_sphere_is_right_to_the_last_digits_from_afar() -> None:
    """Exact integers decide hit or miss and give t to 60 digits."""
    rng = np.random.default_rng(2)
    o, d = rays(3, 300, distance=1e4)
    o, d = np.round(o * 2**20) / 2**20, np.round(d * 2**20) / 2**20
    # turn most of them near the silhouette
    side = np.cross(d, rng.normal(size=d.shape))
    side /= np.linalg.norm(side, axis=1)[:, None]
    o = side * (1 + rng.uniform(-1e-6, 1e-6, (300, 1))) - rng.uniform(0.5, 1, (300, 1)) * d
    hits = analytic.sphere((0, 0, 0), 1, o, d)
    for k in range(300):
        oo, dd = [Fraction(v) for v in o[k]], [Fraction(v) for v in d[k]]
        a = sum(v * v for v in dd)
        b = sum(v * w for v, w in zip(oo, dd))
        disc = b * b - a * (sum(v * v for v in oo) - 1)
        # eps |o| |d| of rounding moves the line by 2e-12; within that either answer is right
        if abs(float(hits.clearance[k])) > 1e-11:
            assert np.isfinite(hits.t[k, 0]) == (disc > 0)
        assert abs(float(-disc / a) - hits.clearance[k] * 2) < 1e-10  # (d - 1)(d + 1) ~ 2 (d - 1)
        if np.isfinite(hits.t[k, 0]) and disc > 0:
            root = Fraction(isqrt(int(disc * 10**120)), 10**60)
            exact = float((-b - root) / a)
            # t of order one: 1e4 / |d|; near the silhouette the error grows by 1 / cos
            half = float(root / a)
            assert abs(hits.t[k, 0] - exact) < 1e-15 + 1e-12 * 1e-4 / max(half, 1e-9)


def test_quadric_agrees_with_the_special_cases() -> None:
    o, d = rays(4, 2000)
    q = np.eye(4)
    q[:3, 3] = q[3, :3] = -P
    q[3, 3] = P @ P - 1.44
    one, two = analytic.quadric(5 * q, o, d), analytic.sphere(P, 1.2, o, d)
    hit = np.isfinite(two.t[:, 0])
    assert np.array_equal(np.isfinite(one.t[:, 0]), hit) and 0.2 < hit.mean() < 0.8
    np.testing.assert_allclose(one.t[hit], two.t[hit], rtol=0, atol=1e-12)  # near tangents
    near = np.abs(two.clearance) < 0.02
    assert near.sum() > 20
    # first order: the relative error is of the size of the clearance itself
    np.testing.assert_allclose(one.clearance[near], 1.2 * two.clearance[near], rtol=0.03)


def test_quadric_with_a_direction_to_infinity() -> None:
    paraboloid = np.diag([1.0, 1, 0, 0])
    paraboloid[2, 3] = paraboloid[3, 2] = -0.5  # x^2 + y^2 = z
    hits = analytic.quadric(paraboloid, [[1, 1, -3], [0, 0, 5]], [[0, 0, 2], [0, 0, -1]])
    np.testing.assert_allclose(hits.t, [[2.5, np.inf], [5, np.inf]], rtol=1e-15)
    assert (hits.clearance == -np.inf).all()  # no extremum along the line


def test_torus_agrees_with_numpy_roots() -> None:
    o, d = rays(5, 400)
    hits = analytic.torus((0, 0, 0), (0, 0, 1), 1.0, 0.4, o, d)
    for k in range(len(o)):
        a, b, c = d[k] @ d[k], o[k] @ d[k], o[k] @ o[k] + 1 - 0.16
        flat = [d[k, :2] @ d[k, :2], 2 * o[k, :2] @ d[k, :2], o[k, :2] @ o[k, :2]]
        square = np.polymul([a, 2 * b, c], [a, 2 * b, c])
        roots = np.roots(np.polysub(square, 4 * np.array(flat)))
        real = np.sort(roots.real[np.abs(roots.imag) < 1e-6])
        found = hits.t[k][np.isfinite(hits.t[k])]
        if abs(hits.clearance[k]) > 1e-6:  # nearly double roots: numpy.roots may leave the axis
            assert len(real) == len(found)
            # the companion matrix is good to eps^(1/2) where roots are close
            np.testing.assert_allclose(found, real, atol=1e-6)


def test_torus_clearance_is_the_distance_from_the_silhouette() -> None:
    rng = np.random.default_rng(6)
    height = 0.4 + rng.uniform(-1e-3, 1e-3, 200)
    o = np.column_stack([rng.uniform(-0.2, 0.2, 200), np.full(200, -3.0), height])
    hits = analytic.torus((0, 0, 0), (0, 0, 1), 1.0, 0.4, o, np.tile([0.0, 1.0, 0.0], (200, 1)))
    # the line runs across the top circle of both sides of the ring
    np.testing.assert_allclose(hits.clearance, height - 0.4, rtol=0.01)
    assert np.array_equal(np.isfinite(hits.t).sum(axis=1), np.where(height < 0.4, 4, 0))


def test_first_takes_the_range_into_account() -> None:
    hits = analytic.sphere((0, 0, 0), 1, [[0, 0, -3]], [[0, 0, 2]])
    assert hits.t.tolist() == [[1, 2]]
    assert hits.first()[0] == 1
    assert hits.first(tmin=1.5)[0] == 2
    assert hits.first(tmin=1.5, tmax=1.7)[0] == np.inf
    assert hits.first(tmax=1)[0] == 1


def test_lines_inside_a_surface_and_parallel_lines() -> None:
    plane = analytic.plane((0, 0, 0), (0, 0, 1), [[0, 0, 1], [0, 0, 0]], [[1, 0, 0]] * 2)
    assert (plane.t == np.inf).all() and (plane.normals == 0).all()
    cylinder = analytic.cylinder((0, 0, 0), (0, 0, 1), 1, [[1, 0, 0], [0, 0, 0]], [[0, 0, 1]] * 2)
    assert (cylinder.t == np.inf).all()


def test_errors_name_the_parameter() -> None:
    o, d = [[0, 0, -3]], [[0, 0, 1]]
    for call, name in (
        (lambda: analytic.sphere((0, 0), 1, o, d), "center"),
        (lambda: analytic.sphere((0, 0, 0), -1, o, d), "radius"),
        (lambda: analytic.sphere((0, 0, 0), np.inf, o, d), "radius"),
        (lambda: analytic.plane((0, 0, 0), (0, 0, 0), o, d), "normal"),
        (lambda: analytic.cone((0, 0, 0), (0, 0, 1), 0, o, d), "slope"),
        (lambda: analytic.torus((0, 0, 0), (0, 0, 1), 1, np.nan, o, d), "minor"),
        (lambda: analytic.quadric(np.zeros((4, 4)), o, d), "A"),
        (lambda: analytic.quadric(np.eye(3), o, d), "A"),
        (lambda: analytic.sphere((0, 0, 0), 1, o, [[0, 0, 0]]), "directions"),
        (lambda: analytic.sphere((0, 0, 0), 1, [[0, np.nan, 0]], d), "origins"),
        (lambda: analytic.sphere((0, 0, 0), 1, o + o, d), "directions"),
    ):
        with pytest.raises(GeometryError, match=f"^{name}: expected"):
            call()
