"""Trimming curves on the device: their points in the parameters of patches, with derivatives."""

from __future__ import annotations

from math import comb
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.trim_outlines import TrimSegments
from ..kernels.arrays import upload
from ..kernels.float64_use import uses_pairs

__all__ = ["CurvePoint", "Cuts", "TrimCurves"]

#: Numbers of a segment: t0, t1, side, weight; the inverse of M, and its offset; origin and size of
#: the place; openings of arcs. See `geometry.trims`.
_ROW = 16


class Cuts(NamedTuple):
    """Segments of the trimming curves of a shape."""

    patch: np.ndarray  #: numbered among all of the structure
    a: np.ndarray
    b: np.ndarray
    rows: np.ndarray  #: where they are in `TrimCurves`


class CurvePoint(NamedTuple):
    """A point of a trimming curve."""

    uv: Any  #: Point2f, in the parameters of its patch
    tangent: Any  #: Vector2f, by the parameter of the segment
    side: Any  #: Float, 1 if the surface is to its left, or -1
    weight: Any  #: Float


class TrimCurves:
    """The segments of the trimming curves of some shapes of a structure."""

    def __init__(self) -> None:
        self._rows: list[np.ndarray] = []
        self._heads: list[np.ndarray] = []
        self._points: list[np.ndarray] = []
        self._index: list[np.ndarray] = []
        self._shapes: list[Any] = []
        self._count = self._used = self._first = 0
        self.degrees: set[int] = set()
        self.number: Any = None  #: type of all arithmetic

    def add(self, shape: Any, first: int, found: TrimSegments | None) -> Cuts:
        """Add the segments of a shape, whose patches are numbered from `first` on."""
        if found is None:
            none = np.zeros((0, 2))
            return Cuts(np.zeros(0, dtype=int), none, none, np.zeros(0, dtype=int))
        trims = shape.trims
        points, index = shape.trim_rows
        starts = self._used + np.cumsum([0] + [len(i) for i in index])
        degree = np.array([len(i) - 1 for i in index])
        p = found.patch
        self._rows.append(
            np.concatenate(
                [
                    found.t,
                    found.side[:, None],
                    found.weight[:, None],
                    np.linalg.inv(trims.square[p, :, :2]).reshape(-1, 4),
                    trims.square[p, :, 2],
                    trims.place[p].reshape(-1, 4),
                    trims.arc[p],
                ],
                axis=1,
            )
        )
        self._heads.append(np.stack([starts[found.curve], degree[found.curve]], axis=1))
        self._index += [i + self._first for i in index]
        self._points.append(points)
        self._shapes.append(shape)
        self._used = int(starts[-1])
        self._first += len(points)
        self.degrees |= set(degree.tolist())
        rows = self._count + np.arange(len(found))
        self._count += len(found)
        return Cuts(p + first, found.a, found.b, rows)

    def uploaded(self, data: Any) -> TrimCurves | None:
        """Return the curves on the device, None without any on the whole structure."""
        if data.trim is None:
            return None
        rows = self._rows or [np.zeros((1, _ROW))]
        # coordinates of a unit square: float32 is enough where float64 is not wanted
        self.number = mi.Float if uses_pairs(mi.Float) else mi.Float64
        self.rows = upload(self.number, np.concatenate([*rows, np.zeros((1, _ROW))]))
        heads = np.concatenate([*self._heads, np.zeros((1, 2))])
        self.heads = upload(mi.UInt32, heads.astype(np.uint32))
        index = np.concatenate([*self._index, np.zeros(1)])
        self.index = upload(mi.UInt32, index.astype(np.uint32))
        self.points = upload(self.number, np.concatenate([*self._points, np.zeros((1, 3))]))
        return self

    def moves(self) -> bool:
        """Return whether any of the curves has derivatives."""
        return bool(dr.grad_enabled([shape.trim_points for shape in self._shapes]))

    def attached(self) -> Any:
        """Return the control points of all curves, with derivatives."""
        tensors = [shape.trim_points for shape in self._shapes]
        parts = [
            dr.zeros(self.number, 3 * len(points)) if tensor is None else self.number(tensor.array)
            for tensor, points in zip(tensors, self._points)
        ]
        return dr.replace_grad(self.points, dr.concat([*parts, dr.zeros(self.number, 3)]))

    def point(self, row: Any, s: Any, active: Any, points: Any = None) -> CurvePoint:
        """Return points of segments.

        Parameters
        ----------
        row : UInt
        s : Float
            From 0 to 1 along the segment.
        active : Bool
        points : optional
            Those of `attached`.
        """
        points = self.points if points is None else points
        m = [dr.gather(self.number, self.rows, _ROW * row + k, active) for k in range(_ROW)]
        start, n = (dr.gather(mi.UInt32, self.heads, 2 * row + k, active) for k in (0, 1))
        t = m[0] + self.number(s) * (m[1] - m[0])
        h, slope = [self.number(0.0)] * 3, [self.number(0.0)] * 3
        for degree in sorted(self.degrees):
            here = active & (n == degree)
            values, partials = self._evaluate(degree, start, t, here, points)
            h = [dr.select(here, x, y) for x, y in zip(values, h)]
            slope = [dr.select(here, x, y) for x, y in zip(partials, slope)]
        scale = dr.select(active, 1.0 / dr.select(active, h[2], 1.0), 0.0)
        x, dx = [], []
        for k in range(2):
            place = h[k] * scale
            size = dr.select(active, m[12 + k], 1.0)
            value = (place - m[10 + k]) / size
            speed = (slope[k] - place * slope[2]) * scale * (m[1] - m[0]) / size
            arc = m[14 + k]
            safe = dr.select(arc > 0, arc, 1.0)
            turn = dr.tan((value - 0.5) * safe * 0.5)
            stretch = 0.5 / dr.tan(safe * 0.25)
            x.append(dr.select(arc > 0, 0.5 + turn * stretch, value) - m[8 + k])
            change = 0.5 * safe * (1 + turn * turn) * stretch
            dx.append(dr.select(arc > 0, speed * change, speed))
        inverse = m[4:8]
        uv = mi.Point2f(
            *(mi.Float(inverse[2 * k] * x[0] + inverse[2 * k + 1] * x[1]) for k in (0, 1))
        )
        tangent = mi.Vector2f(
            *(mi.Float(inverse[2 * k] * dx[0] + inverse[2 * k + 1] * dx[1]) for k in (0, 1))
        )
        return CurvePoint(uv, tangent, mi.Float(m[2]), mi.Float(m[3]))

    def _evaluate(
        self, n: int, start: Any, t: Any, active: Any, points: Any
    ) -> tuple[list[Any], list[Any]]:
        """Return homogeneous points of curves of degree `n`, and how they change by `t`."""
        net = []
        for i in range(n + 1):
            row = 3 * dr.gather(mi.UInt32, self.index, start + i, active)
            net.append([dr.gather(self.number, points, row + c, active) for c in range(3)])
        up, down = [self.number(1.0)], [self.number(1.0)]
        for _ in range(n):
            up.append(up[-1] * t)
            down.append(down[-1] * (1 - t))
        basis = [comb(n, i) * up[i] * down[n - i] for i in range(n + 1)]
        lower = [comb(n - 1, i) * up[i] * down[n - 1 - i] for i in range(n)]
        value = [sum(b * p[c] for b, p in zip(basis, net)) for c in range(3)]
        partial = [
            n * sum(b * (q[c] - p[c]) for b, p, q in zip(lower, net, net[1:])) for c in range(3)
        ]
        return value, partial
