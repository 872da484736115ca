"""Leaves of different degrees in one structure, and of patches with a singular corner."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafSettings, Leaves

GENERAL = LeafSettings(closed_form=False)


def _value(leaves: Leaves, u: float, v: float) -> np.ndarray:
    powers = bernstein.multi_indices(bernstein.degree_of(leaves.graph.net.shape[1]))[:, :2]
    return np.einsum("k,lkc->lc", u ** powers[:, 0] * v ** powers[:, 1], leaves.graph.net)


def test_joined_leaves_keep_their_nets_when_degrees_differ() -> None:
    quadratic = build_leaves(shapes.disk(), GENERAL)
    quartic = build_leaves(shapes.torus())
    assert not quadratic.is_closed_form.any()
    joined = Leaves.join([quadratic, quartic])
    for u, v in ((0.2, 0.3), (0.7, 0.1), (0.0, 0.6)):
        expected = np.concatenate([_value(quadratic, u, v), _value(quartic, u, v)])
        # 1e-15: the sums have the same terms and zeros, at most in another order
        np.testing.assert_allclose(_value(joined, u, v), expected, rtol=0, atol=1e-15)


def test_a_cone_has_few_leaves() -> None:
    # away from the origin, where float32 ends the similar leaves around the apex
    cone = shapes.cone((0, 0, 0), (0.52, 0.52), 1.35)
    # 93 a level and patch down to 1e-6 of the apex' height, which is level 10: about 2800;
    # before, ten million
    assert len(build_leaves(cone, GENERAL)) < 4000


@pytest.mark.parametrize("n", [1, 2, 5, 16])
def test_nets_over_triangles_are_those_of_the_matrices(n: int) -> None:
    rng = np.random.default_rng(n)
    nets = rng.normal(size=(3, bernstein.size(n), 4))
    # more than fit into one step at degree 16
    corners = rng.normal(size=(60, 3, 3))
    expected = np.stack([bernstein.subdivision_matrix(n, c) @ nets for c in corners], axis=1)
    # sums of the same products, perhaps in another order: rounding grows with their moduli
    tolerance = bernstein.size(n) * 1e-15 * np.abs(expected).max()
    np.testing.assert_allclose(bernstein.subdivide(nets, corners), expected, atol=tolerance)


@pytest.mark.parametrize("n", [1, 3, 8, 16, 20])
def test_nets_over_triangles_have_the_points_of_the_patch(n: int) -> None:
    rng = np.random.default_rng(n)
    net = rng.normal(size=(bernstein.size(n), 4))
    corners = rng.dirichlet(np.ones(3), size=(2, 3))
    bary = rng.dirichlet(np.ones(3), size=7)
    parts = bernstein.subdivision_matrix(n, corners) @ net
    for part, triangle in zip(parts, corners):
        expected = bernstein.basis(n, (bary @ triangle)[:, :2]) @ net
        # convex combinations of numbers of size 1, n levels deep
        np.testing.assert_allclose(bernstein.basis(n, bary[:, :2]) @ part, expected, atol=n * 1e-15)
