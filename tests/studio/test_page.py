"""The studio's page: pictures, files, and in headless Chromium."""

from __future__ import annotations

import random
import socket
import sys
import time
from collections.abc import Iterator
from io import BytesIO

import mitsuba as mi
import numpy as np
import pytest
from browser import SECONDS

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import GeometryError, RuntimeSetupError
from mitsuba_bezier.geometry.camera import Camera, look_at
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.studio.page import Studio, checked_port
from mitsuba_bezier.studio.picture import Painter
from mitsuba_bezier.studio.presets import NETS, PRESETS, drawings
from mitsuba_bezier.studio.state import State
from mitsuba_bezier.studio.views import camera_of


@pytest.fixture
def variant():
    before = mi.variant()
    mi.set_variant("llvm_ad_rgb")
    yield
    if before:
        mi.set_variant(before)


def free_ports() -> Iterator[int]:
    """Give ports that are free; none of those that the system gives to who asks for any."""
    for port in random.sample(range(10_000, 32_000), 200):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        yield port


def free_port() -> int:
    return next(free_ports())


CAMERA = Camera(look_at([2.0, -3.6, 2.0], [0, 0, 0.5], [0, 0, 1]), 45, "y", (128, 96))


def test_the_picture_shows_the_surface_and_follows_the_net(variant):
    state = State(PRESETS["rational_triangle"]())
    painter = Painter(state.patches)
    before = painter.paint(CAMERA)
    assert before.shape == (96, 128, 3)
    shown = (before != before[0, 0]).any(axis=2)
    # where points of the surface are in the camera, and nowhere else
    uv = np.random.default_rng(1).dirichlet([1, 1, 1], 300)[:, :2]
    pixel = np.floor(CAMERA.pixels(state.patches.points(0, uv))).astype(int)
    # or in the pixel beside: a ray goes through the middle of each
    near = np.any([np.roll(shown, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    assert near[pixel[:, 1], pixel[:, 0]].all()
    assert 0.02 < shown.mean() < 0.6
    state.move(4, state.places[4] + [0, 0, 0.8])
    painter.show(state.patches)
    after = painter.paint(CAMERA)
    changed = (after != before).any(axis=2)
    assert changed.any() and not changed[:5].any()  # where the surface is
    fresh = Painter(state.patches).paint(CAMERA)
    assert (fresh == after).mean() > 0.999  # a replaced net is as one shown first
    assert len(np.unique(painter.paint(CAMERA, "depth")[..., 0])) > 20
    assert painter.paint(CAMERA, "light", 4).shape == (96, 128, 3)
    state.elevate()
    painter.show(state.patches)
    assert (painter.paint(CAMERA) == after).all(axis=2).mean() > 0.98
    with pytest.raises(GeometryError, match="mode"):
        painter.paint(CAMERA, "x-ray")


def test_a_browsers_camera_is_ours():
    class View:
        position = (2.0, -3.6, 2.0)
        fov = np.radians(45)
        aspect = 4 / 3

    # the quaternion of a rotation whose columns are right, down, forward
    m = CAMERA.to_world[:3, :3] * [-1.0, -1.0, 1.0]
    w = np.sqrt(max(1 + np.trace(m), 1e-12)) / 2
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    View.wxyz = (w, x / (4 * w), y / (4 * w), z / (4 * w))
    found = camera_of(View, 128)
    np.testing.assert_allclose(found.matrix[[0, 1, 3]], CAMERA.matrix[[0, 1, 3]], atol=1e-9)


def test_a_port_that_is_taken_is_one_clear_error():
    port = free_port()
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", port))
        holder.listen()
        with pytest.raises(GeometryError, match=f"an address that is free, got 127.0.0.1:{port}"):
            checked_port("127.0.0.1", port)
    assert checked_port("127.0.0.1", port) == port
    for bad in (0, 70000):
        with pytest.raises(GeometryError, match="1 to 65535"):
            checked_port("127.0.0.1", bad)


def test_without_viser_there_is_one_clear_error(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(RuntimeSetupError, match="mitsuba-bezier\\[studio\\]"):
        Studio(PRESETS["rational_triangle"](), "127.0.0.1", free_port(), tmp_path)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["no such file"], "FILE|NAME: expected a file, or one of rational_triangle"),
        (["triangle_net", "--folder", "no/such/folder"], "--folder: expected a folder"),
        (["triangle_net", "-m", "scalar_rgb"], "--mode: expected a variant with a JIT"),
    ],
)
def test_mistakes_take_one_line(words, says, capsys):
    assert main(["studio", *words]) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


def waited(condition, pause: float = 0.1) -> bool:
    """Wait until something holds; machines may be busy."""
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(pause)
    return False


def pictures(*shots: bytes) -> list[np.ndarray]:
    from PIL import Image

    return [np.array(Image.open(BytesIO(x)).convert("RGB")).astype(int) for x in shots]


@pytest.fixture
def browser():
    """Headless Chromium, with WebGL by its processor."""
    pytest.importorskip("viser", reason="the studio needs the extra 'studio'")
    pytest.importorskip("matplotlib", reason="it saves figures")
    api = pytest.importorskip("playwright.sync_api", reason="it drives Chromium")
    from browser import find

    program = find()
    if program is None:
        pytest.skip("no Chromium: set $CHROMIUM or install one")
    flags = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
    with api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, args=flags, timeout=1000 * SECONDS)
        yield chromium
        chromium.close()


def opened(browser, studio, width: int, height: int):
    """Return a page that shows a refined picture, without the note about WebGL."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(1000 * SECONDS)
    page.goto(f"http://127.0.0.1:{studio.server.get_port()}")
    # whenever it comes
    page.add_style_tag(content=".mantine-Notification-root { display: none !important }")
    # the view is set by the server, and told back by the browser
    assert waited(lambda: studio._views and studio.refined(1))
    # a screenshot takes a second of the processor that the page needs
    assert waited(lambda: shows(page, studio, width, height), 1.0)
    return page


def shows(page, studio, width: int, height: int) -> bool:
    """Return whether a page shows the net as it is now: its points, and the surface behind."""
    from mitsuba_bezier.studio.canvas import CHOSEN, POINT

    (shot,) = pictures(page.screenshot())
    near = np.mgrid[-3:4, -3:4].reshape(2, -1)
    for row, place in enumerate(studio.state.places):
        x, y = np.floor(seen_at(studio, place, width, height)).astype(int)[:, None] + near
        colour = np.array(CHOSEN if row == studio.selected else POINT)
        # of the ball, whose sides are lit; next to none of them is in reach of the controls
        hue = shot[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        hue = hue / np.maximum(hue.max(axis=1, keepdims=True), 1)
        if not (np.abs(hue - colour / colour.max()).max(axis=1) < 0.25).any():
            return False
    # 25 places of the surface are not of the ground's colour
    uv = 0.15 + 0.55 * np.random.default_rng(0).dirichlet([1, 1, 1], 25)[:, :2]
    places = [seen_at(studio, x, width, height) for x in studio.state.patches.points(0, uv)]
    x, y = np.clip(np.floor(places).astype(int).T, 0, [[width - 1], [height - 1]])
    return bool(np.median(np.abs(shot[y, x] - shot[5, 5]).max(axis=1)) > 20)


def seen_at(studio, place, width: int, height: int) -> np.ndarray:
    """Return the pixel of the window where a place is seen."""
    view = next(iter(studio._views.values())).camera
    own = camera_of(view, 1000)
    exact = Camera(own.to_world, float(np.degrees(view.fov)), "y", (width, height))
    return exact.pixels(np.asarray(place, dtype=np.float64))


def changed_within(before, after, points, free: int) -> tuple[int, int]:
    """Count pixels that have changed in the box around points, `free` pixels wider, and outside."""
    changed = np.abs(before - after).max(axis=2) > 12  # more than JPEG and noise do
    low, high = points.min(axis=0) - free, points.max(axis=0) + free
    y, x = np.mgrid[: changed.shape[0], : changed.shape[1]]
    box = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    return int((changed & box).sum()), int((changed & ~box).sum())


@pytest.mark.browser
@pytest.mark.parametrize("size", [(1280, 800), (420, 800)])
def test_a_point_is_dragged_with_the_mouse(variant, tmp_path, browser, size):
    studio = Studio("rational_triangle", "127.0.0.1", free_port(), tmp_path)
    try:
        page = opened(browser, studio, *size)
        row = 1  # none that is selected, with no other before it
        before = page.screenshot()
        places = studio.state.places.copy()
        start = seen_at(studio, places[row], *size)
        end = start + np.array([-60, -30])
        page.mouse.move(*start)
        page.mouse.down()
        page.mouse.move(*(start + np.array([-10, -5])))
        page.mouse.move(*end, steps=6)
        # a drag goes on: the picture follows before the button is let go
        assert waited(lambda: np.abs(studio.state.places[row] - places[row]).max() > 0.05)
        page.mouse.up()
        page.mouse.move(start[0], 20)
        # where the button was let go, by the ball's own size and the throttle of its last step
        assert waited(
            lambda: np.abs(seen_at(studio, studio.state.places[row], *size) - end).max() < 3
        )
        np.testing.assert_array_equal(np.delete(studio.state.places, row, 0),
                                      np.delete(places, row, 0))  # fmt: skip
        assert studio.selected == row
        assert waited(lambda: studio.refined(4))
        around = np.concatenate(
            [[seen_at(studio, x, *size) for x in p] for p in (places, studio.state.places)]
        )
        # the controls tell which point it is
        panel = page.get_by_text("figure", exact=True).bounding_box()

        def follows() -> bool:
            """Whether the picture has changed where the surface has, and nowhere else."""
            old, new = pictures(before, page.screenshot())
            if size[0] > 600:
                old, new = (x[:, : int(panel["x"]) - 20] for x in (old, new))
            else:
                old, new = (x[: int(panel["y"]) - 60] for x in (old, new))
            # balls and names reach 60 pixels beyond the points
            inside, outside = changed_within(old, new, around, 60)
            return inside > 1500 and outside == 0

        # what was sent is shown some time later
        assert waited(follows, 1.0)
        # one step back is the whole drag
        page.get_by_text("undo", exact=True).click()
        assert waited(lambda: np.array_equal(studio.state.places, places))
    finally:
        studio.stop()
    assert not studio._worker.is_alive()


@pytest.mark.browser
def test_weights_files_and_a_second_tab(variant, tmp_path, browser, monkeypatch):
    import mitsuba_bezier as mb

    monkeypatch.setattr("mitsuba_bezier.studio.page.SAVED", 320)  # of 1600, soon rendered
    studio = Studio("rational_triangle", "127.0.0.1", free_port(), tmp_path)
    try:
        page = opened(browser, studio, 800, 500)
        # the weight from 1 through zero to negative, by dragging the slider's thumb
        thumb = page.locator(".mantine-Slider-thumb").nth(1)
        row = studio.selected
        seen = [studio.state.net[row, 3]]
        box = thumb.bounding_box()
        at = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
        page.mouse.move(*at)
        page.mouse.down()
        for step in range(1, 7):
            page.mouse.move(at[0] - 6 * step, at[1])
            seen.append(float(studio.state.net[row, 3]))
        page.mouse.up()
        assert waited(lambda: studio.state.net[row, 3] < -0.3)
        assert (np.diff([*seen, studio.state.net[row, 3]]) <= 0).all() and min(seen) < 0 < max(seen)
        # to zero itself and to infinity by the box as a user types it
        box = page.locator("input.mantine-NumberInput-input").nth(1)
        for text, value in (("0", 0.0), ("4", 1e6), ("-0.5", -0.5)):
            box.fill(text)
            box.press("Enter")
            assert waited(lambda: abs(studio.state.net[row, 3] - value) < 1e-9)  # noqa: B023
        assert waited(lambda: studio.refined(1))
        # saved by the buttons
        for suffix in (".vtu", ".png", ".svg"):
            page.get_by_text(suffix, exact=True).click()
            assert waited((tmp_path / f"studio{suffix}").exists)
            assert waited(lambda: page.get_by_text(f"saved studio{suffix}").count())  # noqa: B023
        kept = mb.load(tmp_path / "studio.vtu")
        assert isinstance(kept, BezierTriangles)
        np.testing.assert_allclose(kept.control_points[0], studio.state.net, atol=1e-9)
        # a second tab sees the same
        second = browser.new_page(viewport={"width": 500, "height": 400})
        second.set_default_timeout(1000 * SECONDS)
        second.goto(f"http://127.0.0.1:{studio.server.get_port()}")
        assert waited(lambda: len(studio._views) == 2 and studio.refined(1))
        assert waited(lambda: second.get_by_text("b011: weight -0.5").count() == 1)
        page.get_by_text("raise", exact=True).click()
        assert waited(lambda: studio.state.degree == 3)
        assert waited(lambda: second.get_by_text("degree 3").count() == 1)
        # one that goes away in the middle of a drag breaks nothing
        place = studio.state.places[0].copy()
        at = seen_at(studio, place, 800, 500)
        page.bring_to_front()
        assert waited(lambda: shows(page, studio, 800, 500), 1.0)
        page.mouse.move(*at)
        page.mouse.down()
        page.mouse.move(*(at + np.array([20, 10])), steps=4)
        assert waited(lambda: np.abs(studio.state.places[0] - place).max() > 0.02)
        page.close()
        assert waited(lambda: len(studio._views) == 1)
        assert waited(lambda: studio.refined(1))  # the other sees where the drag was left
        second.get_by_text("undo", exact=True).click()
        assert waited(lambda: np.allclose(studio.state.places[0], place, atol=1e-12))
    finally:
        studio.stop()


@pytest.mark.browser
def test_what_is_asked_for_while_it_is_busy_is_done_in_order(variant, tmp_path, browser):
    studio = Studio("rational_triangle", "127.0.0.1", free_port(), tmp_path)
    try:
        page = opened(browser, studio, 800, 500)
        point, weight = (page.locator(".mantine-Slider-thumb").nth(k) for k in (0, 1))
        first, net = studio.selected, studio.state.net.copy()
        with studio._lock:  # as while a file is saved
            for thumb, key, handle, value in (
                (weight, "ArrowLeft", studio.weight, net[first, 3] - 0.01),
                (point, "ArrowRight", studio.point, first + 1),
                (weight, "ArrowLeft", studio.weight, net[first, 3] - 0.02),
            ):
                thumb.press(key)
                assert waited(lambda: abs(handle.value - value) < 1e-9)  # noqa: B023
        assert waited(lambda: studio.selected == first + 1)
        net[first, 3] -= 0.01
        net[first + 1, 3] = net[first, 3] - 0.01
        assert waited(lambda: np.allclose(studio.state.net[:, 3], net[:, 3], atol=1e-9))
    finally:
        studio.stop()


@pytest.mark.browser
def test_every_figure_can_be_picked(variant, tmp_path, browser):
    from mitsuba_bezier.figures.catalogue import CATALOGUE

    assert set(CATALOGUE) <= {*NETS, *drawings()}
    studio = Studio(PRESETS["triangle_net"](), "127.0.0.1", free_port(), tmp_path)
    try:
        page = opened(browser, studio, 800, 500)
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        for name in ("sphere_point", "farin", "desargues", "decasteljau"):
            page.locator("input[aria-haspopup='listbox']:visible").first.click()
            page.get_by_role("option", name=name, exact=True).click()
            assert waited(lambda: studio.figure == name and studio.refined(1))  # noqa: B023
            assert studio._message == "" and not errors
        page.get_by_text(".vtu", exact=True).click()
        assert waited(lambda: "a net of a surface" in studio._message)
    finally:
        studio.stop()
