"""Tests of nets that are elevations: they are found, and keep their closed forms."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from backend_cases import plain

import mitsuba_bezier as mb
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.closed_form.degree_reduction import reduce_degree
from mitsuba_bezier.leaves.records import LeafKind

SPHERE = mb.sphere(cover="tetrahedral")
FLAT = mb.BezierTriangles([[[0, 0, 0, 1], [1, 0, 0, 2], [0.5, 1, 0.25, 1]]])


@pytest.mark.parametrize("times", [1, 2, 5])
@pytest.mark.parametrize("single", [False, True])
def test_an_elevation_is_undone(times, single):
    net = SPHERE.elevate(times).control_points
    if single:
        net = net.astype(np.float32).astype(float)
    found, lower, residual = reduce_degree(mb.BezierTriangles(net), 2)
    assert found.all()
    # float64, and the rounding of the tensors that Mitsuba keeps
    assert residual.max() < (3e-7 if single else 1e-14)
    assert np.allclose(lower.control_points, SPHERE.control_points, atol=1e-6 if single else 1e-13)


def test_others_are_left_alone():
    net = SPHERE.elevate(2).control_points.copy()
    net[3, 4, 2] += 1e-5 * np.abs(net[3]).max()
    found, lower, _residual = reduce_degree(mb.BezierTriangles(net), 2)
    assert list(np.flatnonzero(~found)) == [3] and len(lower) == 9
    found, lower, _residual = reduce_degree(mb.torus(), 2)
    assert not found.any() and lower is None


@pytest.mark.parametrize("times", [1, 3])
def test_elevated_quadrics_and_triangles_have_closed_forms(times):
    leaves = build_leaves(SPHERE.elevate(times))
    assert len(leaves) == 10 and leaves.is_closed_form.all()
    assert (leaves.closed_form.group == 0).all()
    leaves = build_leaves(FLAT.elevate(times))
    assert len(leaves) == 1 and leaves.is_closed_form.all()


def test_what_rounding_took_counts_as_a_deviation():
    net = SPHERE.elevate(2).control_points.astype(np.float32).astype(float)
    patches = mb.BezierTriangles(net)
    _found, _lower, residual = reduce_degree(patches, 2)
    leaves = build_leaves(patches).closed_form
    assert residual.min() > 1e-9
    assert (leaves.deviation >= residual[leaves.patch]).all()


def test_rays_on_a_set_of_mixed_degrees():
    mixed = [SPHERE.elevate(2).control_points, mb.torus(center=(5, 0, 0)).control_points]
    patches = mb.BezierTriangles(np.concatenate(mixed))
    structure = build_structure(build_leaves(patches), plain.Float)
    assert structure.kinds == {LeafKind.LINEAR, LeafKind.GRAPH_AFFINE}
    rng = np.random.default_rng(1)
    o = rng.normal(size=(20_000, 3))
    o *= 3 / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-0.55, 0.55, (20_000, 3)) - o
    o, d = o.astype(np.float32).astype(float), d.astype(np.float32).astype(float)
    columns = [[plain.Float(np.ascontiguousarray(a[:, c])) for c in range(3)] for a in (o, d)]
    hit = intersect(structure, *columns, dr.full(plain.Float, np.inf, len(o)))
    a, b, c = (d * d).sum(1), (o * d).sum(1), (o * o).sum(1) - 1
    expected = (-b - np.sqrt(b * b - a * c)) / a
    # a rounding of t, which is about one
    assert np.abs(np.array(hit.t) - expected).max() < 3e-7
    uv = np.stack([hit.u, hit.v], axis=1).astype(float)
    points = patches.points(np.array(hit.patch), uv)
    assert np.abs(points - (o + np.array(hit.t)[:, None] * d)).max() < 1e-5
