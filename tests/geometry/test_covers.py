"""Closed covers: of the sphere, after a triangulation, of other quadrics."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from geometry_cases import rotation
from surface_checks import implicit, parameters, unpaired_edges, volume, winding

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import covers
from mitsuba_bezier.geometry.covers import (
    quadric_cover,
    ruled_cover,
    sphere,
    sphere_face,
    sphere_lune,
)
from mitsuba_bezier.geometry.quadric_types import collineation_to_paraboloid
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.geometry.triangulations import triangulated

SPHERE = np.diag([1.0, 1, 1, -1])
NORTH, SOUTH, EAST = [[0, 0, 1]], [[0, 0, -1]], [[1, 0, 0]]
NAMES = {"octants": (8, 4), "tetrahedral": (10, 2), "lunes": (4, 2)}


def hull(points: np.ndarray) -> np.ndarray:
    """Return the faces of the convex hull, outwards: all triples with all points on one side."""
    faces = []
    for i, j, k in combinations(range(len(points)), 3):
        normal = np.cross(points[j] - points[i], points[k] - points[i])
        side = (points - points[i]) @ normal
        side[[i, j, k]] = 0
        if (side <= 0).all():
            faces.append([i, j, k])
        elif (side >= 0).all():
            faces.append([i, k, j])
    return np.array(faces)


def random_triangulation(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points whose hull contains the origin, and its faces."""
    while True:
        p = rng.normal(size=(count, 3))
        p /= np.linalg.norm(p, axis=1, keepdims=True)
        f = hull(p)
        if (np.linalg.det(p[f]) > 0.01).all():
            return p, f


OCTAHEDRON = (
    np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]],
)


def assert_covers_unit_sphere(patches: BezierTriangles, seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    patch, uv = parameters(rng, len(patches), 2000)
    x = patches.evaluate(patch, uv)
    # rounding of a polynomial with positive or nearly positive terms
    assert implicit(SPHERE, x) < 1e-14
    normals = patches.normals(patch, uv)
    points = patches.points(patch, uv)
    # 1e-7: next to collapsed edges the cross product is small and loses digits
    assert np.abs(normals - points).max() < 1e-7
    # the quadrature stops at 1e-10
    assert abs(patches.area().sum() / (4 * np.pi) - 1) < 1e-9
    assert not unpaired_edges(patches)


@pytest.mark.parametrize("name", NAMES)
def test_named_covers(name):
    patches = sphere(cover=name)
    assert (len(patches), patches.degree) == NAMES[name]
    assert_covers_unit_sphere(patches)
    assert (patches.weights >= 0).all()
    assert abs(volume(patches) / (4 * np.pi / 3) - 1) < 1e-9  # the rule's error after 2 splits


@pytest.mark.parametrize("name", NAMES)
def test_sphere_is_placed(name):
    c = np.array([1.0, -2, 3])
    patches = sphere(c, 0.5, name)
    patch, uv = parameters(np.random.default_rng(2), len(patches), 100)
    assert np.allclose(np.linalg.norm(patches.points(patch, uv) - c, axis=1), 0.5, rtol=1e-14)
    # the angle of a surface seen from inside and outside; quadrature error 1e-6 at this distance
    assert abs(winding(patches, c + 0.1) - 1) < 1e-5
    assert abs(winding(patches, c + 1.0)) < 1e-5


def test_octant_net_is_the_published_one():
    net = sphere().control_points[0]
    r2, r3 = np.sqrt(2), np.sqrt(3)
    assert np.allclose(net[[0, 10, 14], :3] / net[[0, 10, 14], 3:], np.eye(3))
    assert np.isclose(net[0, 3], 4 * r3 * (r3 - 1)) and np.isclose(net[3, 3], 4)
    assert np.allclose(net[1] / net[1, 3], [1, (r3 - 1) / r3, 0, 1])
    assert np.isclose(net[4, 3], r2 / r3 * (3 + 2 * r2 - r3))


def test_tetrahedral_cover_is_four_faces_and_six_lunes():
    area = sphere(cover="tetrahedral").area() / (4 * np.pi)
    assert np.allclose(area, [1 / 6] * 4 + [1 / 18] * 6, rtol=1e-9)


def test_lune_area_is_twice_its_angle():
    # arcs of great circles between poles, named by points of their other halves
    for angle in (0.1, 1.0, np.pi / 2, 3.0):
        other = [np.cos(angle), np.sin(angle), 0]
        for pair in ([1, 0, 0], other), (other, [1, 0, 0]):
            net = BezierTriangles(sphere_lune([0, 0, -1], [0, 0, 1], *pair))
            # 1e-6: where the quadrature is told to stop
            assert np.isclose(net.area(1e-6)[0], 2 * angle, rtol=1e-6)
            x = net.points(0, [[0.3, 0.3]])[0]
            assert x @ net.normals(0, [[0.3, 0.3]])[0] > 0.999


def test_arcs_avoid_their_third_point_even_when_long():
    # small circles around the z and x axes through the same two points
    start, end = np.array([0.64, 0.48, 0.6]), np.array([0.64, -0.48, 0.6])
    first, second = np.array([0.8, 0, 0.6]), np.array([0.64, 0, np.sqrt(1 - 0.64**2)])
    patch = BezierTriangles(sphere_lune(start, end, first, second))
    t = np.linspace(0.01, 0.99, 99)
    edges = [
        patch.points(0, np.column_stack([1 - t, t])),
        patch.points(0, np.column_stack([1 - t, 0 * t])),
    ]
    for other, fixed in ((first, 2), (second, 0)):
        edge = min(edges, key=lambda e: np.ptp(e[:, fixed]))
        assert np.allclose(edge[:, fixed], other[fixed], atol=1e-14)
        # the side of the chord is told by the remaining coordinate
        k = 2 - fixed
        assert ((edge[:, k] - start[k]) * (other[k] - start[k]) < 0).all()


@pytest.mark.parametrize("count", [4, 6, 9, 14])
def test_random_triangulations(count):
    rng = np.random.default_rng(count)
    points, faces = random_triangulation(rng, count)
    patches = triangulated(points, faces)
    assert patches.degree == 2 and len(patches) >= len(faces) * 5 // 2
    assert_covers_unit_sphere(patches)
    # the faces come first, with the given points as corners
    corners = patches.control_points[: len(faces), [0, 3, 5]]
    assert np.allclose(corners[..., :3] / corners[..., 3:], points[faces], atol=1e-14)


def test_tetrahedron_gives_the_tetrahedral_cover():
    net = covers.tetrahedral().control_points[:4, [0, 3, 5]]
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    faces = np.argmax(net[..., :3] @ points.T, axis=2)
    patches = triangulated(points, faces)
    assert np.allclose(patches.control_points[:4], covers.tetrahedral().control_points[:4])
    assert np.allclose(np.sort(patches.area()), np.sort(covers.tetrahedral().area()))


def test_octahedron_and_nearly_hemispherical_faces():
    assert_covers_unit_sphere(triangulated(*OCTAHEDRON))
    # three points near the equator: faces of almost a hemisphere, lunes of more than half a turn
    a, e = np.array([0.0, 2.2, 4.4]), 0.02
    ring = np.column_stack([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.full(3, np.sin(e))])
    points = np.vstack([ring, [0, 0, -1]])
    patches = triangulated(points, [[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]])
    assert len(patches) > 10  # some lunes had to be cut
    assert_covers_unit_sphere(patches)


def test_points_rounded_to_float32_are_accepted():
    points, faces = random_triangulation(np.random.default_rng(5), 8)
    assert_covers_unit_sphere(triangulated(points.astype(np.float32), faces))


def test_triangulation_as_cover_of_other_shapes():
    cover = triangulated(*OCTAHEDRON)
    patches = sphere((1, 1, 1), 2, cover)
    assert abs(volume(patches) / (4 / 3 * np.pi * 8) - 1) < 1e-9
    assert len(quadric_cover(np.diag([1.0, 4, 9, -1]), cover)) == len(cover)


def _octahedron(change) -> tuple[np.ndarray, np.ndarray]:
    points, faces = OCTAHEDRON[0].copy(), np.array(OCTAHEDRON[1])
    return change(points, faces)


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("points: .*unit sphere, got distance 1.1 of point 0", lambda p, f: (p * [1.1, 1, 1], f)),
        ("points: .*shape", lambda p, f: (p[:, :2], f)),
        ("points: .*NaN", lambda p, f: (p * np.nan, f)),
        ("faces: .*integers", lambda p, f: (p, f.astype(float))),
        ("faces: .*integers", lambda p, f: (p, f[:, :2])),
        ("faces: .*integers", lambda p, f: (p, f[:0])),
        ("faces: .*point numbers 0 .. 5", lambda p, f: (p, f + 1)),
        ("faces: .*three different points", lambda p, f: (p, np.vstack([f, [0, 0, 1]]))),
        ("faces: .*gap: edge", lambda p, f: (p, f[1:])),
        ("faces: .*same orientation, got edge", lambda p, f: (p, np.vstack([f[:1, ::-1], f[1:]]))),
        ("faces: .*same orientation, got edge", lambda p, f: (p, np.vstack([f, f[:1]]))),
        ("faces: .*seen from outside, got all", lambda p, f: (p, f[:, ::-1])),
        # point 4 moved through the equator: its four faces are turned inwards
        (
            "faces: .*within a hemisphere",
            lambda p, f: (np.vstack([p[:4], [0.6, 0, -0.8], p[5:]]), f),
        ),
        # a face on a great circle has no inside
        (
            "faces: .*within a hemisphere",
            lambda p, f: (np.vstack([p[:4], [[0.6, 0.8, 0]], p[5:]]), f),
        ),
    ],
)
def test_triangulation_errors(message, change):
    with pytest.raises(GeometryError, match=message):
        triangulated(*_octahedron(change))


def test_double_cover_is_refused():
    # the double pyramid over a pentagram: every face is turned outwards, but it goes round twice
    a = np.arange(5) * 4 * np.pi / 5
    ring = np.column_stack([np.cos(a), np.sin(a), np.zeros(5)])
    points = np.vstack([ring, [[0, 0, 1], [0, 0, -1]]])
    faces = [[i, (i + 1) % 5, 5] for i in range(5)] + [[(i + 1) % 5, i, 6] for i in range(5)]
    with pytest.raises(GeometryError, match="covers the sphere once, got 2 times"):
        triangulated(points, faces)


@pytest.mark.parametrize("name", NAMES)
def test_ellipsoid_cover(name):
    rng = np.random.default_rng(6)
    m = np.eye(4)
    m[:3, :3] = rotation(rng, 3) @ np.diag([0.5, 1, 2])
    m[:3, 3] = [1, 2, 3]
    inverse = np.linalg.inv(m)
    a = inverse.T @ SPHERE @ inverse
    patches = quadric_cover(-a, name)  # the sign of A does not count
    patch, uv = parameters(rng, len(patches), 500)
    assert implicit(a, patches.evaluate(patch, uv)) < 1e-14
    assert not unpaired_edges(patches)
    assert abs(volume(patches) / (4 / 3 * np.pi) - 1) < 1e-9  # outwards, once


@pytest.mark.parametrize(
    "a", [np.diag([1.0, 4, -1, 1]), [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 0, -1], [0, 0, -1, 3]]]
)
def test_other_ovals_are_closed_in_projective_space(a):
    a = np.array(a, dtype=float)
    patches = quadric_cover(a)
    rng = np.random.default_rng(7)
    patch, uv = parameters(rng, len(patches), 500)
    assert implicit(a, patches.evaluate(patch, uv)) < 1e-14
    # a collineation that takes it back to an ellipsoid closes it in affine space, too
    to_sphere = np.linalg.inv(covers._FROM_SPHERE["elliptic paraboloid"])
    back = patches.transform(to_sphere @ collineation_to_paraboloid(a).matrix)
    assert not unpaired_edges(back)
    assert np.isclose(back.area().sum(), 4 * np.pi, rtol=1e-9)


@pytest.mark.parametrize(
    "a", [np.diag([1.0, 4, -1, -1]), [[1, 0, 0, 0], [0, -2, 0, 0], [0, 0, 0, -1], [0, 0, -1, 3]]]
)
def test_ruled_cover(a):
    a = np.array(a, dtype=float)
    patches = ruled_cover(a)
    assert (len(patches), patches.degree) == (8, 2)
    rng = np.random.default_rng(8)
    patch, uv = parameters(rng, 8, 500)
    assert implicit(a, patches.evaluate(patch, uv)) < 1e-14
    # closed: every edge is met by one other edge, as points of projective space
    s = np.linspace(0, 1, 5)[1:-1]
    sides = [(1 - s, s), (0 * s, 1 - s), (s, 0 * s)]
    edges = np.array(
        [patches.evaluate(p, np.column_stack(side)) for p in range(8) for side in sides]
    )
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    # 1 - |cos| of the angle between points as lines through the origin
    met = (np.abs(np.einsum("esc,fsc->efs", edges, edges[:, ::-1])) > 1 - 1e-12).all(axis=2)
    assert (met.sum(axis=1) == 1).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sphere(radius=0), "radius: expected a positive length, got 0"),
        (lambda: sphere(radius=-1), "radius: .*positive"),
        (lambda: sphere(radius=np.nan), "radius: .*finite"),
        (lambda: sphere(radius=(1, 2)), "radius: .*a finite number, got shape"),
        (lambda: sphere(center=(0, 0)), "center: .*shape"),
        (lambda: sphere(center=(0, 0, np.inf)), "center: .*NaN or infinity"),
        (lambda: sphere(cover="cube"), "cover: expected one of 'octants', .*got 'cube'"),
        (lambda: quadric_cover(np.diag([1.0, 1, -1, 0])), "A: expected an oval quadric .*got cone"),
        (lambda: quadric_cover(np.eye(4)), "A: .*imaginary ellipsoid"),
        (lambda: quadric_cover(SPHERE, 3), "cover: "),
        (lambda: ruled_cover(SPHERE), "A: expected a ruled quadric, got ellipsoid"),
        (lambda: sphere_lune(*NORTH, *NORTH, *EAST, [0, 1, 0]), "start, end: .*two different"),
        (lambda: sphere_lune(*NORTH, *EAST, *NORTH, [0, 1, 0]), "start, first: .*two different"),
        (
            lambda: sphere_lune(*NORTH, *SOUTH, *EAST, *EAST),
            "first, second: .*two arcs at an angle",
        ),
        (lambda: sphere_lune(*NORTH, *SOUTH, *EAST, [-1, 0, 0]), "first, second: .*half a turn"),
        (lambda: sphere_lune(*NORTH, *SOUTH, [2, 0, 0], *EAST), "first: .*unit sphere"),
        (lambda: sphere_face([*NORTH, *EAST, *SOUTH], [-1, 0, 0]), "center: .*off the plane"),
        (lambda: sphere_face([*NORTH, *EAST, *SOUTH], *EAST), "center: .*no corner"),
        (lambda: sphere_face([*NORTH, *EAST, [0, 2, 0]], *SOUTH), "corners: .*unit sphere"),
    ],
)
def test_errors(call, message):
    with pytest.raises(GeometryError, match=message):
        call()
