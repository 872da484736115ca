"""Nets and rays of the tests of exact leaves, and how hits are compared with the reference."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from backend_cases import Float
from geometry_cases import rotation

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.tensor import revolved, tensor_to_triangles
from mitsuba_bezier.kernels.structure import Structure, build_structure
from mitsuba_bezier.kernels.traverse import Hit, intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import Leaves
from mitsuba_bezier.oracles.reference import first_hit

TURN = rotation(np.random.default_rng(21), 3)
MOVE = np.eye(4)
MOVE[:3, :3], MOVE[:3, 3] = TURN * [1, 2, 0.7], [0.3, -0.5, 0.8]
#: Takes the plane z = -3 to infinity, and circles to other conics.
IMAGE = np.array([[1.0, 0.2, 0, 0.1], [0, 1.3, 0.3, 0], [0.1, 0, 0.8, 0.2], [0, 0.1, 0.3, 0.9]])


def turned(patches: mb.BezierTriangles, order: tuple[int, ...]) -> mb.BezierTriangles:
    """Return patches with their corners in another order."""
    ijk = bernstein.multi_indices(patches.degree)[:, list(order)]
    rows = [bernstein.row(patches.degree, i, j) for i, j, _k in ijk.tolist()]
    return mb.BezierTriangles(patches.control_points[:, rows])


def otherwise(patches: mb.BezierTriangles) -> mb.BezierTriangles:
    """Return the patches in other parameters, quadratic in the new ones, edges on edges."""
    n = 2 * patches.degree
    lattice = bernstein.multi_indices(n) / n
    twist = np.array([[1.0, 1.3, 0.8], [0.9, 1.0, 1.2], [1.25, 0.85, 1.0]])
    inner = lattice * (lattice @ twist.T)
    total = inner.sum(axis=1, keepdims=True)
    values = bernstein.basis(patches.degree, (inner / total)[:, :2]) @ patches.control_points
    values = values * total**patches.degree  # homogeneous of degree n again
    return mb.BezierTriangles(np.linalg.solve(bernstein.basis(n, lattice[:, :2]), values))


H = np.sqrt(0.5)
LOW, HIGH = [(0, -1, 1), (H, -H, H), (1, 0, 1)], [(1, 0, 1), (H, H, H), (0, 1, 1)]


def revolution(*profiles: list[tuple[float, float, float]], segments: int = 4):
    return mb.BezierTriangles.join([tensor_to_triangles(revolved(p, segments)) for p in profiles])


SPHERE = revolution(LOW, HIGH)


def moved(patches: mb.BezierTriangles) -> mb.BezierTriangles:
    return patches.transform(MOVE)


def single(patches: mb.BezierTriangles) -> mb.BezierTriangles:
    """Return patches, elsewhere and stretched, as Mitsuba's tensors have them."""
    return mb.BezierTriangles(moved(patches).control_points.astype(np.float32))


def columns(*arrays: np.ndarray) -> list[Any]:
    return [[Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in arrays]


def rays(patches: mb.BezierTriangles, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays at points of patches, near their edges too, and at some beside them."""
    rng = np.random.default_rng(1)
    box = patches.hulls()
    middle, size = box.mean(axis=(0, 1)), np.ptp(box, axis=(0, 1)).max()
    uv = rng.dirichlet([0.5, 0.5, 0.5], count)[:, :2]
    target = patches.points(rng.integers(0, len(patches), count), uv)
    target[::4] += rng.normal(scale=0.2 * size, size=target[::4].shape)
    o = middle + 2 * size * rng.normal(size=(count, 3))
    return o.astype(np.float32), (target - o).astype(np.float32)


def traced(leaves: Leaves, o: np.ndarray, d: np.ndarray, **options: Any) -> Hit:
    return intersect(build_structure(leaves, Float), *columns(o, d), Float(np.inf), **options)


def assert_hits_are_those_of_the_reference(
    patches: mb.BezierTriangles, leaves: Leaves, others: float = 0.0
) -> None:
    """Trace rays, and compare hits, parameters and any-hit queries with the reference's.

    Of the hits, `others` may be on another patch: its neighbour, at their common edge.
    """
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
    assert (np.array(hit.patch)[both] != expected.patch[both]).mean() <= others
    # t is rounded to float32, and the quadric of float32 nets is off by as much
    off = np.abs(t[both] / expected.t[both] - 1) * expected.margin.cosine[both]
    assert off.max() < 3e-7
    uv = np.stack([np.array(hit.u), np.array(hit.v)], axis=1).astype(float)
    p = patches.points(np.array(hit.patch)[both], uv[both])
    off = np.linalg.norm(p - (o + t[:, None] * d)[both], axis=1)
    assert off.max() < 1e-6 * np.linalg.norm(o, axis=1).max()
    found = traced(leaves, o, d, any_hit=True)
    assert (np.array(found.valid) == valid).all()


def assert_found_among_others(parts: list[mb.BezierTriangles], others: float = 0.0) -> Structure:
    """Trace parts under one tree, from near by, and compare with each alone; return the structure.

    Of the hits a share below `others`, or none, may be on another patch.
    """
    first = np.cumsum([0, *(len(p) for p in parts)])
    leaves = [build_leaves(p) for p in parts]
    leaves = [x.of_patches(k + np.arange(len(p))) for x, p, k in zip(leaves, parts, first.tolist())]
    structure = build_structure(Leaves.join(leaves), Float)
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
        same = np.array(hit.patch)[near] == np.array(alone.patch)[near] + begin
        assert same.all() or 1 - same.mean() < others
        for x, y in ((hit.u, alone.u), (hit.v, alone.v)):
            np.testing.assert_allclose(np.array(x)[near][same], np.array(y)[near][same], atol=1e-4)
    return structure


def rays_to_edges(
    patches: mb.BezierTriangles, radius: Callable[[np.ndarray], Any], corners: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and targets: from inside of a body of revolution to the edges of patches.

    `radius` is that at a height from 0 to 1. With `corners`, a third of the rays go to these.
    """
    rng = np.random.default_rng(3)
    count = 200_000
    z = rng.uniform(0.02, 0.98, count)
    a, r = rng.random(count) * 2 * np.pi, 0.98 * radius(z) * np.sqrt(rng.random(count))
    o = np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)
    along = rng.random(count)
    if corners:
        along[::3] = np.round(along[::3])
    uv = np.stack([along, 1 - along, 0 * along], axis=1)
    uv = uv[np.arange(count)[:, None], (np.arange(3) + rng.integers(0, 3, (count, 1))) % 3]
    return o, patches.points(rng.integers(0, len(patches), count), uv[:, :2])
