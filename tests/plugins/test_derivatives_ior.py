"""Derivatives by the index of refraction of `dispersive`, against central differences."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import film, forward, inner, picture, reverse, weights
from mitsuba_cases import bezier, sphere_net

import mitsuba_bezier as mb

SIDE = 4


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def behind_a_ball(fov: float, **glass: Any) -> Any:
    """A bright picture, seen through a ball of glass."""
    place = mi.ScalarTransform4f()
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": fov,
                "to_world": place.look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
                **film(SIDE),
            },
            "ball": {
                **bezier(sphere_net("octants")),
                "bsdf": {"type": "dispersive", **glass},
            },
            "sky": {"type": "envmap", "bitmap": picture()["bitmap"]},
        }
    )


def measured(scene: Any, name: str, step: float, spp: int) -> tuple[float, float, float]:
    """Return reverse and forward derivatives, and the central difference."""
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.endswith(name))  # noqa: SIM118
    first = float(params[key][0])
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 5, "rr_depth": 20})
    w = weights(SIDE)

    def rendered(e: Any, seed: int = 2) -> Any:
        params[key] = first + e
        params.update()
        return mi.render(scene, params, integrator=integrator, spp=spp, seed=1, seed_grad=seed)

    both = reverse(rendered, w), forward(rendered, w)
    # the same random numbers on both sides
    out = [inner(rendered(mi.Float(x)), w) for x in (step, -step)]
    return *both, (out[0] - out[1]) / (2 * step)


@pytest.mark.parametrize("kind", ["rgb", "spectral", "mono"])
def test_index_inside(kind):
    mi.set_variant(VARIANT.replace("rgb", kind))
    back, ahead, want = measured(behind_a_ball(14, int_ior=1.5), "int_ior", 0.01, 4096)
    assert ahead == pytest.approx(back, rel=1e-3)  # the same paths
    # a per cent of noise: other wavelengths, and lobes, are chosen on the two sides
    assert back == pytest.approx(want, rel=0.05)


def test_index_outside_where_some_is_totally_reflected():
    # a bubble: beyond 42 degrees nothing passes, and the derivative of what passes is infinite
    scene = behind_a_ball(10, material="air", ext_ior=1.5)
    back, ahead, want = measured(scene, "ext_ior", 0.01, 4096)
    assert np.isfinite(back) and ahead == pytest.approx(back, rel=1e-3)
    assert back == pytest.approx(want, rel=0.05)


def test_all_wavelengths_move_along():
    glass = mi.load_dict({"type": "dispersive", "material": "1.62:36.37"})
    params = mi.traverse(glass)
    assert float(params["int_ior"][0]) == pytest.approx(1.62, abs=1e-6)
    assert float(params["ext_ior"][0]) == 1.0
    si = mi.SurfaceInteraction3f()
    si.wi, si.time = mi.Vector3f(0.6, 0, 0.8), mi.Float(0)
    context = mi.BSDFContext()
    before = [glass.sample(context, si, mi.Float(x), mi.Point2f(0.5))[0].eta[0] for x in (0.3, 0.9)]
    params["int_ior"] = mi.Float(1.72)
    params.update()
    after = [glass.sample(context, si, mi.Float(x), mi.Point2f(0.5))[0].eta[0] for x in (0.3, 0.9)]
    assert before[0] != before[1]  # two colours
    assert np.array(after) - before == pytest.approx(0.1, abs=1e-5)


def test_bad_indices():
    for bad in (-1.0, 0.0, np.inf):
        with pytest.raises(RuntimeError, match="int_ior: expected a positive number"):
            mi.load_dict({"type": "dispersive", "int_ior": bad})
    with pytest.raises(RuntimeError, match="int_ior: expected it or material, not both"):
        mi.load_dict({"type": "dispersive", "int_ior": 1.5, "material": "1.5"})
    glass = mi.load_dict({"type": "dispersive", "int_ior": 1.5})
    params = mi.traverse(glass)
    params["int_ior"] = mi.Float(np.nan)
    with pytest.raises(mb.BezierError, match="int_ior: expected one positive number"):
        params.update()
    assert float(glass.int_ior[0]) == 1.5  # as before
