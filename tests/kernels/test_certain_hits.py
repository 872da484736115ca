"""Rays that certainly meet a leaf, as culling tells: never wrong, and often enough."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from backend_cases import Float, UInt

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels import traverse
from mitsuba_bezier.kernels.arrays import types_of
from mitsuba_bezier.kernels.graph import chart
from mitsuba_bezier.kernels.query import Query, Rays
from mitsuba_bezier.kernels.structure import (
    AFFINE,
    LEAST_REMAINDER,
    OUTWARD_BITS,
    REACH_DIGITS,
    REMAINDER_DIGITS,
    Structure,
    build_structure,
)
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import (
    LEAST_REACH,
    ClosedFormLeaves,
    GraphLeaves,
    LeafKind,
    LeafSettings,
    Leaves,
)
from mitsuba_bezier.oracles.reference import first_hit

GENERAL = LeafSettings(closed_form=False)
TYPES = types_of(Float)


def wavy(n: int) -> mb.BezierTriangles:
    """Return a patch with folds."""
    rng = np.random.default_rng(n)
    points = np.pad(bernstein.multi_indices(n)[:, :2] / n, ((0, 0), (0, 1)))
    points = points + rng.normal(scale=0.5 / n, size=points.shape)
    w = rng.uniform(0.5, 2, size=(len(points), 1))
    return mb.BezierTriangles(np.concatenate([points * w, w], axis=-1)[None])


SURFACES = {
    "octants": mb.sphere(),
    "torus": mb.torus(),
    "hyperboloid": mb.hyperboloid_one_sheet(),
    "degree 3": wavy(3),
    "degree 5": wavy(5),
}


def columns(*arrays: np.ndarray) -> list[Any]:
    return [[Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in arrays]


def straight(patches: mb.BezierTriangles) -> GraphLeaves:
    """Return the leaves with affine charts."""
    graphs = build_leaves(patches, GENERAL).graph
    return graphs.select(graphs.kind == LeafKind.GRAPH_AFFINE)


def built(graphs: GraphLeaves) -> Structure:
    return build_structure(Leaves(graphs, ClosedFormLeaves.zeros()), Float)


def rays_at_leaves(
    leaves: GraphLeaves, count: int, seed: int, reach: float, steep: float = 0.0
) -> tuple[np.ndarray, ...]:
    """Return leaves, rays at points of their charts' planes, also beside them, and distances."""
    rng = np.random.default_rng(seed)
    leaf = rng.integers(0, len(leaves), count)
    inner = rng.dirichlet(np.ones(3), count) * (1 + 3 * reach) - reach
    frame = leaves.chart[leaf, :3, :3]
    p = np.linalg.solve(frame, np.pad(inner[:, :2], ((0, 0), (0, 1)))[..., None])[..., 0]
    e = rng.normal(size=p.shape)
    e[:, 2] += np.copysign(steep, e[:, 2]) * np.linalg.norm(e[:, :2], axis=1)
    d = np.linalg.solve(frame, e[..., None])[..., 0]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    far = rng.uniform(0.01, 2, count)
    o = p + leaves.shift[leaf] - far[:, None] * d
    return leaf, o.astype(np.float32), d.astype(np.float32), far


def test_bounds_as_kernels_have_them():
    leaves = straight(mb.torus())
    structure = built(leaves)
    record = AFFINE.gather(structure.affine, dr.arange(UInt, len(leaves)))
    word, others = record.remainder_outward, record.quadratic_inward
    for e in range(3):
        outward = chart._number(TYPES, word, OUTWARD_BITS[e], REACH_DIGITS, LEAST_REACH)
        inward = chart._number(TYPES, others[e], 0, REACH_DIGITS, LEAST_REACH)
        assert np.array_equal(np.array(outward), leaves.outward[:, e])
        assert np.array_equal(np.array(inward), leaves.inward[:, e])
    quadratic = np.array([np.array(x) for x in chart.affine_quadratic(TYPES, record)])
    assert np.array_equal(quadratic.T, leaves.quadratic)
    remainder = np.array(chart._number(TYPES, word, 0, REMAINDER_DIGITS, LEAST_REMAINDER))
    # seven binary digits, rounded up
    assert (remainder >= leaves.remainder).all()
    assert (remainder <= leaves.remainder * (1 + 2.0**-6)).all()


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_what_is_certain_is_so(surface):
    leaves = straight(surface)
    leaf, o, d, far = rays_at_leaves(leaves, 20_000, 3, 0.2)
    # ends before, at and behind the plane of the leaf; and origins behind it
    end = far * np.random.default_rng(4).choice([0.9, 1.0, 1.1, np.inf], len(far))
    o[::7] += (1.02 * far[:, None] * d)[::7].astype(np.float32)
    structure = built(leaves)
    query, rays = Query(structure, TYPES, True), Rays(*columns(o, d), Float(end))
    candidate, line = chart.cull(query, UInt(leaf), rays, TYPES.Bool(True))
    certain = np.array(line.certain_hit)
    assert np.array(candidate)[certain].all()
    assert 0.05 < certain.mean() < 0.8
    # there is a hit in front of the end, says float64; 2e-6 for what float32 made of its place
    chosen = np.flatnonzero(certain)[:600]
    hits = first_hit(surface, o[chosen], d[chosen])
    assert (hits.t > 0).all() and (hits.t <= end[chosen] + 2e-6).all()


def test_most_hits_are_certain():
    leaves = straight(mb.torus())
    leaf, o, d, _far = rays_at_leaves(leaves, 20_000, 5, 0.0, steep=1.0)
    structure = built(leaves)
    query, rays = Query(structure, TYPES, True), Rays(*columns(o, d), Float(np.inf))
    _candidate, line = chart.cull(query, UInt(leaf), rays, TYPES.Bool(True))
    # 0.84; without `inward` of each edge for itself 0.7
    assert np.array(line.certain_hit).mean() > 0.8


def test_rays_along_an_edge():
    net = np.zeros((1, 6, 4))
    net[0, :, :2], net[0, :, 3] = bernstein.multi_indices(2)[:, :2] / 2, 1.0
    structure = build_structure(build_leaves(mb.BezierTriangles(net), GENERAL), Float)
    # within the leaf's box, and parallel to its third edge
    p = np.array([[0.3, 0.3, 0], [0.6, 0.1, 0], [0.7, 0.7, 0], [0.2, 0.9, 0]])
    d = np.tile([0.5, -0.5, -1.0], (4, 1))
    hit = intersect(structure, *columns(p - d, d), Float(np.inf), any_hit=True)
    assert np.array(hit.valid).tolist() == [True, True, False, False]


def test_most_hits_take_no_march(monkeypatch):
    structure = build_structure(build_leaves(mb.torus()), Float)
    rng = np.random.default_rng(8)
    o = rng.normal(size=(1 << 16, 3))
    d = rng.normal(size=o.shape) * 0.4 - 2 * o
    marches = dr.zeros(UInt, 1)
    dr.eval(marches)

    def count(*args):
        dr.scatter_reduce(dr.ReduceOp.Add, marches, UInt(1), UInt(0), args[4])
        return march(*args)

    march = traverse._meet
    monkeypatch.setattr(traverse, "_meet", count)
    hit = intersect(structure, *columns(o, d), Float(np.inf), any_hit=True)
    hits = np.array(hit.valid).sum()
    # 0.33 a hit; 1.2 if nothing is decided
    assert marches[0] < 0.5 * hits and hits > 10_000


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES.keys())
def test_any_hit_is_where_there_is_a_closest_one(surface):
    leaves = build_leaves(surface, GENERAL).graph
    _leaf, o, d, far = rays_at_leaves(leaves, 100_000, 6, 0.3)
    end = Float(far * np.random.default_rng(7).choice([0.7, 1.3, np.inf], len(far)))
    structure = built(leaves)
    closest = intersect(structure, *columns(o, d), end)
    found = intersect(structure, *columns(o, d), end, any_hit=True)
    # an edge's tolerance or a grazing root may decide one in ten thousand
    assert (np.array(found.valid) != np.array(closest.valid)).mean() <= 1e-4
    assert 0.2 < np.array(closest.valid).mean() < 0.95
