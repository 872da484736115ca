"""Plane regions with curved boundaries, surfaces trimmed by curves, and what they rest on."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.tensor import evaluate_tensor
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io.cad.composition import compose
from mitsuba_bezier.io.cad.curved_triangles import curved_triangle, jacobian_ratio
from mitsuba_bezier.io.cad.plane_regions import chain, region_to_triangles, standard
from mitsuba_bezier.io.cad.polygons import crossing, signed_area, triangulate
from mitsuba_bezier.io.cad.pull_back import foot_points, grid_axes, pulled_back
from mitsuba_bezier.io.cad.trimmed_patches import cut, fit_parabolas, trimmed_patches
from mitsuba_bezier.io.nurbs_surface import PatchGrid
from mitsuba_bezier.io.trims import rectangles, rectilinear


def line(a, b) -> np.ndarray:
    return np.array([[*a, 1], [*b, 1]], float)


def polygon(*points) -> list[np.ndarray]:
    return [line(a, b) for a, b in zip(points, points[1:] + points[:1])]


def circle(center, radius, pieces=4) -> list[np.ndarray]:
    """A circle as rational parabolas."""
    out = []
    h = np.pi / pieces
    for k in range(pieces):
        a = 2 * h * k
        rows = [(np.cos(a), np.sin(a), 1), (np.cos(a + h), np.sin(a + h), np.cos(h))]
        rows.append((np.cos(a + 2 * h), np.sin(a + 2 * h), 1))
        arc = np.array(rows)
        arc[:, :2] = arc[:, :2] * radius + np.array(center) * arc[:, 2:]
        out.append(arc)
    return out


def cubic_blob() -> list[np.ndarray]:
    """A smooth closed curve of polynomial cubics; area in closed form below."""
    rows = [[(1, 0), (1, 0.6), (0.5, 1), (0, 1)], [(0, 1), (-0.7, 1), (-1, 0.4), (-1, 0)]]
    rows += [[(-1, 0), (-1, -0.5), (-0.4, -0.7), (0, -0.7)]]
    rows += [[(0, -0.7), (0.6, -0.7), (1, -0.5), (1, 0)]]
    return [np.column_stack([np.array(r, float), np.ones(4)]) for r in rows]


def polynomial_area(curves) -> float:
    """The integral of (x dy - y dx) / 2 of polynomial curves, by their products."""
    total = 0.0
    for c in curves:
        n = len(c) - 1
        d = n * np.diff(c[:, :2], axis=0)
        for i in range(n + 1):
            for j in range(n):
                weight = comb(n, i) * comb(n - 1, j) / comb(2 * n - 1, i + j) / (2 * n)
                total += weight * (c[i, 0] * d[j, 1] - c[i, 1] * d[j, 0]) / 2
    return total


GAUSS = np.polynomial.legendre.leggauss(24)
S = (GAUSS[0] + 1) / 2
UV = np.stack([np.repeat(S, 24), np.outer(1 - S, S).ravel()], axis=1)
WEIGHT = (np.outer(GAUSS[1] * (1 - S), GAUSS[1]) / 4).ravel()


def plane_area(nets) -> tuple[float, float]:
    """Return the total area and the smallest Jacobian at the Gauss points."""
    total, least = 0.0, np.inf
    for net in nets:
        flat = BezierTriangles(np.column_stack([net[:, :2], np.zeros(len(net)), net[:, 2]]))
        d = flat.differential(0, UV)
        jacobian = d.dp_du[:, 0] * d.dp_dv[:, 1] - d.dp_du[:, 1] * d.dp_dv[:, 0]
        total += WEIGHT @ jacobian
        least = min(least, jacobian.min())
    return total, least


RECT = polygon((0, 0), (4, 0), (4, 4), (0, 4))
REGIONS = {
    "disk": ([circle((0, 0), 1)], np.pi),
    "disk of two arcs": ([circle((3, 1), 1, 3)], np.pi),
    "clockwise": ([[c[::-1] for c in circle((0, 0), 1)[::-1]]], np.pi),
    "square": ([polygon((0, 0), (1, 0), (1, 1), (0, 1))], 1),
    "plate with holes": (
        [circle((1, 1), 0.5), RECT, circle((2.7, 1), 0.9), circle((2, 3), 0.3)],
        16 - np.pi * (0.25 + 0.81 + 0.09),
    ),
    "island in a hole": ([RECT, circle((2, 2), 1.5), circle((2, 2), 1)], 16 - np.pi * 1.25),
    "two outlines": ([circle((0, 0), 1), circle((5, 0), 2)], 5 * np.pi),
    "thin ring": ([circle((0, 0), 1), circle((0, 0), 0.99)], np.pi * (1 - 0.99**2)),
    "nearly tangent": ([circle((0, 0), 1), circle((0.299, 0), 0.7)], np.pi * 0.51),
    "near holes": (
        [RECT, circle((1, 2), 0.999), circle((3, 2), 0.999)],
        16 - 2 * np.pi * 0.999**2,
    ),
    # an arc that leaves a line along its tangent: a corner of angle zero
    "cusp": (
        [[line((0, 0), (1, 0)), line((1, 0), (1, 1)), circle((0, 1), 1)[3][::-1]]],
        1 - np.pi / 4,
    ),
    "cubics": ([cubic_blob()], polynomial_area(cubic_blob())),
    "comb": (
        [polygon(*[(x, 0) for x in range(10)], *[(9 - x, 3 if x % 2 else 1) for x in range(10)])],
        18.0,
    ),
}


@pytest.mark.parametrize("loops, area", REGIONS.values(), ids=REGIONS.keys())
@pytest.mark.parametrize("shift", [(0, 0), (1000, -300)])
def test_regions_are_filled_exactly(loops, area, shift):
    moved = []
    for loop in loops:
        moved.append([c + c[:, 2:] * [*shift, 0] for c in loop])
    nets = region_to_triangles(moved)
    assert not isinstance(nets, str), nets
    total, least = plane_area(nets)
    # rounding of some hundred terms, of numbers as large as the shift squared, at worst
    assert total == pytest.approx(area, abs=1e-12 * (1 + np.hypot(*shift)))
    assert least > 0


def test_regions_keep_their_boundary():
    """All of a circle's points, and only those, are on the boundary of the disk's patches."""
    nets = region_to_triangles([circle((2, 1), 3)])
    t = np.linspace(0, 1, 11)
    length = 0.0
    for net in nets:
        n = bernstein.degree_of(len(net))
        for a, b in ((0, 1), (1, 2), (2, 0)):
            uvw = np.zeros((11, 3))
            uvw[:, a], uvw[:, b] = 1 - t, t
            points = bernstein.basis(n, uvw[:, :2]) @ net
            points = points[:, :2] / points[:, 2:]
            distance = np.linalg.norm(points - [2, 1], axis=1)
            if distance[1:-1].max() < 3 - 1e-6:
                continue  # a side inside
            np.testing.assert_allclose(distance, 3, atol=1e-14)
            angle = np.arctan2(*(points - [2, 1]).T[::-1])
            length += abs(np.angle(np.exp(1j * (angle[-1] - angle[0]))))
    assert length == pytest.approx(2 * np.pi)


@pytest.mark.parametrize(
    "loops, reason",
    [
        ([polygon((0, 0), (1, 1), (1, 0), (0, 2))], "cross itself"),
        ([[line((0, 0), (1, 0)), line((1, 0), (0, 0))]], "no area"),
        ([[*circle((0, 0), 1)[:2], line((-1, 0), (0.5, 0.9)), line((0.5, 0.9), (1, 0))]], "cross"),
    ],
)
def test_regions_that_cannot_be_filled(loops, reason):
    assert reason in region_to_triangles(loops)


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("e", [0, 1, 2])
def test_curved_triangle_has_its_sides(n, e):
    corners = np.array([[0, 0], [1, 0], [0.3, 0.9]])
    rng = np.random.default_rng(n)
    side = np.linspace(0, 1, n + 1)[:, None] * (corners[(e + 1) % 3] - corners[e]) + corners[e]
    side = np.column_stack([side, np.ones(n + 1)])
    side[1:-1, :2] += rng.normal(scale=0.05, size=(n - 1, 2))
    side[1:-1] *= rng.uniform(0.8, 1.2, (n - 1, 1))
    sides = [None, None, None]
    sides[e] = side
    net = curved_triangle(corners, sides)
    for k in range(3):
        index = np.zeros((n + 1, 3), int)
        index[:, k] = n - np.arange(n + 1)
        index[:, (k + 1) % 3] = np.arange(n + 1)
        rows = [bernstein.row(n, i, j) for i, j, _k in index.tolist()]
        straight = np.linspace(0, 1, n + 1)[:, None] * (corners[(k + 1) % 3] - corners[k])
        straight = np.column_stack([straight + corners[k], np.ones(n + 1)])
        # 1e-15: a few roundings of numbers below 1
        np.testing.assert_allclose(net[rows], side if k == e else straight, atol=1e-15)
    assert jacobian_ratio(net) > 0.3


def test_standard_keeps_the_curve():
    rng = np.random.default_rng(0)
    curve = np.column_stack([rng.normal(size=(4, 2)), rng.uniform(0.5, 2, 4)])
    curve[:, :2] *= curve[:, 2:]
    other = standard(curve)
    assert other[0, 2] == other[-1, 2] == 1
    # the same points at other parameters: three points fix the Möbius map; compare implicitly
    t = np.linspace(0, 1, 9)
    r = (curve[0, 2] / curve[-1, 2]) ** (1 / 3)
    s = t / (r * (1 - t) + t)
    for c, at in ((curve, t), (other, s)):
        basis = np.stack([comb(3, i) * at**i * (1 - at) ** (3 - i) for i in range(4)], axis=1)
        h = basis @ c
        points = h[:, :2] / h[:, 2:]
        if c is curve:
            expected = points
    np.testing.assert_allclose(points, expected, atol=1e-14)


def test_chain():
    curves = [c for loop in (circle((0, 0), 1), RECT) for c in loop]
    rng = np.random.default_rng(3)
    mixed = [curves[k] if rng.random() < 0.5 else curves[k][::-1] for k in rng.permutation(8)]
    loops = chain(mixed, 1e-9)
    assert sorted(map(len, loops)) == [4, 4]
    assert chain(mixed[:-1], 1e-9) is None


# ---------------------------------------------------------------------------- polygons


def test_triangulate_random_stars():
    rng = np.random.default_rng(0)
    for _ in range(20):
        m = int(rng.integers(4, 40))
        angle = np.sort(rng.uniform(0, 2 * np.pi, m))
        if np.diff([*angle, angle[0] + 2 * np.pi]).max() > np.pi:
            continue
        points = rng.uniform(0.2, 1, m)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        faces = triangulate(points, [list(range(m))])
        assert faces.shape == (m - 2, 3)
        areas = [signed_area(points[f]) for f in faces]
        assert min(areas) > 0
        assert sum(areas) == pytest.approx(signed_area(points), abs=1e-14)


def test_triangulation_is_delaunay_inside():
    points = np.array([[0, 0], [4, 0], [4, 1], [0, 1], [2, 0.9]], float)
    faces = {frozenset(f) for f in triangulate(points, [[0, 1, 2, 4, 3]]).tolist()}
    assert faces == {frozenset(f) for f in ((0, 1, 4), (1, 2, 4), (0, 4, 3))}


def test_crossing():
    points = np.array([[0, 0], [1, 1], [1, 0], [0, 1], [3, 3], [4, 4]], float)
    assert crossing(points, np.array([[0, 1], [2, 3], [4, 5]])) == {0, 1}
    assert crossing(points, np.array([[0, 1], [1, 2], [2, 0]])) == set()


# ---------------------------------------------------------------------------- trims


def patch(p=2, q=3, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    s, t = np.meshgrid(np.linspace(0, 1, p + 1), np.linspace(0, 1, q + 1), indexing="ij")
    net = np.stack([s, t, rng.normal(scale=0.3, size=s.shape), np.ones(s.shape)], axis=-1)
    return net * rng.uniform(0.7, 1.4, (p + 1, q + 1, 1))


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("p, q", [(1, 1), (2, 3), (3, 3)])
def test_compose(n, p, q):
    rng = np.random.default_rng(n)
    net = patch(p, q)
    domain = np.array([[2.0, 5.0], [-1.0, 0.5]])
    triangle = np.column_stack(
        [
            rng.uniform(2, 5, bernstein.size(n)),
            rng.uniform(-1, 0.5, bernstein.size(n)),
            np.ones(bernstein.size(n)),
        ]
    ) * rng.uniform(0.8, 1.2, (bernstein.size(n), 1))
    out = BezierTriangles(compose(net, domain, triangle))
    assert out.degree == n * (p + q)
    uv = rng.dirichlet([1, 1, 1], 30)[:, :2]
    at = bernstein.basis(n, uv) @ triangle
    st = (at[:, :2] / at[:, 2:] - domain[:, 0]) / (domain[:, 1] - domain[:, 0])
    h = evaluate_tensor(net, st)
    # 1e-13: products of up to six factors near 1, summed
    np.testing.assert_allclose(out.points(0, uv), h[:, :3] / h[:, 3:], atol=1e-13)


def test_cut_halves_a_disk():
    below, above = cut(circle((0, 0), 1), 0, 0.5, 1e-9)
    cap = np.arccos(0.5) - 0.5 * np.sqrt(0.75)
    for side, area in ((below, np.pi - cap), (above, cap)):
        nets = region_to_triangles(chain(side, 1e-9))
        # 1e-9: the roots of the polynomials, at which the circle is cut, are that exact
        assert plane_area(nets)[0] == pytest.approx(area, abs=1e-9)


def test_cut_with_edges_on_the_line():
    """An L whose inner corner lies on the line, and with an edge along it."""
    bent = polygon((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))
    for value, areas in ((1.0, (2.0, 1.0)), (2.0, (3.0, 0.0)), (0.0, (0.0, 3.0))):
        parts = cut(bent, 0, value, 1e-9)
        for side, area in zip(parts, areas):
            if area == 0:
                assert not side
                continue
            nets = region_to_triangles(chain(side, 1e-9))
            assert plane_area(nets)[0] == pytest.approx(area, abs=1e-14)


def test_fit_parabolas():
    def ellipse(t):
        return np.stack([3 * np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], axis=1)

    for tolerance in (1e-3, 1e-6):
        pieces = fit_parabolas(ellipse, np.ones(2), tolerance)
        t = np.linspace(0, 1, 33)
        basis = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=1)
        points = np.concatenate([(basis @ c)[:, :2] for c in pieces])
        # the distance from the ellipse is the value of its equation over its gradient
        value = (points[:, 0] / 3) ** 2 + points[:, 1] ** 2 - 1
        gradient = 2 * np.hypot(points[:, 0] / 9, points[:, 1])
        # 2: the distance is measured at two places of each piece
        assert np.abs(value / gradient).max() < 2 * tolerance
    assert len(pieces) < 150
    assert fit_parabolas(lambda t: np.random.default_rng(0).normal(size=(len(t), 2)), 1, 0) is None


@pytest.mark.parametrize("degrees", [(1, 1), (2, 2), (3, 2)])
def test_trimmed_patches(degrees):
    """A wavy graph over a disk with a hole, knots inside: area of its plan, points on it."""
    p, q = degrees
    knots_u = np.array([0.0] * (p + 1) + [1.3, 2.0] + [4.0] * (p + 1))
    knots_v = np.array([0.0] * (q + 1) + [2.2] + [4.0] * (q + 1))
    m, n = len(knots_u) - p - 1, len(knots_v) - q - 1
    greville = [
        np.array([k[i + 1 : i + d + 1].mean() for i in range(count)])
        for k, d, count in ((knots_u, p, m), (knots_v, q, n))
    ]
    x, y = np.meshgrid(*greville, indexing="ij")  # so that x = u and y = v
    z = np.random.default_rng(0).normal(size=x.shape)
    net = np.stack([x, y, z, np.ones(x.shape)], axis=-1)
    loops = [*circle((2, 2), 1.9), *circle((2.5, 2), 0.6)]
    surface = PatchGrid.from_nurbs(net, knots_u, knots_v, degrees)
    nets = trimmed_patches(surface, loops)
    assert not isinstance(nets, str), nets
    area = 0.0
    for part in nets:
        t = BezierTriangles(part)
        for k in range(len(t)):
            d = t.differential(k, UV)
            area += WEIGHT @ (d.dp_du[:, 0] * d.dp_dv[:, 1] - d.dp_du[:, 1] * d.dp_dv[:, 0])
            on = surface.jet(d.p[::50, :2])[0]
            np.testing.assert_allclose(d.p[::50], on, atol=1e-12)
    # 1e-8: cuts at the knots are placed to that; everything else is exact
    assert area == pytest.approx(np.pi * (1.9**2 - 0.36), abs=1e-8)


def test_trimmed_patches_without_a_closed_boundary():
    net = patch(1, 1)
    knots = np.array([0.0, 0, 1, 1])
    curves = circle((0.5, 0.5), 0.3)[:3]
    assert "closed" in trimmed_patches(PatchGrid.from_nurbs(net, knots, knots, (1, 1)), curves)


def test_rectangles():
    outer = [np.array([a, b], float) for a, b in (((0, 0), (3, 0)), ((3, 0), (3, 2)))]
    outer += [np.array([a, b], float) for a, b in (((3, 2), (0, 2)), ((0, 2), (0, 0)))]
    hole = [np.array([a, b], float) for a, b in (((1, 1), (2, 1)), ((2, 1), (2, 1.5)))]
    hole += [np.array([a, b], float) for a, b in (((2, 1.5), (1, 1.5)), ((1, 1.5), (1, 1)))]
    tolerance = np.full(2, 1e-9)
    boxes = rectangles(rectilinear([outer, hole], tolerance), tolerance)
    sizes = boxes[..., 1] - boxes[..., 0]
    assert np.prod(sizes, axis=1).sum() == pytest.approx(6 - 0.5)
    assert len(boxes) == 4  # left, right, below and above the hole
    slanted = [np.array([(0, 0), (1, 0.1)])]
    assert rectilinear([slanted], tolerance) is None


# ---------------------------------------------------------------------------- surfaces


def test_closest_and_pull_back():
    net = patch(2, 3, seed=5)
    surface = PatchGrid.from_nurbs(net, [0, 0, 0, 2, 2, 2], [1, 1, 1, 1, 3, 3, 3, 3], (2, 3))
    uv = np.random.default_rng(0).uniform([0.05, 1.05], [1.95, 2.95], (20, 2))
    points, du, dv = surface.jet(uv)
    h = evaluate_tensor(net, np.column_stack([uv[:, 0] / 2, (uv[:, 1] - 1) / 2]))
    np.testing.assert_allclose(points, h[:, :3] / h[:, 3:], atol=1e-14)
    step = 1e-6
    for axis, d in ((0, du), (1, dv)):
        ahead, behind = (surface.jet(uv + s * step * np.eye(2)[axis])[0] for s in (1, -1))
        # 1e-9: the cube of the step's error is below the rounding over the step, 1e-16 / 1e-6
        np.testing.assert_allclose(d, (ahead - behind) / (2 * step), atol=1e-8)
    axes = grid_axes(surface)
    found, off = foot_points(surface, axes, points, uv + 0.04)
    np.testing.assert_allclose(found, uv, atol=1e-12)
    assert off.max() < 1e-13
    # the edge v = 1 of the patch is a curve on it
    edge = net[:, 0]
    t = np.linspace(0, 1, 7)
    back = pulled_back(surface, axes, edge[None])[0][0](t)
    np.testing.assert_allclose(back, np.column_stack([2 * t, np.ones(7)]), atol=1e-7)
