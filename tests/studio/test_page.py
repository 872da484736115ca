"""The studio's page: pictures, files, and in headless Chromium."""

from __future__ import annotations

import shutil
import socket
import sys
import time

import mitsuba as mi
import numpy as np
import pytest

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import GeometryError, RuntimeSetupError
from mitsuba_bezier.geometry.camera import Camera, look_at
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.studio.page import Studio, camera_of, checked_port
from mitsuba_bezier.studio.picture import Painter
from mitsuba_bezier.studio.state import PRESETS, State


@pytest.fixture
def variant():
    before = mi.variant()
    mi.set_variant("llvm_ad_rgb")
    yield
    if before:
        mi.set_variant(before)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


CAMERA = Camera(look_at([2.0, -3.6, 2.0], [0, 0, 0.5], [0, 0, 1]), 45, "y", (128, 96))


def test_the_picture_shows_the_surface_and_follows_the_net(variant):
    state = State(PRESETS["rational quadratic"]())
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
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        with pytest.raises(GeometryError, match=f"an address that is free, got 127.0.0.1:{port}"):
            checked_port("127.0.0.1", port)
    assert checked_port("127.0.0.1", port) == port
    for bad in (0, 70000):
        with pytest.raises(GeometryError, match="1 to 65535"):
            checked_port("127.0.0.1", bad)


def test_without_viser_there_is_one_clear_error(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(RuntimeSetupError, match="mitsuba-bezier\\[studio\\]"):
        Studio(PRESETS["rational quadratic"](), "127.0.0.1", free_port(), tmp_path)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["no such file"], "FILE|NAME: expected a file, or one of rational quadratic"),
        (["cubic hill", "--folder", "no/such/folder"], "--folder: expected a folder"),
        (["cubic hill", "-m", "scalar_rgb"], "--mode: expected a variant with a JIT"),
    ],
)
def test_mistakes_take_one_line(words, says, capsys):
    assert main(["studio", *words]) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


def waited(condition, seconds: float = 60.0) -> bool:
    """Wait until something holds; machines may be busy."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.1)
    return False


@pytest.mark.browser
def test_in_a_browser(variant, tmp_path):
    pytest.importorskip("viser", reason="the studio needs the extra 'studio'")
    pytest.importorskip("matplotlib", reason="it saves figures")
    api = pytest.importorskip("playwright.sync_api", reason="it drives Chromium")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("no Chromium on the PATH")
    studio = Studio(PRESETS["rational quadratic"](), "127.0.0.1", free_port(), tmp_path)
    url = f"http://127.0.0.1:{studio.server.get_port()}"
    flags = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
    try:
        with api.sync_playwright() as play:
            browser = play.chromium.launch(executable_path=program, args=flags)
            page = browser.new_page(viewport={"width": 900, "height": 600})
            page.goto(url, timeout=60000)
            assert waited(lambda: any(key[-1] for key in studio._shown.values()))  # refined
            time.sleep(1)
            before = page.screenshot()
            # a drag: the picture changes where the net is, not in the corner
            with studio._lock:
                studio.drag(4, studio.state.places[4] + [0, 0, 0.6])
                studio._touch()
            version = studio.state.version
            assert waited(
                lambda: any(key[0] == version and key[-1] for key in studio._shown.values())
            )
            time.sleep(1)
            from io import BytesIO

            from PIL import Image

            pictures = [np.array(Image.open(BytesIO(x))) for x in (before, page.screenshot())]
            changed = (pictures[0] != pictures[1]).any(axis=2)
            assert changed[100:500, 150:580].sum() > 200 and not changed[-80:, 200:500].any()
            # the weight through zero, by the slider's box as a user types it
            box = page.locator("input.mantine-NumberInput-input").last
            for text in ("0.5", "0", "-0.5"):
                box.fill(text)
                box.press("Enter")
            row = studio.selected
            assert waited(lambda: abs(studio.state.net[row, 3] + 0.5) < 1e-9)
            # saved by the buttons
            for suffix in (".vtu", ".svg"):
                page.get_by_text(f"save {suffix}").click()
                path = tmp_path / f"studio{suffix}"
                assert waited(path.exists)
            import mitsuba_bezier as mb

            kept = mb.load(tmp_path / "studio.vtu")
            assert isinstance(kept, BezierTriangles)
            np.testing.assert_allclose(kept.control_points[0], studio.state.net, atol=1e-9)
            # a second tab sees the same; one that goes away in the middle of a drag breaks nothing
            second = browser.new_page()
            second.goto(url, timeout=60000)
            assert waited(lambda: len(studio._shown) == 2)
            second.close()
            with studio._lock:
                studio.drag(4, studio.state.places[4] - [0, 0, 0.3])
                studio._touch()
            version = studio.state.version
            assert waited(
                lambda: any(key[0] == version and key[-1] for key in studio._shown.values())
            )
            browser.close()
    finally:
        studio.stop()
    assert not studio._worker.is_alive()
