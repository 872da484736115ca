"""A ray in the chart of a graph leaf, and culling by the leaf's quadratic.

``docs/intersection.md`` gives the argument; `mitsuba_bezier.geometry.leaves` the records.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .arrays import Types, dot3, gather_packets
from .structure import AFFINE, BOUND_UNIT, PROJECTIVE, Structure

__all__ = ["ChartLine", "cull", "first_root", "projective_line"]


@dataclass
class ChartLine:
    """A ray in the chart of a leaf, as far as culling got with it.

    The ray is the line ``x0 + tau e``. In an affine chart ``tau`` is the ray parameter from
    ``t0``; for projective ones see `projective_line`. The surface is certainly not met between
    the entry into the leaf's prism and ``tau``.
    """

    t0: Any  #: Float64
    x: Any  #: x0, three
    y: Any
    z: Any
    ex: Any  #: e, three
    ey: Any
    ez: Any
    gamma: Any  #: half the second derivative of the ray's height over the quadratic
    tau: Any
    end: Any  #: where the ray leaves the prism
    sign: Any  #: side of the surface the ray enters on; zero where the quadratic cannot tell

    @staticmethod
    def zero(ty: Types) -> ChartLine:
        """Return an uninitialised value for a loop's state."""
        zero = [dr.zeros(ty.Float) for _ in range(10)]
        return ChartLine(dr.zeros(ty.Float64), *zero)


def cull(
    s: Structure, ty: Types, leaf: Any, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, ChartLine]:
    """Cull with the leaf's quadratic.

    Returns
    -------
    candidate : Bool
        False: there is certainly no hit in this leaf for ``0 < t < t_max``.
    line : ChartLine
    """
    if s.has_affine and not s.has_projective:
        return _cull_affine(s, ty, leaf, o, d, t_max, active)
    if not s.has_affine:
        return _cull_projective(s, ty, leaf - s.first_projective, o, d, t_max, active)
    straight = leaf < s.first_projective
    return dr.if_stmt(
        args=(leaf, o, d, t_max, active),
        cond=straight,
        true_fn=lambda leaf, o, d, t, a: _cull_affine(s, ty, leaf, o, d, t, a),
        false_fn=lambda leaf, o, d, t, a: _cull_projective(
            s, ty, leaf - s.first_projective, o, d, t, a
        ),
        label="bezier chart",
    )


def _cull_affine(
    s: Structure, ty: Types, leaf: Any, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, ChartLine]:
    record = gather_packets(s.affine, leaf, AFFINE, active)
    rows = [record[3 + 3 * r : 6 + 3 * r] for r in range(3)]
    e = [dot3(row, d) for row in rows]
    # Float64 keeps rays from afar, and scenes far off, exact: parameters are found in float32,
    # points at them in float64. First the point nearest the leaf's origin. On a leaf as thin as a
    # hair that may be thousands of its widths away: then on to the point nearest in the chart, from
    # where float32 is enough.
    f64 = ty.Float64
    d64 = [f64(d[i]) for i in range(3)]
    near = [f64(o[i]) - f64(record[i]) for i in range(3)]
    t0 = f64(-dot3([ty.Float(x) for x in near], d) / dot3(d, d))
    near = [dr.fma(t0, d64[i], near[i]) for i in range(3)]
    rough = [ty.Float(x) for x in near]
    ahead = f64(-dot3([dot3(row, rough) for row in rows], e) / dot3(e, e))
    near = [dr.fma(ahead, d64[i], near[i]) for i in range(3)]
    t0 = t0 + ahead
    x0 = [ty.Float(dot3([f64(x) for x in row], near)) for row in rows]
    bits = dr.reinterpret_array(ty.UInt, record[15])
    remainder = dr.square(ty.Float(bits & 0xFFFF)) * BOUND_UNIT
    margin = dr.square(ty.Float(bits >> 16)) * BOUND_UNIT
    lo, hi = ty.Float(-t0), ty.Float(ty.Float64(t_max) - t0)
    return _cull(t0, x0, e, record[12:15], remainder, margin, lo, hi)


def projective_line(ty: Types, record: list[Any], o: Any, d: Any) -> tuple[Any, ...]:
    """Return the image of a ray under a projective leaf's collineation, in float64.

    Homogeneously the ray is ``a + s b``, ``a`` being the point nearest the shift. The image is
    taken as ``x0 + tau e`` through ``a_w a + b_w b``, which is never at the chart's infinity, as
    its ``w`` is ``a_w^2 + b_w^2``, and then moved to its point nearest the leaf's centre.

    Returns
    -------
    x0, e : three Float64 each
    parameter : function
        Takes ``tau`` to the ray parameter.
    both : Bool
        Whether ``tau`` and the ray parameter need not grow together.
    """
    f64 = ty.Float64
    od = [f64(o[i]) - f64(record[i]) for i in range(3)]
    dd = [f64(d[i]) for i in range(3)]
    t0 = -dot3(od, dd) / dot3(dd, dd)
    near = [dr.fma(t0, dd[i], od[i]) for i in range(3)]
    rows = [[f64(x) for x in record[4 + 4 * r : 8 + 4 * r]] for r in range(4)]
    a = [dot3(row, near) + row[3] for row in rows]
    b = [dot3(row, dd) for row in rows]
    aw, bw = a[3], b[3]
    inv = dr.rcp(dr.fma(aw, aw, bw * bw))
    x0 = [dr.fma(aw, a[i], bw * b[i]) * inv for i in range(3)]
    e = [dr.fma(aw, b[i], -bw * a[i]) * inv for i in range(3)]
    middle = -dot3([x0[0] - 1 / 3, x0[1] - 1 / 3, x0[2]], e) / dot3(e, e)
    x0 = [dr.fma(middle, e[i], x0[i]) for i in range(3)]

    def parameter(tau: Any) -> Any:
        tau = tau + middle
        return t0 + dr.fma(tau, aw, bw) / dr.fma(-tau, bw, aw)

    return x0, e, parameter, bw != 0.0


def _cull_projective(
    s: Structure, ty: Types, leaf: Any, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, ChartLine]:
    """As `_cull_affine`, on the line's image under the chart's collineation."""
    record = gather_packets(s.projective, leaf, PROJECTIVE, active)
    x0, e, _parameter, _both = projective_line(ty, record, o, d)
    x0, e = [ty.Float(x) for x in x0], [ty.Float(x) for x in e]
    infinity = dr.full(ty.Float, dr.inf)
    t0 = dr.zeros(ty.Float64)
    return _cull(t0, x0, e, record[20:23], record[3], record[23], -infinity, infinity)


def _cull(
    t0: Any,
    x0: list[Any],
    e: list[Any],
    quadratic: list[Any],
    remainder: Any,
    margin: Any,
    lo: Any,
    hi: Any,
) -> tuple[Any, ChartLine]:
    a, b, c = quadratic
    # |quadratic| over the unit triangle enlarged by the margin, a little more to be safe
    height = 0.26 * (dr.abs(a) + dr.abs(b) + dr.abs(c)) * dr.square(1 + 3 * margin) + remainder
    w0, ew = 1.0 - x0[0] - x0[1], -e[0] - e[1]
    for f0, f1, bound in (
        (x0[0], e[0], margin),
        (x0[1], e[1], margin),
        (w0, ew, margin),
        (x0[2], e[2], height),
        (-x0[2], -e[2], height),
    ):
        # f0 + tau f1 >= -bound, on the line: a half-line; all or nothing where f1 = 0
        cut = (-bound - f0) / f1
        lo = dr.select((f1 > 0.0) & (cut > lo), cut, lo)
        hi = dr.select((f1 < 0.0) & (cut < hi), cut, hi)
        hi = dr.select((f1 == 0.0) & (f0 < -bound), -dr.inf, hi)
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
    x, y, z = x0
    ex, ey, ez = e
    return candidate, ChartLine(t0, x, y, z, ex, ey, ez, gamma, tau, hi, sign)


def first_root(value: Any, slope: Any, half_second: Any) -> tuple[Any, Any]:
    """Return the step to the first zero of ``value + slope x + half_second x^2``, and if any.

    For ``value >= 0`` the first zero ahead; a zero at hand that the slope leads away from does not
    count. For a small negative value the zero behind.
    """
    disc = dr.fma(slope, slope, -4.0 * half_second * value)
    root = dr.sqrt(dr.maximum(disc, 0.0)) + dr.abs(slope)
    away = slope > 0.0
    denominator = dr.select(away, -2.0 * half_second, dr.maximum(root, 1e-30))
    step = dr.select(away, root, 2.0 * value) / denominator
    return step, (disc >= 0.0) & (denominator > 0.0)
