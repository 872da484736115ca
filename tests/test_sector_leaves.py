"""Sectors of cones and disks in closed form, against the float64 reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from drjit.llvm import Float

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.geometry.leaf_builder import build_leaves
from mitsuba_bezier.geometry.leaves import SECTION, LeafSettings, Leaves
from mitsuba_bezier.geometry.reference import first_hit
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import Hit, intersect

RNG = np.random.default_rng(21)
TURN = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
#: Takes the plane z = -3 to infinity, and circles to other conics.
IMAGE = np.array([[1.0, 0.2, 0, 0.1], [0, 1.3, 0.3, 0], [0.1, 0, 0.8, 0.2], [0, 0.1, 0.3, 0.9]])


def turned(patches: mb.BezierTriangles, order: tuple[int, ...]) -> mb.BezierTriangles:
    """Return patches with their corners in another order."""
    ijk = bernstein.multi_indices(patches.degree)[:, list(order)]
    rows = [bernstein.row(patches.degree, i, j) for i, j, _k in ijk.tolist()]
    return mb.BezierTriangles(patches.control_points[:, rows])


def moved(patches: mb.BezierTriangles) -> mb.BezierTriangles:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN * [1, 2, 0.7], [0.3, -0.5, 0.8]
    return patches.transform(matrix)


SURFACES = {
    "cone": shapes.cone(),
    "disk": shapes.disk(),
    "capped cone": shapes.cone(capped=True),
    "capped cylinder": shapes.cylinder(capped=True),
    "moved": moved(shapes.cone(capped=True)),
    "image": shapes.cone(capped=True).transform(IMAGE),
    "negative weights": mb.BezierTriangles(-shapes.cone(capped=True).control_points),
    "as tensors are": mb.BezierTriangles(
        moved(shapes.cone(capped=True)).control_points.astype(np.float32)
    ),
    **{f"corners {o}": turned(shapes.cone(capped=True), o) for o in permutations(range(3))},
}


def columns(*arrays: np.ndarray) -> list[Any]:
    return [[Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in arrays]


def rays(patches: mb.BezierTriangles, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays at points of patches, near their edges too, and at some beside them."""
    rng = np.random.default_rng(1)
    box = patches.bounds()
    middle, size = box.mean(axis=(0, 1)), np.ptp(box, axis=(0, 1)).max()
    uv = rng.dirichlet([0.5, 0.5, 0.5], count)[:, :2]
    target = patches.points(rng.integers(0, len(patches), count), uv)
    target[::4] += rng.normal(scale=0.2 * size, size=target[::4].shape)
    o = middle + 2 * size * rng.normal(size=(count, 3))
    return o.astype(np.float32), (target - o).astype(np.float32)


def traced(leaves: Leaves, o: np.ndarray, d: np.ndarray, **options: Any) -> Hit:
    return intersect(build_structure(leaves, Float), *columns(o, d), Float(np.inf), **options)


@pytest.mark.parametrize("patches", SURFACES.values(), ids=SURFACES.keys())
def test_hits(patches):
    leaves = build_leaves(patches)
    assert leaves.exact.all() and len(leaves) == len(patches)
    o, d = rays(patches, 1000)
    expected = first_hit(patches, o, d)
    # ten roundings of float32; an edge's tolerance is of that size, too
    judged = expected.margin.decidable(6e-7) & ~(expected.margin.cosine < 0.01)
    assert judged.mean() > 0.6
    hit = traced(leaves, o, d)
    t, valid = np.array(hit.t, dtype=float), np.array(hit.valid)
    assert (valid == np.isfinite(expected.t))[judged].all()
    both = valid & judged
    assert 0.3 < both.mean() < judged.mean()
    assert np.array_equal(np.array(hit.patch)[both], expected.patch[both])
    # t is rounded to float32, and the quadric of float32 nets is off by as much
    off = np.abs(t[both] / expected.t[both] - 1) * expected.margin.cosine[both]
    assert off.max() < 3e-7
    uv = np.stack([np.array(hit.u), np.array(hit.v)], axis=1).astype(float)
    p = patches.points(np.array(hit.patch)[both], uv[both])
    off = np.linalg.norm(p - (o + t[:, None] * d)[both], axis=1)
    assert off.max() < 1e-6 * np.linalg.norm(o, axis=1).max()
    found = traced(leaves, o, d, any_hit=True)
    assert (np.array(found.valid) == valid).all()


@pytest.mark.parametrize("single", [False, True], ids=["float64", "float32"])
def test_next_to_the_apex(single):
    # also at the other nappe, which is not on the patch
    rng = np.random.default_rng(2)
    depth, turn = 10 ** rng.uniform(-6, 0, 1500), rng.random(1500) * 2 * np.pi
    target = np.stack([depth * np.cos(turn), depth * np.sin(turn), 1 - depth], axis=1)
    target[::2, 2] = 2 - target[::2, 2]
    o = target + rng.normal(size=target.shape)
    cone = shapes.cone()
    if single:
        o, target = (x @ TURN.T + [0.1, 0.2, 0.3] for x in (o, target))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = TURN, [0.1, 0.2, 0.3]
        cone = mb.BezierTriangles(cone.transform(matrix).control_points.astype(np.float32))
    apex = cone.control_points[0, -1, :3]
    o = o.astype(np.float32)
    d = (target - o).astype(np.float32)
    leaves = build_leaves(cone)
    assert leaves.exact.all() and len(np.unique(leaves.group)) == 1
    expected = first_hit(cone, o, d)
    t = np.array(traced(leaves, o, d).t, dtype=float)
    judged = expected.margin.decidable(6e-7) & ~(expected.margin.cosine < 0.01)
    # an edge's tolerance: the tip of the other nappe belongs to the patch
    ours = o + np.where(np.isfinite(t), t, 0)[:, None] * d
    judged &= np.linalg.norm(ours - apex, axis=1) > 5e-6
    assert judged.mean() > 0.5
    assert (np.isfinite(t) == np.isfinite(expected.t))[judged].all()
    both = np.isfinite(t) & judged
    # float32 nets are off the one cone by 6e-8, here over a cosine
    off = np.abs(t[both] - expected.t[both]) * np.minimum(1, expected.margin.cosine[both])
    assert off.max() < 5e-7 and both.sum() > 250


def test_nothing_leaks_through_edges():
    capped = shapes.cone(capped=True)
    rng = np.random.default_rng(3)
    count = 200_000
    z = rng.uniform(0.02, 0.98, count)
    a, r = rng.random(count) * 2 * np.pi, 0.98 * (1 - z) * np.sqrt(rng.random(count))
    o = np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)
    s = rng.random(count)
    uv = np.stack([s, 1 - s, 0 * s], axis=1)
    uv = uv[np.arange(count)[:, None], (np.arange(3) + rng.integers(0, 3, (count, 1))) % 3]
    target = capped.points(rng.integers(0, 6, count), uv[:, :2])
    o, d = o.astype(np.float32), (target - o).astype(np.float32)
    assert np.array(traced(build_leaves(capped), o, d).valid).all()


def test_among_others():
    # cones, disks, planes, a quadric and what is none of these; all under one tree
    parts = [
        shapes.cone(capped=True),
        mb.sphere(center=(30, 0, 0)),
        mb.sphere(center=(-30, 0, 0), cover="tetrahedral"),
        mb.torus(center=(0, 40, 0)),
        shapes.disk(center=(0, -30, 0)),
    ]
    first = np.cumsum([0, *(len(p) for p in parts)])
    leaves = [build_leaves(p) for p in parts]
    leaves = [replace(x, patch=x.patch + k) for x, k in zip(leaves, first.tolist())]
    structure = build_structure(Leaves.join(leaves), Float)
    assert structure.has_cones and structure.has_disks and structure.has_sections
    for part, begin in zip(parts, first.tolist()):
        o, d = rays(part, 3000)
        # from near by, where nothing else is in front
        o = (o + d * 0.9).astype(np.float32)
        d = (0.1 * d).astype(np.float32)
        alone = traced(build_leaves(part), o, d)
        hit = intersect(structure, *columns(o, d), Float(2.0))
        near = np.array(alone.t) < 1.9
        assert near.mean() > 0.3
        np.testing.assert_allclose(np.array(hit.t)[near], np.array(alone.t)[near], atol=3e-5)
        assert np.array_equal(np.array(hit.patch)[near], np.array(alone.patch)[near] + begin)
        for x, y in ((hit.u, alone.u), (hit.v, alone.v)):
            np.testing.assert_allclose(np.array(x)[near], np.array(y)[near], atol=1e-4)


def test_elevated_and_not_quite():
    cone, disk = shapes.cone(), shapes.disk()
    for patches in (cone.elevate(), disk.elevate(2)):
        assert build_leaves(patches).exact.all()
    # trims ask for the parameters of every root
    assert not build_leaves(cone, LeafSettings(sections=False)).exact.any()
    for patches, rows in ((cone, (2, 4, 5)), (disk, (2, 4))):
        for row in rows:
            net = patches.control_points.copy()
            net[0, row, 0] += 1e-5
            mark = build_leaves(mb.BezierTriangles(net))
            assert not mark.exact[mark.patch == 0].any()
    # a point of the arc may be anywhere
    net = cone.control_points.copy()
    net[0, 1] += [0.1, 0.2, 0.1, 0.3]
    assert build_leaves(mb.BezierTriangles(net)).form[:, SECTION].tolist() == [-3.0] * 3
