"""Nets, curves, labels and arrows in scenes."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb
from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import conics
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.plugins.pieces.curves import tube_points

NET = mb.quadric_patch(
    np.diag([1.0, 1, 1, -1]), [0, 0, 1, 1], [[1, 0, 0, 1], [0, 1, 0, 1], [-0.6, -0.8, 0, 1]]
)
PATCH = mb.BezierTriangles(NET)


@pytest.fixture(autouse=True)
def variant():
    before = mi.variant()
    mi.set_variant(VARIANT)
    yield
    if before:
        mi.set_variant(before)


def hit(scene, origin, direction):
    o, d = mi.Point3f(*map(float, origin)), mi.Vector3f(*map(float, direction))
    return mb.ray_intersect(scene, mi.Ray3f(o, d))


def load(**pieces):
    return mi.load_dict({"type": "scene", **pieces})


def test_a_net_has_its_points_and_legs():
    pieces = mb.net_shapes(PATCH, 0.01)
    balls = [v for k, v in pieces.items() if "point" in k]
    legs = [v for k, v in pieces.items() if "leg" in k]
    assert len(balls) == 6 and len(legs) == 9
    own = sorted(tuple(np.round(b["center"], 9)) for b in balls)
    x = NET[:, :3] / NET[:, 3:]
    assert own == sorted(tuple(p) for p in np.round(x, 9))
    scene = load(**pieces)
    for p in x:  # from above onto each control point
        si = hit(scene, p + np.array([0, 0, 5]), [0, 0, -1])
        assert float(si.t[0]) < 5 - 0.026 + 1e-4  # its ball, or a leg above it


def test_shared_legs_are_made_once():
    two = PATCH.split()
    shared = mb.net_shapes(two, 0.01)
    # four nets of six points: 15 points and 30 legs together, not 24 and 36
    assert sum("point" in k for k in shared) == 15
    assert sum("leg" in k for k in shared) == 30
    curve = BezierCurve.from_points([[0, 0], [1, 1], [2, 0]])
    assert sum("leg" in k for k in mb.net_shapes(curve, 0.01)) == 2


def test_control_vectors_are_arrows():
    ground = mb.BezierTriangles([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    pieces = mb.net_shapes(ground, 0.02, vector_length=2.0)
    assert sum("point" in k for k in pieces) == 1 and sum("leg" in k for k in pieces) == 0
    assert sorted(k for k in pieces if "vector" in k) == [
        f"net_vector_{k}_{part}" for k in (0, 1) for part in ("head", "shaft")
    ]
    scene = load(**pieces)
    for way in ([1, 0, 0], [0, 1, 0]):  # the tip is where it should be
        si = hit(scene, 9 * np.array(way), -np.array(way))
        assert abs(float(si.t[0]) - 7) < 1e-3


def test_an_arrow_points_from_start_to_end():
    a, b = np.array([0.3, -0.2, 0.1]), np.array([1.0, 0.7, -0.4])
    scene = load(**mb.arrow(a, b, 0.01))
    way = (b - a) / np.linalg.norm(b - a)
    si = hit(scene, b + way, -way)
    assert abs(float(si.t[0]) - 1) < 1e-4
    side = np.cross(way, [0, 0, 1])
    side /= np.linalg.norm(side)
    si = hit(scene, (a + b) / 2 + side, -side)
    assert abs(float(si.t[0]) - 0.99) < 1e-4
    si = hit(scene, b - 0.09 * way + side, -side)  # where the head begins, three times as wide
    assert abs(float(si.t[0]) - 0.97) < 2e-3


@pytest.mark.parametrize("parts", [16, 32, 64])
def test_tubes_follow_their_curve_to_fourth_order(parts):
    arc = conics.ellipse_arc((0, 0, 0), (1, 0, 0), (0, 1, 0), 0, 2)
    (points,) = tube_points(arc, 0.01, parts, 100.0)
    assert points.shape == (parts + 3, 4)
    # the middle of each cubic segment, from its four control points
    c = np.lib.stride_tricks.sliding_window_view(points[:, :3], 4, axis=0)
    middle = c @ np.array([1, 23, 23, 1]) / 48
    off = np.abs(np.linalg.norm(middle, axis=1) - 1).max()
    assert off < 0.5 * (2.2 / parts) ** 4  # of the angle of a segment, some 2 / parts


def test_boundary_curves_lie_on_the_surface():
    pieces = mb.boundary_curves(PATCH, 0.01)
    scene = load(**pieces)
    # from outside, towards points of the boundary: the tube's radius before it
    for k in range(3):
        t = np.linspace(0.1, 0.9, 5)
        ends = np.eye(3)
        uvw = np.outer(1 - t, ends[k]) + np.outer(t, ends[(k + 1) % 3])
        for x in PATCH.points(0, uvw[:, :2]):
            n = x / np.linalg.norm(x)
            si = hit(scene, x + n, -n)
            assert abs(float(si.t[0]) - 0.99) < 2e-4


def test_shared_edges_are_one_curve():
    ball = mb.sphere()
    assert len(ball) == 8
    (tubes,) = mb.boundary_curves(ball, 0.01, parts=8).values()
    # twelve edges of eight triangles, of 8 segments each
    assert tubes.primitive_count() == 12 * 8


def test_isoparametric_lines():
    (tubes,) = mb.isoparametric_lines(PATCH, 0.005, lines=3, parts=8, name="iso").values()
    assert tubes.primitive_count() == 3 * 3 * 8
    # those through infinity are cut
    branch = mb.BezierTriangles([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    (tubes,) = mb.isoparametric_lines(branch, 0.005, lines=2, reach=20.0).values()
    assert 0 < float(np.abs(np.array(tubes.bbox().max)).max()) < 25


def test_labels_are_plane_and_stand_where_they_should():
    pytest.importorskip("fontTools", reason="labels need the extra 'figures'")
    pytest.importorskip("matplotlib", reason="its font")
    from mitsuba_bezier.plugins.pieces.labels import text_patches

    at = np.array([0.5, 0.2, 1.0])
    for anchor, x, y in (("center", 0, 0), ("left", 0.5, 0), ("above", 0, 0.5)):
        patches = text_patches("HIH", at, 0.3, (0, 1, 0), (0, 0, 1), anchor)
        box = patches.bounds()
        low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0)
        assert abs(low[0] - 0.5) < 1e-12 and abs(high[0] - 0.5) < 1e-12  # in the plane x = 0.5
        size, middle = high - low, (low + high) / 2
        # the side bearings of H, a tenth of its width, are the same on both sides
        assert abs(middle[1] - at[1] - x * size[1]) < 0.1 * size[1]
        assert abs(middle[2] - at[2] - y * size[2]) < 1e-9
        assert abs(size[2] - 0.3 * 0.729) < 1e-3
    scene = load(**mb.label("I", at, 0.3, right=(0, 1, 0)))
    si = hit(scene, at + np.array([1, 0, 0]), [-1, 0, 0])
    assert abs(float(si.t[0]) - 1) < 1e-5
    assert not bool(hit(scene, at + np.array([1, 0.1, 0]), [-1, 0, 0]).is_valid()[0])
    # an O has a hole
    scene = load(**mb.label("O", (0, 0, 0), 1.0))
    assert not bool(hit(scene, [0, -1, 0], [0, 1, 0]).is_valid()[0])


def test_pieces_merge_into_a_scene():
    scene = load(
        ball=mb.shape(PATCH),
        **mb.net_shapes(PATCH, 0.01),
        **mb.boundary_curves(PATCH, 0.01),
        **mb.arrow([0, 0, 0], [0, 0, 1], 0.02),
    )
    assert len(scene.shapes()) == 1 + 15 + 1 + 2


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: mb.net_shapes(PATCH, 0), "radius: expected a positive length"),
        (lambda: mb.net_shapes("patch", 0.1), "BezierTriangles or a BezierCurve"),
        (lambda: mb.net_shapes(PATCH, 0.1, vector_length=-1), "vector_length"),
        (
            lambda: mb.net_shapes(mb.BezierTriangles(np.eye(4)[:3]), 0.1),
            "a finite control point",
        ),
        (lambda: mb.arrow([0, 0, 0], [0, 0, 0], 0.1), "two different points"),
        (lambda: mb.arrow([0, 0], [0, 0, 1], 0.1), "start"),
        (lambda: mb.boundary_curves(3, 0.1), "BezierTriangles"),
        (lambda: mb.boundary_curves(PATCH, 0.1, parts=1), "integer >= 4"),
        (lambda: mb.boundary_curves(PATCH, 0.1, reach=1e-6), "within reach"),
        (lambda: mb.isoparametric_lines(PATCH, 0.1, lines=0), "integer >= 1"),
        (lambda: mb.label("a", (0, 0, 0), 0), "size"),
        (lambda: mb.label("a", (0, 0, 0), 1, anchor="top"), "one of left, center"),
        (lambda: mb.label("a", (0, 0, 0), 1, right=(0, 0, 1)), "independent directions"),
    ],
)
def test_bad_pieces(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
