"""Bernstein polynomials on the triangle: index order, basis, blossoms, change of basis.

Conventions (``docs/conventions.md``): barycentric coordinates ``U = (u, v, w)`` with
``w = 1 - u - v``, ``B_ijk = n!/(i! j! k!) u^i v^j w^k``, and the rows of a net run over
``(i, j, k)`` with ``i`` falling, then ``j`` falling. All arrays are float64.
"""

from __future__ import annotations

from functools import cache
from math import comb, factorial, isqrt
from typing import Any

import numpy as np

from ..errors import NetError

__all__ = [
    "basis",
    "blossom_step",
    "corner_rows",
    "de_casteljau",
    "degree_of",
    "edge_rows",
    "elevated",
    "elevation_matrix",
    "monomial_matrix",
    "multi_indices",
    "multinomials",
    "net_edges",
    "net_triangles",
    "partials_matrices",
    "permutation",
    "row",
    "size",
    "split_matrices",
    "subdivide",
    "subdivision_matrix",
    "trivariate",
    "univariate",
]


def size(n: int) -> int:
    """Return the number ``K = (n+1)(n+2)/2`` of control points of degree `n`."""
    return (n + 1) * (n + 2) // 2


def degree_of(count: int, parameter: str = "control_points") -> int:
    """Return the degree of a net with `count` control points.

    Raises
    ------
    NetError
        If `count` is no triangular number ``(n+1)(n+2)/2`` with ``n >= 1``.
    """
    n = (isqrt(8 * count + 1) - 3) // 2 if count > 0 else 0
    if n < 1 or size(n) != count:
        raise NetError.expected(
            parameter,
            "K = (n+1)(n+2)/2 control points a patch for a degree n >= 1 (3, 6, 10, 15, ...)",
            f"K = {count}",
        )
    return n


@cache
def multi_indices(n: int) -> np.ndarray:
    """Return the ``(K, 3)`` multi-indices ``(i, j, k)`` in net order."""
    out = np.array([(i, j, n - i - j) for i in range(n, -1, -1) for j in range(n - i, -1, -1)])
    out.setflags(write=False)
    return out


def row(n: int, i: int, j: int) -> int:
    """Return the row of control point ``(i, j, n - i - j)``."""
    level = n - i
    return level * (level + 1) // 2 + (level - j)


def corner_rows(n: int) -> tuple[int, int, int]:
    """Return the rows of the corners ``(n,0,0)``, ``(0,n,0)``, ``(0,0,n)``."""
    return 0, size(n) - n - 1, size(n) - 1


@cache
def edge_rows(n: int) -> np.ndarray:
    """Return the rows along the three edges AB, BC and CA, ``(3, n + 1)``."""
    e = range(n + 1)
    out = np.array(
        [
            [row(n, n - t, t) for t in e],
            [row(n, 0, n - t) for t in e],
            [row(n, t, 0) for t in e],
        ]
    )
    out.setflags(write=False)
    return out


@cache
def net_triangles(n: int) -> np.ndarray:
    """Return rows ``(T, 3)`` of the triangles in a net that de Casteljau's step makes points of."""
    out = np.array(
        [(row(n, i + 1, j), row(n, i, j + 1), row(n, i, j)) for i, j, _k in multi_indices(n - 1)]
    )
    out.setflags(write=False)
    return out


@cache
def net_edges(n: int) -> np.ndarray:
    """Return the pairs of rows that legs of a control net join, each once, ``(E, 2)``."""
    three = net_triangles(n)
    pairs = np.concatenate([three[:, [0, 1]], three[:, [1, 2]], three[:, [2, 0]]])
    out = np.unique(np.sort(pairs, axis=1), axis=0)
    out.setflags(write=False)
    return out


@cache
def multinomials(n: int) -> np.ndarray:
    """Return ``n!/(i! j! k!)`` in net order, ``(K,)``."""
    out = np.array(
        [
            factorial(n) // (factorial(i) * factorial(j) * factorial(k))
            for i, j, k in multi_indices(n)
        ],
        dtype=np.float64,
    )
    out.setflags(write=False)
    return out


def basis(n: int, uv: np.ndarray) -> np.ndarray:
    """Evaluate all Bernstein polynomials of degree `n`.

    Parameters
    ----------
    n : int
        Degree, at least 0.
    uv : (..., 2) array
        Barycentric coordinates ``(u, v)``.

    Returns
    -------
    (..., K) array
    """
    uv = np.asarray(uv, dtype=np.float64)
    uvw = np.stack([uv[..., 0], uv[..., 1], 1.0 - uv[..., 0] - uv[..., 1]], axis=-1)
    powers = np.ones((*uvw.shape, n + 1))
    for e in range(1, n + 1):
        powers[..., e] = powers[..., e - 1] * uvw
    ijk = multi_indices(n)
    return (
        multinomials(n)
        * powers[..., 0, ijk[:, 0]]
        * powers[..., 1, ijk[:, 1]]
        * powers[..., 2, ijk[:, 2]]
    )


def univariate(n: int, t: Any) -> np.ndarray:
    """Return the Bernstein polynomials ``B_i(t) = C(n, i) (1-t)^(n-i) t^i``, ``(..., n+1)``.

    Raises
    ------
    NetError
        If `n` is no degree.
    """
    n = _degree(n)
    t = np.asarray(t, dtype=np.float64)[..., None]
    i = np.arange(n + 1)
    return np.array([comb(n, k) for k in i], dtype=np.float64) * (1 - t) ** (n - i) * t**i


def trivariate(n: int, uvw: Any) -> np.ndarray:
    """Return the Bernstein polynomials of three variables ``n!/(i! j! k!) u^i v^j w^k``.

    Parameters
    ----------
    n : int
        Degree, at least 0.
    uvw : (..., 3) or (..., 2) array_like
        Three variables, of any sum (then the polynomials sum to its n-th power); or ``(u, v)``
        alone, with ``w = 1 - u - v``.

    Returns
    -------
    (..., K) array
        In the order of `multi_indices`.

    Raises
    ------
    NetError
        If an argument is not of this form.
    """
    n, x = _degree(n), np.asarray(uvw, dtype=np.float64)
    if x.ndim == 0 or x.shape[-1] not in (2, 3):
        raise NetError.expected("uvw", "two or three variables", f"shape {x.shape}")
    if x.shape[-1] == 2:
        return basis(n, x)
    ijk = multi_indices(n)
    return multinomials(n) * np.prod(x[..., None, :] ** ijk, axis=-1)


def _degree(n: int) -> int:
    if n != int(n) or n < 0:
        raise NetError.expected("n", "a degree, an integer >= 0", n)
    return int(n)


def blossom_step(net: np.ndarray, uvw: np.ndarray) -> np.ndarray:
    """Return a net ``(K_{n-1}, ...)``: one step of de Casteljau's algorithm over the triangle.

    ``b_ijk <- u b_{i+1,j,k} + v b_{i,j+1,k} + w b_{i,j,k+1}``; with another `uvw` in every step the
    last point is a value of the blossom.
    """
    n = degree_of(len(net))
    i, j, _k = multi_indices(n - 1).T
    level = n - i
    rows = [
        (level - 1) * level // 2 + level - 1 - j,  # (i + 1, j)
        level * (level + 1) // 2 + level - (j + 1),
        level * (level + 1) // 2 + level - j,
    ]
    return uvw[0] * net[rows[0]] + uvw[1] * net[rows[1]] + uvw[2] * net[rows[2]]


def de_casteljau(net: np.ndarray, uvw: np.ndarray) -> list[np.ndarray]:
    """Return the levels of de Casteljau's scheme: nets of degree ``n, n - 1, ..., 0``."""
    scheme = [net]
    while len(scheme[-1]) > 1:
        scheme.append(blossom_step(scheme[-1], uvw))
    return scheme


@cache
def partials_matrices(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices ``(K_{n-1}, K_n)`` that take a net to those of d/du and d/dv.

    ``w`` depends on both: d/du = n (b_{i+1,j,k} - b_{i,j,k+1}).
    """
    du = np.zeros((size(n - 1), size(n)))
    dv = np.zeros_like(du)
    for r, (i, j, _k) in enumerate(multi_indices(n - 1)):
        du[r, row(n, i + 1, j)] += n
        du[r, row(n, i, j)] -= n
        dv[r, row(n, i, j + 1)] += n
        dv[r, row(n, i, j)] -= n
    du.setflags(write=False)
    dv.setflags(write=False)
    return du, dv


def subdivision_matrix(n: int, corners: np.ndarray) -> np.ndarray:
    """Return the ``(..., K, K)`` matrices that take a net to the nets over domain triangles.

    Row ``(i, j, k)`` is the blossom value ``b[A^i, B^j, C^k]`` (Ramshaw), so every net
    coefficient is an affine combination of the old ones.

    Parameters
    ----------
    n : int
        Degree.
    corners : (..., 3, 3) array
        Barycentric coordinates of the new corners ``A``, ``B``, ``C``, one a row; each row
        sums to 1 for an affine change and may have any non-zero sum for a projective one.
    """
    # rows are the coefficients of products ``A^i B^j C^k`` of linear forms, those of one degree
    # after the other: each is one of the degree before, times one form
    corners = np.asarray(corners, dtype=np.float64)
    out = np.ones((*corners.shape[:-2], 1, 1))
    for m in range(1, n + 1):
        which, before, above = _products(m)
        form, lower = corners[..., which, :], out[..., before, :]
        out = np.zeros((*corners.shape[:-2], size(m), size(m)))
        for c in range(3):
            out[..., above[c]] += form[..., c, None] * lower
    return out


@cache
def _products(m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how products of `m` linear forms follow from those of ``m - 1``.

    Returns
    -------
    which, before : (K_m,) arrays
        The form that is new, and the row of the others.
    above : (3, K_{m-1}) array
        Where the terms of the others go, times each of the three variables.
    """
    i, j, _k = multi_indices(m).T
    which = np.where(i > 0, 0, np.where(j > 0, 1, 2))
    level = m - 1 - (i - (which == 0))
    before = level * (level + 1) // 2 + level - (j - (which == 1))
    i, j, _k = multi_indices(m - 1).T
    level = m - i - np.array([[1], [0], [0]])
    above = level * (level + 1) // 2 + level - j - np.array([[0], [1], [0]])
    return which, before, above


def subdivide(nets: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return nets over domain triangles, as `subdivision_matrix`, of all of which that is large.

    Parameters
    ----------
    nets : (P, K, C) array
    corners : (T, 3, 3) array
        Barycentric coordinates of the new corners, one a row, of each triangle.

    Returns
    -------
    (P, T, K, C) array
    """
    count = nets.shape[1]
    n = degree_of(count)
    out = np.empty((len(nets), len(corners), *nets.shape[1:]))
    step = max(1, _ENTRIES // count**2)
    for first in range(0, len(corners), step):
        part = corners[first : first + step]
        rows = subdivision_matrix(n, part).reshape(-1, count)
        out[:, first : first + step] = (rows @ nets).reshape(len(nets), len(part), *nets.shape[1:])
    return out


#: Most entries of the matrices that `subdivide` has at a time.
_ENTRIES = 1 << 20


#: Corners of the four midpoint sub-triangles: at A, at B, at C, and the middle one turned by a
#: half turn, all with the orientation of the parent.
SPLIT_CORNERS = (
    np.array(
        [
            [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
            [[1, 1, 0], [0, 2, 0], [0, 1, 1]],
            [[1, 0, 1], [0, 1, 1], [0, 0, 2]],
            [[0, 1, 1], [1, 0, 1], [1, 1, 0]],
        ],
        dtype=np.float64,
    )
    / 2
)


@cache
def split_matrices(n: int, times: int = 1) -> np.ndarray:
    """Return the matrices ``(4^times, K, K)`` of repeated midpoint splits (see `SPLIT_CORNERS`)."""
    once = np.stack([subdivision_matrix(n, c) for c in SPLIT_CORNERS])
    out = once
    for _ in range(times - 1):
        out = np.einsum("eij,fjk->feik", once, out).reshape(-1, *once.shape[1:])
    out.setflags(write=False)
    return out


@cache
def elevation_matrix(n: int, degree: int | None = None) -> np.ndarray:
    """Return the ``(K_degree, K_n)`` matrix of elevation from `n` to `degree`, or to ``n + 1``."""
    if degree is not None and degree != n + 1:
        steps = np.eye(size(n))
        for m in range(n, degree):
            steps = elevation_matrix(m) @ steps
        steps.setflags(write=False)
        return steps
    out = np.zeros((size(n + 1), size(n)))
    for r, (i, j, k) in enumerate(multi_indices(n + 1)):
        if i:
            out[r, row(n, i - 1, j)] += i / (n + 1)
        if j:
            out[r, row(n, i, j - 1)] += j / (n + 1)
        if k:
            out[r, row(n, i, j)] += k / (n + 1)
    out.setflags(write=False)
    return out


def elevated(net: np.ndarray, n: int, degree: int | None = None) -> np.ndarray:
    """Return nets ``(..., K_n, d)`` elevated to `degree`, or to ``n + 1``.

    The same as the matrix, whose rows have three entries a step; of high degree it is too large.
    """
    if degree is not None and degree != n + 1:
        for m in range(n, degree):
            net = elevated(net, m)
        return net
    if n <= 16:
        return elevation_matrix(n) @ net
    i, j, k = multi_indices(n + 1).T
    out = np.zeros((*net.shape[:-2], size(n + 1), net.shape[-1]))
    for index, (a, b) in zip((i, j, k), ((i - 1, j), (i, j - 1), (i, j))):
        used = np.flatnonzero(index)
        level = n - a[used]
        rows = level * (level + 1) // 2 + level - b[used]
        out[..., used, :] += (index[used] / (n + 1))[:, None] * net[..., rows, :]
    return out


@cache
def monomial_matrix(n: int) -> np.ndarray:
    """Return the ``(K, K)`` matrix from Bernstein to monomial coefficients.

    Row ``r`` belongs to ``u^a v^b`` with ``(a, b) = multi_indices(n)[r, :2]``; expanding
    ``w^k = (1 - u - v)^k`` gives the entries.
    """
    out = np.zeros((size(n), size(n)))
    factors = multinomials(n)
    for col, (i, j, k) in enumerate(multi_indices(n)):
        for a in range(k + 1):
            for b in range(k - a + 1):
                term = (-1) ** (a + b) * comb(k, a) * comb(k - a, b)
                out[row(n, i + a, j + b), col] += factors[col] * term
    out.setflags(write=False)
    return out


@cache
def permutation(n: int, order: tuple[int, int, int]) -> np.ndarray:
    """Return the row order that renames the corners: new corner ``c`` is old ``order[c]``."""
    rows = []
    for ijk in multi_indices(n):
        old = [0, 0, 0]
        for new, exponent in enumerate(ijk):
            old[order[new]] = int(exponent)
        rows.append(row(n, old[0], old[1]))
    return np.array(rows)
