"""Drawings: where things are drawn, through infinity, and over a render."""

from __future__ import annotations

import sys

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need the extra 'figures'")

from mitsuba_bezier import figures
from mitsuba_bezier.errors import BezierError, GeometryError, RuntimeSetupError
from mitsuba_bezier.figures.sampling import Window, trace
from mitsuba_bezier.geometry import conics
from mitsuba_bezier.geometry.camera import Camera, look_at
from mitsuba_bezier.geometry.covers import sphere
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.projective import affine

CAMERA = Camera(look_at([2.1, -3.2, 1.4], [0.1, 0, 0.1], [0, 0, 1]), 40, film_size=(320, 240))
SPHERE = np.diag([1.0, 1, 1, -1])
WINDOW = Window(-2.0, 2.0, -1.5, 1.5)


def dark(drawing: figures.Drawing, width: int) -> np.ndarray:
    """Return how dark each pixel is, 0 to 1."""
    return 1 - drawing.pixels(width).astype(float).mean(axis=2) / 255


# ---------------------------------------------------------------- curves


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_polylines_are_as_close_as_asked(tolerance):
    for arc in conics.circle((0.1, 0.2), 1.2):
        for piece in trace(arc.control_points, WINDOW, tolerance):
            middle = (piece[1:] + piece[:-1]) / 2
            off = np.linalg.norm(middle - [0.1, 0.2], axis=1) - 1.2
            assert np.abs(off).max() <= tolerance
            assert np.abs(np.linalg.norm(piece - [0.1, 0.2], axis=1) - 1.2).max() < 1e-9


def test_curves_go_through_infinity():
    # both branches of x^2 - y^2 = 1 as closed set of arcs: no line across the gap
    pieces = []
    for arc in conics.conic_arcs(np.diag([1.0, -1, -1])):
        pieces += trace(arc.control_points, WINDOW, 1e-3)
    x = np.concatenate(pieces)
    # where it is cut at the window, on chords within 1e-3; the slope of the equation is 4 there
    assert np.abs(x[:, 0] ** 2 - x[:, 1] ** 2 - 1).max() < 5e-3
    for piece in pieces:
        middle = (piece[1:] + piece[:-1]) / 2
        assert np.abs(middle[:, 0] ** 2 - middle[:, 1] ** 2 - 1).max() < 1e-2
    # each branch reaches the window's upper and lower sides
    for side in (-1, 1):
        own = x[np.sign(x[:, 0]) == side]
        assert own[:, 1].max() > 1.5 and own[:, 1].min() < -1.5


def test_a_leg_to_a_control_vector_is_a_ray():
    pieces = trace(np.array([[0.5, 0, 1], [0, 1.0, 0]]), WINDOW, 1e-3)
    assert len(pieces) == 1
    np.testing.assert_allclose(pieces[0][:, 0], 0.5, atol=1e-12)
    assert pieces[0][:, 1].min() == 0 and pieces[0][:, 1].max() > 1.5
    # the line of a rail ends in its vanishing point, exactly
    d = figures.space(CAMERA)
    rail = np.array([-0.5, 1.0, -0.3, 0])
    d.segment([0, 0, -0.5], rail)
    end = d.axes.lines[-1].get_xydata()[-1]
    np.testing.assert_allclose(end, affine(CAMERA.vanishing_point(rail[:3])), atol=1e-6)


def test_what_is_behind_the_eye_is_not_drawn():
    d = figures.space(CAMERA)
    d.segment([0, 0, 0], [4.2, -6.4, 2.7])  # through the eye and on
    d.segment([4, -6.4, 2.8], [5, -9, 3])
    drawn = [line.get_xydata() for line in d.axes.lines]
    assert len(drawn) <= 1
    for x in drawn:
        assert np.isfinite(x).all()


def test_points_are_where_the_camera_sees_them():
    d = figures.space(CAMERA)
    x = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    np.testing.assert_allclose(d.place(x), CAMERA.pixels(x), atol=1e-9)
    d.point(x[0])
    np.testing.assert_allclose(d.axes.lines[-1].get_xydata()[0], CAMERA.pixels(x[0]))


# ---------------------------------------------------------------- over a render


def coverage(rows: np.ndarray, steps: int = 32) -> np.ndarray:
    """Return for each row of pixels where along it rays begin and cease to hit the unit sphere.

    By the quadratic equation of rays through the pixels' middle line, bisected: nothing of the
    conic that is drawn.
    """
    eye = affine(CAMERA.center)

    def hit(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        d = CAMERA.direction(np.stack([x, y], axis=-1))
        b, a = d @ eye, np.sum(d * d, axis=-1)
        return b * b - a * (eye @ eye - 1) > 0

    out = []
    for y in rows + 0.5:
        x = np.arange(0, 320, 0.25)
        inside = np.flatnonzero(hit(x, np.full_like(x, y)))
        ends = []
        for a, b in ((x[inside[0]] - 0.25, x[inside[0]]), (x[inside[-1]] + 0.25, x[inside[-1]])):
            for _ in range(steps):
                m = (a + b) / 2
                a, b = (a, m) if hit(np.array([m]), np.array([y]))[0] else (m, b)
            ends.append(b)
        out.append(ends)
    return np.array(out)


def test_an_overlay_lies_on_the_edges_of_the_render():
    """Within 0.1 px: the middle of the drawn line against the edge that rays find."""
    d = figures.overlay(np.full((240, 320, 3), 255, np.uint8), CAMERA, "print")
    d.quadric_outline(SPHERE, linewidth=1.0)
    ink = dark(d, 1280)  # four pixels of the drawing to one of the render
    rows = np.arange(80, 160, 8)  # where the outline is steep
    for y, (left, right) in zip(rows, coverage(rows)):
        band = ink[4 * y + 1 : 4 * y + 3].mean(axis=0)
        x = (np.arange(1280) + 0.5) / 4
        for edge in (left, right):
            near = np.abs(x - edge) < 3
            middle = (x * band)[near].sum() / band[near].sum()
            # the line is 1 point wide, 2.2 px of the drawing; its mean is found to 0.01 px
            assert abs(middle - edge) < 0.1, (y, middle, edge)


def test_an_overlay_shows_the_render_pixel_for_pixel():
    picture = np.zeros((240, 320, 3), np.uint8)
    picture[100:140, 60:200] = (200, 40, 90)
    d = figures.overlay(picture, CAMERA)
    np.testing.assert_array_equal(d.pixels(320), picture)
    half = figures.overlay(picture, CAMERA, fade=0.5).pixels(320)
    assert half[0, 0, 0] in (127, 128)
    linear = figures.overlay(np.full((240, 320, 3), 0.2140411), CAMERA).pixels(320)
    assert np.isin(linear, (127, 128)).all()  # 0.2140411 is 0.5 by sRGB's curve


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_an_overlay_reads_files(suffix, tmp_path):
    picture = np.zeros((240, 320, 3), np.uint8)
    picture[100:140, 60:200] = (188, 99, 255)
    path = tmp_path / f"render{suffix}"
    if suffix == ".png":
        from PIL import Image

        Image.fromarray(picture).save(path)
    else:
        import OpenEXR

        x = picture / 255.0
        linear = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": linear.astype(np.float32)}).write(str(path))
    np.testing.assert_array_equal(figures.overlay(path, CAMERA).pixels(320), picture)
    path.write_bytes(b"no picture")
    with pytest.raises(GeometryError, match="render: expected a picture"):
        figures.overlay(path, CAMERA)


def test_hidden_parts_of_curves_on_a_sphere_are_dashed():
    d = figures.space(CAMERA)
    d.boundary(sphere()[0], on=SPHERE)
    eye = affine(CAMERA.center)
    d.boundary(sphere(), on=SPHERE)
    styles = {line.get_linestyle() for line in d.axes.lines}
    assert len(styles) == 2  # full and dashed
    assert np.linalg.norm(eye) > 1


# ---------------------------------------------------------------- files and styles


def test_print_is_black_and_grey():
    d = figures.plane((-1, 5), (-1, 3), "print")
    curve = BezierCurve.from_points([[0, 0], [1, 2], [3, 2], [4, 0]], [1, 2, 1, 1])
    d.farin(curve, 0.4)
    d.de_casteljau(curve, 0.4)
    d.curve(curve, "second")
    a = d.pixels(400).astype(int)
    assert np.ptp(a, axis=2).max() == 0
    assert (a < 60).any()


@pytest.mark.parametrize("suffix", figures.SUFFIXES)
def test_files(suffix, tmp_path):
    d = figures.plane((-1, 5), (-1, 3))
    d.curve(BezierCurve.from_points([[0, 0], [1, 2], [3, 2], [4, 0]]))
    d.point([1, 1], "$b_{21}^2$")
    path = tmp_path / "new" / f"figure{suffix}"
    d.save(path, 400)
    data = path.read_bytes()
    begins = {".svg": b"<?xml", ".pdf": b"%PDF", ".png": b"\x89PNG", ".webp": b"RIFF"}
    assert data.startswith(begins.get(suffix, b"\xff\xd8"))
    if suffix in (".svg", ".png"):  # no time in it: the same bytes again
        assert d.encoded(suffix, 400) == data
    if suffix == ".png":
        assert d.pixels(400).shape[1] == 400


CURVE = BezierCurve.from_points([[0, 0], [1, 2], [3, 2]])
PLANE = figures.plane((0, 1), (0, 1))
SPACE = figures.space(CAMERA)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: figures.plane((1, 0), (0, 1)), "x: expected a range"),
        (lambda: figures.plane((0, 1), 3), "y: expected a range"),
        (lambda: figures.plane((0, 1), (0, 1), "colour"), "style: expected one of screen, print"),
        (lambda: figures.space("camera"), "a Camera"),
        (lambda: PLANE.curve(CURVE, "thick"), "role: expected one of"),
        (lambda: PLANE.curve([1, 2]), "a curve of dimension 2"),
        (lambda: SPACE.curve(CURVE), "a curve of dimension 3"),
        (lambda: PLANE.point([1, 2, 3, 4]), "2 coordinates a point, or 3"),
        (lambda: PLANE.label([1, 2, 0], "x"), "a place in the drawing"),
        (lambda: SPACE.line([1, 2, 3]), "b: expected a second point"),
        (lambda: SPACE.line([1, 2, 3], [1, 2, 3]), "two different points"),
        (lambda: PLANE.eye(), "one of space"),
        (lambda: PLANE.conic(np.diag([1.0, -1, 0])), "two lines"),
        (lambda: PLANE.cross_ratio([[0, 0], [1, 0]]), "four points"),
        (lambda: PLANE.encoded(".tiff"), "a suffix .svg"),
        (lambda: PLANE.encoded(".png", 3), "16 to 32768 pixels"),
        (lambda: figures.overlay(np.zeros((10, 10, 3)), CAMERA), "320 x 240 pixels"),
        (lambda: figures.overlay(np.zeros((240, 320)), CAMERA, fade=2), "from 0 to 1"),
        (lambda: figures.overlay(np.zeros(5), CAMERA), "an array (h, w, 3)"),
        (lambda: figures.overlay("no such picture.png", CAMERA), "render: expected a picture"),
        (lambda: figures.draw("nothing"), "name: expected one of vanishing_point"),
        (lambda: figures.draw("decasteljau", s=1), "argument of decasteljau: expected one of t"),
    ],
)
def test_bad_drawings(call, says):
    with pytest.raises(BezierError) as caught:
        call()
    assert says in str(caught.value)


def test_without_matplotlib_there_is_one_clear_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(RuntimeSetupError) as caught:
        figures.plane((0, 1), (0, 1))
    assert "pip install 'mitsuba-bezier[figures]'" in str(caught.value)


def test_the_outline_needs_an_eye_outside():
    inside = Camera(look_at([0.1, 0, 0], [1, 0, 0], [0, 0, 1]), 40)
    with pytest.raises(GeometryError):
        figures.space(inside).quadric_outline(SPHERE)
