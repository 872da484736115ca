"""How trimming curves move where a ray passes one of them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.arrays import upload
from ..silhouette import SilhouetteCurves

__all__ = ["TrimMotion"]

#: Newton steps from the foot on a chord, a 32nd of a curve, to the foot on the curve.
_STEPS = 3


class TrimMotion:
    """The trimming curves with derivatives of a structure, by patches.

    Parameters
    ----------
    data : SceneData
    numbers : list of int
        Which of its shapes.
    """

    def __init__(self, data: Any, numbers: list[int]) -> None:
        curves = SilhouetteCurves(data, numbers, None)
        self.trims = curves.trims
        cuts = np.array(curves.cuts)[: len(curves)]
        rows = np.flatnonzero(cuts > 0)
        patch = curves.segments.patch[rows]
        order = np.argsort(patch, kind="stable")
        rows, patch = rows[order], patch[order]
        patches = sum(len(s.patches) for s in data.shapes)
        first = np.searchsorted(patch, np.arange(patches + 1))
        self.first = upload(mi.UInt32, first.astype(np.uint32))
        ends = np.concatenate([curves.segments.a[rows], curves.segments.b[rows]], axis=1)
        self.ends = upload(mi.Float, np.concatenate([ends, np.zeros((1, 4))]))
        self.rows = upload(mi.UInt32, np.append(cuts[rows] - 1, 0).astype(np.uint32))

    @staticmethod
    def of(data: Any) -> TrimMotion | None:
        """Return those of a structure, None where no trimming curve has derivatives."""
        if data.trim is None:
            return None
        tensors = [shape.trim_points for shape in data.shapes]
        numbers = [k for k, t in enumerate(tensors) if t is not None and dr.grad_enabled(t)]
        return TrimMotion(data, numbers) if numbers else None

    def nearest(self, patch: Any, uv: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return rows of the nearest segments, parameters there, and whether there is one."""
        begin, end = (dr.gather(mi.UInt32, self.first, patch + k, active) for k in (0, 1))
        width = dr.width(uv)

        def step(k: Any, best: Any, which: Any, at: Any) -> tuple[Any, ...]:
            x = [dr.gather(mi.Float, self.ends, 4 * k + c, active) for c in range(4)]
            a, chord = mi.Point2f(x[0], x[1]), mi.Vector2f(x[2] - x[0], x[3] - x[1])
            s = dr.clip(dr.dot(uv - a, chord) / dr.squared_norm(chord), 0.0, 1.0)
            away = dr.squared_norm(uv - (a + s * chord))
            nearer = away < best
            return (
                k + 1,
                dr.select(nearer, away, best),
                dr.select(nearer, k, which),
                dr.select(nearer, s, at),
            )

        state = begin, dr.full(mi.Float, dr.inf, width), mi.UInt32(begin), dr.zeros(mi.Float, width)
        _k, _best, which, s = dr.while_loop(
            state, lambda k, _best, _which, _at: active & (k < end), step, label="bezier trims"
        )
        active = active & (begin < end)
        row = dr.gather(mi.UInt32, self.rows, which, active)
        assert self.trims is not None
        for _ in range(_STEPS):
            point = self.trims.point(row, s, active)
            square = dr.squared_norm(point.tangent)
            off = dr.dot(uv - point.uv, point.tangent)
            s = dr.clip(s + dr.select(active & (square > 0), off / square, 0.0), 0.0, 1.0)
        return row, s, active

    def shift(self, row: Any, s: Any, active: Any) -> tuple[Any, Any]:
        """Return how points of curves move in the parameters of their patch, with derivatives."""
        assert self.trims is not None
        uv = self.trims.point(row, s, active, self.trims.attached()).uv
        du, dv = (dr.replace_grad(mi.Float(0), dr.select(active, x, 0.0)) for x in (uv.x, uv.y))
        return du, dv
