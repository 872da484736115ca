"""A binary tree of axis-aligned boxes, laid out for traversal without a stack.

The tree is built by the surface area heuristic on binned centroids, level by level, so that
all nodes of a level are handled by the same few NumPy calls. It is then written out eight
times in depth-first order, once for each octant of ray directions, near child first: a
traversal reads nodes one after the other and, when it misses one, jumps over its subtree.
"""

from __future__ import annotations

import numpy as np

__all__ = ["NO_LEAF", "build_tree"]

#: Value of `leaf` in an inner node.
NO_LEAF = 0xFFFFFFFF

_BINS = 16


def build_tree(boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build the eight depth-first layouts.

    Parameters
    ----------
    boxes : (L, 2, 3) array
        One box a leaf; faces may be infinite.

    Returns
    -------
    bounds : (8, N, 2, 3) array
        Boxes of the ``N = 2 L - 1`` nodes in order, for each octant. Bit ``a`` of the octant
        is set where the direction's component ``a`` is negative.
    skip : (8, N) uint32 array
        The node that follows the subtree.
    leaf : (8, N) uint32 array
        The leaf number, `NO_LEAF` for inner nodes.
    """
    left, right, axis, bounds, leaf, levels = _topology(boxes)
    count = len(left)
    subtree = np.ones(count, dtype=np.int64)
    for nodes in reversed(levels):
        inner = nodes[left[nodes] >= 0]
        subtree[inner] += subtree[left[inner]] + subtree[right[inner]]
    out_bounds = np.empty((8, count, 2, 3))
    out_skip = np.empty((8, count), dtype=np.uint32)
    out_leaf = np.empty((8, count), dtype=np.uint32)
    for octant in range(8):
        position = np.zeros(count, dtype=np.int64)
        for nodes in levels:
            inner = nodes[left[nodes] >= 0]
            turned = (octant >> axis[inner]) & 1 == 1
            near = np.where(turned, right[inner], left[inner])
            far = np.where(turned, left[inner], right[inner])
            position[near] = position[inner] + 1
            position[far] = position[inner] + 1 + subtree[near]
        out_bounds[octant, position] = bounds
        out_skip[octant, position] = position + subtree
        out_leaf[octant, position] = leaf
    return out_bounds, out_skip, out_leaf


def _topology(boxes: np.ndarray) -> tuple:
    """Build the tree breadth first; children have larger numbers than parents."""
    count = len(boxes)
    total = 2 * count - 1
    left = np.full(total, -1, dtype=np.int64)
    right = np.full(total, -1, dtype=np.int64)
    axis = np.zeros(total, dtype=np.int64)
    leaf = np.full(total, NO_LEAF, dtype=np.uint32)
    bounds = np.empty((total, 2, 3))
    finite = np.clip(np.nan_to_num(boxes, posinf=np.inf, neginf=-np.inf), -_FAR, _FAR)
    centre = finite.mean(axis=1)

    order = np.arange(count)  # leaves, sorted so that each node owns a range
    start, stop, nodes = np.array([0]), np.array([count]), np.array([0])
    used, levels = 1, []
    while len(nodes):
        levels.append(nodes)
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
        split_axis, left_count, permuted = _split(finite, centre, items, member, offsets, length)
        order[slots] = permuted
        axis[nodes] = split_axis
        left[nodes[split]] = used + 2 * np.arange(len(split))
        right[nodes[split]] = left[nodes[split]] + 1
        used += 2 * len(split)
        middle = start[split] + left_count[split]
        nodes = np.stack([left[nodes[split]], right[nodes[split]]], axis=1).ravel()
        start, stop = (
            np.stack([start[split], middle], axis=1).ravel(),
            np.stack([middle, stop[split]], axis=1).ravel(),
        )
    return left, right, axis, bounds, leaf, levels


#: Infinite faces count as this far away when costs are compared.
_FAR = 1e9


def _split(
    boxes: np.ndarray,
    centre: np.ndarray,
    items: np.ndarray,
    member: np.ndarray,
    offsets: np.ndarray,
    length: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Choose for each node an axis and the size of its left part; return the items sorted."""
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
    return best_axis, np.where(halve, length // 2, left_count), items[by_place]


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


def _area(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    d = np.maximum(hi - lo, 0.0)
    d = np.where(np.isfinite(d), d, 0.0)
    return d[..., 0] * d[..., 1] + d[..., 1] * d[..., 2] + d[..., 2] * d[..., 0]
