"""Renders whose kernels have no float64: hits, points, normals, textures and derivatives."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT, has_float64
from mitsuba_cases import bezier

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.kernels import float64_use


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


@pytest.fixture(autouse=True)
def as_it_is_from_the_start(monkeypatch):
    monkeypatch.setattr(float64_use, "_chosen", None)
    monkeypatch.delenv(float64_use.VARIABLE, raising=False)


def all_kinds() -> dict:
    """A scene of all kinds of leaves, textures by position, instances and an asphere."""
    maps = np.tile(np.eye(4), (3, 1, 1))
    maps[:, :3, :3] *= 0.3
    maps[:, :3, 3] = [[-1.5, 0.5, 0], [0, 1.2, 0.3], [1.5, 0.5, 0]]
    checks = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
    move = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "bezierpath", "max_depth": 4},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": move().look_at([0.3, -5, 2.5], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 32, "height": 24, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant"},
        "ground": bezier(
            mb.plane(), to_world=move().translate([0, 0, -0.7]), uv="planar", bsdf=checks
        ),
        "ball": bezier(mb.sphere(radius=0.6), uv="spherical", bsdf=checks),
        "glass": bezier(
            mb.sphere(center=(1.2, -0.6, 0), radius=0.4, cover="tetrahedral"),
            bsdf={"type": "dielectric"},
        ),
        "cone": bezier(shapes.cone(center=(-1.2, -0.6, 0), capped=True)),
        "tori": bezier(mb.torus(tube=0.3), instances=maps),
        "bowl": {
            "type": "asphere",
            "curvature": 0.9,
            "aperture": 0.5,
            "coefficients": "0, 0.05, -0.03",
            "to_world": move().translate([0, -1.5, -0.6]),
        },
    }


def drawn(scene, use: str) -> tuple[np.ndarray, str]:
    """Return a picture, and what Dr.Jit generated for it."""
    mb.set_float64(use)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        picture = np.array(mi.render(scene, spp=4, seed=1))
        texts = [h["ir"] for h in dr.kernel_history() if "ir" in h]
    return picture, "".join(x if isinstance(x, str) else x.read() for x in texts)


def test_a_render_without_float64():
    # loaded anew: tables of textures are made with the scene
    pictures = {}
    for use in ("always", "never"):
        mb.set_float64(use)
        picture, code = drawn(mi.load_dict(all_kinds()), use)
        assert has_float64(code) == (use == "always")
        pictures[use] = picture
    off = np.abs(pictures["never"] - pictures["always"]).max(axis=2)
    assert pictures["always"].std() > 0.05
    # paths are the same; one that is split by a last rounding, at an edge, may be another
    assert (off > 1e-4).mean() < 0.01


def test_a_scene_follows_the_setting():
    """One scene, rendered in turn: no table is of the other kind."""
    scene = mi.load_dict({k: v for k, v in all_kinds().items() if k in (
        "type", "integrator", "sensor", "sky", "ball", "bowl")})  # fmt: skip
    for use in ("always", "never", "always"):
        _picture, code = drawn(scene, use)
        assert has_float64(code) == (use == "always")


@pytest.mark.parametrize("degree", (4, 9))
def test_derivatives(degree):
    """Those of points, normals and distances, by control points and the place of a shape."""
    net = mb.sphere(cover="octants").elevate(degree - 4)
    o = np.array([[0.3, 0.2, -3.0], [0.1, -0.5, -3.0], [0.6, 0.3, -3.0]], dtype=np.float32)
    ray = mi.Ray3f(mi.Point3f(*o.T.copy()), mi.Vector3f(0, 0, 1))
    found = {}
    for use in ("always", "never"):
        mb.set_float64(use)
        shape = mi.load_dict(bezier(net))
        params = mi.traverse(shape)
        points, place = params["control_points"], params["to_world"]
        dr.enable_grad(points, place)
        si = shape.ray_intersect(ray)
        loss = dr.sum(si.t + 0.3 * si.n.x + si.p.y * si.p.z + 0.1 * si.dp_du.x)
        dr.backward(loss)
        found[use] = np.array(dr.grad(points)), np.array(dr.grad(place.matrix))
    for one, other in zip(found["never"], found["always"]):
        assert np.abs(other).max() > 0.01
        # of float32, which adds up what cancels
        assert np.abs(one - other).max() < 1e-4 * np.abs(other).max()
