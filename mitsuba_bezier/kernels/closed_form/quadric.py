"""Intersect rays with the patches of a quadric: in closed form, then which patch it is."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...leaves.records import CLOSED_FORMS
from ..arrays import dot3, inverse_root, reciprocal
from ..edges import edge_tolerance
from ..quadric_records import AXES, GROUP
from ..query import Found, Query, Rays
from ..two_float import fma, select
from .kinds import KINDS
from .members import Members, Roots, find_deferred, find_members

__all__ = ["group_hit"]

#: Rounding of the discriminant of a cone, over the squares of the gradient and of the direction: a
#: few hundred roundings of float64, and the square of a distance well below one of float32. Not
#: over the square of their product, which is small where a line runs beside one of the cone.
APEX = 1e-14
#: ... and of pairs of float32: there it is ten roundings.
APEX_OF_PAIRS = 1e-13


def group_hit(query: Query, group: Any, rays: Rays, active: Any) -> Found:
    """Find the first hit with a group.

    The quadratic ``q s^2 + 2 b s + c = 0`` is solved in wide numbers about the point of the ray
    nearest the group's origin; so the parameter of a hit and the decision at a silhouette are
    as exact as the quadric itself.
    """
    s, ty, o, d, t_max = query.s, query.ty, rays.o, rays.d, rays.t_max
    g = GROUP.read(s.only_group) if s.only_group else GROUP.gather(s.groups, group, active)
    a = g.quadric
    has_apexes = any(KINDS[k].singular for k in s.kinds & CLOSED_FORMS)
    dd = [ty.widen(d[i]) for i in range(3)]
    od = [ty.widen(o[i]) - g.shift[i] for i in range(3)]
    if s.axes is not None:  # in which the group is about as large in one direction as in another
        axes = AXES.gather(s.axes, group, active).rows
        od, dd = ([dot3(row, x) for row in axes] for x in (od, dd))
        o, d = ([ty.narrow(c) for c in x] for x in (od, dd))
    else:
        o = [o[i] - ty.narrow(g.shift[i]) for i in range(3)]
    # any point near the group will do, the exact nearest is not needed
    length2 = dot3(d, d)
    t0 = ty.widen(-dot3(o, d) * reciprocal(length2))
    p = [fma(t0, dd[i], od[i]) for i in range(3)]
    ax = fma(a[0], p[0], fma(a[3], p[1], fma(a[4], p[2], a[6])))
    ay = fma(a[3], p[0], fma(a[1], p[1], fma(a[5], p[2], a[7])))
    az = fma(a[4], p[0], fma(a[5], p[1], fma(a[2], p[2], a[8])))
    aw = fma(a[6], p[0], fma(a[7], p[1], fma(a[8], p[2], a[9])))
    c = fma(ax, p[0], fma(ay, p[1], fma(az, p[2], aw)))
    b = fma(ax, dd[0], fma(ay, dd[1], az * dd[2]))
    qx = fma(a[0], dd[0], fma(a[3], dd[1], a[4] * dd[2]))
    qy = fma(a[3], dd[0], fma(a[1], dd[1], a[5] * dd[2]))
    qz = fma(a[4], dd[0], fma(a[5], dd[1], a[2] * dd[2]))
    q = fma(qx, dd[0], fma(qy, dd[1], qz * dd[2]))
    disc = fma(b, b, -q * c)
    # whether there are roots is decided in wide numbers; they are found in float32 and then made
    # exact by one step of Newton's method, whose slopes are +-2 root
    qf, bf, cf = ty.narrow(q), ty.narrow(b), ty.narrow(c)
    root = dr.sqrt(dr.maximum(ty.narrow(disc), 0.0))
    h = -(bf + dr.copysign(root, bf))
    s1, s2 = cf / h, h / qf
    # q = 0 to rounding: one root is at infinity (a plane, a ray along an asymptote)
    linear = dr.abs(qf * s1) <= 1e-15 * dr.abs(h)
    half = 0.5 / dr.copysign(dr.maximum(root, 1e-7 * dr.abs(h)), bf)
    b2 = b + b
    exact1, exact2 = ty.widen(s1), ty.widen(s2)
    exact1 = exact1 - ty.widen(ty.narrow(fma(fma(q, exact1, b2), exact1, c)) * half)
    exact2 = exact2 + ty.widen(ty.narrow(fma(fma(q, exact2, b2), exact2, c)) * half)
    swap = ~linear & (exact2 < exact1)
    near = select(swap, exact2, exact1)
    far = select(swap, exact1, select(linear, dr.inf, exact2))
    t1, t2 = ty.narrow(t0 + near), ty.narrow(t0 + far)
    if has_apexes:  # lines through one have a double root, which rounding must not take away
        least = APEX_OF_PAIRS if ty.pairs else APEX
        disc = disc + least * dot3([ax, ay, az], [ax, ay, az]) * ty.widen(length2)
    valid = active & (disc >= 0.0)
    want1 = valid & (t1 > 0.0) & (t1 < t_max)
    want2 = valid & (t2 > 0.0) & (t2 < t_max)
    middle = [ty.narrow(p[i]) for i in range(3)]
    near32, far32 = ty.narrow(near), ty.narrow(far)
    gradient = [ty.narrow(x) for x in (ax, ay, az)]

    def tolerance_for(gradient: list[Any]) -> Any:
        cosine = root * inverse_root(dot3(gradient, gradient) * length2)
        return edge_tolerance(cosine, ty.narrow(g.deviation))

    tolerance1 = tolerance2 = tolerance_for(gradient)
    if has_apexes:  # where the gradient has no size that it has everywhere, more or less
        turn = [ty.narrow(x) for x in (qx, qy, qz)]
        tolerance1, tolerance2 = (
            tolerance_for([dr.fma(x, turn[i], gradient[i]) for i in range(3)])
            for x in (near32, far32)
        )
    p1 = [dr.fma(near32, d[i], middle[i]) for i in range(3)]
    p2 = [dr.fma(far32, d[i], middle[i]) for i in range(3)]

    roots = Roots([want1, want2], [near, far], [p1, p2], [tolerance1, tolerance2], p, dd)
    members = Members(group, ty.whole(g.first), ty.whole(g.count))
    deferred = any(KINDS[k].decide for k in s.kinds & CLOSED_FORMS)
    found = (find_deferred if deferred else find_members)(query, members, roots)
    tolerance = dr.select(found.second, tolerance2, tolerance1)
    u, v = (dr.clip(x, -tolerance, 1.0 + tolerance) for x in (found.u, found.v))
    return Found(found.hit, dr.select(found.second, t2, t1), u, v, found.leaf)
