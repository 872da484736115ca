"""The fixture `render_regression`, run by pytest within pytest."""

from __future__ import annotations

import numpy as np
import pytest
from pytest_cases import HEAD, SAME, Project

from mitsuba_bezier.verification.images import read_image, write_exr

pytest_plugins = ["pytester"]


@pytest.fixture
def project(pytester, request):
    return Project(pytester, request)


def test_reference_then_pass(project):
    project.write(SAME)
    result = project.run()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["*no reference *references/ball.exr; make it: pytest *test_same --bezier-generate-refs*"]
    )
    (entry,) = project.entries()
    assert entry["state"] == "error" and "no reference" in entry["message"]

    (project.path / "bezier-artifacts/report.html").unlink()
    result = project.run("--bezier-generate-refs", "-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*reference written: *ball.exr*"])
    stored = read_image(project.reference)
    assert set(stored.channels) == {f"{p}{c}" for p in ("", "variance.") for c in "RGB"}
    assert (stored.attributes["spp"], stored.attributes["passes"]) == (32 * 16, 32)
    assert stored.attributes["variant"] == "scalar_rgb"
    assert stored.attributes["command"].endswith("test_same --bezier-generate-refs")
    assert stored.channels["variance.R"].max() > 1e-4  # there is noise to be judged

    result = project.run("--bezier-report", "all.html")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["report: *all.html"])
    assert [e["state"] for e in project.entries("all.html")] == ["pass"]
    assert not (project.path / "bezier-artifacts/report.html").exists()


FAILURES = """
def test_bright(render_regression):
    render_regression(scene(radiance=6.0), "ball")

def test_small(render_regression):
    render_regression(scene(size=20), "ball")

def test_limit_of_the_call(render_regression):
    render_regression(scene(), "ball", rmse=1e-9)

def test_limit_of_the_file(render_regression):
    render_regression(scene(), "strict/ball")

def test_call_over_file(render_regression):
    render_regression(scene(), "strict/ball", max_abs=10)

def test_nan(render_regression):
    render_regression(scene(), "nan")

def test_nan_allowed(render_regression):
    result = render_regression(scene(), "nan", allow_nan=True)
    assert result.state == "pass" and result.layers[0].metrics.not_finite == 1

@pytest.mark.parametrize(("argument", "message"), [
    ((scene(), "../ball"), "name: expected letters, digits"),
    ((3, "ball"), "scene: expected a Mitsuba scene, dict or XML file, got int"),
    (("none.xml", "ball"), "scene: expected an existing file, got none.xml"),
])
def test_wrong(render_regression, argument, message):
    with pytest.raises(mitsuba_bezier.BezierError, match=message):
        render_regression(*argument)

@pytest.mark.parametrize(("keyword", "message"), [
    ({"sensor": 1}, "sensor: expected a number below 1, got 1"),
    ({"spp": 0}, "spp: expected a number of samples >= 1, got 0"),
    ({"rsme": 1}, "flags: expected one of rmse, .*, got 'rsme'"),
    ({"seed": 1_000_003}, "seed: expected one that the reference does not contain"),
    ({"reference_passes": 1}, None),
])
def test_wrong_keyword(render_regression, keyword, message):
    if message is None:
        render_regression(scene(), "ball", **keyword)  # only used for new references
        return
    with pytest.raises(mitsuba_bezier.BezierError, match=message):
        render_regression(scene(), "ball", **keyword)
"""


def test_what_fails_is_told_kept_and_shown(project):
    project.write(SAME + FAILURES)
    project.run("--bezier-generate-refs", "-k", "test_same").assert_outcomes(
        skipped=1, deselected=15
    )
    stored = read_image(project.reference)
    write_exr(project.path / "references/strict/ball.exr", stored.channels, stored.attributes)
    stored.channels["G"][3, 4] = np.nan
    write_exr(project.path / "references/nan.exr", stored.channels, stored.attributes)
    (project.path / "limits.toml").write_text('[images."strict/*"]\nmax_abs = 1e-9\n')
    project.makeini("[pytest]\nbezier_thresholds = limits.toml\n")

    result = project.run()
    result.assert_outcomes(failed=5, passed=11)
    folder = "bezier-artifacts/test_ball.py_test_bright"
    result.stdout.fnmatch_lines(
        [
            "*render_regression: ball differs from its reference: Z-test *, at least 99.75 %*",
            "*reference: *references/ball.exr",
            f"*render: *{folder}/ball.exr",
            "*report: *bezier-artifacts/report.html",
        ]
    )
    for message in (
        "*size: expected 24 x 24 as in the reference, got 20 x 20*",
        "*RMSE 0.*, at most 1e-09*",
        "*max 0.*, at most 1e-09*",
        "*pixels not finite 1, at most 0*",
        "report: *bezier-artifacts/report.html",
    ):
        result.stdout.fnmatch_lines([message])
    assert read_image(project.path / folder / "ball.exr").attributes["spp"] == 16
    entries = {e["name"].partition("::")[2]: e for e in project.entries() if e["state"] != "pass"}
    assert {name: entry["state"] for name, entry in entries.items()} == {
        "test_bright ball": "fail",
        "test_limit_of_the_call ball": "fail",
        "test_limit_of_the_file strict/ball": "fail",
        "test_nan nan": "fail",
        "test_small ball": "error",
    }
    bright = entries["test_bright ball"]
    assert bright["command"] == "pytest test_ball.py::test_bright"
    assert "Z-score" in [m["title"] for m in bright["panels"][0]["maps"]]


def test_workers_share_one_report(project):
    for name in ("test_a", "test_b", "test_c"):
        test = SAME.replace("'ball'", f"'{name}/ball'")
        project.write(test, name)
    result = project.run("-n", "2")
    result.assert_outcomes(failed=3)
    names = [entry["name"] for entry in project.entries()]
    assert names == [f"test_{c}.py::test_same test_{c}/ball" for c in "abc"]


KINDS = """
XML = '''<scene version="3.0.0">
  <integrator type="direct"/>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="24"/><integer name="height" value="24"/><rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
  </sensor>
  <shape type="sphere"/>
  <shape type="rectangle">
    <transform name="to_world"><lookat origin="0,4,2" target="0,0,0" up="0,0,1"/></transform>
    <emitter type="area"><rgb name="radiance" value="1"/></emitter>
  </shape>
  <emitter type="constant"><rgb name="radiance" value="0.3"/></emitter>
</scene>'''

def test_same(render_regression):
    render_regression(scene(), "ball")

def test_kinds(render_regression, tmp_path):
    file = tmp_path / "ball.xml"
    file.write_text(XML)
    for one in (mi.load_dict(scene()), file, str(file)):
        render_regression(one, "ball")
    for integrator in ({"type": "path", "max_depth": 2}, mi.load_dict({"type": "direct"})):
        render_regression(scene(), "ball", integrator=integrator)
    render_regression(scene(), "ball", spp=64, seed=5)

def test_layers(render_regression):
    aov = {"type": "aov", "aovs": "nn:sh_normal", "img": {"type": "direct"}}
    render_regression(scene(), "aov", integrator=aov)
"""


def test_scenes_files_and_integrators_of_all_kinds(project):
    project.write(KINDS)
    made = project.run("--bezier-generate-refs", "-k", "same or layers")
    made.assert_outcomes(skipped=2, deselected=1)
    names = set(read_image(project.path / "references/aov.exr").channels)
    assert {"R", "nn.X", "variance.nn.X"} <= names
    project.run().assert_outcomes(passed=3)


BEZIER = """
def bezier():
    nets = mi.TensorXf(mitsuba_bezier.sphere().control_points)
    return dict(scene(), ball={"type": "beziertriangle", "control_points": nets})

def test_bezierpath(render_regression):
    path = {"type": "bezierpath", "max_depth": 2}
    render_regression(bezier(), "ball", integrator=path)

def test_native_integrator(render_regression):
    render_regression(bezier(), "ball")
"""


def test_a_bezier_sphere_against_the_sphere_of_mitsuba(project):
    project.write(SAME + BEZIER, variant="llvm_ad_rgb")
    project.run("--bezier-generate-refs", "-k", "same").assert_outcomes(skipped=1, deselected=2)
    project.run("-v").assert_outcomes(passed=3)
    # Mitsuba's own integrator, as it is, does not see it: so this comparison is able to fail
    project.write(
        SAME + BEZIER + "\nimport mitsuba_bezier\nmitsuba_bezier.native(False)\n",
        variant="llvm_ad_rgb",
    )
    result = project.run("-v")
    result.assert_outcomes(passed=2, failed=1)
    result.stdout.fnmatch_lines(["*test_native_integrator FAILED*"])


def test_no_variant_is_told(project):
    text = HEAD.format(variant="scalar_rgb").replace('mi.set_variant("scalar_rgb")', "")
    call = "def test_it(render_regression):\n    render_regression({}, 'ball')\n"
    project._pytester.makepyfile(test_ball=text + call)
    result = project.run()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*VariantError: variant: expected one that is set before*"])
