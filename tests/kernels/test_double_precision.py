"""Every kind of leaf in float64: kernels take their types from the rays."""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import Float64
from leaf_cases import SPHERE, rays, traced

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves

KINDS = {
    "inverted": SPHERE,
    "sections": mb.sphere(),
    "linear inverse": mb.sphere(cover="tetrahedral"),
    "cones and planes": shapes.cone(capped=True),
    "graphs": mb.torus(),
    "graphs at infinity": shapes.quarter_plane(),
    "all": mb.BezierTriangles.join(
        [
            SPHERE,
            mb.sphere(center=(5, 0, 0)),
            mb.torus(center=(-5, 0, 0)),
            shapes.cone(center=(0, 5, 0), capped=True).elevate(2),
            mb.sphere(center=(0, 0, 5), cover="tetrahedral").elevate(2),
        ]
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_double_precision(name):
    patches = KINDS[name]
    o, d = rays(SPHERE if "infinity" in name else patches, 1500)
    leaves = build_leaves(patches)
    structure = build_structure(leaves, Float64)
    columns = [[Float64(a[:, k].astype(np.float64)) for k in range(3)] for a in (o, d)]
    single = traced(leaves, o, d)
    valid = np.array(single.valid)
    for any_hit in (False, True):
        hit = intersect(structure, *columns, Float64(np.inf), any_hit=any_hit)
        assert (np.array(hit.valid) == valid).all() and valid.mean() > 0.1
        if not any_hit:  # of float32 a rounding of t, a few where the surface is a graph
            off = np.array(hit.t)[valid] / np.array(single.t, dtype=float)[valid] - 1
            assert np.abs(off).max() < 5e-7
