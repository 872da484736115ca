"""Points on Bézier shapes, distributed nearly by area, with their exact density."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import GeometryError
from ..geometry.aspheres import LEG, START, EvenAsphere
from ..geometry.surface_area import is_bounded, left_of_cells
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from ..kernels.arrays import upload
from ..kernels.trim import keep

__all__ = ["SurfaceSampling", "direction_sample", "per_solid_angle"]

#: Cells of one shape: enough for the density to be nearly uniform, few enough for the cache.
_CELLS = 4096
#: Least density of a cell's corner, as a part of the cell's mean: no point has density 0.
_FLOOR = 0.125
#: What a cell without any light seen in it counts, as a part of the mean of all.
_BLIND = 0.1


def _resolution(count: int, fine: bool) -> int:
    """Return into how many parts the edges of `count` patches are cut."""
    return int(np.clip(np.sqrt(_CELLS / count), 1, 16)) * (3 if fine else 1)


def _lattice(r: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the cells of a lattice of edge length ``1/r`` in the triangle of parameters.

    Cell ``(i, j, 0)`` has the corners ``(i, j), (i+1, j), (i, j+1)`` in units of ``1/r``, and
    ``(i, j, 1)`` is its neighbour ``(i+1, j+1), (i, j+1), (i+1, j)``.

    Returns
    -------
    valid : (r, r, 2) bool array
        Which cells are in the triangle: `N` of them.
    corners, inner : (N, 3, 2) arrays
        Their corners, and the points of the three-point rule.
    """
    i, j = np.meshgrid(np.arange(r), np.arange(r), indexing="ij")
    valid = np.stack([i + j < r, i + j < r - 1], axis=-1)
    origin = np.stack([i, j], axis=-1)[:, :, None]
    points = []
    for offset in (np.array([[0, 0], [1, 0], [0, 1]]), np.array([[1, 1], [4, 1], [1, 4]]) / 6):
        uv = np.stack([origin + offset, origin + 1 - offset], axis=2) / r
        points.append(uv[valid])
    return valid, points[0], points[1]


def _cell_densities(patches: BezierTriangles, trims: Trims | None, r: int) -> np.ndarray:
    """Return ``|dp_du x dp_dv|`` at the corners of the cells of `_lattice`.

    Values are at least `_FLOOR` times the mean of the three-point rule: corners may be collapsed.

    Returns
    -------
    (P, r, r, 2, 3) array
        Zeros for cells outside of the triangle, and for those that are trimmed away.
    """
    valid, corners, inner = _lattice(r)
    points = np.concatenate([corners, inner]).reshape(-1, 2)
    count = len(patches)
    d = patches.differential(np.repeat(np.arange(count), len(points)), np.tile(points, (count, 1)))
    density = np.linalg.norm(np.cross(d.dp_du, d.dp_dv), axis=1).reshape(count, 2, -1, 3)
    floor = _FLOOR * density[:, 1].mean(axis=2, keepdims=True)
    out = np.zeros((count, r, r, 2, 3))
    out[:, valid] = np.maximum(density[:, 0], floor)
    if trims is not None:
        trimmed = np.flatnonzero(trims.region >= 0)
        several = np.tile(corners, (len(trimmed), 1, 1))
        left = left_of_cells(trims, np.repeat(trimmed, len(corners)), several) > 0
        part = out[trimmed]
        part[:, valid] *= left.reshape(len(trimmed), -1, 1)
        out[trimmed] = part
    return out


def _asphere_densities(asphere: EvenAsphere, matrix: np.ndarray, r: int) -> np.ndarray:
    """Return what `_cell_densities` does for an asphere under a linear map ``(3, 3)``."""
    valid, corners, inner = _lattice(r)
    points = (np.concatenate([corners, inner]) * LEG - START) * asphere.aperture
    size = asphere.aperture
    s = np.minimum((points**2).sum(axis=2), size**2)
    slope = asphere.derivatives(s)[1]
    n = np.stack([*np.moveaxis(-2 * slope[..., None] * points, 2, 0), np.ones_like(s)], axis=-1)
    n = n @ (np.linalg.det(matrix) * np.linalg.inv(matrix))  # areas go with the cofactors
    density = (np.linalg.norm(n, axis=-1) * (LEG * size) ** 2).reshape(2, -1, 3)
    # a cell counts unless all of it is beyond a rim
    distance = np.linalg.norm(points.reshape(2, -1, 3, 2)[1].mean(axis=1), axis=1)
    reach = 0.75 * LEG * size / r  # from the middle of a cell to its corners, at most
    kept = (distance <= size + reach) & (distance >= asphere.inner - reach)
    out = np.zeros((1, r, r, 2, 3))
    out[:, valid] = np.where(kept[:, None], density[0], 0.0)
    return out


def _cell_emission(data: Any, number: int, first: int, r: int) -> np.ndarray | None:
    """Return how much more than the least the cells of a shape emit, ``(P, r, r, 2, 1)``.

    The radiance along the normal at three points of each cell, to which a part of its mean is
    added: the points may miss what is bright. None if no cell emits any.
    """
    shape = data.shapes[number]
    valid, _corners, inner = _lattice(r)
    count = len(shape.patches)
    uv = np.tile(inner.reshape(-1, 2), (count, 1)).T.astype(np.float32)
    with dr.suspend_grad():
        patch = mi.UInt32(np.repeat(np.arange(first, first + count), 3 * len(inner)))
        u, v = mi.Float(uv[0].copy()), mi.Float(uv[1].copy())
        point, n, _density = data.tables.point_and_normal(patch, u, v, mi.Bool(True))
        si = dr.zeros(mi.SurfaceInteraction3f, len(uv[0]))
        si.p, si.n, si.uv = point, n, data.tables.coordinates(patch, u, v, mi.Bool(True))
        si.sh_frame, si.wi, si.prim_index = mi.Frame3f(n), mi.Vector3f(0, 0, 1), patch - first
        si.shape = dr.gather(mi.ShapePtr, data.pointers, mi.UInt32(number))
        if mi.is_spectral:
            visible = np.linspace(430, 650, len(si.wavelengths)).tolist()  # in nm
            si.wavelengths = type(si.wavelengths)(*visible)
        value = mi.unpolarized_spectrum(shape.emitter().eval(si, mi.Bool(True)))
    radiance = np.array(value, dtype=np.float64)
    radiance = radiance.reshape(-1, count, len(inner), 3).mean(axis=(0, 3))
    if not (np.isfinite(radiance).all() and (radiance >= 0).all() and radiance.any()):
        return None
    out = np.zeros((count, r, r, 2, 1))
    out[:, valid, 0] = radiance + _BLIND * radiance.mean()
    return out


def _size(patches: BezierTriangles) -> float:
    """Return the extent of the corners and centroids."""
    uv = np.array([[1, 0], [0, 1], [0, 0], [1 / 3, 1 / 3]])
    count = len(patches)
    points = patches.points(np.repeat(np.arange(count), 4), np.tile(uv, (count, 1)))
    return float(np.ptp(points, axis=0).max())


def per_solid_angle(area: Any, ds: Any, n: Any) -> Any:
    """Return a density by area as one by solid angle, along a direction sample to a normal `n`."""
    cosine = dr.abs(dr.dot(ds.d, n))
    return dr.select(cosine > 0, area * dr.square(ds.dist) / cosine, 0.0)


def direction_sample(ps: Any, ref: Any) -> Any:
    """Turn a `mi.PositionSample3f` into the direction sample seen from `ref` (by solid angle)."""
    ds = mi.DirectionSample3f(ps)
    ds.d = ps.p - ref.p
    dist2 = dr.squared_norm(ds.d)
    ds.dist = dr.sqrt(dist2)
    ds.d = ds.d / ds.dist
    cosine = dr.abs(dr.dot(ds.d, ds.n))
    ds.pdf = dr.select(cosine > 0, ps.pdf * dist2 / cosine, 0.0)
    ds.time = ref.time
    return ds


class SurfaceSampling:
    """Sampling of some of the shapes of a structure.

    A shape is cut into cells in its parameters. The density in ``(u, v)`` is, up to a factor,
    linear in each cell, and ``|dp_du x dp_dv|`` in its corners; by area it is this number over
    ``|dp_du x dp_dv|`` at the point. That is exact for any surface, and nearly constant. In cells
    on a trimming curve a sample may fall on what is trimmed away; its density is then 0, and it
    counts as none.

    Parameters
    ----------
    data : SceneData
        The structure.
    numbers : list of int
        Which of ``data.shapes`` may be sampled.
    by_emission : bool
        Sample shapes with a textured emitter also in proportion to what the parts of their
        surface emit (when this is made: later changes of a texture do no harm but to the noise).
    instanced : bool
        Allow shapes with instances, which are sampled before the maps of these.

    Raises
    ------
    GeometryError
        If a shape has no finite area.
    """

    def __init__(
        self, data: Any, numbers: list[int], by_emission: bool = False, instanced: bool = False
    ) -> None:
        self.data = data
        self.numbers = numbers
        cdf, corners, rows = [], [], []
        offset = 0
        firsts = np.cumsum([0] + [len(s.patches) for s in data.shapes])
        for number in numbers:
            shape = data.shapes[number]
            if shape.instances is not None and not instanced:
                raise GeometryError.expected(
                    f'shape "{shape.id()}"', "one without instances to sample", "instances"
                )
            emitter = shape.emitter() if by_emission else None
            varies = emitter is not None and mi.has_flag(
                emitter.flags(), mi.EmitterFlags.SpatiallyVarying
            )
            # finer where samples may fall on what is trimmed away, or on what is dark
            holes = shape.trims is not None or shape.asphere is not None
            r = _resolution(len(shape.patches), holes or varies)
            bounded = is_bounded(shape.patches)
            density = np.zeros((1, 3))
            if bounded:
                if shape.asphere is None:
                    density = _cell_densities(shape.patches, shape.trims, r)
                else:
                    linear = shape.object_to_world[:3, :3]
                    density = _asphere_densities(shape.asphere, linear, r)
                emission = _cell_emission(data, number, firsts[number], r) if varies else None
                density = (density if emission is None else density * emission).reshape(-1, 3)
            total = density.sum() / (6 * r * r)
            if not (np.isfinite(total) and total > 0):
                raise GeometryError.expected(
                    f'shape "{shape.id()}"',
                    "a surface of finite area to sample or to carry an emitter",
                    "area 0" if bounded else "points at infinity",
                )
            corners.append(density / total)
            cdf.append(np.cumsum(density.sum(axis=1)) / density.sum())
            rows.append((firsts[number], r, offset, len(density)))
            offset += len(density)
        self.cdf = upload(mi.Float, np.concatenate(cdf))
        self.corners = upload(mi.Float, np.concatenate(corners))
        self._size = max(_size(data.shapes[k].patches) for k in numbers)
        self.longest = max(row[3] for row in rows)
        self.rows = upload(mi.UInt32, np.array(rows, dtype=np.uint32))

    def _row(self, which: Any, active: Any) -> list[Any]:
        first, r, offset, count = (
            dr.gather(mi.UInt32, self.rows, 4 * which + k, active) for k in range(4)
        )
        # idle lanes read zeros, and an integer division by zero ends the process
        return [first, dr.maximum(r, 1), offset, dr.maximum(count, 1)]

    def _corners(self, cell: Any, active: Any) -> list[Any]:
        return [dr.gather(mi.Float, self.corners, 3 * cell + k, active) for k in range(3)]

    def sample(self, which: Any, sample: Any, active: Any) -> tuple[Any, Any]:
        """Sample a position.

        Parameters
        ----------
        which : UInt32
            Index into `numbers`.
        sample : Point2f
            Uniform in the unit square; each number is used for a choice, then once more.
        active : Bool

        Returns
        -------
        mi.PositionSample3f
            ``uv`` are texture coordinates, ``time`` is not set.
        UInt32
            The patch, numbered as a hit's.
        """
        patch, u, v, linear = self.sample_parameters(which, sample, active)
        return self.position(patch, u, v, linear, active), patch

    def sample_parameters(self, which: Any, sample: Any, active: Any) -> tuple[Any, ...]:
        """Sample patch, parameters and, the last, their density in ``(u, v)``; see `sample`."""
        first, r, offset, count = self._row(which, active)
        # bisection between bounds that differ from lane to lane
        cell, end = mi.UInt32(offset), offset + count - 1
        for _ in range(self.longest.bit_length()):
            middle = (cell + end) >> 1
            right = dr.gather(mi.Float, self.cdf, middle, active) < sample.x
            cell, end = dr.select(right, middle + 1, cell), dr.select(right, end, middle)
        cell = dr.minimum(cell, offset + count - 1)
        upper = dr.gather(mi.Float, self.cdf, cell, active)
        lower = dr.gather(mi.Float, self.cdf, cell - 1, active & (cell > offset))
        x = dr.clip((sample.x - lower) / (upper - lower), 0.0, dr.one_minus_epsilon(mi.Float))
        # A linear density is a mixture of three, each proportional to one barycentric
        # coordinate b. That one is distributed as Beta(2, 2), whose distribution function
        # b^2 (3 - 2b) has this inverse; the others divide the rest uniformly.
        c = self._corners(cell, active)
        b = 0.5 - dr.sin(dr.asin(1.0 - 2.0 * x) / 3.0)
        y = sample.y * (c[0] + c[1] + c[2])
        choice = dr.select(y < c[0], mi.UInt32(0), dr.select(y < c[0] + c[1], mi.UInt32(1), 2))
        below = dr.select(choice == 0, 0.0, dr.select(choice == 1, c[0], c[0] + c[1]))
        own = dr.select(choice == 0, c[0], dr.select(choice == 1, c[1], c[2]))
        y = dr.clip((y - below) / own, 0.0, 1.0)
        d, e = (1.0 - b) * y, (1.0 - b) * (1.0 - y)
        a = dr.select(choice == 1, b, d)
        b = dr.select(choice == 2, b, e)
        local = cell - offset
        down = (local & 1) == 1
        j = (local >> 1) % r
        i = ((local >> 1) // r) % r
        patch = first + (local >> 1) // (r * r)
        step = 1.0 / mi.Float(r)
        u = (mi.Float(i) + dr.select(down, 1.0 - a, a)) * step
        v = (mi.Float(j) + dr.select(down, 1.0 - b, b)) * step
        linear = dr.fma(a, c[1] - c[0], dr.fma(b, c[2] - c[0], c[0]))
        if self.data.trim is not None:  # what is trimmed away is no sample
            on_surface = mi.Bool(keep(self.data.trim, patch, u, v, active))
            linear = dr.select(on_surface, linear, 0.0)
        if self.data.tables.aspheres is not None:  # nor what is beyond a rim
            within = self.data.tables.aspheres.holds(patch, u, v, active)
            linear = dr.select(within, linear, 0.0)
        return patch, u, v, linear

    def position(self, patch: Any, u: Any, v: Any, linear: Any, active: Any) -> Any:
        """Return the `mi.PositionSample3f` of what `sample_parameters` returned."""
        return self.position_and_error(patch, u, v, linear, active)[0]

    def position_and_error(
        self, patch: Any, u: Any, v: Any, linear: Any, active: Any
    ) -> tuple[Any, Any]:
        """Return what `position` does, and the error of its point along its normal."""
        tables = self.data.tables
        point, n, density, p_err = tables.point_and_error(patch, u, v, active)
        ps = dr.zeros(mi.PositionSample3f, dr.width(u))
        ps.p, ps.n = point, n
        ps.uv = tables.coordinates(patch, u, v, active)
        ps.pdf = dr.select(mi.Bool(active) & (density > 0), linear / density, 0.0)
        ps.delta = False
        return ps, p_err

    def _cell(self, which: Any, patch: Any, uv: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the cell that parameters are in, and the place in it."""
        first, r, offset, _count = self._row(which, active)
        last = mi.Int32(r) - 1
        x, y = uv.x * mi.Float(r), uv.y * mi.Float(r)
        i = dr.clip(mi.Int32(dr.floor(x)), 0, last)
        j = dr.clip(mi.Int32(dr.floor(y)), 0, last - i)
        a, b = x - mi.Float(i), y - mi.Float(j)
        down = (a + b > 1.0) & (i + j < last)
        a, b = dr.select(down, 1.0 - a, a), dr.select(down, 1.0 - b, b)
        cell = ((patch - first) * r + mi.UInt32(i)) * r + mi.UInt32(j)
        return offset + 2 * cell + dr.select(down, mi.UInt32(1), 0), a, b

    def invert(self, which: Any, patch: Any, uv: Any, active: Any) -> Any:
        """Return a number of the unit square that `sample_parameters` maps to these parameters.

        Of the three that there are, that of the part with the highest density.
        """
        cell, a, b = self._cell(which, patch, uv, active)
        offset = self._row(which, active)[2]
        c = self._corners(cell, active)
        part = [c[0] * (1.0 - a - b), c[1] * a, c[2] * b]
        first = (part[0] >= part[1]) & (part[0] >= part[2])
        second = ~first & (part[1] >= part[2])
        beta = dr.select(first, 1.0 - a - b, dr.select(second, a, b))
        rest = dr.maximum(1.0 - beta, 1e-12)
        y = dr.clip(dr.select(second, 1.0 - b / rest, a / rest), 0.0, 1.0)
        below = dr.select(first, 0.0, dr.select(second, c[0], c[0] + c[1]))
        own = dr.select(first, c[0], dr.select(second, c[1], c[2]))
        upper = dr.gather(mi.Float, self.cdf, cell, active)
        lower = dr.gather(mi.Float, self.cdf, cell - 1, active & (cell > offset))
        x = dr.fma(beta * beta * (3.0 - 2.0 * beta), upper - lower, lower)
        return mi.Point2f(x, dr.fma(y, own, below) / (c[0] + c[1] + c[2]))

    def pdf(self, which: Any, patch: Any, uv: Any, active: Any) -> Any:
        """Return the density by area at parameters `uv` of a patch (numbered as a hit's)."""
        cell, a, b = self._cell(which, patch, uv, active)
        c = self._corners(cell, active)
        linear = dr.fma(a, c[1] - c[0], dr.fma(b, c[2] - c[0], c[0]))
        _point, _n, density = self.data.tables.point_and_normal(patch, uv.x, uv.y, active)
        return dr.select(active & (density > 0), linear / density, 0.0)

    def pdf_at(self, which: Any, p: Any, n: Any, active: Any) -> Any:
        """Return the density by area at a point of the surface with the normal `n`.

        A short ray along the normal finds the patch; of a structure with several shapes it may
        find another shape that is as near.
        """
        # far above the rounding of a point, far below the distance of two sheets
        reach = 2.0**-14 * (dr.max(dr.abs(p)) + self._size)
        ray = dr.zeros(mi.Ray3f, dr.width(p))
        ray.o, ray.d, ray.maxt = dr.fma(reach, n, p), -mi.Vector3f(n), 2.0 * reach
        hit = self.data.preliminary(ray, active)
        return self.pdf(which, hit.patch, hit.pi.prim_uv, hit.bezier & mi.Bool(active))
