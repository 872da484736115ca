"""Nets in buckets of their degree: which, and that hits are those of code of their own."""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import Float, Float64
from leaf_cases import assert_found_among_others, rays

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.kernels import buckets
from mitsuba_bezier.kernels.buckets import UNROLLED, choose
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.nets import Nets
from mitsuba_bezier.leaves.records import LeafKind, LeafSettings, Leaves

GENERAL = LeafSettings(closed_form=False)


def wavy(n: int, at: float = 0.0, rational: bool = False) -> mb.BezierTriangles:
    """A height field of degree `n`, in its own place along x."""
    x, y, _w = bernstein.multi_indices(n).T / n
    z = 0.2 * np.sin(3 * x) * np.cos(2 * y)
    w = 1.0 + 0.2 * rational * np.cos(3 * x)
    return mb.BezierTriangles((np.stack([x + at, y, z, np.ones_like(x)]) * w).T[None])


def at_infinity() -> mb.BezierTriangles:
    """A surface whose general leaves have projective charts, some of them."""
    matrix = np.eye(4)
    matrix[3] = (0.2, 0.1, 0.9, 0.6)
    return mb.sphere(cover="octants").transform(matrix)


SURFACES = {
    "affine": lambda: wavy(5),
    "rational": lambda: wavy(4, rational=True),
    "projective": at_infinity,
    "of high degree": lambda: wavy(9),
    "quarter plane": shapes.quarter_plane,
}
#: What rays are aimed at, instead of surfaces that run to infinity.
AIMS = {"projective": mb.sphere(), "quarter plane": wavy(2)}


@pytest.mark.parametrize(
    ("name", "number"),
    [*((name, Float) for name in SURFACES), ("rational", Float64), ("projective", Float64)],
)
def test_nets_read_row_by_row_give_the_same_hits(name, number, monkeypatch):
    patches = SURFACES[name]()
    leaves = build_leaves(patches, GENERAL)
    o, d = rays(AIMS.get(name, patches), 2000)
    columns = [[number(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in (o, d)]
    found = []
    for highest in (99, 0):
        monkeypatch.setattr(buckets, "UNROLLED", highest)
        s = build_structure(leaves, number)
        used = s.nets if s.has(LeafKind.GRAPH_AFFINE) else s.far_nets
        assert (used[0].degree is None) == (highest == 0)
        hits = intersect(s, *columns, number(np.inf))
        any_hit = intersect(s, *columns, number(np.inf), any_hit=True)
        found.append([np.array(x) for x in (*hits, any_hit.valid)])
    assert 0.1 < found[0][0].mean() < 1
    for whole, by_rows in zip(*found):
        np.testing.assert_array_equal(whole, by_rows)


def test_patches_of_many_degrees_in_one_scene():
    parts = [wavy(2, 0), wavy(3, 2), wavy(6, 4, rational=True), wavy(13, 6), wavy(16, 8)]
    structure = assert_found_among_others(parts)
    degrees = [bucket.degree for bucket in structure.nets]
    assert degrees[-1] is None and 1 <= len(degrees) - 1 <= 2
    # each net is as long as it needs to be, or as its bucket's highest
    rows = np.array(structure.nets[-1].by_rows.rows).reshape(-1, 4)
    counts = [build_leaves(p).graph.nets for p in (wavy(13), wavy(16))]
    assert len(rows) == sum(len(nets.rows) for nets in counts)


def test_projective_leaves_of_many_degrees():
    parts = [at_infinity(), at_infinity().elevate(7)]
    leaves = [build_leaves(p, GENERAL) for p in parts]
    count = len(parts[0])
    both = Leaves.join([leaves[0], leaves[1].of_patches(count + np.arange(count))])
    o, d = rays(mb.sphere(), 2000)
    columns = [[Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in (o, d)]
    s = build_structure(both, Float)
    assert s.far_nets[0].degree == 4 and s.far_nets[-1].degree is None
    alone = intersect(build_structure(leaves[0], Float), *columns, Float(np.inf))
    hit = intersect(s, *columns, Float(np.inf))
    valid = np.array(alone.valid)
    assert valid.mean() > 0.1
    np.testing.assert_array_equal(np.array(hit.valid), valid)
    # two leaves in one place: which is hit is rounding
    np.testing.assert_allclose(np.array(hit.t)[valid], np.array(alone.t)[valid], rtol=1e-5)
    assert 0.05 < (np.array(hit.patch)[valid] >= count).mean() < 0.95


# ---------------------------------------------------------------- which buckets


def chosen(*kinds: tuple[int, int, int]) -> list[tuple[int | None, int, int]]:
    """Choose for (degree, components, count) each; return degree, components, count of buckets."""
    degree = np.concatenate([np.full(n, d) for d, _c, n in kinds])
    components = np.concatenate([np.full(n, c) for _d, c, n in kinds])
    out = choose(np.repeat(degree[:, None], 3, axis=1), components)
    every = np.sort(np.concatenate([c.numbers for c in out]))
    assert (every == np.arange(len(degree))).all()
    for c in out:
        assert (np.diff(c.numbers) > 0).all()
        if c.degree is not None:
            assert degree[c.numbers].max(initial=1) == c.degree
            assert components[c.numbers].max(initial=3) == c.components
    return [(c.degree, c.components, len(c.numbers)) for c in out]


def test_beside_nets_by_rows_a_second_bucket_saves_a_lot_or_is_none():
    few = chosen((3, 4, 10), (5, 4, 10), (12, 4, 1))
    assert few == [(5, 4, 20), (None, 4, 1)]
    assert len(chosen((3, 4, 10), (5, 4, 10))) == 2
    assert chosen((2, 4, 100), (8, 4, 1), (12, 4, 1)) == [(2, 4, 100), (8, 4, 1), (None, 4, 1)]


def test_one_degree_is_one_bucket():
    assert chosen((6, 3, 100)) == [(6, 3, 100)]
    assert chosen((UNROLLED + 1, 3, 5)) == [(None, 4, 5)]


def test_a_few_of_high_degree_leave_the_others_alone():
    assert chosen((4, 3, 1000), (16, 4, 3)) == [(4, 3, 1000), (None, 4, 3)]
    assert chosen((4, 3, 1000), (8, 4, 3)) == [(4, 3, 1000), (8, 4, 3)]
    assert chosen((4, 4, 3), (4, 3, 1000)) == [(4, 3, 1000), (4, 4, 3)]
    # as leaves of one patch with weights are
    assert chosen((4, 4, 300), (4, 3, 1000)) == [(4, 4, 1300)]


def test_few_buckets_of_many_degrees():
    kinds = [(d, 3, 10) for d in range(1, UNROLLED + 4)]
    assert len(chosen(*kinds[:UNROLLED])) == 2
    out = chosen(*kinds)
    assert len(out) == 2 and out[-1][0] is None


def test_a_bucket_has_to_save_something():
    # raising one net of a thousand costs next to nothing
    assert chosen((4, 3, 1), (6, 3, 1000)) == [(6, 3, 1001)]


def test_no_nets():
    assert chosen((4, 3, 0)) == [(1, 3, 0)]


# ---------------------------------------------------------------- nets of leaves


def values(nets: np.ndarray, u: float, v: float) -> np.ndarray:
    i, j = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))[:, :2].T
    return np.einsum("k,lkc->lc", u**i * v**j, nets)


def test_nets_of_each_degree():
    rng = np.random.default_rng(0)
    arrays = [rng.normal(size=(k, bernstein.size(n), 4)) for n, k in ((3, 2), (1, 1), (5, 3))]
    nets = Nets.join([Nets.of(a) for a in arrays])
    assert len(nets) == 6 and nets.degree.tolist() == [3, 3, 1, 5, 5, 5]
    at = np.concatenate([values(a, 0.3, 0.2) for a in arrays])
    np.testing.assert_allclose(values(nets.padded(), 0.3, 0.2), at, atol=1e-13)
    np.testing.assert_allclose(values(nets.padded(7), 0.3, 0.2), at, atol=1e-13)
    some = nets[np.array([5, 2, 0])]
    np.testing.assert_allclose(values(some.padded(), 0.3, 0.2), at[[5, 2, 0]], atol=1e-13)
    np.testing.assert_array_equal(nets[nets.degree == 3].padded(), arrays[0])
    assert len(nets[np.zeros(6, dtype=bool)]) == 0


def test_weights_of_nets():
    nets = np.zeros((3, 6, 4))
    nets[1, 2, 3] = 1e-9
    assert Nets.of(nets).are_weighted().tolist() == [False, True, False]
    assert Nets.zeros(0).are_weighted().tolist() == []
