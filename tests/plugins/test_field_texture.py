"""The texture `bezierfield`: values, colours, isolines, sides of elements, bad parameters."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT, has_float64

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.camera import Camera, look_at
from mitsuba_bezier.geometry.fields import BezierField
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.kernels import float64_use
from mitsuba_bezier.plugins.colormaps import banded, color_table, linear_rgb


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def curved(degree: int, rational: bool = False) -> BezierTriangles:
    """Return two curved patches over the square, side by side."""
    rng = np.random.default_rng(degree)
    index = bernstein.multi_indices(degree) / degree
    corners = np.array([[[1, 0, 0], [0, 1, 0], [0, 0, 0]], [[0, 1, 0], [1, 0, 0], [1, 1, 0]]])
    points = np.einsum("kc,pcd->pkd", index, corners.astype(float))
    points += rng.uniform(-0.12, 0.12, points.shape) * (index.max(axis=1) < 1)[None, :, None]
    w = rng.uniform(0.6, 1.6, points.shape[:2]) if rational else np.ones(points.shape[:2])
    return BezierTriangles(np.concatenate([points * w[..., None], w[..., None]], axis=2))


def camera(width: int = 200, height: int = 200) -> dict[str, Any]:
    return {
        "type": "perspective",
        "fov": 30,
        "near_clip": 0.1,
        "far_clip": 100.0,
        "to_world": mi.ScalarTransform4f(CAMERA.to_world.tolist()),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
    }


CAMERA = Camera(look_at([0.9, 0.2, 2.4], [0.5, 0.5, 0], [0, 1, 0]), 30, "x", (200, 200),
                near_clip=0.1, far_clip=100.0)  # fmt: skip
PIXELS = " ".join(map(repr, CAMERA.matrix.ravel().tolist()))


def rays(patches, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return rays of the camera to random places of the patches, in float32."""
    rng = np.random.default_rng(seed)
    uv = 0.01 + 0.97 * rng.dirichlet([1, 1, 1], count)[:, :2]
    at = patches_points(patches, rng.integers(0, 2, count), uv)
    o = np.float32(CAMERA.center[:3])
    d = (at - o).astype(np.float32)
    return np.broadcast_to(o, d.shape).astype(np.float64), d.astype(np.float64)


def exact_parameters(patches, patch, uv, o, d) -> np.ndarray:
    """Return the parameters of hits in float64, by Newton's method from what a kernel found."""
    side = np.cross(d, [0.3, 1.0, 0.2])
    planes = np.stack([side, np.cross(d, side)], axis=1)
    for _ in range(4):
        h, du, dv = (np.asarray(x) for x in _jets(patches, patch, uv))
        rest = np.einsum("nic,nc->ni", planes, h[:, :3] - o * h[:, 3:])
        jac = np.stack(
            [np.einsum("nic,nc->ni", planes, x[:, :3] - o * x[:, 3:]) for x in (du, dv)], axis=2
        )
        uv = uv - np.linalg.solve(jac, rest[..., None])[..., 0]
    return uv


def _jets(patches, patch, uv):
    n = patches.degree
    net = patches.control_points[patch]
    du, dv = bernstein.partials_matrices(n)
    lower = bernstein.basis(n - 1, uv)
    yield np.einsum("nk,nkc->nc", bernstein.basis(n, uv), net)
    for matrix in (du, dv):
        yield np.einsum("nk,kl,nlc->nc", lower, matrix, net)


def hits(patches, texture: Any, count: int = 10_000) -> tuple[Any, np.ndarray, np.ndarray]:
    """Return interactions, the patches and their exact parameters."""
    bsdf = {"type": "diffuse", "reflectance": texture}
    scene = mi.load_dict({"type": "scene", "s": mb.shape(patches, bsdf=bsdf)})
    o, d = rays(patches, count)
    ray = mi.Ray3f(mi.Point3f(*o.T), mi.Vector3f(*d.T))
    si = scene.ray_intersect(ray)
    assert np.array(si.is_valid()).all()
    patch = np.array(si.prim_index).astype(int)
    uv = np.array(si.uv).T.astype(np.float64)
    return si, patch, exact_parameters(patches, patch, uv, o, d)


def field_of(degree: int, seed: int = 1, components: int = 1, rational: bool = False):
    rng = np.random.default_rng(seed)
    ordinates = rng.normal(size=(2, bernstein.size(degree), components))
    weights = None
    if rational:
        weights = rng.uniform(0.5, 2, ordinates.shape[:2])
        ordinates = ordinates * weights[..., None]
    return BezierField("f", ordinates, weights)


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize(
    "geometry, rational", [(2, False), (3, False), (3, True)], ids=["2", "3", "rational"]
)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_values_at_ten_thousand_hits(geometry, rational, degree, offset):
    """To 1e-5 of the range of the exact field, also where a large constant is added to it."""
    patches = curved(geometry, rational)
    field = field_of(degree)
    field.ordinates += offset
    texture = mi.load_dict({"type": "bezierfield", "ordinates": field, "colormap": "none"})
    si, patch, uv = hits(patches, texture)
    expected = field.evaluate(patch, uv)[:, 0]
    low, high = field.range()
    tolerance = 1e-5 * (high - low)
    # what is handed out is float32, which has 24 bits of the value itself
    np.testing.assert_allclose(
        np.array(texture.value(si)[0]), expected, rtol=0, atol=tolerance
    )  # fmt: skip
    assert np.abs(np.array(texture.eval_1(si)) - expected).max() <= tolerance + 1e-7 * offset
    assert high - low > 0.4


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize("weighted", [False, True])
def test_values_without_float64(weighted, offset, monkeypatch):
    """The same tolerance, as values are counted from the middle of their range."""
    monkeypatch.setattr(float64_use, "_chosen", "never")
    patches = curved(3, True)
    field = field_of(3, rational=weighted)
    field.ordinates += offset * (1.0 if field.weights is None else field.weights[..., None])
    given = {"type": "bezierfield", "ordinates": field, "isolines": 7, "world_to_pixel": np.eye(4)}
    texture = mi.load_dict({**given, "minimum": offset - 2.0, "maximum": offset + 2.0})
    si, patch, uv = hits(patches, texture)
    expected = field.evaluate(patch, uv)[:, 0] - offset
    low, high = field.range()
    value = texture.value(si)[0]
    assert texture.offset == offset and type(value) is mi.Float
    assert np.abs(np.array(value) - expected).max() <= 1e-5 * (high - low)
    scaled = np.array(texture.scaled(value))
    assert np.abs(scaled - (expected + 2) / 4).max() <= 1e-5 * (high - low)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(texture.eval(si))
        texts = [h["ir"] for h in dr.kernel_history() if "ir" in h]
    assert texts
    assert not any(has_float64(x if isinstance(x, str) else x.read()) for x in texts)


@pytest.mark.parametrize("rational", [False, True])
def test_components_magnitude_and_quotients(rational):
    patches = curved(2)
    field = field_of(3, components=3, rational=rational)
    for component in (None, 0, "2", "y", "magnitude"):
        more = {} if component is None else {"component": component}
        given = {"type": "bezierfield", "ordinates": field, "colormap": "none", **more}
        texture = mi.load_dict(given)
        si, patch, uv = hits(patches, texture, 500)
        vector = field.evaluate(patch, uv)
        which = {"2": 2, "y": 1, 0: 0}.get(component)
        expected = np.linalg.norm(vector, axis=1) if which is None else vector[:, which]
        np.testing.assert_allclose(np.array(texture.eval_1(si)), expected, atol=2e-5)
        # the partials, by the difference to a hit beside
        value, fu, fv = (np.array(x) for x in texture.value(si))
        h = 1e-6
        for d, found in (([h, 0], fu), ([0, h], fv)):
            beside = field.evaluate(patch, np.array(si.uv).T + d)
            f = np.linalg.norm(beside, axis=1) if which is None else beside[:, which]
            np.testing.assert_allclose((f - value) / h, found, atol=1e-3)


@pytest.mark.parametrize("levels", [0, 12])
@pytest.mark.parametrize("colormap", ["viridis", "gray", "coolwarm_r"])
def test_colours_are_those_of_the_exact_values(colormap, levels):
    patches, field = curved(3), field_of(2)
    given = {"type": "bezierfield", "ordinates": field, "colormap": colormap, "levels": levels}
    texture = mi.load_dict(given)
    low, high = texture.limits
    assert (low, high) == field.range()
    si, patch, uv = hits(patches, texture)
    s = (field.evaluate(patch, uv)[:, 0] - low) / (high - low)
    got = np.array(texture.eval_3(si)).T
    np.testing.assert_allclose(np.array(texture.eval(si)).T, got, atol=1e-7)
    if levels:
        expected = linear_rgb(banded(colormap, levels))[np.minimum((s * levels).astype(int), 11)]
        sure = np.abs(s * levels - np.round(s * levels)) > 1e-4
        np.testing.assert_allclose(got[sure], expected[sure], atol=1e-6)
        return
    table = color_table(colormap)
    srgb = np.stack([np.interp(s * 255, np.arange(256), table[:, c]) for c in range(3)], axis=1)
    # 1e-5 of the range, times the slope of a map, at most 5 or so, and of sRGB, at most 2.3
    np.testing.assert_allclose(got, linear_rgb(srgb), atol=1e-4)


def test_values_beyond_the_limits_have_the_last_colours():
    patches, field = curved(2), field_of(1)
    given = {"type": "bezierfield", "ordinates": field, "minimum": -0.1, "maximum": 0.1}
    texture = mi.load_dict(given)
    si, patch, uv = hits(patches, texture, 2000)
    value = field.evaluate(patch, uv)[:, 0]
    got = np.array(texture.eval_3(si)).T
    ends = linear_rgb(color_table("viridis")[[0, -1]])
    for chosen, end in ((value < -0.1, ends[0]), (value > 0.1, ends[1])):
        assert chosen.any()
        np.testing.assert_allclose(got[chosen], np.tile(end, (chosen.sum(), 1)), atol=1e-6)


def test_tables_are_those_of_matplotlib():
    matplotlib = pytest.importorskip("matplotlib")
    for name in ("viridis", "plasma", "inferno", "magma", "cividis", "coolwarm", "gray", "turbo_r"):
        own = np.asarray(matplotlib.colormaps[name](np.linspace(0, 1, 256)))[:, :3]
        np.testing.assert_allclose(color_table(name), own, atol=0.5 / 255)


# ---------------------------------------------------------------- lines


def line_texture(field: BezierField, **more: Any) -> Any:
    given = {"type": "bezierfield", "ordinates": field, "world_to_pixel": PIXELS, **more}
    return mi.load_dict(given)


@pytest.mark.parametrize("geometry, rational", [(1, False), (3, False), (3, True)])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_isolines_are_where_they_are_and_as_wide(geometry, rational, degree):
    """The middle of a line is within half a pixel of the isoline; its width is that in pixels."""
    patches, field = curved(geometry, rational), field_of(degree, 5)
    low, high = field.range()
    texture = line_texture(field, isolines=8, isoline_width=3.0, isoline_color="1 0 0")
    si, patch, uv = hits(patches, texture, 20_000)
    rgb = np.array(texture.eval_3(si)).T
    on = (rgb == [1, 0, 0]).all(axis=1)
    assert 0.02 < on.mean() < 0.6
    # distance to the nearest isoline in pixels: step to it along the gradient, in float64
    step = (high - low) / 8
    value = field.evaluate(patch, uv)[:, 0]
    level = low + step * np.round((value - low) / step).clip(1, 7)
    place = pixels(patches, patch, uv)
    on_curve = uv.copy()
    for _ in range(20):
        f, gradient, jac = at(patches, field, patch, on_curve)
        across = np.linalg.solve(np.swapaxes(jac, 1, 2), gradient[..., None])[..., 0]
        move = across * ((level - f) / np.maximum((across**2).sum(axis=1), 1e-30))[:, None]
        on_curve = on_curve + np.linalg.solve(jac, move[..., None])[..., 0]
    f, _gradient, _jac = at(patches, field, patch, on_curve)
    inside = (on_curve.min(axis=1) > 0) & (on_curve.sum(axis=1) < 1) & (np.abs(f - level) < 1e-9)
    off = np.linalg.norm(pixels(patches, patch, on_curve) - place, axis=1)
    sure = inside & (off < 4)
    assert sure.sum() > 500
    # half a pixel off: lines bend, and the step is by the gradient at the hit
    assert (off[sure & on] < 1.5 + 0.5).all()
    assert (off[sure & ~on] > 1.5 - 0.5).all()
    assert np.mean((off[sure] < 1.5) == on[sure]) > 0.97


def at(patches, field, patch, uv):
    """Return values, their gradients by the parameters, and the Jacobian of pixels by them."""
    h = 1e-6
    f = field.evaluate(patch, uv)[:, 0]
    p = pixels(patches, patch, uv)
    gradient, columns = [], []
    for d in ([h, 0], [0, h]):
        gradient.append((field.evaluate(patch, uv + d)[:, 0] - f) / h)
        columns.append((pixels(patches, patch, uv + d) - p) / h)
    return f, np.stack(gradient, axis=1), np.stack(columns, axis=2)


def pixels(patches, patch, uv) -> np.ndarray:
    h = np.einsum("nk,nkc->nc", bernstein.basis(patches.degree, uv), patches.control_points[patch])
    image = h @ CAMERA.image_matrix.T
    return image[:, :2] / image[:, 2:]


def test_sides_of_elements():
    """The side that is a diagonal of a quadrilateral has no line."""
    patches, field = curved(1), field_of(1)
    edges = np.array([[1, 1, 0], [1, 1, 0]], dtype=np.float64)
    more = {"edge_width": 4.0, "edge_color": "1 0 0", "colormap": "gray"}
    for given in (edges, None):
        texture = line_texture(field, **more, **({} if given is None else {"edges": given}))
        si, patch, uv = hits(patches, texture)
        rgb = np.array(texture.eval_3(si)).T
        on = (rgb == [1, 0, 0]).all(axis=1)
        # the squares' sides and the diagonal, as seen
        world = patches_points(patches, patch, uv)
        ends = {0: ([0, 0], [0, 1]), 1: ([0, 0], [1, 0]), 2: ([1, 0], [0, 1])}
        turned = {0: ([1, 1], [1, 0]), 1: ([1, 1], [0, 1]), 2: ([1, 0], [0, 1])}
        off = np.full(len(on), np.inf)
        for k in range(2 if given is not None else 3):
            for own, table in ((0, ends), (1, turned)):
                a, b = (to_pixel([*p, 0]) for p in table[k])
                normal = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a)
                d = np.abs((to_pixel(world) - a) @ normal)
                off = np.where(patch == own, np.minimum(off, d), off)
        sure = np.abs(off - 2.0) > 0.05
        assert (on == (off < 2.0))[sure].all() and on.any()


def patches_points(patches, patch, uv):
    h = np.einsum("nk,nkc->nc", bernstein.basis(patches.degree, uv), patches.control_points[patch])
    return h[:, :3] / h[:, 3:]


def to_pixel(points) -> np.ndarray:
    h = np.concatenate([np.asarray(points, float), np.ones((*np.shape(points)[:-1], 1))], axis=-1)
    image = h @ CAMERA.image_matrix.T
    return image[..., :2] / image[..., 2:]


# ---------------------------------------------------------------- in scenes


@pytest.mark.parametrize(
    "variant",
    ["llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono_polarized", "llvm_ad_rgb_double"],
)
def test_every_variant_renders_it(variant):
    if variant not in mi.variants():
        pytest.skip(f"Mitsuba was built without {variant}")
    mi.set_variant(variant)
    try:
        field = BezierField("f", np.tile([[[0.0]], [[1.0]]], (1, 1, 1)))
        for bsdf in (
            {"type": "diffuse", "reflectance": {"type": "bezierfield", "ordinates": field,
                                                "minimum": 0.0, "maximum": 1.0}},
            {"type": "roughconductor", "alpha": {"type": "bezierfield", "colormap": "none",
                                                 "ordinates": field.elevate(1)}},
        ):  # fmt: skip
            scene = {"type": "scene", "s": mb.shape(curved(2), bsdf=bsdf), "eye": camera(24, 24)}
            scene["integrator"] = {"type": "path", "max_depth": 2}
            scene["light"] = {"type": "constant"}
            image = np.array(mi.render(mi.load_dict(scene), spp=4))
            assert np.isfinite(image).all() and image.max() > 0.05
    finally:
        mi.set_variant(VARIANT)


def test_from_a_file(tmp_path):
    """A file that holds both: the shape and its texture have the same patches."""
    patches = curved(2)
    corners = patches.control_points.reshape(-1, 4)
    path = tmp_path / "a.vtu"
    io.save(patches, path)
    text = path.read_bytes()
    assert b"<PointData>" in text
    io.save(patches, path, encoding="ascii")
    values = " ".join(map(repr, (corners[:, 0] + 2 * corners[:, 1]).tolist()))
    array = f'<DataArray type="Float64" Name="f" format="ascii">{values}</DataArray>'
    given = path.read_text().replace("<PointData>", f"<PointData>{array}")
    path.write_text(given)
    texture = {"type": "bezierfield", "filename": str(path), "field": "f", "colormap": "none"}
    shape = {"type": "beziertriangle", "filename": str(path)}
    shape["bsdf"] = {"type": "diffuse", "reflectance": texture}
    scene = mi.load_dict({"type": "scene", "s": shape})
    o, d = rays(patches, 300)
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(*o.T), mi.Vector3f(*d.T)))
    assert np.array(si.is_valid()).all()
    assert np.isfinite(np.array(mi.load_dict(texture).eval_1(si))).all()


FIELD = field_of(1)


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({}, "exactly one of the parameters"),
        ({"ordinates": np.ones((2, 4))}, r"ordinates: expected shape \(P, K, C\)"),
        (
            {"ordinates": FIELD, "colormap": "viridsi"},
            "expected .*viridis.*got 'viridsi'",
        ),
        ({"ordinates": FIELD, "component": 3}, "component: expected a number from 0 to 0"),
        ({"ordinates": FIELD, "minimum": 2.0, "maximum": 2.0}, "range: expected two numbers a,b"),
        ({"ordinates": FIELD, "minimum": 1e9}, "range: expected two numbers a,b with a < b"),
        ({"ordinates": FIELD, "isolines": 5}, "world_to_pixel: expected the map to pixels"),
        ({"ordinates": FIELD, "isolines": -1}, "isolines: expected an integer from 0"),
        ({"ordinates": FIELD, "world_to_pixel": "1 2"}, "world_to_pixel: expected sixteen"),
        ({"ordinates": FIELD, "edges": np.ones((3, 3))}, r"edges: expected shape \(2, 3\)"),
        ({"ordinates": FIELD, "color_map": "gray"}, "unknown parameter 'color_map'.*colormap"),
        ({"ordinates": np.full((2, 3), np.nan)}, "finite values on all 2 patches, got none on 2"),
        ({"filename": "no.vtu", "field": "f"}, "filename: expected a file that can be read"),
    ],
)
def test_bad_parameters(parameters, message):
    with pytest.raises((BezierError, RuntimeError), match=message):
        mi.load_dict({"type": "bezierfield", **parameters})
