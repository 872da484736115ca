"""The report: what is in the page, and how it behaves in a browser.

The tests of behaviour drive headless Chromium. Without one they are skipped with a clear word,
but fail where ``CI`` is set: there the browser belongs to the environment.
"""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from mitsuba_bezier.cli import main as cli
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.verification import png, preview, report
from mitsuba_bezier.verification.comparison import Comparison, compare_images
from mitsuba_bezier.verification.images import Image, write_exr
from mitsuba_bezier.verification.thresholds import Thresholds

HEIGHT, WIDTH = 40, 60


def image(seed=0, scale=1.0, **more):
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    rgb = np.stack([x / WIDTH, y / HEIGHT, 0.5 + 0 * x], axis=-1) * scale
    rgb = rgb + np.random.default_rng(seed).uniform(0, 0.02, rgb.shape)
    return Image({**{c: rgb[..., i] for i, c in enumerate("RGB")}, **more})


def compared(name, test=None, **flags):
    return compare_images(image(), test or image(), Thresholds(flags=flags), name)


def page_data(text):
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    return json.loads(data)


def pixels(uri):
    return png.decode(base64.b64decode(uri.removeprefix("data:image/png;base64,")), "uri")


# ------------------------------------------------------------------ pictures


def test_both_pictures_are_shown_alike():
    a = np.array([[[0.0, 0.0031308, 1.0], [0.5, 0.2, 9.0]]])
    shown, same, caption = preview.show(a, a, "linear", True, exposure=0)
    # sRGB: black, the joint of the curve (12.92 * 0.0031308 * 255), white; clipped above
    assert shown.tolist() == [[[0, 10, 255], [188, 124, 255]]]
    np.testing.assert_array_equal(shown, same)
    darker, _, caption = preview.show(a, a, "linear", True, exposure=-1)
    assert darker[0, 0].tolist() == [0, 5, 188] and caption == "sRGB, exposure -1 EV"
    bright = np.full((4, 4, 3), 100.0)
    assert "exposure -7 EV" in preview.show(bright, bright, "linear", True)[2]
    depth = np.array([[[2.0], [6.0]]])
    shown, other, caption = preview.show(depth, depth + 1, "linear", False)
    assert (shown[0, :, 0].tolist(), other[0, :, 0].tolist()) == ([0, 255], [64, 255])
    assert caption == "linear, black 2, white 6"


def test_not_a_number_stands_out():
    a = np.zeros((1, 2, 3))
    b = a.copy()
    b[0, 1, 2] = np.nan
    assert preview.show(a, b, "linear", True)[1].tolist() == [[[0, 0, 0], [255, 0, 255]]]
    heat = preview.false_color(np.array([[0.0, np.nan, 1.0]]), 0, 1, "magma")
    assert heat.tolist() == [[[0, 0, 4], [0, 255, 140], [252, 253, 191]]]


def test_a_scale_of_no_extent():
    assert preview.false_color(np.zeros((1, 2)), 0, 0, "magma").tolist() == [[[0, 0, 4]] * 2]


def test_histogram_counts_every_pixel():
    rng = np.random.default_rng(2)
    difference = rng.normal(size=(50, 40, 2))
    difference[0, 0, 0] = 1e6  # a firefly, counted in the last bin
    difference[1, 1, 1] = np.nan
    h = preview.difference_histogram(difference, ["R", "G"], bins=11)
    assert [sum(counts) for counts in h.counts] == [2000, 1999]
    assert 2 < h.limit < 5  # that of nearly all, 99.8 % of a normal distribution
    assert h.counts[0][5] == np.sum(np.abs(difference[..., 0]) <= h.limit / 11)
    assert preview.difference_histogram(np.zeros((3, 3, 1)), ["Y"]) is None


def test_a_thumbnail_is_an_average():
    picture = np.random.default_rng(0).integers(0, 256, (200, 130, 3)).astype(np.uint8)
    small = preview.thumbnail(picture, 100)
    assert small.shape == (100, 65, 3)
    expected = picture.reshape(100, 2, 65, 2, 3).mean(axis=(1, 3))
    assert np.abs(small - expected).max() <= 0.5


# ------------------------------------------------------------------ the page


def test_failures_come_first_and_nothing_is_lost():
    comparisons = [
        compared("b passes"),
        Comparison("a broken", None, None, error="damaged"),
        compared("z fails", image(1), max_abs=0.001),
        compared("a passes"),
    ]
    entries = [report.entry(c, f"repeat {c.name}") for c in comparisons]
    data = page_data(report.render_report(entries, "Title", "sub", "all"))
    assert [(e["name"], e["state"]) for e in data["entries"]] == [
        ("z fails", "fail"),
        ("a broken", "error"),
        ("a passes", "pass"),
        ("b passes", "pass"),
    ]
    failed, broken = data["entries"][:2]
    assert failed["command"] == "repeat z fails" and broken["message"] == "damaged"
    (panel,) = failed["panels"]
    assert (panel["width"], panel["height"]) == (WIDTH, HEIGHT)
    titles = [m["title"] for m in panel["maps"]]
    assert titles[:2] == ["absolute", "signed"]
    for uri in (panel["reference"], panel["test"], *(m["picture"] for m in panel["maps"])):
        assert pixels(uri).shape == (HEIGHT, WIDTH, 3)
    assert not np.array_equal(pixels(panel["reference"]), pixels(panel["test"]))
    assert next(c for c in panel["checks"] if c["name"] == "max")["passed"] is False


def test_the_page_needs_nothing_else():
    text = report.render_report([report.entry(compared("x"))], "Title")
    page = text.replace(re.findall(r'id="data">(.*?)</script>', text, re.S)[0], "")
    assert "default-src 'none'" in page
    # no address at all but that of SVG's name space, no file beside the page
    assert set(re.findall(r"\w+://[^\"' )]*", page)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"<(link|script|img)[^>]*(href|src)=(?!\"data:)", page)
    assert "@import" not in page and "url(" not in page


def test_names_cannot_break_out_of_the_page():
    nasty = '</script><img src=x onerror="alert(1)">&amp;\u2028'
    broken = replace(compared("x"), name=nasty, error=nasty, layers=[])
    text = report.render_report([report.entry(broken)], nasty)
    assert page_data(text)["entries"][0]["name"] == nasty
    assert "onerror" not in re.sub(r'id="data">.*?</script>', "", text, flags=re.S)


def test_numbers_that_json_lacks():
    bad = image()
    bad.channels["R"][:] = np.nan
    data = page_data(report.render_report([report.entry(compared("x", bad))], "Title"))
    checks = {c["name"]: c for c in data["entries"][0]["panels"][0]["checks"]}
    assert checks["RMSE"]["value"] is None
    assert checks["pixels not finite"]["value"] == HEIGHT * WIDTH


def test_a_page_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileFormatError, match="expected a file that can be written"):
        report.write_report(tmp_path / "file" / "r.html", [], "Title")


def test_the_command_repeats_one_image_without_its_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("a", "b"):
        write_exr(tmp_path / folder / "s" / "x y.exr", image().channels)
    words = ["compare", "a", "b", "--rmse", "0.1", "--html", "out/r.html", "--json=n.json"]
    assert cli.main(words) == 0
    data = page_data((tmp_path / "out/r.html").read_text(encoding="utf-8"))
    command = "mitsuba-bezier compare a b --rmse 0.1 --only 's/x y'"
    assert data["entries"][0]["command"] == command
    assert data["command"] == "mitsuba-bezier " + " ".join(words)
    assert "report: out/r.html" in capsys.readouterr().out


# ------------------------------------------------------------------ in a browser


@pytest.fixture(scope="module")
def report_page(tmp_path_factory):
    """A report with every kind of entry."""
    depth = np.linspace(1, 9, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    spot = image()
    spot.channels["G"][8:12, 30:36] += 0.5
    layered = [
        compare_images(
            image(**{"dd.T": depth}), image(**{"dd.T": depth + shift}), Thresholds(), "layers"
        )
        for shift in (0.1,)
    ]
    comparisons = [
        compared("pass one"),
        compared("pass two"),
        compared("spot", spot),
        Comparison("broken", None, None, error="x.exr: expected an intact EXR file"),
        *layered,
    ]
    path = tmp_path_factory.mktemp("report") / "report.html"
    entries = [report.entry(c, f"mitsuba-bezier compare --only {c.name}") for c in comparisons]
    report.write_report(path, entries, "Nightly", "Reference: a, test: b", "make all")
    return path


@pytest.fixture
def browser(chromium_browser, report_page):
    """The browser with a freshly loaded report."""
    chromium_browser.scheme("light")
    chromium_browser.resize(1280, 900)
    chromium_browser.clear()
    chromium_browser.open(report_page)
    yield chromium_browser
    assert not chromium_browser.errors
    requests = chromium_browser.requests
    # what is unpacked comes from the page itself
    assert not [url for url in requests if not url.startswith(("data:", "file:", "blob:"))]


CARD = "document.querySelector('[data-name=\"{}\"]')"
SHOWN = (
    "[...document.querySelectorAll('.card')].filter(c => c.offsetParent).map(c => c.dataset.name)"
)


def center(browser, selector):
    browser.run(
        f"document.querySelector({json.dumps(selector)}).scrollIntoView({{block: 'center'}})"
    )
    return browser.run(
        "(b => [b.x + b.width / 2, b.y + b.height / 2])"
        f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
    )


def click(browser, selector):
    x, y = center(browser, selector)
    browser.mouse("mousePressed", x, y)
    browser.mouse("mouseReleased", x, y)


@pytest.mark.browser
def test_it_opens_with_failures_first(browser):
    assert browser.run("document.title") == "✗ Nightly"
    assert browser.run(SHOWN) == ["layers", "spot", "broken", "pass one", "pass two"]
    states = "[...document.querySelectorAll('.card')].map(c => c.classList.contains('open'))"
    assert browser.run(states) == [True, True, True, False, False]
    verdict = browser.run("document.getElementById('verdict').textContent")
    assert verdict == "2 of 5 failed, 1 could not be compared."
    # all pictures can be decoded
    assert browser.run("[...document.images].every(i => i.naturalWidth > 0)")
    assert browser.run("document.images.length") > 6


SPOT = '[data-name="spot"]'
CLIP = f"document.querySelector('{SPOT} img[alt=test]').style.clipPath"


@pytest.mark.browser
def test_the_slider_moves_with_mouse_and_keys(browser):
    browser.run(f"document.querySelector('{SPOT}').scrollIntoView()")
    assert browser.run(CLIP) == "inset(0px 0px 0px 50%)"
    box = browser.run(
        f"(() => {{ const b = document.querySelector('{SPOT} .stage').getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height] })()"
    )
    y = box[1] + box[3] / 3
    browser.mouse("mousePressed", box[0] + box[2] / 2, y)
    browser.mouse("mouseMoved", box[0] + box[2] / 4, y)
    browser.mouse("mouseReleased", box[0] + box[2] / 4, y)
    assert browser.run(CLIP) == "inset(0px 0px 0px 25%)"
    # released: the picture no longer follows
    browser.mouse("mouseMoved", box[0] + box[2] / 2, y)
    assert browser.run(CLIP) == "inset(0px 0px 0px 25%)"
    browser.key("ArrowRight")
    assert browser.run(CLIP) == "inset(0px 0px 0px 26%)"
    handle = f"document.querySelector('{SPOT} .handle')"
    assert browser.run(f"{handle}.getAttribute('aria-valuenow')") == "26"
    # what is left of the divider is the reference, right of it the test: at 0, all is the test
    browser.run(f"{handle}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Home'}}))")
    assert browser.run(CLIP) == "inset(0px 0px 0px 0%)"


@pytest.mark.browser
def test_blink_shows_one_after_the_other(browser):
    click(browser, f'{SPOT} button[data-name="Blink"]')
    state = f"document.querySelector('{SPOT} img[alt=test]').style.visibility"
    for shown in ("hidden", "", "hidden"):
        browser.wait(f"{state} === '{shown}'")
    browser.key(" ")  # by hand: no more change by itself
    before = browser.run(state)
    # two of its intervals, by the clock that they run by
    browser.run("new Promise(done => setTimeout(done, 1300))")
    assert browser.run(state) == before
    browser.key(" ")
    assert browser.run(state) != before


@pytest.mark.browser
def test_side_by_side_and_zoom(browser):
    click(browser, f'{SPOT} button[data-name="Side by side"]')
    shown = (
        f"[...document.querySelectorAll('{SPOT} .pair .stage')].filter(s => s.offsetParent).length"
    )
    assert browser.run(shown) == 2
    browser.run(f"document.querySelector('{SPOT} button[data-name=\"4×\"]').click()")
    widths = f"[...document.querySelectorAll('{SPOT} .stage')].map(s => s.clientWidth)"
    assert browser.run(widths) == [4 * WIDTH] * 3
    # what was in the middle stays there
    offset = (
        "(f => [f.scrollLeft + f.clientWidth / 2, f.scrollWidth / 2])"
        f"(document.querySelector('{SPOT} .frame'))"
    )
    browser.run(f"document.querySelector('{SPOT} button[data-name=\"8×\"]').click()")
    middle, half = browser.run(offset)
    assert abs(middle - half) <= 1
    sharp = f"getComputedStyle(document.querySelector('{SPOT} .stage img')).imageRendering"
    assert browser.run(sharp) == "pixelated"


@pytest.mark.browser
def test_maps_and_layers_change_picture_and_scale(browser):
    ticks = f"document.querySelector('{SPOT} .ticks').textContent"
    source = f"document.querySelector('{SPOT} img[alt$=map]').src"
    before = browser.run(source)
    assert browser.run(ticks) == "00.1250.250.3750.5"
    browser.run(f"document.querySelector('{SPOT} button[data-name=signed]').click()")
    assert browser.run(ticks) == "−0.5−0.2500.250.5"
    assert browser.run(source) != before
    layers = CARD.format("layers")
    # the layer that failed comes first
    names = f"[...{layers}.querySelectorAll('.layers button')].map(b => b.textContent)"
    assert browser.run(names) == ["dd", "colour"]
    assert "0.1" in browser.run(f"{layers}.querySelector('tr.bad').textContent")
    browser.run(f"{layers}.querySelector('.layers [data-name=colour]').click()")
    assert browser.run(f"{layers}.querySelector('tr.bad')") is None
    assert "No differences" in browser.run(f"{layers}.querySelector('.side-by').textContent")


@pytest.mark.browser
def test_a_selection_of_a_layer_that_was_left_is_not_told(browser):
    # the numbers of the first layer come when the second is shown
    browser.run(
        "(() => { const real = unpack, gate = new Promise(done => window.release = done);"
        "unpack = async panel => { await gate; const v = await real(panel);"
        "window.unpacked = true; return v } })()"
    )
    layers = CARD.format("layers")
    x, y = center(browser, '[data-name="layers"] .stage')
    browser.run(f"{layers}.querySelector('.select').click()")
    browser.page.mouse.move(x, y)
    browser.page.mouse.down()
    browser.page.mouse.move(x + 30, y + 20)
    browser.page.mouse.up()
    assert browser.run(f"{layers}.querySelectorAll('.box').length") > 0
    browser.run(f"{layers}.querySelector('.layers [data-name=colour]').click()")
    browser.run("release()")
    browser.wait("window.unpacked")
    browser.settle()
    assert "Selection" not in browser.run(f"{layers}.querySelector('.side-by').textContent")


@pytest.mark.browser
def test_filters_by_state_and_text(browser):
    click(browser, '.chip[data-state="pass"]')
    assert browser.run(SHOWN) == ["layers", "spot", "broken"]
    click(browser, '.chip[data-state="pass"]')
    click(browser, '.chip[data-state="fail"]')
    assert browser.run(SHOWN) == ["broken", "pass one", "pass two"]
    click(browser, '.chip[data-state="fail"]')
    browser.run("scrollTo(0, 0)")
    browser.key("/")
    for letter in "pass":
        browser.key(letter)
    assert browser.run(SHOWN) == ["pass one", "pass two"]
    for letter in " qqq":
        browser.key(letter)
    assert browser.run(SHOWN) == []
    assert "No image matches" in browser.run("document.getElementById('list').innerText")


@pytest.mark.browser
def test_keys_lead_through_the_page(browser):
    name = "document.querySelector('.card.current').dataset.name"
    browser.key("j")
    assert browser.run(name) == "spot"
    browser.key("k")
    assert browser.run(name) == "layers"
    for expected in ("spot", "broken", "layers"):  # around the failures
        browser.key("n")
        assert browser.run(name) == expected
    browser.key("j")
    browser.key("2")
    pressed = f"document.querySelector('{SPOT} [data-name=Blink]').getAttribute('aria-pressed')"
    assert browser.run(pressed) == "true"
    browser.key("m")
    assert browser.run(f"document.querySelector('{SPOT} .ticks').textContent").startswith("−")
    browser.key("o")
    assert not browser.run(f"document.querySelector('{SPOT}').classList.contains('open')")
    browser.key("?")
    assert browser.run("document.getElementById('keys').open")


@pytest.mark.browser
@pytest.mark.parametrize("width", [360, 800, 1280, 1900])
def test_it_fits_every_width(browser, width):
    browser.resize(width, 800)  # and what is laid out by that
    assert browser.run("document.documentElement.scrollWidth") <= width
    # the picture is within its frame
    wide = (
        f"(s => [s.clientWidth, s.parentNode.clientWidth])(document.querySelector('{SPOT} .stage'))"
    )
    stage, frame = browser.run(wide)
    assert 0 < stage <= frame


@pytest.mark.browser
def test_light_and_dark(browser):
    color = "getComputedStyle(document.body).backgroundColor"
    light = browser.run(color)
    browser.scheme("dark")
    dark = browser.run(color)
    assert light == "rgb(244, 245, 247)" and dark == "rgb(18, 19, 22)"
    browser.key("t")  # the reader's choice overrules the system's
    assert browser.run(color) == light
