"""Derivatives of what is seen in ideal mirrors and through glass, against central differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import film, inner, picture, weights
from mitsuba_cases import bezier, tensor

from mitsuba_bezier.geometry import bernstein

SIDE, SPP = 4, 4096


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def sheet(z: float, phase: float, up: bool = True) -> np.ndarray:
    """Return a bent cubic, wider than what the camera sees of it: no outline is in the image."""
    ij = np.array(bernstein.multi_indices(3))[:, :2]
    xy = ij if up else ij[:, ::-1]
    x, y = (3 * xy - 3).T
    bend = 0.1 * np.sin(1.3 * (x + y) + phase) + 0.05 * np.cos(x - phase)
    w = 1 + 0.2 * np.sin(x + 2 * y + phase)
    return (np.c_[x, y, z + bend, np.ones(len(x))] * w[:, None])[None]


def lens(half: float, phase: float = 0.0) -> np.ndarray:
    return np.concatenate([sheet(half, phase), sheet(-half, phase + 2, up=False)])


def scene_of(z: float, target: float, **shapes: Any) -> Any:
    """A camera above, and a bright picture at height `z` that faces height `target`."""
    place = mi.ScalarTransform4f()
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 12,
                "to_world": place.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                **film(SIDE),
            },
            "picture": {
                "type": "rectangle",
                "to_world": place.look_at([0, 0, z], [0, 0, target], [0, 1, 0]).scale(6),
                "emitter": {"type": "area", "radiance": picture()},
            },
            **shapes,
        }
    )


GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
MIRROR = {"type": "twosided", "metal": {"type": "conductor", "material": "none"}}


def mirror() -> Any:
    return scene_of(5, 0, surface=bezier(sheet(0, 0), bsdf=MIRROR))


def glass() -> Any:
    return scene_of(-3, 0, surface=bezier(lens(0.5), bsdf=GLASS))


def nested() -> Any:
    fluid = {"type": "dielectric", "int_ior": 1.2, "ext_ior": 1.5}
    inside = bezier(lens(0.2, 1.0), bsdf=fluid)
    return scene_of(-3, 0, outside=bezier(lens(0.5), bsdf=GLASS), surface=inside)


def ball() -> Any:
    """One of Mitsuba's own shapes, seen through a pane of patches."""
    glass = {"type": "sphere", "radius": 2.0, "center": [0, 0, -2.0], "bsdf": GLASS}
    pane = bezier(sheet(1.0, 0.0), bsdf={"type": "thindielectric"})
    return scene_of(-6, 0, surface=glass, pane=pane)


def lit_wall() -> Any:
    """Behind a lens a wall with a texture and a lamp: the lens ends at what is rough."""
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -2.5]).scale(6),
        "bsdf": {"type": "diffuse", "reflectance": picture()},
    }
    lamp = {"type": "point", "position": [0.4, 0.2, -1.2], "intensity": 3.0}
    return scene_of(9, 10, surface=bezier(lens(0.5), bsdf=GLASS), wall=wall, lamp=lamp)


def place(e: Any) -> Any:
    shift = mi.Transform4f().translate(mi.Vector3f(0.3, -0.2, 0.25) * e)
    return shift @ mi.Transform4f().rotate([0.3, 1, 0.2], 6 * e)


def moved(params: Any) -> Any:
    """Return what gives the surface its place, and the net its points and weights, for `e`."""
    own = {key: params[key] for key in params.keys() if key.startswith("surface.")}  # noqa: SIM118
    matrix = mi.Matrix4f(mi.ScalarMatrix4f(np.array(own["surface.to_world"].matrix)[..., 0]))
    net = own.get("surface.control_points")
    if net is not None:
        net = np.array(net)
        change = np.random.default_rng(3).normal(size=net.shape) * [0.3, 0.3, 0.3, 0.15]

    def move(e: Any) -> None:
        params["surface.to_world"] = place(e) @ mi.Transform4f(matrix)
        if net is not None:
            params["surface.control_points"] = tensor(net) + e * tensor(change)
        params.update()

    return move


@pytest.mark.parametrize("make", [mirror, glass, nested, ball, lit_wall])
def test_chains(make):
    scene = make()
    move = moved(mi.traverse(scene))
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 6, "rr_depth": 20})
    w = weights(SIDE)

    def image(e: Any) -> Any:
        move(e)
        return mi.render(scene, integrator=integrator, spp=SPP, seed=1, seed_grad=2)

    def attached() -> tuple[Any, Any]:
        e = mi.Float(0)
        dr.enable_grad(e)
        move(e)
        params = mi.traverse(scene)
        return e, mi.render(scene, params, integrator=integrator, spp=SPP, seed=1, seed_grad=2)

    e, rendered = attached()
    dr.backward(dr.sum(rendered * mi.TensorXf(w), axis=None))
    got = dr.grad(e)[0]
    e, rendered = attached()
    dr.forward(e)
    forward = inner(dr.grad(rendered), w)
    # the same samples: only the order of sums differs, of terms that are larger than their sum
    assert forward == pytest.approx(got, rel=1e-3)

    step = 0.04
    want = (inner(image(mi.Float(step)), w) - inner(image(mi.Float(-step)), w)) / (2 * step)
    # two seeds of 65536 paths: a per cent of noise, most where other lobes are chosen
    assert got == pytest.approx(want, rel=0.05)


def test_index_of_refraction():
    # of a pane: what it reflects and lets through, not where to
    pane = bezier(sheet(0.5, 0.0), bsdf={"type": "thindielectric", "int_ior": 1.5})
    scene = scene_of(-3, 0, surface=pane)
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.endswith("eta"))  # noqa: SIM118
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 4})
    w, out = weights(SIDE), []
    params[key] = mi.Float(1.5)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(
        dr.sum(mi.render(scene, params, integrator=integrator, spp=SPP) * mi.TensorXf(w), axis=None)
    )
    got = dr.grad(params[key])[0]
    for e in (0.3, -0.3):
        params[key] = mi.Float(1.5 + e)
        params.update()
        out.append(inner(mi.render(scene, integrator=integrator, spp=SPP), w))
    # nothing but noise: 1 % of the picture, and the third derivative by the ior
    assert got == pytest.approx((out[0] - out[1]) / 0.6, rel=0.1)


def test_a_ball_looks_the_same_from_all_sides():
    # a glossy one that is seen by way of the floor: its whole frame turns, and nothing changes
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    scene = mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 2, 6], [0, 0, 0], [0, 1, 0]),
                **film(SIDE),
            },
            "floor": {"type": "rectangle", "to_world": turn.scale(9)},
            "ball": {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": 0.3}},
            "lamp": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().look_at([1, 4, 2], [0, 0, 0], [0, 0, 1]),
                "emitter": {"type": "area", "radiance": 9.0},
            },
        }
    )
    params = mi.traverse(scene)
    angle = mi.Float(0)
    dr.enable_grad(angle)
    params["ball.to_world"] = mi.Transform4f().rotate([0.3, 1, 0.2], angle)
    params.update()
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 4, "rr_depth": 20})
    image = mi.render(scene, params, integrator=integrator, spp=64)
    dr.backward(dr.sum(image * mi.TensorXf(weights(SIDE)), axis=None))
    # a degree changes nothing; 1e-6 are roundings, where half a frame that turns made 1e-4
    assert abs(dr.grad(angle)[0]) < 1e-6
