"""Evaluate and restrict a NURBS surface, given as a grid of Bézier patches."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np

from .nurbs import bezier_matrices, surface_to_bezier

__all__ = ["PatchGrid", "bezier_points"]


def bezier_points(curve: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Evaluate a rational Bézier curve ``(n+1, d+1)`` at ``(N,)``; return Euclidean points."""
    n = len(curve) - 1
    h = np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=1) @ curve
    return h[:, :-1] / h[:, -1:]


def _univariate(n: int, t: np.ndarray) -> np.ndarray:
    if n < 0:
        return np.zeros((len(t), 0))
    return np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=1)


class PatchGrid:
    """Tensor-product Bézier patches side by side.

    Parameters
    ----------
    patches : (Su, Sv, p+1, q+1, 4) array
        Homogeneous control points.
    u : (Su+1,) array
        Where the patches begin and end along u.
    v : (Sv+1,) array
        Where they do along v.

    Attributes
    ----------
    domain : (2, 2) array
        ``[[u0, u1], [v0, v1]]``.
    size : float
        Diagonal of the bounding box of the finite control points.
    """

    def __init__(self, patches: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
        self.patches, self.u, self.v = patches, u, v
        self.domain = np.array([u[[0, -1]], v[[0, -1]]])
        flat = patches.reshape(-1, 4)
        flat = flat[flat[:, 3] != 0]
        self.size = float(np.linalg.norm(np.ptp(flat[:, :3] / flat[:, 3:], axis=0)))

    @classmethod
    def from_nurbs(
        cls, net: Any, knots_u: Any, knots_v: Any, degrees: tuple[int, int]
    ) -> PatchGrid:
        """Return the patches of a NURBS surface; see `nurbs.surface_to_bezier`."""
        patches, domains = surface_to_bezier(net, knots_u, knots_v, degrees)
        u, v = (np.unique(domains[:, axis]) for axis in range(2))
        return cls(patches.reshape(len(u) - 1, len(v) - 1, *patches.shape[1:]), u, v)

    @property
    def degrees(self) -> tuple[int, int]:
        """The degrees along u and along v."""
        return self.patches.shape[2] - 1, self.patches.shape[3] - 1

    def tiled(self, axis: int, low: float, high: float) -> PatchGrid:
        """Return the same surface, closed along an axis, over all periods that meet a range."""
        breaks = (self.u, self.v)[axis]
        period = breaks[-1] - breaks[0]
        # 1e-9 of a period: a range that ends at the seam does not need the next one
        first = int(np.floor((low - breaks[0]) / period + 1e-9))
        last = max(int(np.ceil((high - breaks[0]) / period - 1e-9)), first + 1)
        turns = range(first, last)
        patches = np.concatenate([self.patches] * len(turns), axis=axis)
        ends = np.concatenate([breaks[:-1] + k * period for k in turns])
        ends = np.append(ends, breaks[-1] + (last - 1) * period)
        return PatchGrid(patches, *((ends, self.v) if axis == 0 else (self.u, ends)))

    def rectangle(self, box: np.ndarray) -> np.ndarray:
        """Return the patches ``(S, p+1, q+1, 4)`` restricted to ``[[u0, u1], [v0, v1]]``."""
        patches = self.patches
        for axis, breaks in enumerate((self.u, self.v)):
            low, high = np.clip(box[axis], breaks[0], breaks[-1])
            keep = np.flatnonzero((breaks[:-1] < high) & (breaks[1:] > low))
            parts = []
            for k in keep:
                part = np.take(patches, k, axis=axis)
                size = breaks[k + 1] - breaks[k]
                cut = np.clip((np.array([low, high]) - breaks[k]) / size, 0, 1)
                if cut.tolist() != [0, 1]:
                    n = patches.shape[2 + axis] - 1
                    knots = np.array([0.0] * (n + 1) + [1.0] * (n + 1))
                    matrices, _first, intervals = bezier_matrices(knots, n, cut)
                    at = int(np.argmin(np.abs(intervals - cut).sum(axis=1)))
                    # the control points along this axis stand one place ahead of their grid axis
                    part = np.moveaxis(np.tensordot(matrices[at], part, (1, 1 + axis)), 0, 1 + axis)
                parts.append(part)
            patches = np.stack(parts, axis=axis)
        return patches.reshape(-1, *patches.shape[2:])

    def jet(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points and first partial derivatives, ``(N, 3)`` each."""
        i, j = (
            np.clip(np.searchsorted(breaks, uv[:, axis], side="right") - 1, 0, len(breaks) - 2)
            for axis, breaks in enumerate((self.u, self.v))
        )
        hu, hv = self.u[i + 1] - self.u[i], self.v[j + 1] - self.v[j]
        s, t = (uv[:, 0] - self.u[i]) / hu, (uv[:, 1] - self.v[j]) / hv
        nets = self.patches[i, j]
        p, q = self.degrees
        bs, bt = _univariate(p, s), _univariate(q, t)
        ds, dt = _univariate(p - 1, s), _univariate(q - 1, t)
        # along v first, by products of matrices: an einsum of three factors is slow
        rows = (bt[:, None, None, :] @ nets)[:, :, 0]
        rows_t = (dt[:, None, None, :] @ np.diff(nets, axis=2))[:, :, 0]
        h = (bs[:, None, :] @ rows)[:, 0]
        hs = p * (ds[:, None, :] @ np.diff(rows, axis=1))[:, 0] / hu[:, None]
        ht = q * (bs[:, None, :] @ rows_t)[:, 0] / hv[:, None]
        point = h[:, :3] / h[:, 3:]
        du = (hs[:, :3] - point * hs[:, 3:]) / h[:, 3:]
        dv = (ht[:, :3] - point * ht[:, 3:]) / h[:, 3:]
        return point, du, dv
