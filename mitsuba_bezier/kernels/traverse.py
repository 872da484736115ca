"""Traversal of the tree: the nearest hit, or any hit, of rays with all leaves."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr

from ..geometry.tree import NO_LEAF
from .arrays import Types, dot3, gather_packets, types_of
from .leaf import exact_roots, graph_cull, graph_march, load_leaf
from .structure import FLAG_EXACT, NODE, Structure

__all__ = ["Hit", "intersect"]


class Hit(NamedTuple):
    """Result of `intersect`, all of the rays' width."""

    valid: Any  #: Bool
    t: Any  #: Float, infinite where not valid
    patch: Any  #: UInt
    u: Any  #: Float, patch barycentrics
    v: Any


def intersect(
    s: Structure, o: Any, d: Any, t_max: Any, active: Any = True, any_hit: bool = False
) -> Hit:
    """Intersect rays with all leaves of a structure.

    Parameters
    ----------
    s : Structure
    o, d : three Float arrays each
        Origin and direction; the direction need not have unit length.
    t_max : Float
        Hits have ``0 < t < t_max``.
    active : Bool
    any_hit : bool
        Stop at the first hit found; then only `valid` means something.
    """
    ty = types_of(o[0])
    o, d = [ty.Float(o[i]) for i in range(3)], [ty.Float(d[i]) for i in range(3)]
    t_max = ty.Float(t_max)
    length2 = dot3(d, d)
    # a ray that is no ray is a miss: NaN fails both comparisons
    finite = (dot3(o, o) < dr.inf) & (length2 > 0.0) & (length2 < dr.inf) & (t_max > 0.0)
    active = ty.Bool(active) & finite
    octant = (
        dr.select(d[0] < 0.0, ty.UInt(1), 0)
        | dr.select(d[1] < 0.0, ty.UInt(2), 0)
        | dr.select(d[2] < 0.0, ty.UInt(4), 0)
    )
    # finite reciprocals: zero times infinity would turn a slab into NaN
    rcp = [dr.rcp(dr.select(dr.abs(c) > 1e-20, c, dr.copysign(ty.Float(1e-20), c))) for c in d]
    end = (octant + 1) * s.node_count
    node = octant * s.node_count

    state = (active, node, t_max, ty.UInt(NO_LEAF), dr.zeros(ty.Float), dr.zeros(ty.Float))

    def body(run, node, t, hit_leaf, hit_u, hit_v):
        node, leaf = _next_leaf(s, ty, node, end, o, d, rcp, t, run)
        found = run & (leaf != NO_LEAF)
        index = dr.select(found, leaf, 0)
        parts = []
        if s.has_exact and s.has_graph:
            flags = dr.gather(ty.Float32, s.records, index * 32 + 31, found)
            is_exact = dr.reinterpret_array(ty.UInt, flags) == FLAG_EXACT
            parts = [(_exact, found & is_exact), (_graph, found & ~is_exact)]
        else:
            parts = [(_exact if s.has_exact else _graph, found)]
        for test, mask in parts:
            if len(parts) > 1:
                accept, new_t, u, v = dr.if_stmt(
                    args=(mask, index, t),
                    cond=mask,
                    true_fn=lambda m, i, t, test=test: test(s, ty, i, o, d, t, m),
                    false_fn=lambda m, i, t: (
                        ty.Bool(False),
                        t,
                        dr.zeros(ty.Float),
                        dr.zeros(ty.Float),
                    ),
                )
            else:
                accept, new_t, u, v = test(s, ty, index, o, d, t, mask)
            t = dr.select(accept, new_t, t)
            hit_leaf = dr.select(accept, leaf, hit_leaf)
            hit_u, hit_v = dr.select(accept, u, hit_u), dr.select(accept, v, hit_v)
        run = run & (node < end)
        if any_hit:
            run = run & (hit_leaf == NO_LEAF)
        return run, node, t, hit_leaf, hit_u, hit_v

    _run, _node, t, leaf, u, v = dr.while_loop(
        state,
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "node", "t", "leaf", "u", "v"),
        label="bezier traversal",
    )
    valid = active & (leaf != NO_LEAF)
    if any_hit:
        zero = dr.zeros(ty.Float)
        return Hit(valid, dr.select(valid, t, dr.inf), ty.UInt(0), zero, zero)
    return _resolve(s, ty, o, d, valid, t, leaf, u, v)


def _next_leaf(
    s: Structure, ty: Types, node: Any, end: Any, o: Any, d: Any, rcp: Any, t_max: Any, run: Any
) -> tuple[Any, Any]:
    """Walk the tree to the next leaf that may be hit; `NO_LEAF` when there is none."""

    # candidates of graph leaves are culled by their quadratic inside the same loop
    def body(walk, node, leaf):
        packet = gather_packets(s.nodes, node, NODE, walk)
        enter = dr.zeros(ty.Float)
        leave = t_max
        for a in range(3):
            lo, hi = (packet[a] - o[a]) * rcp[a], (packet[3 + a] - o[a]) * rcp[a]
            enter = dr.maximum(enter, dr.minimum(lo, hi))
            leave = dr.minimum(leave, dr.maximum(lo, hi))
        # two roundings a face (Ize, "Robust BVH Ray Traversal")
        hit = enter <= leave * _GROW
        skip = dr.reinterpret_array(ty.UInt, packet[6])
        found = dr.reinterpret_array(ty.UInt, packet[7])
        node = dr.select(hit, node + 1, skip)
        leaf = dr.select(hit, found, NO_LEAF)
        walk = walk & (leaf == NO_LEAF) & (node < end)
        return walk, node, leaf

    _walk, node, leaf = dr.while_loop(
        (run, node, ty.UInt(NO_LEAF)),
        cond=lambda *st: st[0],
        body=body,
        labels=("walk", "node", "leaf"),
        label="bezier boxes",
    )
    return node, leaf


_GROW = 1.0 + 4.0 * 6e-8


def _exact(s: Structure, ty: Types, leaf: Any, o: Any, d: Any, t_max: Any, active: Any) -> tuple:
    ray = load_leaf(s, ty, leaf, o, d, 3, active)
    near, far = exact_roots(ty, ray, d)
    t1 = ty.Float(ray.t0 + ty.Float64(near[0]))
    t2 = ty.Float(ray.t0 + ty.Float64(far[0]))
    ok1 = active & near[3] & (t1 > 0.0) & (t1 < t_max)
    ok2 = active & far[3] & (t2 > 0.0) & (t2 < t_max)
    return (
        ok1 | ok2,
        dr.select(ok1, t1, t2),
        dr.select(ok1, near[1], far[1]),
        dr.select(ok1, near[2], far[2]),
    )


def _graph(s: Structure, ty: Types, leaf: Any, o: Any, d: Any, t_max: Any, active: Any) -> tuple:
    ray = load_leaf(s, ty, leaf, o, d, 4 if s.projective else 3, active)
    lo, hi = ty.Float(-ray.t0), ty.Float(ty.Float64(t_max) - ray.t0)
    candidate, *_rest = graph_cull(s, ray, lo, hi)
    return graph_march(s, ty, leaf, o, d, ty.Float(0), t_max, active & candidate)


def _resolve(
    s: Structure, ty: Types, o: Any, d: Any, valid: Any, t: Any, leaf: Any, u: Any, v: Any
) -> Hit:
    """Turn leaf coordinates into patch coordinates; polish exact leaves in float64."""
    index = dr.select(valid, leaf, 0)
    bits = dr.gather(ty.Float32, s.records, index * 32 + 30, valid)
    patch = dr.reinterpret_array(ty.UInt, bits)
    if s.has_exact:
        t, u, v = _polish(s, ty, index, o, d, t, u, v, valid)
    m = gather_packets(s.domain, index, 9, valid)
    w = 1.0 - u - v
    bary = [dr.fma(m[3 * r], u, dr.fma(m[3 * r + 1], v, m[3 * r + 2] * w)) for r in range(3)]
    inv = dr.rcp(bary[0] + bary[1] + bary[2])
    return Hit(valid, dr.select(valid, t, dr.inf), patch, bary[0] * inv, bary[1] * inv)


def _polish(
    s: Structure, ty: Types, leaf: Any, o: Any, d: Any, t: Any, u: Any, v: Any, valid: Any
) -> tuple[Any, Any, Any]:
    """Do one Newton step along the ray on the float64 quadric of an exact leaf."""
    f64 = ty.Float64
    a = gather_packets(s.forms, leaf, 13, valid)
    dd = [f64(d[i]) for i in range(3)]
    p = [dr.fma(f64(t), dd[i], f64(o[i])) - a[10 + i] for i in range(3)]
    ax = dr.fma(a[0], p[0], dr.fma(a[3], p[1], dr.fma(a[4], p[2], a[6])))
    ay = dr.fma(a[3], p[0], dr.fma(a[1], p[1], dr.fma(a[5], p[2], a[7])))
    az = dr.fma(a[4], p[0], dr.fma(a[5], p[1], dr.fma(a[2], p[2], a[8])))
    aw = dr.fma(a[6], p[0], dr.fma(a[7], p[1], dr.fma(a[8], p[2], a[9])))
    value = dr.fma(ax, p[0], dr.fma(ay, p[1], dr.fma(az, p[2], aw)))
    slope = 2.0 * dot3([ax, ay, az], dd)
    step = -value / slope
    # near a silhouette the step is not small; the float32 root is then the better one
    return dr.select(dr.abs(step) < 1e-3 * dr.abs(t), ty.Float(f64(t) + step), t), u, v
