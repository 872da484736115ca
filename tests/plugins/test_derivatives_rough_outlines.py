"""Derivatives of outlines that rough surfaces see in mirrors, and of small things in mirrors."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import central_by, film, weights
from mitsuba_cases import bezier

import mitsuba_bezier as mb
from mitsuba_bezier.plugins.integrators.crossings import _joined

SIDE, DEPTH = 4, 4
NET = "surface.control_points"
BALL = mb.sphere(cover="octants").control_points
MIRROR = {"type": "twosided", "one": {"type": "conductor", "material": "none"}}


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def ball(centre: Any, radius: float) -> np.ndarray:
    return BALL @ np.block([[radius * np.eye(3), np.array(centre)[:, None]], [0, 0, 0, 1]]).T


def look(*args: Any) -> Any:
    return mi.ScalarTransform4f().look_at(*args)


def scene_of(camera: dict[str, Any], **shapes: Any) -> Any:
    camera = {"type": "perspective", **camera, **film(SIDE)}
    return mi.load_dict({"type": "scene", "camera": camera, **shapes})


def grown(net: np.ndarray, centre: Any) -> np.ndarray:
    return net - net[..., 3:] * np.array([*centre, 1.0])


def reverse(integrator: dict[str, Any], scene: Any, change: np.ndarray, w: Any, spp: int) -> float:
    params = mi.traverse(scene)
    dr.enable_grad(params[NET])
    params.update()
    mi.load_dict(integrator).render_backward(scene, None, mi.TensorXf(w), seed=1, spp=spp)
    got = np.array(dr.grad(params[NET])).reshape(change.shape)
    dr.disable_grad(params[NET])
    return float((got * change).sum())


@pytest.mark.parametrize("radius", [0.8, 0.2], ids=["two pixels", "half a pixel"])
def test_small_things_in_a_mirror(radius):
    """Of two outlines in one piece of a line, none was found."""
    mi.set_variant(VARIANT)
    centre, fov = (4, 0.1, 0.2), 20
    light = {"type": "area", "radiance": 1.0}
    black = {"type": "diffuse", "reflectance": 0.0}
    scene = scene_of(
        {"fov": fov, "to_world": look([0, 0, 5], [0, 0, 0], [0, 1, 0])},
        surface=bezier(ball(centre, radius), bsdf=black, emitter=light),
        mirror={
            "type": "rectangle",
            "to_world": look([0, 0, 0], [1, 0, 1], [0, 1, 0]).scale(4),
            "bsdf": MIRROR["one"],
        },
    )
    change = grown(np.array(mi.traverse(scene)[NET]).reshape(BALL.shape), centre) / radius
    w = np.full((SIDE, SIDE, 3), 1 / 3, dtype=np.float32)
    outlines = {"type": "bezier_prb_projective", "max_depth": 3, "sppp": 0, "sppi": 0, "sppc": 0}
    got = reverse(outlines, scene, change, w, 4096)

    def area(r: float) -> float:
        """Return that of the ellipse in which a sphere is seen, in pixels."""
        away, x, y = 9.0, 0.2, 0.1
        pixel = 2 * np.tan(np.radians(fov / 2)) / SIDE
        square = away**2 + x**2 + y**2 - r**2
        return float(np.pi * r**2 * np.sqrt(square) / (away**2 - r**2) ** 1.5 / pixel**2)

    want = (area(radius + 1e-4) - area(radius - 1e-4)) / 2e-4
    # five standard errors of some thousand crossings
    assert got == pytest.approx(want, rel=0.05)


def floor_beside_a_mirror() -> Any:
    """A ball before a mirror takes light from a floor, half of it by way of the mirror."""
    return scene_of(
        {"fov": 20, "to_world": look([-1, -5, 5], [0.5, 0, 0], [0, 0, 1])},
        floor={"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(9)},
        mirror={
            "type": "rectangle",
            "to_world": look([2.5, 0, 3], [0, 0, 3], [0, 0, 1]).scale(3),
            "bsdf": MIRROR,
        },
        surface=bezier(ball((1.5, 0.2, 2.0), 0.6), bsdf={"type": "diffuse", "reflectance": 0.0}),
        sky={"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 1.0, 2.0]}},
    )


def floor_in_a_mirror() -> Any:
    """The shadow of a ball, which only a mirror shows to the camera."""
    return scene_of(
        {"fov": 14, "to_world": look([0, 0, 6], [0, 0, 0], [0, 1, 0])},
        mirror={
            "type": "rectangle",
            "to_world": look([0, 0, 0], [1, 0, 1], [0, 1, 0]).scale(4),
            "bsdf": MIRROR["one"],
        },
        floor={"type": "rectangle", "to_world": look([4, 0, 0], [0, 0, 0], [0, 1, 0]).scale(3)},
        surface=bezier(ball((2.4, 2.0, 0.3), 0.7), bsdf={"type": "diffuse", "reflectance": 0.0}),
        sky={"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 1.0, 2.0]}},
    )


SCENES = {
    "mirror seen by the floor": (floor_beside_a_mirror, (1.5, 0.2, 2.0)),
    "floor seen in the mirror": (floor_in_a_mirror, (2.4, 2.0, 0.3)),
}


@pytest.mark.parametrize("name", SCENES)
def test_outlines_between_rough_surfaces_and_mirrors(name):
    make, centre = SCENES[name]
    scene = make()
    change = grown(np.array(mi.traverse(scene)[NET]).reshape(BALL.shape), centre)
    w = weights(SIDE) * np.linspace(0.5, 1.5, SIDE, dtype=np.float32)[:, None]
    full = {"type": "bezier_prb_projective", "max_depth": DEPTH}
    got = reverse(full, scene, change, w, 2048)
    none = reverse({**full, "spps": 0}, scene, change, w, 512)
    want = central_by(scene, NET, change, w, 4096, 0.05, DEPTH)
    # both have standard errors of 2 %
    assert got == pytest.approx(want, rel=0.1)
    assert abs(none - want) > 0.25 * abs(want)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_lanes_are_joined_whatever_their_number(count):
    """Vectors were taken for numbers where they had as many lanes as coordinates."""
    parts = [
        (mi.Point2f([k] * count, [k + 1] * count), {"x": mi.Float([k] * count)}) for k in (0, 5)
    ]
    point, rest = _joined(parts)
    assert np.array(point).tolist() == [[0] * count + [5] * count, [1] * count + [6] * count]
    assert np.array(rest["x"]).tolist() == [0] * count + [5] * count
