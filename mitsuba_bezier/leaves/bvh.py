"""Build a bounding volume hierarchy (BVH): a binary tree of boxes, numbered as in a heap.

The root is node 1, the children of node ``k`` are ``2 k`` and ``2 k + 1``, so parents and siblings
need no pointers and a traversal needs no stack (Binder and Keller, "Efficient Stackless Hierarchy
Traversal on GPUs with Backtracking in Constant Time", 2016, who hash such numbers; here the tree
is kept shallow enough to store all of them). It is built by the surface area heuristic on binned
centroids, level by level, so that all nodes of a level are handled by the same few NumPy calls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["NO_LEAF", "Bvh", "bodies_apart", "build_bvh", "levels_for"]

#: Value of `Bvh.leaf` in nodes that are no leaves.
NO_LEAF = 0xFFFFFFFF

_BINS = 16

#: A BVH has room for at least this many times its leaves: with less, the heuristic would have
#: little choice where to cut; with more, most of the room would stay empty.
_ROOM_PER_LEAF = 1.25

#: Infinite faces count as this far away when costs are compared.
_FAR = 1e9

#: Bodies are apart if their boxes together have less than this share of the surface of the box of
#: both: more than a quarter of the rays that enter the latter pass by the former, then.
_APART = 0.75
#: At most as many bodies, the children of one node.
_BODIES = 4


@dataclass
class Bvh:
    """The nodes by number; most numbers may be unused."""

    bounds: np.ndarray  #: (K, 2, 3) boxes of the nodes
    leaf: np.ndarray  #: (K,) uint32 number of the leaf, `NO_LEAF` in inner nodes and unused ones
    inner: np.ndarray  #: numbers of the inner nodes, ascending


def levels_for(count: int) -> int:
    """Return how many levels of nodes of four children there are room for, over so many leaves."""
    return int(np.ceil(np.log2(_ROOM_PER_LEAF * count) / 2)) if count > 1 else 0


def bodies_apart(boxes: np.ndarray) -> list[np.ndarray]:
    """Return the boxes ``(L, 2, 3)`` as bodies far from each other.

    Returns
    -------
    list of int arrays
        The boxes of each, as children are in order: the pairs of them along an axis, and those of
        a pair. A single one if they are not apart, as most are, or are unbounded.
    """
    bodies = [np.arange(len(boxes))]
    if len(boxes) < 2 or not (np.abs(boxes) < _FAR).all():
        return bodies
    centre = boxes.mean(axis=1)
    whole: list[np.ndarray] = []  # those that are not apart
    while bodies and len(bodies) + len(whole) < _BODIES:
        body = bodies.pop(0)
        count = len(body)
        if count < 2:
            whole.append(body)
            continue
        none, member = np.zeros(1, dtype=int), np.zeros(count, dtype=int)
        left, order = _split(boxes, centre, body, member, none, np.array([count]))
        parts = [order[: left[0]], order[left[0] :]]
        areas = [_area_of(boxes[part]) for part in parts]
        if sum(areas) < _APART * _area_of(boxes[body]):
            bodies += parts
            bodies.sort(key=lambda part: -_area_of(boxes[part]))
        else:
            whole.append(body)
    bodies = whole + bodies
    middle = np.array([boxes[b, 0].min(axis=0) + boxes[b, 1].max(axis=0) for b in bodies])
    order = np.argsort(middle[:, np.ptp(middle, axis=0).argmax()]).tolist()
    for pair in range(0, len(bodies) - 1, 2):
        a, b = order[pair : pair + 2]
        step = middle[b] - middle[a]
        if step[np.abs(step).argmax()] < 0.0:
            order[pair : pair + 2] = b, a
    return [bodies[k] for k in order]


def build_bvh(boxes: np.ndarray, bodies: list[np.ndarray] | None = None) -> Bvh:
    """Build the BVH over boxes ``(L, 2, 3)``, whose faces may be infinite.

    Each leaf is one node; a single leaf is the root. Without leaves the root has no children.

    Parameters
    ----------
    boxes : (L, 2, 3) array
    bodies : list of int arrays, optional
        As from `bodies_apart`, of which the nodes 4, 5, ... are the roots.
    """
    count = len(boxes)
    if count == 0:
        none = np.full(2, NO_LEAF, dtype=np.uint32)
        return Bvh(np.zeros((2, 2, 3)), none, np.zeros(0, dtype=np.int64))
    bodies = bodies or [np.arange(count)]
    apart = len(bodies) > 1
    # even, as nodes with four children leave out every other level
    depth = 2 * max(levels_for(len(body)) for body in bodies)
    total = 2 << (depth + 2 * apart)
    leaf = np.full(total, NO_LEAF, dtype=np.uint32)
    bounds = np.zeros((total, 2, 3))
    finite = np.clip(np.nan_to_num(boxes, posinf=np.inf, neginf=-np.inf), -_FAR, _FAR)
    centre = finite.mean(axis=1)

    order = np.concatenate(bodies)  # leaves, sorted so that each node owns a range
    stop = np.cumsum([len(body) for body in bodies])
    start, nodes = np.append(0, stop[:-1]), np.array([1])
    room = 1 << depth
    levels = []
    if apart:
        nodes = 4 + np.arange(len(bodies))
        levels.append(np.unique([1, *nodes // 2]))
        bounds[1:4] = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    while True:
        length = stop - start
        member = np.repeat(np.arange(len(nodes)), length)
        offsets = np.concatenate([[0], np.cumsum(length)[:-1]])
        slots = np.arange(length.sum()) + np.repeat(start - offsets, length)
        items = order[slots]
        bounds[nodes, 0] = np.minimum.reduceat(boxes[items, 0], offsets)
        bounds[nodes, 1] = np.maximum.reduceat(boxes[items, 1], offsets)
        single = length == 1
        leaf[nodes[single]] = order[start[single]]
        split = np.flatnonzero(~single)
        if not len(split):
            break
        left_count, permuted = _split(finite, centre, items, member, offsets, length)
        order[slots] = permuted
        room //= 2
        left_count = np.clip(left_count, length - room, room)
        parents = nodes[split]
        levels.append(parents)
        middle = start[split] + left_count[split]
        nodes = np.stack([2 * parents, 2 * parents + 1], axis=1).ravel()
        start, stop = (
            np.stack([start[split], middle], axis=1).ravel(),
            np.stack([middle, stop[split]], axis=1).ravel(),
        )
    inner = np.sort(np.concatenate(levels)) if levels else np.zeros(0, dtype=np.int64)
    used = max(2 * int(inner[-1]) + 2 if len(inner) else 2, 8 if apart else 2)
    return Bvh(bounds[:used], leaf[:used], inner)


def _split(
    boxes: np.ndarray,
    centre: np.ndarray,
    items: np.ndarray,
    member: np.ndarray,
    offsets: np.ndarray,
    length: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the size of each node's left part; return it and the items, sorted accordingly."""
    points = centre[items]
    low = np.minimum.reduceat(points, offsets)
    extent = np.maximum.reduceat(points, offsets) - low
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = (points - low[member]) / extent[member] * _BINS
    bins = np.clip(np.nan_to_num(scaled), 0, _BINS - 1).astype(np.int64)
    best_axis = extent.argmax(axis=1)
    best_bin = np.full(len(length), -1, dtype=np.int64)
    large = np.flatnonzero(length > 2)  # two leaves need no choice, and they are most nodes
    if len(large):
        wanted = np.repeat(length > 2, length)
        number = np.repeat(np.arange(len(large)), length[large])
        best_axis[large], best_bin[large] = _best_bins(
            boxes[items[wanted]], bins[wanted], number, best_axis[large]
        )

    coordinate = points[np.arange(len(items)), best_axis[member]]
    chosen = bins[np.arange(len(items)), best_axis[member]]
    by_place = np.lexsort((coordinate, member))
    left_count = np.bincount(member, weights=chosen <= best_bin[member], minlength=len(length))
    left_count = left_count.astype(np.int64)
    # all centres in one place, or a lopsided bin: halve
    halve = (best_bin < 0) | (left_count == 0) | (left_count == length)
    return np.where(halve, length // 2, left_count), items[by_place]


def _best_bins(
    boxes: np.ndarray, bins: np.ndarray, member: np.ndarray, best_axis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return for each node the axis and the last bin of the cheapest left part, -1 if none.

    Parameters
    ----------
    boxes : (I, 2, 3) array
        Boxes of the leaves, node by node.
    bins : (I, 3) array
        Their bins along each axis.
    member : (I,) array
        Their nodes.
    best_axis : (N,) array
        The axis where no part is better than another.
    """
    nodes = len(best_axis)
    best_cost = np.full(nodes, np.inf)
    best_bin = np.full(nodes, -1, dtype=np.int64)
    for a in range(3):
        key = member * _BINS + bins[:, a]
        by_key = np.argsort(key, kind="stable")
        sorted_key = key[by_key]
        first = np.flatnonzero(np.diff(sorted_key, prepend=-1))
        filled = sorted_key[first]
        lo = np.full((nodes * _BINS, 3), np.inf)
        hi = np.full((nodes * _BINS, 3), -np.inf)
        lo[filled] = np.minimum.reduceat(boxes[by_key, 0], first)
        hi[filled] = np.maximum.reduceat(boxes[by_key, 1], first)
        number = np.bincount(key, minlength=nodes * _BINS).reshape(nodes, _BINS)
        lo_b, hi_b = lo.reshape(nodes, _BINS, 3), hi.reshape(nodes, _BINS, 3)
        n_left = np.cumsum(number, axis=1)
        area_left = _area(np.minimum.accumulate(lo_b, axis=1), np.maximum.accumulate(hi_b, axis=1))
        lo_r = np.minimum.accumulate(lo_b[:, ::-1], axis=1)[:, ::-1]
        hi_r = np.maximum.accumulate(hi_b[:, ::-1], axis=1)[:, ::-1]
        area_right = _area(lo_r, hi_r)
        n_right = n_left[:, -1:] - n_left
        cost = area_left[:, :-1] * n_left[:, :-1] + area_right[:, 1:] * n_right[:, :-1]
        cost = np.where((n_left[:, :-1] > 0) & (n_right[:, :-1] > 0), cost, np.inf)
        where = cost.argmin(axis=1)
        value = cost[np.arange(nodes), where]
        better = value < best_cost
        best_cost = np.where(better, value, best_cost)
        best_axis = np.where(better, a, best_axis)
        best_bin = np.where(better, where, best_bin)
    return best_axis, best_bin


def _area_of(boxes: np.ndarray) -> float:
    return float(_area(boxes[:, 0].min(axis=0)[None], boxes[:, 1].max(axis=0)[None])[0])


def _area(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    d = np.maximum(hi - lo, 0.0)
    d = np.where(np.isfinite(d), d, 0.0)
    return d[..., 0] * d[..., 1] + d[..., 1] * d[..., 2] + d[..., 2] * d[..., 0]
