"""Pack a BVH4 for the device: inner nodes of four children in 32 bytes, with quantised boxes.

As compressed wide BVHs have them (Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on
GPUs Through Compressed Wide BVHs", 2017), with children in a heap's order in place of pointers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..errors import BezierError
from ..leaves.bvh import NO_LEAF, Bvh, bodies_apart, build_bvh, levels_for
from .arrays import Types, upload
from .records import Record, bits

__all__ = [
    "AXIS",
    "FACE",
    "INNER",
    "LEAF",
    "NODE",
    "SCALE",
    "STEPS",
    "TURN",
    "Nodes",
    "build_nodes",
]

#: A node: the origin of its box; a word for each of its four children; a word with the units of the
#: three axes (`_units`) and which children are nodes (`INNER`) and leaves (`LEAF`), four bits each.
#: A child's word has the faces of its box in units from the origin, five bits each: the low ones
#: from the bits `FACE` on, the high ones as well once the word is turned to the left by `TURN`.
#: That of child `k` < 3 has, from the bit `AXIS` on, the axis along which two parts of the node are
#: in order: its two pairs of children, the first pair, the second pair.
NODE = Record(np.float32, origin=(3,), children=bits((4,)), units=bits())
FACE, TURN, AXIS = (18, 13, 8), 15, 23
#: The bits of a face are left where they are, as those of the mantissa of a float, 1 + k / SCALE
#: for the face k. The origin is stored less this many units.
SCALE = tuple(1 << (23 - bit) for bit in FACE)
#: The first bits of the nibbles in a record's last word.
INNER, LEAF = 24, 28
#: Most units from the origin. If `Nodes.unbounded`, none and all stand for infinite faces.
STEPS = 31

#: Infinite faces count as this far away: times the largest `SCALE`, about the most that does not
#: overflow with `walk._LARGEST`.
_FAR = 1e12
#: What rounding may take from a face in the kernel, in units: 8 roundings of the numbers that it is
#: the difference of, and as many again.
_SLACK = np.array([1e-6 * (scale + 64) for scale in SCALE])
#: A tree whose nodes have more levels has the state of its walks in 64 bits.
_SHALLOW = 9
#: Numbers of nodes are below this: a walk's leaves share a word with 7 other bits.
_MOST_NODES = 2**25


@dataclass
class Bodies:
    """What the root of the first tree has as data of the kernel: boxes of bodies that are apart.

    Where a scene is mostly empty its box tells little, and 31sts of it even less: rays that pass by
    all bodies read no node, and others not this one.
    """

    bounds: list[list[Any]]  #: as `Nodes.bounds`, of children 0, 1, ...
    kinds: Any  #: UInt: which of them are nodes and leaves, as in a record from the bit `INNER` on
    axes: list[Any]  #: three UInt: as in a record from the bits `AXIS` on


@dataclass
class Nodes:
    """Trees one after the other, on the device of one array type."""

    records: Any  #: Float32, x `NODE`: the node `k` of a tree at its first + k
    slots: Any  #: UInt: the leaf that is child `c` of node `k` at 4 (first + k) + c
    unbounded: bool  #: whether there are infinite faces
    deep: bool  #: whether a tree has more than `_SHALLOW` levels of nodes
    first: np.ndarray  #: of each tree
    single: np.ndarray  #: for each tree, whether its root is a leaf
    bounds: list[Any]  #: low and high corner of the first tree, six Floats
    root_is_leaf: Any  #: Bool, of the first tree; opaque as the bounds: data, not code
    bodies: Bodies | None  #: of the first tree, if it has more than one
    bytes: int


def build_nodes(
    boxes: np.ndarray, like: Types, owner: np.ndarray | None = None, owners: int | None = None
) -> Nodes:
    """Build the trees over boxes ``(L, 2, 3)``, one for each of `owners`; empty ones have none.

    A node has the number of its binary one, whose depth is even: the children of node `k` are
    4 k to 4 k + 3, and those of them that are leaves have no record. A root that is a leaf is child
    1 of node 0.
    """
    padded = _padded(boxes)
    unbounded = bool((np.abs(padded) > _FAR).any())
    owner = np.zeros(len(boxes), dtype=int) if owner is None else owner
    records, slots, firsts, single = [], [], [], []
    first, bodies = 0, None
    for number in range(int(owner.max(initial=0)) + 1 if owners is None else owners):
        mine = np.flatnonzero(owner == number)
        parts = _apart(padded[mine]) if number == 0 else None
        tree = build_bvh(padded[mine], parts)
        record = _records(tree, unbounded)
        if parts is not None:
            bodies = _body_data(tree, record, len(parts), like)
        if len(record) > _MOST_NODES:
            raise BezierError.expected(
                "patches", "some ten million leaves at most in one tree", f"{len(mine)} leaves"
            )
        slot = np.zeros(4 * len(record), dtype=np.uint32)
        known = np.flatnonzero(tree.leaf != NO_LEAF)
        # at an odd depth, the first of two children that a node there would have had
        slot[known << (_level(known) % 2)] = mine[tree.leaf[known]]
        records.append(record)
        slots.append(slot)
        firsts.append(first)
        single.append(len(mine) == 1)
        first += len(record)
    all_records, all_slots = np.concatenate(records), np.concatenate(slots)
    # the faces of a child are only known to its parent: the root's, to all
    low = np.clip(padded[owner == 0, 0].min(axis=0, initial=_FAR), -_FAR, _FAR)
    high = np.clip(padded[owner == 0, 1].max(axis=0, initial=-_FAR), -_FAR, _FAR)
    levels = 1 + int(_level(max(map(len, records)) - 1)) // 2
    return Nodes(
        records=upload(like.Float32, all_records),
        slots=upload(like.UInt, all_slots),
        unbounded=unbounded,
        deep=levels > _SHALLOW,
        first=np.array(firsts, dtype=np.uint32),
        single=np.array(single),
        bounds=[dr.opaque(like.Float, float(x)) for x in (*low, *high)],
        root_is_leaf=dr.opaque(like.Bool, bool(single[0])),
        bodies=bodies,
        bytes=all_records.nbytes + all_slots.nbytes,
    )


def _apart(boxes: np.ndarray) -> list[np.ndarray] | None:
    """Return the bodies that are the children of a root, if they are apart and it is worthwhile.

    They take a level of nodes to themselves. Walks in deep trees are slower.
    """
    if levels_for(len(boxes)) > _SHALLOW:
        return None
    parts = bodies_apart(boxes)
    if len(parts) == 1 or 1 + max(levels_for(len(part)) for part in parts) > _SHALLOW:
        return None
    return parts


def _body_data(tree: Bvh, record: np.ndarray, count: int, like: Types) -> Bodies:
    """Return what is known of the root's children, from its record and in full."""
    root = record[1].view(np.uint32)
    axes = [(int(root[3 + k]) >> AXIS) & 3 for k in range(3)]
    faces = tree.bounds[4 : 4 + count].reshape(count, 6)
    return Bodies(
        bounds=[[dr.opaque(like.Float, float(x)) for x in box] for box in faces],
        kinds=dr.opaque(like.UInt, int(root[7]) >> INNER),
        axes=[dr.opaque(like.UInt, axis) for axis in axes],
    )


def _level(number: Any) -> Any:
    """Return the depth of binary nodes, 0 for node 0."""
    return np.maximum(np.frexp(number)[1] - 1, 0)


def _records(tree: Bvh, unbounded: bool) -> np.ndarray:
    """Return the records of the nodes up to the last one."""
    inner = tree.inner[_level(tree.inner) % 2 == 0]
    # without an inner node there is one leaf, which needs none, or a root without children
    last = int(inner[-1]) if len(inner) else int((tree.leaf == NO_LEAF).all())
    boxes, is_leaf, is_inner = _children(tree, inner)
    infinite = np.abs(boxes) > _FAR
    # the frame is that of the finite faces
    beside = infinite | ~(is_leaf | is_inner)[:, :, None, None]
    lowest = np.where(beside, np.inf, boxes).min(axis=(1, 2))
    highest = np.where(beside, -np.inf, boxes).max(axis=(1, 2))
    lowest, highest = (np.where(np.isfinite(x), x, 0.0) for x in (lowest, highest))
    # the origin is rounded down, by up to two units in its last place
    ulp = np.spacing(np.abs(lowest).astype(np.float32)).astype(np.float64)
    code, unit = _units((highest - lowest + 2 * ulp) / (STEPS - 0.2 - 2 * unbounded))
    # a little lower, so that the slack is there at the lowest step as well
    before = np.array(SCALE) * unit
    origin = lowest - (unbounded + 2 * _SLACK) * unit - before
    origin = np.nextafter(origin.astype(np.float32), np.float32(-np.inf))
    steps = np.where(beside, lowest[:, None, None], boxes)
    steps = (steps - (origin.astype(float) + before)[:, None, None]) / unit[:, None, None]
    low = np.floor(steps[:, :, 0] - _SLACK).astype(np.uint32)
    high = np.ceil(steps[:, :, 1] + _SLACK).astype(np.uint32)
    low[infinite[:, :, 0]], high[infinite[:, :, 1]] = 0, STEPS
    children = np.zeros((len(inner), 4), dtype=np.uint32)
    units = np.zeros(len(inner), dtype=np.uint32)
    for c in range(4):
        children[:, c] = _faces(low[:, c]) | _turned(_faces(high[:, c]))
        units |= is_inner[:, c].astype(np.uint32) << np.uint32(INNER + c)
        units |= is_leaf[:, c].astype(np.uint32) << np.uint32(LEAF + c)
    for k, axis in enumerate(_axes(boxes)):
        children[:, k] |= axis.astype(np.uint32) << np.uint32(AXIS)
    for a in range(3):
        units |= code[:, a] << np.uint32(8 * a)
    out = NODE.pack(last + 1)
    out[inner] = NODE.pack(len(inner), origin=origin, children=children, units=units)
    return out


def _faces(steps: np.ndarray) -> np.ndarray:
    """Return words with the faces ``(I, 3)`` from `FACE` on."""
    x, y, z = (steps[:, a] << np.uint32(FACE[a]) for a in range(3))
    return x | y | z


def _turned(words: np.ndarray) -> np.ndarray:
    """Return words turned to the right by `TURN`."""
    return (words >> np.uint32(TURN)) | (words << np.uint32(32 - TURN))


def _children(tree: Bvh, inner: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the boxes ``(I, 4, 2, 3)`` of children and which ``(I, 4)`` are leaves and nodes.

    A leaf that is an only child has a copy of its box beside it, and so has a body without another.
    """
    boxes = np.zeros((len(inner), 4, 2, 3))
    is_leaf, is_inner = np.zeros((2, len(inner), 4), dtype=bool)
    known = np.zeros(len(tree.leaf), dtype=bool)
    known[tree.inner] = True
    for half in range(2):
        child = 2 * inner + half
        only = tree.leaf[child] != NO_LEAF
        is_leaf[only, 2 * half] = True
        boxes[only, 2 * half : 2 * half + 2] = tree.bounds[child[only], None]
        for c in range(2):
            deeper = 2 * child[~only] + c
            boxes[~only, 2 * half + c] = tree.bounds[deeper]
            is_leaf[~only, 2 * half + c] = tree.leaf[deeper] != NO_LEAF
            is_inner[~only, 2 * half + c] = known[deeper]
        alone = ~(is_leaf | is_inner)[:, 2 * half + 1]
        boxes[alone, 2 * half + 1] = boxes[alone, 2 * half]
    return boxes, is_leaf, is_inner


def _axes(boxes: np.ndarray) -> list[np.ndarray]:
    """Return along which axes the pairs of four children, and the children of each, are apart."""
    centre = np.clip(boxes, -_FAR, _FAR).mean(axis=2)
    pairs = centre.reshape(-1, 2, 2, 3).mean(axis=2)
    apart = (pairs[:, 1] - pairs[:, 0], centre[:, 1] - centre[:, 0], centre[:, 3] - centre[:, 2])
    return [difference.argmax(axis=1) for difference in apart]


def _units(least: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least units not below `least` that are powers of two, or 1.5 times such.

    Returns
    -------
    code : array of uint32
        Twice the exponent, and one for the half: from 2^-63 on in eight bits.
    unit : array
    """
    least = np.maximum(least, 2.0**-63)
    mantissa, exponent = np.frexp(least)  # the mantissa is from 1/2 to 1
    code = 2 * (exponent - 1) + np.where(mantissa <= 0.5, 0, np.where(mantissa <= 0.75, 1, 2))
    return (code + 126).astype(np.uint32), 2.0 ** (code // 2) * (1 + code % 2 / 2)


def _padded(box: np.ndarray) -> np.ndarray:
    """Grow boxes by what float32 may lose of their faces, their size and the slab test."""
    finite = np.where(np.isfinite(box), box, 0.0)
    pad = 4e-7 * np.abs(finite).max(axis=1, keepdims=True)
    pad = pad + 1e-6 * np.abs(finite[:, 1:] - finite[:, :1]).max(axis=2, keepdims=True)
    return np.concatenate([box[:, :1] - pad, box[:, 1:] + pad], axis=1)
