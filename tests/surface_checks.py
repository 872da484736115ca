"""Measures of surfaces made of Bézier triangles, shared by the tests of covers and shapes."""

from __future__ import annotations

import numpy as np

from mitsuba_bezier.geometry.triangles import BezierTriangles

#: An edge is sampled here; the same parameters from either end.
_STEPS = np.array([0.0, 0.2, 0.5, 0.8, 1.0])


def parameters(rng: np.random.Generator, count: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random patch numbers ``(n,)`` and parameters ``(n, 2)`` inside the triangle."""
    return rng.integers(0, count, n), rng.dirichlet((1, 1, 1), n)[:, :2]


def implicit(a: np.ndarray, x: np.ndarray) -> float:
    """Return the largest ``|x'Ax|``, relative to the sizes of `A` and `x`."""
    value = np.abs(np.einsum("...i,ij,...j->...", x, a, x))
    return float((value / (np.linalg.norm(x, axis=-1) ** 2 * np.abs(a).max())).max())


def unpaired_edges(patches: BezierTriangles) -> list[tuple[int, int]]:
    """Return the edges ``(patch, side)`` that no other edge covers in the other direction.

    Collapsed edges are left out. Two edges pair when they agree at all samples, taken in
    opposite order, to 1e-9 of the size of the surface.
    """
    s = _STEPS
    zero = np.zeros_like(s)
    sides = [(1 - s, s), (zero, 1 - s), (s, zero)]  # A to B, B to C, C to A
    curves = []
    for p in range(len(patches)):
        for k, (u, v) in enumerate(sides):
            curves.append(((p, k), patches.points(p, np.column_stack([u, v]))))
    size = np.ptp(np.concatenate([x for _name, x in curves]), axis=0).max()
    curves = [(name, x) for name, x in curves if np.ptp(x, axis=0).max() > 1e-9 * size]
    stack = np.array([x for _name, x in curves])
    open_edges = []
    for name, x in curves:
        partners = (np.abs(stack - x[::-1]).max(axis=(1, 2)) <= 1e-9 * size).sum()
        if partners != 1:
            open_edges.append(name)
    return open_edges


def _quadrature(patches: BezierTriangles, levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points and weighted normals of a Gauss rule, on `levels` midpoint splits."""
    for _ in range(levels):
        patches = patches.split()
    nodes, gauss = np.polynomial.legendre.leggauss(8)
    nodes, gauss = (nodes + 1) / 2, gauss / 2
    s, t = np.meshgrid(nodes, nodes, indexing="ij")
    uv = np.stack([s, (1 - s) * t], axis=-1).reshape(-1, 2)
    weight = np.outer(gauss * (1 - nodes), gauss).reshape(-1)
    count = len(patches)
    d = patches.differential(np.repeat(np.arange(count), len(uv)), np.tile(uv, (count, 1)))
    return d.p, np.cross(d.dp_du, d.dp_dv) * np.tile(weight, count)[:, None]


def volume(patches: BezierTriangles, levels: int = 2) -> float:
    """Return the enclosed volume by the divergence theorem; negative if turned inwards."""
    points, normals = _quadrature(patches, levels)
    return float((points * normals).sum() / 3)


def winding(patches: BezierTriangles, point: np.ndarray, levels: int = 2) -> float:
    """Return how often a closed surface encloses a point: its solid angle over 4 pi."""
    points, normals = _quadrature(patches, levels)
    r = points - point
    return float(((r * normals).sum(axis=1) / np.linalg.norm(r, axis=1) ** 3).sum() / (4 * np.pi))
