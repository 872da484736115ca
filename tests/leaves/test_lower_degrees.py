"""Nets of leaves of high degree at a lower one: how far off, and that rays meet what they did."""

from __future__ import annotations

from math import perm

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.graph import subdivision
from mitsuba_bezier.leaves.graph.lower_degrees import HIGH, TOLERANCE, lowered
from mitsuba_bezier.leaves.nets import Nets
from mitsuba_bezier.leaves.records import SIZES, LeafSettings

GENERAL = LeafSettings(closed_form=False)


def smooth(n: int, decay: float, count: int = 5) -> np.ndarray:
    """Nets of four random polynomials, the coefficients of `u^a v^b` of size ``decay^(a + b)``."""
    rng = np.random.default_rng(n)
    powers = bernstein.multi_indices(n)[:, :2].sum(axis=1)
    monomials = rng.normal(size=(count, bernstein.size(n), 4)) * decay ** powers[:, None]
    return from_monomials(n) @ monomials


def from_monomials(n: int) -> np.ndarray:
    """The matrix from monomial coefficients to Bernstein ones: products of falling factorials."""
    return np.array(
        [
            [perm(i, a) * perm(j, b) / perm(n, a + b) for a, b, _c in bernstein.multi_indices(n)]
            for i, j, _k in bernstein.multi_indices(n)
        ]
    )


def jets(nets: Nets, uv: np.ndarray) -> np.ndarray:
    """Values and first partials ``(L, 3, N, 4)`` of monomial nets."""
    net = nets.padded()
    a, b = bernstein.multi_indices(bernstein.degree_of(net.shape[1]))[:, :2].T
    u, v = uv[:, :1], uv[:, 1:]
    value = u**a * v**b
    du = a * u ** np.maximum(a - 1, 0) * v**b
    dv = b * u**a * v ** np.maximum(b - 1, 0)
    return np.stack([m @ net for m in (value, du, dv)], axis=1)


@pytest.mark.parametrize("size", [0, 6, 11])
@pytest.mark.parametrize(("n", "decay"), [(9, 0.05), (9, 0.1), (14, 0.1), (16, 0.03), (20, 0.05)])
def test_values_and_partials_are_within_what_is_allowed(n, decay, size):
    net = smooth(n, decay)
    low = lowered(net, np.full(len(net), size))
    assert low.highest < n
    s = SIZES[size]
    corner = np.array([[1 + 2 * s, -s], [-s, 1 + 2 * s], [-s, -s]])  # of the triangle of bounds
    uvw = bernstein.multi_indices(24) / 24
    exact = jets(Nets.of(bernstein.monomial_matrix(n) @ net), uvw @ corner)
    off = np.abs(jets(low, uvw @ corner) - exact)
    # what float64 makes of monomials that were multiplied out
    rounding = 1e-15 * np.abs(bernstein.monomial_matrix(n)).sum(axis=1).max() * np.abs(net).max()
    assert off[:, 0].max() <= TOLERANCE + rounding
    assert off[:, 1:].max() <= 10 * TOLERANCE + n * rounding


def test_the_degree_is_the_least_that_will_do():
    n = 12
    rng = np.random.default_rng(3)
    exact = []
    for m in range(1, n + 1):
        net = rng.normal(size=(bernstein.size(m), 4))
        for k in range(m, n):
            net = bernstein.elevated(net, k)
        exact.append(net)
    assert lowered(np.array(exact), np.zeros(n, dtype=int)).degree.tolist() == list(range(1, n + 1))
    # a term below what is allowed does not count, and one above does
    powers = bernstein.multi_indices(n)[:, :2].tolist()
    monomials = np.zeros((2, bernstein.size(n), 4))
    monomials[:, powers.index([2, 1]), 2] = 0.1
    monomials[:, powers.index([3, 4]), 2] = 1e-12, 1e-3
    net = from_monomials(n) @ monomials
    low = lowered(net, np.zeros(2, dtype=int))
    assert low.degree[0] == 3 and 5 <= low.degree[1] <= 7


def test_order_and_empty_sets():
    net = np.concatenate([smooth(10, 1e-3, 2), smooth(10, 0.5, 2), smooth(10, 1e-3, 1)])
    size = np.array([3, 0, 5, 0, 3])
    together = lowered(net, size)
    for k in range(len(net)):
        alone = lowered(net[k : k + 1], size[k : k + 1])
        assert alone.degree == together.degree[k]
        np.testing.assert_allclose(alone.rows, together[[k]].rows, atol=1e-15)
    assert len(lowered(net[:0], size[:0])) == 0


def bumpy(n: int) -> mb.BezierTriangles:
    x, y, _w = bernstein.multi_indices(n).T / n
    z = 0.2 * np.sin(5 * x) * np.cos(4 * y)
    return mb.BezierTriangles(np.stack([x, y, z, 1 + 0.1 * x * y], axis=1)[None])


def test_leaves_of_high_degree_are_lowered_and_no_others(monkeypatch):
    high = build_leaves(bumpy(11), GENERAL).graph
    assert (high.nets.degree < 11).mean() > 0.5
    monkeypatch.setattr(subdivision, "HIGH", 99)
    whole = build_leaves(bumpy(11), GENERAL).graph
    np.testing.assert_array_equal(high.chart, whole.chart)
    uv = bernstein.multi_indices(6)[:, :2] / 6
    off = np.abs(jets(high.nets, uv) - jets(whole.nets, uv)).max(axis=(0, 2, 3))
    assert 0 < off[0] <= 1.01 * TOLERANCE and off[1:].max() <= 10 * TOLERANCE
    monkeypatch.undo()
    assert (build_leaves(bumpy(HIGH), GENERAL).graph.nets.degree == HIGH).all()


def test_leaves_at_infinity_keep_their_degree():
    # their marches are in float64: a tenth of a rounding of float32 is a mile at the horizon
    matrix = np.eye(4)
    matrix[3] = (1.0, 0.6, 0.1, -0.7)
    leaves = build_leaves(bumpy(10).transform(matrix), GENERAL).graph
    far = (leaves.chart[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1) & leaves.certified
    assert far.any() and (leaves.nets.degree[far] == 10).all()
