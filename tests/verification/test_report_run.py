"""The report of a run: states, values, exposure, selections, grid, forms; in a browser."""

from __future__ import annotations

import base64
import errno
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import DECODED

from mitsuba_bezier import _files
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.verification import preview, report
from mitsuba_bezier.verification.accept import plan
from mitsuba_bezier.verification.comparison import compare_images
from mitsuba_bezier.verification.images import Image, read_image, write_exr
from mitsuba_bezier.verification.records import Record, measures
from mitsuba_bezier.verification.thresholds import Thresholds

HEIGHT, WIDTH = 48, 64
SCREENSHOTS = Path(__file__).with_name("screenshots")
RUN = {
    "accept": True,
    "report": "bezier-artifacts/report.html",
    "root": "..",
    "branch": "main",
    "commit": "0123456789abcdef",
    "subject": "Lamps are brighter",
    "seconds": 75.0,
    "machine": "Linux x86_64, a processor, 2 cores",
}


def picture(seed=0, shift=0.0, spp=16):
    """A disc before a gradient, with noise, and its variance."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    disc = np.hypot(x - 32 - shift, y - 24) < 14
    base = np.stack([x / WIDTH, y / HEIGHT, np.full(x.shape, 0.4)], axis=-1)
    base[disc] = [0.8, 0.3, 0.1]
    noise = np.random.default_rng(seed).normal(0, 0.1 / np.sqrt(spp), base.shape)
    channels = {c: (base + noise)[..., k] for k, c in enumerate("RGB")}
    return channels, {f"variance.{c}": np.full(x.shape, 0.01) for c in "RGB"}


def reference(seed=1):
    channels, variance = picture(seed, spp=512)
    return Image({**channels, **variance}, {"spp": 512})


def entry(name, shift=0.0, seed=2, **limits):
    test = Image(picture(seed, shift)[0], {"spp": 16})
    result = compare_images(reference(), test, Thresholds(flags=limits), name)
    record = Record(
        f"test_a.py::test_{name} {name}",
        f"test_a.py::test_{name}",
        name,
        result.change,
        f"references/{name}.exr",
        f"{name}.exr",
        f"{name}.candidate.exr",
        measures=measures(result),
        notes=result.notes,
        seconds=seed,
    )
    small = base64.b64decode(preview.thumbnail_jpeg(test))
    made = report.entry(replace(result, name=record.title), f"pytest {record.test}")
    return report.from_record(made, record, result.state, small)


def lone(name, state):
    record = Record(
        f"test_a.py::test_{name} {name}", f"test_a.py::test_{name}", name, state, candidate="x.exr"
    )
    made = report.Entry(record.title, "error", report.single(reference(), "test"), "no reference")
    return report.from_record(made, record, "error")


def page_data(path):
    (data,) = re.findall(r'id="data">(.*?)</script>', path.read_text(encoding="utf-8"), re.S)
    return json.loads(data)


@pytest.fixture(scope="module")
def entries():
    return [
        entry("moved", 3.0),
        entry("tight", rmse=1e-3),
        entry("much", 9.0, flip=0.01, z_test=False),
        entry("same"),
        entry("wide", max_abs=100, z_test=False),
        lone("brand-new", "new"),
    ]


@pytest.fixture(scope="module", params=["page", "folder"])
def page(request, entries, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / "report.html"
    note = report.write_report(path, entries, "Render regression", run=RUN, form=request.param)
    assert note == ""
    return path


# ------------------------------------------------------------------ what is in it


def test_the_map_of_the_measure_that_failed_first_is_shown_first(entries):
    first = {e.name.split()[-1]: e.panels[0].maps[e.panels[0].first].title for e in entries[:3]}
    assert first == {"moved": "Z-score", "tight": "absolute", "much": "FLIP"}


def test_files_beside_it_come_and_go(entries, tmp_path):
    path = tmp_path / "r.html"
    report.write_report(path, entries, "Title", form="folder")
    folder = tmp_path / "r_files"
    names = {p.name for p in folder.iterdir()}
    assert {p.rpartition(".")[2] for p in names} == {"png", "jpeg", "js"}
    text = path.read_text(encoding="utf-8")
    assert len(text) < 1e5 and "base64," not in page_data(path)["entries"][0]["thumbnail"]
    assert all(f"r_files/{name}" in text for name in names)
    (folder / "mine.txt").touch()
    report.write_report(path, entries[:1], "Title", form="folder")
    assert {p.name for p in folder.iterdir()} < names | {"mine.txt"}
    report.write_report(path, entries, "Title", form="page")
    assert [p.name for p in folder.iterdir()] == ["mine.txt"]


def test_a_large_page_asks_for_a_folder(entries, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "LARGEST_PAGE", 200_000)
    path = tmp_path / "r.html"
    note = report.write_report(path, entries, "Title")
    assert re.fullmatch(r"one page would have \d+ MB, .*: its pictures are in r_files/ .*", note)
    assert (tmp_path / "r_files").is_dir() and path.stat().st_size < 200_000
    note = report.write_report(path, entries, "Title", form="page")
    assert note.endswith("use the form of a folder") and path.stat().st_size > 200_000


def test_a_disk_that_is_full_in_the_middle_leaves_the_old_report(entries, tmp_path, monkeypatch):
    path = tmp_path / "r.html"
    report.write_report(path, entries[:2], "Title", form="folder")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    write, count = _files.os.write, [0]

    def full(descriptor, data):
        count[0] += 1
        if count[0] > 7:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr(_files.os, "write", full)
    with pytest.raises(FileFormatError, match="No space left"):
        report.write_report(path, entries, "Title", form="folder")
    monkeypatch.undo()
    assert count[0] > 7
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


# ------------------------------------------------------------------ in a browser


@pytest.fixture
def browser(chromium_browser, page):
    chromium_browser.scheme("light")
    chromium_browser.resize(1280, 900)
    chromium_browser.clear()
    chromium_browser.open(page)
    yield chromium_browser
    assert not chromium_browser.errors
    places = ("data:", "file:", "blob:")
    assert not [url for url in chromium_browser.requests if not url.startswith(places)]


def card(name):
    return f"document.querySelector('[data-name=\"test_a.py::test_{name} {name}\"]')"


NAMES = "[...document.querySelectorAll('.card')].map(c => c.dataset.name.split(' ').pop())"


@pytest.mark.browser
def test_states_and_where_it_was_made(browser):
    assert browser.run("document.getElementById('verdict').textContent") == (
        "3 changed, 1 new, 2 unchanged."
    )
    pills = "[...document.querySelectorAll('.pill')].map(p => p.textContent)"
    assert browser.run(pills) == [
        *["✗ changed"] * 3,
        "+ new",
        *["✓ unchanged"] * 2,
    ]
    about = browser.run("document.getElementById('meta').textContent")
    for text in ("branch main", "commit 0123456789", "Lamps are brighter", "1 min 15 s", "2 cores"):
        assert text in about
    assert "svg" in browser.run("document.getElementById('icon').href")
    # what is wrong with a test is told in the list, too
    assert "cannot fail" in browser.run(f"{card('wide')}.querySelector('.why').textContent")
    browser.run("document.querySelector('.chip[data-state=changed]').click()")
    shown = "[...document.querySelectorAll('.card')].filter(c => c.offsetParent).length"
    assert browser.run(shown) == 3


@pytest.mark.browser
def test_values_under_the_cursor(browser, entries):
    stage = f"{card('moved')}.querySelector('.stage')"
    browser.run(f"{stage}.scrollIntoView({{block: 'center'}})")
    x, y, w, h = browser.run(
        f"(b => [b.x, b.y, b.width, b.height])({stage}.getBoundingClientRect())"
    )
    column, row = 40, 20
    browser.page.mouse.move(x + w * (column + 0.5) / WIDTH, y + h * (row + 0.5) / HEIGHT)
    browser.wait(f"{card('moved')}.querySelector('.readout').textContent.includes('difference')")
    lines = browser.run(f"{card('moved')}.querySelector('.readout').textContent").split("\n")
    assert lines[0] == f"column {column}, row {row}"
    a, b = reference().channels, picture(2, 3.0)[0]
    for line, values in zip(lines[1:], (a, b, {c: b[c] - a[c] for c in "RGB"})):
        found = dict(re.findall(r"([RGB]) (\S+)", line))
        for channel in "RGB":
            number = float(found[channel].replace("−", "-"))
            # three digits of half precision, of the largest of the two that are added
            near = max(abs(a[channel][row, column]), abs(b[channel][row, column])) * 2e-3
            assert number == pytest.approx(values[channel][row, column], abs=near)


@pytest.mark.browser
def test_exposure_and_channels_change_both_pictures(browser):
    sources = f"[...{card('moved')}.querySelectorAll('.pair img')].map(i => i.src)"
    before = browser.run(sources)
    browser.run(f"{card('moved')}.querySelector('.head').focus()")
    # the first of two changes may be painted before the second: wait for the end of both
    painted = f"{card('moved')}.querySelector('.adjust').ariaBusy === 'false'"
    browser.key("]")
    browser.key("]")
    browser.wait(painted)
    assert browser.run(sources)[0] != before[0]
    assert browser.run(f"{card('moved')}.querySelector('.adjust output').textContent") == "+1.0 EV"
    middle = (
        "(async () => { const c = document.createElement('canvas'); const i = new Image();"
        f"i.src = {card('moved')}.querySelector('.pair img').src; await i.decode();"
        "c.width = i.width; c.height = i.height; const x = c.getContext('2d');"
        "x.drawImage(i, 0, 0);"
        "return [...x.getImageData(2, 40, 1, 1).data] })()"
    )
    values = reference().stack("RGB")[40, 2]
    # half precision and the rounding to bytes
    np.testing.assert_allclose(browser.run(middle)[:3], preview.to_srgb8(2 * values), atol=1)
    browser.key("[")
    browser.key("[")
    browser.wait(painted)
    assert browser.run(sources)[0] == before[0]
    browser.key("c")  # red alone, as grey
    browser.wait(painted)
    red = browser.run(middle)
    assert red[0] == red[1] == red[2] == pytest.approx(preview.to_srgb8(values)[0], abs=1)


@pytest.mark.browser
def test_a_selection_has_its_own_numbers_and_histogram(browser):
    stage = f"{card('moved')}.querySelector('.stage')"
    browser.run(f"{stage}.scrollIntoView({{block: 'center'}})")
    x, y, w, h = browser.run(
        f"(b => [b.x, b.y, b.width, b.height])({stage}.getBoundingClientRect())"
    )
    split = browser.run(f"{card('moved')}.querySelector('.handle').style.left")
    browser.run(f"{card('moved')}.querySelector('.select').click()")
    browser.page.mouse.move(x + w * 10.5 / WIDTH, y + h * 10.5 / HEIGHT)
    browser.page.mouse.down()
    browser.page.mouse.move(x + w * 29.5 / WIDTH, y + h * 39.5 / HEIGHT, steps=3)
    browser.page.mouse.up()
    heading = f"[...{card('moved')}.querySelectorAll('h3')].map(h => h.textContent).join()"
    browser.wait(f"{heading}.includes('columns 10 to 29, rows 10 to 39')")
    # the slider stayed where it was
    assert browser.run(f"{card('moved')}.querySelector('.handle').style.left") == split
    row = browser.run(
        f"[...{card('moved')}.querySelectorAll('.side-by > div:last-child tbody tr')][0].innerText"
    ).split("\t")
    a, b = (v["R"][10:40, 10:30] for v in (reference().channels, picture(2, 3.0)[0]))
    expected = [a.mean(), b.mean(), (b - a).mean(), np.sqrt(((b - a) ** 2).mean())]
    found = [float(cell.replace("−", "-")) for cell in row[1:]]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4)
    browser.key("Escape")
    browser.wait(f"!{heading}.includes('columns 10')")


@pytest.mark.browser
def test_onion_skin_sorting_grid_and_keys(browser):
    browser.run(f"{card('moved')}.querySelector('.head').focus()")
    browser.key("4")
    opacity = f"{card('moved')}.querySelector('img[alt=test]').style.opacity"
    assert browser.run(opacity) == "0.5"
    browser.key("ArrowRight")
    assert browser.run(opacity) == "0.55"
    browser.page.select_option("#sort", "size")
    assert browser.run(NAMES)[0] == "tight"  # 25 times its limit
    browser.page.select_option("#sort", "name")
    assert browser.run(NAMES) == ["brand-new", "moved", "much", "same", "tight", "wide"]
    browser.run("document.activeElement.blur()")
    browser.key("g")
    assert browser.run("document.getElementById('list').classList.contains('grid')")
    assert browser.run("document.getElementById('layout').textContent") == "List"


@pytest.mark.browser
def test_the_button_copies_the_command_that_accepts(browser, page):
    copied = "document.getElementById('accept').dataset.copied"
    browser.run("document.getElementById('accept').click()")
    browser.wait(copied)
    # paths are relative to the root of the project
    assert browser.run(copied) == "mitsuba-bezier accept bezier-artifacts/report.html"
    browser.run(f"{card('much')}.querySelector('.head').focus()")
    browser.key("a")
    assert browser.run("document.getElementById('accept').textContent").endswith("1 marked")
    browser.run("document.getElementById('accept').click()")
    expected = "mitsuba-bezier accept bezier-artifacts/report.html 'test_a.py::test_much much'"
    browser.wait(f"{copied} === {json.dumps(expected)}")
    # and the command knows what it means
    (page.parent / "test_a.py").touch()
    channels = picture()[0]
    write_exr(page.parent / "much.candidate.exr", channels)
    (step,) = plan(page, ["test_a.py::test_much much"], page.parent)
    assert step.target == page.parent.resolve() / "references/much.exr"
    assert read_image(page.parent / "much.candidate.exr").channels.keys() == channels.keys()


@pytest.mark.browser
def test_what_a_button_says_outlasts_copied(browser):
    label = "document.getElementById('accept').textContent"
    browser.run("document.getElementById('accept').click()")
    browser.wait(f"{label} === 'Copied'")
    browser.run(f"{card('much')}.querySelector('.head').focus()")
    browser.key("a")
    browser.run("new Promise(done => setTimeout(done, 1700))")  # "Copied" stays for 1.5 s
    assert browser.run(label) == "Copy: accept 1 marked"


# the numbers come when a test lets them
SLOW = """(() => {
  const real = unpack, gate = new Promise(done => window.release = done);
  unpack = async panel => {
    await gate;
    const numbers = await real(panel);
    window.unpacked = true;
    return numbers;
  };
})()"""


@pytest.mark.browser
def test_numbers_that_come_late_are_not_those_of_a_pixel_that_was_left(browser):
    browser.run(SLOW)
    stage = f"{card('moved')}.querySelector('.stage')"
    browser.run(f"{stage}.scrollIntoView({{block: 'center'}})")
    x, y = browser.run(f"(b => [b.x + 9, b.y + 9])({stage}.getBoundingClientRect())")
    browser.page.mouse.move(x, y)
    place = f"{card('moved')}.querySelector('.under span:nth-child(2)').textContent"
    browser.wait(f"{place}.startsWith('column')")
    browser.page.mouse.move(1, 1)
    browser.wait(f"{place} === ''")
    browser.run("release()")
    browser.wait("window.unpacked")
    browser.settle()
    told = f"{card('moved')}.querySelector('.readout').textContent"
    assert browser.run(told).startswith("Point at a pixel")


@pytest.mark.browser
def test_pictures_that_are_gone_are_told(chromium_browser, entries, tmp_path):
    path = tmp_path / "r.html"
    report.write_report(path, entries[:1], "Title", run=RUN, form="folder")
    for file in (tmp_path / "r_files").iterdir():
        file.unlink()
    chromium_browser.open(path)
    told = "document.querySelector('.gone')?.textContent"
    chromium_browser.wait(told)  # the event comes after the promise of the picture
    assert "the picture is gone" in chromium_browser.run(told)
    stage = chromium_browser.page.locator(".stage").first
    stage.hover()
    chromium_browser.wait(
        "document.querySelector('.readout').textContent.includes('their file is gone')"
    )


@pytest.mark.browser
def test_a_hundred_images_are_a_grid(chromium_browser, entries, tmp_path):
    named = [
        replace(e, name=f"{e.name} {k}", record={**e.record, "title": f"{e.name} {k}"})
        for k in range(20)
        for e in entries[:5]
    ]
    path = tmp_path / "r.html"
    report.write_report(path, named, "Title", run=RUN)
    chromium_browser.resize(1280, 900)
    chromium_browser.open(path)
    load = "performance.timing.loadEventEnd - performance.timing.navigationStart"
    spent = chromium_browser.run(load)
    print(f"{path.stat().st_size / 1e6:.1f} MB, opened in {spent} ms")
    tiles = (
        "[...document.querySelectorAll('main.grid .card .thumb')].filter(t => t.naturalWidth > 0)"
    )
    assert chromium_browser.run(f"{tiles}.length") == 100
    assert chromium_browser.run(f"{tiles}[0].clientWidth") > 140


# Fonts differ from machine to machine. In this one all letters are blank and equally wide, so that
# layout and pictures are all that is seen, and are the same.
FONT = (SCREENSHOTS / "blank.ttf").read_bytes()
PLAIN = f"""
@font-face {{
  font-family: Blank; src: url(data:font/ttf;base64,{base64.b64encode(FONT).decode()});
}}
* {{ font-family: Blank !important; transition: none !important; caret-color: transparent; }}
select {{ appearance: none !important; }} .chart text {{ font-family: Blank !important; }}
"""


@pytest.mark.browser
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (768, "dark"), (420, "light")])
def test_screenshots(chromium_browser, entries, tmp_path, width, scheme):
    """Compared by our own `compare`; ``BEZIER_SCREENSHOTS=1`` takes them anew."""
    path = tmp_path / "r.html"
    report.write_report(path, entries, "Render regression", run=RUN)
    taken, stored = tmp_path / "taken.png", SCREENSHOTS / f"report-{width}.png"
    with chromium_browser.bare(width, 1400, scheme) as page:  # the page itself allows no font
        page.goto(path.as_uri())
        page.add_style_tag(content=PLAIN)
        page.evaluate("document.fonts.ready.then(() => 1)")
        page.evaluate(DECODED)
        page.screenshot(path=taken)
        if os.environ.get("BEZIER_SCREENSHOTS"):
            stored.write_bytes(taken.read_bytes())
        # the same to the pixel with one Chromium; others may draw corners in another way
        limits = Thresholds(flags={"rmse": 0.02})
        found = compare_images(
            read_image(stored), read_image(taken), limits, "report", with_flip=False
        )
        assert found.state == "pass", found.failed_checks
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        # what is not there is seen
        for part in (".view:nth-child(2)", ".bar", ".adjust"):
            page.add_style_tag(content=f"{part} {{ display: none !important }}")
            page.screenshot(path=taken)
            broken = compare_images(
                read_image(stored), read_image(taken), limits, "report", with_flip=False
            )
            assert broken.state == "fail", part
