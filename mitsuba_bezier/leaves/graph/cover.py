"""Which parameter triangle a leaf's bounds have to hold on: one whose image covers its prism.

See `leaf_bounds`, whose statement 2 is shown here.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from ...geometry import bernstein
from ..records import SIZES

__all__ = ["by_size", "covering_sizes", "edge_reach", "needed_margin", "to_triangle"]

#: A parameter triangle that reaches out by this times what the chart triangle does will do.
_STEEP = 1.15
#: ... and if not, larger ones are tried: this many in all.
_TRIES = 4
#: The edges of the parameter triangle are sampled at the ends of this many pieces.
_PIECES = 8

#: Leaves examined at a time: what fits in the cache.
_CHUNK = 512


def needed_margin(outward: np.ndarray) -> np.ndarray:
    """Return how far out of the unit triangle the kernel may look for a leaf; it clips in float32.

    Parameters
    ----------
    outward : (L, 3) array
        To where it should.
    """
    return outward + 3e-6


@cache
def _pieces(n: int) -> tuple[np.ndarray, ...]:
    """Return for each edge of the leaf the matrix to the coefficients of its eight pieces."""
    ijk = bernstein.multi_indices(n)
    halves = np.zeros((2, n + 1, n + 1))
    for i in range(n + 1):
        for a in range(i + 1):
            halves[0, i, a] = halves[1, n - i, n - a] = comb(i, a) / 2**i
    cuts = np.eye(n + 1)[None]
    for _ in range(3):
        cuts = np.concatenate([h @ c for c in cuts for h in halves]).reshape(-1, n + 1, n + 1)
    out = []
    for e in range(3):
        pick = np.eye(bernstein.size(n))[ijk[:, e] == 0]
        out.append((cuts @ pick).reshape(-1, bernstein.size(n)))
    return tuple(out)


def edge_reach(chart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bound how far the edges of leaves leave the edges of the unit triangle in the chart.

    By the coefficients of eight pieces of each edge. Where the map is one-to-one, the leaf reaches
    no further out than its edges do.

    Parameters
    ----------
    chart : (L, K, 4) array
        With positive weights.

    Returns
    -------
    out, inward : (L, 3) arrays
        At least 0: no barycentric of the leaf is below ``-out``, and each is at most ``inward`` on
        the edge where, in the unit triangle, it is zero.
    """
    n = bernstein.degree_of(chart.shape[1])
    out = np.zeros((len(chart), 3))
    inward = np.zeros((len(chart), 3))
    if not len(chart):
        return out, inward
    net = np.ascontiguousarray(chart[..., [0, 1, 3]].transpose(1, 2, 0))
    net = net.reshape(chart.shape[1], -1)
    for e, matrix in enumerate(_pieces(n)):
        x, y, w = (matrix @ net).reshape(-1, 3, len(chart)).transpose(1, 0, 2)
        inv = 1.0 / w
        x, y = x * inv, y * inv
        barycentrics = (x, y, 1 - x - y)
        for k, b in enumerate(barycentrics):
            out[:, k] = np.maximum(out[:, k], -b.min(axis=0))
        inward[:, e] = np.maximum(inward[:, e], barycentrics[e].max(axis=0))
    return out, inward


def to_triangle(n: int, size: int) -> np.ndarray:
    """Return the matrix to the coefficients on ``T``."""
    s = SIZES[size]
    return bernstein.subdivision_matrix(n, np.full((3, 3), -s) + (1 + 3 * s) * np.eye(3))


@cache
def _edge_matrices(n: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return samples, and coefficients of the second derivatives, of a net on the edges of T."""
    to_t = to_triangle(n, size)
    at = bernstein.multi_indices(_PIECES)
    ijk = bernstein.multi_indices(n)
    values = bernstein.basis(n, at[:, :2] / _PIECES) @ to_t
    bent = [np.diff(to_t[ijk[:, e] == 0], 2, axis=0) * (n * (n - 1)) for e in range(3)]
    if n == 1:
        bent = [np.zeros((1, 3))] * 3
    return np.stack([values[at[:, e] == 0] for e in range(3)]), np.stack(bent)


def _covers(chart: np.ndarray, needed: np.ndarray, n: int, size: int) -> np.ndarray:
    """Return a mask of leaves for which the edges of ``T`` do not meet ``P``.

    Each piece between two samples has to be beyond one of the edges of ``P``: ``U + m W < 0`` for a
    barycentric ``U`` and its ``m``. That is a polynomial, which is off its linear interpolation by
    at most an eighth of its second derivative.
    """
    x, y, w = chart[..., 0].T, chart[..., 1].T, chart[..., 3].T
    m = needed.T
    net = np.concatenate([x + m[0] * w, y + m[1] * w, w - x - y + m[2] * w], axis=1)
    # edge, sample, barycentric and leaf
    values, bent = (matrix @ net for matrix in _edge_matrices(n, size))
    most = np.maximum(values[:, 1:], values[:, :-1])
    most += np.abs(bent).max(axis=1, keepdims=True) / (8 * _PIECES**2)
    beyond = (most < 0).reshape(*most.shape[:2], 3, -1)
    return beyond.any(axis=2).all(axis=(0, 1))


def by_size(rows: np.ndarray, size: np.ndarray) -> list[tuple[np.ndarray, int]]:
    """Return the leaves `rows` in chunks that have the same of the sizes `size`, and which."""
    rows = rows[np.argsort(size[rows], kind="stable")]
    out = []
    for part in np.split(rows, np.flatnonzero(np.diff(size[rows])) + 1):
        for i in range(0, len(part), _CHUNK):
            out.append((part[i : i + _CHUNK], int(size[part[0]])))
    return out


def covering_sizes(
    chart: np.ndarray, needed: np.ndarray, inward: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the smallest triangles ``T`` that will do.

    Parameters
    ----------
    chart : (L, K, 4) array
    needed, inward : (L, 3) arrays
        What `needed_margin` and `edge_reach` say.

    Returns
    -------
    size : (L,) int array
        Indices of `SIZES`.
    rows : int array
        The leaves for which a triangle was found.
    """
    n = bernstein.degree_of(chart.shape[1])
    reach = (needed.max(axis=1) + inward.max(axis=1)) * _STEEP
    reach = np.nan_to_num(reach, nan=np.inf)
    size = np.minimum(np.searchsorted(SIZES, reach), len(SIZES) - 1)
    rows = np.arange(len(chart))
    covered = [rows[:0]]
    for _ in range(_TRIES):
        missing = [rows[:0]]
        for part, s in by_size(rows, size):
            found = _covers(chart[part], needed[part], n, s)
            covered.append(part[found])
            missing.append(part[~found & (s < len(SIZES) - 1)])
        rows = np.concatenate(missing)
        size[rows] += 1
    return size, np.sort(np.concatenate(covered))
