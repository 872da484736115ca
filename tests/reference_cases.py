"""Patches and rays for the tests of the reference intersector."""

from __future__ import annotations

import numpy as np

from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = ["rays", "rays_through", "wavy"]


def wavy(
    rng: np.random.Generator, n: int, patches: int = 4, signs: bool = False, vectors: int = 0
) -> BezierTriangles:
    """Return random patches over one triangle, weights 0.3 to 3.

    `signs` turns a fifth of the weights negative; `vectors` control points move to infinity.
    """
    k = bernstein.size(n)
    net = np.ones((patches, k, 4))
    net[..., :2] = bernstein.multi_indices(n)[:, :2] * 2 / n - 2 / 3
    net[..., 2] = 0
    net[..., :3] += rng.normal(size=(patches, k, 3)) * 0.35 / np.sqrt(n)
    weights = np.exp(rng.uniform(np.log(0.3), np.log(3), (patches, k)))
    if signs:
        weights *= rng.choice([1, -1], (patches, k), p=[0.8, 0.2])
    net *= weights[..., None]
    for p in range(patches):
        net[p, rng.choice(k, vectors, replace=False), 3] = 0
    return BezierTriangles(net)


def rays(
    rng: np.random.Generator, count: int, distance: float = 2.5, ball: float = 1.2
) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from a sphere to points of a ball, directions not of length 1."""
    o = rng.normal(size=(count, 3))
    o *= distance / np.linalg.norm(o, axis=1)[:, None]
    target = rng.normal(size=(count, 3))
    target *= (ball * rng.uniform(0, 1, count) ** (1 / 3) / np.linalg.norm(target, axis=1))[:, None]
    return o, (target - o) * rng.uniform(0.3, 3, (count, 1))


def rays_through(
    rng: np.random.Generator, nets: BezierTriangles, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return ``o, d, patch, uv, t`` with ``o + t d`` the point of the patch at `uv`."""
    patch = rng.integers(0, len(nets), count)
    uv = rng.dirichlet([1, 1, 1], count)[:, :2]
    x = nets.points(patch, uv)
    d = rng.normal(size=(count, 3))
    t = rng.uniform(-3, 3, count)
    good = np.linalg.norm(x, axis=1) < 100  # not too near infinity
    return (x - t[:, None] * d)[good], d[good], patch[good], uv[good], t[good]
