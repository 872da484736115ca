"""Nets in coordinates of their own: float32 loses a part of the patch then, not of its place."""

from __future__ import annotations

import numpy as np

from ..geometry import bernstein
from .graph.collapsed_edges import collapsed_edge

__all__ = ["local_nets"]

#: Patches at a time.
_CHUNK = 2**14


def local_nets(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return nets relative to an origin of their own, of weights up to 1.

    Parameters
    ----------
    nets : (P, K, 4) array

    Returns
    -------
    local : (P, K, 4) array
        What ``(w (x - o), w)`` is, up to a factor, for control points ``(w x, w)``; so control
        vectors stay what they are.
    origin : (P, 4) array
        The origin `o` of each patch, numbers of float32 near its middle, or where an edge is
        collapsed to a point, that point: there all control points are 0, whatever their weights,
        and partials near it keep their digits. Then the row of the largest weight.
    """
    local, origin = np.empty(nets.shape), np.empty((len(nets), 4))
    for first in range(0, len(nets), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        local[chunk], origin[chunk] = _local(nets[chunk])
    return local, origin


def _local(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    w = nets[..., 3]
    row = np.abs(w).argmax(axis=1)
    largest = np.abs(w).max(axis=1)
    # nets at infinity have no weights
    largest = np.where(largest > 0, largest, np.abs(nets).max(axis=(1, 2)))
    factor = np.ldexp(1.0, -np.frexp(largest)[1])  # a power of two: digits stay
    local = nets * factor[:, None, None]
    w = local[..., 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = (local[..., :3] * np.sign(w)[..., None]).sum(axis=1)
        middle = middle / np.abs(w).sum(axis=1)[:, None]
    corner = collapsed_edge(nets)
    ijk = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))
    for c in range(3):
        those, edge = np.flatnonzero(corner == c), np.flatnonzero(ijk[:, c] == 0)
        if len(those):
            best = edge[np.abs(w[np.ix_(those, edge)]).argmax(axis=1)]
            with np.errstate(divide="ignore", invalid="ignore"):
                middle[those] = local[those, best, :3] / w[those, best, None]
    with np.errstate(over="ignore"):
        middle = middle.astype(np.float32).astype(np.float64)
    middle = np.where(np.isfinite(middle).all(axis=1)[:, None], middle, 0.0)
    local[..., :3] -= w[..., None] * middle[:, None]
    return local, np.column_stack([middle, row])
