"""The AOV integrator: Mitsuba's channels and numbers, and those of exact patches."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier, tensor

import mitsuba_bezier as mb
from mitsuba_bezier.plugins.integrators.bezieraov import KINDS

#: All types that Mitsuba's integrator knows.
ALL = ",".join(f"{kind}:{kind}" for kind in KINDS if kind not in ("patch", "boundary_test"))
SIDE = 24


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def scene_of(pixel_format: str = "rgb", **shapes: Any) -> Any:
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -1.2]).scale(3),
            },
            "sky": {"type": "constant"},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([4, 2, 2], [0, 0, 0], [0, 0, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": SIDE,
                    "height": SIDE,
                    "rfilter": {"type": "box"},
                    "pixel_format": pixel_format,
                },
                "sampler": {"type": "independent"},
            },
            **shapes,
        }
    )


def rendered(scene: Any, kind: str, aovs: str, spp: int = 4, **nested: Any) -> tuple:
    """Return the tensor, and the film's channels by name."""
    integrator = mi.load_dict({"type": kind, "aovs": aovs, **nested})
    image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=3))
    bitmap = scene.sensors()[0].film().bitmap()
    names = [field.name for field in bitmap.struct_()]
    return image, dict(zip(names, np.moveaxis(np.array(bitmap), -1, 0)))


def channels(aovs: str, *shapes: Any, spp: int = 1) -> dict[str, np.ndarray]:
    scene = scene_of(**{f"shape{i}": shape for i, shape in enumerate(shapes)})
    return rendered(scene, "bezieraov", aovs, spp)[1]


# ---------------------------------------------------------------- against Mitsuba


@pytest.mark.parametrize(
    ("pixel_format", "names"), [("rgb", ()), ("rgba", ("image",)), ("rgb", ("a", "b"))]
)
def test_without_bezier_shapes_it_is_aov(pixel_format, names):
    balls = {"ball": {"type": "sphere"}}
    nested = {name: {"type": "path", "max_depth": 3} for name in names}
    theirs, film = rendered(scene_of(pixel_format, **balls), "aov", ALL, **nested)
    ours, own_film = rendered(scene_of(pixel_format, **balls), "bezieraov", ALL, **nested)
    assert theirs.shape == ours.shape
    assert list(film) == list(own_film)
    # Mitsuba has NaN in the texture partials where rays meet nothing
    assert np.isfinite(ours).all()
    for name, channel in film.items():
        if name != "shape_index.I":  # numbers of another scene
            # the same numbers, maybe summed in another order
            assert np.nanmax(np.abs(channel - own_film[name])) < 1e-6, name
    # the tensor has one image for each nested integrator, which Mitsuba renders anew
    same = len(pixel_format)
    assert np.abs(theirs - ours)[..., :same].max() < 1e-6
    rest = slice(same * len(names), -1)
    assert np.nanmax(np.abs(theirs - ours)[..., rest]) < 1e-6


def test_nested_integrators_with_variables_of_their_own():
    inner = {"aovs": "d:depth", "image": {"type": "path", "max_depth": 2}}
    films = []
    for kind in ("aov", "bezieraov"):
        scene = scene_of(ball={"type": "sphere"})
        image, film = rendered(scene, kind, "n:geo_normal", inner={"type": kind, **inner})
        films.append(film)
    assert list(films[0]) == list(films[1])
    assert film["inner.d.T"].max() > 1
    # what the inner one returns by itself, a picture and depths, then the normal
    channels = ["R", "G", "B", "inner.d.T", "n.X", "n.Y", "n.Z"]
    expected = np.stack([film[channel] for channel in channels], axis=-1)
    assert image.shape == expected.shape and np.abs(image - expected).max() < 1e-6


def test_other_variants():
    for name in ("llvm_ad_spectral", "llvm_ad_mono"):
        if name not in mi.variants():
            continue
        mi.set_variant(name)
        try:
            colour = {"type": "rgb", "value": [0.2, 0.5, 0.8]}
            ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": colour}}
            aovs, nested = "a:albedo", {"i": {"type": "path", "max_depth": 2}}
            theirs = rendered(scene_of(ball=ball), "aov", aovs, **nested)[1]
            ours = rendered(scene_of(ball=ball), "bezieraov", aovs, **nested)[1]
            assert list(theirs) == list(ours)
            for channel in theirs:
                assert np.abs(theirs[channel] - ours[channel]).max() < 1e-5, channel
        finally:
            mi.set_variant(VARIANT)


def test_a_bezier_sphere_has_the_variables_of_a_sphere():
    aovs = "a:albedo,d:depth,p:position,n:geo_normal,s:sh_normal,f:shape_index"
    native = scene_of(ball={"type": "sphere"})
    theirs = rendered(native, "aov", aovs, image={"type": "path", "max_depth": 3})[1]
    exact = scene_of(ball=bezier(mb.sphere()))
    nested = {"type": "bezierpath", "max_depth": 3}
    ours = rendered(exact, "bezieraov", aovs, image=nested)[1]
    assert list(theirs) == list(ours)
    for name in theirs:
        if name.startswith(("a.", "d.", "p.", "n.", "s.")):
            # a sample at the silhouette may hit one and miss the other
            assert (np.abs(theirs[name] - ours[name]) < 2e-5).mean() > 0.97, name
    # ... and the picture is that of the nested integrator alone, to the sample
    alone = np.array(mi.render(exact, integrator=mi.load_dict(nested), spp=4, seed=3))
    first = np.stack([ours[c] for c in "RGB"], axis=-1)
    assert np.abs(alone - first).max() < 1e-6
    assert np.abs(np.stack([ours[f"image.{c}"] for c in "RGB"], axis=-1) - first).max() < 1e-6


# ---------------------------------------------------------------- variables of patches


def test_numbers_of_patches_and_shapes():
    beside = mi.ScalarTransform4f().translate([-0.65, 1.35, 0]).scale(0.4)
    image = channels(
        "k:patch,i:prim_index,s:shape_index,d:depth",
        bezier(mb.sphere(cover="octants")),
        bezier(mb.sphere(cover="tetrahedral"), to_world=beside),
    )
    patch, prim, shape = image["k.I"], image["i.I"], image["s.I"]
    first = (patch >= 0) & (patch < 8)
    second = patch >= 8
    assert first.sum() > 20 and second.sum() > 10
    assert np.array_equal(patch[first], prim[first])
    assert np.array_equal(patch[second] - 8, prim[second])
    assert len({*shape[first]}) == len({*shape[second]}) == 1
    assert shape[first][0] != shape[second][0]
    # the floor is no patch, nor is the sky
    rest = ~first & ~second
    assert (patch[rest] == -1).all() and (image["d.T"][rest] > 0).any()


def test_texture_coordinates_and_partials():
    corners = np.array([[[0.9, 0.2], [0.3, 0.95], [0.1, 0.1]]])
    net = [[[3, 0, 0, 1], [0, 3, 0, 1], [0, 0, 3, 1]]]
    image = channels(
        "t:uv,u:dp_du,v:dp_dv,x:duv_dx,p:position", bezier(net, texcoords=tensor(corners))
    )
    seen = image["t.U"] + image["t.V"] != 0
    p = np.stack([image[f"p.{c}"] for c in "XYZ"], axis=-1)
    seen &= np.abs(p.sum(axis=-1) - 3) < 1e-4  # not the floor
    assert seen.sum() > 40
    uv = np.stack([image["t.U"], image["t.V"]], axis=-1)[seen]
    expected = p[seen] / 3 @ corners[0]  # barycentric coordinates on this plane
    assert np.abs(uv - expected).max() < 1e-5
    a, b, c = corners[0]
    step = np.linalg.inv(np.column_stack([a - c, b - c]))
    by_uv = np.array([[3, 0, -3], [0, 3, -3]]).T @ step  # columns: dp_du, dp_dv
    for k, name in enumerate("uv"):
        got = np.stack([image[f"{name}.{c}"] for c in "XYZ"], axis=-1)[seen]
        assert np.abs(got - by_uv[:, k]).max() < 1e-4
    # from pixel to pixel the coordinates change by duv_dx
    inside = seen[:, 1:] & seen[:, :-1]
    jump = np.diff(image["t.U"], axis=1)[inside]
    # 0.6: one sample a pixel, anywhere in it
    assert abs(np.median(jump) / np.median(image["x.U"][seen]) - 1) < 0.6


def test_boundary_test():
    # a closed sphere has silhouettes only; its upper half has an edge too
    net = mb.sphere(cover="octants")
    corners = net.points(np.repeat(np.arange(8), 3), np.tile([[1, 0], [0, 1], [0, 0]], (8, 1)))
    heights = corners.reshape(8, 3, 3)[..., 2]
    upper = net[heights.max(axis=1) > 0.5]
    pole = heights[heights.max(axis=1) > 0.5].argmax(axis=1)  # the corner opposite to the edge
    aovs = "b:boundary_test,p:position,n:geo_normal,t:uv,k:patch"
    eye = np.array([4, 2, 2])
    for image, is_open in (
        (channels(aovs, bezier(net)), False),
        (channels(aovs, bezier(upper)), True),
    ):
        p = np.stack([image[f"p.{c}"] for c in "XYZ"], axis=-1)
        n = np.stack([image[f"n.{c}"] for c in "XYZ"], axis=-1)
        d = (p - eye) / np.linalg.norm(p - eye, axis=-1, keepdims=True)
        expected = np.abs((n * d).sum(axis=-1))
        ours = image["k.I"] >= 0
        assert ours.sum() > 20
        if is_open:
            u, v = image["t.U"][ours], image["t.V"][ours]
            patch = image["k.I"][ours].astype(int)
            edge = np.stack([u, v, 1 - u - v], axis=1)[np.arange(len(u)), pole[patch]]
            assert (edge < expected[ours]).mean() > 0.1
            expected[ours] = np.minimum(expected[ours], edge)
        seen = np.linalg.norm(n, axis=-1) > 0
        assert np.abs(image["b"] - expected)[seen].max() < 1e-5
        assert (image["b"][~seen] == 1).all() and (~seen).any()


def test_derivatives_of_depth():
    # a plane whose edges are out of the picture: they would move
    net = np.array([[[40, 0, -1, 1], [-40, 40, -1, 1], [-40, -40, -1, 1]]], dtype=float)
    scene = scene_of(shape=bezier(net))
    integrator = mi.load_dict({"type": "bezieraov", "aovs": "d:depth"})
    params = mi.traverse(scene)
    key = "shape.control_points"

    def mean_depth(height: float) -> Any:
        values = net.copy()
        values[..., 2] += height
        params[key] = tensor(values)
        params.update()
        return mi.render(scene, integrator=integrator, spp=4, seed=1)

    h = 1e-2
    expected = (np.array(mean_depth(h)) - np.array(mean_depth(-h))).mean() / (2 * h)
    mean_depth(0)
    lift = mi.Float(0.0)
    dr.enable_grad(lift)
    values = tensor(net)
    params[key] = values + lift * mi.TensorXf(np.float32([0, 0, 1, 0]).reshape(1, 1, 4))
    params.update()
    image = mi.render(scene, params, integrator=integrator, spp=4, seed=1)
    dr.backward(dr.mean(image, axis=None))
    # the differences of float32 images over 2 h
    assert dr.grad(lift)[0] == pytest.approx(expected, rel=1e-3)


def test_derivatives_with_a_nested_integrator():
    scene = scene_of(ball=bezier(mb.sphere()))
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.startswith("floor.") and "reflectance" in k)  # noqa: SIM118
    nested = mi.load_dict({"type": "bezierpath", "max_depth": 3})
    both = mi.load_dict({"type": "bezieraov", "aovs": "a:albedo", "image": nested})
    dr.enable_grad(params[key])
    params.update()

    # forward: the nested image's derivative, then that of the albedo
    dr.set_grad(params[key], 1.0)
    params.update()
    got = np.array(both.render_forward(scene, params, 0, 5, 16))
    dr.set_grad(params[key], 1.0)
    params.update()
    alone = np.array(nested.render_forward(scene, params, 0, 5, 16))
    assert got.shape == (SIDE, SIDE, 6)
    assert np.abs(got[..., :3] - alone).max() < 1e-5 and alone.max() > 0.1
    # 1 on the floor, seen at the bottom, and 0 in the sky above
    assert np.abs(got[-1, SIDE // 2, 3:] - 1).max() < 1e-5 and np.abs(got[0, 0, 3:]).max() == 0

    # backward: of the sum of all
    weights = dr.ones(mi.TensorXf, (SIDE, SIDE, 6))
    dr.set_grad(params[key], 0.0)
    both.render_backward(scene, params, weights, 0, 5, 16)
    assert np.array(dr.grad(params[key])).sum() == pytest.approx(got.sum(), rel=0.02)


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("properties", "words"),
    [
        ({"aovs": "x:deph"}, ["aovs: expected a type among albedo, depth, ", "patch", '"x:deph"']),
        ({"aovs": "depth"}, ["aovs: expected <name>:<type> pairs", '"depth"']),
        ({"aovs": ":depth"}, ["aovs: expected <name>:<type> pairs", '":depth"']),
        ({"aovs": "x:depth, x:uv"}, ["aovs: expected each name once", '"x"']),
        ({"aovs": 3}, ["aovs: expected a list", "got 3"]),
        ({}, ["aovs: expected a list", "got nothing"]),
        ({"aovs": "", "light": {"type": "ptracer"}}, ["light: expected an integrator"]),
        ({"aovs": "", "stone": {"type": "sphere"}}, ["stone: expected an integrator"]),
        ({"aovs": "", "max_depth": 3}, ["bezieraov: expected no path depth", "max_depth"]),
        ({"aovs": "", "aov": "x:uv"}, ["unknown parameter 'aov'; did you mean 'aovs'?"]),
    ],
)
def test_bad_input(properties, words):
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "bezieraov", **properties})
    for word in words:
        assert word in str(error.value)


def test_text():
    integrator = mi.load_dict(
        {"type": "bezieraov", "aovs": "d:depth, b:boundary_test", "image": {"type": "bezierpath"}}
    )
    assert "d:depth, b:boundary_test" in str(integrator) and "BezierPath" in str(integrator)
    assert integrator.aov_names() == ["image.R", "image.G", "image.B", "image.A", "d.T", "b"]
    assert mi.traverse(integrator) is not None
