"""A NURBS surface in NumPy: evaluation, closest points, curves pulled back to (u, v)."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np

from .nurbs import surface_to_bezier

__all__ = ["NurbsSurface", "bezier_points"]


def bezier_points(curve: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Evaluate a rational Bézier curve ``(n+1, d+1)`` at ``(N,)``; return Euclidean points."""
    n = len(curve) - 1
    h = np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=1) @ curve
    return h[:, :-1] / h[:, -1:]


def _univariate(n: int, t: np.ndarray) -> np.ndarray:
    if n < 0:
        return np.zeros((len(t), 0))
    return np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=1)


class NurbsSurface:
    """A NURBS surface.

    Parameters
    ----------
    net : (m, n, 4) array_like
        Homogeneous control points, the first index along u.
    knots_u, knots_v : array_like
        The knots.
    degrees : (int, int)
        The degrees along u and along v.

    Attributes
    ----------
    patches : (S, p+1, q+1, 4) array
        The Bézier patches.
    domain : (2, 2) array
        ``[[u0, u1], [v0, v1]]``.
    size : float
        Diagonal of the bounding box of the control points.
    """

    def __init__(self, net: Any, knots_u: Any, knots_v: Any, degrees: tuple[int, int]) -> None:
        self.net = np.asarray(net, dtype=np.float64)
        self.knots = (np.asarray(knots_u, float), np.asarray(knots_v, float))
        self.degrees = degrees
        self.patches, domains = surface_to_bezier(net, knots_u, knots_v, degrees)
        self._u, self._v = (np.unique(domains[:, axis]) for axis in range(2))
        self.domain = np.array([self._u[[0, -1]], self._v[[0, -1]]])
        points = self.net[..., :3] / self.net[..., 3:]
        self.size = float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0)))

    def jet(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points and first partial derivatives, ``(N, 3)`` each."""
        i, j = (
            np.clip(np.searchsorted(breaks, uv[:, axis], side="right") - 1, 0, len(breaks) - 2)
            for axis, breaks in enumerate((self._u, self._v))
        )
        hu, hv = self._u[i + 1] - self._u[i], self._v[j + 1] - self._v[j]
        s, t = (uv[:, 0] - self._u[i]) / hu, (uv[:, 1] - self._v[j]) / hv
        nets = self.patches[i * (len(self._v) - 1) + j]
        p, q = self.degrees
        bs, bt = _univariate(p, s), _univariate(q, t)
        ds, dt = _univariate(p - 1, s), _univariate(q - 1, t)
        h = np.einsum("ni,nj,nijc->nc", bs, bt, nets)
        hs = p * np.einsum("ni,nj,nijc->nc", ds, bt, np.diff(nets, axis=1)) / hu[:, None]
        ht = q * np.einsum("ni,nj,nijc->nc", bs, dt, np.diff(nets, axis=2)) / hv[:, None]
        point = h[:, :3] / h[:, 3:]
        du = (hs[:, :3] - point * hs[:, 3:]) / h[:, 3:]
        dv = (ht[:, :3] - point * ht[:, 3:]) / h[:, 3:]
        return point, du, dv

    def closest(self, point: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """Return the parameters (u, v) of a point on the surface, by Gauss-Newton.

        Parameters
        ----------
        point : (3,) array
            The point.
        guess : (2,) array, optional
            Where to start; by default the nearest of some points of every patch.
        """
        if guess is None:
            t = np.linspace(0, 1, 7)
            u, v = (
                np.unique((b[:-1, None] + np.diff(b)[:, None] * t).ravel())
                for b in (self._u, self._v)
            )
            grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
            guess = grid[np.argmin(np.linalg.norm(self.jet(grid)[0] - point, axis=1))]
        uv = np.array(guess, dtype=float)
        for _ in range(30):
            p, du, dv = (x[0] for x in self.jet(uv[None]))
            step = np.linalg.lstsq(np.stack([du, dv], axis=1), point - p, rcond=1e-10)[0]
            new = np.clip(uv + step, self.domain[:, 0], self.domain[:, 1])
            moved = np.abs(new - uv).max()
            uv = new
            if moved <= 1e-14 * (np.abs(uv).max() + 1):
                break
        return uv

    def pull_back(self, curve: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the parameters ``(N, 2)`` of points of a space curve on the surface.

        The search goes outwards from the middle of the curve, where the parameters are not
        ambiguous as they are on a seam.
        """
        places = np.unique(np.concatenate([np.linspace(0, 1, 33), t]))
        points = bezier_points(curve, places)
        out = np.empty((len(places), 2))
        middle = len(places) // 2
        out[middle] = self.closest(points[middle])
        for k in range(middle + 1, len(places)):
            out[k] = self.closest(points[k], out[k - 1])
        for k in range(middle - 1, -1, -1):
            out[k] = self.closest(points[k], out[k + 1])
        return out[np.searchsorted(places, t)]
