"""Plane triangles with rational curves for sides, and where they fold."""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from ...geometry import bernstein

__all__ = ["curved_triangle", "jacobian_ratio"]


def _elevate(curve: np.ndarray, n: int) -> np.ndarray:
    while len(curve) - 1 < n:
        m = len(curve)
        t = np.arange(m + 1)[:, None] / m
        padded = np.concatenate([curve[:1], curve, curve[-1:]])
        curve = t * padded[:-1] + (1 - t) * padded[1:]
    return curve


def _chord(curve: np.ndarray) -> np.ndarray:
    t = np.linspace(0, 1, len(curve))[:, None]
    return (1 - t) * curve[0] + t * curve[-1]


@cache
def _fade_matrix(n: int) -> np.ndarray:
    """Return the matrix ``(K, n+1)`` from a side's deviation to the net of the triangle.

    The side runs from corner A to B and its deviation is ``t (1-t) q(t)``; in the triangle it
    becomes ``u v q(v + w/2)``, which equals it where ``w = 0`` and vanishes on the other sides.
    """
    out = np.zeros((bernstein.size(n), n + 1))
    for i, j, k in bernstein.multi_indices(n - 2).tolist() if n >= 2 else ():
        scale = (i + 1) * (j + 1) / (n * (n - 1))
        for a in range(k + 1):  # blossom of q at 0 (i times), 1 (j times), 1/2 (k times)
            m = j + a + 1
            q = n * (n - 1) / (m * (n - m))
            out[bernstein.row(n, i + 1, j + 1), m] += scale * q * comb(k, a) / 2**k
    return out


def curved_triangle(corners: np.ndarray, sides: list[np.ndarray | None]) -> np.ndarray:
    """Return the net of a plane triangle with curved sides.

    Parameters
    ----------
    corners : (3, 2) array
        Euclidean corners A, B, C.
    sides : list of 3
        The sides AB, BC, CA as homogeneous Bézier curves ``(n+1, 3)`` with end weights 1, None
        for straight ones.

    Returns
    -------
    (K, 3) array
        Homogeneous ``(w x, w y, w)``, of the highest degree among the sides.
    """
    n = max([1, *(len(s) - 1 for s in sides if s is not None)])
    flat = np.concatenate([corners, np.ones((3, 1))], axis=1)
    net = bernstein.multi_indices(n) @ flat / n
    for e, side in enumerate(sides):
        if side is None:
            continue
        curve = _elevate(side, n)
        deviation = curve - _chord(curve)
        # the fade is written for the side AB: the renaming that makes side e that one
        order = [(0, 1, 2), (2, 0, 1), (1, 2, 0)][e]
        net = net + (_fade_matrix(n) @ deviation)[bernstein.permutation(n, order)]
    return net


@cache
def _samples(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    m = 3 * n + 3
    uv = bernstein.multi_indices(m)[:, :2] / m
    du, dv = bernstein.partials_matrices(n)
    lower = bernstein.basis(n - 1, uv)
    return bernstein.basis(n, uv), lower @ du, lower @ dv


def jacobian_ratio(net: np.ndarray) -> float:
    """Return the smallest Jacobian of a plane net ``(K, 3)``, relative to its flat triangle.

    Sampled at a lattice finer than the degree of the Jacobian's numerator, ``3 n - 3``.
    """
    n = bernstein.degree_of(len(net))
    value, du, dv = (b @ net for b in _samples(n))
    if value[:, 2].min() <= 0:
        return -1.0
    numerator = np.linalg.det(np.stack([du, dv, value], axis=1)) / value[:, 2] ** 3
    corners = net[list(bernstein.corner_rows(n))]
    corners = corners[:, :2] / corners[:, 2:]
    area = np.linalg.det(corners[:2] - corners[2])
    if area <= 0:
        return -1.0
    return float(numerator.min() / area)
