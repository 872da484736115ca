"""Walk rays through a BVH, without a stack."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import drjit as dr

from ..leaves.bvh import NO_LEAF
from .arrays import Types, reciprocal
from .nodes import AXIS, FACE, INNER, NODE, SCALE, STEPS, TURN, Nodes

__all__ = [
    "BvhRays",
    "Slabs",
    "Walk",
    "begin",
    "begin_at_root",
    "next_leaf",
    "prepare",
    "take_leaf",
    "walk_to_leaves",
]

#: The largest reciprocal of a direction's component.
_LARGEST = 1e20

#: Slabs are widened by four roundings a face: of the difference, the product and, two, of the
#: reciprocal (Ize, "Robust BVH Ray Traversal", 2013, who has three). The origin's coordinates
#: are moved apart by as much, as they are multiplied before the difference.
_ROUNDING = 4.0 * 6e-8
_GROW = 1.0 + 2.0 * _ROUNDING


@dataclass
class Slabs:
    """What a slab test needs of a ray: ``plane * rcp + near`` is the entry, and the exit alike."""

    rcp: list[Any]  #: reciprocals of the direction, finite
    rcp_far: list[Any]  #: the same, a little more
    near: list[Any]  #: ``-o rcp``, a little less
    far: list[Any]  #: ``-o rcp_far``, a little more
    forward: Any  #: UInt: the bits of the faces along axes whose low faces are the near ones
    backward: Any  #: UInt: bit `a` tells that the direction's component `a` is negative


@dataclass(frozen=True)
class BvhRays:
    """A BVH, and what rays need to walk it."""

    nodes: Nodes
    ty: Types
    first: Any  #: UInt: where the BVH begins among the nodes
    slabs: Slabs


@dataclass
class Walk:
    """Where a ray is in a BVH, and which branches are left.

    Children have a place from 0 to 3 in the order in which the ray meets them, or should: the pairs
    of children are in order along an axis, and so are the two of each pair.
    """

    node: Any  #: UInt, zero at the end
    #: UInt, or UInt64 in deep trees: for each level from the node's on, four bits for the places of
    #: siblings that are still to be visited
    pending: Any
    turns: Any  #: the same, three bits for each level: the turns of the parent, see `_order`
    leaves: Any  #: UInt: a node's number, its turns and four bits for places of leaves; or zero

    def goes_on(self) -> Any:
        """Return a mask of walks on which there may be more leaves."""
        return (self.node != 0) | (self.leaves != 0)


def prepare(ty: Types, o: list[Any], d: list[Any]) -> Slabs:
    """Return what slab tests need of rays."""
    # finite reciprocals: zero times infinity would turn a slab into NaN
    tiny = ty.Float(1.0 / _LARGEST)
    rcp = [reciprocal(dr.select(dr.abs(c) > tiny, c, dr.select(c < 0.0, -tiny, tiny))) for c in d]
    rcp_far = [r * _GROW for r in rcp]
    near = [-dr.fma(dr.abs(o[a] * rcp[a]), _ROUNDING, o[a] * rcp[a]) for a in range(3)]
    far = [dr.fma(dr.abs(o[a] * rcp_far[a]), _ROUNDING, -o[a] * rcp_far[a]) for a in range(3)]
    forward, backward = ty.UInt(0), ty.UInt(0)
    for a in range(3):
        turned = rcp[a] < 0.0  # then the high face is the near one
        forward = forward | dr.select(turned, 0, ty.UInt(_bits(a)))
        backward = backward | dr.select(turned, ty.UInt(1 << a), 0)
    return Slabs(rcp, rcp_far, near, far, forward, backward)


def begin(ty: Types, nodes: Nodes, slabs: Slabs, t_max: Any) -> Walk:
    """Return the start of a walk through the first tree, at the end for rays that pass it by."""
    bodies = nodes.bodies
    if bodies is None:
        entered = _is_entered(ty, slabs, nodes.bounds, t_max)
        return begin_at_root(ty, nodes, nodes.root_is_leaf, entered)
    # a step at the root, whose record is not read
    walk = begin_at_root(ty, nodes, ty.Bool(False), ty.Bool(True))
    count = len(bodies.bounds)
    # the second pair, and the second of that, may not be there
    later = [
        ((slabs.backward >> axis) & 1) != 0 if count > needed else ty.Bool(False)
        for axis, needed in zip(bodies.axes, (2, 1, 3))
    ]
    order = _order(ty, later, bodies.kinds)
    entered = [_is_entered(ty, slabs, bounds, t_max) for bounds in bodies.bounds]
    return _descend(ty, walk, _up(ty, walk), order, entered)


def _is_entered(ty: Types, slabs: Slabs, bounds: list[Any], t_max: Any) -> Any:
    """Return a mask of rays that enter a box, given by its corners."""
    enter, leave = dr.zeros(ty.Float), t_max
    for a in range(3):
        low, high = bounds[a], bounds[3 + a]
        turned = slabs.rcp[a] < 0.0
        near = dr.fma(dr.select(turned, high, low), slabs.rcp[a], slabs.near[a])
        far = dr.fma(dr.select(turned, low, high), slabs.rcp_far[a], slabs.far[a])
        # one instruction each; those of dr.maximum and dr.minimum look out for NaN
        enter = dr.select(near > enter, near, enter)
        leave = dr.select(far < leave, far, leave)
    return enter <= leave


def begin_at_root(ty: Types, nodes: Nodes, is_leaf: Any, active: Any) -> Walk:
    """Return the start of a walk at the root of a tree, which may be a leaf."""
    state = dr.uint64_array_t(ty.UInt) if nodes.deep else ty.UInt
    none, one = dr.zeros(ty.UInt), ty.UInt(1)
    return Walk(
        node=dr.select(active & ~is_leaf, one, none),
        pending=dr.zeros(state),
        turns=dr.zeros(state),
        leaves=dr.select(active & is_leaf, one << 1, none),  # child 1 of node 0
    )


def walk_to_leaves(bvh: BvhRays, walk: Walk, t_max: Any, run: Any, most: int | None = None) -> Walk:
    """Walk to the next node with leaves whose boxes are hit, for `most` nodes at most.

    Nothing is done where the walk has leaves already.
    """

    def waits(walk: Any) -> Any:
        return (walk.leaves == 0) & (walk.node != 0)

    def step(walk: Any, go: Any) -> Any:
        record = NODE.gather(bvh.nodes.records, bvh.first + walk.node, go)
        return _step(bvh, record, walk, t_max)

    def body(go: Any, walk: Any) -> Any:
        walk = step(walk, go)
        return go & waits(walk), walk

    def counted(go: Any, walk: Any, count: Any) -> Any:
        walk, count = step(walk, go), count + 1
        return go & waits(walk) & (count < most), walk, count

    state = (run & waits(walk), walk)
    return dr.while_loop(
        state if most is None else (*state, dr.zeros(bvh.ty.UInt)),
        cond=lambda *st: st[0],
        body=body if most is None else counted,
        labels=("go", "walk", "count")[: 2 if most is None else 3],
        label="bezier boxes",
    )[1]


def take_leaf(bvh: BvhRays, leaves: Any, run: Any) -> tuple[Any, Any]:
    """Take the leaf that should be met first out of a walk's `leaves`.

    Returns
    -------
    leaves : UInt
        The others.
    leaf : UInt
        Its number, `NO_LEAF` where there was none.
    """
    found = run & (leaves != 0)
    child = _child(dr.tzcnt(leaves), leaves >> 4)
    slot = 4 * bvh.first + (((leaves >> 7) << 2) | child)
    leaf = dr.gather(bvh.ty.UInt, bvh.nodes.slots, slot, found)
    others = leaves & (leaves - 1)
    others = dr.select((others & 15) != 0, others, 0)
    return dr.select(found, others, leaves), dr.select(found, leaf, NO_LEAF)


def next_leaf(bvh: BvhRays, walk: Walk, t_max: Any, run: Any) -> tuple[Walk, Any]:
    """Walk to the next leaf whose box is hit, and past it; the leaf as from `take_leaf`."""
    walk = walk_to_leaves(bvh, walk, t_max, run)
    leaves, leaf = take_leaf(bvh, walk.leaves, run)
    return replace(walk, leaves=leaves), leaf


def _step(bvh: BvhRays, record: SimpleNamespace, walk: Walk, t_max: Any) -> Walk:
    """Test the four children of a node, which has no leaves in `walk`; go down, or up.

    Each step has to wait for the step before. So all that does not depend on the slab tests comes
    first, to be done while these are.
    """
    ty, slabs = bvh.ty, bvh.slabs
    words, units = record.children, record.units
    up = _up(ty, walk)
    later = [((slabs.backward >> ((word >> AXIS) & 3)) & 1) != 0 for word in words[:3]]
    order = _order(ty, later, units >> INNER)

    # near and far faces, in the same places
    high = [(word << TURN) | (word >> (32 - TURN)) for word in words]
    nears = [(w & slabs.forward) | (h & ~slabs.forward) for w, h in zip(words, high)]
    fars = [(h & slabs.forward) | (w & ~slabs.forward) for w, h in zip(words, high)]
    enter, leave = [dr.zeros(ty.Float)] * 4, [t_max] * 4
    for a in range(3):
        # eight bits from 22 on: half of the exponent, less 64, and the first of the mantissa
        bits = ((units << (22 - 8 * a)) & 0x3FC00000) + 0x20000000
        unit = ty.Float(dr.reinterpret_array(ty.Float32, bits))
        origin, scale = ty.Float(record.origin[a]), float(SCALE[a])
        in_unit, out_unit = unit * (slabs.rcp[a] * scale), unit * (slabs.rcp_far[a] * scale)
        near = dr.fma(origin, slabs.rcp[a], slabs.near[a])
        far = dr.fma(origin, slabs.rcp_far[a], slabs.far[a])
        for c in range(4):
            t_near = dr.fma(_face(ty, nears[c], a), in_unit, near)
            t_far = dr.fma(_face(ty, fars[c], a), out_unit, far)
            cuts_near, cuts_far = t_near > enter[c], t_far < leave[c]
            if bvh.nodes.unbounded:
                cuts_near &= _is_finite(nears[c], a)
                cuts_far &= _is_finite(fars[c], a)
            enter[c] = dr.select(cuts_near, t_near, enter[c])
            leave[c] = dr.select(cuts_far, t_far, leave[c])
    return _descend(ty, walk, up, order, [enter[c] <= leave[c] for c in range(4)])


def _descend(
    ty: Types,
    walk: Walk,
    up: tuple[Any, Any, Any],
    order: tuple[Any, Any, list[Any], Any],
    entered: list[Any],
) -> Walk:
    """Go down to a child, of up to four of which some are `entered`; or go up.

    Parameters
    ----------
    up, order : tuple
        As from `_up` and `_order`.
    """
    none = dr.zeros(ty.UInt)
    node, pending, turns_back = up
    turns, children, places, kinds = order
    hit = [dr.select(yes, place, none) for yes, place in zip(entered, places)]
    hits = hit[0] | hit[1]
    if len(hit) > 2:
        hits = hits | (hit[2] | hit[3] if len(hit) > 3 else hit[2])
    hits = hits & kinds
    inner, leaves = hits & 15, hits >> 4
    go_down = inner != 0
    child = (children >> (dr.tzcnt(inner) << 1)) & 3
    state = type(walk.pending)
    return Walk(
        dr.select(go_down, (walk.node << 2) | child, node),
        dr.select(go_down, (walk.pending << 4) | state(inner & (inner - 1)), pending),
        dr.select(go_down, (walk.turns << 3) | state(turns), turns_back),
        dr.select(leaves != 0, (walk.node << 7) | (turns << 4) | leaves, none),
    )


def _up(ty: Types, walk: Walk) -> tuple[Any, Any, Any]:
    """Return node, pending and turns of the branch to visit next, node zero if none is left."""
    state = type(walk.pending)
    place = ty.UInt(dr.tzcnt(walk.pending))
    turns = walk.turns >> state((place >> 2) * 3)
    node = ((walk.node >> ((place >> 1) & 30)) & 0xFFFFFFFC) | _child(place, ty.UInt(turns))
    # where nothing is left the place is the number of bits, and no shift
    others = (walk.pending & (walk.pending - 1)) >> state(
        place & (60 if state is not ty.UInt else 28)
    )
    return dr.select(walk.pending != 0, node, 0), others, turns


def _order(ty: Types, later: list[Any], kinds: Any) -> tuple[Any, Any, list[Any], Any]:
    """Return what the order of the children along a ray is.

    Parameters
    ----------
    later : three Bool
        Whether the second pair of children comes first, the second of the first pair, and the
        second of the second.
    kinds : UInt
        Which children are nodes, and which are leaves, four bits each.

    Returns
    -------
    turns : UInt
        `later` as bits.
    children : UInt
        The child at each place, two bits each.
    places : four UInt
        For each child the bits, in the two nibbles, of its place.
    kinds : UInt
        For each place.
    """

    def either(k: int, yes: int, no: int) -> Any:
        return dr.select(later[k], ty.UInt(yes), no)

    turns = either(0, 1, 0) | either(1, 2, 0) | either(2, 4, 0)
    first, second = either(0, 2, 0), either(0, 0, 2)  # the places of the pairs
    children = (either(1, 0b0001, 0b0100) << (2 * first)) | (
        either(2, 0b1011, 0b1110) << (2 * second)
    )
    places = [either(1, 0x22, 0x11) << first, either(1, 0x11, 0x22) << first]
    places += [either(2, 0x22, 0x11) << second, either(2, 0x11, 0x22) << second]
    swapped = ((kinds & 0x55) << 1) | ((kinds >> 1) & 0x55)
    of_first = dr.select(later[1], swapped, kinds) & 0x33
    of_second = (dr.select(later[2], swapped, kinds) >> 2) & 0x33
    return turns, children, places, (of_first << first) | (of_second << second)


def _child(place: Any, turns: Any) -> Any:
    """Return which child is at a place, the last two bits of `place`."""
    pair = ((place >> 1) ^ turns) & 1
    return (pair << 1) | ((place ^ (turns >> (pair + 1))) & 1)


def _bits(axis: int) -> int:
    """Return which bits are those of a face."""
    return STEPS << FACE[axis]


def _face(ty: Types, faces: Any, axis: int) -> Any:
    """Return 1 + k / `SCALE` for the face `k` along an axis."""
    return ty.Float(dr.reinterpret_array(ty.Float32, (faces & _bits(axis)) | 0x3F800000))


def _is_finite(faces: Any, axis: int) -> Any:
    """Return a mask of faces whose bits are neither all zero nor all one."""
    lowest = 1 << FACE[axis]
    return ((faces + lowest) & (_bits(axis) - lowest)) != 0
