"""Leaves met one by one, as Mitsuba 3.10 will ask, against the walk of the tree."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from drjit import llvm
from geometry_cases import rotation
from leaf_cases import columns, rays

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.trim_cells import trim_cells
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.kernels.one_leaf import leaf_bounds, leaf_count, meet_leaf, upload_bounds
from mitsuba_bezier.kernels.structure import Structure, build_structure
from mitsuba_bezier.kernels.traverse import Hit, intersect
from mitsuba_bezier.kernels.trim_table import build_table
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafSettings


def wavy(degree: int, count: int, ratio: float = 1.0) -> mb.BezierTriangles:
    """Return patches over the triangle, bent at random, with weights from `ratio` to 1."""
    rng = np.random.default_rng(degree)
    ijk = bernstein.multi_indices(degree)
    net = np.zeros((count, len(ijk), 4))
    net[..., :2] = ijk[:, :2] / degree
    net[..., 2] = rng.uniform(-0.3, 0.3, net.shape[:2]) + np.arange(count)[:, None]
    weight = rng.uniform(ratio, 1.0, net.shape[:2])
    net[..., :3] *= weight[..., None]
    net[..., 3] = weight
    return mb.BezierTriangles(net)


def far() -> mb.BezierTriangles:
    """Return a bent patch that runs to infinity at a corner."""
    net = wavy(3, 1, 0.5).control_points.copy()
    net[:, 0, 3] = 0.0
    return mb.BezierTriangles(net)


TURN = np.eye(4)
TURN[:3, :3] = rotation(np.random.default_rng(4), 3)
ONE = LeafSettings(closed_form=False)
KINDS: dict[str, tuple[mb.BezierTriangles, Any]] = {
    "polynomial graphs": (wavy(3, 3), None),
    "rational graphs": (wavy(4, 2, 0.4), None),
    "graphs to infinity": (far(), None),
    "plane": (mb.plane(), None),
    "one quadric": (mb.sphere(cover="tetrahedral").transform(TURN), None),
    "octants": (mb.sphere().transform(TURN), None),
    "sectors of a cone": (mb.cone().transform(TURN), None),
    "torus": (mb.torus(), None),
    "graphs of quadrics": (mb.sphere(cover="tetrahedral"), ONE),
    "all at once": (
        mb.BezierTriangles.join(
            [mb.sphere(), mb.cone().transform(TURN), wavy(3, 2), wavy(3, 1, 0.5), far(), mb.torus()]
        ),
        None,
    ),
}


def one_by_one(s: Structure, o: Any, d: Any, any_hit: bool = False) -> Hit:
    """Meet all leaves with all rays, in one recorded loop over their numbers."""

    def body(k, t, valid, patch, u, v):
        hit = meet_leaf(s, k, o, d, t, True, any_hit)
        near = hit.valid
        return (
            k + 1,
            t if any_hit else dr.select(near, hit.t, t),
            valid | near,
            dr.select(near, hit.patch, patch),
            dr.select(near, hit.u, u),
            dr.select(near, hit.v, v),
        )

    real = type(o[0])
    count, whole = dr.width(o[0]), dr.uint32_array_t(real)
    state = (
        dr.zeros(whole, count),
        dr.full(real, np.inf, count),
        dr.zeros(dr.mask_t(real), count),
        dr.zeros(whole, count),
        dr.zeros(real, count),
        dr.zeros(real, count),
    )
    many = leaf_count(s)
    _k, t, valid, patch, u, v = dr.while_loop(
        state, cond=lambda k, *_: k < many, body=body, mode="symbolic"
    )
    return Hit(valid, t, patch, u, v)


def assert_equal(alone: Hit, tree: Hit) -> None:
    valid = np.array(tree.valid)
    assert 0.2 < valid.mean() < 1
    np.testing.assert_array_equal(np.array(alone.valid), valid)
    t, want = np.array(alone.t)[valid], np.array(tree.t)[valid]
    # Marches begin with what is known of the nearest hit so far, which the order of leaves decides:
    # they end within a few roundings of each other.
    np.testing.assert_allclose(t, want, rtol=1e-6)
    same = np.array(alone.patch)[valid] == np.array(tree.patch)[valid]
    assert same.mean() > 0.999  # at a common edge it may be the neighbour
    for x, y in ((alone.u, tree.u), (alone.v, tree.v)):
        np.testing.assert_allclose(np.array(x)[valid][same], np.array(y)[valid][same], atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_all_leaves_one_by_one_are_the_tree(kind):
    patches, settings = KINDS[kind]
    leaves = build_leaves(patches, settings) if settings else build_leaves(patches)
    s = build_structure(leaves, llvm.Float)
    ray = columns(*rays(near(patches), 600))
    assert_equal(one_by_one(s, *ray), intersect(s, *ray, llvm.Float(np.inf)))
    any_hit = one_by_one(s, *ray, any_hit=True)
    assert (np.array(any_hit.valid) == np.array(one_by_one(s, *ray).valid)).all()


def near(patches: mb.BezierTriangles) -> mb.BezierTriangles:
    """Return what rays are aimed at: the parts of patches that do not run to infinity."""
    finite = (np.abs(patches.control_points[..., 3]) > 1e-9).all(axis=1)
    return patches[finite] if finite.any() else wavy(3, 1, 0.5)


def test_float64():
    patches = mb.BezierTriangles.join([mb.sphere(), wavy(3, 2)])
    s = build_structure(build_leaves(patches), llvm.Float64)
    ray = [[llvm.Float64(x) for x in v] for v in columns(*rays(patches, 300))]
    assert_equal(one_by_one(s, *ray), intersect(s, *ray, llvm.Float64(np.inf)))


def test_trimmed_leaves():
    patches = mb.BezierTriangles.join([mb.sphere(), wavy(3, 2)])
    arc = np.array([[0.3, 0.1, 1], [0.55, 0.2, 1], [0.3, 0.5, 1]])
    region = closed_region([arc, np.array([[0.3, 0.5, 1], [0.3, 0.1, 1]])], 1e-12)
    count = len(patches)
    trims = Trims(
        [region], np.zeros(count, int), [square_map()] * count, [[[0, 0], [1, 1]]] * count
    )
    leaves = build_leaves(patches)
    cells, cell, keep = trim_cells(trims, leaves.patch, leaves.corners())
    leaves = leaves.select(keep)
    s = build_structure(leaves, llvm.Float, (build_table(cells, llvm.Float), cell[keep]))
    o, d = rays(patches, 20_000)
    all_of_it = build_structure(build_leaves(patches), llvm.Float)
    tree = intersect(s, *columns(o, d), llvm.Float(np.inf))
    met = np.array(intersect(all_of_it, *columns(o, d), llvm.Float(np.inf)).valid)
    kept = met & (np.array(tree.valid) | (np.arange(len(met)) % 9 == 0))
    assert 0.02 < np.array(tree.valid).mean() < 0.7 * met.mean()  # the trims take most away
    ray = columns(o[kept], d[kept])
    assert_equal(one_by_one(s, *ray), intersect(s, *ray, llvm.Float(np.inf)))


@pytest.mark.parametrize("kind", KINDS)
def test_hits_are_in_the_boxes_of_their_leaves(kind):
    patches, settings = KINDS[kind]
    leaves = build_leaves(patches, settings) if settings else build_leaves(patches)
    s, bounds = build_structure(leaves, llvm.Float), upload_bounds(leaves, llvm.Float)
    many, (o, d) = leaf_count(s), rays(near(patches), 200)
    assert dr.width(bounds) == 6 * many
    # every leaf with every ray, by arrays of numbers
    leaf = np.repeat(np.arange(many), len(o)).astype(np.uint32)
    rays_of_all = columns(np.tile(o, (many, 1)), np.tile(d, (many, 1)))
    number = llvm.UInt(leaf)
    hit = meet_leaf(s, number, *rays_of_all, llvm.Float(np.inf))
    low, high = leaf_bounds(bounds, number, hit.valid)
    valid, t = np.array(hit.valid), np.array(hit.t, dtype=float)[:, None]
    assert valid.any()
    p = np.array(rays_of_all[0]).T + t * np.array(rays_of_all[1]).T
    # t is rounded: six roundings of the distance, and the edges' tolerance (1e-6 of a leaf)
    slack = 2e-6 * (1 + np.abs(p) + t * np.linalg.norm(np.array(rays_of_all[1]).T, axis=1)[:, None])
    inside = (p >= np.array(low).T - slack) & (p <= np.array(high).T + slack)
    assert inside[valid].all()


def test_numbers_beyond_the_last_are_misses():
    s = build_structure(build_leaves(mb.sphere()), llvm.Float)
    ray = columns(*rays(mb.sphere(), 100))
    assert not np.array(meet_leaf(s, leaf_count(s), *ray, llvm.Float(np.inf)).valid).any()
    active = llvm.Bool(False)
    assert not np.array(meet_leaf(s, 0, *ray, llvm.Float(np.inf), active).valid).any()
