"""Scenes of balls, native or of patches, and the statistics that compare their pictures."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import mitsuba as mi
import numpy as np
from mitsuba_cases import bezier

import mitsuba_bezier as mb

# ---------------------------------------------------------------- scenes

WIDTH, HEIGHT = 96, 40
BALLS = ["diffuse", "rough conductor", "dielectric"]


def bsdfs() -> dict[str, dict]:
    return {
        "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}},
        "rough conductor": {"type": "roughconductor", "alpha": 0.15, "material": "Cu"},
        "dielectric": {"type": "dielectric", "int_ior": 1.5},
    }


def ball(kind: str, center: list[float], radius: float, **more: Any) -> dict:
    """Return a sphere: Mitsuba's (``native``) or a cover."""
    if kind == "native":
        return {"type": "sphere", "center": center, "radius": radius, **more}
    place = mi.ScalarTransform4f().translate(center).scale(radius)
    return bezier(mb.sphere(cover=kind), to_world=place, **more)


def sky() -> Any:
    """Return a small environment map with a bright side."""
    rng = np.random.default_rng(0)
    values = 0.3 + 0.4 * rng.random((8, 16, 3), dtype=np.float32)
    values[2:4, 3:6] = [3.0, 2.5, 2.0]
    return {"type": "envmap", "bitmap": mi.Bitmap(values)}


def lamp() -> dict:
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([0, 4, 2], [0, 0, 0], [0, 0, 1]).scale(0.7),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [8, 8, 9]}},
    }


def floor() -> dict:
    board = {"type": "checkerboard", "to_uv": mi.ScalarTransform3f().scale([6, 6])}
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).translate([0, 0, -1]).scale(5),
        "bsdf": {"type": "diffuse", "reflectance": board},
    }


def camera(width: int = WIDTH, height: int = HEIGHT) -> dict:
    return {
        "type": "perspective",
        "fov": 50,
        "to_world": mi.ScalarTransform4f().look_at([0, 1.2, 8], [0, -0.1, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
        "sampler": {"type": "independent"},
    }


def three_balls(kind: str) -> Any:
    shapes = {
        f"ball{i}": ball(kind, [2.4 * (i - 1), 0, 0], 1.0, bsdf=bsdfs()[name])
        for i, name in enumerate(BALLS)
    }
    lights = {"sky": sky(), "lamp": lamp()}
    return mi.load_dict({"type": "scene", "camera": camera(), "floor": floor(), **lights, **shapes})


# ---------------------------------------------------------------- statistics

BATCHES = 16


def moments(scene: Any, integrator: Any, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and variance of one sample, from independent renders of `spp` samples."""
    images = np.stack(
        [
            np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed + k))
            for k in range(BATCHES)
        ]
    ).astype(np.float64)
    assert np.isfinite(images).all()
    return images.mean(axis=0), images.var(axis=0, ddof=1) * spp


def share_that_agrees(a: tuple, b: tuple, spp: int, columns: slice = slice(None)) -> float:
    """Return the share of pixels that pass Mitsuba's per-pixel Z-test, averaged over channels.

    As in Mitsuba's ``test_renders.py``: variance at least 1e-4, level 0.01 with Šidák's
    correction; here both images have noise.
    """
    (mean_a, var_a), (mean_b, var_b) = ((m[:, columns], v[:, columns]) for m, v in (a, b))
    count = spp * BATCHES
    variance = np.maximum(var_a, 1e-4) + np.maximum(var_b, 1e-4)
    z = np.abs(mean_a - mean_b) * np.sqrt(count / variance)
    alpha = 1 - (1 - 0.01) ** (1 / (z.shape[0] * z.shape[1]))
    return float((z < NormalDist().inv_cdf(1 - alpha / 2)).mean())


#: Mitsuba's own share. With variances from 16 batches a pixel of two equal renders is beyond
#: the level in one of 20 000 cases (Student's distribution with 30 degrees of freedom).
SHARE = 0.9975


SPP = 32


def path(**parameters: Any) -> Any:
    return mi.load_dict({"type": "path", **parameters})


def bezierpath(**parameters: Any) -> Any:
    return mi.load_dict({"type": "bezierpath", **parameters})
