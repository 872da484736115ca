"""Intersect many incoherent rays, in memory, as a wavefront.

In `traverse.intersect` each ray has a lane, and a packet of lanes goes on until its last ray is
done: where neighbours go different ways most lanes wait. Here a lane takes the next ray of its
share when it is done with one (Aila and Laine, "Understanding the Efficiency of Ray Traversal on
GPUs", 2009, section 3.3); and it is done as soon as there is a leaf that may be hit. Then these
leaves are met, all lanes at work, and the rays that have to go on begin again where they were.

The steps are those of `traverse`, and so are the results, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from ..leaves.bvh import NO_LEAF
from .arrays import Types, dot3, inverse_root, types_of
from .query import Found, Hit, Nearest, Query, Rays
from .structure import Structure
from .traverse import cull_leaf, finish, intersect, meet, search, take_candidate
from .walk import BvhRays, Slabs, Walk, begin, prepare, walk_to_leaves

__all__ = ["intersect_wavefront", "is_worthwhile", "query"]

#: Fewer rays are left to `traverse`, at the beginning and at the end: each launch takes its time.
_MIN_RAYS = 1 << 16
#: All rays are taken to their next leaf this often; few are left then, and these have much to do.
_MAX_ROUNDS = 3
#: After this many nodes without a leaf the lanes of a packet look at the leaves of the others. 2 to
#: 6 are alike.
_MAX_NODES = 3
#: The rays of one packet at a time are neighbours; a share is as many for each of its lanes.
_PACKET = 16
_RAYS_A_LANE = 64
#: At most this many rays are traced at once, for the memory that they take.
_MAX_RAYS = 1 << 24
#: Trees of fewer leaves are walked in a few steps; and where all are closed forms, of fewer groups:
#: that is where it pays.
_MIN_LEAVES = 8
_MIN_GROUPS = 100
#: Rays are incoherent if neighbours are this far apart, see `_distance`.
_MIN_DISTANCE = 0.05
#: This many pairs of neighbours are looked at.
_SAMPLED_PAIRS = 4096

#: In place of a leaf's number: the ray certainly hits it, which is all that is asked.
_CERTAIN = NO_LEAF - 1

#: Where arrays have no values yet, or must not be looked at.
_RECORDING = (
    dr.JitFlag.SymbolicScope,
    dr.JitFlag.FreezingScope,
    dr.JitFlag.ForbidSynchronization,
)


def query(
    s: Structure, o: list[Any], d: list[Any], t_max: Any, active: Any, any_hit: bool, coherent: bool
) -> Hit:
    """Intersect rays with all leaves in the way that is the fastest; see `traverse.intersect`.

    Parameters
    ----------
    coherent : bool
        Whether neighbours among the rays are known to have much in common.
    """
    if not coherent and is_worthwhile(s, o, d):
        return intersect_wavefront(s, o, d, t_max, active, any_hit)
    return intersect(s, o, d, t_max, active, any_hit)


def is_worthwhile(s: Structure, o: list[Any], d: list[Any]) -> bool:
    """Return whether rays are many, in memory and incoherent, and there are leaves to find.

    Never inside of a recorded loop or function, where there is no memory to look at.
    """
    if s.group_count < _MIN_GROUPS and (not s.has_graphs or s.leaf_count < _MIN_LEAVES):
        return False
    if any(dr.flag(flag) for flag in _RECORDING):
        return False
    ty = types_of(o[0])
    # measured with LLVM only
    if dr.backend_v(ty.Float) != dr.JitBackend.LLVM:
        return False
    rays = [*o, *d]
    if max(dr.width(x) for x in rays) < _MIN_RAYS:
        return False
    known = (dr.VarState.Evaluated, dr.VarState.Literal)
    return all(x.state in known for x in rays) and _distance(s, ty, o, d) > _MIN_DISTANCE


def intersect_wavefront(
    s: Structure, o: Any, d: Any, t_max: Any, active: Any = True, any_hit: bool = False
) -> Hit:
    """Intersect rays with all leaves; see `traverse.intersect`.

    Takes some 80 bytes a ray while it is at work, but not for more than `_MAX_RAYS` rays.
    """
    ty = types_of(o[0], s.pairs)
    count = max(dr.width(x) for x in (*o, *d, t_max, active))
    query = Query(s, ty, any_hit)
    rays = _Rays(
        [_in_memory(ty.Float(o[i]), count) for i in range(3)],
        [_in_memory(ty.Float(d[i]), count) for i in range(3)],
        ty.Float(t_max),
    )
    # what no hit is before: rays that are none, or not to be traced
    t = dr.select(ty.Bool(active) & rays.are_valid(), rays.t_max, 0.0)
    leaf, u, v = dr.full(ty.UInt, NO_LEAF, count), *(dr.zeros(ty.Float, count) for _ in range(2))
    nearest = _Nearest(_in_memory(t, count), leaf, u, v)
    dr.make_opaque(rays.o, rays.d, nearest)
    for start in range(0, count, _MAX_RAYS):
        queue = _Queue(min(_MAX_RAYS, count - start))
        if queue.count < count:
            queue.ray = dr.arange(ty.UInt, queue.count) + dr.opaque(ty.UInt, start)
            dr.eval(queue.ray)
        _trace(query, rays, nearest, queue)
    return finish(query, nearest, dr.full(ty.Bool, True, count))


class _Rays(Rays):
    """Rays in memory."""

    def at(self, ray: Any, t: Any, active: Any = True) -> Rays:
        """Return rays by their numbers, with the ends `t` of all."""
        o, d = ([dr.gather(type(x), x, ray, active) for x in xs] for xs in (self.o, self.d))
        return Rays(o, d, dr.gather(type(t), t, ray, active))


class _Nearest(Nearest):
    """The nearest hits so far, of all rays, in memory."""

    def update(self, ray: Any, found: Found | Nearest, hit: Any) -> None:
        """Write down hits of rays, by their numbers."""
        for name, array in vars(self).items():
            dr.scatter(array, getattr(found, name), ray, hit)


@dataclass
class _Queue:
    """Rays that wait for lanes."""

    count: int
    ray: Any = None  #: their numbers; None: all rays
    walk: Any = None  #: Walk: where they are, by place in the queue; None: at the beginning


@dataclass
class _Lane:
    """What the lanes of a packet are at."""

    next: Any  #: UInt: the place in the queue of the ray that comes after
    place: Any  #: that of this one, `NO_LEAF` if there is none
    rays: Rays
    slabs: Slabs
    walk: Walk
    leaf: Any  #: the one that may be hit, or `NO_LEAF`


def _trace(query: Query, rays: _Rays, nearest: _Nearest, queue: _Queue) -> None:
    """Trace the rays of a queue."""
    s, ty = query.s, query.ty
    for _round in range(_MAX_ROUNDS):
        found, walk = _walk_to_candidates(query, rays, nearest.t, queue)
        if query.ends_where_certain:
            ray = dr.arange(ty.UInt, queue.count) if queue.ray is None else queue.ray
            dr.scatter(nearest.leaf, found, ray, found == _CERTAIN)
        place = dr.compress(found < _CERTAIN)
        if not dr.width(place):
            return
        ray = place if queue.ray is None else dr.gather(ty.UInt, queue.ray, place)
        those = rays.at(ray, nearest.t)
        index = dr.gather(ty.UInt, found, place)
        candidate, line = cull_leaf(query, index, those, ty.Bool(True))
        met = meet(query, index, line, those, candidate)
        nearest.update(ray, met, met.hit)
        node, leaves = (dr.gather(ty.UInt, x, place) for x in (walk.node, walk.leaves))
        on = ((node | leaves) != 0) & ~(met.hit & query.any_hit)
        dr.eval(nearest, on, ray)
        rest = dr.compress(on)
        if not dr.width(rest):
            return
        place, ray = (dr.gather(ty.UInt, x, rest) for x in (place, ray))
        walk = Walk(*(dr.gather(type(x), x, place) for _k, x in _fields(walk)))
        dr.eval(ray, walk)
        queue = _Queue(dr.width(rest), ray, walk)
        if queue.count < _MIN_RAYS:
            break
    those = rays.at(queue.ray, nearest.t)
    bvh = BvhRays(s.nodes, ty, ty.UInt(0), prepare(ty, those.o, those.d))
    there = search(query, bvh, those, queue.walk, ty.Bool(True))
    nearest.update(queue.ray, there, there.leaf != NO_LEAF)
    dr.eval(nearest)


def _threads() -> int:
    """Return how many threads share the lanes."""
    return int(dr.thread_count())


def _walk_to_candidates(query: Query, rays: _Rays, t: Any, queue: _Queue) -> tuple[Any, Walk]:
    """Take each ray of a queue to its next leaf that it may hit.

    Returns
    -------
    leaf : UInt
        By place in the queue, `NO_LEAF` where there is none; or `_CERTAIN`.
    walk : Walk
        Where the others may go on; arbitrary in the first and the last.
    """
    s, ty = query.s, query.ty
    count = queue.count
    # at least a hundred packets for each thread, so that none waits for long
    share = max(1, min(_RAYS_A_LANE, count // (100 * _PACKET * _threads())))
    lanes = -(-count // (share * _PACKET)) * _PACKET
    lane = dr.arange(ty.UInt, lanes)
    # data, not code: a kernel serves all counts
    size, end = (dr.opaque(ty.UInt, x) for x in (share * _PACKET, count))
    start = (lane // _PACKET) * size + lane % _PACKET
    end = dr.minimum((lane // _PACKET + 1) * size, end)
    first = ty.UInt(0)
    state = dr.uint64_array_t(ty.UInt) if s.nodes.deep else ty.UInt
    leaf_out = dr.empty(ty.UInt, count)
    walk_out = Walk(*(dr.empty(x, count) for x in (ty.UInt, state, state, ty.UInt)))
    dr.make_opaque(leaf_out, walk_out)

    def next_ray(lane: Any) -> Any:
        """Put away what was found, and take the next ray."""
        done = lane.place != NO_LEAF
        dr.scatter(leaf_out, lane.leaf, lane.place, done)
        done = done & (lane.leaf != NO_LEAF)
        for k, x in _fields(walk_out):
            dr.scatter(x, getattr(lane.walk, k), lane.place, done)
        place = dr.select(lane.next < end, lane.next, NO_LEAF)
        known = place != NO_LEAF
        ray = place if queue.ray is None else dr.gather(ty.UInt, queue.ray, place, known)
        those = rays.at(ray, t, known)
        slabs = prepare(ty, those.o, those.d)
        if queue.walk is None:
            walk = begin(ty, s.nodes, slabs, those.t_max)
            known = known & (those.t_max > 0.0)
            walk.node = dr.select(known, walk.node, 0)
            walk.leaves = dr.select(known, walk.leaves, 0)
        else:
            walk = Walk(*(dr.gather(type(x), x, place, known) for _k, x in _fields(queue.walk)))
        return _Lane(lane.next + _PACKET, place, those, slabs, walk, ty.UInt(NO_LEAF))

    def body(run: Any, lane: Any) -> Any:
        needs = run & (~lane.walk.goes_on() | (lane.leaf != NO_LEAF))
        lane = dr.if_stmt(
            args=(lane,),
            cond=needs,
            true_fn=next_ray,
            false_fn=lambda lane: lane,
            label="bezier next ray",
        )
        run = run & (lane.place != NO_LEAF)
        bvh = BvhRays(s.nodes, ty, first, lane.slabs)
        walk = walk_to_leaves(bvh, lane.walk, lane.rays.t_max, run, _MAX_NODES)

        def look(walk: Any, those: Any) -> Any:
            leaves, leaf, line = take_candidate(query, bvh, those, walk.leaves, run)
            if query.ends_where_certain:
                leaf = dr.select((leaf != NO_LEAF) & line.certain_hit, _CERTAIN, leaf)
            return replace(walk, leaves=leaves), leaf

        walk, leaf = dr.if_stmt(
            args=(walk, lane.rays),
            cond=run & (walk.leaves != 0),
            true_fn=look,
            false_fn=lambda walk, _rays: (walk, ty.UInt(NO_LEAF)),
            label="bezier leaves",
        )
        return run, replace(lane, walk=walk, leaf=leaf)

    none = dr.full(ty.UInt, NO_LEAF, lanes)
    zeros = [dr.zeros(ty.Float, lanes)] * 3
    nowhere = Walk(*(dr.zeros(type(x), lanes) for _k, x in _fields(walk_out)))
    slabs = prepare(ty, zeros, zeros)
    begins = _Lane(start, none, Rays(zeros, zeros, zeros[0]), slabs, nowhere, none)
    dr.while_loop(
        (start < end, begins),
        cond=lambda run, _lane: run,
        body=body,
        labels=("run", "lane"),
        label="bezier wavefront",
    )
    dr.eval(leaf_out, walk_out)
    return leaf_out, walk_out


def _fields(walk: Walk) -> list[tuple[str, Any]]:
    """Return the names and arrays of a walk."""
    return list(vars(walk).items())


def _in_memory(values: Any, count: int) -> Any:
    """Return an array of `count` values, which is in memory or can be."""
    if dr.width(values) == count:
        return values
    array = dr.empty(type(values), count)
    dr.scatter(array, values, dr.arange(dr.uint32_array_t(type(values)), count))
    return array


def _distance(s: Structure, ty: Types, o: list[Any], d: list[Any]) -> float:
    """Return how far apart neighbours among rays are, at most 1, in the mean of a sample.

    That is the distance of their points nearest the centre of the scene's box, over its diagonal,
    and half that of their directions.
    """
    count = max(dr.width(x) for x in (*o, *d))
    low, high = s.nodes.bounds[:3], s.nodes.bounds[3:]
    diagonal2 = dot3(*[[high[a] - low[a] for a in range(3)]] * 2)
    samples = min(_SAMPLED_PAIRS, count // 2)
    first = dr.arange(ty.UInt, samples) * dr.opaque(ty.UInt, count // samples)

    def ray(number: Any) -> Any:
        def at(x: Any) -> Any:
            return ty.Float(x) if dr.width(x) == 1 else dr.gather(ty.Float, x, number)

        return [at(x) for x in o], [at(x) for x in d]

    points, directions = [], []
    for number in (first, first + 1):
        o_i, d_i = ray(number)
        inverse = inverse_root(dot3(d_i, d_i))
        unit = [x * inverse for x in d_i]
        away = [0.5 * (low[a] + high[a]) - o_i[a] for a in range(3)]
        ahead = dr.maximum(dot3(away, unit), 0.0)
        points.append([dr.fma(ahead, unit[a], o_i[a]) for a in range(3)])
        directions.append(unit)
    apart, turned = ([y - x for x, y in zip(*pair)] for pair in (points, directions))
    distance = dr.sqrt(dot3(apart, apart) / diagonal2) + 0.5 * dr.sqrt(dot3(turned, turned))
    # rays that are none, and scenes without end, count as near
    distance = dr.select(distance > 0.0, dr.minimum(distance, 1.0), 0.0)
    return float(dr.mean(distance)[0])
