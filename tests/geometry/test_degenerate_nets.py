"""Nets with a factor, and nets that are no surfaces: hits as they should be, none, or one error."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.contours import contour_segments, edge_segments
from mitsuba_bezier.geometry.proper_nets import free_of_factor, spans_area
from mitsuba_bezier.leaves.builder import build_leaves

GOOD = [[-1, -1, 0.2], [1, -1, 0.2], [0, 1, 0.2]]


@pytest.fixture(autouse=True)
def _variant() -> None:
    mi.set_variant(VARIANT)


def planar(degree: int, corners: Any, weight: float = 1.0) -> np.ndarray:
    """Return the net of a triangle, elevated."""
    points = bernstein.multi_indices(degree) / degree @ np.array(corners, dtype=float)
    return np.column_stack([points, np.full(len(points), weight)])


def scene(nets: np.ndarray, tensor: Any = None, **more: Any) -> Any:
    nets = np.asarray(nets, dtype=float)
    nets = nets if nets.ndim == 3 else nets[None]
    tensor = (tensor or mi.TensorXd)(nets.ravel(), nets.shape)
    return mi.load_dict(
        {"type": "scene", "s": {"type": "beziertriangle", "control_points": tensor, **more}}
    )


def down(count: int = 200) -> Any:
    """Return rays from above at the unit square, from -1 to 1."""
    x, y = np.random.default_rng(3).uniform(-1, 1, (2, count)).astype(np.float32)
    return mi.Ray3f(mi.Point3f(x, y, 5.0), mi.Vector3f(0, 0, -1))


def answers(s: Any, rays: Any) -> list[np.ndarray]:
    si = mb.ray_intersect(s, rays)
    return [np.array(x) for x in (si.t, si.p, si.n, si.dp_du, si.uv)]


# ------------------------------------------------------------------ factors


FACTORS = [1e-300, 1e-150, 1e-38, 1e-20, 1e20, 1e39, 1e150, 1e300, -1.0, -1e-300, -1e300]


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("body", ["sphere", "torus"])
def test_factors_of_nets_mean_nothing(body, factor):
    patches = {"sphere": mb.sphere, "torus": lambda: mb.torus()[:4]}[body]()
    nets = patches.control_points
    rays = down()
    one, other = scene(nets), scene(nets * factor)
    for a, b in zip(answers(one, rays), answers(other, rays)):
        assert (np.isfinite(a) == np.isfinite(b)).all()
        # rounding of hits in float32, where rays graze some more
        assert np.allclose(a, b, rtol=1e-5, atol=2e-5)
    a, b = (s.shapes()[0] for s in (one, other))
    assert np.allclose(a.surface_area(), b.surface_area(), rtol=1e-6)
    for corner in ("min", "max"):
        # the boxes may be a thousandth larger than the surface
        assert np.allclose(getattr(a.bbox(), corner), getattr(b.bbox(), corner), atol=4e-3)
    many = mb.BezierTriangles(nets * factor)
    uv = [[0.2, 0.3]]
    assert np.allclose(many.points(0, uv), patches.points(0, uv), rtol=1e-14)
    assert np.allclose(many.normals(0, uv), patches.normals(0, uv), rtol=1e-13)
    assert np.allclose(many.area(), patches.area(), rtol=1e-9)
    assert np.allclose(many.bounds(), patches.bounds(), atol=1e-12)
    assert (many.control_points == nets * factor).all()
    shown = np.array(other.shapes()[0].control_points)
    assert np.isfinite(shown).all() and shown.any(axis=(1, 2)).all()
    if 1e-30 <= abs(factor) <= 1e30:  # what the user gave
        assert np.allclose(shown / np.float32(factor), nets, rtol=1e-6, atol=1e-6)


def test_each_patch_may_have_its_own_factor():
    nets = mb.sphere().control_points
    factors = np.array([1e-300, -1e300, 1e-20, 1e20, -1, 1e-38, 1e39, 7])[:, None, None]
    for a, b in zip(answers(scene(nets), down()), answers(scene(nets * factors), down())):
        assert np.allclose(a, b, rtol=1e-5, atol=2e-5)


@pytest.mark.parametrize("factor", [1e-38, 1e-30, 1e30, 1e37, -1e37])
def test_factors_in_float32(factor):
    nets = mb.sphere().control_points
    s = scene(nets * factor, mi.TensorXf)
    for a, b in zip(answers(scene(nets, mi.TensorXf), down()), answers(s, down())):
        assert np.allclose(a, b, rtol=1e-5, atol=2e-5)
    shown = np.array(mi.traverse(s)["s.control_points"])
    assert (shown == (nets * factor).astype(np.float32)).all()


@pytest.mark.parametrize("factor", [1e-20, 1e15, -3.0])
def test_derivatives_by_nets_with_a_factor(factor):
    nets = planar(2, GOOD)[None]

    def derivative(by: float) -> np.ndarray:
        s = scene(nets * by)
        params = mi.traverse(s)
        points = params["s.control_points"]
        dr.enable_grad(points)
        params.update()
        si = mb.ray_intersect(s, mi.Ray3f([0.1, -0.2, 5], [0, 0, -1]))
        dr.backward(si.t)
        return np.array(points.grad)

    assert np.abs(derivative(1.0)).max() > 0.1
    # a net times f moves f times less with its numbers; a rounding or two of float32
    expected = derivative(1.0)
    assert np.allclose(derivative(factor) * factor, expected, atol=3e-6 * np.abs(expected).max())


def test_freed_nets_differ_by_powers_of_two():
    nets = mb.sphere().control_points[:3] * np.array([3e-310, -5.0, 1e300])[:, None, None]
    free = free_of_factor(nets)
    assert ((np.abs(free[..., 3]).max(axis=1) >= 1) & (np.abs(free[..., 3]).max(axis=1) < 2)).all()
    entries = nets[1:] != 0
    assert (np.abs(np.frexp(free[1:][entries] / nets[1:][entries])[0]) == 0.5).all()
    same = mb.sphere().control_points
    assert free_of_factor(same, 3) is same


# ------------------------------------------------------------------ no surfaces


def degenerate(degree: int) -> dict[str, np.ndarray]:
    ijk = bernstein.multi_indices(degree)
    i, zero, one = ijk[:, 0] / degree, np.zeros(len(ijk)), np.ones(len(ijk))
    ideal = planar(degree, GOOD, 0.0)
    return {
        "point": planar(degree, [[1, 2, 3]] * 3),
        "origin": planar(degree, [[0, 0, 0]] * 3),
        "line": planar(degree, [[0, 0, 0], [1, 1, 1], [0.3, 0.3, 0.3]]),
        "line far away": planar(
            degree, [[1000, 2000.3, 0], [1001.1, 2001.4, 1.1], [1000.3, 2000.6, 0.3]]
        ),
        "one edge": planar(degree, [[0, 0, 0], [1, 0, 0], [1, 0, 0]]),
        "points on a line": np.column_stack([np.cos(7 * ijk[:, 0]), zero, zero, one]),
        "parabola": np.column_stack([i, i**2, zero, one]),
        "rounding": planar(degree, [[1, 1, 1], [1 + 1e-20, 1, 1], [1, 1 + 1e-20, 1]]),
        "1e-45": planar(degree, [[0, 0, 0], [1e-45, 0, 0], [0, 1e-45, 0]]),
        "1e-200": planar(degree, [[0, 0, 0], [1e-200, 0, 0], [0, 1e-200, 0]]),
        "at infinity": ideal,
        "nearly": np.column_stack([ideal[:, :3], 1e-40 * one]),
    }


NAMES = list(degenerate(1))


@pytest.mark.parametrize("degree", [1, 2, 4])
@pytest.mark.parametrize("name", NAMES)
def test_nets_that_are_no_surfaces_are_met_by_no_ray(name, degree):
    net = degenerate(degree)[name]
    assert not spans_area(net[None])[0]
    s = scene(net)
    si = mb.ray_intersect(s, down(20))
    assert dr.width(si.t) == 20 and not np.array(si.is_valid()).any()
    assert not np.array(mb.ray_test(s, down(20))).any()
    assert np.isfinite([s.bbox().min, s.bbox().max]).all()
    # among others they change nothing
    good = planar(degree, GOOD)
    alone, among = scene(good), scene(np.stack([net, good, net]))
    for a, b in zip(answers(alone, down()), answers(among, down())):
        assert (a == b).all()
    assert np.array(mb.ray_intersect(among, down()).prim_index).max() == 1
    assert (np.array(alone.bbox().max) == np.array(among.bbox().max)).all()


def test_an_arc_over_three_corners_is_no_surface():
    # the blossom of a parabola at 1, 1/2, 0: three corners that are independent
    at = np.array([1, 0.5, 0])
    pairs = at[[[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]]]
    net = np.column_stack([pairs.mean(axis=1), pairs.prod(axis=1), 0 * pairs[:, 0], np.ones(6)])
    assert not spans_area(net[None])[0]
    assert len(build_leaves(mb.BezierTriangles(net))) == 0


def test_thin_and_small_and_far_patches_are_surfaces():
    for corners in (
        [[0, 0, 0], [1, 0, 0], [0, 1e-9, 0]],
        [[0, 0, 0], [1e-15, 0, 0], [0, 1e-15, 0]],
        [[1e6, 0, 0], [1e6 + 1, 0, 0], [1e6, 1, 0]],
        [[0, 0, 1e6], [1e6, 0, 1e6], [0, 1e-3, 1e6]],
    ):
        for degree in (1, 3):
            assert spans_area(planar(degree, corners)[None])[0]
    for patches in (mb.half_plane(), mb.hyperboloid_two_sheets(), mb.sphere(cover="lunes")):
        assert spans_area(patches.control_points).all()


def test_updates_to_a_point_and_back():
    net = planar(2, GOOD)
    s = scene(net)
    params = mi.traverse(s)
    before = answers(s, down())

    def put(values: np.ndarray) -> None:
        params["s.control_points"] = mi.TensorXf(values.astype(np.float32).ravel(), (1, 6, 4))
        params.update()

    put(planar(2, [[0, 0, 0]] * 3))
    assert not np.array(mb.ray_intersect(s, down()).is_valid()).any()
    with pytest.raises(mb.errors.NetError, match="control_points: expected finite numbers"):
        put(net * np.nan)
    assert not np.array(mb.ray_intersect(s, down()).is_valid()).any()
    put(net)
    for a, b in zip(before, answers(s, down())):
        assert np.allclose(a, b, atol=1e-6)


def test_instances_and_others_beside_nothing():
    point, good = planar(2, [[0, 0, 0]] * 3)[None], planar(2, GOOD)[None]
    maps = np.eye(4)[None, :3]

    def shape(nets: np.ndarray, copied: bool) -> dict:
        tensor = mi.TensorXd(nets.ravel(), nets.shape)
        out = {"type": "beziertriangle", "control_points": tensor}
        return out | ({"instances": mi.TensorXd(maps.ravel(), maps.shape)} if copied else {})

    alone = answers(mi.load_dict({"type": "scene", "a": shape(good, False)}), down())
    for first in (False, True):
        for second in (False, True):
            s = mi.load_dict({"type": "scene", "a": shape(point, first), "b": shape(good, second)})
            for a, b in zip(alone, answers(s, down())):
                assert np.allclose(a, b, atol=1e-6)
            s = mi.load_dict({"type": "scene", "a": shape(point, first), "b": shape(point, second)})
            assert not np.array(mb.ray_intersect(s, down()).is_valid()).any()


def test_emitters_need_a_surface():
    with pytest.raises(RuntimeError, match="control_points: expected a surface, for it carries"):
        scene(planar(2, [[0, 0, 0]] * 3), emitter={"type": "area"})
    s = scene(np.stack([planar(2, [[0, 0, 0]] * 3), planar(2, GOOD)]), emitter={"type": "area"})
    ps = s.shapes()[0].sample_position(0.0, mi.Point2f([0.1, 0.5, 0.9], [0.2, 0.7, 0.9]))
    assert np.isfinite(np.array(ps.p)).all()
    # the triangle has an area of two
    assert np.allclose(ps.pdf, 0.5, rtol=1e-5)


@pytest.mark.filterwarnings("error")
def test_points_have_no_outline():
    point = mb.BezierTriangles(planar(2, [[1, 2, 3]] * 3))
    assert len(edge_segments(point)) == len(contour_segments(point, np.array([0, -5.0, 0]))) == 0
    ball = mb.sphere(cover="tetrahedral")
    both = mb.BezierTriangles(np.concatenate([point.control_points, ball.control_points]))
    found = contour_segments(both, np.array([0, -5.0, 0]))
    assert len(edge_segments(both)) == 0 and len(found) > 100 and found.patch.min() > 0


def test_rough_nets_are_surfaces():
    ijk = bernstein.multi_indices(6)
    net = planar(6, GOOD)
    net[:, :3] += 5 * np.cos(np.arange(3) + ijk @ [[1.0], [2.3], [3.1]] * [[1, 2, 5]])
    assert spans_area(net[None])[0]
