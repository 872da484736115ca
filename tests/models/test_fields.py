"""Fields of models: colours with their bar, displaced surfaces, scenes in files, bad input."""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.fields import BezierField, products, warped
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.models.colorbar import beside, color_bar, tick_labels, tick_values
from mitsuba_bezier.models.fields import pixel_map


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant("llvm_ad_rgb")


def net(degree: int = 2, rational: bool = False) -> BezierTriangles:
    """Return two patches over the square."""
    rng = np.random.default_rng(degree)
    index = bernstein.multi_indices(degree) / degree
    corners = np.array([[[1, 0, 0], [0, 1, 0], [0, 0, 0]], [[0, 1, 0], [1, 0, 0], [1, 1, 0]]])
    points = np.einsum("kc,pcd->pkd", index, corners.astype(float))
    points[..., 2] += 0.1 * rng.random(points.shape[:2])
    w = rng.uniform(0.6, 1.6, points.shape[:2]) if rational else np.ones(points.shape[:2])
    return BezierTriangles(np.concatenate([points * w[..., None], w[..., None]], axis=2))


def field(name: str, degree: int, components: int = 1, rational: bool = False, unit: str = ""):
    rng = np.random.default_rng(degree + components)
    values = rng.normal(size=(2, bernstein.size(degree), components))
    weights = rng.uniform(0.5, 2, values.shape[:2]) if rational else None
    return BezierField(name, values, weights, unit)


FIELDS = [field("T", 3, unit="K"), field("u", 2, 3), field("zone", 0), field("q", 1, 2, True)]


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.vtu"
    edges = np.array([[True, True, False]] * 2)
    io.save(net(), path, fields=FIELDS, edges=edges)
    return path


# ---------------------------------------------------------------- geometry


def some(count: int = 40):
    rng = np.random.default_rng(7)
    return rng.integers(0, 2, count), rng.dirichlet([1, 1, 1], count)[:, :2]


@pytest.mark.parametrize("m, n", [(0, 2), (1, 1), (2, 3), (4, 1)])
def test_products(m, n):
    a, b = field("a", m, 3), field("b", n, 1)
    both = BezierField("ab", products(a.ordinates, b.ordinates))
    patch, uv = some()
    expected = a.evaluate(patch, uv) * b.evaluate(patch, uv)
    np.testing.assert_allclose(both.evaluate(patch, uv), expected, atol=1e-13)


@pytest.mark.parametrize("rational_net", [False, True])
@pytest.mark.parametrize("rational_field", [False, True])
@pytest.mark.parametrize("degrees", [(2, 1), (2, 2), (2, 3), (1, 0)])
def test_warped_points_are_the_sum(degrees, rational_net, rational_field):
    patches = net(degrees[0], rational_net)
    own = field("u", degrees[1], 3, rational_field)
    moved = warped(patches, own, 0.7)
    patch, uv = some()
    h, k = patches.evaluate(patch, uv), moved.evaluate(patch, uv)
    expected = h[:, :3] / h[:, 3:] + 0.7 * own.evaluate(patch, uv)
    np.testing.assert_allclose(k[:, :3] / k[:, 3:], expected, atol=1e-13)
    if not (rational_net or rational_field):
        assert moved.degree == max(degrees)
        assert (moved.control_points[..., 3] == 1).all()


def test_warp_keeps_the_degree_where_weights_are_those_of_the_points():
    patches = net(2, rational=True)
    w = patches.control_points[..., 3]
    vectors = np.random.default_rng(0).normal(size=(*w.shape, 3))
    moved = warped(patches, BezierField("u", vectors * w[..., None], w), 2.0)
    assert moved.degree == 2
    points = patches.control_points[..., :3] / w[..., None] + 2 * vectors
    np.testing.assert_allclose(moved.control_points[..., :3] / w[..., None], points, atol=1e-14)


@pytest.mark.parametrize("components, rational", [(1, False), (1, True), (3, False), (3, True)])
@pytest.mark.parametrize("degree", [0, 1, 2, 5])
def test_range_is_that_of_many_samples(degree, components, rational):
    own = field("f", degree, components, rational)
    low, high = own.range()
    n = 60
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    uv = np.stack([i, j], axis=-1)[i + j <= n] / n
    values = np.concatenate([own.evaluate([k] * len(uv), uv) for k in (0, 1)])
    values = np.linalg.norm(values, axis=1) if components > 1 else values[:, 0]
    size = max(high - low, 1e-6)
    assert low <= values.min() + 1e-6 * size and high >= values.max() - 1e-6 * size
    # samples are a 60th apart, so an extremum is missed by a curvature's 60th squared
    assert values.min() - low < 2e-2 * size and high - values.max() < 2e-2 * size


# ---------------------------------------------------------------- files


def test_fields_survive_a_file(model):
    read = io.read(model)
    assert list(read.fields) == ["u", "T", "zone", "q"] or set(read.fields) == {
        "T",
        "u",
        "zone",
        "q",
    }
    patch, uv = some()
    for own in FIELDS:
        got = read.fields[own.name]
        expected = own.evaluate(patch, uv)
        np.testing.assert_allclose(got.evaluate(patch, uv), expected, atol=1e-13)
    assert read.fields["T"].unit == "K"
    assert read.edges.tolist() == [[True, True, False]] * 2
    assert read.groups[0] == net()


def test_vtk_sees_what_it_can(model):
    """A field of the degree of the patches is point data, as VTK interpolates them."""
    vtk = pytest.importorskip("vtk")
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(model))
    reader.Update()
    grid = reader.GetOutput()
    data = grid.GetPointData().GetArray("u")
    assert grid.GetCellData().GetArray("zone") is not None
    cell = vtk.vtkGenericCell()
    for k in (0, 1):
        grid.GetCell(k, cell)
        for u, v in some(5)[1]:
            w = [0.0] * cell.GetNumberOfPoints()
            cell.EvaluateLocation(vtk.reference(0), (v, 1 - u - v, 0), [0.0] * 3, w)
            ids = [cell.GetPointId(i) for i in range(len(w))]
            value = sum(a * np.array(data.GetTuple(i)) for a, i in zip(w, ids))
            np.testing.assert_allclose(FIELDS[1].evaluate([k], [[u, v]])[0], value, atol=1e-12)


def test_convert_keeps_fields(model, tmp_path, capsys):
    out = tmp_path / "out.vtu"
    assert main(["convert", str(model), str(out)]) == 0
    assert set(io.read(out).fields) == {"T", "u", "zone", "q"}
    assert main(["convert", str(model), str(tmp_path / "out.bv")]) == 0
    assert "fields are not written, which only .vtu can hold: " in capsys.readouterr().err


def test_info_lists_fields(model, capsys):
    assert main(["info", str(model), "--json"]) == 0
    found = {f["name"]: f for f in json.loads(capsys.readouterr().out)["fields"]}
    assert (found["T"]["degree"], found["T"]["unit"], found["u"]["components"]) == (3, "K", 3)
    assert found["T"]["range"] == pytest.approx(FIELDS[0].range())
    assert main(["info", str(model)]) == 0
    assert "field       T: 1 component of degree 3, " in capsys.readouterr().out


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize("more", [{}, {"ortho": True}, {"view": "20,70", "up": "y"}])
def test_pixels_of_both_cameras(more):
    """A point that a camera sees in a pixel is mapped there."""
    from mitsuba_bezier.models.scene import Look, describe, models_of

    node = describe(models_of(net()), Look(size=(64, 40), **more))
    matrix = pixel_map(node["camera"])
    camera = {
        **node["camera"],
        "to_world": mi.ScalarTransform4f(node["camera"]["to_world"].tolist()),
    }
    sensor = mi.load_dict(camera)
    at = np.random.default_rng(0).random((50, 2))
    ray, _w = sensor.sample_ray(0.0, 0.5, mi.Point2f(*at.T), mi.Point2f(0.5))
    point = np.array(ray(3.0)).T
    image = np.concatenate([point, np.ones((50, 1))], axis=1) @ matrix.T
    np.testing.assert_allclose(image[:, :2] / image[:, 3:], at * [64, 40], atol=2e-3)


def pixels_of(path) -> np.ndarray:
    return np.array(mi.Bitmap(str(path)))


def test_render_with_a_bar(model, tmp_path, capsys):
    out = tmp_path / "a.exr"
    words = ["render", str(model), "--color-by", "T", "--range", "-1,2", "--levels", "6"]
    words += ["--isolines", "--edges", "--size", "96x64", "--spp", "4", "-o", str(out)]
    assert main(words) == 0
    assert "T [K]: -1 to 2" in capsys.readouterr().err
    picture = pixels_of(out.with_suffix(".png"))
    assert picture.shape[0] == 64 and picture.shape[1] > 110
    # the bar has the six colours
    from mitsuba_bezier.plugins.colormaps import banded

    bar = picture[:, 96:].reshape(-1, 3)
    for color in np.rint(255 * banded("viridis", 6)):
        assert (np.abs(bar - color).max(axis=1) <= 1).sum() > 5
    # without it, or without colours, the picture has its size
    assert main([*words, "--no-bar"]) == 0
    assert pixels_of(out.with_suffix(".png")).shape[1] == 96


def test_scene_file_is_the_same_picture(model, tmp_path):
    """What --scene writes renders as the model does: fields of any degree, lines, sides."""
    options = ["--color-by", "T", "--isolines", "--edges", "--size", "48x32", "--spp", "4"]
    one, two, scene = tmp_path / "one.exr", tmp_path / "two.exr", tmp_path / "s" / "scene.xml"
    scene.parent.mkdir()
    assert main(["render", str(model), *options, "-o", str(one)]) == 0
    assert main(["render", str(model), *options, "--scene", str(scene)]) == 0
    assert main(["render", str(scene), "-o", str(two)]) == 0
    a, b = (np.array(mi.Bitmap(str(p)))[..., :3] for p in (one, two))
    # equal seeds and scenes; numbers of XML are those of the dictionary
    np.testing.assert_allclose(a, b, atol=2e-3)


def test_warp_in_a_render_is_the_displaced_surface(model):
    scene = mi.load_dict(mb.scene(str(model), warp="u", factor=0.2, size=(16, 16), spp=1))
    moved = warped(net(), FIELDS[1], 0.2)
    patch, uv = some(200)
    h = moved.evaluate(patch, uv)
    points = h[:, :3] / h[:, 3:]
    o = points + np.array([0, 0, 5.0])
    ray = mi.Ray3f(mi.Point3f(*o.T), mi.Vector3f(0, 0, -1))
    si = scene.ray_intersect(ray)
    found = np.array(si.p)[2]
    assert (found >= points[:, 2] - 1e-5).all()  # or another patch is above
    assert (np.abs(found - points[:, 2]) < 1e-5).mean() > 0.3


@pytest.mark.parametrize(
    "options, message",
    [
        (["--color-by", "Temp"], "color-by: expected 'T'"),
        (["--color-by", "T", "--component", "4"], "component: expected a number from 0 to 0"),
        (["--color-by", "T", "--colormap", "virdis"], "colormap: expected viridis"),
        (["--color-by", "T", "--range", "2,1"], "--range: expected A,B with A < B"),
        (["--color-by", "T", "--range", "1,1"], "--range: expected A,B with A < B"),
        (["--color-by", "T", "--range", "1e9,"], "range: expected two numbers a,b with a < b"),
        (["--color-by", "T", "--range", "nan,1"], "--range: expected A,B"),
        (["--color-by", "T", "--levels", "0"], "--levels: expected a number from 1"),
        (["--range", "0,1"], "--range: expected with --color-by NAME, got without"),
        (["--factor", "2"], "--factor: expected with --warp NAME, got without"),
        (["--warp", "T"], "warp: expected a field of 2 or 3 components, got 'T' of 1"),
        (["--warp", "v"], "warp: expected 'u'"),
    ],
)
def test_bad_input_is_one_line(model, capsys, options, message):
    try:
        code = main(["render", str(model), *options])
    except SystemExit as end:
        code = end.code
    error = capsys.readouterr().err
    assert code == 2 and message in error and len(error.strip().splitlines()) == 1


def test_fields_that_are_not_finite(tmp_path, capsys):
    bad = field("T", 1)
    bad.ordinates[1, 2] = np.nan
    path = tmp_path / "a.vtu"
    io.save(net(), path, fields=[bad])
    assert main(["render", str(path), "--color-by", "T"]) == 2
    error = capsys.readouterr().err
    assert "field 'T': expected finite values on all 2 patches, got none on 1 of them" in error
    with pytest.raises(BezierError, match="finite values on all"):
        mb.scene(str(path), color_by="T")


def test_models_without_fields(tmp_path, capsys):
    path = tmp_path / "a.vtu"
    io.save(net(), path)
    assert main(["render", str(path), "--color-by", "T"]) == 2
    assert "has none, got 'T'" in capsys.readouterr().err


# ---------------------------------------------------------------- the bar


@pytest.mark.parametrize(
    "low, high, levels",
    [
        (0, 1, 0),
        (-3.7, 12.2, 0),
        (101325.0, 101326.0, 0),
        (1e-9, 3e-9, 0),
        (0, 1, 12),
        (-1e8, 2e7, 7),
    ],
)
def test_the_ends_of_the_bar_are_the_range(low, high, levels):
    values = tick_values(low, high, levels)
    assert values[0] == low and values[-1] == high
    assert values == sorted(set(values)) and 2 <= len(values) <= 9
    texts = [t.replace("\N{MINUS SIGN}", "-") for t in tick_labels(values)]
    assert len(set(texts)) == len(texts)
    for text, x in zip(texts, values):
        assert abs(float(text) - x) <= 2e-3 * (high - low)


@pytest.mark.parametrize("height", [24, 64, 300, 1200])
def test_the_bar_has_the_colours_from_end_to_end(height):
    pytest.importorskip("matplotlib")
    from mitsuba_bezier.plugins.colormaps import color_table

    bar = color_bar(height, (0, 1), "viridis", "a name", alpha=height == 300)
    assert bar.shape[0] == height and bar.shape[2] == (4 if height == 300 else 3)
    column = bar[:, np.argmax((np.ptp(bar[..., :3].astype(int), axis=2) > 40).sum(axis=0)), :3]
    table = color_table("viridis")
    # the first pixel's middle is half a pixel from the end, and one may be blended with the rim
    off = 1.5 / (0.84 * height)
    for end, inner in ((0, off), (1, 1 - off)):
        near = table[[round(255 * end), round(255 * inner)]] * 255
        low, high = near.min(axis=0) - 8, near.max(axis=0) + 8
        assert ((column >= low) & (column <= high)).all(axis=1).any()
    picture = np.zeros((height, 10, bar.shape[2]), np.uint8)
    assert beside(picture, bar).shape == (height, 10 + bar.shape[1], bar.shape[2])


def test_the_film_of_a_model_has_a_box_filter_for_the_denoiser(model):
    import argparse

    from mitsuba_bezier.cli import _model, render

    parser = argparse.ArgumentParser()
    render.add_parser(parser.add_subparsers(dest="command"))
    words = ["render", str(model), "--color-by", "T", "--denoise", "--size", "8x8", "--no-bar"]
    loaded = _model.load(parser.parse_args(words))
    film = loaded.scene.sensors()[0].film()
    assert film.rfilter().class_name().startswith("Box")
