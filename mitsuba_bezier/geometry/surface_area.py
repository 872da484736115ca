"""Areas of Bézier surfaces, whole or trimmed."""

from __future__ import annotations

import numpy as np

from .bernstein import multi_indices
from .boxes import reaches_infinity
from .triangles import BezierTriangles
from .trim_cells import trim_cells
from .trims import Trims

__all__ = ["is_bounded", "left_of_cells", "surface_area"]

#: How often a trimmed patch is divided; triangles at its boundary then count by a share.
_LEVELS = 5


def is_bounded(patches: BezierTriangles) -> bool:
    """Return whether all patches are finite."""
    return not reaches_infinity(patches.control_points).any()


def left_of_cells(trims: Trims, patch: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return what trims leave of triangles: 0 nothing, 1 maybe a part, 2 all.

    Parameters
    ----------
    trims : Trims
    patch : (N,) int array
    corners : (N, 3, 2) array
        Parameters of the corners.
    """
    _cells, cell, keep = trim_cells(trims, patch, corners)
    return np.where(keep, np.where(cell < 0, 2, 1), 0)


def surface_area(patches: BezierTriangles, trims: Trims | None = None) -> float:
    """Return the area, infinite for a surface that runs to infinity.

    That of a trimmed patch is exact to about 1e-3: at the trimming curves the unit is a
    triangle of 1/192 of the patch.
    """
    if not is_bounded(patches):
        return float("inf")
    if trims is None:
        return float(patches.area().sum())
    whole = trims.region < 0
    total = float(patches[whole].area().sum()) if whole.any() else 0.0
    patch = np.flatnonzero(~whole)
    corners = np.tile([[[1.0, 0], [0, 1], [0, 0]]], (len(patch), 1, 1))
    for level in range(_LEVELS + 1):
        left = left_of_cells(trims, patch, corners)
        last = level == _LEVELS
        # three points are enough for an eighth of a patch
        done = (left == 2) if level >= 3 else np.zeros(len(left), dtype=bool)
        if last:
            done = left > 0
        if done.any():
            total += _sum(patches, trims, patch[done], corners[done], left[done] == 1)
        on = (left > 0) & ~done
        if last or not on.any():
            return total
        a, b, c = corners[on].transpose(1, 0, 2)
        p, q, r = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, p, r), (p, b, q), (r, q, c), (q, r, p)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
        patch = np.tile(patch[on], 4)
    return total


def _sum(
    patches: BezierTriangles,
    trims: Trims,
    patch: np.ndarray,
    corners: np.ndarray,
    partial: np.ndarray,
) -> float:
    """Return the area of triangles in parameters by the three-point rule."""
    inner = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
    uv = np.einsum("qk,nkd->nqd", inner, corners).reshape(-1, 2)
    d = patches.differential(np.repeat(patch, 3), uv)
    density = np.linalg.norm(np.cross(d.dp_du, d.dp_dv), axis=1).reshape(-1, 3).mean(axis=1)
    edge = corners[:, :2] - corners[:, 2:]
    size = np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]) / 2
    share = np.ones(len(patch))
    if partial.any():
        points = np.einsum("qk,nkd->nqd", _CENTROIDS, corners[partial]).reshape(-1, 2)
        inside = trims.inside(np.repeat(patch[partial], len(_CENTROIDS)), points)
        share[partial] = inside.reshape(-1, len(_CENTROIDS)).mean(axis=1)
    return float((density * size * share).sum())


def _lattice_centroids(r: int) -> np.ndarray:
    """Return barycentrics of the centroids of ``r^2`` equal parts of a triangle."""
    up = multi_indices(r - 1) + 1 / 3
    down = multi_indices(r - 2) + 2 / 3
    return np.concatenate([up, down]) / r


#: Points that tell which share of a triangle at a trimming curve is left.
_CENTROIDS = _lattice_centroids(6)
