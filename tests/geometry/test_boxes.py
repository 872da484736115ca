"""Boxes and areas of surfaces: what is finite has a finite box, and memory does not grow."""

from __future__ import annotations

import json
import tracemalloc

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier, tensor

import mitsuba_bezier as mb
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.boxes import finite_parts, reaches_infinity, surface_boxes

#: What boxes may be larger than surfaces, in their size: what `bounds` promises.
TIGHT = 1e-3
COVERS = ("octants", "tetrahedral", "lunes")


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def union(boxes: np.ndarray) -> np.ndarray:
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def box_of_image(matrix: np.ndarray) -> np.ndarray:
    """Return the box of a collineation's image of the unit sphere, by its tangent planes."""
    dual = matrix @ np.diag([1.0, 1, 1, -1]) @ matrix.T
    d, c, w = np.diag(dual)[:3], dual[:3, 3], dual[3, 3]
    root = np.sqrt(c * c - d * w)
    return np.sort([(c - root) / w, (c + root) / w], axis=0)


def check(box: np.ndarray, right: np.ndarray) -> None:
    size = np.ptp(right, axis=0).max()
    rounding = 1e-12 * np.abs(right).max()
    assert (box[0] <= right[0] + rounding).all() and (box[1] >= right[1] - rounding).all()
    assert np.abs(box - right).max() <= 1.01 * TIGHT * size  # of the size known from inside


def images() -> list[np.ndarray]:
    """Return collineations that leave the unit sphere finite, some of them only just."""
    out = [np.eye(4)]
    for k, bottom in enumerate([(0.3, 0.2, -0.4), (0.9, 0, 0), (-0.5, 0.5, 0.69), (0, 0, -0.99)]):
        m = np.eye(4)
        m[:3, :3] += 0.3 * np.roll(np.diag([1.0, -0.5, 2.0]), k, axis=1)
        m[:3, 3] = 0, 10.0 ** (k - 1), -3
        m[3, :3] = bottom
        out += [m, -m]
    return out


@pytest.mark.parametrize("cover", COVERS)
@pytest.mark.parametrize("matrix", images())
def test_boxes_are_those_of_the_surface(cover, matrix):
    patches = mb.sphere(cover=cover).transform(matrix)
    right = box_of_image(matrix)
    assert not reaches_infinity(patches.control_points).any()
    check(union(patches.bounds()), right)
    check(surface_boxes(patches.control_points, together=True)[0], right)
    net, patch = finite_parts(patches.control_points)
    assert set(patch) == set(range(len(patches)))
    w = net[..., 3]
    assert (w.min(axis=1) * w.max(axis=1) >= 0).all() and (w.any(axis=-1)).all()
    assert not net[w == 0].any()  # zero vectors add nothing


def test_each_patch_has_its_own_box():
    patches = mb.sphere(cover="lunes").split()
    uv = np.random.default_rng(1).dirichlet([0.4] * 3, 5000)[:, :2]
    for patch, box in enumerate(patches.bounds()):
        points = patches.points(np.full(len(uv), patch), uv)
        size = np.ptp(points, axis=0).max()
        assert (box[0] <= points.min(axis=0) + 1e-12).all()
        assert (box[1] >= points.max(axis=0) - 1e-12).all()
        # samples are not at the very extremes
        assert np.abs(box - [points.min(axis=0), points.max(axis=0)]).max() < 5e-3 * size


@pytest.mark.parametrize("sign", [1, -1])
def test_sides_where_surfaces_reach_infinity_are_infinite(sign):
    inf = np.inf
    quarter = sign * mb.quarter_plane().control_points
    assert mb.BezierTriangles(quarter).bounds().tolist() == [[[0, 0, 0], [inf, inf, 0]]]
    # z = x^2 + y^2 over the quadrant: its two far corners are one point at infinity
    ijk = bernstein.multi_indices(2)
    net = np.zeros((6, 4))
    net[(ijk == (0, 0, 2)).all(axis=1)] = 0, 0, 0, 1
    net[(ijk == (1, 0, 1)).all(axis=1)] = 1, 0, 0, 0
    net[(ijk == (0, 1, 1)).all(axis=1)] = 0, 1, 0, 0
    net[(ijk == (2, 0, 0)).all(axis=1)] = 0, 0, 4, 0
    net[(ijk == (0, 2, 0)).all(axis=1)] = 0, 0, 4, 0
    paraboloid = mb.BezierTriangles(sign * net)
    assert reaches_infinity(paraboloid.control_points).all()
    box = paraboloid.bounds()[0]
    assert box[1].tolist() == [inf, inf, inf]
    assert np.abs(box[0]).max() < 0.01  # some parts of it are seen near the vertex only
    assert paraboloid.area().tolist() == [inf]
    # a sphere through infinity
    m = np.eye(4)
    m[3, 0] = 2
    torn = mb.sphere(cover="lunes").transform(m)
    which = reaches_infinity(torn.control_points)
    assert which.any() and not np.isfinite(union(torn.bounds())).any()
    assert (np.isinf(torn.area()) == which).all()
    assert np.isfinite(torn.bounds()[~which]).all()


def test_a_zero_vector_among_the_control_points_is_not_infinity():
    """A base point at a corner: the square 0..1 x 0..1 as one triangle, with four sides."""
    # x = u / (u + v) along the side at the corner w = 1, a line of points for one parameter
    net = np.zeros((1, 6, 4))
    ijk = bernstein.multi_indices(2)
    for (i, j, k), point in (
        ((2, 0, 0), (1, 1)), ((1, 1, 0), (0.5, 1)), ((0, 2, 0), (0, 1)),
        ((1, 0, 1), (1, 0)), ((0, 1, 1), (0, 0)),
    ):  # fmt: skip
        net[0, (ijk == (i, j, k)).all(axis=1)] = *point, 0, 1
    patches = mb.BezierTriangles(net)
    assert not reaches_infinity(net).any() and np.isfinite(patches.area()).all()
    box = patches.bounds()[0]
    uv = np.random.default_rng(1).dirichlet([0.3] * 3, 5000)[:, :2]
    points = patches.points(np.zeros(len(uv), dtype=int), uv)
    assert (box[0] <= points.min(axis=0)).all() and (box[1] >= points.max(axis=0)).all()
    assert np.abs(box - [[0, 0, 0], [1, 1, 0]]).max() < 2 * TIGHT
    shape = mi.load_dict({**bezier(patches), "instances": tensor(np.eye(4)[None, :3])})
    assert np.allclose(shape.bbox().max, [1, 1, 0], atol=2 * TIGHT)


def test_boxes_of_scenes():
    lunes = mb.sphere(radius=10, cover="lunes")
    assert not np.isfinite(lunes.hulls()).all()
    shape = {"type": "beziertriangle", "control_points": tensor(lunes.control_points)}
    scene = mi.load_dict({"type": "scene", "ball": shape})

    def box():
        return np.array([scene.bbox().min, scene.bbox().max])

    assert np.abs(box() - [[-10] * 3, [10] * 3]).max() < 20 * TIGHT
    params = mi.traverse(scene)
    params["ball.to_world"] = mi.Transform4f().translate([100, 0, 0]).scale(0.5)
    params.update()
    assert np.abs(box() - [[95, -5, -5], [105, 5, 5]]).max() < 10 * TIGHT
    params["ball.control_points"] = tensor(mb.sphere(radius=2, cover="lunes").control_points)
    params.update()
    assert np.abs(box() - [[99, -1, -1], [101, 1, 1]]).max() < 2 * TIGHT
    # the float32 box of what is not flat in float32 holds the float64 one
    centre = np.array([1e5 + 0.1, 0.1, -777.7])
    far = mb.sphere(center=centre, radius=0.3)
    s = mi.load_dict({"type": "beziertriangle", "control_points": mi.TensorXd(far.control_points)})
    assert (np.array(s.bbox().min, dtype=float) <= centre - 0.3).all()
    assert (np.array(s.bbox().max, dtype=float) >= centre + 0.3).all()


def test_instances_of_finite_surfaces_with_points_at_infinity():
    maps = np.broadcast_to(np.eye(4)[:3], (2, 3, 4)).copy()
    maps[1, 0, 3] = 5
    ball = bezier(mb.sphere(cover="lunes"))
    shape = mi.load_dict({**ball, "instances": tensor(maps)})
    low, high = np.array(shape.bbox().min), np.array(shape.bbox().max)
    assert (low <= -1).all() and (low > -2).all()
    assert (high >= [6, 1, 1]).all() and (high < [7, 2, 2]).all()
    ray = mi.Ray3f([5.5, -9, 0.1], [0, 1, 0])
    assert shape.ray_intersect_preliminary(ray).t[0] == pytest.approx(9 - np.sqrt(0.74), abs=1e-5)


def test_nothing_is_lost_outside_of_a_box():
    """Light from infinity starts at the scene's box: half a dome hides all of it."""
    half = mb.sphere(radius=10, cover="lunes").control_points[[0, 3]]
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}}
    light = {"type": "directional", "direction": [1, 0, 0]}
    frame = mi.ScalarTransform4f()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "bezierpath", "max_depth": 2},
            "sensor": {
                "type": "orthographic",
                "to_world": frame.look_at([19, 0, 0], [20, 0, 0], [0, 0, 1]).scale([0.01, 0.01, 1]),
                "film": {"type": "hdrfilm", "width": 2, "height": 2},
            },
            "light": light,
            "dome": {**bezier(half), "bsdf": black},
            "receiver": {
                "type": "rectangle",
                "to_world": frame.translate([20, 0, 0]).rotate([0, 1, 0], -90).scale(0.05),
            },
        }
    )
    assert np.array(mi.render(scene, spp=16)).max() == 0.0


def test_info_tells_boxes_of_surfaces(tmp_path, capsys):
    path = str(tmp_path / "ball.vtu")
    mb.save(mb.sphere(radius=3, cover="lunes"), path)
    assert main(["info", "--json", path]) == 0
    found = json.loads(capsys.readouterr().out)
    assert np.abs(np.array(found["bounds"]) - [[-3] * 3, [3] * 3]).max() < 6 * TIGHT
    assert [group["reach_infinity"] for group in found["patches"]] == [0]
    assert main(["info", path]) == 0
    text = capsys.readouterr().out
    assert "at infinity" in text and "reach infinity" not in text and "(-infinity" not in text

    path = str(tmp_path / "floor.vtu")
    mb.save(mb.plane(), path)
    assert main(["info", path]) == 0
    text = capsys.readouterr().out
    assert "4 reach infinity" in text
    assert "from (-infinity, -infinity, 0)" in text and "to   (infinity, infinity, 0)" in text


# ------------------------------------------------------------------------ areas


def rough(count: int, degree: int = 6) -> np.ndarray:
    """Return nets whose control points are off a lattice, the first with a collapsed edge."""
    rng = np.random.default_rng(0)
    uv = bernstein.multi_indices(degree) / degree
    net = np.ones((count, len(uv), 4))
    net[..., :3] = uv + 0.1 * rng.normal(size=(count, len(uv), 3))
    edge = uv[:, 0] == 0
    net[0, edge] = net[0, edge][0]
    return net


def test_areas_take_little_memory():
    mb.BezierTriangles(rough(1)).area()  # what is kept for all
    net = mb.BezierTriangles(rough(200))
    tracemalloc.start()
    try:
        areas = net.area()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # some arrays of 2 MiB at a time; all splits of all patches at once were 80 GiB
    assert peak < 64 * 2**20
    assert areas[7] == pytest.approx(net[7].area()[0], rel=1e-12)


def test_areas_do_not_depend_on_where_they_are():
    net = rough(3)
    areas = mb.BezierTriangles(net).area()
    dense = 0.0  # the sum of flat triangles converges as 1 / resolution^2: extrapolated once
    for resolution, weight in ((100, -1 / 3), (200, 4 / 3)):
        points, faces = mb.BezierTriangles(net).tessellate(resolution)
        a, b, c = points[faces].transpose(1, 0, 2)
        flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        dense = dense + weight * flat.reshape(3, -1).sum(axis=1)
    assert np.allclose(areas, dense, rtol=1e-6)
    far = net.copy()
    far[..., :3] += 2.0**20  # numbers of 2^-32: areas are off by as much
    assert np.allclose(mb.BezierTriangles(far).area(), areas, rtol=1e-8)
    assert np.allclose(mb.BezierTriangles(-1e6 * net).area(), areas, rtol=1e-12)


@pytest.mark.parametrize("cover", COVERS)
def test_the_area_of_spheres(cover):
    assert mb.sphere(cover=cover).area().sum() == pytest.approx(4 * np.pi, rel=1e-12)


def test_areas_of_folds_and_lines():
    # (u^2, v) for u in -1/2..1/2 and so on: folded along a line, each side counts
    net = np.ones((1, 6, 4))
    u = np.array([1, 0.5, 0.5, 0, 0, 0]) - 0.3  # of the lattice of control points
    v = np.array([0, 0.5, 0, 1, 0.5, 0])
    # blossom of (u - 0.3)^2 at the pairs of corners
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    corner = np.array([0.7, -0.3, -0.3])
    net[0, :, 0] = [corner[i] * corner[j] for i, j in pairs]
    net[0, :, 1], net[0, :, 2] = v, 0 * u
    # the integral of 2 |u - 0.3| (1 - u) over 0..1
    right = 2 * ((0.3**2 / 2 - 0.3**3 / 6) + (0.7**2 / 2 * 0.7 - 0.7**3 / 3))
    assert mb.BezierTriangles(net).area()[0] == pytest.approx(right, rel=1e-5)
    net[0, :, 0] = 2 * v
    assert mb.BezierTriangles(net).area()[0] < 1e-12


def test_the_shape_tells_an_infinite_area():
    plane = mi.load_dict(bezier(mb.quarter_plane()))
    assert np.isinf(np.array(plane.surface_area())[0])
    ball = mi.load_dict(bezier(mb.sphere(cover="lunes")))
    assert dr.allclose(ball.surface_area(), 4 * np.pi, rtol=1e-6)
