"""`mitsuba-bezier verify`: every case passes, and every case can fail."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.cli.verify import cast
from mitsuba_bezier.verification.cases import CASES
from mitsuba_bezier.verification.verify import verify

RESOLUTION = 96


@pytest.fixture(scope="module", autouse=True)
def variant():
    import mitsuba as mi

    mi.set_variant(VARIANT)


def judge(case, patches=None):
    hits, o, d = cast(case, RESOLUTION, patches)
    return verify(case, hits, case.truth(o, d), o, d, math.radians(case.fov) / RESOLUTION)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_every_case_passes_and_fails_with_a_wrong_weight(case):
    good = judge(case)
    assert good.passed, good
    # enough of the surface in view for the figures to mean something
    assert good.hits > 0.04 * good.pixels
    # one weight of every patch is off by 1e-3: the point it weights is drawn that much harder
    net = case.patches().control_points.copy()
    row = 1 if net.shape[1] > 3 else 0
    net[:, row] *= 1 + 1e-3
    if net.shape[1] == 3:  # on a plane no weight matters, but the place of a corner does
        net[:, :, 2] += 1e-3 * net[:, :, 3]
    assert not judge(case, mb.BezierTriangles(net)).passed


def test_a_missing_patch_is_seen():
    case = next(c for c in CASES if c.name == "torus")
    verdict = judge(case, case.patches()[1:])
    assert verdict.mask_mismatches > 0 or verdict.depth_max > 0.1
    assert not verdict.passed


def test_turned_normals_are_seen():
    case = next(c for c in CASES if c.name == "sphere-octants")
    patches = case.patches()
    half = mb.BezierTriangles.join([patches[:4].reverse(), patches[4:]])
    verdict = judge(case, half)
    assert verdict.normal_flips > 0 and not verdict.passed
    # nothing else is wrong with it
    assert verdict.mask_mismatches == 0 and verdict.depth_max < 2e-5


def test_silhouettes_are_measured_in_pixels():
    case = next(c for c in CASES if c.name == "sphere-octants")
    bigger = mb.sphere(radius=1.05)
    verdict = judge(case, bigger)
    # the silhouette moves by 5 % of the radius, which is 5 % of 1 / (4.5 * pixel) pixels
    pixel = math.radians(case.fov) / RESOLUTION
    distance = float(np.linalg.norm(case.origin))
    assert verdict.silhouette_px == pytest.approx(0.05 / distance / pixel, rel=0.5)


def test_command_writes_figures_and_fails_on_bad_input(tmp_path, capsys):
    out = tmp_path / "figures.json"
    page = tmp_path / "report.html"
    words = ["verify", "sphere-tetrahedral", "lens", "--resolution", "64", "--json", str(out)]
    assert main([*words, "--html", str(page)]) == 0
    text = page.read_text()
    assert "mitsuba-bezier verify lens -m llvm_ad_rgb --resolution 64" in text
    assert 'src="http' not in text and 'href="http' not in text  # self-contained
    figures = json.loads(out.read_text())
    assert [c["name"] for c in figures["cases"]] == ["sphere-tetrahedral", "lens"]
    assert all(c["passed"] for c in figures["cases"])
    capsys.readouterr()
    assert main(["verify", "spere"]) == 2
    assert "CASE: expected one of sphere-octants" in capsys.readouterr().err
    assert main(["verify", "--resolution", "0"]) == 2
    assert "--resolution: expected 8" in capsys.readouterr().err
    assert main(["verify", "--list"]) == 0
    assert capsys.readouterr().out.split() == [c.name for c in CASES]
