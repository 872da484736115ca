"""Accepting: from pytest, from a report of pytest, from a report of `compare`."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pytest_cases import SAME, Project

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.verification.images import read_image, write_exr

pytest_plugins = ["pytester"]

TWO = """
def test_a(render_regression):
    render_regression(scene({a}), "a")

def test_b(render_regression):
    render_regression(scene({b}), "b")
    render_regression(scene({b}), "deep/b")
"""


@pytest.fixture
def project(pytester, request):
    return Project(pytester, request)


def test_change_see_accept_green(project, capsys):
    project.write(TWO.format(a=1.0, b=1.0))
    # both calls of a test write theirs in one run
    project.run("--bezier-accept").assert_outcomes(skipped=2)
    assert (project.path / "references/deep/b.exr").is_file()
    old = (project.path / "references/a.exr").read_bytes()

    project.write(TWO.format(a=6.0, b=5.0))
    project.run().assert_outcomes(failed=2)
    report = str(project.path / "bezier-artifacts/report.html")
    states = {e["name"].split()[-1]: e["change"] for e in project.entries()}
    assert states == {"a": "changed", "b": "changed"}  # the test of b ended there

    # one of them, from the report; what is accepted is what was to be seen
    candidate = next((project.path / "bezier-artifacts").rglob("a.candidate.exr")).read_bytes()
    assert main(["accept", report, "a", "--list"]) == 0
    assert (project.path / "references/a.exr").read_bytes() == old
    assert main(["accept", report, "a"]) == 0
    assert "changed  references/a.exr\n1 reference accepted" in capsys.readouterr().out
    assert (project.path / "references/a.exr").read_bytes() == candidate
    assert main(["accept", report, "a"]) == 0  # once more does no harm

    # the other from pytest, by name, and one that is no name of an image
    result = project.run("--bezier-accept", "a", "none")
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    result.stdout.fnmatch_lines(["--bezier-accept: no render is called 'none'"])
    result = project.run("--bezier-accept", "*b", "test_ball.py")
    result.assert_outcomes(passed=1, skipped=1)
    project.run().assert_outcomes(passed=2)
    assert [e["change"] for e in project.entries()] == ["unchanged"] * 3


def test_new_and_removed(project):
    project.write(TWO.format(a=1.0, b=1.0))
    project.run("--bezier-accept").assert_outcomes(skipped=2)
    (project.path / "references/a.exr").rename(project.path / "references/old.exr")
    project.run("-k", "test_a").assert_outcomes(failed=1, deselected=1)
    # a part of the tests cannot tell what no test uses
    assert [e["change"] for e in project.entries()] == ["new"]
    project.run().assert_outcomes(failed=1, passed=1)
    states = {e["name"].split()[-1]: e["change"] for e in project.entries()}
    assert states == {"a": "new", "b": "unchanged", "deep/b": "unchanged"}, "its test failed"
    report = str(project.path / "bezier-artifacts/report.html")
    assert main(["accept", report]) == 0
    result = project.run()
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(["removed: references/old.exr: no test uses it"])
    assert main(["accept", report, "old"]) == 0
    assert not (project.path / "references/old.exr").exists()
    project.run().assert_outcomes(passed=2)
    assert {e["change"] for e in project.entries()} == {"unchanged"}


def test_a_report_from_elsewhere(project, capsys, tmp_path_factory, monkeypatch):
    project.write(SAME)
    project.run().assert_outcomes(failed=1)
    away = tmp_path_factory.mktemp("downloads") / "artefact"
    shutil.copytree(project.path / "bezier-artifacts", away)
    report = str(away / "report.html")
    monkeypatch.chdir(away)
    assert main(["accept", report]) == 2
    assert "--root: expected the folder of the project" in capsys.readouterr().err
    assert main(["accept", report, "--root", str(project.path)]) == 0
    assert project.reference.is_file()
    # somebody else has been faster
    image = read_image(project.reference)
    write_exr(project.reference, image.channels, {"spp": 1})
    monkeypatch.chdir(project.path)
    assert main(["accept", report]) == 2
    assert "it has changed since; run the tests again" in capsys.readouterr().err
    # its pictures are gone
    project.reference.unlink()
    for picture in away.rglob("*.exr"):
        picture.unlink()
    assert main(["accept", report]) == 2
    assert "ball.candidate.exr: expected an image file, got nothing there" in (
        capsys.readouterr().err
    )
    assert not project.reference.exists()


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Two folders of images, compared in a report."""
    monkeypatch.chdir(tmp_path)
    y = np.linspace(0, 1, 64).reshape(8, 8)
    for name, scale in (("a/same", 1), ("a/o'd \nd", 1), ("a/gone", 1)):
        write_exr(f"{name}.exr", {c: y * scale for c in "RGB"})
    for name, scale in (("b/same", 1), ("b/o'd \nd", 2), ("b/x/new", 1)):
        write_exr(f"{name}.exr", {c: y * scale for c in "RGB"})
    assert main(["compare", "a", "b", "--html", "out/r.html"]) == 2
    return tmp_path


def tree(folder):
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in Path(folder).rglob("*.exr")
    }


def test_folders_of_images(folders, capsys):
    assert main(["accept", "out/r.html", "none"]) == 2
    assert "NAME: expected an image or a test of the report, got 'none'" in capsys.readouterr().err
    assert main(["accept", "out/r.html"]) == 0
    out = capsys.readouterr().out
    assert "removed  ../a/gone.exr" in out and "new      ../a/x/new.exr" in out
    assert "../a/o'd \\nd.exr" in out  # one line
    assert tree("a") == tree("b")
    assert main(["compare", "a", "b", "--html", "out/r.html"]) == 0


def change(data, name, **fields):
    for entry in data["entries"]:
        if entry["name"] == name:
            entry["record"] |= fields


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"reference": "../../outside.exr"}, "--root: expected a folder that holds"),
        ({"reference": "../a/.bashrc"}, "expected a reference that is an image"),
        ({"reference": "../a/same.png"}, "expected an image .png"),
        ({"candidate": "r.html"}, "expected an image, .exr or .png"),
        ({"candidate": "../text.exr"}, "expected an intact EXR file"),
        ({"candidate": "../none.exr"}, "nothing there"),
        ({"reference": "../a/link.exr"}, "expected a file, got a link"),
        ({"reference": 3}, "expected a report of mitsuba-bezier"),
        ({"was": "0"}, "has changed since"),
    ],
)
def test_a_report_cannot_have_more_done_than_images_in_place_of_images(
    folders, capsys, fields, message
):
    page = folders / "out/r.html"
    text = page.read_text(encoding="utf-8")
    (data,) = re.findall(r'id="data">(.*?)</script>', text, re.S)
    loaded = json.loads(data)
    change(loaded, "o'd \nd", **fields)
    page.write_text(text.replace(data, json.dumps(loaded).replace("<", "\\u003c")))
    (folders / "text.exr").write_text("no image")
    (folders / "target").write_text("precious")
    os.symlink("../target", folders / "a/link.exr")
    before = tree("a")
    assert main(["accept", "out/r.html"]) == 2
    assert message in capsys.readouterr().err
    assert tree("a") == before and (folders / "target").read_text() == "precious"


@pytest.mark.parametrize(
    "text", ["", "<html>", "[]", "{}", '{"run": 1, "records": [1]}', "{" * 9999]
)
def test_no_report(tmp_path, capsys, text):
    path = tmp_path / "r.html"
    path.write_text(text)
    assert main(["accept", str(path)]) == 2
    assert "expected a report of mitsuba-bezier" in capsys.readouterr().err
    assert main(["accept", str(tmp_path / "none.html")]) == 2
