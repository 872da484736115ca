"""Tensor-product patches split into triangles."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import NetError
from mitsuba_bezier.geometry.tensor import evaluate_tensor, tensor_to_triangles

DEGREES = [(1, 1), (1, 2), (2, 1), (2, 2), (3, 3), (4, 1), (3, 5)]


@pytest.mark.parametrize(("p", "q"), DEGREES)
def test_triangles_are_the_patch(p, q):
    rng = np.random.default_rng(1)
    nets = rng.normal(size=(3, p + 1, q + 1, 4))
    triangles = tensor_to_triangles(nets)
    assert triangles.degree == p + q and len(triangles) == 6
    st = rng.uniform(-0.5, 1.5, (50, 2))
    for m, net in enumerate(nets):
        want = evaluate_tensor(net, st)
        # outside of [0,1]^2 the polynomials of degree 8 reach 1e3: relative to that
        scale = np.abs(want).max()
        assert np.abs(triangles.evaluate(2 * m, st) - want).max() < 1e-12 * scale
        assert np.abs(triangles.evaluate(2 * m + 1, 1 - st) - want).max() < 1e-12 * scale


def test_tensor_evaluation_by_de_casteljau():
    rng = np.random.default_rng(2)
    net = rng.normal(size=(4, 3, 4))
    for s, t in rng.uniform(0, 1, (10, 2)):
        rows = net
        while len(rows) > 1:
            rows = (1 - s) * rows[:-1] + s * rows[1:]
        row = rows[0]
        while len(row) > 1:
            row = (1 - t) * row[:-1] + t * row[1:]
        assert np.allclose(evaluate_tensor(net, [s, t]), row, rtol=0, atol=1e-14)


def test_orientation_follows_s_and_t():
    x, y = np.meshgrid([0.0, 1, 2], [0.0, 1], indexing="ij")
    net = np.stack([x, y, np.zeros_like(x), np.ones_like(x)], axis=-1)
    triangles = tensor_to_triangles(net)
    normals = triangles.normals([0, 1], [[0.3, 0.3]] * 2)
    assert np.allclose(normals, [[0, 0, 1]] * 2, atol=1e-15)
    corners = triangles.points([0, 0, 0, 1, 1, 1], [[1, 0], [0, 1], [0, 0]] * 2)[:, :2]
    assert np.allclose(corners, [[2, 0], [0, 1], [0, 0], [0, 1], [2, 0], [2, 1]], atol=1e-15)


def test_control_vectors_are_kept():
    # a quarter of a cylinder to the horizon: one row of control points is ideal
    arc = np.array([[1, 0, 0, 1], [np.sqrt(0.5)] * 2 + [0, np.sqrt(0.5)], [0, 1, 0, 1]])
    net = np.stack([arc, np.outer(arc[:, 3], [0, 0, 1, 0])])
    triangles = tensor_to_triangles(net)
    x = triangles.evaluate([0, 0, 1], [[0.5, 0.2], [1, 0], [1 / 3, 1 / 3]])
    assert np.allclose(x[:, 0] ** 2 + x[:, 1] ** 2, x[:, 3] ** 2, atol=1e-15)
    assert x[1, 3] == 0


@pytest.mark.parametrize(
    "net",
    [
        np.zeros((4, 4)),
        np.zeros((1, 3, 4)),
        np.zeros((3, 1, 4)),
        np.zeros((2, 2, 3)),
        np.zeros((0, 2, 2, 4)),
        np.full((2, 2, 4), np.nan),
        "net",
    ],
)
def test_errors(net):
    with pytest.raises(NetError, match="net: expected"):
        tensor_to_triangles(net)
    with pytest.raises(NetError, match="net: expected"):
        evaluate_tensor(net, [0.5, 0.5])


def test_evaluation_errors():
    with pytest.raises(NetError, match="net: expected one net"):
        evaluate_tensor(np.ones((2, 2, 2, 4)), [0.5, 0.5])
    with pytest.raises(NetError, match="st: expected"):
        evaluate_tensor(np.ones((2, 2, 4)), [0.5, 0.5, 0.5])
