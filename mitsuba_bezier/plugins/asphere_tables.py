"""Even aspheres among the patches of a structure: points and partials from their own formula.

To all else an asphere is a patch: a triangle of parameters ``(u, v)`` that are linear in x and y
(`geometry.aspheres.LEG`), and holds the disk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.aspheres import LEG, START
from ..kernels.arrays import upload, upload_wide
from ..kernels.records import Record
from ..kernels.revolution_records import sag_and_slopes
from ..kernels.two_float import TwoFloat, coarse, fma, select, sqrt
from .wide_vectors import place_of, wide_types, widen

__all__ = ["AsphereTables"]

#: The number of an asphere in place of a patch that is none.
_NONE = 0xFFFFFFFF


def _as(like: Any, x: Any) -> Any:
    """Return a number in the type of another one."""
    return TwoFloat.of(x) if isinstance(like, TwoFloat) else type(like)(coarse(x))


@cache
def _layout(count: int) -> Record:
    """Return the layout of an asphere: its map to space, from the patch's origin, and its sag."""
    return Record(
        np.float64,
        linear=(3, 3),
        shift=(3,),
        aperture=(),
        inner=(),
        curvature=(),
        conic=(),
        coefficients=(max(count, 1),),
    )


@dataclass
class AsphereTables:
    """The aspheres of a list of shapes."""

    number: Any  #: UInt, of each patch, `_NONE` where it is no asphere
    values: Any  #: wide, x `_layout`
    terms: int  #: coefficients of each; fewer are padded

    @staticmethod
    def of(shapes: list[Any], origins: list[np.ndarray]) -> AsphereTables | None:
        """Return the aspheres among shapes, given the origins of their patches; None if none is."""
        found = [k for k, shape in enumerate(shapes) if shape.asphere is not None]
        if not found:
            return None
        numbers = [np.full(len(shape.patches), _NONE, dtype=np.uint32) for shape in shapes]
        count = max(len(shapes[k].asphere.coefficients) for k in found)
        layout = _layout(count)
        rows = []
        for i, k in enumerate(found):
            shape, surface = shapes[k], shapes[k].asphere
            numbers[k][:] = i
            matrix = shape.object_to_world
            coefficients = np.zeros(max(count, 1))
            coefficients[: len(surface.coefficients)] = surface.coefficients
            rows.append(
                layout.pack(
                    1,
                    linear=matrix[:3, :3],
                    shift=matrix[:3, 3] - origins[k][0, :3],
                    aperture=surface.aperture,
                    inner=surface.inner,
                    curvature=surface.curvature,
                    conic=surface.conic,
                    coefficients=coefficients,
                )
            )
        return AsphereTables(
            upload(mi.UInt32, np.concatenate(numbers)),
            upload_wide(wide_types(), np.concatenate(rows)),
            count,
        )

    def attached(self, shapes: list[Any]) -> AsphereTables:
        """Return the same with the derivatives of the shapes' parameters."""
        layout = _layout(self.terms)
        values = type(self.values)(dr.detach(self.values))
        number = type(values)
        zero = mi.UInt32(0)
        first = 0
        for shape in shapes:
            if shape.asphere is None:
                continue
            if dr.grad_enabled(shape.to_world, *shape.sag_parameters):
                matrix = shape.to_world.matrix
                entries = {
                    layout.first["linear"] + 3 * i + j: matrix[i, j]
                    for i in range(3)
                    for j in range(3)
                }
                entries |= {layout.first["shift"] + i: matrix[i, 3] for i in range(3)}
                curvature, conic, coefficients = shape.sag_parameters
                entries[layout.first["curvature"]] = curvature
                entries[layout.first["conic"]] = conic
                for slot, value in entries.items():
                    dr.scatter(values, number(value), zero + place_of(values, first + slot))
                width = dr.width(coefficients) if len(shape.asphere.coefficients) else 0
                if width:
                    index = dr.arange(mi.UInt32, width) + (first + layout.first["coefficients"])
                    dr.scatter(values, number(coefficients.array), place_of(values, index))
            first += layout.size
        return replace(self, values=dr.replace_grad(self.values, values))

    @property
    def _has_float64(self) -> bool:
        return type(self.values) is mi.Float64

    def _wide(self, x: Any) -> Any:
        """Return a number as those of the records are."""
        return widen(not self._has_float64, x)

    def _gather(self, patch: Any, active: Any, through: str | None = None) -> tuple[Any, Any]:
        """Return which patches are aspheres, and their records."""
        number = dr.gather(mi.UInt32, self.number, patch, active)
        mine = mi.Bool(active) & (number != _NONE)
        record = _layout(self.terms).gather(self.values, dr.select(mine, number, 0), mine, through)
        return mine, record

    def lifted(self, h: list[list[Any]], patch: Any, u: Any, v: Any, active: Any) -> Any:
        """Return points and partials as `evaluate_second` does, those of aspheres their own."""
        mine, m = self._gather(patch, active)
        size = m.aperture
        step = LEG * size
        x, y = (self._wide(w) * step - START * size for w in (u, v))
        bend = (1.0 + m.conic) * m.curvature * m.curvature
        f, f1, f2 = sag_and_slopes(m.curvature, bend, m.coefficients, fma(x, x, y * y))
        zero, twice = 0.0 * coarse(x), 2.0 * f1
        cx, cy, slope, square = coarse(x), coarse(y), coarse(step), coarse(step * step)
        across = 4.0 * f2 * cx * cy * square
        local = [
            [x, y, f],
            [slope, zero, twice * cx * slope],
            [zero, slope, twice * cy * slope],
            [zero, zero, dr.fma(4.0 * f2 * cx, cx, twice) * square],
            [zero, zero, across],
            [zero, zero, dr.fma(4.0 * f2 * cy, cy, twice) * square],
        ]
        out = []
        for k, (old, point) in enumerate(zip(h, local)):
            linear = m.linear if k == 0 else [[coarse(a) for a in row] for row in m.linear]
            new = [sum(a * b for a, b in zip(row, point)) for row in linear]
            if k == 0:
                new = [a + b for a, b in zip(new, m.shift)]
            new.append(zero + (1.0 if k == 0 else 0.0))
            out.append([select(mine, _as(b, a), b) for a, b in zip(new, old)])
        return out

    def holds(self, patch: Any, u: Any, v: Any, active: Any) -> Any:
        """Return whether parameters are between the rims of an asphere; true for other patches."""
        mine, m = self._gather(patch, active, "inner")
        x, y = (self._wide(w) * LEG - START for w in (u, v))
        r = sqrt(fma(x, x, y * y)) * m.aperture
        return ~mine | ((r <= m.aperture) & (r >= m.inner))
