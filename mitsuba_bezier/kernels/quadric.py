"""Ray against a group of exact leaves: one quadric in closed form, then which patch it is."""

from __future__ import annotations

from typing import Any

import drjit as dr

from .arrays import Types, dot3, gather_packets
from .quadric_records import FEW, GROUP, MEMBER, TABLE
from .structure import Structure
from .trim import leaf_test

__all__ = ["edge_tolerance", "group_hit"]

#: A hit this far outside its leaf still counts, in leaf barycentrics: ten roundings of a
#: number near one, so that two leaves cannot both refuse a ray that meets their common edge.
EDGE = 1e-6
#: ... and at grazing angles, where an error across the surface is an error along it divided
#: by the cosine; never more than this.
EDGE_GRAZING = 3e-3
#: Error across the surface of a graph leaf in float32, in leaf sizes.
ACROSS = 1e-7
#: Rounding of the discriminant of a cone, over the square of half the linear coefficient: a few
#: hundred roundings of float64, and the square of a distance well below one of float32.
APEX = 1e-14
#: Rounding of a member's rows, in their own scale; it matters where all three coordinates are
#: small, at the centre of projection (the tip of a lune).
ROWS = 2e-7


def edge_tolerance(cosine: Any, across: Any = ACROSS) -> Any:
    """Return the tolerance in leaf barycentrics for a hit at this ``|cos|``.

    `across` is by how much, in leaf sizes, the surface that was met may differ from the patch.
    """
    return dr.minimum(EDGE_GRAZING, EDGE + across * dr.rcp(dr.maximum(cosine, 1e-12)))


def group_hit(
    s: Structure, ty: Types, group: Any, o: Any, d: Any, t_max: Any, active: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """Find the first hit with a group.

    The quadratic ``q s^2 + 2 b s + c = 0`` is solved in float64 about the point of the ray
    nearest the group's origin; so the parameter of a hit and the decision at a silhouette are
    as exact as the quadric itself.

    Returns
    -------
    hit : Bool
    t, u, v : Float
        Ray parameter; barycentrics of the patch.
    leaf : UInt
    """
    f64 = ty.Float64
    g = s.only_group or gather_packets(s.groups, group, GROUP, active)
    a = g[:10]
    dd = [f64(d[i]) for i in range(3)]
    od = [f64(o[i]) - g[10 + i] for i in range(3)]
    # any point near the group will do, the exact nearest is not needed
    length2 = dot3(d, d)
    t0 = f64(-dot3([o[i] - ty.Float(g[10 + i]) for i in range(3)], d) * dr.rcp(length2))
    p = [dr.fma(t0, dd[i], od[i]) for i in range(3)]
    ax = dr.fma(a[0], p[0], dr.fma(a[3], p[1], dr.fma(a[4], p[2], a[6])))
    ay = dr.fma(a[3], p[0], dr.fma(a[1], p[1], dr.fma(a[5], p[2], a[7])))
    az = dr.fma(a[4], p[0], dr.fma(a[5], p[1], dr.fma(a[2], p[2], a[8])))
    aw = dr.fma(a[6], p[0], dr.fma(a[7], p[1], dr.fma(a[8], p[2], a[9])))
    c = dr.fma(ax, p[0], dr.fma(ay, p[1], dr.fma(az, p[2], aw)))
    b = dr.fma(ax, dd[0], dr.fma(ay, dd[1], az * dd[2]))
    qx = dr.fma(a[0], dd[0], dr.fma(a[3], dd[1], a[4] * dd[2]))
    qy = dr.fma(a[3], dd[0], dr.fma(a[1], dd[1], a[5] * dd[2]))
    qz = dr.fma(a[4], dd[0], dr.fma(a[5], dd[1], a[2] * dd[2]))
    q = dr.fma(qx, dd[0], dr.fma(qy, dd[1], qz * dd[2]))
    disc = dr.fma(b, b, -q * c)
    # whether there are roots is decided in float64; they are found in float32 and then made exact
    # by one step of Newton's method, whose slopes are +-2 root
    qf, bf, cf = ty.Float(q), ty.Float(b), ty.Float(c)
    root = dr.sqrt(dr.maximum(ty.Float(disc), 0.0))
    h = -(bf + dr.copysign(root, bf))
    s1, s2 = cf / h, h / qf
    # q = 0 to rounding: one root is at infinity (a plane, a ray along an asymptote)
    linear = dr.abs(qf * s1) <= 1e-15 * dr.abs(h)
    half = 0.5 / dr.copysign(dr.maximum(root, 1e-7 * dr.abs(h)), bf)
    b2 = b + b
    exact1, exact2 = f64(s1), f64(s2)
    exact1 = exact1 - f64(ty.Float(dr.fma(dr.fma(q, exact1, b2), exact1, c)) * half)
    exact2 = exact2 + f64(ty.Float(dr.fma(dr.fma(q, exact2, b2), exact2, c)) * half)
    swap = ~linear & (exact2 < exact1)
    near = dr.select(swap, exact2, exact1)
    far = dr.select(swap, exact1, dr.select(linear, dr.inf, exact2))
    t1, t2 = ty.Float(t0 + near), ty.Float(t0 + far)
    # a line through the apex has a double root, which rounding must not take away
    valid = active & ((dr.fma(APEX * b, b, disc) if s.has_cones else disc) >= 0.0)
    want1 = valid & (t1 > 0.0) & (t1 < t_max)
    want2 = valid & (t2 > 0.0) & (t2 < t_max)
    middle = [ty.Float(p[i]) for i in range(3)]
    near32, far32 = ty.Float(near), ty.Float(far)
    gradient = [ty.Float(x) for x in (ax, ay, az)]

    def tolerance_for(gradient: list[Any]) -> Any:
        cosine = root * dr.rsqrt(dot3(gradient, gradient) * length2)
        return edge_tolerance(cosine, ty.Float(g[15]))

    tolerance1 = tolerance2 = tolerance_for(gradient)
    if s.has_cones:  # where the gradient has no size that it has everywhere, more or less
        turn = [ty.Float(x) for x in (qx, qy, qz)]
        tolerance1, tolerance2 = (
            tolerance_for([dr.fma(x, turn[i], gradient[i]) for i in range(3)])
            for x in (near32, far32)
        )
    p1 = [dr.fma(near32, d[i], middle[i]) for i in range(3)]
    p2 = [dr.fma(far32, d[i], middle[i]) for i in range(3)]

    first, count = ty.UInt(g[13]), ty.UInt(g[14])
    k, following = first, first + 1
    if dr.width(s.members) > dr.width(s.rows):
        first = first + (group + 1) * TABLE
        point = [dr.select(want1, a, b) for a, b in zip(p1, p2)]
        many = count >= FEW
        likely = _likely_member(s, ty, first, point, many & (want1 | want2))
        k = dr.select(many, first + dr.minimum(likely, count - 1), first)
        following = dr.select(many, first, first + 1)
    last = first + count
    none = dr.zeros(ty.UInt)
    state = (want1 | want2, k, following, ty.Bool(False), ty.Bool(False), none, none)

    def inside(m: list[Any], p: list[Any], tolerance: Any) -> Any:
        bary = _values(m, p)
        total = bary[0] + bary[1] + bary[2]
        # Compared before a division: near the centre of projection all four are roundings.
        # Only patches that reach the centre, the lunes, may have a hit there.
        size = dr.abs(total)
        sign = dr.select(m[14] != 0.0, 1.0, total)  # planes have sides, barycentrics have not
        signed = [dr.mulsign(b, sign) for b in bary]
        lowest = dr.minimum(dr.minimum(signed[0], signed[1]), signed[2])
        return (lowest >= -dr.fma(tolerance, size, ROWS)) & (size >= m[13])

    def in_disk(leaf: Any, bary: list[Any], active: Any) -> Any:
        number = dr.select(active, leaf - s.first_group, 0)
        d = gather_packets(s.rows, 2 * number + 1, 8, active)[4:]
        inverse = dr.rcp(bary[0] + bary[1] + bary[2])
        u, v = _in_disk(bary[0] * inverse, bary[1] * inverse, [ty.Float(x) for x in d])
        return dr.minimum(dr.minimum(u, v), 1.0 - u - v) >= -tolerance1

    def parameters(leaf: Any, along: Any, active: Any) -> tuple[Any, Any]:
        point = [dr.fma(along, dd[i], p[i]) for i in range(3)]
        planar = None
        if s.has_cones and s.has_disks:
            planar = sum(dr.abs(a[i]) for i in range(6)) == 0.0
        return _barycentrics(s, ty, leaf, point, planar, active)

    def body(run, k, following, hit1, hit2, leaf1, leaf2):
        m = gather_packets(s.members, k, MEMBER, run)
        leaf = dr.reinterpret_array(ty.UInt, m[12])
        is_in1, is_in2 = inside(m, p1, tolerance1), inside(m, p2, tolerance2)
        if s.has_disks:  # a plane is met once
            disk = m[14] <= -4.0
            is_in1 = dr.select(disk, in_disk(leaf, _values(m, p1), run & disk), is_in1)
        in1, in2 = want1 & ~hit1 & is_in1, want2 & ~hit2 & is_in2
        kept = leaf_test(s, leaf)
        if kept is not None:
            in1 = in1 & kept(*parameters(leaf, near, in1), in1)
            in2 = in2 & kept(*parameters(leaf, far, in2), in2)
        hit1, hit2 = hit1 | in1, hit2 | in2
        leaf1, leaf2 = dr.select(in1, leaf, leaf1), dr.select(in2, leaf, leaf2)
        run = run & (following < last) & ~hit1 & (want1 | ~hit2)
        return run, following, following + 1, hit1, hit2, leaf1, leaf2

    _run, _k, _following, hit1, hit2, leaf1, leaf2 = dr.while_loop(
        state,
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "member", "following", "hit1", "hit2", "leaf1", "leaf2"),
        label="bezier group members",
    )
    hit, leaf = hit1 | hit2, dr.select(hit1, leaf1, leaf2)
    along = dr.select(hit1, near, far)
    u, v = parameters(leaf, along, hit)
    tolerance = dr.select(hit1, tolerance1, tolerance2)
    u, v = (dr.clip(x, -tolerance, 1.0 + tolerance) for x in (u, v))
    return hit, dr.select(hit1, t1, t2), u, v, leaf


def _likely_member(s: Structure, ty: Types, first: Any, point: list[Any], active: Any) -> Any:
    """Look up which member of a group covers a point, most likely, in the table before them."""
    floats, bits = first * MEMBER, ty.UInt(0)
    word = dr.gather(ty.Float32, s.members, floats + (MEMBER - 1), active)
    word = dr.reinterpret_array(ty.UInt, word)
    for a in range(3):
        scale = dr.reinterpret_array(ty.Float32, ((word >> (10 * a)) & 1023) << 21)
        cell = ty.UInt(dr.clip(dr.fma(point[a], ty.Float(scale), 4.0), 0.0, 7.0))
        bits = bits | ((cell & 7) << (3 * a))
    word = dr.gather(ty.Float32, s.members, floats - TABLE * MEMBER + (bits >> 3), active)
    return (dr.reinterpret_array(ty.UInt, word) >> ((bits & 7) << 2)) & 15


def _values(rows: list[Any], p: list[Any]) -> list[Any]:
    """Return three linear forms of a point."""
    return [dot3(rows[4 * r : 4 * r + 3], p) + rows[4 * r + 3] for r in range(3)]


def _barycentrics(
    s: Structure, ty: Types, leaf: Any, p: list[Any], planar: Any, active: Any
) -> tuple[Any, Any]:
    """Invert a patch in float64: near the tip of a lune little is left of ``U`` in float32.

    For sectors these are the first two from the corner on that is their middle. `planar` tells a
    disk from a cone where there are both.
    """
    sectors = s.has_cones or s.has_disks
    number = dr.select(active, leaf - s.first_group, 0)
    m = gather_packets(s.rows, number, MEMBER if sectors else 12, active)
    bary = _values(m, p)
    total = ty.Float(bary[0] + bary[1] + bary[2])
    inv = dr.rcp(dr.select(total == 0.0, 1.0, total))
    b0, b1, b2 = (ty.Float(b) for b in bary)
    u, v = b0 * inv, b1 * inv
    if not sectors:
        return u, v
    # all that is no sector has a fourth row of zeros
    if s.has_disks:
        u, v = _in_disk(u, v, [ty.Float(x) for x in m[12:16]])
    if s.has_cones:
        last = ty.Float(dot3(m[12:15], p) + m[15])
        is_cone = last != 0.0
        if planar is not None:
            is_cone = is_cone & ~planar
        # through the larger: where a coordinate is small its root is not well known
        first = b0 >= b2
        large = dr.maximum(dr.select(first, b0, b2), 1e-30)
        one = dr.sqrt(large / last)
        other = one * b1 / (2.0 * large)
        u = dr.select(is_cone, dr.select(first, one, other), u)
        v = dr.select(is_cone, dr.select(first, other, one), v)
    return u, v


def _in_disk(a: Any, b: Any, disk: list[Any]) -> tuple[Any, Any]:
    """Return parameters of a sector of a disk; see `geometry.sector_leaves`."""
    d0, d1, _d2, total = disk
    e, f = dr.fma(total, a, -d0), dr.fma(total, b, -d1)
    half = 1.0 - dr.fma(e, b, f * a)
    root = dr.sqrt(dr.maximum(dr.fma(half, half, -4.0 * (e * f) * (a * b)), 0.0))
    k = 2.0 * (a * b) / (half + root)
    return dr.fma(k, e, a), dr.fma(k, f, b)
