"""The light tracer against the path tracer, where both converge."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from render_cases import BATCHES, ball, lamp, moments, share_that_agrees, sky

import mitsuba_bezier as mb

#: Samples of a light tracer are rare and bright where little light arrives: its batches are further
#: from normal than those that Mitsuba's 0.9975 is for. Two light tracers, ours and Mitsuba's on its
#: own spheres, agree on all pixels of most scenes.
SHARE = 0.99


def T() -> Any:
    return mi.ScalarTransform4f()


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def lights() -> dict[str, dict]:
    glow = {"type": "area", "radiance": rgb(6, 5, 3)}
    aim = T().look_at([2, 3, 2], [0, -0.5, 0], [0, 1, 0])
    return {
        "area on patches": ball("octants", [1.8, 1.5, 1.0], 0.5, emitter=glow),
        "area": lamp(),
        "point": {"type": "point", "position": [2, 3, 2], "intensity": rgb(20, 18, 15)},
        "spot": {"type": "spot", "to_world": aim, "intensity": rgb(40, 40, 40), "cutoff_angle": 35},
        "directional": {
            "type": "directional",
            "direction": [-0.5, -1, -0.4],
            "irradiance": rgb(3, 3, 2),
        },
        "constant": {"type": "constant", "radiance": rgb(0.6, 0.7, 0.8)},
        "envmap": sky(),
    }


def scene(material: dict, *names: str) -> Any:
    film = {"type": "hdrfilm", "width": 24, "height": 18, "rfilter": {"type": "box"}}
    eye = T().look_at([0, 2.5, 7], [0, 0, 0], [0, 1, 0])
    table = T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "fov": 45, "to_world": eye, "film": film},
            "table": {"type": "rectangle", "to_world": table, "bsdf": {"type": "diffuse"}},
            "ball": ball("octants", [0, 0, 0], 1.0, bsdf=material),
            **{f"light{k}": lights()[name] for k, name in enumerate(names)},
        }
    )


def assert_path_agrees(scene: Any, spp: int = 48, **parameters: Any) -> None:
    by_light = moments(scene, mi.load_dict({"type": "ptracer", **parameters}), spp, 0)
    by_path = moments(scene, mi.load_dict({"type": "path", **parameters}), spp, 500)
    share = share_that_agrees(by_light, by_path, spp)
    assert share >= SHARE, f"{share:.4f}, means {by_light[0].mean()} and {by_path[0].mean()}"
    # the whole picture is known better than its pixels: within four standard errors
    error = sum(np.mean(v) / (spp * BATCHES * v[..., 0].size) for _m, v in (by_light, by_path))
    assert abs(by_light[0].mean() - by_path[0].mean()) < 4 * np.sqrt(error)


DIFFUSE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}}
METAL = {"type": "roughconductor", "alpha": 0.4, "material": "Cu"}


@pytest.mark.parametrize(
    "light", ["area on patches", "area", "point", "spot", "directional", "constant", "envmap"]
)
def test_lights(light):
    mi.set_variant(VARIANT)
    assert_path_agrees(scene(DIFFUSE, light), max_depth=4)


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"])
def test_several_lights_and_metal(variant):
    mi.set_variant(variant)
    assert_path_agrees(scene(METAL, "area on patches", "point", "constant"), 192, max_depth=4)


@pytest.mark.parametrize("parameters", [{"max_depth": 1}, {"max_depth": 2, "hide_emitters": True}])
def test_depths(parameters):
    mi.set_variant(VARIANT)
    assert_path_agrees(scene(DIFFUSE, "area on patches", "constant"), **parameters)


def crossed_mirrors() -> Any:
    """Return two mirrors of glass at Brewster's angle, one across the other, and a screen."""
    angle = np.pi - 2 * np.arctan(1.5)
    first = np.array([1.0, 0, 0])
    second = np.array([np.cos(angle), np.sin(angle), 0])
    third = np.cos(angle) * second + np.array([0, 0, np.sin(angle)])

    def disk(place: np.ndarray, normal: np.ndarray, radius: float, **more: Any) -> dict:
        up = [0, 0, 1] if abs(normal[2]) < 0.5 * np.linalg.norm(normal) else [1, 0, 0]
        aim = T().look_at(list(place), list(place + normal), up)
        return mb.shape(mb.disk(), to_world=aim.scale(radius), **more)

    glass = {"type": "twosided", "m": {"type": "conductor", "eta": 1.5, "k": 0.0}}
    black = {"type": "twosided", "m": {"type": "diffuse", "reflectance": 0.0}}
    screen = 2 * second + 2 * third
    side = np.cross(third, [1, 0, 0])
    side = np.sin(0.9) * side / np.linalg.norm(side) - np.cos(0.9) * third
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    eye = T().look_at(list(screen + 4 * side), list(screen), [0.1, 0.2, 1])
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "fov": 25, "to_world": eye, "film": film},
            "first": disk(np.zeros(3), second - first, 1, bsdf=glass),
            "second": disk(2 * second, third - second, 1, bsdf=glass),
            "screen": disk(screen, -third, 0.8, bsdf={"type": "diffuse"}),
            "lamp": disk(-3 * first, first, 0.5, emitter={"type": "area", "radiance": 50.0}),
            # no light reaches the screen but by both mirrors
            "tube": {
                "type": "cylinder",
                "p0": [-3.01, 0, 0],
                "p1": [-1, 0, 0],
                "radius": 0.51,
                "bsdf": black,
            },
            "board": {
                "type": "cube",
                "to_world": T().translate([-1, -1, 0.75]).scale([4, 2, 0.02]),
                "bsdf": black,
            },
        }
    )


def test_polarization():
    means = []
    for variant in ("llvm_ad_mono", "llvm_ad_mono_polarized"):
        mi.set_variant(variant)
        mirrors = crossed_mirrors()
        assert_path_agrees(mirrors, max_depth=5)
        image = mi.render(mirrors, integrator=mi.load_dict({"type": "ptracer"}), spp=256)
        means.append(np.array(image).mean())
    # what the first mirror leaves, the second one does not reflect; the cone of light is wide
    assert 0 < means[1] < 0.2 * means[0]
