"""Tensor-product patches after maps of their parameter plane, as Bézier triangles."""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from ...geometry import bernstein

__all__ = ["compose"]


@cache
def _multinomials(n: int) -> np.ndarray:
    return np.array([comb(n, i) * comb(n - i, j) for i, j, _k in bernstein.multi_indices(n)])


@cache
def _product_rows(n: int, m: int) -> np.ndarray:
    """Return the row of the product of monomials, ``(K_n K_m,)``."""
    index = bernstein.multi_indices(n)[:, None] + bernstein.multi_indices(m)[None]
    level = n + m - index[..., 0]
    return (level * (level + 1) // 2 + level - index[..., 1]).ravel()


def _multiply(f: np.ndarray, n: int, g: np.ndarray, m: int) -> np.ndarray:
    """Multiply homogeneous polynomials in (u, v, w), given by their plain coefficients."""
    rows = _product_rows(n, m)
    return np.bincount(rows, weights=np.outer(f, g).ravel(), minlength=bernstein.size(n + m))


def _powers(f: np.ndarray, g: np.ndarray, n: int, p: int) -> np.ndarray:
    """Return ``C(p, i) f^i g^(p-i)`` for i = 0 .. p, polynomials of degree ``n p``."""
    up, down = [np.ones(1)], [np.ones(1)]
    for k in range(p):
        up.append(_multiply(up[-1], n * k, f, n))
        down.append(_multiply(down[-1], n * k, g, n))
    return np.array(
        [comb(p, i) * _multiply(up[i], n * i, down[p - i], n * (p - i)) for i in range(p + 1)]
    )


def compose(patch: np.ndarray, domain: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Return a tensor-product patch restricted to a triangle of its parameter plane.

    Parameters
    ----------
    patch : (p+1, q+1, 4) array
        Homogeneous control points.
    domain : (2, 2) array
        ``[[u0, u1], [v0, v1]]`` of the patch.
    triangle : (K, 3) array
        Net of degree n of homogeneous parameters ``(w u, w v, w)``.

    Returns
    -------
    (K', 4) array
        Net of degree ``n (p + q)``.
    """
    p, q = patch.shape[0] - 1, patch.shape[1] - 1
    n = bernstein.degree_of(len(triangle))
    plain = triangle * _multinomials(n)[:, None]
    along = []
    for axis, degree in ((0, p), (1, q)):
        low, high = domain[axis]
        s = (plain[:, axis] - low * plain[:, 2]) / (high - low)
        along.append(_powers(s, plain[:, 2] - s, n, degree))
    first = np.einsum("ik,ijc->jck", along[0], patch)
    out = np.zeros((bernstein.size(n * (p + q)), 4))
    for j in range(q + 1):
        for c in range(4):
            out[:, c] += _multiply(first[j, c], n * p, along[1][j], n * q)
    out /= _multinomials(n * (p + q))[:, None]
    if (triangle[:, 2] == triangle[0, 2]).all() and (patch[..., 3] == patch[0, 0, 3]).all():
        out[:, 3] = patch[0, 0, 3] * triangle[0, 2] ** (p + q)  # without rounding
    return out
