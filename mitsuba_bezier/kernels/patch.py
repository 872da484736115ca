"""Evaluation of patches from their Bernstein nets, for surface interactions."""

from __future__ import annotations

from functools import cache
from math import factorial
from typing import Any

import drjit as dr
import numpy as np

from ..geometry import bernstein
from .arrays import gather_packets, reciprocal

__all__ = ["affine_partials", "bernstein_basis", "evaluate", "pack", "padded_width"]


def padded_width(n: int) -> int:
    """Return the floats a net of degree `n` takes in a buffer, a multiple of eight."""
    return -(-bernstein.size(n) * 4 // 8) * 8


@cache
def _multinomials(n: int) -> tuple[float, ...]:
    ijk = bernstein.multi_indices(n)
    return tuple(
        factorial(n) / (factorial(i) * factorial(j) * factorial(k)) for i, j, k in ijk.tolist()
    )


def bernstein_basis(n: int, u: Any, v: Any, w: Any) -> list[Any]:
    """Return the Bernstein polynomials of degree `n`, in net order."""
    powers = []
    for x in (u, v, w):
        p: list[Any] = [None, x]
        for _ in range(n - 1):
            p.append(p[-1] * x)
        powers.append(p)
    out = []
    for c, ijk in zip(_multinomials(n), bernstein.multi_indices(n).tolist()):
        term: Any = c
        for p, e in zip(powers, ijk):
            if e:
                term = term * p[e]
        out.append(term)
    return out


def evaluate(
    buffer: Any, n: int, patch: Any, u: Any, v: Any, active: Any = True
) -> tuple[list[Any], list[Any], list[Any]]:
    """Evaluate homogeneous points and first partials.

    The three points of the last de Casteljau step give all of it: with ``c_0, c_1, c_2`` the
    value is ``u c_0 + v c_1 + w c_2``, the partials are ``n (c_0 - c_2)`` and
    ``n (c_1 - c_2)``. Bernstein form: convex combinations, no cancellation in float32.

    Parameters
    ----------
    buffer : Float
        Nets, `padded_width` floats each.
    n : int
        Degree.
    patch : UInt
    u, v : Float
    active : Bool

    Returns
    -------
    value, d_du, d_dv : lists of 4 Float
    """
    net = gather_packets(buffer, patch, bernstein.size(n) * 4, active)
    w = 1.0 - u - v
    basis = bernstein_basis(n - 1, u, v, w)
    corner: list[list[Any]] = [[None] * 4 for _ in range(3)]
    for b, (i, j, _k) in zip(basis, bernstein.multi_indices(n - 1).tolist()):
        rows = (bernstein.row(n, i + 1, j), bernstein.row(n, i, j + 1), bernstein.row(n, i, j))
        for c, r in zip(corner, rows):
            for a in range(4):
                term = net[4 * r + a]
                c[a] = term * b if c[a] is None else dr.fma(term, b, c[a])
    c0, c1, c2 = corner
    value = [dr.fma(u, c0[a], dr.fma(v, c1[a], w * c2[a])) for a in range(4)]
    return value, [n * (c0[a] - c2[a]) for a in range(4)], [n * (c1[a] - c2[a]) for a in range(4)]


def affine_partials(value: list[Any], d_du: list[Any], d_dv: list[Any]) -> tuple[list[Any], ...]:
    """Return the affine point and its true partials (quotient rule)."""
    inv = reciprocal(value[3])
    p = [value[a] * inv for a in range(3)]
    pu = [(d_du[a] - p[a] * d_du[3]) * inv for a in range(3)]
    pv = [(d_dv[a] - p[a] * d_dv[3]) * inv for a in range(3)]
    return p, pu, pv


def pack(nets: np.ndarray) -> np.ndarray:
    """Pad nets ``(P, K, 4)`` to rows of `padded_width` floats."""
    out = np.zeros((len(nets), padded_width(bernstein.degree_of(nets.shape[1]))))
    out[:, : nets.shape[1] * 4] = nets.reshape(len(nets), -1)
    return out
