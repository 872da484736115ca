"""Traversal of the tree: the nearest hit, or any hit, of rays with all leaves."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr

from ..geometry.tree import NO_LEAF
from .arrays import Types, dot3, gather_packets, types_of
from .chart import ChartLine, cull
from .march import march
from .quadric import group_hit
from .section import section_parameters
from .structure import DOMAIN, NODE, Structure

__all__ = ["Hit", "finish", "intersect", "next_leaf", "prepare", "search"]

#: Slabs are widened by four roundings a face: of the difference, the product and, two, of the
#: reciprocal (Ize, "Robust BVH Ray Traversal", 2013, who has three). The origin's coordinates
#: are moved apart by as much, as they are multiplied before the difference.
_ROUNDING = 4.0 * 6e-8
_GROW = 1.0 + 2.0 * _ROUNDING


class Hit(NamedTuple):
    """Result of `intersect`, all of the rays' width."""

    valid: Any  #: Bool
    t: Any  #: Float, infinite where not valid
    patch: Any  #: UInt
    u: Any  #: Float, patch barycentrics
    v: Any


class Slabs(NamedTuple):
    """What a slab test needs of a ray: ``plane * rcp + near`` is the entry, and the exit alike."""

    rcp: list[Any]  #: reciprocals of the direction, finite
    near: list[Any]  #: ``-o rcp``, a little less
    far: list[Any]  #: ``-o rcp``, a little more


def intersect(
    s: Structure, o: Any, d: Any, t_max: Any, active: Any = True, any_hit: bool = False
) -> Hit:
    """Intersect rays with all leaves of a structure.

    Parameters
    ----------
    s : Structure
        What to intersect.
    o, d : three Float arrays each
        Origin and direction; the direction need not have unit length.
    t_max : Float
        Hits have ``0 < t < t_max``.
    active : Bool
        Which rays to trace.
    any_hit : bool
        Stop at the first hit found; then only `valid` means something.
    """
    ty = types_of(o[0])
    o, d = [ty.Float(o[i]) for i in range(3)], [ty.Float(d[i]) for i in range(3)]
    t_max = ty.Float(t_max)
    active = ty.Bool(active) & is_ray(o, d, t_max)
    octant, slabs = prepare(ty, o, d)
    first = octant * s.node_count
    t, leaf, u, v = search(s, ty, o, d, slabs, t_max, first, first + s.node_count, active, any_hit)
    return finish(s, ty, t, leaf, u, v, active, any_hit)


def is_ray(o: list[Any], d: list[Any], t_max: Any) -> Any:
    """Tell which rays are rays; others, with NaN or without a direction, are misses."""
    length2 = dot3(d, d)
    # NaN fails all comparisons
    return (dot3(o, o) < dr.inf) & (length2 > 0.0) & (length2 < dr.inf) & (t_max > 0.0)


def prepare(ty: Types, o: list[Any], d: list[Any]) -> tuple[Any, Slabs]:
    """Return the octant of rays and what slab tests need."""
    octant = (
        dr.select(d[0] < 0.0, ty.UInt(1), 0)
        | dr.select(d[1] < 0.0, ty.UInt(2), 0)
        | dr.select(d[2] < 0.0, ty.UInt(4), 0)
    )
    # finite reciprocals: zero times infinity would turn a slab into NaN
    tiny = ty.Float(1e-20)
    rcp = [dr.rcp(dr.select(dr.abs(c) > tiny, c, dr.select(c < 0.0, -tiny, tiny))) for c in d]
    slabs = Slabs(
        rcp,
        [-dr.fma(dr.abs(o[a] * rcp[a]), _ROUNDING, o[a] * rcp[a]) for a in range(3)],
        [dr.fma(dr.abs(o[a] * rcp[a]), _ROUNDING, -o[a] * rcp[a]) for a in range(3)],
    )
    return octant, slabs


def search(
    s: Structure,
    ty: Types,
    o: list[Any],
    d: list[Any],
    slabs: Slabs,
    t_max: Any,
    first: Any,
    end: Any,
    active: Any,
    any_hit: bool,
) -> tuple[Any, Any, Any, Any]:
    """Search the nodes from `first` to `end`; return t, leaf (or `NO_LEAF`), u, v of the leaf."""

    def body(run, node, t, leaf, u, v):
        node, index, line = _next_candidate(s, ty, node, end, o, d, slabs, t, run)
        found = run & (index != NO_LEAF)
        if s.has_groups and (s.has_affine or s.has_projective):
            accept, t_new, u_new, v_new, leaf_new = dr.if_stmt(
                args=(found, index, line, t),
                cond=found & (index >= s.first_group),
                true_fn=lambda m, i, _l, t: group_hit(s, ty, i - s.first_group, o, d, t, m),
                false_fn=lambda m, i, line, t: (*march(s, ty, i, line, o, d, t, m), i),
                label="bezier leaf kind",
            )
        elif s.has_groups:
            accept, t_new, u_new, v_new, leaf_new = group_hit(s, ty, index, o, d, t, found)
        else:
            accept, t_new, u_new, v_new = march(s, ty, index, line, o, d, t, found)
            leaf_new = index
        t = dr.select(accept, t_new, t)
        leaf = dr.select(accept, leaf_new, leaf)
        u, v = dr.select(accept, u_new, u), dr.select(accept, v_new, v)
        run = run & (node < end)
        if any_hit:
            run = run & (leaf == NO_LEAF)
        return run, node, t, leaf, u, v

    zero = dr.zeros(ty.Float)
    _run, _node, t, leaf, u, v = dr.while_loop(
        (active, ty.UInt(first), t_max, ty.UInt(NO_LEAF), zero, zero),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "node", "t", "leaf", "u", "v"),
        label="bezier traversal",
    )
    return t, leaf, u, v


def finish(
    s: Structure, ty: Types, t: Any, leaf: Any, u: Any, v: Any, active: Any, any_hit: bool
) -> Hit:
    """Turn a leaf and its parameters into a patch and its."""
    valid = active & (leaf != NO_LEAF)
    t = dr.select(valid, t, dr.inf)
    if any_hit:
        zero = dr.zeros(ty.Float)
        return Hit(valid, t, ty.UInt(0), zero, zero)
    m = gather_packets(s.domain, dr.select(valid, leaf, 0), DOMAIN, valid)
    patch = dr.reinterpret_array(ty.UInt, m[9])
    if s.has_sections:
        u, v = section_parameters(s, ty, leaf, u, v, valid & (m[11] > 0.0))
    if s.has_affine or s.has_projective:
        w = 1.0 - u - v
        bary = [dr.fma(m[3 * r], u, dr.fma(m[3 * r + 1], v, m[3 * r + 2] * w)) for r in range(3)]
        inv = dr.rcp(bary[0] + bary[1] + bary[2])
        u, v = bary[0] * inv, bary[1] * inv
    return Hit(valid, t, patch, u, v)


def _next_candidate(
    s: Structure, ty: Types, node: Any, end: Any, o: Any, d: Any, slabs: Slabs, t_max: Any, run: Any
) -> tuple[Any, Any, ChartLine]:
    """Walk the tree to the next leaf that its quadratic does not exclude.

    Boxes and quadratics share one loop, so that the lanes of a packet that found a candidate
    wait for the others here and all march together.
    """
    if not (s.has_affine or s.has_projective):
        node, leaf = next_leaf(s.nodes, ty, node, end, slabs, t_max, run)
        return node, leaf, ChartLine.zero(ty)

    def body(walk, node, leaf, line):
        node, leaf = next_leaf(s.nodes, ty, node, end, slabs, t_max, walk)
        found = walk & (leaf != NO_LEAF)
        graph = found & (leaf < s.first_group) if s.has_groups else found
        candidate, line = cull(s, ty, leaf, o, d, t_max, graph)
        candidate = found & (candidate | ~graph)
        leaf = dr.select(candidate, leaf, NO_LEAF)
        walk = walk & ~candidate & (node < end)
        return walk, node, leaf, line

    _walk, node, leaf, line = dr.while_loop(
        (run, node, ty.UInt(NO_LEAF), ChartLine.zero(ty)),
        cond=lambda *st: st[0],
        body=body,
        labels=("walk", "node", "leaf", "line"),
        label="bezier candidates",
    )
    return node, leaf, line


def next_leaf(
    nodes: Any, ty: Types, node: Any, end: Any, slabs: Slabs, t_max: Any, run: Any
) -> tuple[Any, Any]:
    """Walk the tree to the next leaf whose box is hit; `NO_LEAF` when there is none."""

    def body(walk, node, leaf):
        packet = gather_packets(nodes, node, NODE, walk)
        enter, leave = dr.zeros(ty.Float), t_max
        for a in range(3):
            # one instruction each; those of dr.maximum and dr.minimum look out for NaN
            near = dr.fma(packet[a], slabs.rcp[a], slabs.near[a])
            far = dr.fma(packet[3 + a], slabs.rcp[a], slabs.far[a])
            enter = dr.select(near > enter, near, enter)
            leave = dr.select(far < leave, far, leave)
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
