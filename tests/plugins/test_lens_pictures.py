"""Pictures through the sensor ``lens`` against those that Mitsuba's own sensors and glass give."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from mitsuba_bezier.optics import (
    barrel_shapes,
    camera_frame,
    first_order,
    focused,
    lens_shapes,
    load,
    stopped_down,
)
from mitsuba_bezier.verification.ztest import critical_z

GAUSS = Path(__file__).parents[2] / "scenes/lenses/double_gauss.csv"
WIDTH, HEIGHT = 24, 16

#: A weak singlet: at f/20 and within a degree its aberrations blur 1 % of a pixel.
SINGLET = """# title: a weak singlet
radius, thickness, nd, semi_diameter, stop
60, 2, 1.5, 8,
-291.3, 0.0001, , 8,
inf, 99, , 2.5, yes
"""


@pytest.fixture(autouse=True)
def llvm():
    mi.set_variant("llvm_ad_rgb")


def film():
    return {
        "type": "hdrfilm",
        "width": WIDTH,
        "height": HEIGHT,
        "rfilter": {"type": "box"},
        "pixel_format": "luminance",
    }


def passes(scene, spp: int, count: int, seed: int) -> np.ndarray:
    return np.array(
        [np.array(mi.render(scene, spp=spp, seed=seed + k))[..., 0] for k in range(count)]
    )


def agree(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return the share of pixels whose means agree, and how far the images' means are apart.

    Variances are those of the passes; both are in standard errors.
    """
    count = len(a)
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / count + 1e-10)
    z = (a.mean(axis=0) - b.mean(axis=0)) / error
    total = np.sqrt((error**2).sum()) / error.size
    # with few passes Student's t has wider tails: its quantile at 4 normal standard deviations is
    # 6 for the 14 degrees of freedom of 8 passes
    share = (np.abs(z) < 1.5 * critical_z(z.size)).mean()
    return share, abs(a.mean() - b.mean()) / total


def stripes(distance: float, size: float, period: float):
    """Return a striped board that shines, in front of the camera and across its axis."""
    value = np.zeros((64, 64, 3), np.float32)
    value[(np.arange(64) // 8) % 2 == 0] = 1.0
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, distance]).rotate([0, 1, 0], 180)
        @ mi.ScalarTransform4f().scale(size),
        "emitter": {
            "type": "area",
            "radiance": {
                "type": "bitmap",
                "bitmap": mi.Bitmap(value),
                "raw": True,
                "filter_type": "nearest",
                "to_uv": mi.ScalarTransform3f().scale([period, period]),
            },
        },
    }


def board(x: float, z: float, size: float):
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([x, 0, z]).rotate([0, 1, 0], 180)
        @ mi.ScalarTransform4f().scale(size),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
    }


def test_depth_of_field_is_that_of_a_thin_lens(tmp_path):
    path = tmp_path / "singlet.csv"
    path.write_text(SINGLET)
    at, width = 1.0, 4.0
    lens = focused(load(path), 1000 * at)
    data = first_order(lens)
    pupil, radius = data.entrance_pupil, data.entrance_diameter / 2
    # what the film sees of the plane in focus, from the entrance pupil
    half = width / 2 / abs(data.magnification) / (1000 * at + pupil)
    # near, in focus and far; in scene units from the pupil
    boards = {
        "near": board(-0.0085, 0.5, 0.0052),
        "sharp": board(0.0, at + pupil / 1000, 0.0055),
        "far": board(0.05, 4.0, 0.03),
    }
    ours = {
        "type": "lens",
        "filename": str(path),
        "focus_distance": at,
        "film_width": width,
        "film": film(),
    }
    thin = {
        "type": "thinlens",
        "aperture_radius": radius / 1000,
        "focus_distance": at + pupil / 1000,
        "fov": 2 * np.degrees(np.arctan(half)),
        "film": film(),
    }
    images = []
    for sensor in (ours, thin, {**thin, "aperture_radius": 0.8 * radius / 1000}):
        scene = mi.load_dict(
            {"type": "scene", "integrator": {"type": "path"}, "sensor": sensor, **boards}
        )
        images.append(passes(scene, 256, 16, 1))
    assert agree(images[0], images[1])[0] >= 0.9975
    # brightness falls by cos^4 of up to 1.2 degrees, 0.1 %; the means' standard error is 0.05 %
    assert images[0].mean() == pytest.approx(images[1].mean(), rel=3e-3)
    assert images[0].mean(axis=0).std() > 0.1
    # and a pupil a fifth smaller does not
    assert agree(images[0], images[2])[0] < 0.97


def geometry(lens, sensor, scale, size):
    """Return the glass and the barrel of a sensor in its scene."""
    frame = camera_frame(lens, scale=scale)
    iris = {key: sensor[key] for key in ("blades", "blade_rotation") if key in sensor}
    shapes = lens_shapes(lens, to_world=frame, **iris)
    return {**shapes, **barrel_shapes(lens, size, frame)}


def test_the_sequence_of_surfaces_is_the_glass_in_the_scene_without_ghosts():
    lens = stopped_down(focused(load(GAUSS), 2000.0), 4.0)
    common = {"type": "lens", "filename": str(GAUSS), "f_number": 4.0, "focus_distance": 2.0}
    common |= {"blades": 3, "blade_rotation": 20.0}  # a shape that is seen, and is no mirror image
    inside = {**common, "coating": "none", "film": film()}
    outside = {**common, "glass": "scene", "coating": "none", "film": film()}
    boards = {"sharp": stripes(2.05, 0.4, 1.0), "far": board(0.25, 4.0, 0.1)}
    # light that is not reflected meets ten surfaces of glass; two reflections meet two more
    straight = {"type": "path", "max_depth": 11, "rr_depth": 100}
    a = mi.load_dict({"type": "scene", "integrator": straight, "sensor": inside, **boards})
    body = geometry(lens, outside, 1e-3, 22.0)
    b = mi.load_dict({"type": "scene", "integrator": straight, "sensor": outside, **boards, **body})
    ours, glass = passes(a, 64, 12, 1), passes(b, 64, 12, 50)
    assert ours.mean() > 0.2
    share, off = agree(ours, glass)
    assert share >= 0.9975 and off < 4


def test_ghosts_are_those_of_the_glass_in_the_scene():
    lens = stopped_down(focused(load(GAUSS), 2000.0), 4.0)
    common = {"type": "lens", "filename": str(GAUSS), "f_number": 4.0, "focus_distance": 2.0}
    inside = {**common, "ghosts": True, "coating": "none", "film": film()}
    outside = {**common, "glass": "scene", "coating": "none", "film": film()}
    # a lamp in a corner of the picture, and what it does to the dark rest of it
    lamp = {"lamp": board(0.35, 2.05, 0.2)}
    path = {"type": "path", "max_depth": 60, "rr_depth": 100}

    def scene(sensor, **more):
        sensor = {**sensor, "film": {**film(), "width": 12, "height": 8}}
        parts = {"type": "scene", "integrator": path, "sensor": sensor, **lamp, **more}
        return mi.load_dict(parts)

    ours = passes(scene(inside), 1024, 8, 1)
    glass = passes(scene(outside, **geometry(lens, outside, 1e-3, 22.0)), 128, 8, 50)
    dark = passes(scene({**inside, "ghosts": False}), 64, 2, 9).mean(axis=0) == 0
    assert 0.5 < dark.mean() < 0.9
    assert agree(ours, glass)[0] >= 0.9975
    a, b = ours[:, dark].mean(axis=1), glass[:, dark].mean(axis=1)
    error = np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / 8)
    # four standard errors, which are far less than the ghosts
    assert abs(a.mean() - b.mean()) < 4 * error < 0.6 * b.mean()
