"""Vectors of wide numbers (`kernels.arrays.Types`): those of Mitsuba in float64, or pairs.

The functions take either: on `mi.Vector3d` they are Dr.Jit's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..kernels.arrays import Types, dot3, types_of
from ..kernels.float64_use import uses_pairs
from ..kernels.two_float import TwoFloat, fma, select

__all__ = [
    "PairVector",
    "along",
    "choose",
    "cross",
    "detach",
    "dot",
    "dot_rows",
    "narrow",
    "normalized",
    "place_of",
    "single",
    "times",
    "vector",
    "wide_types",
    "widen",
]

_XYZ = range(3)


class PairVector:
    """Three `TwoFloat`."""

    # Dr.Jit walks through these in the state of a branch
    DRJIT_STRUCT = {"x": Any, "y": Any, "z": Any}

    def __init__(self, x: Any = 0.0, y: Any = 0.0, z: Any = 0.0) -> None:
        self.x, self.y, self.z = TwoFloat.of(x), TwoFloat.of(y), TwoFloat.of(z)

    def __getitem__(self, k: int) -> TwoFloat:
        return (self.x, self.y, self.z)[k]

    def __add__(self, other: Any) -> PairVector:
        return PairVector(*(self[k] + other[k] for k in _XYZ))

    def __sub__(self, other: Any) -> PairVector:
        return PairVector(*(self[k] - other[k] for k in _XYZ))

    def __mul__(self, factor: Any) -> PairVector:
        return PairVector(*(self[k] * factor for k in _XYZ))


def wide_types() -> Types:
    """Return the types of Mitsuba's variant, with derivatives."""
    ty = types_of(mi.Float, uses_pairs(mi.Float))
    return replace(ty, Float=mi.Float, Float32=mi.Float, Float64=mi.Float64)


def place_of(buffer: Any, slot: Any) -> Any:
    """Return where a number is that `upload_wide` copied: of two floats, the first."""
    return slot if type(buffer) is mi.Float64 else slot + slot - slot % 8


def widen(pairs: bool, x: Any) -> Any:
    """Return a number as a wide one."""
    return TwoFloat.of(x) if pairs else mi.Float64(x)


def vector(pairs: bool, v: Any) -> Any:
    """Return three numbers as a wide vector."""
    if pairs:
        return PairVector(*(v[k] for k in _XYZ))
    return mi.Vector3d(*(v[k] for k in _XYZ))


def single(v: Any) -> Any:
    """Return the nearest `mi.Vector3f`."""
    return mi.Vector3f(*(v[k].hi for k in _XYZ)) if isinstance(v, PairVector) else mi.Vector3f(v)


def narrow(x: Any) -> Any:
    """Return the nearest `mi.Float`."""
    return x.hi if isinstance(x, TwoFloat) else mi.Float(x)


def detach(v: Any) -> Any:
    """Return a number or a vector without derivatives."""
    if isinstance(v, TwoFloat):
        return TwoFloat(dr.detach(v.hi), None if v.lo is None else dr.detach(v.lo))
    if isinstance(v, PairVector):
        return PairVector(*(detach(v[k]) for k in _XYZ))
    return dr.detach(v)


def dot(a: Any, b: Any) -> Any:
    """Return the scalar product."""
    return dot3(a, b) if isinstance(a, PairVector) else dr.dot(a, b)


def cross(a: Any, b: Any) -> Any:
    """Return the vector product."""
    if not isinstance(a, PairVector):
        return dr.cross(a, b)
    ends = ((1, 2), (2, 0), (0, 1))
    return PairVector(*(fma(a[i], b[j], -(a[j] * b[i])) for i, j in ends))


def normalized(v: PairVector) -> tuple[PairVector, Any]:
    """Return a vector over its largest coordinate, and that as a `mi.Float`, without derivatives.

    Zero stays zero, over zero.
    """
    largest = dr.max(dr.abs(dr.detach(single(v))))
    return v * dr.select(largest > 0.0, dr.rcp(largest), 0.0), largest


def along(t: Any, d: Any, o: Any) -> Any:
    """Return ``o + t d``, for a `mi.Float` t and a `mi.Vector3f` d."""
    if isinstance(o, PairVector):
        return PairVector(*(fma(TwoFloat(t), d[k], o[k]) for k in _XYZ))
    return dr.fma(mi.Float64(t), mi.Vector3d(d), o)


def choose(mask: Any, a: Any, b: Any) -> Any:
    """Return `a` where the mask is set and `b` elsewhere."""
    if isinstance(a, PairVector):
        return PairVector(*(select(mask, a[k], b[k]) for k in _XYZ))
    return dr.select(mask, a, b)


def dot_rows(a: Any, v: Any) -> list[Any]:
    """Return a matrix times three `TwoFloat`."""
    v = [TwoFloat.of(x) for x in v]
    return [dot3(v, [a[i, j] for j in _XYZ]) for i in _XYZ]


def times(a: Any, v: Any) -> Any:
    """Return a matrix times a wide vector."""
    return PairVector(*dot_rows(a, v)) if isinstance(v, PairVector) else a @ v
