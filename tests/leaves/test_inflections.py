"""Patches whose edges have inflections: as few leaves as others, not needles along such an edge."""

from __future__ import annotations

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.leaves.builder import build_leaves


def graph(degree, height):
    """Return the patch ``z = height(x, y)`` over the unit triangle."""
    uv = bernstein.multi_indices(degree)[:, :2] / degree
    points = np.stack([*uv.T, height(*uv.T), np.ones(len(uv))], axis=1)
    return mb.BezierTriangles(np.linalg.solve(bernstein.basis(degree, uv), points)[None])


#: Heights that are bent along two edges, and have inflections along the third, y = 0; and how many
#: leaves they may have: half as many again as when this was written. Where that edge was never
#: cut there were 4000, 12 000 and 55 000.
HEIGHTS = {
    "one inflection": (110, 3, lambda x, y: 3 * y * y + 5 * x * (x - 0.5) * (x - 1)),
    # the slope is the same at both ends and in the middle
    "two inflections": (160, 4, lambda x, y: 3 * y * y + 20 * (x * (1 - x)) ** 2),
    "three": (
        930,
        5,
        lambda x, y: 3 * y * y + 100 * np.prod([x - k / 4 for k in range(5)], axis=0),
    ),
}


@pytest.mark.parametrize("name", HEIGHTS)
def test_an_edge_with_inflections_is_cut(name):
    most, degree, height = HEIGHTS[name]
    leaves = build_leaves(graph(degree, height)).graph
    assert leaves.certified.all()
    assert len(leaves) <= most


def test_a_rough_net():
    # of a height field with noise; it had 76 000 leaves, a quarter of them not certified
    heights = [250, 105, 80, 260, 241, 13, 360, 317, -28, 0]
    net = np.ones((10, 4))
    net[:, :2] = bernstein.multi_indices(3)[:, :2] / 3
    net[:, 2] = np.array(heights) / 1000
    leaves = build_leaves(mb.BezierTriangles(net[None])).graph
    assert leaves.certified.all()
    assert len(leaves) == 4
