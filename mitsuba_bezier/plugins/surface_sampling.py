"""Points on Bézier shapes, distributed by area, with their exact density."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import GeometryError
from ..geometry.triangles import BezierTriangles
from ..kernels.arrays import upload

__all__ = ["SurfaceSampling"]

#: Cells of one shape: enough for the density to be nearly uniform, few enough for the cache.
_CELLS = 4096


def _resolution(count: int) -> int:
    """Return into how many parts the edges of `count` patches are cut."""
    return int(np.clip(np.sqrt(_CELLS / count), 1, 16))


def _cell_areas(patches: BezierTriangles, r: int) -> np.ndarray:
    """Return areas ``(P, r, r, 2)`` of the cells of a lattice of edge length ``1/r``.

    Cell ``(i, j, 0)`` has the corners ``(i, j), (i+1, j), (i, j+1)`` in units of ``1/r``, and
    ``(i, j, 1)`` is its neighbour ``(i+1, j+1), (i, j+1), (i+1, j)``. The area is that of the
    three-point rule; it decides how often a cell is chosen, not the density within.
    """
    i, j = np.meshgrid(np.arange(r), np.arange(r), indexing="ij")
    inner = np.array([[4, 1], [1, 4], [1, 1]]) / 6
    uv = np.empty((r, r, 2, 3, 2))
    corner = np.stack([i, j], axis=-1)[:, :, None]
    uv[:, :, 0] = (corner + inner) / r
    uv[:, :, 1] = (corner + 1 - inner) / r
    valid = np.stack([i + j < r, i + j < r - 1], axis=-1)
    out = np.zeros((len(patches), r, r, 2))
    points = uv[valid].reshape(-1, 2)
    for p in range(len(patches)):
        d = patches.differential(p, points)
        density = np.linalg.norm(np.cross(d.dp_du, d.dp_dv), axis=1).reshape(-1, 3).mean(axis=1)
        out[p][valid] = density / (2 * r * r)
    return out


class SurfaceSampling:
    """Sampling of some of the shapes of a structure.

    A shape is cut into cells in its parameters; a cell is chosen by its area, a point in it
    uniformly in ``(u, v)``. The density by area is then the probability of the cell over its
    parameter area and over ``|dp_du x dp_dv|``: exact, whatever the areas of the cells are.

    Parameters
    ----------
    data : SceneData
        The structure.
    numbers : list of int
        Which of ``data.shapes`` may be sampled.

    Raises
    ------
    GeometryError
        If a shape has no finite area.
    """

    def __init__(self, data: Any, numbers: list[int]) -> None:
        self.data = data
        self.numbers = numbers
        cdf, probability, rows = [], [], []
        offset = 0
        firsts = np.cumsum([0] + [len(s.patches) for s in data.shapes])
        for number in numbers:
            shape = data.shapes[number]
            r = _resolution(len(shape.patches))
            areas = _cell_areas(shape.patches, r).ravel()
            total = areas.sum()
            if not (np.isfinite(total) and total > 0) or (shape.patches.weights == 0).any():
                raise GeometryError.expected(
                    f'shape "{shape.id()}"',
                    "a surface of finite area to sample or to carry an emitter",
                    "points at infinity" if total > 0 or np.isnan(total) else "area 0",
                )
            probability.append(areas / total)
            cdf.append(np.cumsum(areas) / total)
            rows.append((firsts[number], r, offset, len(areas)))
            offset += len(areas)
        self.cdf = upload(mi.Float, np.concatenate(cdf))
        self.probability = upload(mi.Float, np.concatenate(probability))
        self.longest = max(row[3] for row in rows)
        self.rows = upload(mi.UInt32, np.array(rows, dtype=np.uint32))

    def _row(self, which: Any, active: Any) -> list[Any]:
        first, r, offset, count = (
            dr.gather(mi.UInt32, self.rows, 4 * which + k, active) for k in range(4)
        )
        # idle lanes read zeros, and an integer division by zero ends the process
        return [first, dr.maximum(r, 1), offset, dr.maximum(count, 1)]

    def sample(self, which: Any, sample: Any, active: Any) -> Any:
        """Sample a position.

        Parameters
        ----------
        which : UInt32
            Index into `numbers`.
        sample : Point2f
            Uniform in the unit square; the first is used for the cell, then once more.
        active : Bool

        Returns
        -------
        mi.PositionSample3f
        """
        first, r, offset, count = self._row(which, active)
        # bisection between bounds that differ from lane to lane
        cell, end = mi.UInt32(offset), offset + count - 1
        for _ in range(self.longest.bit_length()):
            middle = (cell + end) >> 1
            right = dr.gather(mi.Float, self.cdf, middle, active) < sample.x
            cell, end = dr.select(right, middle + 1, cell), dr.select(right, end, middle)
        cell = dr.minimum(cell, offset + count - 1)
        upper = dr.gather(mi.Float, self.cdf, cell, active)
        p = dr.gather(mi.Float, self.probability, cell, active)
        again = dr.clip((sample.x - (upper - p)) / p, 0.0, dr.one_minus_epsilon(mi.Float))
        # uniform in the unit triangle (Turk's square root map)
        root = dr.sqrt(again)
        a, b = 1.0 - root, sample.y * root
        local = cell - offset
        down = (local & 1) == 1
        j = (local >> 1) % r
        i = ((local >> 1) // r) % r
        patch = (local >> 1) // (r * r)
        a, b = dr.select(down, 1.0 - a, a), dr.select(down, 1.0 - b, b)
        step = 1.0 / mi.Float(r)
        u, v = (mi.Float(i) + a) * step, (mi.Float(j) + b) * step
        return self._position(first + patch, u, v, p, r, active)

    def _position(self, patch: Any, u: Any, v: Any, p: Any, r: Any, active: Any) -> Any:
        point, n, density = self.data.tables.point_and_normal(patch, u, v, active)
        ps = dr.zeros(mi.PositionSample3f, dr.width(u))
        ps.p, ps.n, ps.uv = point, n, mi.Point2f(u, v)
        ps.pdf = dr.select(density > 0, 2.0 * p * mi.Float(r * r) / density, 0.0)
        ps.delta = False
        return ps

    def pdf(self, which: Any, patch: Any, uv: Any, active: Any) -> Any:
        """Return the density by area at parameters `uv` of a patch (numbered as a hit's)."""
        first, r, offset, _count = self._row(which, active)
        last = mi.Int32(r) - 1
        i = dr.clip(mi.Int32(dr.floor(uv.x * mi.Float(r))), 0, last)
        j = dr.clip(mi.Int32(dr.floor(uv.y * mi.Float(r))), 0, last - i)
        down = (uv.x * mi.Float(r) - mi.Float(i)) + (uv.y * mi.Float(r) - mi.Float(j)) > 1.0
        down = down & (i + j < last)
        cell = ((patch - first) * r + mi.UInt32(i)) * r + mi.UInt32(j)
        cell = offset + 2 * cell + dr.select(down, mi.UInt32(1), 0)
        p = dr.gather(mi.Float, self.probability, cell, active)
        _point, _n, density = self.data.tables.point_and_normal(patch, uv.x, uv.y, active)
        return dr.select(active & (density > 0), 2.0 * p * mi.Float(r * r) / density, 0.0)
