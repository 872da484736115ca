"""Textures on Bézier shapes against Mitsuba's own shapes: Z-tests, and maps point by point."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier, numbers, ray_of, tensor
from render_cases import BATCHES, SHARE, bezierpath, camera, floor, moments, path, sky

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.bernstein import multi_indices
from mitsuba_bezier.verification import ztest

POINTS = [[1, 0, 0], [0.8, 0.9, 0.5], [0.4, 0, 0.6], [0, 2, 0.3], [0.1, 0.7, 0.3], [0, 0, 0]]
WEIGHTS = np.array([1, 1, 1, 2, 0.6, 0.7])[:, None]
CORNERS = np.array([[[0.9, 0.2], [0.3, 0.95], [0.1, 0.1]]])
SPP = 32


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def uneven_patch() -> mb.BezierTriangles:
    return mb.BezierTriangles(np.hstack([np.array(POINTS) * WEIGHTS, WEIGHTS])[None])


def tessellated(patches: mb.BezierTriangles, resolution: int, bsdf: dict) -> Any:
    """Return one patch as a mesh with its normals and the texture coordinates `CORNERS`."""
    vertices, faces = patches.tessellate(resolution)
    uv = multi_indices(resolution)[:, :2] / resolution
    texture = np.column_stack([uv, 1 - uv.sum(axis=1)]) @ CORNERS[0]
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(
        "patch",
        len(vertices),
        len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    values = {
        "vertex_positions": mi.Float(vertices.ravel()),
        "vertex_normals": mi.Float(patches.normals(0, uv).ravel()),
        "vertex_texcoords": mi.Float(texture.ravel()),
        "faces": mi.UInt32(faces.ravel()),
    }
    params = mi.traverse(mesh)
    for key, value in values.items():
        params[key] = value
    params.update()
    return mesh


def image(*shape: int, low: float = 0.1, seed: int = 1) -> Any:
    values = low + (1 - low) * np.random.default_rng(seed).random(shape)
    return mi.Bitmap(values.astype(np.float32))


def bitmap(pixels: Any, **more: Any) -> dict:
    return {"type": "bitmap", "bitmap": pixels, "raw": True, **more}


def share_within_noise(a: tuple, b: tuple, spp: int) -> float:
    """Return the share of pixels that pass Mitsuba's Z-test; see `mitsuba_bezier.verification`."""
    variances = [np.maximum(v, ztest.VARIANCE_FLOOR) / (spp * BATCHES) for _mean, v in (a, b)]
    z = ztest.z_scores(a[0], b[0], *variances)
    critical = ztest.critical_z(z.shape[0] * z.shape[1])
    return float((np.abs(z) < critical).mean())


# ---------------------------------------------------------------- Z-tests


def textured_lamp(kind: str) -> Any:
    """A ball with one colour in each octant above a floor; nothing else shines."""
    pixels = image(2, 4, 3, low=0.0)  # rows: above and below, columns: quarters around z
    shape: dict[str, Any] = {
        "emitter": {"type": "area", "radiance": bitmap(pixels, filter_type="nearest")},
        "to_world": mi.ScalarTransform4f().translate([0, 0.3, 0]).scale(0.8),
    }
    if kind == "native":
        shape["type"] = "sphere"
    else:
        patches = mb.sphere(cover="octants")
        middle = patches.points(range(8), np.full((8, 2), 1 / 3))
        around = np.arctan2(middle[:, 1], middle[:, 0]) % (2 * np.pi) / (2 * np.pi)
        down = np.arccos(middle[:, 2] / np.linalg.norm(middle, axis=1)) / np.pi
        shape.update(type="beziertriangle", control_points=tensor(patches))
        if kind == "projection":
            shape["uv"] = "spherical"
        elif kind == "texture":
            # all of a patch within one pixel of the image
            spread = np.array([[0.1, 0], [0, 0.2], [-0.1, -0.2]])
            shape["texcoords"] = tensor(np.stack([around, down], axis=-1)[:, None] + spread)
        else:
            row, column = (np.floor(x).astype(int) for x in (2 * down, 4 * around))
            shape["face_light"] = tensor(np.array(pixels)[row, column])
            radiance = {"type": "mesh_attribute", "name": "face_light"}
            shape["emitter"] = {"type": "area", "radiance": radiance}
    return mi.load_dict(
        {"type": "scene", "camera": camera(48, 20), "floor": floor(), "lamp": shape}
    )


@pytest.fixture(scope="module")
def native_lamp(variant) -> tuple:
    return moments(textured_lamp("native"), path(max_depth=3), 2 * SPP, 0)


@pytest.mark.parametrize("kind", ["texture", "attribute", "projection"])
def test_a_textured_area_light_on_a_sphere(native_lamp, kind):
    native = native_lamp
    ours = moments(textured_lamp(kind), bezierpath(max_depth=3), 2 * SPP, 4000)
    assert native[0].mean() > 0.05
    share = share_within_noise(native, ours, 2 * SPP)
    assert share >= SHARE, f"{share:.4%}"
    noise = np.sqrt((native[1] + ours[1]).sum() / (2 * SPP * BATCHES)) / native[0].size
    # five standard deviations of the mean over the image
    assert ours[0].mean() == pytest.approx(native[0].mean(), abs=5 * noise)


def patch_in_the_open(kind: str) -> Any:
    bsdf = {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": bitmap(image(16, 16, 3))},
    }
    if kind == "mesh":
        # 96: the tessellation is 1e-4 off the surface, a hundredth of a pixel
        shape = tessellated(uneven_patch(), 96, bsdf)
    else:
        shape = bezier(uneven_patch(), texcoords=tensor(CORNERS), bsdf=bsdf)
    view = camera(40, 32)
    view["to_world"] = mi.ScalarTransform4f().look_at([0.4, 0.8, 3], [0.4, 0.8, 0], [0, 1, 0])
    return mi.load_dict({"type": "scene", "camera": view, "shape": shape, "sky": sky()})


def test_a_bitmap_on_a_patch():
    mesh = moments(patch_in_the_open("mesh"), path(max_depth=3), SPP, 0)
    ours = moments(patch_in_the_open("ours"), bezierpath(max_depth=3), SPP, 4000)
    share = share_within_noise(mesh, ours, SPP)
    assert share >= SHARE, f"{share:.4%}"


# ---------------------------------------------------------------- maps that turn normals


def bumpy() -> dict:
    # bilinear between pixels: its slope jumps, there neighbours are not compared
    values = mi.Bitmap(0.6 * np.array(image(8, 8, 1)))
    return {
        "type": "bumpmap",
        "arbitrary": bitmap(values, wrap_mode="clamp"),
        "bsdf": {"type": "diffuse"},
    }


def mapped() -> dict:
    values = np.array(image(8, 8, 3)) * [0.6, 0.6, 0.3] + [0.2, 0.2, 0.7]
    return {
        "type": "normalmap",
        "normalmap": bitmap(mi.Bitmap(values.astype(np.float32))),
        "bsdf": {"type": "roughplastic", "alpha": 0.4},
    }


@pytest.mark.parametrize("bsdf", [bumpy, mapped])
def test_maps_act_as_on_a_mesh(bsdf):
    patches = uneven_patch()
    mesh = mi.load_dict({"type": "scene", "mesh": tessellated(patches, 200, bsdf())})
    shape = mi.load_dict(bezier(patches, texcoords=tensor(CORNERS), bsdf=bsdf()))
    rng = np.random.default_rng(0)
    w = rng.dirichlet([1, 1, 1], 4000)
    p, n = patches.points(0, w[:, :2]), patches.normals(0, w[:, :2])
    ray = ray_of(p + 2 * n + 0.5 * rng.normal(size=p.shape), np.zeros(3))
    ray.d = dr.normalize(mi.Point3f(p.T) - ray.o)
    light = dr.normalize(mi.Vector3f((n + 0.3 * rng.normal(size=n.shape)).T))

    def reflected(si: Any) -> np.ndarray:
        context = mi.BSDFContext()
        return numbers(si.bsdf(mi.RayDifferential3f(ray)).eval(context, si, si.to_local(light)))

    theirs, ours = mesh.ray_intersect(ray), shape.ray_intersect(ray)
    both = np.array(theirs.is_valid() & ours.is_valid())
    assert both.mean() > 0.95
    a, b = reflected(theirs)[both, 0], reflected(ours)[both, 0]
    assert np.abs(numbers(theirs.uv) - numbers(ours.uv))[both].max() < 1e-3
    # the map does something
    plain = mi.load_dict(bezier(patches, bsdf={"type": "diffuse"}))
    c = reflected(plain.ray_intersect(ray))[both, 0]
    assert np.quantile(np.abs(a - c), 0.5) > 0.02
    # 1 %: the partials of a flat triangle are those of its middle, 1/200 away
    assert np.quantile(np.abs(a - b), 0.98) < 0.01 * a.max()
