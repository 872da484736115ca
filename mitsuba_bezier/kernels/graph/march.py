"""The certified march of a ray to its first meeting with a graph leaf.

``docs/intersection.md`` gives the argument.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr

from ...leaves.records import BENDING_LIMIT, SIZES, LeafKind
from ..arrays import Types, inverse_root, reciprocal, types_of
from ..edges import edge_tolerance
from ..net import graph_point
from ..structure import AFFINE, PROJECTIVE, Structure
from ..trim import leaf_test
from .chart import ChartLine, affine_line, affine_quadratic, projective_line, root_fraction
from .grazing import polish

__all__ = ["march"]

#: Steps below this (in leaf sizes) are the last: the error after it is its square times what the
#: leaf's bounds leave open of the second derivative, below the rounding of float32.
LAST_STEP = 1e-4
#: ... and in projective charts, where a point at distance t lies 1/t of the leaf's size from
#: the plane at infinity: 1e-12 there is 1e-6 of t at t = 1e6.
LAST_STEP_PROJECTIVE = 1e-6
#: A march that has not ended after so many steps is given up as a miss. Nearly all take less than
#: ten; along the lines of a ruled surface, at a cosine `c`, it is some `1 / sqrt(c)`.
MAX_STEPS = 1024


def march(
    s: Structure,
    ty: Types,
    leaf: Any,
    line: ChartLine,
    o: Any,
    d: Any,
    t_max: Any,
    active: Any,
    any_hit: bool = False,
) -> tuple[Any, Any, Any, Any]:
    """Find the first hit in a graph leaf; if `any_hit` is set, only whether there is one.

    Returns
    -------
    hit : Bool
    t : Float
        Ray parameter.
    u, v : Float
        Leaf barycentrics.
    """
    if not s.has(LeafKind.GRAPH_PROJECTIVE):
        return _march_affine(s, ty, leaf, line, o, d, t_max, active, any_hit)
    if not s.has(LeafKind.GRAPH_AFFINE):
        return _march_projective(s, ty, leaf - s.first_projective, line, o, d, t_max, active)
    return dr.if_stmt(
        args=(leaf, line, o, d, t_max, active),
        cond=leaf < s.first_projective,
        true_fn=lambda leaf, line, o, d, t, a: _march_affine(
            s, ty, leaf, line, o, d, t, a, any_hit
        ),
        false_fn=lambda leaf, line, o, d, t, a: _march_projective(
            s, ty, leaf - s.first_projective, line, o, d, t, a
        ),
        label="bezier march",
    )


def _march_affine(
    s: Structure,
    ty: Types,
    leaf: Any,
    line: ChartLine,
    o: Any,
    d: Any,
    t_max: Any,
    active: Any,
    any_hit: bool,
) -> tuple[Any, Any, Any, Any]:
    record = AFFINE.gather(s.affine, leaf, active)
    data = s.degree_record.gather(s.nets, leaf, active)
    x0, e = affine_line(ty, record, line.base, o, d)
    hit, t, u, v, closing = _march(
        s.degree,
        data,
        affine_quadratic(ty, record),
        x0,
        e,
        line,
        lambda tau: ty.Float(line.base + ty.Float64(tau)),
        False,
        LAST_STEP,
        leaf_test(s, leaf),
        t_max,
        active,
    )
    if any_hit:
        return hit, t, u, v
    return hit, *polish(s, ty, leaf, line.base, o, d, (t, u, v, closing), hit)


def _march_projective(
    s: Structure, ty: Types, leaf: Any, line: ChartLine, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """March in float64: distances to the plane at infinity are differences of numbers near one."""
    record = PROJECTIVE.gather(s.projective, leaf, active)
    data = s.far_record.gather(s.far_nets, leaf, active)
    x0, e, to_t, both = projective_line(ty, record, o, d)
    hit, t, u, v, _closing = _march(
        s.degree,
        data,
        record.quadratic,
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
    data: SimpleNamespace,
    quadratic: list[Any],
    x0: list[Any],
    e: list[Any],
    line: ChartLine,
    parameter: Any,
    all_roots: Any,
    last_step: float,
    kept: Any,
    t_max: Any,
    active: Any,
) -> tuple[Any, Any, Any, Any, Any]:
    """March along ``x0 + tau e``, in the precision of these.

    Returns hit, ray parameter and leaf barycentrics as `march`, and how fast the ray comes nearer
    to the surface there: leaf sizes for each unit of the ray parameter.

    The march keeps a chart parameter ``tau`` before which there is no (further) meeting with
    the surface. It steps to the first zero of the quadratic lower bound that the value, the
    slope and the stored bound on the second derivative give, which never jumps over a root
    and converges quadratically to it, also when two roots are close.

    Parameters
    ----------
    n : int
        Degree.
    data : record
        See `structure.net_record`.
    quadratic : list
        The leaf's, three numbers.
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
    variation, net = data.variation, data.net
    size = dr.floor(data.bending * (1.0 / BENDING_LIMIT))
    bending = dr.fma(size, -BENDING_LIMIT, data.bending)
    # the bounds hold for parameters with barycentrics down to `low`, up to `high`
    low = -SIZES[0] * dr.exp2(size * 0.5)
    high = 1.0 - 2.0 * low
    a, b, c = (ty.Float(x) for x in quadratic)
    x0, y0, z0 = x0
    ex, ey, ez = e
    gamma, end = ty.Float(line.gamma), ty.Float(line.end)
    lateral2 = dr.fma(ex, ex, ey * ey)
    wobble = 0.5 * variation * lateral2  # half the uncertainty of the second derivative
    speed2 = dr.fma(ez, ez, lateral2)
    speed = dr.sqrt(speed2)
    longest = 2.0 * last_step * reciprocal(speed)
    tilt = 2.0 * bending * dr.sqrt(lateral2)
    # the quadratic's mixed second derivative along the ray and along the axes
    mixed_x = dr.fma(a, ey, -dr.fma(b, ex + ex + ey, c * ey))
    mixed_y = dr.fma(a, ex, -dr.fma(b, ex, c * (ex + ey + ey)))

    def held(u: Any, v: Any) -> tuple[Any, Any]:
        """Return the parameters themselves, or others where the bounds hold."""
        u = dr.select(u < low, low, dr.select(u > high, high, u))
        top = 1.0 - low - u
        return u, dr.select(v < low, low, dr.select(v > top, top, v))

    def start(tau: Any) -> tuple[Any, Any]:
        """Return parameters near the chart point under the ray."""
        x, y = dr.fma(tau, ex, x0), dr.fma(tau, ey, y0)
        w = 1.0 - x - y
        xy, xw, yw = x * y, x * w, y * w
        off = (dr.fma(q[0], xy, dr.fma(q[1], xw, q[2] * yw)) for q in data.start)
        return x + next(off), y + next(off)

    def advance(
        go: Any, step: Any, tau: Any, u: Any, v: Any, sign: Any, root: Any, slope: Any, normal2: Any
    ) -> Any:
        (x, y, z), (xu, yu, zu), (xv, yv, zv) = graph_point(net, n, u, v)
        idet = reciprocal(dr.fma(xu, yv, -xv * yu))
        rx, ry = dr.fma(tau, ex, x0) - x, dr.fma(tau, ey, y0) - y
        du, dv = dr.fma(yv, rx, -xv * ry) * idet, dr.fma(xu, ry, -yu * rx) * idet
        eu, ev = dr.fma(yv, ex, -xv * ey) * idet, dr.fma(xu, ey, -yu * ex) * idet
        # the surface on the ray's vertical: tangent plane and the quadratic's second derivative
        bent = dr.fma(rx, dr.fma(a, ry, -b * (rx + ry)), -c * ry * (rx + ry))
        value = dr.fma(tau, ez, z0) - z - dr.fma(zu, du, dr.fma(zv, dv, bent))
        slope = ez - dr.fma(zu, eu, zv * ev) - dr.fma(rx, mixed_x, ry * mixed_y)
        off2 = dr.fma(rx, rx, ry * ry)
        slack = bending * off2  # what that may miss
        # The side is known from the entry on, or as soon as the value says it for certain;
        # until then the march stays where it is and only (u, v) improve.
        certain = (sign != 0.0) | (dr.abs(value) > slack) | (off2 < 1e-3 * last_step * last_step)
        sign = dr.select(certain & (sign == 0.0), dr.copysign(ty.Float(1), value), sign)
        signed = sign * value
        signed_slope = dr.fma(sign, slope, -tilt * (dr.abs(rx) + dr.abs(ry)))
        sure = dr.select(signed > 0.0, dr.maximum(signed - slack, 0.0), signed)
        num, den, exists = root_fraction(sure, signed_slope, dr.fma(sign, gamma, -wobble))
        num, den = dr.select(certain, num, 0.0), dr.select(certain, den, 1.0)
        exists = exists | ~certain
        root = exists & (dr.abs(num) * speed < last_step * den)
        root = root & (dr.abs(value) * speed < last_step * dr.abs(slope))
        # No step leads past a root. On its other side, with the bound's zeros nowhere, there is no
        # other way to come but by rounding: the root is at hand
        root = certain & (off2 < last_step * last_step) & (root | (~exists & (signed < 0.0)))
        # the last step is Halley's, without the slack; Newton's where the two differ much
        square = slope * slope
        bend = dr.clip(gamma * value, -0.5 * square, 0.5 * square)
        delta = dr.select(root, -value * slope, num) / dr.select(root, square - bend, den)
        delta = dr.select(root, dr.clip(delta, -longest, longest), delta)
        tau = tau + delta
        u, v = u + dr.fma(eu, delta, du), v + dr.fma(ev, delta, dv)
        held_u, held_v = held(u, v)
        u, v = dr.select(root, u, held_u), dr.select(root, v, held_v)
        step = step + 1
        go = go & ~root & exists & (tau <= end) & (step < MAX_STEPS)
        return go, step, tau, u, v, sign, root, slope, dr.fma(zu, zu, dr.fma(zv, zv, 1.0))

    def body(
        run: Any,
        step: Any,
        tau: Any,
        u: Any,
        v: Any,
        sign: Any,
        hit: Any,
        best: Any,
        best_u: Any,
        best_v: Any,
        best_closing: Any,
    ) -> Any:
        one = dr.full(ty.Float, 1.0)
        _go, step, tau, u, v, sign, root, slope, normal2 = dr.while_loop(
            (run, step, tau, u, v, sign, ty.Bool(False), one, one),
            cond=lambda *st: st[0],
            body=advance,
            labels=("go", "step", "tau", "u", "v", "sign", "root", "slope", "normal2"),
            label="bezier leaf steps",
        )
        # a root: is it ours?
        slope = dr.abs(slope)
        closing = slope * inverse_root(normal2)
        tolerance = edge_tolerance(closing * reciprocal(speed))
        inside = dr.minimum(dr.minimum(u, v), 1.0 - u - v) >= -tolerance
        t = parameter(tau)
        accept = run & root & inside & (t > 0.0) & (t < best)
        if kept is not None:
            accept = accept & kept(u, v, accept)
        hit = hit | accept
        best = dr.select(accept, t, best)
        best_u, best_v = dr.select(accept, u, best_u), dr.select(accept, v, best_v)
        best_closing = dr.select(accept, closing, best_closing)

        # go on from the other side of the surface, if the bound lets it come back
        back = dr.fma(sign, gamma, wobble)
        run = run & root & (~accept | all_roots) & (back > 0.0)
        tau = tau + slope / back
        u, v = held(*start(tau))
        run = run & (tau <= end) & (step < MAX_STEPS)
        return run, step, tau, u, v, -sign, hit, best, best_u, best_v, best_closing

    tau = ty.Float(line.tau)
    u, v = held(*start(tau))
    zero = dr.zeros(ty.Float)
    sign = ty.Float(line.sign)
    state = (active, ty.UInt(0), tau, u, v, sign, ty.Bool(False), t_max, zero, zero, zero)
    _run, _step, _tau, _u, _v, _sign, *results = dr.while_loop(
        state,
        cond=lambda *st: st[0],
        body=body,
        labels=(
            *("run", "step", "tau", "u", "v", "sign"),
            *("hit", "best", "best_u", "best_v", "best_closing"),
        ),
        label="bezier leaf march",
    )
    return tuple(results)
