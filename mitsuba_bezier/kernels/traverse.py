"""Traverse the BVH: the nearest hit, or any hit, of rays with all leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import drjit as dr

from ..leaves.bvh import NO_LEAF
from ..leaves.records import INVERTED_KINDS, LeafKind
from .arrays import Types, dot3, reciprocal, types_of
from .closed_form.newton import section_parameters
from .closed_form.quadric import group_hit
from .graph.chart import ChartLine, cull
from .graph.march import march
from .records import is_kind
from .structure import DOMAIN, Structure
from .walk import Slabs, Walk, begin, next_leaf, prepare, take_leaf, walk_to_leaves

__all__ = [
    "Hit",
    "cull_leaf",
    "finish",
    "intersect",
    "is_ray",
    "meet",
    "search",
    "take_candidate",
]


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
    slabs = prepare(ty, o, d)
    walk = begin(ty, s.nodes, slabs, t_max)
    if s.only_group is not None and not s.has_graphs:
        t, leaf, u, v = _meet_group(s, ty, o, d, t_max, active & (walk.leaves != 0))
    else:
        t, leaf, u, v = search(s, ty, o, d, slabs, t_max, ty.UInt(0), walk, active, any_hit)
    return finish(s, ty, t, leaf, u, v, active, any_hit)


def _meet_group(
    s: Structure, ty: Types, o: list[Any], d: list[Any], t_max: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """Do what `search` does where all there is are the patches of one quadric: no tree to walk."""

    def meet_it(active: Any) -> Any:
        hit, t, u, v, leaf = group_hit(s, ty, ty.UInt(0), o, d, t_max, active)
        return t, dr.select(hit, leaf, NO_LEAF), u, v

    zero = dr.zeros(ty.Float)
    return dr.if_stmt(
        args=(active,),
        cond=active,
        true_fn=meet_it,
        false_fn=lambda _active: (t_max, ty.UInt(NO_LEAF), zero, zero),
        label="bezier one group",
    )


def is_ray(o: list[Any], d: list[Any], t_max: Any) -> Any:
    """Return a mask of rays that are rays; others, with NaN or no direction, are misses."""
    length2 = dot3(d, d)
    # NaN fails all comparisons
    return (dot3(o, o) < dr.inf) & (length2 > 0.0) & (length2 < dr.inf) & (t_max > 0.0)


def search(
    s: Structure,
    ty: Types,
    o: list[Any],
    d: list[Any],
    slabs: Slabs,
    t_max: Any,
    first: Any,
    walk: Walk,
    active: Any,
    any_hit: bool,
) -> tuple[Any, Any, Any, Any]:
    """Search the tree that begins at `first`; return t, leaf (or `NO_LEAF`), u, v of the leaf."""
    if not (s.has_graphs or s.has_groups):
        none = dr.full(ty.UInt, NO_LEAF, dr.width(active))
        return t_max, none, dr.zeros(ty.Float), dr.zeros(ty.Float)

    def body(run: Any, walk: Any, t: Any, leaf: Any, u: Any, v: Any) -> Any:
        def candidate(walk: Any, run: Any) -> Any:
            return _candidate(s, ty, first, walk, o, d, slabs, t, run, any_hit)

        if any_hit:
            walk, index, line = _until_found(ty, candidate, walk, run)
        else:
            walk, index, line = candidate(walk, run)
        found = run & (index != NO_LEAF)
        accept, t_new, u_new, v_new, leaf_new = meet(s, ty, index, line, o, d, t, found, any_hit)
        t = dr.select(accept, t_new, t)
        leaf = dr.select(accept, leaf_new, leaf)
        u, v = dr.select(accept, u_new, u), dr.select(accept, v_new, v)
        run = run & walk.goes_on()
        if any_hit:
            run = run & (leaf == NO_LEAF)
        return run, walk, t, leaf, u, v

    zero = dr.zeros(ty.Float)
    _run, _walk, t, leaf, u, v = dr.while_loop(
        (active & walk.goes_on(), walk, t_max, ty.UInt(NO_LEAF), zero, zero),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "walk", "t", "leaf", "u", "v"),
        label="bezier traversal",
    )
    return t, leaf, u, v


def meet(
    s: Structure,
    ty: Types,
    index: Any,
    line: ChartLine,
    o: Any,
    d: Any,
    t_max: Any,
    active: Any,
    any_hit: bool,
) -> tuple[Any, Any, Any, Any, Any]:
    """Find the first hit in a leaf, or in a group of exact ones; or only whether there is one.

    Then nothing is to be found where culling knew.

    Returns
    -------
    hit : Bool
    t : Float
    u, v : Float
        Of the leaf.
    leaf : UInt
        For a group, the member.
    """
    if any_hit and s.has_certain_hits:
        hit, *found = dr.if_stmt(
            args=(index, line, t_max),
            cond=active & ~line.sure,
            true_fn=lambda i, line, t: _meet(s, ty, i, line, o, d, t, active & ~line.sure, any_hit),
            false_fn=lambda i, line, t: (line.sure, t, dr.zeros(ty.Float), dr.zeros(ty.Float), i),
            label="bezier undecided",
        )
        return active & hit, *found
    return _meet(s, ty, index, line, o, d, t_max, active, any_hit)


def _meet(
    s: Structure,
    ty: Types,
    index: Any,
    line: ChartLine,
    o: Any,
    d: Any,
    t_max: Any,
    active: Any,
    any_hit: bool,
) -> tuple[Any, Any, Any, Any, Any]:
    if s.has_groups and s.has_graphs:
        return dr.if_stmt(
            args=(active, index, line, t_max),
            cond=active & (index >= s.first_group),
            true_fn=lambda m, i, _l, t: group_hit(s, ty, i - s.first_group, o, d, t, m),
            false_fn=lambda m, i, line, t: (*march(s, ty, i, line, o, d, t, m, any_hit), i),
            label="bezier leaf kind",
        )
    if s.has_groups:
        return group_hit(s, ty, index, o, d, t_max, active)
    return (*march(s, ty, index, line, o, d, t_max, active, any_hit), index)


def finish(
    s: Structure, ty: Types, t: Any, leaf: Any, u: Any, v: Any, active: Any, any_hit: bool
) -> Hit:
    """Turn a leaf and its parameters into a patch and its."""
    valid = active & (leaf != NO_LEAF)
    t = dr.select(valid, t, dr.inf)
    if any_hit:
        zero = dr.zeros(ty.Float)
        return Hit(valid, t, ty.UInt(0), zero, zero)
    if s.domain is None:  # patches are leaves, and of one kind
        if s.has(LeafKind.PLANE_SECTIONS):
            u, v = section_parameters(s, ty, leaf, u, v, valid)
        return Hit(valid, t, dr.select(valid, leaf, 0), u, v)
    m = DOMAIN.gather(s.domain, dr.select(valid, leaf, 0), valid)
    if s.has(LeafKind.PLANE_SECTIONS):
        is_section = is_kind(m.kind, LeafKind.PLANE_SECTIONS)
        u, v = section_parameters(s, ty, leaf, u, v, valid & is_section)
    if s.has(LeafKind.CONE):  # counted from their apex on
        w = 1.0 - u - v
        first, second = m.corner == 0, m.corner == 1
        u, v = (
            dr.select(first, w, dr.select(second, v, u)),
            dr.select(first, u, dr.select(second, w, v)),
        )
    if s.has_graphs or s.has(*INVERTED_KINDS):  # or leaves are patches
        w = 1.0 - u - v
        bary = [dr.fma(row[0], u, dr.fma(row[1], v, row[2] * w)) for row in m.map]
        inv = reciprocal(bary[0] + bary[1] + bary[2])
        u, v = bary[0] * inv, bary[1] * inv
    return Hit(valid, t, m.patch, u, v)


def take_candidate(
    s: Structure,
    ty: Types,
    first: Any,
    leaves: Any,
    o: Any,
    d: Any,
    t_max: Any,
    run: Any,
    any_hit: bool,
) -> tuple[Any, Any, ChartLine]:
    """Take a leaf out of a walk's `leaves`, and turn it down if it is culled."""
    leaves, leaf = take_leaf(s.nodes, ty, first, leaves, run)
    known = run & (leaf != NO_LEAF)
    candidate, line = cull_leaf(s, ty, leaf, o, d, t_max, known, any_hit)
    return leaves, dr.select(candidate, leaf, NO_LEAF), line


def cull_leaf(
    s: Structure,
    ty: Types,
    leaf: Any,
    o: Any,
    d: Any,
    t_max: Any,
    active: Any,
    any_hit: bool,
) -> tuple[Any, ChartLine]:
    """Cull a leaf as `chart.cull` does, or let a group pass."""
    if not s.has_graphs:
        return active, ChartLine.zero(ty)
    graph = active & (leaf < s.first_group) if s.has_groups else active
    candidate, line = cull(s, ty, leaf, o, d, t_max, graph, any_hit and s.has_certain_hits)
    if s.has_groups:
        line = replace(line, sure=line.sure & graph)
    return active & (candidate | ~graph), line


def _until_found(ty: Types, candidate: Any, walk: Walk, run: Any) -> tuple[Walk, Any, ChartLine]:
    """Repeat `candidate` until there is one, or the tree is at its end.

    The lanes of a packet that found one wait for the others, and all march together: the least
    marches. It pays where few go on after their first.
    """

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
    s: Structure,
    ty: Types,
    first: Any,
    walk: Walk,
    o: Any,
    d: Any,
    slabs: Slabs,
    t_max: Any,
    run: Any,
    any_hit: bool,
) -> tuple[Walk, Any, ChartLine]:
    """Walk to the next node with leaves, and find the first that its quadratic does not exclude.

    There may be none, and still more of the tree. For the closest hit leaves are culled in pairs:
    that takes less than twice the time of one, most of which is waiting for results.
    """
    if not s.has_graphs:
        walk, leaf = next_leaf(s.nodes, ty, first, walk, slabs, t_max, run)
        return walk, leaf, ChartLine.zero(ty)

    def take(leaves: Any, go: Any) -> Any:
        return take_candidate(s, ty, first, leaves, o, d, t_max, go, any_hit)

    def body(go: Any, leaves: Any, leaf: Any, line: Any) -> Any:
        leaves, leaf, line = take(leaves, go)
        if not any_hit:
            others, second, its_line = take(leaves, go)
            found = leaf != NO_LEAF
            # a second candidate stays, and will be culled again
            leaves = dr.select(found & (second != NO_LEAF), leaves, others)
            leaf, line = dr.select(found, leaf, second), dr.select(found, line, its_line)
        go = go & (leaf == NO_LEAF) & (leaves != 0)
        return go, leaves, leaf, line

    walk = walk_to_leaves(s.nodes, ty, first, walk, slabs, t_max, run)
    _go, leaves, leaf, line = dr.while_loop(
        (run & (walk.leaves != 0), walk.leaves, ty.UInt(NO_LEAF), ChartLine.zero(ty)),
        cond=lambda *st: st[0],
        body=body,
        labels=("go", "leaves", "leaf", "line"),
        label="bezier quadratics",
    )
    return replace(walk, leaves=leaves), leaf, line
