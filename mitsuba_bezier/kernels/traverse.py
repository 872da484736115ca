"""Traverse the BVH: the nearest hit, or any hit, of rays with all leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from ..leaves.bvh import NO_LEAF
from ..leaves.records import CLOSED_FORMS, INVERTED_KINDS
from .arrays import reciprocal, types_of
from .closed_form.kinds import KINDS
from .closed_form.quadric import group_hit
from .graph.chart import ChartLine, cull
from .graph.march import march
from .query import Found, Hit, Nearest, Query, Rays
from .records import is_kind
from .revolution import revolution_hit
from .structure import DOMAIN, Structure
from .walk import BvhRays, Walk, begin, next_leaf, prepare, take_leaf, walk_to_leaves

__all__ = ["cull_leaf", "finish", "intersect", "meet", "search", "take_candidate"]


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
    ty = types_of(o[0], s.pairs)
    query, rays = Query(s, ty, any_hit), Rays.of(ty, o, d, t_max)
    active = ty.Bool(active) & rays.are_valid()
    bvh = BvhRays(s.nodes, ty, ty.UInt(0), prepare(ty, rays.o, rays.d))
    walk = begin(ty, s.nodes, bvh.slabs, rays.t_max)
    if s.only_group is not None and not (s.has_graphs or s.has_revolutions):
        nearest = _meet_group(query, rays, active & (walk.leaves != 0))
    else:
        nearest = search(query, bvh, rays, walk, active)
    return finish(query, nearest, active)


def _meet_group(query: Query, rays: Rays, active: Any) -> Nearest:
    """Do what `search` does where all there is are the patches of one quadric: no BVH to walk."""
    ty = query.ty

    def meet_it(active: Any) -> Any:
        found = group_hit(query, ty.UInt(0), rays, active)
        return Nearest(found.t, dr.select(found.hit, found.leaf, NO_LEAF), found.u, found.v)

    return dr.if_stmt(
        args=(active,),
        cond=active,
        true_fn=meet_it,
        false_fn=lambda _active: Nearest.none(ty, rays.t_max),
        label="bezier one group",
    )


def search(query: Query, bvh: BvhRays, rays: Rays, walk: Walk, active: Any) -> Nearest:
    """Search a BVH from where `walk` is."""
    s, ty = query.s, query.ty
    if not (s.has_graphs or s.has_groups or s.has_revolutions):
        none = Nearest.none(ty, rays.t_max)
        return replace(none, leaf=dr.full(ty.UInt, NO_LEAF, dr.width(active)))

    def body(run: Any, walk: Any, nearest: Any) -> Any:
        nearer = rays.until(nearest.t)

        def candidate(walk: Any, run: Any) -> Any:
            return _candidate(query, bvh, nearer, walk, run)

        if query.any_hit:
            walk, leaf, line = _until_found(query, candidate, walk, run)
        else:
            walk, leaf, line = candidate(walk, run)
        found = meet(query, leaf, line, nearer, run & (leaf != NO_LEAF))
        nearest = nearest.updated(found)
        run = run & walk.goes_on()
        if query.any_hit:
            run = run & (nearest.leaf == NO_LEAF)
        return run, walk, nearest

    return dr.while_loop(
        (active & walk.goes_on(), walk, Nearest.none(ty, rays.t_max)),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "walk", "nearest"),
        label="bezier traversal",
    )[2]


def meet(query: Query, leaf: Any, line: ChartLine, rays: Rays, active: Any) -> Found:
    """Find the first hit in a leaf, or in a group; or only whether there is one.

    Then nothing is to be found where culling knew.
    """
    if not query.ends_where_certain:
        return _meet(query, leaf, line, rays, active)
    found = dr.if_stmt(
        args=(leaf, line, rays.t_max),
        cond=active & ~line.certain_hit,
        true_fn=lambda leaf, line, t: _meet(
            query, leaf, line, rays.until(t), active & ~line.certain_hit
        ),
        false_fn=lambda leaf, line, t: _no_more(query, leaf, line.certain_hit, t),
        label="bezier uncertain",
    )
    return replace(found, hit=active & found.hit)


def _no_more(query: Query, leaf: Any, hit: Any, t: Any) -> Found:
    """Return a hit of which it is only known that it is one."""
    return Found(hit, t, dr.zeros(query.ty.Float), dr.zeros(query.ty.Float), leaf)


def _meet(query: Query, leaf: Any, line: ChartLine, rays: Rays, active: Any) -> Found:
    """Choose by kind what finds the first hit."""
    s = query.s
    if s.revolutions is None:
        return _meet_patch(query, leaf, line, rays, active)
    first = s.revolutions.first
    if not (s.has_graphs or s.has_groups):
        return revolution_hit(query, leaf - first, rays, active)
    return dr.if_stmt(
        args=(active, leaf, line, rays.t_max),
        cond=active & (leaf >= first),
        true_fn=lambda m, i, _line, t: revolution_hit(query, i - first, rays.until(t), m),
        false_fn=lambda m, i, line, t: _meet_patch(query, i, line, rays.until(t), m),
        label="bezier asphere",
    )


def _meet_patch(query: Query, leaf: Any, line: ChartLine, rays: Rays, active: Any) -> Found:
    """Do what `_meet` does for leaves that are no aspheres."""
    s = query.s
    if not s.has_groups:
        return march(query, leaf, line, rays, active)
    if not s.has_graphs:
        return group_hit(query, leaf, rays, active)
    return dr.if_stmt(
        args=(active, leaf, line, rays.t_max),
        cond=active & (leaf >= s.first_group),
        true_fn=lambda m, i, _line, t: group_hit(query, i - s.first_group, rays.until(t), m),
        false_fn=lambda m, i, line, t: march(query, i, line, rays.until(t), m),
        label="bezier leaf kind",
    )


def finish(query: Query, nearest: Nearest, active: Any) -> Hit:
    """Turn a leaf and its parameters into a patch and its."""
    s, ty = query.s, query.ty
    leaf, u, v = nearest.leaf, nearest.u, nearest.v
    valid = active & (leaf != NO_LEAF)
    t = dr.select(valid, nearest.t, dr.inf)
    if query.any_hit:
        zero = dr.zeros(ty.Float)
        return Hit(valid, t, ty.UInt(0), zero, zero)
    m = None
    if s.domain is not None:
        m = DOMAIN.gather(s.domain, dr.select(valid, leaf, 0), valid)
    for kind in sorted(s.kinds & CLOSED_FORMS):
        at_hit = KINDS[kind].at_hit
        if at_hit is not None:
            mine = valid if m is None else valid & is_kind(m.kind, kind)
            u, v = at_hit(query, m, leaf, u, v, mine)
    if m is None:  # patches are leaves, and of one kind
        return Hit(valid, t, dr.select(valid, leaf, 0), u, v)
    if s.has_graphs or s.has(*INVERTED_KINDS):  # or leaves are patches
        w = 1.0 - u - v
        bary = [dr.fma(row[0], u, dr.fma(row[1], v, row[2] * w)) for row in m.map]
        inv = reciprocal(bary[0] + bary[1] + bary[2])
        u, v = bary[0] * inv, bary[1] * inv
    return Hit(valid, t, m.patch, u, v)


def take_candidate(
    query: Query, bvh: BvhRays, rays: Rays, leaves: Any, run: Any
) -> tuple[Any, Any, ChartLine]:
    """Take a leaf out of a walk's `leaves`, and turn it down if it is culled."""
    leaves, leaf = take_leaf(bvh, leaves, run)
    candidate, line = cull_leaf(query, leaf, rays, run & (leaf != NO_LEAF))
    return leaves, dr.select(candidate, leaf, NO_LEAF), line


def cull_leaf(query: Query, leaf: Any, rays: Rays, active: Any) -> tuple[Any, ChartLine]:
    """Cull a leaf as `chart.cull` does, or let a group pass."""
    s = query.s
    if not s.has_graphs:
        return active, ChartLine.zero(query.ty)
    graph = active if s.has_only_graphs else active & (leaf < s.first_group)
    candidate, line = cull(query, leaf, rays, graph)
    if not s.has_only_graphs:
        line = replace(line, certain_hit=line.certain_hit & graph)
    return active & (candidate | ~graph), line


def _until_found(query: Query, candidate: Any, walk: Walk, run: Any) -> tuple[Walk, Any, ChartLine]:
    """Repeat `candidate` until there is one, or the BVH is at its end.

    The lanes of a packet that found one wait for the others, and all march together: the least
    marches. It pays where few go on after their first.
    """
    ty = query.ty

    def body(go: Any, walk: Any, leaf: Any, line: Any) -> Any:
        walk, leaf, line = candidate(walk, go)
        return go & (leaf == NO_LEAF) & walk.goes_on(), walk, leaf, line

    _go, walk, leaf, line = dr.while_loop(
        (run, walk, ty.UInt(NO_LEAF), ChartLine.zero(ty)),
        cond=lambda *st: st[0],
        body=body,
        labels=("go", "walk", "leaf", "line"),
        label="bezier candidates",
    )
    return walk, leaf, line


def _candidate(
    query: Query, bvh: BvhRays, rays: Rays, walk: Walk, run: Any
) -> tuple[Walk, Any, ChartLine]:
    """Walk to the next node with leaves, and find the first that its quadratic does not exclude.

    There may be none, and still more of the BVH. For the closest hit leaves are culled in pairs:
    that takes less than twice the time of one, most of which is waiting for results.
    """
    ty = query.ty
    if not query.s.has_graphs:
        walk, leaf = next_leaf(bvh, walk, rays.t_max, run)
        return walk, leaf, ChartLine.zero(ty)

    def body(go: Any, leaves: Any, leaf: Any, line: Any) -> Any:
        leaves, leaf, line = take_candidate(query, bvh, rays, leaves, go)
        if not query.any_hit:
            others, second, its_line = take_candidate(query, bvh, rays, leaves, go)
            found = leaf != NO_LEAF
            # a second candidate stays, and will be culled again
            leaves = dr.select(found & (second != NO_LEAF), leaves, others)
            leaf, line = dr.select(found, leaf, second), dr.select(found, line, its_line)
        go = go & (leaf == NO_LEAF) & (leaves != 0)
        return go, leaves, leaf, line

    walk = walk_to_leaves(bvh, walk, rays.t_max, run)
    _go, leaves, leaf, line = dr.while_loop(
        (run & (walk.leaves != 0), walk.leaves, ty.UInt(NO_LEAF), ChartLine.zero(ty)),
        cond=lambda *st: st[0],
        body=body,
        labels=("go", "leaves", "leaf", "line"),
        label="bezier quadratics",
    )
    return replace(walk, leaves=leaves), leaf, line
