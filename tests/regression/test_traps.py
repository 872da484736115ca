"""The traps of those who keep renders under test, each as a run of pytest within pytest."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from pytest_cases import HEAD, SAME, Project

import mitsuba_bezier as mb
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.verification.images import read_image, write_exr

pytest_plugins = ["pytester"]


@pytest.fixture
def project(pytester, request):
    return Project(pytester, request)


XML = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="3"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm">
      <string name="component_format" value="float32"/>
      <integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
  </sensor>
  <shape type="beziertriangle"><string name="filename" value="ball.vtu"/></shape>
  <emitter type="constant"><rgb name="radiance" value="0.3"/></emitter>
</scene>"""

# the package is not imported: the fixture is all that such a project knows
WITH_PATH = """
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")

def test_it(render_regression):
    {before}
    render_regression("{scene}", "ball")
"""


def test_the_object_is_seen_by_path_and_rendered_as_the_command_does(project):
    scene = project.path / "below" / "ball.xml"
    scene.parent.mkdir()
    scene.write_text(XML)
    mb.save(mb.sphere(), scene.parent / "ball.vtu")
    project.makepyfile(**{"below/test_it": WITH_PATH.format(before="", scene="ball.xml")})
    project.run("--bezier-generate-refs").assert_outcomes(skipped=1)
    stored = read_image(project.path / "below/references/ball.exr")
    # how it was made, so that a difference can be told from a change
    about = stored.attributes
    assert about["integrator"] == "bezierpath" and len(about["scene"]) == 32
    assert (about["sensor"], about["rfilter"], about["passes"]) == (0, "box", 32)
    assert {f"version_{n}" for n in ("mitsuba", "drjit", "llvm", "mitsuba_bezier")} <= set(about)

    project.run("--bezier-report", "all.html").assert_outcomes(passed=1)
    (kept,) = (project.path / "bezier-artifacts").rglob("ball.exr")
    assert main(["render", str(scene), "-o", "own.exr", "-q"]) == 0
    own, kept = read_image("own.exr"), read_image(kept)
    for channel in "RGB":
        np.testing.assert_array_equal(own.channels[channel], kept.channels[channel])
    assert own.attributes["scene"] == kept.attributes["scene"] == about["scene"]

    # nothing of ours in force: still the picture of the command, not one without the ball
    before = "import mitsuba_bezier; mitsuba_bezier.native(False)"
    project.makepyfile(**{"below/test_it": WITH_PATH.format(before=before, scene="ball.xml")})
    project.run().assert_outcomes(passed=1)
    # and where that cannot be, an error
    scene.write_text(XML.replace('"path"', '"direct"').replace('name="max_depth" value="3"', ""))
    scene.write_text(re.sub(r"<integrator.*?/integrator>", '<integrator type="direct"/>', XML))
    result = project.run()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*integrator: expected one that sees the scene's B*zier shapes*"])

    # without the ball the test is red
    scene.write_text(re.sub(r"<shape.*?/shape>", "", XML))
    result = project.run()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*Z-test*the scene is another than that of the reference*"])


def test_nothing_red_stays_beside_a_green_run(project):
    changed = SAME.replace("scene()", "scene(radiance=6.0)")
    project.write(SAME)
    project.run("--bezier-generate-refs").assert_outcomes(skipped=1)
    own = project.path / "bezier-artifacts" / "mine.txt"
    own.write_text("not of this plugin")
    project.write(changed)
    project.run().assert_outcomes(failed=1)
    assert [e["change"] for e in project.entries()] == ["changed"]
    kept = [p.name for p in (project.path / "bezier-artifacts").rglob("*.exr")]
    assert sorted(kept) == ["ball.candidate.exr", "ball.exr"]

    # another run, of other tests, says nothing about them
    project.makepyfile(test_other="def test_other():\n    pass\n")
    project.run("test_other.py").assert_outcomes(passed=1)
    assert [e["change"] for e in project.entries()] == ["changed"]

    project.write(SAME)
    project.run().assert_outcomes(passed=2)
    assert [e["change"] for e in project.entries()] == ["unchanged"]
    assert not list((project.path / "bezier-artifacts").rglob("*.exr"))
    assert own.read_text() == "not of this plugin"


def test_paths_are_those_of_the_test_or_the_root_and_none_is_absolute(project, monkeypatch):
    scene = XML.replace("<shape", "<!--").replace("/shape>", "-->").replace('"path"', '"direct"')
    scene = re.sub(r"<integrator.*?/integrator>", '<integrator type="direct"/>', scene)
    (project.path / "scenes").mkdir()
    (project.path / "scenes/a.xml").write_text(scene)
    tests = "def test_it(render_regression):\n    render_regression('scenes/a.xml', 'a')\n"
    project.makepyfile(**{"tests/test_it": HEAD.format(variant="scalar_rgb") + tests})
    project.makeini("[pytest]\n")
    elsewhere = project.path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    arguments = (str(project.path / "tests"), f"--rootdir={project.path}")
    result = project.run(*arguments, f"--junitxml={project.path}/junit.xml")
    result.assert_outcomes(failed=1)
    page = (project.path / "bezier-artifacts/report.html").read_text(encoding="utf-8")
    junit = (project.path / "junit.xml").read_text(encoding="utf-8")
    for text in (page, junit, (project.path / "bezier-artifacts/results.json").read_text()):
        assert str(project.path) not in text and "/tmp/" not in text
    # figures that a program can read, no Python
    (value,) = [p.get("value") for p in ET.fromstring(junit).iter("property")]
    assert json.loads(value)["reference"] == "tests/references/a.exr"
    assert json.loads(value)["state"] == "new"
    project.run(*arguments, "--bezier-accept").assert_outcomes(skipped=1)
    assert (project.path / "tests/references/a.exr").is_file()
    project.run(*arguments).assert_outcomes(passed=1)


CANNOT = """
def test_wide(render_regression):
    render_regression(scene(), "ball", rmse=10, z_test=False)

def test_few(render_regression):
    render_regression(scene(), "ball", z_share=0.01)

def test_narrow(render_regression):
    render_regression(scene(), "ball", rmse=1e-4)

def test_good(render_regression):
    render_regression(scene(), "ball", rmse=0.02)

def test_empty(render_regression):
    void = scene()
    del void["ball"]
    render_regression(void, "void")
"""


def test_what_cannot_fail_or_cannot_pass_is_said(project):
    project.write(CANNOT)
    made = project.run("--bezier-generate-refs", "-k", "good or empty")
    made.assert_outcomes(skipped=2, deselected=3)
    made.stdout.fnmatch_lines(["note: *test_empty void: the reference shows nothing: every pixel*"])
    result = project.run()
    result.assert_outcomes(passed=4, failed=1)
    cannot = "this test cannot fail: the limits let a picture pass that has one colour all over"
    for line in (
        f"note: *test_wide ball: {cannot}",
        f"note: *test_few ball: {cannot}",
        "note: *test_empty void: the reference shows nothing: every pixel is *",
        "note: *test_narrow ball: RMSE: the limit 0.0001 is below what noise alone gives, 0.0*",
    ):
        result.stdout.fnmatch_lines([line])
    assert "test_good ball:" not in result.stdout.str()
    entries = {e["name"]: e for e in project.entries()}
    assert entries["test_ball.py::test_wide ball"]["notes"] == [cannot]
    # what noise gives stands beside each limit, and is right
    checks = entries["test_ball.py::test_narrow ball"]["panels"][0]["checks"]
    rmse = next(c for c in checks if c["name"] == "RMSE")
    # 1728 numbers: their root mean square is within some 5 % of what is expected
    assert rmse["expected"] == pytest.approx(rmse["value"], rel=0.15)

    project.makeini("[pytest]\nbezier_strict = true\n")
    project.run().assert_outcomes(passed=1, failed=4)


def test_a_reference_that_lies_elsewhere_or_is_a_pointer(project):
    project.makeini("[pytest]\nbezier_reference_dir = {rootdir}/../refs\n")
    project.write(SAME)
    project.run("--bezier-accept").assert_outcomes(skipped=1)
    reference = project.path.parent / "refs" / "ball.exr"
    assert reference.is_file() and not project.reference.exists()
    project.run().assert_outcomes(passed=1)
    exact = read_image(reference)
    lines = "bezier_reference_dir = {rootdir}/../refs\nbezier_compression = dwaa"
    project.makeini(f"[pytest]\n{lines}\n")
    project.run("--bezier-generate-refs").assert_outcomes(skipped=1)
    small = read_image(reference)
    assert small.attributes["lossy"] == "dwaa" and "lossy" not in exact.attributes
    error = np.abs(small.channels["G"] - exact.channels["G"]).max()
    assert 0 < error < 0.02  # of values up to 1: below the noise of a test
    project.run().assert_outcomes(passed=1)
    reference.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    result = project.run()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*got a pointer of Git LFS; fetch it: git lfs pull*"])


def test_a_reference_of_another_size_or_variant(project):
    project.write(SAME)
    project.run("--bezier-generate-refs").assert_outcomes(skipped=1)
    stored = read_image(project.reference)
    small = {name: pixels[:20] for name, pixels in stored.channels.items()}
    write_exr(project.reference, small, {**stored.attributes, "variant": "llvm_ad_spectral"})
    result = project.run()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "*size: expected 24 x 20 as in the reference, got 24 x 24*variant llvm_ad_spectral in "
            "the reference, scalar_rgb now*"
        ]
    )


def test_two_tests_do_not_write_one_reference(project):
    shared = SAME.replace("test_same", "test_share")
    project.write(SAME + shared + SAME.replace("test_same", "test_too").replace("()", "(3.0)"))
    result = project.run("--bezier-generate-refs")
    # of one scene they share it, of two it is an error
    result.assert_outcomes(skipped=1, passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            "*name: expected one that no test of another scene writes, got ball, which is that of "
            "*test_same*"
        ]
    )


ODD = """
@pytest.mark.parametrize("word", ["quote'\\"s", "new\\nline", "a/b", "a b", "a_b", "ü" * 200])
def test_odd(render_regression, word):
    render_regression(scene(6.0), "ball")
"""


def test_odd_names_of_tests_do_not_meet(project):
    project.write(SAME + ODD)
    project.run("--bezier-generate-refs", "-k", "same").assert_outcomes(skipped=1, deselected=6)
    project.run("--junitxml=j.xml").assert_outcomes(passed=1, failed=6)
    values = [p.get("value") for p in ET.parse(project.path / "j.xml").getroot().iter("property")]
    images = {json.loads(value).get("image") for value in values}
    assert len(values) == 7 and len(images) == 7
    assert all((project.path / "bezier-artifacts" / i).is_file() for i in images if i)
    assert len({e["name"] for e in project.entries()}) == 7
