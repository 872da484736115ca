"""Every field of a surface interaction, against finite differences in float64."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import ball_rays, bezier, numbers, ray_of

import mitsuba_bezier as mb
from mitsuba_bezier.kernels.arrays import upload
from mitsuba_bezier.kernels.curvature import affine_second_partials, evaluate_second
from mitsuba_bezier.kernels.patch import pack

POINTS = [[1, 0, 0], [0.8, 0.9, 0.5], [0.4, 0, 0.6], [0, 2, 0.3], [0.1, 0.7, 0.3], [0, 0, 0]]
WEIGHTS = np.array([1, 1, 1, 3, 0.4, 0.7])[:, None]
CORNERS = np.array([[[0.2, 0.1], [0.9, 0.3], [0.4, 0.8]]])
#: A map that turns orientation.
MIRROR = np.array([[1.0, 0.4, 0, 2], [-0.3, 1.5, 0.2, -1], [0.1, 0, -0.8, 0.5], [0, 0, 0, 1]])

EVERYTHING = 0  # set with the variant


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    global EVERYTHING
    mi.set_variant(VARIANT)
    EVERYTHING = mi.RayFlags.All | mi.RayFlags.dNSdUV


def uneven_patch() -> mb.BezierTriangles:
    return mb.BezierTriangles(np.hstack([np.array(POINTS) * WEIGHTS, WEIGHTS])[None])


def flat_patch() -> mb.BezierTriangles:
    return mb.BezierTriangles([[[1, 0, 0, 1], [0, 4, 2, 2], [0, 0, 0.5, 0.5]]])


def hits(shape: Any, seed: int = 0, flags: Any = None) -> tuple[Any, Any, np.ndarray, np.ndarray]:
    """Return interactions, rays, patches and parameters of rays through the whole shape."""
    rng = np.random.default_rng(seed)
    count = 4000
    patch = rng.integers(0, len(shape.patches), count)
    w = rng.dirichlet([1, 1, 1], count)
    p = shape.patches.points(patch, w[:, :2])
    o = p + rng.normal(size=(count, 3)) * np.ptp(p, axis=0).max()
    ray = ray_of(o, p - o)
    pi = shape.ray_intersect_preliminary(ray)
    si = shape.ray_intersect(ray, EVERYTHING if flags is None else flags)
    return si, ray, np.array(pi.prim_index).astype(int), numbers(pi.prim_uv).astype(float)


def difference(function: Any, patch: np.ndarray, uv: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return the central difference of a function of parameters along `step` (2,) or (N, 2)."""
    h = 1e-5  # its square, and float64's rounding over it, are below 1e-9
    return (function(patch, uv + h * step) - function(patch, uv - h * step)) / (2 * h)


CASES = {
    "octants": (lambda: mb.sphere(cover="octants"), {}),
    "flipped": (lambda: mb.sphere(cover="octants"), {"flip_normals": True}),
    "tetrahedral": (lambda: mb.sphere(cover="tetrahedral"), {}),
    "torus": (lambda: mb.torus(radius=2, tube=0.5), {}),
    "uneven": (uneven_patch, {}),
    "mirrored": (uneven_patch, {"to_world": MIRROR}),
    "textured": (uneven_patch, {"texcoords": CORNERS}),
    # a map of texture coordinates that turns orientation
    "textured, mirrored": (
        uneven_patch,
        {"texcoords": CORNERS[:, ::-1], "to_world": MIRROR, "flip_normals": True},
    ),
    "degree 1": (flat_patch, {}),
}


def make(net: Any, parameters: dict) -> Any:
    convert = {
        "to_world": lambda m: mi.ScalarTransform4f(m.tolist()),
        "texcoords": lambda x: mi.TensorXf(np.ascontiguousarray(x, dtype=np.float32)),
        "flip_normals": bool,
    }
    return mi.load_dict(bezier(net(), **{k: convert[k](v) for k, v in parameters.items()}))


@pytest.mark.parametrize("name", CASES)
def test_partials_are_those_of_finite_differences(name):
    net, parameters = CASES[name]
    shape = make(net, parameters)
    si, _ray, patch, uv = hits(shape)
    valid = np.array(si.is_valid())
    assert valid.mean() > 0.999  # a point on an open edge may be missed
    patches, sign = shape.patches, shape.orientation
    steps = np.eye(2)
    if "texcoords" in parameters:
        a, b, c = parameters["texcoords"][0]
        steps = np.linalg.inv(np.column_stack([a - c, b - c])).T
        expected = uv @ np.array([a - c, b - c]) + c
    else:
        expected = uv
    # what the parameters of a hit are off by; those of the interaction are moved to the ray
    assert np.abs(numbers(si.uv) - expected)[valid].max() < 3e-6

    # where the surface is collapsed, within float32 of it, there are no partials to compare
    d = patches.differential(patch, uv)
    n = np.cross(d.dp_du, d.dp_dv)
    sine = np.linalg.norm(n, axis=1)
    lengths = np.linalg.norm([d.dp_du, d.dp_dv], axis=2)
    sine /= lengths.prod(axis=0) + 1e-30
    thin = lengths.min(axis=0) < 1e-2 * lengths.max(axis=0)
    inside = valid & (sine > 1e-3) & (np.minimum(uv.min(axis=1), 1 - uv.sum(axis=1)) > 1e-4)
    assert inside.mean() > 0.97

    def compare(got: Any, expected: np.ndarray, tolerance: float) -> None:
        error = np.linalg.norm(numbers(got) - expected, axis=1)[inside]
        assert error.max() < tolerance * np.linalg.norm(expected, axis=1)[inside].max()

    normals = sign * patches.normals(patch, uv)
    # 2e-4: roundings of the net (6e-8) seen where the partials meet at a sine of 1e-3
    compare(si.n, normals, 2e-4)
    compare(si.sh_frame.n, normals, 2e-4)
    for du, dn, step in ((si.dp_du, si.dn_du, steps[0]), (si.dp_dv, si.dn_dv, steps[1])):
        # 1e-5: roundings of points that are larger than their partials
        compare(du, difference(patches.points, patch, uv, step), 1e-5)
        expected = sign * difference(patches.normals, patch, uv, step)
        error = np.linalg.norm(numbers(dn) - expected, axis=1)[inside]
        scale = np.linalg.norm(expected, axis=1)[inside].max() + 1e-2  # flat: 0
        # a rounding (6e-8) over the square of what is left of the partials
        assert (error / scale)[~thin[inside]].max() < 1e-3
        # 2e-2: the step of 5e-3 inside, where nothing is left
        assert (error / scale).max() < 2e-2


@pytest.mark.parametrize("name", ["octants", "textured"])
def test_partials_of_the_normal_on_request_only(name):
    shape = make(*CASES[name])
    plain, *_ = hits(shape, flags=mi.RayFlags.All)
    assert np.abs(numbers(plain.dn_du)).max() == np.abs(numbers(plain.dn_dv)).max() == 0
    both = [hits(shape, flags=mi.RayFlags.All | f)[0].dn_du for f in geometric_and_shading()]
    assert np.array_equal(np.array(both[0]), np.array(both[1])) and np.abs(both[0]).max() > 0.1


def geometric_and_shading() -> tuple[Any, Any]:
    return mi.RayFlags.dNGdUV, mi.RayFlags.dNSdUV


@pytest.mark.parametrize("name", CASES)
def test_shading_frames(name):
    si, ray, *_ = hits(make(*CASES[name]))
    valid = np.array(si.is_valid())
    s, t, n = (numbers(x)[valid] for x in (si.sh_frame.s, si.sh_frame.t, si.sh_frame.n))
    frame = np.stack([s, t, n], axis=1).astype(float)
    # orthonormal and right-handed, to a few roundings (2e-7) over the least sine 1e-4 kept
    assert np.abs(frame @ frame.transpose(0, 2, 1) - np.eye(3)).max() < 2e-3
    assert np.linalg.det(frame).min() > 0.99
    # s lies in the plane of n and dp_du, on the side of dp_du
    assert np.einsum("ni,ni->n", s, numbers(si.dp_du)[valid]).min() > -1e-6
    wi = numbers(si.to_world(si.wi))[valid] + numbers(ray.d)[valid]
    assert np.abs(wi).max() < 2e-3 * np.abs(numbers(ray.d)).max()


def test_an_interaction_from_a_preliminary_one():
    shape = make(*CASES["textured"])
    si, ray, *_ = hits(shape)
    pi = shape.ray_intersect_preliminary(ray)
    again = shape.compute_surface_interaction(ray, pi, EVERYTHING)
    for name in ("t", "p", "n", "uv", "dp_du", "dn_dv", "wi", "prim_index"):
        assert np.array_equal(np.array(getattr(si, name)), np.array(getattr(again, name))), name
    assert dr.all(again.shape == si.shape)


def test_misses():
    shape = make(*CASES["octants"])
    si = shape.ray_intersect(ray_of([[0, 3, 3.0]], [[0, 0, -1.0]]), EVERYTHING)
    assert not dr.any(si.is_valid())
    for field in (si.p, si.n, si.dp_du, si.dn_du, si.uv, si.sh_frame.n):
        assert np.abs(np.array(field)).max() == 0
    assert numbers(si.wi).tolist() == [[0, 0, 1]]


def test_collapsed_corners_and_edges_have_finite_fields():
    # rays at corners and edges, where lunes are collapsed; from inside every one hits
    for cover in ("tetrahedral", "octants"):
        shape = mi.load_dict(bezier(mb.sphere(cover=cover)))
        count = len(shape.patches)
        t = np.linspace(0, 1, 9)
        edge = np.concatenate([np.stack([t, 0 * t], 1), np.stack([0 * t, t], 1)])
        edge = np.concatenate([edge, np.stack([t, 1 - t], 1)])
        p = shape.patches.points(np.repeat(np.arange(count), len(edge)), np.tile(edge, (count, 1)))
        si = shape.ray_intersect(ray_of(np.zeros(3), p), EVERYTHING)
        assert dr.all(si.is_valid())
        for field in (si.n, si.dp_du, si.dp_dv, si.dn_du, si.dn_dv, si.wi):
            assert np.isfinite(np.array(field)).all()
        for axis in (si.sh_frame.s, si.sh_frame.t, si.sh_frame.n):
            # 1e-3: the frame is orthonormal to that in the test above
            assert np.abs(np.linalg.norm(numbers(axis), axis=1) - 1).max() < 1e-3
        # the normal of the unit sphere is the point; 1e-3: the step inside at such places
        assert np.abs(numbers(si.n) - numbers(si.p)).max() < 2e-3


@pytest.mark.parametrize("dp_du", [[0, 0, 0], [0, 0, 1e-9], [0, 1e-30, 0], [1e-7, 0, 1]])
def test_a_frame_where_the_partial_has_no_direction(dp_du):
    from mitsuba_bezier.plugins.interaction import shading_frame

    frame = shading_frame(mi.Normal3f(0, 0, 1), mi.Vector3f(*dp_du))
    axes = np.array([np.array(x).ravel() for x in (frame.s, frame.t, frame.n)])
    assert np.abs(axes @ axes.T - np.eye(3)).max() < 1e-6


def test_texture_coordinates_on_a_line_give_some_frame():
    corners = np.array([[[0, 0], [0.5, 0.5], [1, 1]]], dtype=np.float32)
    shape = mi.load_dict(bezier(uneven_patch(), texcoords=mi.TensorXf(corners)))
    si, *_ = hits(shape)
    valid = np.array(si.is_valid())
    for field in (si.dp_du, si.dp_dv, si.sh_frame.s, si.dn_du, si.wi):
        assert np.isfinite(numbers(field)[valid]).all()
    assert np.abs(np.linalg.norm(numbers(si.dp_du), axis=1) - 1)[valid].max() < 1e-5


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_second_partials_of_the_kernel(degree):
    rng = np.random.default_rng(degree)
    net = rng.normal(size=(3, (degree + 1) * (degree + 2) // 2, 4))
    net[..., 3] = rng.uniform(0.5, 2, net.shape[:2])
    patches = mb.BezierTriangles(net)
    patch, w = rng.integers(0, 3, 500), rng.dirichlet([1, 1, 1], 500)
    buffer = upload(mi.Float64, pack(net))
    u, v = mi.Float64(w[:, 0].copy()), mi.Float64(w[:, 1].copy())
    got = affine_second_partials(evaluate_second(buffer, degree, mi.UInt32(patch), u, v))
    for a, b in zip(got, patches.differential(patch, w[:, :2])):
        # some hundred roundings of float64
        values = np.array([np.array(x) for x in a]).T
        assert np.abs(values - b).max() < 1e-12 * max(np.abs(b).max(), 1)


# ---------------------------------------------------------------- ray differentials


@pytest.mark.parametrize("name", ["octants", "textured", "textured, mirrored"])
def test_texture_coordinates_of_neighbouring_rays(name):
    shape = make(*CASES[name])
    step = 1e-3
    o, _d = ball_rays(1, 3)
    si, ray, *_ = hits(shape)
    extent = np.ptp(numbers(si.p), axis=0).max()
    rd = mi.RayDifferential3f(ray)
    rd.has_differentials = True
    moved = []
    for axis in ([1, 0, 0], [0, 1, 0]):
        side = dr.cross(ray.d, mi.Vector3f(axis))
        o = ray.o + step * extent * dr.normalize(side)
        moved.append(mi.Ray3f(o, ray.d))
    rd.o_x, rd.d_x, rd.o_y, rd.d_y = moved[0].o, moved[0].d, moved[1].o, moved[1].d
    si.compute_uv_partials(rd)
    cosine = np.abs(np.einsum("ni,ni->n", numbers(si.n), numbers(dr.normalize(ray.d))))
    for neighbour, got in zip(moved, (si.duv_dx, si.duv_dy)):
        other = shape.ray_intersect(neighbour)
        same = np.array(si.is_valid() & other.is_valid() & (si.prim_index == other.prim_index))
        near = numbers(dr.norm(other.p - si.p)) < 10 * step * extent  # not another sheet
        use = same & near & (cosine > 0.5)
        assert use.sum() > 500
        expected = (numbers(other.uv) - numbers(si.uv))[use]
        error = np.linalg.norm(numbers(got)[use] - expected, axis=1)
        # 3 %: the surface bends by that over the step, seen at a cosine of 1/2
        assert np.median(error / np.linalg.norm(expected, axis=1)) < 0.005
        assert np.quantile(error / np.linalg.norm(expected, axis=1), 0.99) < 0.03
