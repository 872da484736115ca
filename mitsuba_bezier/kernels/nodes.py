"""The records of a tree's inner nodes, and the walk of a ray through them without a stack."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from ..geometry.tree import NO_LEAF, Tree, build_tree
from .arrays import Types, gather_packets, upload

__all__ = ["NODE", "Nodes", "Slabs", "Walk", "begin", "build_nodes", "next_leaf", "prepare"]

#: Floats in the record of an inner node: origin of its box 3; for each axis a word of four bytes,
#: the faces of the first child and of the second, low and high, in units of the node's own; the
#: units' exponents (three bytes) and which children are leaves (two bits); nothing.
NODE = 8
#: Infinite faces count as this far away: the most that does not overflow with `_LARGEST`.
_FAR = 1e16
#: The largest reciprocal of a direction's component.
_LARGEST = 1e20
#: What rounding may take from a face in the kernel, in units of its byte: 8 roundings of 512.
_SLACK = 1e-3

#: Slabs are widened by four roundings a face: of the difference, the product and, two, of the
#: reciprocal (Ize, "Robust BVH Ray Traversal", 2013, who has three). The origin's coordinates
#: are moved apart by as much, as they are multiplied before the difference.
_ROUNDING = 4.0 * 6e-8
_GROW = 1.0 + 2.0 * _ROUNDING


@dataclass
class Nodes:
    """Trees one after the other, on the device of one array type."""

    records: Any  #: Float32, x `NODE`: the node `k` of a tree at its first + k
    leaves: Any  #: UInt: the leaf in node `k` at twice the first + k
    unbounded: bool  #: whether bytes 0 and 255 stand for infinite faces, in all trees
    first: np.ndarray  #: of each tree
    single: np.ndarray  #: for each tree, whether its root is a leaf
    bounds: list[Any]  #: low and high corner of the first tree, six Floats
    root_is_leaf: Any  #: Bool, of the first tree; opaque as the bounds: data, not code
    bytes: int


class Slabs(NamedTuple):
    """What a slab test needs of a ray: ``plane * rcp + near`` is the entry, and the exit alike."""

    rcp: list[Any]  #: reciprocals of the direction, finite
    near: list[Any]  #: ``-o rcp``, a little less
    far: list[Any]  #: ``-o rcp``, a little more
    shifts: list[list[Any]]  #: which byte of a word holds the near and far face of each child


@dataclass
class Walk:
    """Where a ray is in a tree, and which branches are left.

    Bit `j` of `pending` tells that the sibling of the ancestor ``node >> j`` is still to be
    visited, bit `j` of `leaves` that it is a leaf.
    """

    node: Any  #: UInt, zero at the end
    at_leaf: Any  #: Bool
    pending: Any  #: UInt
    leaves: Any  #: UInt


def build_nodes(boxes: np.ndarray, like: Types, owner: np.ndarray | None = None) -> Nodes:
    """Build the trees over boxes ``(L, 2, 3)``, one for each owner from 0 on."""
    padded = _padded(boxes)
    unbounded = bool((np.abs(padded) > _FAR).any())
    owner = np.zeros(len(boxes), dtype=int) if owner is None else owner
    records, leaves, firsts, single = [], [], [], []
    first = 0
    for number in range(int(owner.max(initial=0)) + 1):
        mine = np.flatnonzero(owner == number)
        tree = build_tree(padded[mine])
        record = _records(tree, unbounded)
        leaf = np.zeros(2 * len(record), dtype=np.uint32)
        known = tree.leaf != NO_LEAF
        leaf[: len(known)][known] = mine[tree.leaf[known]]
        records.append(record)
        leaves.append(leaf)
        firsts.append(first)
        single.append(len(mine) == 1)
        first += len(record)
    all_records, all_leaves = np.concatenate(records), np.concatenate(leaves)
    # the faces of a child are only known to its parent: the root's, to all
    low = np.clip(padded[owner == 0, 0].min(axis=0), -_FAR, _FAR)
    high = np.clip(padded[owner == 0, 1].max(axis=0), -_FAR, _FAR)
    return Nodes(
        records=upload(like.Float32, all_records.view(np.float32)),
        leaves=upload(like.UInt, all_leaves),
        unbounded=unbounded,
        first=np.array(firsts, dtype=np.uint32),
        single=np.array(single),
        bounds=[dr.opaque(like.Float, float(x)) for x in (*low, *high)],
        root_is_leaf=dr.opaque(like.Bool, bool(single[0])),
        bytes=all_records.nbytes + all_leaves.nbytes,
    )


def _records(tree: Tree, unbounded: bool) -> np.ndarray:
    """Return the records ``(K, NODE)`` of the nodes up to the last inner one, as uint32."""
    inner = tree.inner
    out = np.zeros((int(inner[-1]) + 1 if len(inner) else 1, NODE), dtype=np.uint32)
    children = np.stack([tree.bounds[2 * inner], tree.bounds[2 * inner + 1]], axis=1)
    infinite = np.abs(children) > _FAR
    # the frame is that of the finite faces
    lowest = np.where(infinite, np.inf, children).min(axis=(1, 2))
    highest = np.where(infinite, -np.inf, children).max(axis=(1, 2))
    lowest, highest = (np.where(np.isfinite(x), x, 0.0) for x in (lowest, highest))
    # the origin is rounded down, by up to two units in its last place
    ulp = np.spacing(np.abs(lowest).astype(np.float32)).astype(np.float64)
    extent = np.maximum(highest - lowest + 2 * ulp, 1e-30)
    exponent = np.ceil(np.log2(extent / 248.0)).astype(int)
    unit = 2.0**exponent
    # a little lower, so that the slack is there at the lowest byte as well
    origin = lowest - (unbounded + 2 * _SLACK) * unit
    origin = np.nextafter(origin.astype(np.float32), np.float32(-np.inf))
    children = np.where(infinite, lowest[:, None, None], children)
    steps = (children - origin[:, None, None].astype(np.float64)) / unit[:, None, None]
    low = np.floor(steps[:, :, 0] - _SLACK).astype(np.uint32)
    high = np.ceil(steps[:, :, 1] + _SLACK).astype(np.uint32)
    low[infinite[:, :, 0]], high[infinite[:, :, 1]] = 0, 255
    out[inner, 0:3] = origin.view(np.uint32)
    for c in range(2):
        out[inner, 3:6] |= (low[:, c] | high[:, c] << np.uint32(8)) << np.uint32(16 * c)
        is_leaf = (tree.leaf[2 * inner + c] != NO_LEAF).astype(np.uint32)
        out[inner, 6] |= is_leaf << np.uint32(24 + c)
    for a in range(3):
        out[inner, 6] |= (exponent[:, a] + 127).astype(np.uint32) << np.uint32(8 * a)
    return out


def _padded(box: np.ndarray) -> np.ndarray:
    """Grow boxes by what float32 may lose of their faces, their size and the slab test."""
    finite = np.where(np.isfinite(box), box, 0.0)
    pad = 4e-7 * np.abs(finite).max(axis=1, keepdims=True)
    pad = pad + 1e-6 * np.abs(finite[:, 1:] - finite[:, :1]).max(axis=2, keepdims=True)
    return np.concatenate([box[:, :1] - pad, box[:, 1:] + pad], axis=1)


def prepare(ty: Types, o: list[Any], d: list[Any]) -> Slabs:
    """Return what slab tests need of rays."""
    # finite reciprocals: zero times infinity would turn a slab into NaN
    tiny = ty.Float(1.0 / _LARGEST)
    rcp = [dr.rcp(dr.select(dr.abs(c) > tiny, c, dr.select(c < 0.0, -tiny, tiny))) for c in d]
    near = [-dr.fma(dr.abs(o[a] * rcp[a]), _ROUNDING, o[a] * rcp[a]) for a in range(3)]
    far = [dr.fma(dr.abs(o[a] * rcp[a]), _ROUNDING, -o[a] * rcp[a]) for a in range(3)]
    shifts = []
    for a in range(3):
        turned = rcp[a] < 0.0  # then the high face is the near one
        # left shifts for the first child, right shifts for the second: see `_face`
        pairs = ((7, 15), (15, 7), (9, 1), (1, 9))
        shifts.append([dr.select(turned, ty.UInt(i), j) for i, j in pairs])
    return Slabs(rcp, near, far, shifts)


def begin(ty: Types, nodes: Nodes, slabs: Slabs, t_max: Any) -> Walk:
    """Return the start of a walk through the first tree, at the end for rays that pass it by."""
    enter, leave = dr.zeros(ty.Float), t_max
    for a in range(3):
        low, high = nodes.bounds[a], nodes.bounds[3 + a]
        turned = slabs.rcp[a] < 0.0
        near = dr.fma(dr.select(turned, high, low), slabs.rcp[a], slabs.near[a])
        far = dr.fma(dr.select(turned, low, high), slabs.rcp[a], slabs.far[a])
        # one instruction each; those of dr.maximum and dr.minimum look out for NaN
        enter = dr.select(near > enter, near, enter)
        leave = dr.select(far < leave, far, leave)
    zero = dr.zeros(ty.UInt)
    node = dr.select(enter <= leave * _GROW, ty.UInt(1), zero)
    return Walk(node, nodes.root_is_leaf & (node != 0), zero, zero)


def next_leaf(
    nodes: Nodes, ty: Types, first: Any, walk: Walk, slabs: Slabs, t_max: Any, run: Any
) -> tuple[Walk, Any]:
    """Walk a tree to the next leaf whose box is hit, and past it.

    Returns
    -------
    walk : Walk
    leaf : UInt
        Its number, `NO_LEAF` when there is none.
    """

    def body(go, walk):
        record = gather_packets(nodes.records, first + walk.node, NODE, go)
        step = _step(ty, record, nodes.unbounded, walk, slabs, t_max)
        return go & ~step.at_leaf & (step.node != 0), step

    _go, walk = dr.while_loop(
        (run & ~walk.at_leaf & (walk.node != 0), walk),
        cond=lambda *st: st[0],
        body=body,
        labels=("go", "walk"),
        label="bezier boxes",
    )
    found = run & walk.at_leaf & (walk.node != 0)
    leaf = dr.gather(ty.UInt, nodes.leaves, 2 * first + walk.node, found)
    onward = _up(ty, walk)
    return _select(found, onward, walk), dr.select(found, leaf, NO_LEAF)


def _step(
    ty: Types, record: list[Any], unbounded: bool, walk: Walk, slabs: Slabs, t_max: Any
) -> Walk:
    """Test both children of a node; go to the nearer that is hit, or up."""
    units = dr.reinterpret_array(ty.UInt, record[6])
    zero = dr.zeros(ty.Float)
    enter, leave = [zero, zero], [t_max, t_max]
    for a in range(3):
        word = dr.reinterpret_array(ty.UInt, record[3 + a])
        bits = (units << (23 - 8 * a)) & 0x7F800000
        unit = ty.Float(dr.reinterpret_array(ty.Float32, bits)) * (slabs.rcp[a] * 256.0)
        origin = ty.Float(record[a])
        near = dr.fma(origin, slabs.rcp[a], slabs.near[a]) - unit
        far = dr.fma(origin, slabs.rcp[a], slabs.far[a]) - unit
        shift = slabs.shifts[a]
        faces = (word << shift[0], word << shift[1], word >> shift[2], word >> shift[3])
        for c in range(2):
            t_near = dr.fma(_face(ty, faces[2 * c]), unit, near)
            t_far = dr.fma(_face(ty, faces[2 * c + 1]), unit, far)
            cuts_near, cuts_far = t_near > enter[c], t_far < leave[c]
            if unbounded:
                cuts_near &= _is_finite(faces[2 * c])
                cuts_far &= _is_finite(faces[2 * c + 1])
            enter[c] = dr.select(cuts_near, t_near, enter[c])
            leave[c] = dr.select(cuts_far, t_far, leave[c])
    hit = [enter[c] <= leave[c] * _GROW for c in range(2)]
    second = hit[1] & (~hit[0] | (enter[1] < enter[0]))
    child = dr.select(second, ty.UInt(1), 0)
    is_leaf = units >> 24
    down = Walk(
        (walk.node << 1) | child,
        ((is_leaf >> child) & 1) != 0,
        (walk.pending << 1) | dr.select(hit[0] & hit[1], ty.UInt(1), 0),
        (walk.leaves << 1) | ((is_leaf >> (1 - child)) & 1),
    )
    return _select(hit[0] | hit[1], down, _up(ty, walk))


def _face(ty: Types, shifted: Any) -> Any:
    """Return 1 + b / 256 for the byte `b` in bits 15 to 22: the mantissa of a float."""
    return ty.Float(dr.reinterpret_array(ty.Float32, (shifted & 0x7F8000) | 0x3F800000))


def _is_finite(shifted: Any) -> Any:
    """Tell whether a byte is neither 0 nor 255."""
    return (((shifted + 0x8000) & 0x7F8000) >> 16) != 0


def _up(ty: Types, walk: Walk) -> Walk:
    """Go to the nearest branch that is left, or to the end."""
    some = walk.pending != 0
    levels = dr.select(some, dr.tzcnt(walk.pending), 0)
    one = ty.UInt(1)
    return Walk(
        dr.select(some, (walk.node >> levels) ^ one, 0),
        some & (((walk.leaves >> levels) & one) != 0),
        (walk.pending >> levels) & ~one,
        walk.leaves >> levels,
    )


def _select(mask: Any, a: Walk, b: Walk) -> Walk:
    return Walk(
        dr.select(mask, a.node, b.node),
        dr.select(mask, a.at_leaf, b.at_leaf),
        dr.select(mask, a.pending, b.pending),
        dr.select(mask, a.leaves, b.leaves),
    )
