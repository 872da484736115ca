"""A few bodies of `benchmarks/cad_bodies.py`: rays against OpenCASCADE's own intersections."""

from __future__ import annotations

import sys
from pathlib import Path

import mitsuba as mi
import pytest
from backend_cases import VARIANT

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

BODIES = [
    "sphere less cylinder, as NURBS",
    "cone bored along 0 1 0",
    "ball with a hole through its pole",
    "bored torus, axis 1 1 0",
]


@pytest.mark.parametrize("name", BODIES)
def test_rays_equal_opencascade(tmp_path, name):
    pytest.importorskip("OCP")
    import cad_bodies

    mi.set_variant(VARIANT)
    bodies = cad_bodies.bodies()
    path = cad_bodies.write(bodies[name](), tmp_path / "body.step")
    found = cad_bodies.compare(path, bodies[name.removesuffix(", as NURBS")](), 250, False)
    assert found["wrong"] == [] and found["refused"] == 0
    # of 250 rays one or two meet edges within 1e-4 of the body
    assert found["edge"] <= 2 and found["hits"] > 50
