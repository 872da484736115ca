"""The scenes of lenses are loaded, rendered small, and show what they are for."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.optics import Lens, Surface, first_order, load, spot, trace

SCENES = Path(__file__).parents[2] / "scenes/lenses"
FILES = sorted(SCENES.glob("*.xml"))


def script(name: str) -> ModuleType:
    """Return a script that makes a scene, as a module."""
    spec = importlib.util.spec_from_file_location(name, SCENES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def render(name: str, width: int, height: int, spp: int, **values: str) -> np.ndarray:
    """Return the picture of a scene."""
    mi.set_variant("llvm_ad_rgb")
    size = {"width": str(width), "height": str(height), "spp": str(spp)}
    scene = mi.load_file(str(SCENES / f"{name}.xml"), **size, **values)
    image = np.array(mi.render(scene, spp=spp))
    assert image.shape == (height, width, 3) and np.isfinite(image).all() and (image >= 0).all()
    return image.mean(axis=2)


@pytest.mark.parametrize("file", FILES, ids=[f.stem for f in FILES])
def test_all_that_a_scene_names_is_there(file):
    root = ElementTree.parse(file).getroot()
    names = [node.get("value") for node in root.iter("string") if node.get("name") == "filename"]
    for name in names:
        inside = (SCENES / name).resolve()
        assert inside.is_relative_to(SCENES.parent) and inside.is_file(), name
    # glass by n_d and V_d, which needs no catalogue
    for node in root.iter("string"):
        if node.get("name") in ("material", "exterior") and "dispersive" in file.read_text("utf-8"):
            assert re.fullmatch(r"[\d.:]+|air|none", node.get("value")), node.get("value")
    assert {"width", "height", "spp"} <= {node.get("name") for node in root.iter("default")}


def test_scripts_make_what_is_there():
    for name in ("table", "street"):
        assert script(f"make_{name}").scene() == (SCENES / f"{name}.xml").read_text("utf-8")
    telescope = script("make_telescope")
    assert telescope.scene() == (SCENES / "startest.xml").read_text("utf-8")
    magnifier, eye = script("make_magnifier"), script("make_eye")
    made = dict(telescope.mirrors())
    made |= {"magnifier_glass": magnifier.glass(), "magnifier_ring": magnifier.ring()}
    made |= {f"eye_{name}": net for name, net in {**eye.bodies(), "cap": eye.cut()}.items()}
    assert {f"{name}.vtu" for name in made} == {f.name for f in SCENES.glob("*.vtu")}
    for name, net in made.items():
        saved = mb.load(SCENES / f"{name}.vtu")
        # other machines may round sines and roots differently
        np.testing.assert_allclose(
            saved.control_points, net.control_points, rtol=1e-12, atol=1e-12, err_msg=name
        )
    for name, text in eye.rays().items():
        saved = np.array((SCENES / f"eye_rays_{name}.txt").read_text("utf-8").split(), float)
        # written with six digits
        np.testing.assert_allclose(np.array(text.split(), float), saved, atol=2e-6, err_msg=name)


def test_the_double_gauss_is_what_its_patent_says():
    lens = load(SCENES / "gauss_f14.csv")
    data = first_order(lens)
    # the patent's lens has f = 100, here halved; its radii have five digits
    assert data.focal_length == pytest.approx(50, rel=1e-4)
    assert data.f_number == pytest.approx(1.4)
    on_axis = spot(lens, (0, 0))
    # all of the beam of f/1.4 passes, and meets within some hundredths of a millimetre
    assert on_axis.transmitted == 1 and on_axis.rms < 0.025


def test_the_eye_has_the_power_of_its_authors():
    eye = load(SCENES / "eye.csv")
    data = first_order(eye)
    behind = eye.indices(0.5876)[-1]
    # Escudero-Sanz and Navarro (1999): 60.4 dioptres, 24 mm long
    assert 1000 * behind / data.focal_length == pytest.approx(60.4, abs=0.05)
    assert eye.frames()[-1][2, 3] == pytest.approx(23.92)


def test_rays_of_the_eye_meet_on_its_retina():
    middle = load(SCENES / "eye.csv").frames()[-1][2, 3] - 12
    for text in script("make_eye").rays().values():
        rays = [np.array([row.split() for row in ray.splitlines()], float)
                for ray in text.strip().split("\n\n")]  # fmt: skip
        ends = np.array([ray[-1, :3] for ray in rays])
        np.testing.assert_allclose(np.linalg.norm(ends - [middle, 0, 0], axis=1), 12, atol=2e-6)
        # a pupil of 4 mm, 20 degrees off the axis: a tenth of a millimetre by its aberrations
        assert len(rays) == 9 and np.ptp(ends, axis=0).max() < 0.3


def test_the_mirrors_of_the_telescope_have_one_focus():
    telescope = script("make_telescope")
    mirrors = Lens(
        [
            Surface(-1 / 1200, -450, mirror=True, conic=-1, semi_diameter=100),
            Surface(-1 / 400, 450 + telescope.FOCUS, mirror=True, conic=-25 / 9, semi_diameter=32),
        ]
    )
    y = np.linspace(41, 100, 20)
    o = np.stack([0 * y, y, 0 * y - 600], axis=1)
    found = trace(mirrors, o, np.tile([0.0, 0.0, 1.0], (20, 1)))
    # two conics with a common focus: to rounding
    assert found.valid.all() and np.abs(found.points[-1][:, :2]).max() < 1e-9
    for net, s, z in zip(telescope.mirrors().values(), mirrors.surfaces, (0, -450)):
        p = net.tessellate(8)[0]
        np.testing.assert_allclose(
            p[:, 2] - z, s.sag(np.hypot(p[:, 0], p[:, 1])), atol=1e-9, err_msg="patches"
        )


def test_stars_out_of_focus_show_secondary_and_spider():
    image = render("startest", 320, 180, 64)
    pixels = 320 / 66  # in a millimetre
    # 120 mm outside of the focus of f/12: a disk of 10 mm, its shadow of 40 %
    x, y = 160 + 26.4 * pixels, 90.0
    rows, columns = np.mgrid[:180, :320] + 0.5
    r = np.hypot(columns - x, rows - y) / pixels
    turn = np.degrees(np.arctan2(rows - y, columns - x)) % 90
    ring = (r > 2.6) & (r < 4.4)
    # vanes are at 45 degrees, 3 mm of 200: a shadow of 0.15 mm, less than a pixel
    vanes, between = ring & (np.abs(turn - 45) < 2), ring & (np.abs(turn - 45) > 15)
    bright = image[between].mean()
    assert bright > 0.3
    assert image[r < 1.6].max() < 0.1 * bright
    assert image[(r > 5.8) & (r < 6.0)].max() < 0.1 * bright
    assert image[vanes].mean() < 0.85 * bright
    # in focus a star is a point
    middle = image[80:100, 150:170]
    assert middle.max() > 0.2 and (middle > 0.1 * middle.max()).sum() <= 16


def test_the_magnifier_gathers_light():
    image = render("magnifier", 80, 50, 32)
    # the caustic is some times as bright as the page in the light, and the shadow darker
    page = np.median(image[5:20, 5:15])
    assert image[25:35, 48:60].max() > 2 * page
    assert image[30:40, 62:70].min() < 0.6 * page


def test_the_eye_is_cut_in_half():
    image = render("eye", 64, 36, 8)
    # the retina behind the cut is lit, beside the eye the wall is dark
    assert image[8:12, 40:46].mean() > 3 * image[2:6, 58:62].mean()


def test_lamps_behind_the_table_are_spread():
    sky = render("table", 60, 40, 16)[:12]
    # lamps of radiance 30 to 60 are discs of 1 to 2, which cover a good part of the sky
    assert 0.12 < (sky > 0.3).mean() < 0.5
    assert 1 < np.percentile(sky, 95) < 6


def test_ghosts_of_the_lamp_lie_across_the_street():
    ghosts, none = (render("street", 60, 40, 64, ghosts=g) for g in ("true", "false"))
    # below the middle, away from the lamp, where the street alone is dark
    corner = (slice(28, 38), slice(40, 56))
    assert ghosts[corner].mean() > 3 * none[corner].mean()


def test_lamps_out_of_focus_are_discs():
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_file(str(SCENES / "bokeh.xml"), width="60", height="40", spp="16")
    image = np.array(mi.render(scene, spp=16)).mean(axis=2)
    assert np.isfinite(image).all()
    # a lamp of 1 cm behind the teapot would be a pixel without the lens; its discs cover much
    bright = image > 0.5 * np.percentile(image, 99)
    assert 0.02 < bright.mean() < 0.6


def test_a_prism_spreads_colours_in_their_order():
    mi.set_variant("llvm_ad_spectral")
    scene = mi.load_file(str(SCENES / "prism.xml"), width="160", height="90", spp="64")
    image = np.array(mi.render(scene, spp=64))
    assert np.isfinite(image).all()
    # one column of the fan, right of the prism: red is turned least and stands highest
    column = image[:, 125:140].mean(axis=1)
    rows = np.arange(len(column))[:, None]
    middle = (rows * column).sum(axis=0) / column.sum(axis=0)
    # the fan is some ten pixels wide there; noise of a mean row is a tenth of a pixel
    assert middle[0] + 1 < middle[1] < middle[2] - 1
    # before the prism the beam is white: equal shares but for the illuminant's own colour
    white = image[:, 15:40].sum(axis=(0, 1))
    assert white.min() > 0.5 * white.max()
