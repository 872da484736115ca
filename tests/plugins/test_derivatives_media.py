"""Derivatives of `beziervolpath` by media, materials and lights, against central differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import film, forward, inner, reverse, weights
from mitsuba_cases import bezier, sphere_net

SIDE = 4


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def scene_of(kind: str) -> Any:
    """A ball of fog or of cloud before a wall, under a lamp and a sky."""
    place = mi.ScalarTransform4f()
    fog = {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": [0.8, 0.5, 0.3]},
        "sigma_t": {"type": "rgb", "value": [0.9, 0.7, 0.5]},
        "phase": {"type": "hg", "g": 0.3},
    }
    grid = np.random.default_rng(0).uniform(0.3, 2, (3, 4, 5, 1)).astype(np.float32)
    cloud = {
        "type": "heterogeneous",
        "albedo": 0.8,
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(grid),
            "to_world": place.translate([-1, -1, -1]).scale(2),
        },
    }
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 30,
                "to_world": place.look_at([0, 0.5, 5], [0, 0, 0], [0, 1, 0]),
                **film(SIDE),
            },
            "ball": {
                **bezier(),
                "control_points": sphere_net("tetrahedral"),
                "bsdf": {"type": "null"},
                "interior": fog if kind == "fog" else cloud,
            },
            "wall": {"type": "rectangle", "to_world": place.translate([0, 0, -1.5]).scale(4)},
            "lamp": {
                "type": "rectangle",
                "to_world": place.look_at([2, 3, 2], [0, 0, 0], [0, 1, 0]),
                "emitter": {"type": "area", "radiance": 5.0},
            },
            "sky": {"type": "constant", "radiance": 0.3},
        }
    )


@pytest.mark.parametrize(
    ("kind", "key", "step"),
    [
        ("fog", "ball.interior_medium.sigma_t", 0.2),
        ("fog", "ball.interior_medium.albedo", 0.1),
        ("fog", "lamp.emitter.radiance", 1.0),
        ("cloud", "ball.interior_medium.sigma_t", 0.2),
    ],
)
def test_media(kind, key, step):
    scene = scene_of(kind)
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.startswith(key))  # noqa: SIM118
    first = type(params[key])(params[key])
    integrator = mi.load_dict({"type": "beziervolpath", "max_depth": 6, "rr_depth": 20})
    w = weights(SIDE)

    def rendered(e: Any, seed: int = 1) -> Any:
        params[key] = first + e
        params.update()
        return mi.render(
            scene, params, integrator=integrator, spp=8192, seed=seed, seed_grad=seed + 10
        )

    got = reverse(rendered, w)
    # the same paths
    assert forward(rendered, w) == pytest.approx(got, rel=1e-3)
    out = [inner(rendered(mi.Float(x)), w) for x in (step, -step)]
    # 131072 paths: 2 % of noise, and the third derivative by the density
    assert got == pytest.approx((out[0] - out[1]) / (2 * step), rel=0.08)


def test_what_moves_is_refused():
    scene = scene_of("fog")
    params = mi.traverse(scene)
    dr.enable_grad(params["ball.control_points"])
    params.update()
    integrator = mi.load_dict({"type": "beziervolpath"})
    with pytest.raises(Exception, match=r"beziervolpath: expected .*bezierpath.* ball.control_p"):
        integrator.render_backward(scene, params, mi.TensorXf(weights(SIDE)), spp=1)
