"""Parts of patches that are trimmed away as a whole are told, wherever trimming curves are cut."""

from __future__ import annotations

import numpy as np

from mitsuba_bezier.geometry.trim_cells import UntrimmedParts
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map


def trims_of(*loops):
    """Return a patch, the lower half of the unit square, trimmed by polygons."""
    curves = []
    for points in loops:
        h = [[*p, 1.0] for p in points]
        curves += [np.array([a, b]) for a, b in zip(h, h[1:] + h[:1])]
    return Trims([closed_region(curves, tolerance=0)], [0], [square_map()], [[[0, 0], [1, 1]]])


def triangles(side):
    """Return the corners ``(L, 3, 2)`` of the triangles of a grid over the unit triangle."""
    i, j = np.nonzero(np.add.outer(np.arange(side), np.arange(side)) < side)
    low = np.stack([i, j], axis=1) / side
    steps = np.array([[1, 0], [0, 1], [0, 0]]) / side
    return low[:, None] + steps


def needed(trims, corners):
    return UntrimmedParts(trims)(np.zeros(len(corners), dtype=int), corners)


def test_joints_of_curves_beside_a_part_do_not_keep_it():
    # a strip whose sides are of several pieces, as in CAD files: all to its left is gone
    heights = np.linspace(0, 0.5, 6)
    side = [(0.4 + 0.02 * t, t) for t in heights]
    back = [(0.45 + 0.02 * t, t) for t in heights[::-1]]
    trims = trims_of(side + back)
    corners = triangles(16)
    left = corners[:, :, 0].max(axis=1) < 0.35
    found = needed(trims, corners)
    assert not found[left].any()
    assert found.any()


def test_no_part_that_is_left_is_dropped():
    rng = np.random.default_rng(3)
    inner = rng.dirichlet([1, 1, 1], 60)
    for _ in range(20):
        # stars about points of the patch, some with a hole, with corners anywhere
        centre, count = rng.uniform(0.1, 0.4, 2), int(rng.integers(3, 12))
        angle = np.sort(rng.uniform(0, 2 * np.pi, count))
        ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        outer = centre + rng.uniform(0.1, 0.6, (count, 1)) * ray
        loops = [outer.tolist()]
        if rng.random() < 0.5:
            loops.append((centre + 0.5 * (outer - centre))[::-1].tolist())
        trims = trims_of(*loops)
        corners = triangles(int(rng.integers(4, 14)))
        points = np.einsum("pk,lkc->lpc", inner, corners)
        inside = trims.inside(0, points.reshape(-1, 2)).reshape(points.shape[:2]).any(axis=1)
        found = needed(trims, corners)
        assert not (inside & ~found).any()
