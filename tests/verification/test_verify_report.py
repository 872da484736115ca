"""The report of `verify`: what is in it, and how it behaves in a browser."""

from __future__ import annotations

import base64
import json
import math
import re

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb
from mitsuba_bezier.cli.verify import cast
from mitsuba_bezier.verification import png
from mitsuba_bezier.verification.cases import CASES
from mitsuba_bezier.verification.report import write_report
from mitsuba_bezier.verification.verify import verify
from mitsuba_bezier.verification.verify_report import WORDING, verify_entry

RESOLUTION = 96
BY_NAME = {case.name: case for case in CASES}


def entry(name, patches=None):
    case = BY_NAME[name]
    hits, o, d = cast(case, RESOLUTION, patches)
    truth = case.truth(o, d)
    verdict = verify(case, hits, truth, o, d, math.radians(case.fov) / RESOLUTION)
    return verify_entry(verdict, hits, truth, f"mitsuba-bezier verify {name}", 48)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Two good cases, one with a hole, and one with a bent surface."""
    mi.set_variant(VARIANT)
    bent = BY_NAME["ellipsoid"].patches().control_points.copy()
    bent[:, 1] *= 1.02
    entries = [
        entry("sphere-octants"),
        entry("ellipsoid", mb.BezierTriangles(bent)),
        entry("torus", BY_NAME["torus"].patches()[4:]),
        entry("cone"),
    ]
    path = tmp_path_factory.mktemp("verify") / "report.html"
    write_report(path, entries, "Patches", "sub", "all", WORDING, by_name=False)
    return path


@pytest.fixture(scope="module")
def data(page):
    (text,) = re.findall(r'id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.S)
    return {e["name"]: e for e in json.loads(text)["entries"]}


def test_failures_first_then_the_order_of_the_cases(data):
    states = [(e["name"], e["state"]) for e in data.values()]
    assert states == [
        ("ellipsoid", "fail"),
        ("torus", "fail"),
        ("sphere-octants", "pass"),
        ("cone", "pass"),
    ]


def test_what_failed_is_told(data):
    def failed(name):
        return {
            c["name"] for p in data[name]["panels"] for c in p["checks"] if c["passed"] is False
        }

    assert {"mask mismatches", "depth, max"} <= failed("torus")
    assert "angle, max" in failed("ellipsoid")
    assert not failed("cone")
    # the layer that failed comes first, else the normals
    assert [p["title"] for p in data["torus"]["panels"]] == ["depth", "normal"]
    assert [p["title"] for p in data["cone"]["panels"]] == ["normal", "depth"]
    # what has no limit is not judged
    free = [c for c in data["cone"]["panels"][0]["checks"] if c["limit"] is None]
    assert free and all(c["passed"] is None for c in free)


def test_equal_pictures_are_kept_once(data):
    assert all(p["test"] is None for p in data["cone"]["panels"])
    assert all(p["test"] for p in data["torus"]["panels"])


def test_the_worst_pixel_is_marked_and_does_not_darken_the_rest(data):
    (panel,) = [p for p in data["torus"]["panels"] if p["title"] == "depth"]
    worst = next(c["value"] for c in panel["checks"] if c["name"] == "depth, max")
    depth = panel["maps"][0]
    assert depth["title"] == "depth" and 0 < depth["high"] <= worst
    column, row = panel["marked"]
    uri = depth["picture"].removeprefix("data:image/png;base64,")
    picture = png.decode(base64.b64decode(uri), "map")
    # magma ends in a light yellow
    assert picture[row, column].tolist() == [252, 253, 191]
    # half of the patches are missing: more than a fiftieth of the picture is wrong, and seen
    assert (picture.max(axis=-1) > 100).mean() > 0.02


@pytest.fixture
def browser(chromium_browser, page):
    chromium_browser.scheme("light")
    chromium_browser.resize(1280, 900)
    chromium_browser.clear()
    chromium_browser.open(page)
    yield chromium_browser
    assert not chromium_browser.errors
    urls = chromium_browser.requests
    assert not [url for url in urls if not url.startswith(("data:", "file:"))]


NAMES = "[...document.querySelectorAll('.card')].map(c => c.dataset.name)"


@pytest.mark.browser
def test_it_opens_with_failures_first(browser):
    assert browser.run(NAMES) == ["ellipsoid", "torus", "sphere-octants", "cone"]
    states = "[...document.querySelectorAll('.card')].map(c => c.classList.contains('open'))"
    assert browser.run(states) == [True, True, False, False]
    assert browser.run("document.title") == "✗ Patches"
    assert browser.run("document.getElementById('verdict').textContent") == "2 of 4 failed."
    assert browser.run("[...document.images].every(i => i.naturalWidth > 0)")
    why = "document.querySelector('[data-name=torus] .why').textContent"
    assert "mask mismatches" in browser.run(why)
    why = "document.querySelector('[data-name=cone] .why').textContent"
    assert " hits, 0 mask mismatches; depth within " in browser.run(why)
    # words of this page, none of image comparison
    tags = "[...document.querySelectorAll('[data-name=torus] .tag')].map(t => t.textContent)"
    assert set(browser.run(tags)) == {"formula", "patches"}
    assert "test" not in browser.run("document.getElementById('list').innerText")


@pytest.mark.browser
def test_the_slider_moves(browser):
    torus = "[data-name=torus]"
    clip = f"document.querySelectorAll('{torus} .stage img')[1].style.clipPath"
    browser.run(f"document.querySelector('{torus} .stage').scrollIntoView({{block: 'center'}})")
    assert browser.run(clip) == "inset(0px 0px 0px 50%)"
    x, y, width, height = browser.run(
        f"(b => [b.x, b.y, b.width, b.height])(document.querySelector('{torus} .stage')"
        ".getBoundingClientRect())"
    )
    browser.mouse("mousePressed", x + width / 2, y + height / 3)
    browser.mouse("mouseMoved", x + width / 4, y + height / 3)
    browser.mouse("mouseReleased", x + width / 4, y + height / 3)
    assert browser.run(clip) == "inset(0px 0px 0px 25%)"
    browser.key("ArrowLeft")
    assert browser.run(clip) == "inset(0px 0px 0px 24%)"


@pytest.mark.browser
def test_layers_change_pictures_and_numbers(browser):
    torus = "document.querySelector('[data-name=torus]')"
    assert "mask mismatches" in browser.run(f"{torus}.querySelector('.checks').textContent")
    browser.run(f"{torus}.querySelector('.layers [data-name=normal]').click()")
    assert "normals turned" in browser.run(f"{torus}.querySelector('.checks').textContent")
    # a passing case, whose two pictures are one in the file, shows both
    browser.run("document.querySelector('[data-name=cone] .head').click()")
    images = "[...document.querySelectorAll('[data-name=cone] .pair img')].map(i => i.src)"
    sources = browser.run(images)
    assert len(sources) == 3 and len(set(sources)) == 1
    assert np.all([s.startswith("data:image/png") for s in sources])


@pytest.mark.browser
@pytest.mark.parametrize("width", [360, 1280])
def test_it_fits(browser, width):
    browser.resize(width, 800)
    assert browser.run("document.documentElement.scrollWidth") <= width
