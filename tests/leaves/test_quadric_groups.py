"""Groups of patches on one quadric: those that belong together, and only those."""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import Float

import mitsuba_bezier as mb
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves

CENTRE = np.array([0.5, 0.25, 0.125])


def ball(cover: str, radius: float, centre: np.ndarray) -> mb.BezierTriangles:
    matrix = np.diag([radius, radius, radius, 1.0])
    matrix[:3, 3] = centre
    return mb.sphere(cover=cover).transform(matrix)


@pytest.mark.parametrize("cover", ["tetrahedral", "octants"])
@pytest.mark.parametrize("radius", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("ratio", [1.5, 1.01])
def test_small_shells_beside_something_large(cover, radius, ratio):
    large = ball(cover, 1.0, np.full(3, -1.0))
    small = [ball(cover, r, CENTRE) for r in (radius, ratio * radius)]
    patches = mb.BezierTriangles.join([*small, large])
    every = build_leaves(patches)
    leaves = every.closed_form
    assert len(every) == len(leaves) == len(patches)
    sphere = leaves.patch // len(small[0])
    for group in np.unique(leaves.group):
        assert len(np.unique(sphere[leaves.group == group])) == 1
    # float64, over what is left of a centre near one: 1e-16 / 1e-4 twice, as it is squared
    assert leaves.deviation.max() < 1e-9
    structure = build_structure(every, Float)
    o = [Float(x) for x in CENTRE]
    inside = intersect(structure, o, [Float(0), Float(0.6), Float(0.8)], Float(np.inf))
    assert inside.t[0] == pytest.approx(radius, rel=1e-6)
    beyond = 1.1 * radius if ratio > 1.1 else 1.005 * radius
    o = [Float(x) for x in CENTRE + np.array([0.0, 0.6, 0.8]) * beyond]
    between = intersect(structure, o, [Float(0), Float(0.6), Float(0.8)], Float(np.inf))
    # a rounding of the origin's coordinates, 3e-8
    assert between.t[0] == pytest.approx(ratio * radius - beyond, abs=1e-7)


def test_one_patch_of_another_shell():
    large = ball("tetrahedral", 1.0, np.full(3, -1.0))
    small = ball("tetrahedral", 1e-3, CENTRE)
    other = mb.BezierTriangles(ball("tetrahedral", 1.1e-3, CENTRE).control_points[:1])
    leaves = build_leaves(mb.BezierTriangles.join([small, other, large])).closed_form
    assert np.bincount(leaves.group).tolist().count(1) == 1
    assert leaves.deviation.max() < 1e-9  # as above


@pytest.mark.parametrize("cover", ["tetrahedral", "octants", "lunes"])
def test_spheres_have_a_group_each(cover):
    centres = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    patches = mb.BezierTriangles.join([ball(cover, 0.01, c) for c in centres])
    leaves = build_leaves(patches).closed_form
    each = len(patches) // 50
    assert len(leaves) == len(patches)
    assert len(np.unique(leaves.group)) == 50
    for group in np.unique(leaves.group):
        assert len(np.unique(leaves.patch[leaves.group == group] // each)) == 1
    assert leaves.deviation.max() < 2e-12  # of which 1e-12 is for the neighbour's


@pytest.mark.parametrize("cover", ["tetrahedral", "octants", "lunes"])
def test_nets_in_float32(cover):
    # relative to the size of an octant 4e-7, and less: rounding must not part patches
    patches = ball(cover, 0.3 if cover == "octants" else 0.1, CENTRE / 4)
    patches = mb.BezierTriangles(patches.control_points.astype(np.float32).astype(np.float64))
    far = ball(cover, 1.0, np.full(3, -2.0))
    leaves = build_leaves(mb.BezierTriangles.join([patches, far]))
    assert leaves.is_closed_form.all() and len(np.unique(leaves.closed_form.group)) == 2
