"""A small, seeded run of the accuracy suite, `benchmarks/accuracy.py`, row by row."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def suite():
    """Return the module of the suite, which lies outside of the package."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        yield importlib.import_module("accuracy")
    finally:
        sys.path.remove(str(BENCHMARKS))


def lines(suite, row: str, scale: float, *choice):
    """Run a row; every line that is kept must meet its requirement."""
    rng = np.random.default_rng([7, *row.encode()])
    out = list(suite.ROWS[row](rng, scale, *choice))
    assert out
    failed = [f"{x.what}: {x.measured}\n  " + "\n  ".join(x.failures) for x in out if not x.passed]
    assert not failed, "\n".join(failed)
    assert all(line.rays > 0 for line in out)
    return out


# The scales leave each line a few hundred to some ten thousand rays; the tolerances are those
# of the table, in `accuracy_tools` and `accuracy_rows`.


def test_spheres_are_as_exact_as_the_native_one(suite):
    from accuracy_tools import GENERAL

    lines(suite, "spheres", 0.005, (("tetrahedral", None), ("octants", None), ("octants", GENERAL)))


def test_closed_covers_do_not_leak(suite):
    lines(suite, "leaks", 0.001, ("tetrahedral", "octants", "capped cone"))


def test_rays_that_leave_a_sphere_do_not_meet_it_again(suite):
    for line in lines(suite, "leaving", 0.05, ((0.0, 1e3), (1e4, 1e3))):
        # grazing rays apart, spawned origins are inside: the check of the other side is no sham
        assert line.values["inside"] > 0.9


def test_random_rational_triangles(suite):
    lines(suite, "random", 0.002, (2, 4, 8))


def test_teapot_torus_and_cone(suite):
    lines(suite, "models", 0.001)


def test_surfaces_to_infinity(suite):
    for line in lines(suite, "infinity", 0.002, ("general",)):
        # hits far out were judged, and they are most of the rays
        assert line.values["reach"] > 1e5 and line.values["firm"] > 0.4


def test_points_are_as_exact_as_those_of_the_native_sphere(suite):
    places = (((0.0, 0.0, 0.0), 1.0), ((278.0, 273.0, -5400.0), 250.0), ((1e5, 0.0, 0.0), 1.0))
    found = lines(suite, "points", 0.02, places)
    # three covers and an asphere each, and a torus near enough
    assert len(found) == 14
    for line in found:
        assert line.values["lost"] == 0 and line.values["max n"] < 1e-6


def test_command_line(suite, capsys):
    assert suite.main(["odd", "--scale", "0.005", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["scale"] == 0.005
    assert {line["row"] for line in report["lines"]} == {"odd"}
    assert all(line["passed"] for line in report["lines"])
    with pytest.raises(SystemExit):
        suite.main(["evn"])
    assert "expected some of spheres" in capsys.readouterr().err


def test_a_hole_is_found(suite):
    """A suite that passes everything proves nothing: one patch less, one patch moved."""
    import accuracy_rows
    import accuracy_tools

    import mitsuba_bezier as mb

    ball = mb.sphere(cover="tetrahedral")
    rng = np.random.default_rng(3)
    o, d = accuracy_tools.at_random(rng, 2000, 0.5)
    hole = accuracy_tools.Tracer(mb.BezierTriangles(ball.control_points[1:]))
    assert 10 < (~hole(o, d).valid).sum() < 1990
    o, d = accuracy_tools.at_random(rng, 500)
    tracer = accuracy_tools.Tracer(ball)
    tracer.patches = ball.transform(np.diag([1.001, 1, 1, 1]))
    line = accuracy_tools.against_reference("moved", tracer, o, d)
    assert not line.passed and line.values["wrong root"] > 50 and line.failures
    assert accuracy_rows.scaled(10, 0.1) == 64
