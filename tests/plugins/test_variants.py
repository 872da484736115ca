"""One body of tests over all variants of Mitsuba that start on this machine.

Scalar variants cannot run the kernels; that they say so is tested with the command line.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from render_cases import (
    BATCHES,
    SHARE,
    ball,
    camera,
    floor,
    moments,
    share_that_agrees,
)

import mitsuba_bezier as mb
from mitsuba_bezier import _runtime

VARIANTS = _runtime.usable_variants()


@pytest.fixture(scope="module", params=VARIANTS)
def variant(request: Any) -> Any:
    mi.set_variant(request.param)
    yield request.param
    mi.set_variant(VARIANT)


def test_some_variant_of_each_kind_starts():
    # what Mitsuba's wheels have; on a GPU the same five of cuda come on top
    kinds = {name.partition("_ad_")[2] for name in VARIANTS}
    assert kinds == {"rgb", "mono", "mono_polarized", "spectral", "spectral_polarized"}


def scene(kind: str, fog: bool = False) -> Any:
    """Return a glass ball, a diffuse ball of one colour or one of fog, and a ball that shines.

    The camera looks through a polarizer: light that the glass reflects is polarized, so where
    Mueller matrices count, each has to be turned into the right frame.
    """
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.1]}}
    light = {"type": "area", "radiance": {"type": "rgb", "value": [6, 5, 4]}}
    # of 30 degrees, which is neither along nor across the plane of any reflection
    filter_ = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 1, 6]).scale(3),
        "bsdf": {"type": "polarizer", "theta": {"type": "spectrum", "value": 30.0}},
    }
    glass = {"bsdf": {"type": "dielectric"}}
    right: dict[str, Any] = {"bsdf": red}
    if fog:
        medium = {
            "type": "homogeneous",
            "sigma_t": {"type": "rgb", "value": [0.9, 0.6, 0.3]},
            "albedo": {"type": "rgb", "value": [0.9, 0.7, 0.4]},
        }
        glass["interior"] = {**medium, "albedo": 0.0}  # coloured glass
        right = {"bsdf": {"type": "null"}, "interior": medium}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera(48, 20),
            "floor": floor(),
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}},
            "filter": filter_,
            "glass": ball(kind, [-1.6, 0, 0.5], 1, **glass),
            "right": ball(kind, [0.9, 0, 0], 1, **right),
            "lamp": ball(kind, [-0.2, 2.2, 1.0], 0.5, emitter=light),
        }
    )


SPP = 16


def check(native: tuple, ours: tuple) -> None:
    share = share_that_agrees(native, ours, SPP)
    assert native[0].mean() > 0.03  # there is light
    assert share >= SHARE, f"{share:.4%}"
    # five standard deviations of the mean over the image
    noise = np.sqrt((native[1] + ours[1]).sum() / (SPP * BATCHES)) / native[0].size
    assert ours[0].mean() == pytest.approx(native[0].mean(), abs=5 * noise)
    assert noise < 0.01 * native[0].mean()


def test_bezierpath_agrees_with_path(variant):
    native = moments(scene("native"), mi.load_dict({"type": "path", "max_depth": 6}), SPP, 0)
    integrator = mi.load_dict({"type": "bezierpath", "max_depth": 6})
    check(native, moments(scene("tetrahedral"), integrator, SPP, 1000))


def test_beziervolpath_agrees_with_volpath(variant):
    native = mi.load_dict({"type": "volpath", "max_depth": 6})
    ours = mi.load_dict({"type": "beziervolpath", "max_depth": 6})
    check(
        moments(scene("native", fog=True), native, SPP, 0),
        moments(scene("tetrahedral", fog=True), ours, SPP, 1000),
    )


def test_rays_meet_the_same_point(variant):
    shape = mi.load_dict({"type": "scene", "ball": ball("octants", [0, 0, 0], 1)})
    ray = mi.Ray3f(mi.Point3f([0.3, -0.2], [0.1, 0.4], -3), mi.Vector3f(0, 0, 1))
    si = mb.ray_intersect(shape, ray)
    p = np.array(si.p).T
    assert np.array(si.is_valid()).all()
    # 1e-6: roundings of float32 numbers of size one
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.array(si.n).T, p, atol=1e-6)
