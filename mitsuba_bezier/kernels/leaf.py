"""Ray against one leaf: closed form for exact leaves, certified march for graph leaves.

``docs/intersection.md`` gives the argument; `mitsuba_bezier.geometry.leaves` the records.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from .arrays import Types, dot3, gather_packets
from .net import horner
from .structure import RECORD, Structure

__all__ = ["LeafRay", "edge_tolerance", "exact_roots", "graph_cull", "graph_march", "load_leaf"]

#: A hit this far outside its leaf still counts, in leaf barycentrics: ten roundings of a
#: number near one, so that two leaves cannot both refuse a ray that meets their common edge.
EDGE = 1e-6
#: ... and at grazing angles, where an error across the surface is an error along it divided
#: by the cosine; never more than this.
EDGE_GRAZING = 3e-3


@dataclass
class LeafRay:
    """A ray in the frame of a leaf.

    ``origin`` and ``direction`` hold the frame's rows applied to the point of the ray that is
    nearest the leaf's origin, at ray parameter ``t0`` (float64), and to its direction.
    """

    record: list[Any]
    t0: Any
    near: list[Any]
    origin: list[Any]
    direction: list[Any]


def load_leaf(
    s: Structure, ty: Types, leaf: Any, o: Any, d: Any, rows: int, active: Any
) -> LeafRay:
    """Read a leaf record and express the ray in its frame.

    The shift to the point nearest the leaf is done in float64: it is what keeps distant or
    far-off rays exact, as all that follows has numbers of the leaf's own size.
    """
    record = gather_packets(s.records, leaf, RECORD, active)
    f64 = ty.Float64
    od = [f64(o[i]) - f64(record[i]) for i in range(3)]
    dd = [f64(d[i]) for i in range(3)]
    t0 = -dot3(od, dd) / dot3(dd, dd)
    near = [ty.Float(dr.fma(t0, dd[i], od[i])) for i in range(3)]
    origin, direction = [], []
    for r in range(rows):
        row = record[4 + 4 * r : 8 + 4 * r]
        origin.append(dot3(row, near) + row[3])
        direction.append(dot3(row, d))
    return LeafRay(record, t0, near, origin, direction)


def edge_tolerance(cosine: Any) -> Any:
    """Return the tolerance in leaf barycentrics for a hit at this ``|cos|``."""
    return dr.minimum(EDGE_GRAZING, EDGE + 1e-7 / dr.maximum(cosine, 1e-12))


# ---------------------------------------------------------------------- exact leaves


def exact_roots(ty: Types, ray: LeafRay, d: Any) -> list[tuple[Any, Any, Any, Any]]:
    """Return both meetings with the quadric as ``(s, u, v, inside)``, nearer first.

    ``s`` is the ray parameter measured from ``ray.t0``. The quadratic is solved about the
    point nearest the leaf's origin, with the discriminant as an exact difference of products
    (Kahan), so that what is lost near a silhouette is a rounding of the leaf's size.
    """
    a = ray.record[20:30]
    p = ray.near
    ax = dr.fma(a[0], p[0], dr.fma(a[3], p[1], dr.fma(a[4], p[2], a[6])))
    ay = dr.fma(a[3], p[0], dr.fma(a[1], p[1], dr.fma(a[5], p[2], a[7])))
    az = dr.fma(a[4], p[0], dr.fma(a[5], p[1], dr.fma(a[2], p[2], a[8])))
    aw = dr.fma(a[6], p[0], dr.fma(a[7], p[1], dr.fma(a[8], p[2], a[9])))
    c = dr.fma(ax, p[0], dr.fma(ay, p[1], dr.fma(az, p[2], aw)))
    b = dr.fma(ax, d[0], dr.fma(ay, d[1], az * d[2]))
    qx = dr.fma(a[0], d[0], dr.fma(a[3], d[1], a[4] * d[2]))
    qy = dr.fma(a[3], d[0], dr.fma(a[1], d[1], a[5] * d[2]))
    qz = dr.fma(a[4], d[0], dr.fma(a[5], d[1], a[2] * d[2]))
    q = dr.fma(qx, d[0], dr.fma(qy, d[1], qz * d[2]))
    # q s^2 + 2 b s + c = 0
    qc = q * c
    disc = dr.fma(b, b, -qc) - dr.fma(q, c, -qc)
    root = dr.sqrt(dr.maximum(disc, 0.0))
    h = -(b + dr.copysign(root, b))
    s1, s2 = c / h, h / q
    valid = disc >= 0.0
    near, far = dr.minimum(s1, s2), dr.maximum(s1, s2)
    # q = 0: one root is at infinity (a planar patch, or a ray along an asymptote)
    linear = dr.abs(q) * dr.abs(s1) <= 1e-12 * dr.abs(h)
    near, far = dr.select(linear, s1, near), dr.select(linear, dr.inf, far)
    gradient = dr.sqrt(dr.fma(ax, ax, dr.fma(ay, ay, az * az)))
    cosine = root / dr.maximum(gradient, 1e-30)
    tolerance = edge_tolerance(cosine)
    out = []
    for s in (near, far):
        bary = [dr.fma(s, ray.direction[r], ray.origin[r]) for r in range(3)]
        total = bary[0] + bary[1] + bary[2]
        inv = dr.rcp(total)
        u, v, w = bary[0] * inv, bary[1] * inv, bary[2] * inv
        inside = valid & (dr.minimum(dr.minimum(u, v), w) >= -tolerance)
        out.append((s, u, v, inside))
    return out


# ---------------------------------------------------------------------- graph leaves


def _chart_line(s: Structure, ray: LeafRay) -> tuple[list[Any], list[Any]]:
    """Return the affine line ``x0 + tau e`` of the ray in the chart.

    In an affine chart ``tau`` is the ray parameter from ``t0``. In a projective one the
    point of homogeneous parameter ``(a_w, b_w)`` on the line is taken as origin: it is never
    at the chart's infinity (``w = a_w^2 + b_w^2``).
    """
    a, b = ray.origin, ray.direction
    if not s.projective:
        return a[:3], b[:3]
    inv = dr.rcp(dr.fma(a[3], a[3], b[3] * b[3]))
    x0 = [dr.fma(a[3], a[i], b[3] * b[i]) * inv for i in range(3)]
    e = [dr.fma(a[3], b[i], -b[3] * a[i]) * inv for i in range(3)]
    return x0, e


def _ray_parameter(s: Structure, ray: LeafRay, tau: Any) -> Any:
    """Return the ray parameter from ``t0`` of chart parameter `tau`."""
    if not s.projective:
        return tau
    aw, bw = ray.origin[3], ray.direction[3]
    return dr.fma(tau, aw, bw) / dr.fma(-tau, bw, aw)


def _clip(s: Structure, ray: LeafRay, x0: list, e: list, lo: Any, hi: Any) -> tuple[Any, Any]:
    """Clip the line to the enlarged prism over the leaf; `lo`, `hi` bound an affine tau."""
    margin, height = ray.record[26], ray.record[3]
    if s.projective:
        affine = ray.direction[3] == 0.0
        lo, hi = dr.select(affine, lo, -dr.inf), dr.select(affine, hi, dr.inf)
    rest0, rest1 = 1.0 - x0[0] - x0[1], -e[0] - e[1]
    for f0, f1, bound in (
        (x0[0], e[0], margin),
        (x0[1], e[1], margin),
        (rest0, rest1, margin),
        (x0[2], e[2], height),
        (-x0[2], -e[2], height),
    ):
        # f0 + tau f1 >= -bound; a direction component of zero gives an empty or whole line
        cut = (-bound - f0) / f1
        outside = (f1 == 0.0) & (f0 < -bound)
        lo = dr.select(f1 > 0.0, dr.maximum(lo, cut), dr.select(outside, dr.inf, lo))
        hi = dr.select(f1 < 0.0, dr.minimum(hi, cut), hi)
    return lo, hi


def _quadratic(ray: LeafRay, x0: list, e: list) -> tuple[Any, Any, Any]:
    """Return ``alpha + 2 beta tau + gamma tau^2``: the ray's height over the quadratic."""
    a, b, c = ray.record[20], ray.record[21], ray.record[22]
    w0, ew = 1.0 - x0[0] - x0[1], -e[0] - e[1]
    alpha = x0[2] - dr.fma(a * x0[0], x0[1], dr.fma(b * x0[0], w0, c * x0[1] * w0))
    mixed = dr.fma(
        a,
        dr.fma(x0[0], e[1], e[0] * x0[1]),
        dr.fma(b, dr.fma(x0[0], ew, e[0] * w0), c * dr.fma(x0[1], ew, e[1] * w0)),
    )
    beta = 0.5 * (e[2] - mixed)
    gamma = -dr.fma(a * e[0], e[1], dr.fma(b * e[0], ew, c * e[1] * ew))
    return alpha, beta, gamma


def _first_root(value: Any, slope: Any, half_second: Any) -> tuple[Any, Any]:
    """Return the step to the first zero of ``value + slope x + half_second x^2``, and if any.

    For ``value >= 0`` the first positive zero; for a small negative one the zero behind.
    """
    disc = dr.fma(slope, slope, -4.0 * half_second * value)
    denominator = dr.sqrt(dr.maximum(disc, 0.0)) - slope
    return 2.0 * value / denominator, (disc >= 0.0) & (denominator > 0.0)


def graph_cull(s: Structure, ray: LeafRay, lo: Any, hi: Any) -> tuple[Any, Any, Any, Any]:
    """Cull with the leaf's quadratic.

    Returns
    -------
    candidate : Bool
        False: there is certainly no hit in this leaf.
    tau : Float
        The surface is certainly not met between the entry and this chart parameter.
    end : Float
        Where the ray leaves the prism.
    sign : Float
        On which side of the surface the ray enters; zero where the quadratic cannot tell.
    """
    x0, e = _chart_line(s, ray)
    lo, hi = _clip(s, ray, x0, e, lo, hi)
    alpha, beta, gamma = _quadratic(ray, x0, e)
    remainder = ray.record[23]
    value = dr.fma(dr.fma(gamma, lo, 2.0 * beta), lo, alpha)
    sign = dr.copysign(1.0, value)
    gap = dr.abs(value) - remainder
    slope = sign * 2.0 * dr.fma(gamma, lo, beta)
    step, exists = _first_root(gap, slope, sign * gamma)
    clear = gap > 0.0
    tau = dr.select(clear, lo + step, lo)
    candidate = (lo <= hi) & (~clear | (exists & (tau <= hi)))
    return candidate, tau, hi, dr.select(clear, sign, 0.0)


def graph_march(
    s: Structure,
    ty: Types,
    leaf: Any,
    o: Any,
    d: Any,
    t_min: Any,
    t_max: Any,
    active: Any,
    max_steps: int = 16,
) -> tuple[Any, Any, Any, Any]:
    """Find the first hit in a graph leaf.

    The march keeps a chart parameter ``tau`` before which there is no (further) meeting with
    the surface. It steps to the first zero of the quadratic lower bound that the value, the
    slope and the stored bound on the second derivative give, which never jumps over a root
    and converges quadratically to it, also when two roots are close.

    Returns
    -------
    hit : Bool
    t : Float
        Ray parameter.
    u, v : Float
        Leaf barycentrics.
    """
    ray = load_leaf(s, ty, leaf, o, d, 4 if s.projective else 3, active)
    f64 = ty.Float64
    lo, hi = ty.Float(f64(t_min) - ray.t0), ty.Float(f64(t_max) - ray.t0)
    candidate, tau, end, sign = graph_cull(s, ray, lo, hi)
    x0, e = _chart_line(s, ray)
    _alpha, _beta, gamma = _quadratic(ray, x0, e)
    variation, bending = ray.record[24], ray.record[25]
    lateral2 = dr.fma(e[0], e[0], e[1] * e[1])
    wobble = 0.5 * variation * lateral2  # half the uncertainty of the second derivative
    speed = dr.sqrt(dr.fma(e[2], e[2], lateral2))
    width = s.degree
    count = (width + 1) * (width + 2) // 2 * 4
    net = gather_packets(s.nets, leaf, count, active & candidate)

    u = dr.fma(tau, e[0], x0[0])
    v = dr.fma(tau, e[1], x0[1])
    zero = dr.zeros(ty.Float, 1)
    state = (
        active & candidate,
        ty.UInt(0),
        tau,
        u,
        v,
        sign,
        ty.Bool(False),
        ty.Float(dr.inf),
        zero,
        zero,
    )

    def body(run, step, tau, u, v, sign, hit, best, best_u, best_v):
        p, pu, pv = horner(net, width, u, v)
        inv = dr.rcp(1.0 + p[3])
        x, y, z = (u + p[0]) * inv, (v + p[1]) * inv, p[2] * inv
        # partials of the affine chart point; the identity was split off x, y and W
        xu, yu, zu = (
            (1.0 + pu[0] - x * pu[3]) * inv,
            (pu[1] - y * pu[3]) * inv,
            (pu[2] - z * pu[3]) * inv,
        )
        xv, yv, zv = (
            (pv[0] - x * pv[3]) * inv,
            (1.0 + pv[1] - y * pv[3]) * inv,
            (pv[2] - z * pv[3]) * inv,
        )
        idet = dr.rcp(dr.fma(xu, yv, -xv * yu))
        rx, ry = dr.fma(tau, e[0], x0[0]) - x, dr.fma(tau, e[1], x0[1]) - y
        du, dv = dr.fma(yv, rx, -xv * ry) * idet, dr.fma(xu, ry, -yu * rx) * idet
        eu, ev = dr.fma(yv, e[0], -xv * e[1]) * idet, dr.fma(xu, e[1], -yu * e[0]) * idet
        value = dr.fma(tau, e[2], x0[2]) - z - dr.fma(zu, du, zv * dv)
        slope = e[2] - dr.fma(zu, eu, zv * ev)
        off2 = dr.fma(rx, rx, ry * ry)
        slack = bending * off2  # what linear extrapolation to the ray's vertical may miss
        # The side is known from the entry on, or as soon as the value says it for certain;
        # until then the march stays where it is and only (u, v) improve.
        certain = (sign != 0.0) | (dr.abs(value) > slack) | (off2 < 1e-10)
        sign = dr.select(certain & (sign == 0.0), dr.copysign(1.0, value), sign)
        # the slope is that at (x, y); the ray is sqrt(off2) away from there
        tilt = 2.0 * bending * dr.sqrt(off2 * lateral2)
        signed, signed_slope = sign * value, sign * slope - tilt
        sure = dr.select(signed > 0.0, dr.maximum(signed - slack, 0.0), signed)
        half_second = sign * gamma - wobble
        delta, exists = _first_root(sure, signed_slope, half_second)
        delta, exists = dr.select(certain, delta, 0.0), exists | ~certain
        newton = -value / slope
        small = dr.abs(newton) * speed < _STEP
        close = (off2 < _STEP * _STEP) & (dr.abs(delta) * speed < _STEP)
        converged = certain & exists & close & small
        # on the last step the first-order term decides, without the slack
        delta = dr.select(converged, newton, delta)
        next_tau = tau + delta
        next_u, next_v = u + dr.fma(eu, delta, du), v + dr.fma(ev, delta, dv)

        # a root: is it ours?
        cosine = dr.abs(slope) / dr.sqrt(
            dr.fma(lateral2, 1.0, e[2] * e[2]) * (1.0 + dr.square(zu) + dr.square(zv))
        )
        tolerance = edge_tolerance(cosine)
        inside = dr.minimum(dr.minimum(next_u, next_v), 1.0 - next_u - next_v) >= -tolerance
        t = ty.Float(ray.t0 + f64(_ray_parameter(s, ray, next_tau)))
        accept = run & converged & inside & (t > t_min) & (t < t_max) & (t < best)
        hit = hit | accept
        best = dr.select(accept, t, best)
        best_u, best_v = dr.select(accept, next_u, best_u), dr.select(accept, next_v, best_v)

        # not ours: go on from the other side of the surface
        other = sign * gamma + wobble  # = -(half_second for the other sign)
        jump = dr.abs(slope) / other
        again = converged & ~accept & (other > 0.0)
        far_tau = next_tau + jump
        far_u, far_v = dr.fma(far_tau, e[0], x0[0]), dr.fma(far_tau, e[1], x0[1])
        sign = dr.select(again, -sign, sign)
        tau = dr.select(again, far_tau, next_tau)
        u, v = dr.select(again, far_u, next_u), dr.select(again, far_v, next_v)
        step = step + 1
        run = run & dr.select(converged, again, exists) & (tau <= end) & (step < max_steps)
        return run, step, tau, u, v, sign, hit, best, best_u, best_v

    _run, _step, _tau, _u, _v, _sign, hit, best, best_u, best_v = dr.while_loop(
        state,
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "tau", "u", "v", "sign", "hit", "best", "best_u", "best_v"),
        label="bezier leaf march",
    )
    return hit, best, best_u, best_v


#: Steps below this (in leaf sizes) are the last: the error after it is its square times the
#: leaf's bending, below the rounding of float32.
_STEP = 3e-4
