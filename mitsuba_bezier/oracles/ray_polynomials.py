"""Rays and patches as pairs of polynomials, for `reference`.

A line is the meet of two planes ``L``; ``L.P`` for the control points `P` of a patch are the
Bernstein coefficients of a polynomial that vanishes where the patch meets the plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles

__all__ = ["Patches", "Rays", "problems"]


class Patches:
    """Nets moved to centres of their own, with spheres around what rays may meet."""

    def __init__(self, nets: BezierTriangles, extend: float) -> None:
        points = nets.control_points
        w = points[..., 3]
        finite = np.abs(w) > 1e-6 * np.abs(points).max(axis=(1, 2))[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            affine = np.where(finite[..., None], points[..., :3] / w[..., None], 0.0)
        count = np.maximum(finite.sum(axis=1), 1)
        self.center = affine.sum(axis=1) / count[:, None]
        apart = np.linalg.norm(affine - self.center[:, None], axis=2)
        self.finite = np.where(finite, apart, 0.0).max(axis=1)  # reach of the finite points
        local = points.copy()
        local[..., :3] -= w[..., None] * self.center[:, None]
        self.nets = BezierTriangles(local)
        self.size = np.linalg.norm(local[..., :3], axis=2)  # (P, K): |X_k - w_k c|
        corners = (1.0 + 3.0 * extend) * np.eye(3) - extend
        outer = bernstein.subdivision_matrix(nets.degree, corners) @ local
        w = outer[..., 3]
        one_sign = (w > 0).all(axis=1) | (w < 0).all(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (np.linalg.norm(outer[..., :3], axis=2) / np.abs(w)).max(axis=1)
        self.radius = np.where(one_sign, reach, np.inf)


class Rays:
    """Lines as meets of two planes: ``a`` and ``b`` complete ``d/|d|`` to a frame."""

    def __init__(self, origins: Any, directions: Any) -> None:
        self.o = self._checked(origins, "origins")
        self.d = self._checked(directions, "directions")
        if self.o.shape != self.d.shape:
            raise GeometryError.expected(
                "directions", f"the shape of origins, {self.o.shape}", f"{self.d.shape}"
            )
        self.length = np.linalg.norm(self.d, axis=1)
        if not ((self.length > 0) & np.isfinite(self.length)).all():
            raise GeometryError.expected(
                "directions",
                "vectors that are not zero",
                f"{self.d[np.argmin(self.length)].tolist()}",
            )
        self.unit = self.d / self.length[:, None]
        # the axis with the least component of d: exact zeros stay exact for axis-aligned rays
        axis = np.eye(3)[np.argmin(np.abs(self.unit), axis=1)]
        a = np.cross(self.unit, axis)
        self.a = a / np.linalg.norm(a, axis=1)[:, None]
        self.b = np.cross(self.unit, self.a)

    @staticmethod
    def _checked(value: Any, parameter: str) -> np.ndarray:
        out = np.atleast_2d(np.asarray(value, dtype=np.float64))
        if out.ndim != 2 or out.shape[1] != 3 or not np.isfinite(out).all():
            raise GeometryError.expected(
                parameter,
                "finite numbers of shape (N, 3)",
                f"shape {out.shape}" if out.shape[-1:] != (3,) else "NaN or infinity",
            )
        return out


def problems(
    patches: Patches, rays: Rays, block: int, band: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield ray, patch, polynomials and their bounds, some `block` pairs at a time."""
    parts: list[tuple[np.ndarray, ...]] = []
    waiting = 0
    for p in range(len(patches.nets)):
        near = np.arange(len(rays.o))
        if np.isfinite(patches.radius[p]):
            o = rays.o - patches.center[p]
            distance = np.linalg.norm(np.cross(o, rays.unit), axis=1)
            # at a point of the patch M/|w| <= radius + |o|; 1e-12 for rounding
            reach = patches.radius[p] + np.linalg.norm(o, axis=1)
            near = near[distance <= patches.radius[p] + (band + 1e-12) * reach]
        for start in range(0, len(near), block):
            ray = near[start : start + block]
            o = rays.o[ray] - patches.center[p]
            planes = np.stack([rays.a[ray], rays.b[ray]], axis=1)
            planes = np.concatenate([planes, -(planes @ o[:, :, None])], axis=2)
            f = planes @ patches.nets.control_points[p].T
            weights = np.abs(patches.nets.weights[p])
            distance = np.linalg.norm(o, axis=1)
            bound = (patches.size[p] + weights * distance[:, None]).max(axis=1)
            parts.append((ray, np.full(len(ray), p), f, bound))
            waiting += len(ray)
            if waiting >= block:
                yield tuple(np.concatenate(column) for column in zip(*parts))  # type: ignore[misc]
                parts, waiting = [], 0
    if parts:
        yield tuple(np.concatenate(column) for column in zip(*parts))  # type: ignore[misc]
