"""Derivatives within surfaces: attached hits, and path replay, against central differences."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import BENT, KEY, attach, central, film, inner, set_net, weights
from mitsuba_cases import bezier, ray_of, tensor

import mitsuba_bezier as mb
from mitsuba_bezier.plugins import scene_data


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


# ---------------------------------------------------------------- hits

FIELDS = ("t", "p", "n", "uv", "dp_du", "dp_dv", "wi")


def hits(net: np.ndarray, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from above that meet the middle of the patch."""
    rng = np.random.default_rng(1)
    uv = 0.08 + 0.8 * rng.dirichlet([1, 1, 1], count)[:, :2]
    patch = rng.integers(len(net), size=count)
    target = mb.BezierTriangles(net).points(patch, uv)
    o = np.array([0.4, 0.3, 4.0]) + 0.3 * rng.normal(size=(count, 3))
    return np.float32(o), np.float32(target - o)


def fields(scene: Any, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    si = mb.ray_intersect(scene, ray_of(o, d))
    dr.eval(si)
    return np.concatenate([np.atleast_2d(getattr(si, f)) for f in FIELDS]), np.array(si.is_valid())


def test_derivatives_of_hits():
    # all at once: control points and weights, the transformation, origin and direction
    rng = np.random.default_rng(2)
    net = BENT
    change = rng.normal(size=net.shape) * [1, 1, 1, 0.5]
    turn = np.zeros((4, 4))
    turn[:3] = 0.3 * rng.normal(size=(3, 4))
    o, d = hits(net)
    do, dd = np.float32(rng.normal(size=(2, *o.shape)) * 0.3)

    def scene_of(e: float) -> Any:
        place = mi.ScalarTransform4f((np.eye(4) + e * turn).tolist())
        # the structure has the degree of the ball, which is 4
        ball = bezier(mb.sphere(center=[0, 0, -9]))
        surface = bezier(net + e * change, to_world=place)
        return mi.load_dict({"type": "scene", "surface": surface, "ball": ball})

    theta = mi.Float(0)
    dr.enable_grad(theta)
    scene = scene_of(0)
    params = mi.traverse(scene)
    params[KEY] = tensor(net) + theta * tensor(change)
    matrix = mi.Matrix4f(turn.tolist())
    params["surface.to_world"] = mi.Transform4f(mi.Matrix4f(1) + theta * matrix)
    params.update()
    ray = ray_of(o, d)
    ray.o += theta * mi.Point3f(*do.T.copy())
    ray.d += theta * mi.Vector3f(*dd.T.copy())
    si = mb.ray_intersect(scene, ray)
    values = [getattr(si, f) for f in FIELDS]
    dr.forward_from(theta, flags=dr.ADFlag.ClearEdges)
    derivatives = [dr.grad(v) for v in values]
    dr.eval(derivatives)
    got = np.concatenate([np.atleast_2d(g) for g in derivatives])

    e = 2e-3
    plus, there = fields(scene_of(e), o + np.float32(e) * do, d + np.float32(e) * dd)
    minus, too = fields(scene_of(-e), o - np.float32(e) * do, d - np.float32(e) * dd)
    ok = np.array(si.is_valid()) & there & too
    assert ok.mean() > 0.95
    want = (plus - minus)[:, ok] / (2 * e)
    error = np.abs(got[:, ok] - want)
    # roundings of 1e-6 over the step are 5e-4; the step squared times third derivatives is less
    scale = np.abs(want).mean(axis=1, keepdims=True)
    assert (np.median(error / scale, axis=1) < 1e-3).all()
    assert (np.quantile(error / scale, 0.99, axis=1) < 2e-2).all()


def test_ray_flags():
    o, d = hits(BENT, 50)
    shape = mi.load_dict(bezier(BENT))
    params = mi.traverse(shape)
    points = tensor(BENT)
    dr.enable_grad(points)
    params["control_points"] = points
    params.update()
    follow = shape.ray_intersect(ray_of(o, d), mi.RayFlags.All | mi.RayFlags.FollowShape)
    assert not dr.grad_enabled(follow.uv) and dr.grad_enabled(follow.p, follow.t)
    detached = shape.ray_intersect(ray_of(o, d), mi.RayFlags.All | mi.RayFlags.DetachShape)
    assert not dr.grad_enabled(detached)
    # parameters fixed, all control points moved along x: so does the point
    dr.set_grad(points, tensor(np.broadcast_to([1.0, 0, 0, 0], BENT.shape) * BENT[..., 3:]))
    dr.forward_to(follow.p, flags=dr.ADFlag.ClearNone)
    # 1e-5: some roundings of sums of a few numbers near one
    np.testing.assert_allclose(np.array(dr.grad(follow.p)).T, [[1, 0, 0]] * 50, atol=1e-5)


def test_collapsed_edges_have_finite_derivatives():
    # lunes: normals at their tips are limits; rays that miss must not spoil a sum
    net = mb.sphere(cover="tetrahedral").control_points
    rng = np.random.default_rng(3)
    target = rng.normal(size=(2000, 3)) * [0.8, 0.8, 0]
    target[:200] = mb.BezierTriangles(net).points(rng.integers(10, size=200), [[1.0, 0]] * 200)
    o = np.array([0.1, 0.2, 4.0])
    shape = mi.load_dict(bezier(net))
    params = mi.traverse(shape)
    points = tensor(net)
    dr.enable_grad(points)
    params["control_points"] = points
    params.update()
    ray = ray_of(o, target - o)
    dr.enable_grad(ray.o)
    si = shape.ray_intersect(ray)
    valid = np.array(si.is_valid())
    assert valid[:200].any() and not valid.all()
    dr.backward(dr.sum(dr.select(si.is_valid(), si.t + si.n.x + si.sh_frame.s.y + si.wi.z, 0)))
    assert np.isfinite(np.array(dr.grad(points))).all()
    assert np.isfinite(np.array(dr.grad(ray.o))).all()


# ---------------------------------------------------------------- a scene without silhouettes

SIDE, SPP = 4, 100

#: Larger than the view, so that no edge is in the image, and convex, so that it hides nothing.
WIDE = BENT * [2.2, 2.2, -1.2, 1.0] + [0, 0, 0.5, 0]


@pytest.fixture(scope="module")
def indoors(variant) -> Any:
    """A patch that fills the film, under a point light and a Bézier lamp with a texture."""
    rng = np.random.default_rng(0)
    glow = mi.Bitmap(np.float32(rng.uniform(1, 6, (3, 3, 3))))
    lamp = {
        "type": "area",
        "radiance": {"type": "bitmap", "bitmap": glow, "raw": True, "filter_type": "bilinear"},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 14,
                "to_world": mi.ScalarTransform4f().look_at([0, 0.3, 5], [-0.3, 0, 0], [0, 1, 0]),
                **film(SIDE),
            },
            "surface": bezier(
                WIDE,
                bsdf={
                    "type": "twosided",
                    "plastic": {
                        "type": "roughplastic",
                        "alpha": 0.3,
                        "diffuse_reflectance": {"type": "rgb", "value": [0.8, 0.6, 0.5]},
                    },
                },
            ),
            "point": {"type": "point", "position": [1, 1, 3.0], "intensity": 3.0},
            "bulb": bezier(
                mb.sphere(cover="tetrahedral"),
                to_world=mi.ScalarTransform4f().translate([2, -1.5, 2.5]).scale(0.4),
                emitter=lamp,
            ),
            "room": {
                "type": "sphere",
                "radius": 7,
                "flip_normals": True,
                "bsdf": {"type": "diffuse", "reflectance": 0.5},
            },
        }
    )


def replay(scene: Any, spp: int = SPP, **more: Any) -> tuple[Any, Any]:
    """Return the integrator and a render with it, always by the same random numbers."""
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 3, "rr_depth": 20, **more})
    return integrator, lambda: mi.render(scene, integrator=integrator, spp=spp, seed=1)


def reverse(integrator: Any, scene: Any, w: np.ndarray, spp: int = SPP) -> None:
    integrator.render_backward(scene, None, mi.TensorXf(w), seed=1, spp=spp)


def test_24_components(indoors):
    params = mi.traverse(indoors)
    integrator, render = replay(indoors, max_depth=2)
    w = weights(SIDE)
    points = attach(params, WIDE)
    reverse(integrator, indoors, w)
    got = np.array(dr.grad(points)).reshape(6, 4)
    want = np.zeros((6, 4))
    for i, c in product(range(6), range(4)):
        change = np.zeros((1, 6, 4))
        change[0, i, c] = 1
        want[i, c] = central(render, params, WIDE, change, w, 1e-2)
    # 5 % are required; 0.5 % of the largest are noise
    np.testing.assert_allclose(got, want, rtol=0.05, atol=0.005 * np.abs(want).max())

    for change in np.random.default_rng(5).normal(size=(2, 1, 6, 4)):
        points = attach(params, WIDE)
        dr.set_grad(points, tensor(change))
        forward = inner(integrator.render_forward(indoors, None, seed=1, spp=SPP), w)
        # the same samples: only the order of sums differs
        assert forward == pytest.approx((got * change).sum(), abs=1e-4 * float(np.abs(got).max()))
    set_net(params, WIDE)


def test_light_that_was_reflected_by_another_surface(indoors):
    spp = 1600  # the central difference has noise: the lamp hides some of the room
    params = mi.traverse(indoors)
    integrator, render = replay(indoors, spp, max_depth=3)
    w = weights(SIDE)
    change = np.random.default_rng(7).normal(size=WIDE.shape)
    points = attach(params, WIDE)
    reverse(integrator, indoors, w, spp)
    got = float((np.array(dr.grad(points)).reshape(WIDE.shape) * change).sum())
    want = central(render, params, WIDE, change, w, 1e-2)
    set_net(params, WIDE)
    # as above; without the light reflected by the room it is 7 % less
    assert got == pytest.approx(want, rel=0.02)


def test_place_and_materials(indoors):
    # to_world of the lamp is left alone: its silhouette moves over the room
    params = mi.traverse(indoors)
    integrator, render = replay(indoors)
    w = weights(SIDE)
    keys = list(params.keys())
    colour = next(k for k in keys if "diffuse_reflectance" in k)
    light = next(k for k in keys if k.startswith("bulb.") and k.endswith(".data"))
    first = {k: type(params[k])(params[k]) for k in (colour, light, "surface.to_world")}

    def place(e: Any) -> Any:
        return mi.Transform4f().rotate([0.3, 1, 0.2], e) @ mi.Transform4f().scale(1 + 0.01 * e)

    changes = {
        "surface.to_world": (place, 1.0),
        colour: (lambda e: first[colour] + e * mi.Color3f(1, 0.5, 0.2), 0.05),
        light: (lambda e: first[light] * (1 + e), 0.05),
    }
    for key, (value, step) in changes.items():
        theta = mi.Float(0)
        dr.enable_grad(theta)
        params[key] = value(theta)
        params.update()
        reverse(integrator, indoors, w)
        dr.enqueue(dr.ADMode.Backward, params[key])
        dr.traverse(dr.ADMode.Backward)
        got = dr.grad(theta)[0]
        out = []
        for sign in (1, -1):
            params[key] = value(mi.Float(sign * step))
            params.update()
            out.append(inner(render(), w))
        params[key] = first[key]
        params.update()
        # as above
        assert got == pytest.approx((out[0] - out[1]) / (2 * step), rel=0.05), key


def test_derivatives_do_not_change_the_image(indoors):
    params = mi.traverse(indoors)
    _integrator, render = replay(indoors)
    plain = np.array(render())
    attach(params, WIDE)
    assert (np.array(render()) == plain).all()
    set_net(params, WIDE)


def test_without_bezier_shapes_it_is_prb(variant):
    # the same random numbers in the same order; a textured lamp moves, too
    glow = mi.Bitmap(np.float32(np.random.default_rng(0).uniform(1, 6, (4, 4, 3))))
    radiance = {"type": "bitmap", "bitmap": glow, "raw": True}
    scene = mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 2, 6], [0, 0, 0], [0, 1, 0]),
                **film(4),
            },
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(9),
            },
            # diffuse: prb forgets that the frame of a vertex turns under the light that it gets
            "ball": {"type": "sphere"},
            "lamp": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().look_at([1, 4, 2], [0, 0, 0], [0, 0, 1]),
                "emitter": {"type": "area", "radiance": radiance},
            },
            "sky": {"type": "constant", "radiance": 0.2},
        }
    )
    params = mi.traverse(scene)
    keys = ["ball.to_world", "lamp.to_world", "floor.bsdf.reflectance.value", "sky.radiance.value"]
    got = []
    for name in ("prb", "bezierpath"):
        integrator = mi.load_dict({"type": name, "max_depth": 4, "rr_depth": 20})
        for key in keys:
            dr.enable_grad(params[key])
            dr.clear_grad(params[key])
        params.update()
        reverse(integrator, scene, weights(4), 64)
        value = [dr.grad(getattr(params[k], "matrix", params[k])) for k in keys]
        got.append(np.concatenate([np.array(v).ravel() for v in value]))
    assert (got[0] != 0).sum() > 10
    # roundings in another order, and a path in thousands that they send elsewhere
    np.testing.assert_allclose(got[1], got[0], atol=2e-3 * np.abs(got[0]).max())


# ---------------------------------------------------------------- optimisation


def test_steps_of_an_optimisation_share_their_kernels(indoors):
    params = mi.traverse(indoors)
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    optimizer = mi.ad.Adam(lr=0.01)
    optimizer[KEY] = tensor(WIDE)
    known: set = set()
    fresh, losses = [], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for step in range(4):
            params.update(optimizer)
            image = mi.render(indoors, params, integrator=integrator, spp=16, seed=step)
            loss = dr.mean(dr.square(image - 0.5), axis=None)
            dr.backward(loss)
            optimizer.step()
            dr.eval()
            losses.append(float(loss.array[0]))
            history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
            # a kernel may come from the disk, and one that reads memory of another alignment is
            # another to Dr.Jit: their text is compared, without that and without their names
            without = re.compile(r"align \d+|drjit_\w+|i32 \d+, <\d+ x i1>")
            kernels = {without.sub("", k["ir"].getvalue()) for k in history}
            fresh.append(len(kernels - known))
            known |= kernels
    set_net(params, WIDE)
    assert fresh[0] > 0 and fresh[2:] == [0, 0]
    assert losses[-1] < losses[0]
    # structures of earlier steps are gone
    surface = next(s for s in indoors.shapes() if s.id() == "surface")
    held = [d for d in scene_data._cache.values() if any(s is surface for s in d.shapes)]
    assert len(held) == 1


def test_invalid_update_keeps_the_last_valid_state(indoors):
    params = mi.traverse(indoors)
    _integrator, render = replay(indoors, 4)
    before = np.array(render())
    attach(params, WIDE)
    bad = WIDE.copy()
    bad[0, 2, 1] = np.nan
    params[KEY] = tensor(bad)
    with pytest.raises(mb.BezierError, match="control_points: expected finite numbers"):
        params.update()
    assert (np.array(render()) == before).all()
    attach(params, WIDE)  # and goes on
    assert (np.array(render()) == before).all()
    set_net(params, WIDE)


# ---------------------------------------------------------------- what cannot be


def test_nothing_to_differentiate(indoors):
    integrator, _render = replay(indoors)
    with pytest.raises(mb.BezierError, match="expected a parameter that the image depends on"):
        reverse(integrator, indoors, weights(SIDE), 4)


def test_polarized_variants_have_no_derivatives():
    mi.set_variant("llvm_ad_mono_polarized")
    try:
        scene = mi.load_dict(
            {
                "type": "scene",
                "camera": {"type": "perspective"},
                "surface": bezier(WIDE, emitter={"type": "area"}),
            }
        )
        integrator = mi.load_dict({"type": "bezierpath"})
        with pytest.raises(mb.BezierError, match="bezierpath: expected a variant without polar"):
            integrator.render_backward(scene, None, mi.TensorXf(0.0, (1, 1, 1)), spp=1)
    finally:
        mi.set_variant(VARIANT)
