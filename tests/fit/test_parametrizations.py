"""What is unknown of a parameter: values at the start, derivatives, and what stays true of them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import fit
from mitsuba_bezier.fit.parametrization import tensor
from mitsuba_bezier.fit.problem import Problem

# unknowns are float64, nets float32: 6e-8 relative; points of a torus are 3 from the origin
SINGLE = 1e-6


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant("llvm_ad_rgb")


def paraboloid() -> Any:
    """Return a patch on z = x^2 + y^2 (times 1/2), projected from its ideal point."""
    a = np.diag([1.0, 1, 0, 0])
    a[2, 3] = a[3, 2] = -0.5
    corners = [[1, 0, 1, 1], [0, 1, 1, 1], [-1, -1, 2, 1]]
    return mb.quadric_patch(a, [0, 0, 1, 0], corners)[None]


CASES = {
    "octants": lambda: fit.Net(mb.sphere(cover="octants")),
    "lunes": lambda: fit.Net(mb.sphere(cover="tetrahedral")),
    "ideal points": lambda: fit.Net(mb.plane()),
    "negative weights": lambda: fit.Net(mb.hyperboloid_two_sheets()),
    "points only": lambda: fit.Net(mb.torus(), weights=False),
    "weights only": lambda: fit.Net(mb.torus(), points=False),
    "held": lambda: fit.Net(mb.tensor_to_triangles(SADDLE), hold="boundary"),
    "affine": lambda: fit.Collineation(mb.sphere()),
    "projective": lambda: fit.Collineation(mb.sphere(), affine=False),
    "sphere": lambda: fit.Sphere((1, 2, 3), 0.5),
    "pose": lambda: fit.Pose(mb.torus(), scale=True),
    "quadric": lambda: fit.Quadric(mb.sphere(cover="tetrahedral")[:4]),
    "paraboloid": lambda: fit.Quadric(paraboloid()),
}
SADDLE = np.array([[[x, y, x * y, 1.0] for y in (-1.0, 0.0, 1.0)] for x in (-1.0, 0.0, 1.0)])


def net_of(item: fit.Parametrization, unknowns: dict[str, np.ndarray]) -> np.ndarray:
    return np.array(item.value({k: tensor(v) for k, v in unknowns.items()}), dtype=np.float64)


@pytest.mark.parametrize("name", CASES)
def test_the_start_is_the_net_that_was_given(name: str) -> None:
    item = CASES[name]()
    if isinstance(item, fit.Sphere):
        expected = mb.sphere((1, 2, 3), 0.5).control_points
    else:
        expected = item.patches.control_points
    assert np.abs(net_of(item, item.start()) - expected).max() <= SINGLE * np.abs(expected).max()


@pytest.mark.parametrize("name", CASES)
def test_gradients_are_those_of_differences(name: str) -> None:
    item = CASES[name]()
    shape = mb.shape(mb.sphere(cover="octants"))
    scene = mi.load_dict({"type": "scene", "b": shape})

    def wave(params: Any, _seed: int) -> Any:
        values = params["b.control_points"].array
        k = dr.cos(dr.arange(mi.Float, dr.width(values)) * 0.7) / 8
        return dr.sum(dr.sin(values * k) * k)

    problem = Problem(scene, {"b.control_points": item}, lambda p, s: iter([wave(p, s)]), [], 0)
    rng = np.random.default_rng(3)
    x = problem.start + 0.02 * rng.standard_normal(len(problem.start))
    _loss, gradient = problem.evaluate(x, 0)
    way = rng.standard_normal(len(x))
    h = 4e-3
    ends = [problem.evaluate(x + s * h * way, 0)[0] for s in (-1, 1)]
    # rounding of the sum: 1e-6 in 2 h; curvature: h^2 of terms that are some units large
    size = np.linalg.norm(gradient) * np.linalg.norm(way)
    assert abs(gradient @ way - (ends[1] - ends[0]) / (2 * h)) <= 1e-3 * size + 1e-3


def test_weights_keep_their_sign_and_seams_stay_closed() -> None:
    patches = mb.sphere(cover="octants")
    item = fit.Net(patches)
    rng = np.random.default_rng(0)
    moved = {k: v + 0.3 * rng.standard_normal(v.shape) for k, v in item.start().items()}
    net = item.net(moved)
    assert np.array_equal(np.sign(net.weights), np.sign(patches.weights))
    assert np.abs(net_of(item, moved) - net.control_points).max() < 1e-5
    # all edges are still shared by two patches
    from mitsuba_bezier.geometry.contours import open_edges

    assert len(open_edges(patches, creases=False)) == 0
    assert len(open_edges(net, creases=False)) == 0


@pytest.mark.parametrize("how", ["elevate", "split"])
def test_a_finer_net_is_the_same_surface(how: str) -> None:
    item = fit.Net(mb.sphere(cover="octants"))
    rng = np.random.default_rng(1)
    now = {k: v + 0.05 * rng.standard_normal(v.shape) for k, v in item.start().items()}
    finer = item.refined(now, how)
    assert sum(v.size for v in finer.start().values()) > sum(v.size for v in now.values())
    old, new = item.net(now), finer.net(finer.start())
    uv = rng.dirichlet([1, 1, 1], 50)[:, :2]
    if how == "elevate":
        a, b = (n.points(np.zeros(50, dtype=int), uv) for n in (old, new))
        assert np.abs(a - b).max() < 1e-12
    else:
        assert new.area().sum() == pytest.approx(old.area().sum(), rel=1e-6)
    from mitsuba_bezier.geometry.contours import open_edges

    assert len(open_edges(new, creases=False)) == 0


def test_a_quadric_stays_one_for_all_numbers() -> None:
    item = fit.Quadric(mb.sphere(cover="tetrahedral")[:4])
    rng = np.random.default_rng(2)
    numbers = item.start()["numbers"] * 2
    numbers = numbers + 0.1 * rng.standard_normal(10)
    a = np.zeros((4, 4))
    a[np.triu_indices(4)] = numbers
    a = a + a.T - np.diag(np.diag(a))
    net = item.net({"numbers": numbers})
    uv = rng.dirichlet([1, 1, 1], 400)[:, :2]
    x = net.evaluate(np.arange(400) % 4, uv)
    value = np.einsum("ni,ij,nj->n", x, a, x) / np.einsum("ni,ni->n", x, x)
    assert np.abs(value).max() < 1e-13


def test_a_pose_is_rigid() -> None:
    torus = mb.torus()
    item = fit.Pose(torus)
    net = net_of(
        item, {"rotation": np.array([0.3, -1.2, 0.8]), "translation": np.array([1, 2, 3.0])}
    )
    before, after = (mb.BezierTriangles(n) for n in (torus.control_points, net))
    rng = np.random.default_rng(4)
    uv = rng.dirichlet([1, 1, 1], 60)[:, :2]
    patch = rng.integers(len(torus), size=60)
    p, q = before.points(patch, uv), after.points(patch, uv)
    d = [np.linalg.norm(x[:, None] - x[None], axis=-1) for x in (p, q)]
    assert np.abs(d[0] - d[1]).max() < 1e-5  # float32, distances up to 4
    assert np.allclose(q.mean(axis=0) - p.mean(axis=0), [1, 2, 3], atol=0.5)


def test_joins_are_zero_where_the_surface_is_smooth_and_not_where_it_is_not() -> None:
    smooth = mb.sphere(cover="octants")
    joins = fit.Joins(smooth)
    assert float(joins(mi.TensorXf(smooth.control_points))[0]) < 1e-6
    item = fit.Net(smooth)
    rng = np.random.default_rng(5)
    start = item.start()
    bent = item.net({k: v + 0.05 * rng.standard_normal(v.shape) for k, v in start.items()})
    angle = float(joins(mi.TensorXf(bent.control_points))[0])
    # an independent mean of 1 - cos, by normals in float64 along all edges
    t = (np.arange(1, 2 * 4 + 2) - 0.5) / 9
    sides = []
    ends = np.array([[[1, 0], [0, 1]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]], dtype=float)
    for patch in range(8):
        for start_, end in ends:
            uv = start_ + t[:, None] * (end - start_)
            where = np.full(9, patch)
            sides.append((bent.points(where, uv), bent.normals(where, uv)))
    total, count = 0.0, 0
    for i, (p, n) in enumerate(sides):
        for q, m in sides[i + 1 :]:
            for way in (slice(None), slice(None, None, -1)):
                if np.abs(p - q[way]).max() < 1e-9:
                    total += (1 - (n * m[way]).sum(axis=1)).sum()
                    count += len(t)
    assert count == 12 * 9
    assert angle == pytest.approx(total / count, rel=1e-4)


def test_only_some_entries_are_unknown_and_the_others_stay() -> None:
    first = np.array([[8.0, 0.5, 3.0], [60.0, 1.0, 2.0]])
    item = fit.Values(first, only=[-3, 1], low=0, high=100)
    assert item.start()["values"].shape == (2,)
    x = mi.TensorXf(item.start()["values"] + [0.5, 0.0])
    dr.enable_grad(x)
    value = item.value({"values": x})
    # the logistic function of ln(60 / 40) + 1/2
    expected = first.copy()
    expected[1, 0] = 100 / (1 + np.exp(-np.log(1.5) - 0.5))
    assert np.allclose(np.array(value), expected, rtol=1e-6)
    dr.backward(dr.sum(value * mi.TensorXf(np.arange(6.0).reshape(2, 3)), axis=None))
    slope = expected[1, 0] * (1 - expected[1, 0] / 100)
    assert np.allclose(np.array(dr.grad(x)), [3 * slope, 0.5 * (1 - 0.005)], rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: fit.Net(np.zeros((1, 5, 4))), "control_points"),
        (lambda: fit.Net(mb.sphere(), hold="edges"), "hold"),
        (lambda: fit.Net(mb.sphere(), hold=np.zeros(3, dtype=bool)), "hold"),
        (lambda: fit.Net(mb.sphere(), points=False, weights=False), "points, weights"),
        (lambda: fit.Net(mb.disk()[:1], hold="boundary"), "hold"),
        (lambda: fit.Quadric(mb.sphere(cover="octants")), "degree 4"),
        (lambda: fit.Quadric(mb.sphere(cover="tetrahedral")), "edges"),
        (lambda: fit.Quadric(mb.sphere(cover="tetrahedral")[:4], anchor=(1, 0, 0)), "anchor"),
        (lambda: fit.Collineation(mb.sphere(), np.zeros((4, 4))), "start"),
        (lambda: fit.Sphere(radius=-1), "radius"),
        (lambda: fit.Values([1, -1], positive=True), "start"),
        (lambda: fit.Values([0.5], low=1, high=2), "start"),
        (lambda: fit.Values([0.5], low=0), "low, high"),
        (lambda: fit.Values([np.nan]), "start"),
        (lambda: fit.Values("blue"), "start"),
        (lambda: fit.Values([]), "start"),
        (lambda: fit.Values([[1], [2, 3]]), "start"),
        (lambda: fit.Values([0.5], low=0, high=np.inf), "low, high"),
        (lambda: fit.Values([0.5], scale=0), "scale"),
        (lambda: fit.Values([1, 2], only=[2]), "only: expected entries from 0 to 1"),
        (lambda: fit.Values([1, 2], only=[1, -1]), "only"),
        (lambda: fit.Values([1, 2], only=[]), "only"),
        (lambda: fit.Values([1, 2], only=[0.5]), "only"),
        (lambda: fit.Values([1, 2], only=[True, False]), "only"),
        (lambda: fit.Joins(mb.sphere()[:1]), "patches"),
    ],
)
def test_bad_input_is_one_clear_message(make: Any, says: str) -> None:
    with pytest.raises(mb.BezierError, match=says):
        make()
