"""Derivatives in variants whose spectra are colours, wavelengths, or one number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import film, forward, inner, reverse, weights
from mitsuba_cases import bezier, sphere_net, tensor

SIDE = 4


@pytest.fixture(params=["rgb", "spectral", "mono"], autouse=True)
def variant(request: pytest.FixtureRequest) -> None:
    mi.set_variant(VARIANT.replace("rgb", request.param))


def scene_of(bsdf: dict[str, Any], rfilter: str, lamp: dict[str, Any], **more: Any) -> Any:
    """A large ball that fills the view, above a floor, under a lamp."""
    place = mi.ScalarTransform4f()
    camera = {
        "type": "perspective",
        "fov": 16,
        "to_world": place.look_at([0, 0, 7], [0, 0, 0], [0, 1, 0]),
        **film(SIDE),
    }
    camera["film"]["rfilter"] = {"type": rfilter}
    net = sphere_net("tetrahedral", radius=1.5)
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera,
            "surface": bezier(net, bsdf=bsdf, **more),
            "floor": {"type": "rectangle", "to_world": place.translate([0, 0, -3]).scale(8)},
            "lamp": lamp,
        }
    )


def both(scene: Any, key: str, value: Callable[[Any], Any], kind: str, spp: int) -> Any:
    """Return derivatives in reverse and forward mode, and the loss."""
    params = mi.traverse(scene)
    integrator = mi.load_dict({"type": kind, "max_depth": 5, "rr_depth": 20})
    w = weights(SIDE)

    def rendered(e: Any) -> Any:
        params[key] = value(e)
        params.update()
        return mi.render(scene, params, integrator=integrator, spp=spp, seed=1, seed_grad=2)

    return reverse(rendered, w), forward(rendered, w), lambda x: inner(rendered(mi.Float(x)), w)


def grown(scene: Any) -> Callable[[Any], Any]:
    """Return the net for a number by which it grows."""
    net = np.array(mi.traverse(scene)["surface.control_points"])
    change = net @ np.diag([0.5, 0.2, 0.3, 0]).astype(np.float32)
    return lambda e: tensor(net) + e * tensor(change)


@pytest.mark.parametrize("kind", ["bezierpath", "bezierptracer"])
def test_what_a_spot_lights(kind):
    # the light of its cone changes with the place of what it falls on
    place = mi.ScalarTransform4f().look_at([0.2, 0.1, 5], [0, 0, 0], [0, 1, 0])
    spot = {"type": "spot", "to_world": place, "cutoff_angle": 8, "intensity": 300.0}
    scene = scene_of({"type": "diffuse", "reflectance": 0.5}, "gaussian", spot)
    back, ahead, loss = both(scene, "surface.control_points", grown(scene), kind, 1024)
    assert ahead == pytest.approx(back, rel=1e-3)  # the same paths
    # two seeds of some 10000 paths: a per cent of noise
    assert back == pytest.approx((loss(0.05) - loss(-0.05)) / 0.1, rel=0.05)


def test_media():
    fog = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.7}
    place = mi.ScalarTransform4f().look_at([0, 1, 5], [0, 0, 0], [0, 1, 0])
    light = {"type": "area", "radiance": {"type": "uniform", "value": 9.0}}
    lamp = {"type": "rectangle", "to_world": place, "emitter": light}
    scene = scene_of({"type": "null"}, "box", lamp, interior=fog)
    key = "lamp.emitter.radiance.value"
    back, ahead, loss = both(scene, key, lambda e: mi.Float(9) + e, "beziervolpath", 1024)
    assert ahead == pytest.approx(back, rel=1e-3)
    assert back == pytest.approx((loss(1.0) - loss(-1.0)) / 2, rel=0.05)
