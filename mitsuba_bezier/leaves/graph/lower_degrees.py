"""Nets of leaves of high degree, at the least degree that is as exact as float32 holds them.

A leaf is a small part of its patch, on which terms of high degree have all but vanished. The
polynomial of degree `m` that is nearest, in the square mean over a triangle, has the Bernstein
coefficients that are nearest as vectors (Lutterkort, Peters and Reif, "Polynomial degree reduction
in the L2-norm equals best Euclidean approximation of Bezier coefficients", 1999). So one
orthonormal basis of all nets of degree `n`, in which those of degree 0, 1, ... come first, tells
what each degree leaves over.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...geometry import bernstein
from ..nets import Nets
from .cover import by_size, to_triangle

__all__ = ["HIGH", "TOLERANCE", "allowed", "lowered"]

#: Nets of a higher degree are lowered: those that are read row by row, so that each row counts.
#: Others gain nothing: of the teapot's rays 99 in 100 meet leaves that need its degree, 6.
HIGH = 8
#: What values may be off by: a tenth of a rounding of float32 of a number near one, as leaves are.
TOLERANCE = 0.1 * 2.0**-24


def allowed(n: int) -> float:
    """Return what coefficients of degree `n` that are left out may add up to."""
    return min(1.0, 10 / (2 * n)) * TOLERANCE


def lowered(net: np.ndarray, size: np.ndarray) -> Nets:
    """Return the monomial nets of Bernstein nets ``(L, K, 4)``, each of as low a degree as will do.

    The nearest are taken over the parameter triangles `T` on which bounds of leaves hold, from
    where a march may evaluate them. There values are off by at most `TOLERANCE`, and partials by
    ten times as much. For if what is left over has the Euclidean length `e`, its coefficients are
    at most `e`, and so are its values; partials are nets of differences of two, times `n`.

    Parameters
    ----------
    net : (L, K, 4) array
    size : (L,) int array
        The triangles, of `SIZES`.
    """
    n = bernstein.degree_of(net.shape[1])
    most = allowed(n)
    parts, places = [Nets.zeros(0)], [np.zeros(0, dtype=int)]
    for rows, s in by_size(np.arange(len(net)), size):
        over_t = to_triangle(n, s) @ net[rows]
        squares = (_graded_basis(n) @ over_t) ** 2
        # what is left over from each row on, of the component that has the most
        left = np.cumsum(squares[:, ::-1], axis=1)[:, ::-1].max(axis=2)
        least = np.full(len(rows), n)
        for m in range(n - 1, 0, -1):
            least[(least == m + 1) & (left[:, bernstein.size(m)] <= most**2)] = m
        for m in np.unique(least).tolist():
            those = least == m
            if m < n:
                parts.append(Nets.of(_to_monomials(n, m, s) @ over_t[those]))
            else:
                parts.append(Nets.of(bernstein.monomial_matrix(n) @ net[rows[those]]))
            places.append(rows[those])
    return Nets.join(parts)[np.argsort(np.concatenate(places))]


@cache
def _graded_basis(n: int) -> np.ndarray:
    """Return an orthonormal basis of nets of degree `n`, in rows, those of low degree first."""
    rows = np.zeros((0, bernstein.size(n)))
    for m in range(n + 1):
        up = bernstein.elevation_matrix(m, n)
        for _ in range(2):  # again, for the last digits
            up = up - rows.T @ (rows @ up)
        rows = np.concatenate([rows, np.linalg.svd(up)[0][:, : m + 1].T])
    return rows


@cache
def _to_monomials(n: int, m: int, size: int) -> np.ndarray:
    """Return the matrix from nets of degree `n` over `T` to the nearest monomials of degree `m`."""
    nearest = np.linalg.pinv(bernstein.elevation_matrix(m, n))
    return bernstein.monomial_matrix(m) @ np.linalg.solve(to_triangle(m, size), nearest)
