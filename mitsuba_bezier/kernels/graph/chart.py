"""Cull a ray by the quadratic of a graph leaf, in the leaf's chart.

``docs/intersection.md`` gives the argument; `mitsuba_bezier.leaves.records` the records.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import drjit as dr
import numpy as np

from ...leaves.records import LEAST_REACH, LeafKind
from ..arrays import Types, dot3, reciprocal
from ..query import Query, Rays
from ..structure import (
    AFFINE,
    LEAST_REMAINDER,
    OUTWARD_BITS,
    PROJECTIVE,
    REACH_DIGITS,
    REMAINDER_DIGITS,
)
from ..two_float import fma

__all__ = [
    "ChartLine",
    "ChartRays",
    "LeafBounds",
    "affine_rays",
    "cull",
    "first_root",
    "projective_rays",
    "root_fraction",
]


@dataclass(frozen=True)
class ChartRays:
    """The images ``x0 + tau e`` of rays in the charts of leaves."""

    x0: list[Any]  #: three numbers, as the next of the type in which they are known
    e: list[Any]
    parameter: Callable[[Any], Any]  #: takes ``tau`` to the ray parameter
    turns: Any = False  #: Bool: whether ``tau`` and the ray parameter need not grow together


@dataclass(frozen=True)
class LeafBounds:
    """What culling knows of leaves: their quadratic, and how far they are from it."""

    quadratic: list[Any]  #: a, b, c
    remainder: Any
    outward: list[Any]
    inward: list[Any] | None  #: None where culling is not to find certain hits


@dataclass
class ChartLine:
    """How far culling got with a ray in the chart of a leaf.

    The ray is a line ``x0 + tau e`` there. In an affine chart ``tau`` is the ray parameter from
    `base`; for projective ones see `projective_rays`. The surface is certainly not met between
    the entry into the leaf's prism and ``tau``.
    """

    base: Any  #: wide, ray parameter of a point near the leaf
    gamma: Any  #: half the second derivative of the ray's height over the quadratic
    tau: Any
    end: Any  #: where the ray leaves the prism
    sign: Any  #: side of the surface the ray enters on; zero where the quadratic cannot tell
    certain_hit: Any  #: Bool; never set where culling was not to find out

    @staticmethod
    def zero(ty: Types) -> ChartLine:
        """Return an uninitialised value for a loop's state."""
        zero = dr.zeros(ty.Float)
        return ChartLine(ty.wide_zero(), zero, zero, zero, zero, ty.Bool(False))


def cull(query: Query, leaf: Any, rays: Rays, active: Any) -> tuple[Any, ChartLine]:
    """Cull with the leaf's quadratic.

    If the query ends there, certain hits are found, too; not in projective charts.

    Returns
    -------
    candidate : Bool
        False: there is certainly no hit in this leaf for ``0 < t < t_max``.
    line : ChartLine
    """
    s = query.s
    if not s.has(LeafKind.GRAPH_PROJECTIVE):
        return _cull_affine(query, leaf, rays, active)
    if not s.has(LeafKind.GRAPH_AFFINE):
        return _cull_projective(query, leaf - s.first_projective, rays, active)
    straight = leaf < s.first_projective
    return dr.if_stmt(
        args=(leaf, rays, active),
        cond=straight,
        true_fn=lambda leaf, rays, active: _cull_affine(query, leaf, rays, active),
        false_fn=lambda leaf, rays, active: _cull_projective(
            query, leaf - s.first_projective, rays, active
        ),
        label="bezier chart",
    )


def _cull_affine(query: Query, leaf: Any, rays: Rays, active: Any) -> tuple[Any, ChartLine]:
    """Cull in float32; what that may be off is a part of the leaf's bounds.

    Only the ray's point near the leaf is a wide number, so that neither rays from afar nor
    scenes far off make it worse. The march goes along a line that is known better: `affine_rays`.
    """
    s, ty, o, d = query.s, query.ty, rays.o, rays.d
    record = AFFINE.gather(s.affine, leaf, active)
    rows = record.rows
    e = [dot3(row, d) for row in rows]
    t0 = ty.widen(
        -dot3([o[i] - ty.Float(record.shift[i]) for i in range(3)], d) * reciprocal(dot3(d, d))
    )
    near = _point(ty, record.shift, t0, rays)
    x0 = [dot3(row, [ty.narrow(x) for x in near]) for row in rows]
    # on a leaf as thin as a hair the nearest point may be thousands of widths away: then on to the
    # point nearest in the chart
    ahead = -dot3(x0, e) * reciprocal(dot3(e, e))
    x0 = [dr.fma(ahead, e[i], x0[i]) for i in range(3)]
    base = t0 + ty.widen(ahead)
    word = record.remainder_outward
    remainder = _number(ty, word, 0, REMAINDER_DIGITS, LEAST_REMAINDER)
    outward = [_number(ty, word, at, REACH_DIGITS, LEAST_REACH) for at in OUTWARD_BITS]
    inward = None
    if query.ends_where_certain:
        inward = [
            _number(ty, word, 0, REACH_DIGITS, LEAST_REACH) for word in record.quadratic_inward
        ]
    bounds = LeafBounds(affine_quadratic(ty, record), remainder, outward, inward)
    lo, hi = ty.narrow(-base), ty.narrow(ty.widen_end(rays.t_max) - base)
    return _cull((x0, e), bounds, lo, hi, base)


def _number(ty: Types, word: Any, at: int, digits: tuple[int, int], least: float) -> Any:
    """Return a number that `structure` packed into a word, from bit `at` on."""
    exponent, mantissa = digits
    left = 23 - mantissa - at  # to where a float has its exponent's last bits
    bits = (word << left) if left >= 0 else (word >> -left)
    bits = bits & ((2 ** (exponent + mantissa) - 1) << (23 - mantissa))
    bits = bits + int(np.float32(least).view(np.uint32))
    return ty.Float(dr.reinterpret_array(ty.Float32, bits))


def affine_quadratic(ty: Types, record: SimpleNamespace) -> list[Any]:
    """Return the quadratic of an affine leaf."""
    return [dr.reinterpret_array(ty.Float32, x & 0xFFFFFF00) for x in record.quadratic_inward]


def _point(ty: Types, shift: list[Any], t: Any, rays: Rays) -> list[Any]:
    """Return the point of a ray at `t`, from a leaf's shift, as wide numbers."""
    away = [ty.widen(rays.o[i]) - ty.widen(shift[i]) for i in range(3)]
    return [fma(t, ty.widen(rays.d[i]), away[i]) for i in range(3)]


def affine_rays(
    ty: Types, record: SimpleNamespace, base: Any, rays: Rays, wide: bool = False
) -> ChartRays:
    """Return the images of rays under an affine leaf's chart; the parameter `base` is at zero.

    `x0` is found in wide numbers; both are wide if `wide`.
    """
    near = _point(ty, record.shift, base, rays)
    rows = record.rows
    wide_rows = [[ty.widen(x) for x in row] for row in rows]
    x0 = [dot3(row, near) for row in wide_rows]
    if wide:
        e = [dot3(row, [ty.widen(rays.d[i]) for i in range(3)]) for row in wide_rows]
    else:
        x0, e = [ty.narrow(x) for x in x0], [dot3(row, rays.d) for row in rows]
    return ChartRays(x0, e, lambda tau: ty.narrow(base + ty.widen(tau)))


def projective_rays(ty: Types, record: SimpleNamespace, rays: Rays) -> ChartRays:
    """Return the images of rays under a projective leaf's collineation, as wide numbers.

    Homogeneously the ray is ``a + s b``, ``a`` being the point nearest the shift. The image is
    taken as ``x0 + tau e`` through ``a_w a + b_w b``, which is never at the chart's infinity, as
    its ``w`` is ``a_w^2 + b_w^2``, and then moved to its point nearest the leaf's centre.
    """
    o, d = rays.o, rays.d
    od = [ty.widen(o[i]) - ty.widen(record.shift[i]) for i in range(3)]
    dd = [ty.widen(d[i]) for i in range(3)]
    t0 = -dot3(od, dd) / dot3(dd, dd)
    near = [fma(t0, dd[i], od[i]) for i in range(3)]
    rows = [[ty.widen(x) for x in row] for row in record.rows]
    a = [dot3(row, near) + row[3] for row in rows]
    b = [dot3(row, dd) for row in rows]
    aw, bw = a[3], b[3]
    inv = reciprocal(fma(aw, aw, bw * bw))
    x0 = [fma(aw, a[i], bw * b[i]) * inv for i in range(3)]
    e = [fma(aw, b[i], -bw * a[i]) * inv for i in range(3)]
    middle = -dot3([x0[0] - 1 / 3, x0[1] - 1 / 3, x0[2]], e) / dot3(e, e)
    x0 = [fma(middle, e[i], x0[i]) for i in range(3)]

    def parameter(tau: Any) -> Any:
        tau = tau + middle
        return ty.narrow(t0 + fma(tau, aw, bw) / fma(-tau, bw, aw))

    return ChartRays(x0, e, parameter, ty.narrow(bw) != 0.0)


def _cull_projective(query: Query, leaf: Any, rays: Rays, active: Any) -> tuple[Any, ChartLine]:
    """As `_cull_affine`, on the line's image under the chart's collineation."""
    ty = query.ty
    record = PROJECTIVE.gather(query.s.projective, leaf, active)
    there = projective_rays(ty, record, rays)
    line = [ty.narrow(x) for x in there.x0], [ty.narrow(x) for x in there.e]
    infinity = dr.full(ty.Float, dr.inf)
    zero = ty.wide_zero()
    bounds = LeafBounds(record.quadratic, record.remainder, [record.outward] * 3, None)
    return _cull(line, bounds, -infinity, infinity, zero)


def _cull(
    line: tuple[list[Any], list[Any]], bounds: LeafBounds, lo: Any, hi: Any, base: Any
) -> tuple[Any, ChartLine]:
    """Cull the piece from `lo` to `hi` of a line ``x0 + tau e`` in a chart."""
    x0, e = line
    a, b, c = bounds.quadratic
    remainder, outward, inward = bounds.remainder, bounds.outward, bounds.inward
    bends = dr.abs(a) + dr.abs(b) + dr.abs(c)
    # |quadratic| over the enlarged triangle, a little more to be safe: with the sum m of `outward`,
    # products of barycentrics are at most (1 + m)^2 / 4 or, where one is negative, m (1 + m)
    total = outward[0] + outward[1] + outward[2]
    height = dr.fma(bends, dr.fma(dr.fma(total, 1.3, 0.52), total, 0.26), remainder)
    w0, ew = 1.0 - x0[0] - x0[1], -e[0] - e[1]
    inner_lo, inner_hi = lo, hi  # within what the leaf certainly covers
    for k, (f0, f1) in enumerate(((x0[0], e[0]), (x0[1], e[1]), (w0, ew))):
        # f0 + tau f1 >= -outward, on the line: a half-line. Where f1 = 0 it is all or nothing, and
        # taken for all
        inverse = reciprocal(f1)
        cut = (-outward[k] - f0) * inverse
        lo = dr.select((f1 > 0.0) & (cut > lo), cut, lo)
        hi = dr.select((f1 < 0.0) & (cut < hi), cut, hi)
        if inward is not None:
            cut = (inward[k] - f0) * inverse
            inner_lo = dr.select((f1 > 0.0) & (cut > inner_lo), cut, inner_lo)
            inner_hi = dr.select((f1 < 0.0) & (cut < inner_hi), cut, inner_hi)
    rising = reciprocal(e[2])
    low, high = (-height - x0[2]) * rising, (height - x0[2]) * rising
    near, far = dr.select(rising > 0.0, low, high), dr.select(rising > 0.0, high, low)
    lo, hi = dr.select(near > lo, near, lo), dr.select(far < hi, far, hi)
    alpha = x0[2] - dr.fma(a * x0[0], x0[1], dr.fma(b * x0[0], w0, c * x0[1] * w0))
    mixed = dr.fma(
        a,
        dr.fma(x0[0], e[1], e[0] * x0[1]),
        dr.fma(b, dr.fma(x0[0], ew, e[0] * w0), c * dr.fma(x0[1], ew, e[1] * w0)),
    )
    slope0 = e[2] - mixed
    gamma = -dr.fma(a * e[0], e[1], dr.fma(b * e[0], ew, c * e[1] * ew))
    value = dr.fma(dr.fma(gamma, lo, slope0), lo, alpha)
    sign = dr.copysign(dr.full(type(value), 1.0), value)
    gap = dr.abs(value) - remainder
    step, exists = first_root(gap, sign * dr.fma(2.0 * gamma, lo, slope0), sign * gamma)
    clear = gap > 0.0
    tau = dr.select(clear, lo + step, lo)
    candidate = (lo <= hi) & (~clear | (exists & (tau <= hi)))
    sign = dr.select(clear, sign, 0.0)
    certain = type(candidate)(False)
    if inward is not None:
        # over what the leaf covers the ray changes from one side of it to the other
        first = dr.fma(dr.fma(gamma, inner_lo, slope0), inner_lo, alpha)
        last = dr.fma(dr.fma(gamma, inner_hi, slope0), inner_hi, alpha)
        certain = (inner_lo < inner_hi) & (first * last < 0.0)
        certain = certain & (dr.abs(first) > remainder) & (dr.abs(last) > remainder)
        # along an edge the cuts above do not tell on which side of it
        certain = certain & (e[0] * e[1] * ew != 0.0)
    return candidate | certain, ChartLine(base, gamma, tau, hi, sign, certain)


def first_root(value: Any, slope: Any, half_second: Any) -> tuple[Any, Any]:
    """Return the step to the first zero of ``value + slope x + half_second x^2``, and if any.

    For ``value >= 0`` the first zero ahead; a zero at hand that the slope leads away from does not
    count. For a small negative value the zero behind.
    """
    numerator, denominator, exists = root_fraction(value, slope, half_second)
    return numerator / denominator, exists


def root_fraction(value: Any, slope: Any, half_second: Any) -> tuple[Any, Any, Any]:
    """Return the step of `first_root` as numerator and denominator, and if any."""
    disc = dr.fma(slope, slope, -4.0 * half_second * value)
    root = dr.sqrt(dr.maximum(disc, 0.0)) + dr.abs(slope)
    away = slope > 0.0
    denominator = dr.select(away, -2.0 * half_second, dr.maximum(root, 1e-30))
    return dr.select(away, root, 2.0 * value), denominator, (disc >= 0.0) & (denominator > 0.0)
