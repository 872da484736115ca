"""Ray against one graph leaf: culling by its quadratic, then a certified march.

``docs/intersection.md`` gives the argument; `mitsuba_bezier.geometry.leaves` the records.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .arrays import Types, dot3, gather_packets, types_of
from .net import horner
from .quadric import edge_tolerance
from .structure import AFFINE, BOUND_UNIT, HEAD, PROJECTIVE, Structure
from .trim import leaf_test

__all__ = ["ChartLine", "cull", "march"]

#: Steps below this (in leaf sizes) are the last: the error after it is its square times the
#: leaf's bending, below the rounding of float32.
LAST_STEP = 3e-4
#: ... and in projective charts, where a point at distance t lies 1/t of the leaf's size from
#: the plane at infinity: 1e-12 there is 1e-6 of t at t = 1e6.
LAST_STEP_PROJECTIVE = 1e-6
#: A march that has not ended after so many steps is given up as a miss.
MAX_STEPS = 64


@dataclass
class ChartLine:
    """A ray in the chart of a leaf, as far as culling got with it.

    The ray is the line ``x0 + tau e``. In an affine chart ``tau`` is the ray parameter from
    ``t0``; for projective ones see `_projective_line`. The surface is certainly not met between
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


def _nearest(ty: Types, shift: list[Any], o: Any, d: Any) -> tuple[Any, list[Any]]:
    """Return the parameter (float64) and the place of the ray's point nearest `shift`.

    In float64: it is what keeps rays from afar, and scenes far off, exact, as all that follows
    has numbers of the leaf's own size.
    """
    f64 = ty.Float64
    od = [f64(o[i]) - f64(shift[i]) for i in range(3)]
    dd = [f64(d[i]) for i in range(3)]
    t0 = -dot3(od, dd) / dot3(dd, dd)
    return t0, [ty.Float(dr.fma(t0, dd[i], od[i])) for i in range(3)]


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
    t0, near = _nearest(ty, record[0:3], o, d)
    x0 = [dot3(record[3 + 3 * r : 6 + 3 * r], near) for r in range(3)]
    e = [dot3(record[3 + 3 * r : 6 + 3 * r], d) for r in range(3)]
    bits = dr.reinterpret_array(ty.UInt, record[15])
    remainder = dr.square(ty.Float(bits & 0xFFFF)) * BOUND_UNIT
    margin = dr.square(ty.Float(bits >> 16)) * BOUND_UNIT
    lo, hi = ty.Float(-t0), ty.Float(ty.Float64(t_max) - t0)
    return _cull(t0, x0, e, record[12:15], remainder, margin, lo, hi)


def _projective_line(ty: Types, record: list[Any], o: Any, d: Any) -> tuple[Any, ...]:
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
    x0, e, _parameter, _both = _projective_line(ty, record, o, d)
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

    For ``value >= 0`` the first positive zero; for a small negative one the zero behind.
    """
    disc = dr.fma(slope, slope, -4.0 * half_second * value)
    denominator = dr.sqrt(dr.maximum(disc, 0.0)) - slope
    return 2.0 * value / denominator, (disc >= 0.0) & (denominator > 0.0)


def march(
    s: Structure, ty: Types, leaf: Any, line: ChartLine, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """Find the first hit in a graph leaf.

    Returns
    -------
    hit : Bool
    t : Float
        Ray parameter.
    u, v : Float
        Leaf barycentrics.
    """
    if not s.has_projective:
        return _march_affine(s, ty, leaf, line, t_max, active)
    if not s.has_affine:
        return _march_projective(s, ty, leaf - s.first_projective, line, o, d, t_max, active)
    return dr.if_stmt(
        args=(leaf, line, o, d, t_max, active),
        cond=leaf < s.first_projective,
        true_fn=lambda leaf, line, o, d, t, a: _march_affine(s, ty, leaf, line, t, a),
        false_fn=lambda leaf, line, o, d, t, a: _march_projective(
            s, ty, leaf - s.first_projective, line, o, d, t, a
        ),
        label="bezier march",
    )


def _march_affine(
    s: Structure, ty: Types, leaf: Any, line: ChartLine, t_max: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    data = gather_packets(s.nets, leaf, HEAD + (s.degree + 1) * (s.degree + 2) * 2, active)
    x0, e = [line.x, line.y, line.z], [line.ex, line.ey, line.ez]

    def parameter(tau: Any) -> Any:
        return ty.Float(line.t0 + ty.Float64(tau))

    kept = leaf_test(s, leaf)
    return _march(s.degree, data, x0, e, line, parameter, False, LAST_STEP, kept, t_max, active)


def _march_projective(
    s: Structure, ty: Types, leaf: Any, line: ChartLine, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """March in float64: distances to the plane at infinity are differences of numbers near one."""
    record = gather_packets(s.projective, leaf, PROJECTIVE, active)
    data = gather_packets(s.far_nets, leaf, HEAD + (s.degree + 1) * (s.degree + 2) * 2, active)
    x0, e, to_t, both = _projective_line(ty, record, o, d)
    hit, t, u, v = _march(
        s.degree,
        data,
        x0,
        e,
        line,
        lambda tau: ty.Float(to_t(tau)),
        both,
        LAST_STEP_PROJECTIVE,
        leaf_test(s, leaf + s.first_projective),
        t_max,
        active,
    )
    return hit, t, ty.Float(u), ty.Float(v)


def _march(
    n: int,
    data: list[Any],
    x0: list[Any],
    e: list[Any],
    line: ChartLine,
    parameter: Any,
    all_roots: Any,
    last_step: float,
    kept: Any,
    t_max: Any,
    active: Any,
) -> tuple[Any, Any, Any, Any]:
    """March along ``x0 + tau e``, in the precision of these.

    The march keeps a chart parameter ``tau`` before which there is no (further) meeting with
    the surface. It steps to the first zero of the quadratic lower bound that the value, the
    slope and the stored bound on the second derivative give, which never jumps over a root
    and converges quadratically to it, also when two roots are close.

    Parameters
    ----------
    n : int
        Degree.
    data : list
        Record of the net: variation, bending, the parameter quadratics, the coefficients.
    line : ChartLine
        Where culling came to.
    parameter : function
        Takes ``tau`` to the ray parameter.
    all_roots : Bool
        Whether a later root may have the smaller ray parameter.
    last_step : float
        Steps below this are the last.
    kept : function or None
        Tells which roots are not trimmed away.
    """
    ty = types_of(x0[0])
    variation, bending, net = data[0], data[1], data[HEAD:]
    x0, y0, z0 = x0
    ex, ey, ez = e
    gamma, end = ty.Float(line.gamma), ty.Float(line.end)
    lateral2 = dr.fma(ex, ex, ey * ey)
    wobble = 0.5 * variation * lateral2  # half the uncertainty of the second derivative
    speed2 = dr.fma(ez, ez, lateral2)
    speed = dr.sqrt(speed2)

    def start(tau: Any) -> tuple[Any, Any]:
        """Return parameters near the chart point under the ray."""
        x, y = dr.fma(tau, ex, x0), dr.fma(tau, ey, y0)
        w = 1.0 - x - y
        xy, xw, yw = x * y, x * w, y * w
        u = x + dr.fma(data[2], xy, dr.fma(data[3], xw, data[4] * yw))
        v = y + dr.fma(data[5], xy, dr.fma(data[6], xw, data[7] * yw))
        return u, v

    def body(run, step, tau, u, v, sign, hit, best, best_u, best_v):
        p, pu, pv = horner(net, n, u, v)
        inv = dr.rcp(1.0 + p[3])
        x, y, z = (u + p[0]) * inv, (v + p[1]) * inv, p[2] * inv
        # partials of the affine chart point; the identity was split off x, y and W
        xu, xv = (1.0 + pu[0] - x * pu[3]) * inv, (pv[0] - x * pv[3]) * inv
        yu, yv = (pu[1] - y * pu[3]) * inv, (1.0 + pv[1] - y * pv[3]) * inv
        zu, zv = (pu[2] - z * pu[3]) * inv, (pv[2] - z * pv[3]) * inv
        idet = dr.rcp(dr.fma(xu, yv, -xv * yu))
        rx, ry = dr.fma(tau, ex, x0) - x, dr.fma(tau, ey, y0) - y
        du, dv = dr.fma(yv, rx, -xv * ry) * idet, dr.fma(xu, ry, -yu * rx) * idet
        eu, ev = dr.fma(yv, ex, -xv * ey) * idet, dr.fma(xu, ey, -yu * ex) * idet
        value = dr.fma(tau, ez, z0) - z - dr.fma(zu, du, zv * dv)
        slope = ez - dr.fma(zu, eu, zv * ev)
        off2 = dr.fma(rx, rx, ry * ry)
        slack = bending * off2  # what linear extrapolation to the ray's vertical may miss
        # The side is known from the entry on, or as soon as the value says it for certain;
        # until then the march stays where it is and only (u, v) improve.
        certain = (sign != 0.0) | (dr.abs(value) > slack) | (off2 < 1e-3 * last_step * last_step)
        sign = dr.select(certain & (sign == 0.0), dr.copysign(ty.Float(1), value), sign)
        # the slope is that at the foot (x, y); the ray is sqrt(off2) away from there
        tilt = 2.0 * bending * dr.sqrt(off2 * lateral2)
        signed, signed_slope = sign * value, sign * slope - tilt
        sure = dr.select(signed > 0.0, dr.maximum(signed - slack, 0.0), signed)
        delta, exists = first_root(sure, signed_slope, sign * gamma - wobble)
        delta, exists = dr.select(certain, delta, 0.0), exists | ~certain
        newton = -value / slope
        close = (off2 < last_step * last_step) & (dr.abs(delta) * speed < last_step)
        converged = certain & exists & close & (dr.abs(newton) * speed < last_step)
        # on the last step the first-order term decides, without the slack
        delta = dr.select(converged, newton, delta)
        tau = tau + delta
        u, v = u + dr.fma(eu, delta, du), v + dr.fma(ev, delta, dv)

        # a root: is it ours?
        normal2 = 1.0 + dr.square(zu) + dr.square(zv)
        tolerance = edge_tolerance(dr.abs(slope) * dr.rsqrt(speed2 * normal2))
        inside = dr.minimum(dr.minimum(u, v), 1.0 - u - v) >= -tolerance
        t = parameter(tau)
        accept = run & converged & inside & (t > 0.0) & (t < best)
        if kept is not None:
            accept = accept & kept(u, v, accept)
        hit = hit | accept
        best = dr.select(accept, t, best)
        best_u, best_v = dr.select(accept, u, best_u), dr.select(accept, v, best_v)

        # go on from the other side of the surface, if the bound lets it come back
        back = sign * gamma + wobble
        again = converged & (~accept | all_roots) & (back > 0.0)
        tau = dr.select(again, tau + dr.abs(slope) / back, tau)
        far_u, far_v = start(tau)
        sign = dr.select(again, -sign, sign)
        u, v = dr.select(again, far_u, u), dr.select(again, far_v, v)
        step = step + 1
        goes = dr.select(converged, again, exists) & (tau <= end) & (step < MAX_STEPS)
        return run & goes, step, tau, u, v, sign, hit, best, best_u, best_v

    tau = ty.Float(line.tau)
    u, v = start(tau)
    zero = dr.zeros(ty.Float)
    sign = ty.Float(line.sign)
    state = (active, ty.UInt(0), tau, u, v, sign, ty.Bool(False), t_max, zero, zero)
    _run, _step, _tau, _u, _v, _sign, hit, best, best_u, best_v = dr.while_loop(
        state,
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "tau", "u", "v", "sign", "hit", "best", "best_u", "best_v"),
        label="bezier leaf march",
    )
    return hit, best, best_u, best_v
