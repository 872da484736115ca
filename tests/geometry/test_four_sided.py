"""The patchwork theorem: triangles and four-sided patches cover a quadric without gap."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from geometry_cases import apart, collineation

import mitsuba_bezier as mb
from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.four_sided import boundary_curve, four_sided_net, patchwork
from mitsuba_bezier.geometry.projective import point
from mitsuba_bezier.geometry.tensor import evaluate_tensor

SPHERE = np.diag([1.0, 1, 1, -1])


def tetrahedral(seed: int) -> tuple[np.ndarray, list]:
    """Four faces over points of the sphere, each from a centre of its own, and their edges."""
    rng = np.random.default_rng(seed)
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    corners = corners + 0.2 * rng.normal(size=(4, 3))
    corners /= np.linalg.norm(corners, axis=1)[:, None]
    faces = [[k for k in range(4) if k != skip] for skip in range(4)]
    nets = []
    for skip, face in enumerate(faces):
        x = corners[face]
        if np.linalg.det(x) < 0:
            face[1], face[2] = face[2], face[1]
            x = corners[face]
        # any centre in the region opposite to the face: about the corner that was skipped
        center = corners[skip] + 0.15 * rng.normal(size=3)
        center /= np.linalg.norm(center)
        nets.append(mb.quadric_patch(SPHERE, point(center), point(x)))
    edges = {}
    for p, face in enumerate(faces):
        for e in range(3):
            edges.setdefault(frozenset((face[e], face[(e + 1) % 3])), []).append((p, e))
    return np.array(nets), [tuple(pair) for pair in edges.values()]


@pytest.mark.parametrize("seed", range(5))
def test_faces_and_four_sided_patches_cover_the_sphere(seed):
    nets, neighbours = tetrahedral(seed)
    assert len(neighbours) == 6
    between = patchwork(SPHERE, nets, neighbours)
    faces = mb.BezierTriangles(nets)
    # areas with their sign along the outward normal: where neighbours overlap, a patch between
    # them turns its other side out, and is counted negatively
    total = faces.area().sum()
    for k in range(6):
        two = between[2 * k : 2 * k + 2]
        uv = np.full((2, 2), 1 / 3)
        x, n = two.points([0, 1], uv), two.normals([0, 1], uv)
        assert np.allclose(np.linalg.norm(x, axis=1), 1, atol=1e-12)
        side = np.sign((x * n).sum(axis=1))
        assert side[0] == side[1]
        # which side is out depends on the order of the pair: its first edge runs with its face,
        # the patch lies to the right of it
        total += -side[0] * two.area().sum() * orientation(faces, neighbours[k][0])
    assert abs(total - 4 * np.pi) < 1e-8  # the area is integrated to 1e-10 a patch


def orientation(faces: mb.BezierTriangles, edge: tuple[int, int]) -> float:
    p, _e = edge
    x = faces.points(p, [[1 / 3, 1 / 3]])[0]
    return float(np.sign(x @ faces.normals(p, [[1 / 3, 1 / 3]])[0]))


@pytest.mark.parametrize("seed", range(5))
def test_the_sides_are_the_neighbours_edges(seed):
    rng = np.random.default_rng(seed)
    nets, neighbours = tetrahedral(seed)
    m = collineation(rng, 4)  # on any oval quadric
    back = np.linalg.inv(m)
    a = back.T @ SPHERE @ back
    nets = nets @ m.T
    st = rng.uniform(0, 1, (40, 2))
    for (p, e), (q, f) in neighbours:
        first, second = boundary_curve(nets[p], e), boundary_curve(nets[q], f).reverse()
        net = four_sided_net(a, first, second)
        x = evaluate_tensor(net, st)
        value = np.einsum("ni,ij,nj->n", x, a, x)
        # products of three control points of size about 1
        assert np.abs(value).max() < 1e-10 * np.abs(x).max() ** 2
        # sides 0 and 2 are the arcs (as conics), the others are the corners
        for column, arc in ((0, first), (2, second)):
            own = BezierCurve(net[:, column])
            s = np.linspace(0, 1, 9)
            seen = own.evaluate(s)
            plane = np.linalg.svd(arc.control_points)[2][3]
            flat = np.abs(seen @ plane) / np.linalg.norm(seen, axis=1)
            assert flat.max() < 1e-12
            assert apart(own.control_points[1], arc.control_points[1]) < 1e-10
            assert apart(seen[[0, -1]], arc.control_points[[0, 2]]) < 1e-9
            # the arc, not its complement: one positive factor for each control point, up to r^k
            ratio = [float(u @ v / (v @ v)) for u, v in zip(own.control_points, arc.control_points)]
            assert ratio[0] * ratio[2] > 0
            assert np.isclose(ratio[1] ** 2, ratio[0] * ratio[2], rtol=1e-8)
        assert apart(net[0], np.broadcast_to(first.control_points[0], (3, 4))) < 1e-14
        assert apart(net[2], np.broadcast_to(first.control_points[2], (3, 4))) < 1e-14


def test_a_ruled_quadric_too():
    ruled = np.diag([1.0, 1, -1, -1])
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(20):
        angle, z = rng.uniform(0, 2 * np.pi, 4), rng.uniform(-1, 1, 4)
        x = np.stack([*(np.sqrt(1 + z**2) * [np.cos(angle), np.sin(angle)]), z], axis=1)
        p = point(x)
        one = mb.quadric_patch(ruled, p[2], p[[0, 1, 3]])
        two = mb.quadric_patch(ruled, p[3], p[[0, 1, 2]])
        try:
            net = four_sided_net(ruled, boundary_curve(one, 0), boundary_curve(two, 0))
        except GeometryError:
            continue  # a plane of the pencil touches: no patch between these arcs
        found += 1
        y = evaluate_tensor(net, rng.uniform(0, 1, (20, 2)))
        assert np.abs(np.einsum("ni,ij,nj->n", y, ruled, y)).max() < 1e-9 * np.abs(y).max() ** 2
    assert found > 5


def test_known_lunes_are_these_patches():
    """The cover by lunes has the area that the theorem gives."""
    nets = mb.sphere(cover="tetrahedral").control_points
    faces = nets[:4]
    a = SPHERE
    ends = {}
    for p, e in itertools.product(range(4), range(3)):
        arc = boundary_curve(faces[p], e)
        key = frozenset(tuple(np.round(arc.points(t), 9)) for t in (0.0, 1.0))
        ends.setdefault(key, []).append((p, e))
    between = patchwork(a, faces, [tuple(pair) for pair in ends.values()])
    lunes = mb.sphere(cover="tetrahedral").area()[4:]
    own = between.area().reshape(6, 2).sum(axis=1)
    np.testing.assert_allclose(own, lunes, rtol=1e-8)


CIRCLE = BezierCurve([[1, 0, 0, 1], [1, 1, 0, 1], [0, 1, 0, 1]])
R = np.sqrt(0.5)
ARC = BezierCurve([[1, 0, 0, 1], [R, R, 0, R], [0, 1, 0, 1]])


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: four_sided_net(SPHERE, CIRCLE, CIRCLE), "first: expected an arc on the quadric"),
        (
            lambda: four_sided_net(SPHERE, BezierCurve(np.eye(4)[:2]), CIRCLE),
            "a curve of degree 2",
        ),
        (
            lambda: four_sided_net(SPHERE, BezierCurve([[x, 0, 0, 1] for x in (0, 1, 2)]), CIRCLE),
            "dependent control points",
        ),
        (lambda: boundary_curve(np.eye(4), 0), "a quadratic net"),
        (lambda: boundary_curve(np.ones((6, 4)), 3), "0, 1 or 2"),
        (lambda: patchwork(SPHERE, np.ones((1, 6, 4)), []), "at least one pair"),
    ],
)
def test_bad_patchworks(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)


def test_arcs_must_share_their_ends():
    turned = BezierCurve(ARC.control_points[:, [1, 2, 0, 3]])
    with pytest.raises(GeometryError, match="second: expected an arc with the ends of the first"):
        four_sided_net(SPHERE, ARC, turned)
