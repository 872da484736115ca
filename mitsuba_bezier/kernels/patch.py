"""Evaluation of patches from their Bernstein nets, for surface interactions."""

from __future__ import annotations

from functools import cache
from math import factorial
from typing import Any

import numpy as np

from ..geometry import bernstein
from .arrays import reciprocal

__all__ = ["affine_partials", "bernstein_basis", "pack", "padded_width", "scaled"]


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


def scaled(nets: np.ndarray) -> np.ndarray:
    """Return nets ``(P, K, 4)`` times their multinomials, as `rolled_partials` reads them."""
    return nets * bernstein.multinomials(bernstein.degree_of(nets.shape[1]))[:, None]
