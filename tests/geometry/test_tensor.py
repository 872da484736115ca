"""Tensor-product patches split into triangles."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import NetError
from mitsuba_bezier.geometry.tensor import evaluate_tensor, revolved, tensor_to_triangles

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


@pytest.mark.parametrize("segments", [3, 4, 7])
def test_revolution(segments):
    # a rational profile, from the axis on
    profile = np.array([[0.0, -1, 1], [0.6, -0.5, 0.8], [1, 1, 1]])
    nets = revolved(profile, segments)
    assert nets.shape == (segments, 3, 3, 4)
    t = np.linspace(0, 1, 5)
    st = np.array([(s, x) for s in (0, 0.3, 0.8, 1) for x in t])
    basis = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=1)
    r, z, w = (basis @ profile).T
    for net in nets:
        x = evaluate_tensor(net, st)
        p = (x[:, :3] / x[:, 3:]).reshape(4, 5, 3)
        # rounding of float64
        assert np.abs(np.hypot(p[..., 0], p[..., 1]) - r / w).max() < 1e-15
        assert np.abs(p[..., 2] - z / w).max() < 1e-15
    # one goes on where the one before ends, and the last where the first begins
    assert np.abs(nets[:, 2] - np.roll(nets, -1, axis=0)[:, 0]).max() < 1e-15
    normals = tensor_to_triangles(nets).normals(0, [[1 / 3, 1 / 3]])
    assert normals[0, 2] < 0  # outwards, below


def test_revolution_errors():
    for profile in (np.zeros((3, 4)), np.zeros((1, 3)), [[0, 0, np.nan], [1, 0, 1]]):
        with pytest.raises(NetError, match="profile: expected"):
            revolved(profile)
    with pytest.raises(NetError, match="segments: expected an integer of at least 3, got 2"):
        revolved([[1, 0, 1], [1, 1, 1]], 2)


def test_evaluation_errors():
    with pytest.raises(NetError, match="net: expected one net"):
        evaluate_tensor(np.ones((2, 2, 2, 4)), [0.5, 0.5])
    with pytest.raises(NetError, match="st: expected"):
        evaluate_tensor(np.ones((2, 2, 4)), [0.5, 0.5, 0.5])
