"""Points, normals and partials of hits are as exact as `t`, wherever the surface is."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import numbers, ray_of, tensor

import mitsuba_bezier as mb
from mitsuba_bezier.leaves.local_nets import local_nets

#: Rounding to float32, relative.
ROUNDING = 2.0**-24
COVERS = ("octants", "tetrahedral", "lunes")
PLACES = [
    ((0, 0, 0), 1.0),
    ((0, 0, 0), 1e-3),
    ((0, 0, 0), 1e3),
    ((1000, 0, 0), 1.0),
    ((278, 273, -5400), 250.0),
    ((1e5, -2e5, 4), 1.0),
    ((8e5, 0.1, 0.3), 1000.0),
]


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def rays(centre: Any, radius: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 4000, 3))
    x, y = (a / np.linalg.norm(a, axis=1)[:, None] for a in (x, y))
    o = (centre + 3 * radius * x).astype(np.float32)
    d = centre + 0.9 * radius * rng.random((4000, 1)) * y - o
    return o, (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)


def truth(o: np.ndarray, d: np.ndarray, centre: Any, radius: float) -> tuple:
    """Return point, normal and cosine at the first hits of a ball, NaN for misses."""
    d = d.astype(float)
    d2 = np.einsum("ni,ni->n", d, d)
    away = o.astype(float) - centre
    along = np.einsum("ni,ni->n", away, d) / d2
    foot = away - along[:, None] * d
    with np.errstate(invalid="ignore"):
        half = np.sqrt((radius**2 - np.einsum("ni,ni->n", foot, foot)) / d2)
    n = (foot - half[:, None] * d) / radius
    return centre + radius * n, n, np.abs(np.einsum("ni,ni->n", n, d))


def move(centre: Any, radius: float) -> Any:
    return mi.ScalarTransform4d().translate(list(centre)).scale(radius)


def errors(si: Any, o: np.ndarray, d: np.ndarray, centre: Any, radius: float) -> Any:
    """Return the largest error of points over the radius, and the mean and largest of normals."""
    p, n, cosine = truth(o, d, centre, radius)
    with np.errstate(invalid="ignore"):
        sure = (cosine > 0.05) & np.array(si.is_valid())  # rays themselves are float32 numbers
    assert sure.mean() > 0.95
    off = np.linalg.norm(numbers(si.p) - p, axis=1)[sure] / radius
    turned = np.linalg.norm(numbers(si.n) - n, axis=1)[sure]
    return off.max(), turned.mean(), turned.max()


@pytest.mark.parametrize(("centre", "radius"), PLACES)
def test_balls_are_as_exact_as_those_of_mitsuba(centre, radius):
    centre = np.array(centre, dtype=float)
    o, d = rays(centre, radius)
    ball = mi.load_dict({"type": "sphere", "to_world": move(centre, radius)})
    native = errors(mi.load_dict({"type": "scene", "ball": ball}).ray_intersect(ray_of(o, d)),
                    o, d, centre, radius)  # fmt: skip
    for cover in COVERS:
        net = mb.sphere(cover=cover)
        here = mb.sphere(center=centre, radius=radius, cover=cover).control_points
        maps = np.eye(4)[None, :3] * [[[-radius], [radius], [radius]]]
        maps[0, :, 3] = centre
        for made in (
            {"control_points": tensor(net), "to_world": move(centre, radius)},
            {"control_points": mi.TensorXd(here)},
            {"control_points": tensor(net), "instances": mi.TensorXd(maps)},
        ):
            shape = mi.load_dict({"type": "beziertriangle", **made})
            p, mean, most = errors(shape.ray_intersect(ray_of(o, d)), o, d, centre, radius)
            # a rounding of the coordinates and one of the ball's, each in three axes
            place = np.abs(centre).max() / radius + 1
            assert p < 2 * np.sqrt(3) * ROUNDING * place and p < 2 * native[0]
            # three roundings of the result; nets and parameters, in the size of a patch, are
            # rounded as well
            assert mean < ROUNDING and most < 6 * ROUNDING
            assert mean < 2 * native[1] and most < 2 * native[2]


@pytest.mark.parametrize("cover", COVERS)
def test_partials_far_from_the_origin(cover):
    centre, radius = np.array([1e5, -2e5, 4]), 2.0
    patches = mb.sphere(center=centre, radius=radius, cover=cover)
    shape = mi.load_dict(
        {"type": "beziertriangle", "control_points": mi.TensorXd(patches.control_points)}
    )
    o, d = rays(centre, radius)
    ray = ray_of(o, d)
    si, pi = shape.ray_intersect(ray), shape.ray_intersect_preliminary(ray)
    patch, uv = np.array(pi.prim_index).astype(int), numbers(si.uv).astype(float)
    at = patches.differential(patch, uv)
    inside = np.array(si.is_valid()) & (np.minimum(uv.min(axis=1), 1 - uv.sum(axis=1)) > 0.01)
    for got, right, second in (
        (si.dp_du, at.dp_du, np.linalg.norm([at.d2p_duu, at.d2p_duv], axis=2).sum(axis=0)),
        (si.dp_dv, at.dp_dv, np.linalg.norm([at.d2p_duv, at.d2p_dvv], axis=2).sum(axis=0)),
    ):
        off = np.linalg.norm(numbers(got) - right, axis=1)
        # roundings of the result and of the net, and of the parameters that are compared here
        size = np.linalg.norm(right, axis=1) + second + radius
        assert (off / size)[inside].max() < 4 * ROUNDING


def test_hits_at_a_distance():
    """A ray parameter of 1e5 is rounded by 4e-3: points on the surface are not off by that."""
    shape = mi.load_dict({"type": "beziertriangle", "control_points": tensor(mb.sphere())})
    rng = np.random.default_rng(5)
    target = rng.uniform(-0.5, 0.5, size=(500, 3))
    o = (1e5 * rng.normal(size=(500, 3))).astype(np.float32)
    d = target - o
    d = (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)
    # float32 directions miss the ball by up to 1e-2
    p, n, cosine = truth(o, d, np.zeros(3), 1.0)
    si = shape.ray_intersect(ray_of(o, d))
    sure = np.array(si.is_valid()) & (np.nan_to_num(cosine) > 0.3)
    assert sure.mean() > 0.5
    # t is off by some roundings; the step to the ray takes that back
    assert np.linalg.norm(numbers(si.p) - p, axis=1)[sure].max() < 4e-7
    assert np.linalg.norm(numbers(si.n) - n, axis=1)[sure].max() < 4e-7


def test_translations_keep_float64():
    where = 1e6 + 1 / 3  # float32 knows it to 1/16
    place = mi.ScalarTransform4d().translate([where, 0, 0])
    shape = mi.load_dict(
        {"type": "beziertriangle", "control_points": tensor(mb.sphere()), "to_world": place}
    )
    ray = mi.Ray3f([1e6, -3, 0], [0, 1, 0])
    right = np.array([-1 / 3, -np.sqrt(1 - 1 / 9), 0])
    assert np.abs(numbers(shape.ray_intersect(ray).n) - right).max() < 1e-6
    params = mi.traverse(shape)
    params["control_points"] = tensor(mb.sphere(cover="tetrahedral"))
    params.update()
    assert np.abs(numbers(shape.ray_intersect(ray).n) - right).max() < 1e-6


def test_origins_of_nets():
    net = np.array(mb.sphere(center=(1e5, 2, 3), cover="lunes").control_points)
    local, origin = local_nets(1e-30 * net)
    assert np.abs(local[..., 3]).max() <= 1 and np.abs(local[..., 3]).max() > 0.25
    assert np.array_equal(origin[:, :3], origin[:, :3].astype(np.float32))
    back = local.copy()
    back[..., :3] += back[..., 3:] * origin[:, None, :3]
    factor = back[..., 3].max() / net[..., 3].max()
    assert np.allclose(back, factor * net, rtol=1e-9, atol=1e-9)
    assert np.abs(local[..., :3]).max() < 4  # in the size of the ball
    # rows at infinity stay, and a net without weights is no error
    ideal = net[..., 3] == 0
    assert ideal.any() and np.allclose(local[ideal], factor * net[ideal])
    far, origin = local_nets(np.eye(4)[None, :3])
    assert np.array_equal(origin[0, :3], np.zeros(3)) and np.isfinite(far).all()
    # a collapsed edge is the origin, whatever its weights
    lune = mb.sphere(center=(7, 8, 9), cover="tetrahedral").control_points[4:]
    local, _origin = local_nets(lune)
    zero = np.abs(local[..., :3]).max(axis=2) < 1e-6
    assert (zero.sum(axis=1) == 3).all()


@pytest.mark.parametrize(("x", "share"), [(3e4, 0.0), (1e5, 0.01)])
def test_general_surfaces_far_from_the_origin(x, share):
    """Without a closed form leaves have float32 origins: a few are lost at 1e5 of their sizes."""
    torus = mb.torus(radius=0.7, tube=0.3)
    o, d = rays(np.array([x, 0, 0]), 1.0)
    far = torus.transform(np.eye(4) + x * np.outer([1, 0, 0, 0], [0, 0, 0, 1]))
    t = []
    for patches, start in ((far, o), (torus, o.astype(float) - [x, 0, 0])):
        net = mi.TensorXd(patches.control_points)
        shape = mi.load_dict({"type": "beziertriangle", "control_points": net})
        t.append(np.array(shape.ray_intersect_preliminary(ray_of(start, d)).t))
    with np.errstate(invalid="ignore"):
        same = (t[0] == t[1]) | (np.abs(t[0] - t[1]) < 1e-6)  # some roundings of t, 2 to 4
    assert np.isfinite(t[1]).mean() > 0.3 and (~same).mean() <= share
