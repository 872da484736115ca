"""The site builds without a warning, and its pages hold together."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import browser
import pytest

DOCS = Path(__file__).parents[2] / "docs"


def module(name: str, path: Path):
    """Return a script of the documentation as a module."""
    spec = importlib.util.spec_from_file_location(name, path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


BUILD = module("docs_build", DOCS / "build.py")
GENERATE = module("docs_generate", DOCS / "_ext" / "generate.py")
PAGES = module("docs_site_pages", DOCS / "_ext" / "site_pages.py")


def test_the_site_builds_and_its_pages_hold_together(tmp_path):
    for package in (
        "sphinx",
        "furo",
        "myst_parser",
        "sphinx_design",
        "sphinx_gallery",
        "latex2mathml",
    ):
        pytest.importorskip(package, reason="pip install '.[docs]'")
    command = [sys.executable, str(DOCS / "build.py"), "--out", str(tmp_path / "html")]
    environment = {**os.environ, "MITSUBA_BEZIER_GALLERY": "0"}  # its scripts run in .ci/run
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "no faults" in done.stdout
    built = {path.relative_to(tmp_path / "html").as_posix() for path in tmp_path.rglob("*.html")}
    assert {"index.html", "quickstart.html", "generated/api.html"} <= built
    # formulas are drawn by the browser, without a script, and none is left as it was written
    report = (tmp_path / "html" / "paper.html").read_text(encoding="utf-8")
    assert report.count("<math ") > 40 and "$" not in re.sub(
        r"<script.*?</script>", "", report, flags=re.S
    )
    # every page of the repository is one of the site, the lecture in pieces
    pages = {p.relative_to(DOCS).with_suffix(".html").as_posix() for p in BUILD.pages()}
    assert pages - built == {"lecture.html"}


def test_a_page_wider_than_a_telephone_is_found(tmp_path):
    if browser.find() is None or importlib.util.find_spec("playwright") is None:
        pytest.skip("no Chromium, or no playwright")
    (tmp_path / "good.html").write_text("<!doctype html><p>words</p>")
    words = [sys.executable, str(DOCS / "look.py"), str(tmp_path), "--screens", str(tmp_path / "s")]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0 and "1 pages, no faults" in done.stdout, done.stderr
    assert (tmp_path / "s" / "420" / "good.jpg").stat().st_size > 1000
    wide = "<!doctype html><div style='width: 700px'>x</div><script>none()</script>"
    (tmp_path / "wide.html").write_text(wide)
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 1
    # 700 and the margin of 8 pixels
    assert "wide.html: 288 pixels wider than 420" in done.stderr
    assert "none is not defined" in done.stderr


@pytest.fixture
def site(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "index.html").write_text("<a href='sub/a.html#here'>a</a><img src='p.png'>")
    (tmp_path / "sub" / "a.html").write_text("<p id='here'></p><a href='../index.html'>b</a>")
    (tmp_path / "p.png").write_bytes(b"0" * 1000)
    assert BUILD.faults(tmp_path) == []
    return tmp_path


@pytest.mark.parametrize(
    "text, fault",
    [
        ("<a href='sub/b.html'>", "leads nowhere"),
        ("<a href='sub/a.html#there'>", "no place on its page"),
        ("<a href='#there'>", "no place on its page"),
        ("<img src='q.png'>", "q.png is not there"),
        ("<script src='https://cdn.example/x.js'></script>", "asks another server"),
        ("<script src='//cdn.example/x.js'></script>", "asks another server"),
        ("<link rel='stylesheet' href='https://fonts.example/x.css'>", "asks another server"),
    ],
)
def test_faults_of_pages_are_found(site, text, fault):
    (site / "index.html").write_text(text)
    (found,) = BUILD.faults(site)
    assert found.startswith("index.html") and fault in found


def test_a_folder_without_pages_is_a_fault(tmp_path):
    assert len(BUILD.faults(tmp_path)) == len(BUILD.faults(tmp_path / "none")) == 1


def test_links_elsewhere_are_none_of_the_build(site):
    (site / "index.html").write_text("<a href='https://example.org/x#y'>x</a>")
    assert BUILD.faults(site) == []


def test_heavy_pages_are_found(site):
    (site / "p.png").write_bytes(b"0" * 2_100_000)
    (found,) = BUILD.faults(site)
    assert "weighs 2.10 MB" in found


def test_the_page_of_commands_has_every_command_and_option():
    from mitsuba_bezier.cli.main import COMMANDS, _parser

    text = GENERATE.commands()
    for name in COMMANDS:
        section = text[text.index(f"\n## {name}\n") :].split("\n## ", 2)[1]
        (subparsers,) = (a for a in _parser([name])._actions if a.dest == "command")
        for action in subparsers.choices[name]._actions:
            for option in action.option_strings if action.dest != "help" else ():
                assert option in section


#: Parameters of Mitsuba's classes below ours, and `trims`, which files fill in.
INHERITED = {
    *("trims", "face_normals", "silhouette_sampling_weight", "interior", "exterior"),
    *("hide_emitters", "shutter_open", "shutter_close"),
}


def test_the_page_of_plugins_has_every_parameter_that_is_accepted():
    from mitsuba_bezier.plugins import PLUGINS, spelling

    text = GENERATE.plugins()
    for name in PLUGINS:
        section = text[text.index(f"\n## {name}\n") :].split("\n## ", 2)[1]
        for parameter in spelling.PARAMETERS.get(name, ()):
            if parameter not in INHERITED and "other parameters are the same" not in section:
                assert parameter in section, f"{name} {parameter}"


def test_a_row_of_a_table_of_parameters_needs_a_type():
    text = "Title (:monosp:`x`)\n-----\n\n.. pluginparameters::\n\n * - a\n   - |int|\n"
    with pytest.raises(ValueError, match="expected a name, a type and a meaning"):
        GENERATE.read_plugin(text)
    rows = GENERATE.read_plugin(text + "   - Of :math:`a \\le b`, ``c``.\n\nAfter.\n")
    assert rows == ("Title", [], [("a", "int", "Of `a ≤ b`, `c`.")], ["After."])


def test_every_public_name_has_a_place_in_the_reference():
    import mitsuba_bezier

    text = GENERATE.api()
    for name in set(mitsuba_bezier.__all__) - GENERATE.NO_PAGE:
        assert f":: mitsuba_bezier.{name}\n" in text


def test_the_lecture_is_cut_into_pages_that_keep_all_of_it():
    pages = GENERATE.lecture()
    text = (DOCS / "lecture.md").read_text(encoding="utf-8")
    assert sum(page.count("![") for page in pages.values()) == text.count("![")
    assert sum(page.count("```python") for page in pages.values()) == text.count("```python")
    assert len(pages) == text.count("\n## ") + 1
    # links lead elsewhere, and nothing else has changed
    for sign in "()[]":
        assert sum(page.count(sign) for page in pages.values()) == text.count(sign), sign


@pytest.mark.parametrize(
    ("picture", "drawing"),
    [
        ("figures/ceva.svg", True),
        ("figures/basic_curve.webp", True),
        ("../figures/kepler.png", True),
        ("figures/media_drawn.webp", False),  # over a render
        ("lens-mtf.svg", True),
        ("lens-focus.jpg", True),
        ("lens-eye.jpg", False),
        ("../renders/readme.jpg", False),
    ],
)
def test_drawings_are_told_from_renders(picture, drawing):
    assert PAGES.is_drawing(picture) == drawing


@pytest.mark.parametrize(
    "page, link, led",
    [
        ("index", "[a](lecture.md#b)", "[a](generated/lecture.md#b)"),
        ("howto/x", "[a](../lecture.md)", "[a](../generated/lecture.md)"),
        ("howto/x", "[a](../../README.md)", "[a](../index.md)"),
        ("verification", "[a](../tests/x/README.md)", "[a](path:../tests/x/README.md)"),
        ("verification", "[a](conventions.md#b)", "[a](conventions.md#b)"),
        ("verification", "[a](https://x.org/y.md)", "[a](https://x.org/y.md)"),
    ],
)
def test_links_of_the_repository_lead_somewhere_on_the_site(page, link, led):
    assert PAGES.lead(page, link) == led


def test_the_drawings_of_the_concepts_are_there():
    pytest.importorskip("matplotlib")
    draw = module("docs_concepts", DOCS / "concepts" / "draw.py")
    text = "".join(p.read_text(encoding="utf-8") for p in (DOCS / "concepts").glob("*.md"))
    for name, figure in draw.FIGURES.items():
        assert f"]({name}.svg)" in text and (DOCS / "concepts" / f"{name}.svg").exists()
        assert figure().encoded(".svg").startswith(b"<?xml")  # with its asserts


def test_the_short_answer_on_speed_is_that_of_the_table():
    text = (DOCS / "performance.md").read_text(encoding="utf-8")
    short = text[text.index("In short") : text.index("## Rays")]
    rays = text[text.index("<!-- rays -->") : text.index("The same by processor")]
    figures = re.findall(r"\d+(?:\.\d+)?", short)
    assert len(figures) == 6
    for figure in figures:
        assert f"| {figure} (" in rays, figure


def test_pictures_of_parameters_are_of_parameters_that_there_are():
    text = GENERATE.plugins()
    found = sorted((DOCS / "pictures").glob("*-*.webp"))
    assert len(found) >= 13
    for path in found:
        plugin, _, parameter = path.stem.partition("-")
        assert f"![{plugin} with {parameter}](../pictures/{path.name})" in text
        assert path.stat().st_size < 40_000
