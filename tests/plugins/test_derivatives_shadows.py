"""Derivatives of soft shadows by `shadow_steps` of `bezierpath`, against central differences."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import film, forward, inner, lens, reverse, weights
from mitsuba_cases import bezier, sphere_net

SIDE = 4
BLACK = {"type": "twosided", "paint": {"type": "diffuse", "reflectance": 0.0}}


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def pane(half: float) -> np.ndarray:
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    a, b, c, d = ([*xy, 0, 1] for xy in corners)
    return np.array([[a, b, c], [a, c, d]], dtype=float)


def scene_of(caster: dict[str, Any], **more: Any) -> Any:
    """A floor under a lamp, and something beside the view that throws a shadow into it."""
    place = mi.ScalarTransform4f()
    camera = {
        "type": "perspective",
        "fov": 12,
        "to_world": place.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
        **film(SIDE),
    }
    floor = {"type": "rectangle", "to_world": place.translate([0, 0, -3]).scale(6)}
    lamp = {
        "type": "rectangle",
        "to_world": place.look_at([3.2, 0.8, -0.5], [0, 0, -3], [0, 1, 0.1]).scale(0.5),
        "emitter": {"type": "area", "radiance": 20.0},
    }
    parts = {"camera": camera, "caster": caster, "floor": floor, "lamp": lamp}
    return mi.load_dict({"type": "scene", **parts, **more})


def above_floor(turn: float = 0.0) -> Any:
    return mi.ScalarTransform4f().translate([1.5, 0.4, -1.85]).rotate([0.3, 1, 0], turn)


def ball() -> Any:
    return scene_of(bezier(sphere_net(radius=0.6), to_world=above_floor(), bsdf=BLACK))


def sheet() -> Any:
    """Open edges only, none of them along the sides of the lamp."""
    return scene_of(bezier(pane(0.5), to_world=above_floor(25), bsdf=BLACK))


def rectangle() -> Any:
    """One of Mitsuba's shapes."""
    caster = {"type": "rectangle", "to_world": above_floor(25).scale(0.5), "bsdf": BLACK}
    return scene_of(caster)


def through_glass() -> Any:
    caster = bezier(sphere_net(radius=0.6), to_world=above_floor(), bsdf=BLACK)
    glass = bezier(lens(0.1), bsdf={"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    return scene_of(caster, glass=glass)


def measured(scene: Any, key: str, spp: int, steps: int = 16) -> tuple[float, float, float]:
    """Return derivatives by the place of a shape in reverse and forward mode, and difference."""
    params = mi.traverse(scene)
    first = mi.Transform4f(params[key])
    with_edges = mi.load_dict({"type": "bezierpath", "max_depth": 5, "shadow_steps": steps})
    w = weights(SIDE)

    def rendered(e: Any) -> Any:
        params[key] = mi.Transform4f().translate(mi.Vector3f(0.3, -0.2, 0.25) * e) @ first
        params.update()
        return mi.render(
            scene, params, integrator=with_edges, spp=64, spp_grad=spp, seed=1, seed_grad=2
        )

    both = reverse(rendered, w), forward(rendered, w)
    out = []
    for e in (0.1, -0.1):
        params[key] = mi.Transform4f().translate(mi.Vector3f(0.3, -0.2, 0.25) * e) @ first
        params.update()
        out.append(inner(mi.render(scene, integrator=with_edges, spp=16 * spp, seed=1), w))
    return *both, (out[0] - out[1]) / 0.2


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (ball, "caster.to_world"),
        (sheet, "caster.to_world"),
        (rectangle, "caster.to_world"),
        (ball, "floor.to_world"),
        (through_glass, "caster.to_world"),
    ],
)
def test_soft_shadows(make, key):
    back, ahead, want = measured(make(), key, 1024)
    assert ahead == pytest.approx(back, rel=1e-3)  # the same paths
    # 16384 paths: up to 5 % of noise in the derivative, 2 % in the difference
    assert back == pytest.approx(want, rel=0.15)


def test_without_them_there_is_nothing():
    back, _ahead, want = measured(ball(), "caster.to_world", 64, steps=0)
    assert back == 0 and want != 0


@pytest.mark.parametrize("bad", [-1, 1.5, "many", True])
def test_bad_numbers_of_steps(bad):
    with pytest.raises(RuntimeError, match="shadow_steps: expected an integer >= 0"):
        mi.load_dict({"type": "bezierpath", "shadow_steps": bad})


def test_integrators_with_outlines_have_samples_of_their_own():
    with pytest.raises(RuntimeError, match="shadow_steps: expected none beside sppi"):
        mi.load_dict({"type": "bezier_prb_projective", "shadow_steps": 8})
