"""Tensor-product patches and their exact split into two Bézier triangles."""

from __future__ import annotations

from functools import lru_cache
from math import comb
from typing import Any

import numpy as np

from ..errors import NetError
from . import bernstein
from .checks import finite_array
from .triangles import BezierTriangles

__all__ = ["evaluate_tensor", "revolved", "tensor_matrices", "tensor_to_triangles"]


def _tensor_nets(net: Any, parameter: str) -> np.ndarray:
    """Return nets as ``(P, p+1, q+1, 4)``, checked."""
    one = np.ndim(net) == 3
    shape: tuple[int | None, ...] = (None, None, 4) if one else (None, None, None, 4)
    nets = finite_array(parameter, net, shape, NetError)
    nets = nets[None] if one else nets
    if min(nets.shape[1:3]) < 2:
        raise NetError.expected(
            parameter,
            "shape (p+1, q+1, 4) or (P, p+1, q+1, 4) with degrees p, q >= 1",
            f"shape {np.shape(net)}",
        )
    return nets


def tensor_matrices(p: int, q: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices ``(K_{p+q}, (p+1)(q+1))`` from a tensor net to two triangles.

    In the first triangle ``s = u``, ``t = v``: the powers of ``1 - s = v + w`` and
    ``1 - t = u + w`` in ``B_i^p(s) B_j^q(t)`` are expanded. The second has ``s = 1 - u``,
    ``t = 1 - v``, so it is the first of the net turned by half a turn.
    """
    # those of high degree are large: a file of many degrees would fill the memory with them
    small = (p + 1) * (q + 1) * bernstein.size(p + q) <= 100_000
    return (_kept_matrices if small else _matrices)(p, q)


def _matrices(p: int, q: int) -> tuple[np.ndarray, np.ndarray]:
    n = p + q
    # exact up to 2^64 where long double has 64 bits, and rounded by less than float64 beyond
    binomial = np.zeros((n + 1, n + 1), dtype=np.longdouble)
    binomial[:, 0] = 1
    for row in range(1, n + 1):
        binomial[row, 1:] = binomial[row - 1, 1:] + binomial[row - 1, :-1]
    out = np.zeros((bernstein.size(n), p + 1, q + 1))
    j = np.arange(q + 1)[:, None, None]
    b = np.arange(q + 1)  # u^b of (u + w)^(q - j)
    for i in range(p + 1):
        # v^a of (v + w)^(p - i)
        jj, aa, bb = np.nonzero(np.broadcast_to(b <= q - j, (q + 1, p - i + 1, q + 1)))
        x, y = i + bb, jj + aa
        term = binomial[p, i] * binomial[q, jj] * binomial[p - i, aa] * binomial[q - jj, bb]
        out[_rows(n, x, y), i, jj] = term / (binomial[n, x] * binomial[n - x, y])
    first = out.reshape(len(out), -1)
    second = np.ascontiguousarray(out[:, ::-1, ::-1]).reshape(len(out), -1)
    return first, second


def _rows(n: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return `bernstein.row` of many indices."""
    level = n - x
    return level * (level + 1) // 2 + level - y


_kept_matrices = lru_cache(maxsize=64)(_matrices)


def tensor_to_triangles(net: Any) -> BezierTriangles:
    """Split tensor-product patches exactly into two triangles each, along a diagonal.

    Parameters
    ----------
    net : (p+1, q+1, 4) or (P, p+1, q+1, 4) array_like
        Homogeneous control points ``b_ij`` of ``sum b_ij B_i^p(s) B_j^q(t)``, degrees at
        least 1.

    Returns
    -------
    BezierTriangles
        ``2P`` triangles of degree ``p + q``, oriented along ``d/ds x d/dt``. Triangle ``2m``
        has the corners ``(s, t) = (1, 0), (0, 1), (0, 0)`` of patch `m`, with ``s = u``,
        ``t = v``; triangle ``2m + 1`` has ``(0, 1), (1, 0), (1, 1)``, with ``s = 1 - u``,
        ``t = 1 - v``.

    Raises
    ------
    NetError
        If the array is not of this form or not finite.

    Examples
    --------
    >>> net = [[[0, 0, 0, 1], [0, 1, 0, 1]], [[1, 0, 0, 1], [1, 1, 1, 1]]]
    >>> patches = mb.tensor_to_triangles(net)
    >>> len(patches), patches.degree
    (2, 2)
    """
    nets = _tensor_nets(net, "net")
    count, p, q = len(nets), nets.shape[1] - 1, nets.shape[2] - 1
    both = np.stack(tensor_matrices(p, q))
    out = np.einsum("ekl,plc->pekc", both, nets.reshape(count, -1, 4))
    return BezierTriangles(out.reshape(2 * count, -1, 4))


def revolved(profile: Any, segments: int = 4) -> np.ndarray:
    """Revolve a rational Bézier curve around the z axis, as CAD systems do.

    Parameters
    ----------
    profile : (q+1, 3) array_like
        Homogeneous control points ``(r, z, w)`` of the curve, ``r`` being the distance from the
        axis times the weight. Where it is zero an edge of the patches collapses.
    segments : int
        Patches around the axis, at least 3.

    Returns
    -------
    (segments, 3, q+1, 4) array
        Nets of tensor-product patches, quadratic around the axis; with ``d/ds x d/dt`` on the
        right of the curve, seen from where its way is up and the axis on its left.

    Raises
    ------
    NetError
        If the profile is not of this form or not finite, or the segments are too few.
    """
    curve = finite_array("profile", profile, (None, 3), NetError)
    if len(curve) < 2:
        raise NetError.expected("profile", "at least two control points", f"{len(curve)}")
    if segments < 3:
        raise NetError.expected("segments", "an integer of at least 3", segments)
    half = np.pi / segments
    angle = half * (2 * np.arange(segments)[:, None] + np.arange(3))
    # the middle control point is where the tangents meet: as a homogeneous point, on the circle
    weight = np.array([1.0, np.cos(half), 1.0])
    x, y = np.cos(angle), np.sin(angle)
    r, z, w = (curve[:, k][None, None] for k in range(3))
    parts = [x[..., None] * r, y[..., None] * r, weight[:, None] * z, weight[:, None] * w]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def evaluate_tensor(net: Any, st: Any) -> np.ndarray:
    """Evaluate homogeneous points of one tensor-product patch.

    Parameters
    ----------
    net : (p+1, q+1, 4) array_like
        Homogeneous control points.
    st : (N, 2) array_like
        Parameters.

    Returns
    -------
    (N, 4) array

    Raises
    ------
    NetError
        If an array is not of this form.
    """
    nets = _tensor_nets(net, "net")
    if len(nets) != 1:
        raise NetError.expected("net", "one net (p+1, q+1, 4)", f"{len(nets)} nets")
    st = finite_array("st", np.atleast_2d(st), (None, 2), NetError)
    bs, bt = (_bernstein(d - 1, x) for d, x in zip(nets.shape[1:3], st.T))
    return np.einsum("ni,nj,ijc->nc", bs, bt, nets[0])


def _bernstein(n: int, t: np.ndarray) -> np.ndarray:
    """Return the univariate Bernstein polynomials ``(N, n+1)``."""
    i = np.arange(n + 1)
    binomials = np.array([comb(n, k) for k in i], dtype=np.float64)
    return binomials * t[:, None] ** i * (1 - t[:, None]) ** (n - i)
