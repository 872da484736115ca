"""What kernels know of even aspheres, see `leaves.revolution`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from ..leaves.records import RevolutionLeaves
from .arrays import Types, upload, upload_wide
from .records import Record
from .two_float import coarse, fma, maximum, sqrt

__all__ = ["Revolutions", "revolution_record", "sag_and_slopes", "upload_revolutions"]


@cache
def revolution_record(count: int) -> Record:
    """Return the layout of an asphere with `count` coefficients.

    `axes` and `shift` take points to axes in which the aperture's radius is one; `inner2` is the
    square of the hole's, `cells` the number of the first cell less the bits of it, and `steps` the
    cells in an octave of the grade.
    """
    return Record(
        np.float64,
        shift=(3,),
        axes=(3, 3),
        low=(),
        high=(),
        curvature=(),
        bend=(),
        inner2=(),
        grading=(),
        cells=(),
        steps=(),
        coefficients=(max(count, 1),),
    )


def sag_and_slopes(
    curvature: Any, bend: Any, coefficients: list[Any], s: Any
) -> tuple[Any, Any, Any]:
    """Return the sag of an asphere and its first and second derivatives by ``s = r^2``.

    As `EvenAsphere.derivatives`; beyond the conic's end some number that is finite. If numbers are
    `TwoFloat` the sag is one as well, derivatives are coarse.
    """
    f, near = 0.0 * s, coarse(s)
    f1 = half = 0.0 * near
    for c in (*reversed(coefficients), 0.0):
        half = dr.fma(half, near, f1)
        f1 = dr.fma(f1, near, coarse(f))
        f = fma(f, s, c)
    grade = maximum(fma(-bend, s, 1.0), 1e-6)
    root = sqrt(grade)
    share = 0.5 * coarse(curvature) / coarse(root)
    f = f + curvature * s / (1.0 + root)
    return f, f1 + share, 2.0 * half + 0.5 * share * coarse(bend) / coarse(grade)


@dataclass
class Revolutions:
    """The even aspheres of a structure, on the device."""

    first: Any  #: UInt, the number of the first in the BVH; opaque as the next
    first_domain: Any  #: UInt, ... and among domains
    coefficients: int  #: of each, padded with zeros
    records: Any  #: wide, x `revolution_record`
    cells: Any  #: Float32, eight numbers each, see `leaves.revolution.Profile`
    bytes: int
    count: int


def upload_revolutions(
    leaves: RevolutionLeaves, ty: Types, first: int, first_domain: int
) -> Revolutions | None:
    """Return the aspheres on the device, None if there are none."""
    if not len(leaves):
        return None
    profiles = leaves.profile.tolist()
    count = max(len(p.surface.coefficients) for p in profiles)
    coefficients = np.zeros((len(profiles), max(count, 1)))
    for row, p in zip(coefficients, profiles):
        row[: len(p.surface.coefficients)] = p.surface.coefficients
    starts = np.cumsum([0, *(len(p.cells) for p in profiles)])[:-1]
    records = revolution_record(count).pack(
        len(profiles),
        shift=leaves.shift,
        axes=leaves.axes,
        low=[p.low for p in profiles],
        high=[p.high for p in profiles],
        curvature=[p.surface.curvature for p in profiles],
        bend=[p.surface.bend for p in profiles],
        inner2=[p.surface.inner**2 for p in profiles],
        grading=[p.grading for p in profiles],
        cells=[start - p.first for start, p in zip(starts.tolist(), profiles)],
        steps=[p.bits for p in profiles],
        coefficients=coefficients,
    )
    cells = np.concatenate([p.cells for p in profiles])
    return Revolutions(
        first=dr.opaque(ty.UInt, first),
        first_domain=dr.opaque(ty.UInt, first_domain),
        coefficients=count,
        records=upload_wide(ty, records),
        cells=upload(ty.Float32, cells),
        bytes=records.nbytes + cells.nbytes,
        count=len(profiles),
    )
