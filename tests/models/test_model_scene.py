"""The scene around a model: camera, ground, materials, and what is told of wrong options."""

from __future__ import annotations

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.io.parts import Part
from mitsuba_bezier.models import bounds
from mitsuba_bezier.models.camera import UPS, VIEWS, fitted, read_up, read_view, view_frame
from mitsuba_bezier.models.materials import MATERIALS, linear, material
from mitsuba_bezier.models.scene import Look, describe, models_of


def part(net: mb.BezierTriangles, matrix: np.ndarray | None = None) -> Part:
    places = np.eye(4)[None] if matrix is None else matrix[None]
    return Part("part", [net], [np.arange(len(net))], [None], places)


def seen(points: np.ndarray, view, aspect: float) -> np.ndarray:
    """Return places in the picture, -1 to 1 in both directions, as a camera has them."""
    back = view.origin - view.target
    back = back / np.linalg.norm(back)
    rows = np.stack([np.cross(view.up, back), view.up, back])
    local = (points - view.origin) @ rows.T
    if view.fov is None:
        return local[:, :2] / view.scale * [1.0, aspect]
    smaller = np.tan(np.radians(view.fov) / 2)
    return local[:, :2] / -local[:, 2:] / smaller * [min(1 / aspect, 1.0), min(aspect, 1.0)]


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.6])
@pytest.mark.parametrize("fov", [5.0, 24.0, 90.0, None])
@pytest.mark.parametrize("view", [*VIEWS, (-130, 20), (30.5, -45)])
def test_all_points_are_seen_and_the_picture_is_full(view, fov, aspect):
    rng = np.random.default_rng(5)
    points = rng.normal(size=(400, 3)) * [3, 1, 0.2] + [1e3, -40, 7]
    frame = view_frame(*read_view(view), read_up("z"))
    camera = fitted(points, frame, fov, aspect, margin=0.06)
    places = seen(points, camera, aspect)
    # the nearest place: the outermost points of one direction lie on the margin on both sides
    low, high = places.min(axis=0), places.max(axis=0)
    assert max(-low.min(), high.max()) <= 0.94 + 1e-9
    full = np.isclose(-low, 0.94, atol=1e-9) & np.isclose(high, 0.94, atol=1e-9)
    distance = (camera.origin - points) @ frame.back
    near = 0.2 * np.linalg.norm(np.ptp(points @ frame.rows.T, axis=0))
    assert full.any() or distance.min() == pytest.approx(near)
    assert camera.near < distance.min() and camera.far > distance.max()


@pytest.mark.parametrize("up", UPS)
def test_what_is_up_stays_up(up):
    rows = read_up(up)
    assert np.allclose(rows @ rows.T, np.eye(3)) and np.linalg.det(rows) == pytest.approx(1)
    assert rows[2] @ np.eye(3)["xyz".index(up[-1])] == (-1 if up[0] == "-" else 1)
    front = view_frame(0, 0, rows)
    assert np.allclose(front.up, rows[2]) and np.allclose(front.back, -rows[1])
    # from above, what lies behind is up in the picture
    assert np.allclose(view_frame(0, 90, rows).up, rows[1])


def test_bounds_are_those_of_what_trims_leave():
    square = mb.tensor_to_triangles(
        np.array([[[0, 0, 0, 1.0], [0, 1, 0, 1]], [[1, 0, 0, 1], [1, 1, 0, 1]]])
    )
    from mitsuba_bezier.geometry.trims import Trims, square_map

    corners = [(0, 0), (0.5, 0), (0.5, 1), (0, 1)]  # the left half
    loop = [np.array([[*a, 1.0], [*b, 1.0]]) for a, b in zip(corners, corners[1:] + corners[:1])]
    maps = np.stack([square_map(), square_map(second=True)])
    place = np.tile([[0.0, 0.0], [1.0, 1.0]], (2, 1, 1))
    trims = Trims([loop], [0, 0], maps, place)
    whole = Part("whole", [square], [np.zeros(2, int)], [None])
    left = Part("left", [square], [np.zeros(2, int)], [trims])
    points = bounds.surface_points([whole])
    assert np.allclose([points.min(axis=0), points.max(axis=0)], [[0, 0, 0], [1, 1, 0]])
    points = bounds.surface_points([left])
    axis = int(np.argmin(points.max(axis=0)[:2]))
    assert 0.45 <= points.max(axis=0)[axis] <= 0.5 + 1e-9
    # the lowest point is found to the step, 2^-12 of a patch's side over its divisions
    up = -np.eye(3)[axis]
    assert bounds.lowest([left], up) == pytest.approx(-0.5, abs=1e-4)


def test_the_ground_touches_a_ball_that_was_moved():
    move = np.eye(4)
    move[:3, 3] = 10, -20, 5
    up = np.array([0.3, 0.4, np.sqrt(0.75)])
    found = bounds.lowest([part(mb.sphere(), move)], up)
    # steps halve twelve times: 1/6 * 2^-12 of the angle, squared
    assert found == pytest.approx(up @ move[:3, 3] - 1, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"view": "isso"}, "did you mean 'iso'"),
        ({"view": "10,200"}, "elevation from -90 to 90"),
        ({"view": "nan,0"}, "azimuth"),
        ({"up": "w"}, "one of z, -z"),
        ({"fov": 0}, "fov"),
        ({"fov": float("nan")}, "fov"),
        ({"size": (0, 5)}, "pixels"),
        ({"background": "blue"}, "#rrggbb"),
        ({"light": "no-such.exr"}, "studio, sky, lamp"),
        ({"materials": {"*": "goold"}}, "did you mean 'gold'"),
        ({"materials": {"nothing": "gold"}}, "'nothing' (there are net)"),
        ({"materials": {"ne": "gold"}}, "did you mean 'net'?"),
        ({"materials": {"*": "<bsdf type='diffuse'>"}}, "XML of a <bsdf>"),
        ({"materials": {"*": "gold:#ffffff"}}, "'gold' without a colour"),
        ({"materials": {"*": "matte:#ggg"}}, "#rrggbb"),
    ],
)
def test_an_option_that_is_none_is_one_line(options, words):
    with pytest.raises(BezierError) as caught:
        describe(models_of(mb.sphere()), Look(**options))
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("net", "words"),
    [
        (mb.plane(), "reach infinity"),
        (mb.BezierTriangles([[[1, 2, 3, 1.0]] * 3]), "no area"),
        (mb.BezierTriangles([[[0, 0, 0, 1.0], [1, 0, 0, 1], [3, 0, 0, 1]]]), "no area"),
    ],
)
def test_a_model_of_no_finite_size_is_one_line(net, words):
    with pytest.raises(BezierError) as caught:
        describe(models_of(net), Look())
    assert words in str(caught.value)


def test_an_unknown_option_of_scene_names_those_that_are():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    with pytest.raises(BezierError, match="options view, up"):
        mb.scene(mb.sphere(), viwe="front")
    with pytest.raises(BezierError, match="BezierTriangles"):
        mb.scene(7)


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_loads(name):
    import mitsuba as mi

    from mitsuba_bezier.models.description import to_dictionary

    mi.set_variant("llvm_ad_rgb")
    assert mi.load_dict(to_dictionary(mi, material(name))) is not None


def test_a_snippet_of_xml_is_a_material():
    import mitsuba as mi

    from mitsuba_bezier.models.description import to_dictionary

    mi.set_variant("llvm_ad_rgb")
    text = '<bsdf type="diffuse"><rgb name="reflectance" value="0.1 0.2 0.3"/></bsdf>'
    out = to_dictionary(mi, {"type": "scene", "bsdf": material(text)})
    assert "0.1, 0.2, 0.3" in str(out["bsdf"])


def test_colours_are_linear():
    from mitsuba_bezier.io.parts import srgb

    assert linear("#ffffff") == (1, 1, 1) and linear("#000") == (0, 0, 0)
    assert linear("#808080")[0] == pytest.approx(0.2158605, abs=1e-6)  # IEC 61966-2-1
    for text in ("#123456", "#fedcba", "#0a0b0c"):
        assert srgb(linear(text)) == text


def test_an_appearance_replaces_what_a_part_looks_like():
    asked = []

    def appearance(part, group, rows):
        asked.append((part.name, group, rows.tolist()))
        return {"bsdf": {"type": "diffuse"}, "face_a": np.arange(8.0)}

    node = describe(models_of(mb.sphere()), Look(), appearance)["part-net"]
    assert asked == [("net", 0, list(range(8)))]
    assert node["bsdf"] == {"type": "diffuse"} and len(node["face_a"]) == 8


def test_exploded_parts_move_from_the_middle():
    from mitsuba_bezier.models.selection import exploded

    moves = np.stack([np.eye(4)] * 2)
    moves[:, 0, 3] = -3, 3
    pair = Part("pair", [mb.sphere()], [np.arange(8)], [None], moves)
    middle = part(mb.sphere())
    a, b = exploded([pair, middle], 0.5)
    assert np.allclose(a.placements[:, 0, 3], [-4.5, 4.5], atol=1e-2) and len(a.groups[0]) == 8
    assert np.allclose(b.placements[0], np.eye(4), atol=1e-2)
    with pytest.raises(BezierError, match="explode"):
        Look(explode=-1)
