"""Derivatives of what the light tracer draws, against central differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import forward, inner, lens, reverse, weights
from mitsuba_cases import bezier, tensor

import mitsuba_bezier as mb

SIDE = 8


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def caustic(rfilter: str = "gaussian") -> Any:
    """A spot light through a lens on a floor; all that it lights is inside of the film."""
    place = mi.ScalarTransform4f()
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 35,
                "to_world": place.look_at([0, -6, -1.2], [0, 0, -3], [0, 0, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": SIDE,
                    "height": SIDE,
                    "pixel_format": "rgb",
                    "rfilter": {"type": rfilter},
                },
            },
            "surface": bezier(lens(0.2), bsdf=glass),
            "floor": {"type": "rectangle", "to_world": place.translate([0, 0, -3]).scale(8)},
            "lamp": {
                "type": "spot",
                "to_world": place.look_at([0.2, 0.1, 4], [0, 0, 0], [0, 1, 0]),
                "cutoff_angle": 8,
                "beam_width": 2,
                "intensity": 900.0,
            },
        }
    )


def derivatives(key: str, value: Any, spp: int) -> tuple[float, float, Any]:
    """Return reverse and forward derivatives of the loss by what `value` takes, and the loss."""
    scene = caustic()
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.startswith(key))  # noqa: SIM118
    integrator = mi.load_dict({"type": "bezierptracer", "max_depth": 4, "rr_depth": 20})
    w = weights(SIDE)

    def rendered(e: Any) -> Any:
        params[key] = value(e)
        params.update()
        return mi.render(scene, params, integrator=integrator, spp=spp, seed=1, seed_grad=2)

    both = reverse(rendered, w), forward(rendered, w)
    return *both, lambda x: inner(rendered(mi.Float(x)), w)


def test_caustic():
    net = lens(0.2)
    change = np.random.default_rng(3).normal(size=net.shape) * [0.3, 0.3, 0.3, 0.15]
    reverse, forward, loss = derivatives(
        "surface.control_points", lambda e: tensor(net) + e * tensor(change), 4096
    )
    # the same paths
    assert forward == pytest.approx(reverse, rel=1e-3)
    step = 0.03
    # two seeds of 262144 paths: 2 % of noise, by those that reflect at one sign of the step only
    assert reverse == pytest.approx((loss(step) - loss(-step)) / (2 * step), rel=0.1)


def test_receiver():
    # it moves and turns under light that stays, and its colour changes what it reflects
    first = mi.Transform4f().translate(mi.Vector3f(0, 0, -3))

    def place(e: Any) -> Any:
        turn = mi.Transform4f().rotate([0.3, 1, 0.2], 5 * e)
        return mi.Transform4f().translate(mi.Vector3f(0.1, 0, -0.3) * e) @ first @ turn

    reverse, forward, loss = derivatives(
        "floor.to_world", lambda e: place(e) @ mi.Transform4f().scale(8), 1024
    )
    assert forward == pytest.approx(reverse, rel=1e-3)
    assert reverse == pytest.approx((loss(0.1) - loss(-0.1)) / 0.2, rel=0.05)
    reverse, forward, loss = derivatives(
        "floor.bsdf.reflectance", lambda e: mi.Float(0.5) + e, 4096
    )
    assert forward == pytest.approx(reverse, rel=1e-3)
    # linear in the albedo; a per cent is noise of other paths
    assert reverse == pytest.approx((loss(0.1) - loss(-0.1)) / 0.2, rel=0.05)


def test_box_filters_have_none():
    scene = caustic("box")
    params = mi.traverse(scene)
    dr.enable_grad(params["surface.control_points"])
    params.update()
    integrator = mi.load_dict({"type": "bezierptracer"})
    with pytest.raises(Exception, match="rfilter: expected a filter without a step"):
        integrator.render_backward(scene, params, mi.TensorXf(weights(SIDE)), spp=1)


def test_lights_that_move_are_refused():
    lamp = {"type": "rectangle", "emitter": {"type": "area"}}
    camera = {"type": "perspective", "film": {"type": "hdrfilm", "width": 2, "height": 2}}
    scene = mi.load_dict({"type": "scene", "camera": camera, "lamp": lamp})
    params = mi.traverse(scene)
    theta = mi.Float(0)
    dr.enable_grad(theta)
    params["lamp.to_world"] = params["lamp.to_world"] @ mi.Transform4f().rotate([1, 0, 0], theta)
    params.update()
    integrator = mi.load_dict({"type": "bezierptracer"})
    with pytest.raises(
        mb.BezierError, match=r"bezierptracer: expected .*bezierpath.*lamp.to_world"
    ):
        integrator.render_backward(scene, params, dr.zeros(mi.TensorXf, (2, 2, 3)), spp=1)


def lit(lamp: dict[str, Any]) -> Any:
    scene = {
        "type": "scene",
        "camera": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "rgb"},
        },
        "wall": {"type": "rectangle"},
        "lamp": lamp,
    }
    return mi.load_dict(scene)


LAMPS = {
    "area": ("lamp.emitter.radiance.value", {"type": "rectangle", "emitter": {"type": "area"}}),
    "point": ("lamp.intensity.value", {"type": "point", "position": [0, 0, 2.0]}),
}


@pytest.mark.parametrize("kind", LAMPS)
def test_radiance_of_lights(kind):
    """The light is linear in it; derivatives were 0, and forward a fault of Dr.Jit."""
    key, lamp = LAMPS[kind]
    if kind == "area":
        lamp["to_world"] = mi.ScalarTransform4f().look_at([0, 1, 2], [0, 0, 0], [0, 0, 1])
    scene = lit(lamp)
    params = mi.traverse(scene)
    integrator = mi.load_dict({"type": "bezierptracer", "max_depth": 3})
    w = weights(4)
    want = float((np.array(mi.render(scene, integrator=integrator, spp=4096, seed=1)) * w).sum())
    dr.enable_grad(params[key])
    params.update()
    integrator.render_backward(scene, params, mi.TensorXf(w), seed=1, spp=4096)
    got = float((np.array(dr.grad(params[key])) * np.array(params[key])).sum())
    # 65536 paths, others for what is seen at once
    assert got == pytest.approx(want, rel=0.05)
    with pytest.raises(Exception, match="bezierptracer: expected reverse mode"):
        integrator.render_forward(scene, params, seed=1, spp=4)
