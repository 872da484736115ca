"""Pack what a traversal reads: nodes of the BVH, leaves, their nets, groups of quadrics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from ..leaves.records import (
    CLOSED_FORMS,
    GRAPHS,
    INVERTED_KINDS,
    LEAST_REACH,
    NO_APEX,
    GraphLeaves,
    LeafKind,
    Leaves,
)
from .arrays import types_of, upload, upload_wide
from .buckets import Bucket, Choice, choose
from .float64_use import uses_pairs
from .leaf_nets import build_buckets
from .nodes import Nodes, build_nodes
from .quadric_records import (
    axes_records,
    cell_records,
    group_records,
    inverse_records,
    member_records,
    member_sides,
    polynomial_degree,
    polynomial_records,
    ranges,
    shared_section,
)
from .records import Record, bits
from .revolution_records import Revolutions, upload_revolutions
from .trim_table import TrimTable

__all__ = ["AFFINE", "DOMAIN", "PROJECTIVE", "Structure", "build_structure", "leaf_boxes"]

#: What culling reads of a leaf in an affine chart. Bounds are in the words' bits, see below.
AFFINE = Record(
    np.float32, shift=(3,), rows=(3, 3), quadratic_inward=bits((3,)), remainder_outward=bits()
)
#: ... and in a projective one; `outward` is the largest of the three.
PROJECTIVE = Record(np.float32, shift=(3,), remainder=(), rows=(4, 4), quadratic=(3,), outward=())
#: From leaf to patch: `map` takes barycentrics, `cell` is 1 + the trim cell or 0, `kind` and
#: `corner` are those of `ClosedFormLeaves`.
DOMAIN = Record(np.float32, map=(3, 3), patch=bits(), cell=bits(), kind=bits(), corner=bits())

#: Bits of exponent and mantissa of the bounds of an affine leaf, which begin at the least they can
#: be: the remainder has the lowest bits of the record's last word, three numbers `outward` those
#: from `OUTWARD_BITS` on, three numbers `inward` the lowest of a, b and c.
REMAINDER_DIGITS, LEAST_REMAINDER = (5, 6), 2.0**-29
REACH_DIGITS = (4, 3)
OUTWARD_BITS = (11, 18, 25)


@dataclass
class Structure:
    """All leaves of a scene under one BVH, on the device of one array type.

    Leaves are numbered: affine charts first, then projective ones, then groups of leaves with a
    closed form. Domain records follow the same order, with the members of groups at the end.
    """

    kinds: frozenset[LeafKind]  #: of all leaves: what the code of kernels depends on
    nodes: Nodes  #: one BVH for each object
    first_projective: Any  #: UInt, number of the first leaf of the second kind; opaque as the next
    first_group: Any  #: UInt, and of the third
    affine: Any  #: Float32, x `AFFINE`
    projective: Any  #: Float32, x `PROJECTIVE`
    nets: list[Bucket]  #: of affine leaves, in float32
    far_nets: list[Bucket]  #: of projective leaves, wide
    groups: Any  #: wide, x `GROUP`
    axes: Any  #: wide, x `AXES`: of each group; None if all are those of space
    #: The record of the group if there is but one, as data of the kernel: no ray gathers it.
    only_group: list[Any] | None
    #: see `quadric_records.shared_section`: data of the kernel, too, if not None
    shared_section: list[Any] | None
    members: Any  #: Float32, x `MEMBER`
    has_tables: bool  #: whether tables of likely members are before those of each group
    cells: Any  #: Float32, x `CELLS`: of groups in which some leaves are inverted
    inverses: Any  #: wide, x `INVERSE`: of each member
    polynomials: Any  #: Float32, x K * 4: P and Q of each member, if some kind has them
    domain: Any  #: Float32, x `DOMAIN`; None where leaves are patches, and of one kind
    polynomial_degree: int
    graph_count: int  #: affine and projective
    group_count: int
    #: whether what the sides of a member are at a hit tells its parameters, mostly
    by_sides: bool
    leaf_count: int  #: all leaves, members of groups counted singly
    bytes: int
    trim: TrimTable | None = None  #: only where some leaf has trims
    pairs: bool = False  #: wide numbers are `TwoFloat`, see `Types`
    revolutions: Revolutions | None = None  #: even aspheres, numbered after the groups

    def has(self, *kinds: LeafKind) -> bool:
        """Return whether there are leaves of one of these kinds."""
        return not self.kinds.isdisjoint(kinds)

    @property
    def has_graphs(self) -> bool:
        """Whether there is a leaf without a closed form."""
        return self.has(*GRAPHS)

    @property
    def has_groups(self) -> bool:
        """Whether there is a leaf with a closed form."""
        return self.has(*CLOSED_FORMS)

    @property
    def has_revolutions(self) -> bool:
        """Whether there is an even asphere."""
        return self.revolutions is not None

    @property
    def has_only_graphs(self) -> bool:
        """Whether there is nothing but graph leaves."""
        return not (self.has_groups or self.has_revolutions)

    @property
    def has_certain_hits(self) -> bool:
        """Whether culling may find that a ray certainly meets a leaf, trimmed nowhere."""
        return self.has(LeafKind.GRAPH_AFFINE) and self.trim is None


def build_structure(
    leaves: Leaves,
    like: Any,
    trims: tuple[TrimTable, np.ndarray] | None = None,
    objects: np.ndarray | None = None,
    object_count: int | None = None,
) -> Structure:
    """Pack `leaves` for the array types of `like` (a Dr.Jit float array or type).

    Parameters
    ----------
    leaves : Leaves
    like : Float
    trims : pair of TrimTable and (L,) int array, optional
        The cells of the leaves, -1 for those that need no test.
    objects : (L,) int array, optional
        Which object each leaf belongs to, from 0 on; each gets a tree of its own.
    object_count : int
        How many there are, if the last of them may have no leaves.
    """
    ty = types_of(like, uses_pairs(like))
    graph, closed = leaves.graph, leaves.closed_form
    order = _Order.of(leaves)
    members, group_first, graphs = order.members, order.group_first, order.graphs
    near, far = graph.select(order.near), graph.select(order.far)
    owner = None
    if objects is not None:
        of_graphs, of_closed, of_rest = np.split(objects, np.cumsum([len(graph), len(closed)]))
        owner = np.concatenate([of_graphs[graphs], of_closed[members[group_first]], of_rest])
    nodes = build_nodes(_boxes(leaves, order), ty, owner, object_count)
    grouped = closed.select(members)  # by group
    sides = member_sides(grouped)
    groups = group_records(grouped, group_first, order.group_size)
    records, has_tables = member_records(grouped, sides, len(graphs))
    arrays = {
        "affine": _affine_records(near),
        "projective": _projective_records(far),
        "members": records,
        "cells": cell_records(grouped, sides, groups),
        "groups": groups,  # now with the numbers of their tables
        "axes": axes_records(closed.select(members[group_first])),
        "inverses": inverse_records(grouped),
        "polynomials": polynomial_records(grouped),
        "domain": _domain(
            Leaves(graph.select(graphs), grouped, leaves.revolution),
            _cells_of(trims, leaves, graphs, members),
        ),
    }
    count = len(graphs) + len(group_first)
    aspheres = upload_revolutions(leaves.revolution, ty, count, len(graphs) + len(members))
    single = ty.Float is ty.Float32  # as members are
    shared = shared_section(grouped, sides) if single else None
    nets = build_buckets(near, order.affine, np.float32, ty)
    far_nets = build_buckets(far, order.projective, np.float64, ty)
    only = None
    if len(group_first) == 1:
        only = [ty.wide_opaque(float(x)) for x in groups[0]]
    kinds = leaves.kinds
    linear = not kinds & CLOSED_FORMS - {LeafKind.LINEAR}
    return Structure(
        **{
            name: None
            if a is None
            else upload_wide(ty, _at_least_one(a))
            if a.dtype == np.float64
            else upload(ty.Float32, _at_least_one(a))
            for name, a in arrays.items()
        },
        kinds=kinds,
        nodes=nodes,
        pairs=ty.pairs,
        only_group=only,
        shared_section=shared and [dr.opaque(ty.Float, x) for x in shared],
        has_tables=has_tables,
        nets=nets,
        far_nets=far_nets,
        first_projective=dr.opaque(ty.UInt, len(near)),
        first_group=dr.opaque(ty.UInt, len(graphs)),
        polynomial_degree=polynomial_degree(grouped),
        graph_count=len(graphs),
        group_count=len(group_first),
        by_sides=shared is not None or (single and trims is None and linear),
        leaf_count=len(leaves),
        bytes=sum(a.nbytes for a in arrays.values() if a is not None)
        + sum(bucket.bytes for bucket in (*nets, *far_nets))
        + nodes.bytes
        + (trims[0].bytes if trims else 0)
        + (aspheres.bytes if aspheres else 0),
        trim=None if trims is None else trims[0],
        revolutions=aspheres,
    )


def leaf_boxes(leaves: Leaves) -> np.ndarray:
    """Return the boxes ``(L, 2, 3)`` of leaves in the order of the structure, one for a group."""
    return _boxes(leaves, _Order.of(leaves))


def _boxes(leaves: Leaves, order: _Order) -> np.ndarray:
    boxes = leaves.graph.box[order.graphs]
    if len(order.members):
        box = leaves.closed_form.box[order.members]
        low = np.minimum.reduceat(box[:, 0], order.group_first)
        high = np.maximum.reduceat(box[:, 1], order.group_first)
        boxes = np.concatenate([boxes, np.stack([low, high], axis=1)])
    return np.concatenate([boxes, leaves.revolution.box])


@dataclass(frozen=True)
class _Order:
    """In which order leaves are: indices of graphs, and of closed forms."""

    affine: list[Choice]  #: the buckets of their nets, numbers are those among graphs
    projective: list[Choice]
    members: np.ndarray  #: by group
    group_first: np.ndarray  #: where groups begin, and how long they are
    group_size: np.ndarray

    @staticmethod
    def of(leaves: Leaves) -> _Order:
        kind = leaves.graph.kind
        buckets = []
        for chart in (LeafKind.GRAPH_AFFINE, LeafKind.GRAPH_PROJECTIVE):
            those = np.flatnonzero(kind == chart)
            nets = leaves.graph.nets[those]
            # polynomial patches have weight one on all leaves, up to rounding of float64
            weighted = nets.are_weighted() | (chart == LeafKind.GRAPH_PROJECTIVE)
            chosen = choose(nets.powers, np.where(weighted, 4, 3))
            buckets.append([replace(c, numbers=those[c.numbers]) for c in chosen])
        group = leaves.closed_form.group
        members = np.argsort(group, kind="stable")
        first, size = ranges(group[members])
        return _Order(buckets[0], buckets[1], members, first, size)

    @property
    def near(self) -> np.ndarray:
        """Affine leaves, by bucket."""
        return np.concatenate([c.numbers for c in self.affine])

    @property
    def far(self) -> np.ndarray:
        """Projective leaves, by bucket."""
        return np.concatenate([c.numbers for c in self.projective])

    @property
    def graphs(self) -> np.ndarray:
        """Both."""
        return np.concatenate([self.near, self.far])


def _at_least_one(a: np.ndarray) -> np.ndarray:
    return a if len(a) else np.zeros((1, *a.shape[1:]), a.dtype)


def _affine_records(leaves: GraphLeaves) -> np.ndarray:
    inward = _code(leaves.inward, REACH_DIGITS, LEAST_REACH)
    outward = _code(leaves.outward, REACH_DIGITS, LEAST_REACH)
    bounds = _code(leaves.remainder, REMAINDER_DIGITS, LEAST_REMAINDER)
    for e, shift in enumerate(OUTWARD_BITS):
        bounds |= outward[:, e] << np.uint32(shift)
    return AFFINE.pack(
        len(leaves),
        shift=leaves.shift,
        rows=leaves.chart[:, :3, :3],
        quadratic_inward=leaves.quadratic.astype(np.float32).view(np.uint32) | inward,
        remainder_outward=bounds,
    )


def _code(x: np.ndarray, digits: tuple[int, int], least: float) -> np.ndarray:
    """Return numbers, rounded up, as this many bits of an exponent and of a mantissa."""
    mantissa, exponent = np.frexp(np.maximum(x, least) / least)  # from 0.5 to 1
    code = np.ceil((2 * mantissa - 2 + exponent) * 2 ** digits[1])
    return np.minimum(code, 2 ** sum(digits) - 1).astype(np.uint32)


def _projective_records(leaves: GraphLeaves) -> np.ndarray:
    return PROJECTIVE.pack(
        len(leaves),
        shift=leaves.shift,
        remainder=leaves.remainder,
        rows=leaves.chart,
        quadratic=leaves.quadratic,
        outward=leaves.outward.max(axis=1, initial=0.0),
    )


def _cells_of(
    trims: tuple[TrimTable, np.ndarray] | None,
    leaves: Leaves,
    graphs: np.ndarray,
    members: np.ndarray,
) -> np.ndarray | None:
    """Return the trim cells of leaves in the order of the structure."""
    if trims is None:
        return None
    ends = np.cumsum([len(leaves.graph), len(leaves.closed_form)])
    of_graphs, of_closed, others = np.split(trims[1], ends)
    return np.concatenate([of_graphs[graphs], of_closed[members], others])


def _domain(leaves: Leaves, cells: np.ndarray | None) -> np.ndarray | None:
    """Return the records of domains, None where leaves are patches, all of one kind."""
    kinds = leaves.kinds
    if (
        cells is None
        and len(leaves) > 1
        and (len(kinds) == 1 or kinds == INVERTED_KINDS)
        and kinds <= CLOSED_FORMS - {LeafKind.CONE}
        and (leaves.patch == np.arange(len(leaves))).all()
        and (leaves.domain == np.eye(3)).all()
    ):
        return None
    return DOMAIN.pack(
        len(leaves),
        map=leaves.domain,
        patch=leaves.patch,
        cell=0 if cells is None else cells + 1,
        kind=leaves.kind,
        corner=np.concatenate(
            [
                np.full(len(leaves.graph), NO_APEX),
                leaves.closed_form.corner,
                np.full(len(leaves.revolution), NO_APEX),
            ]
        ),
    )
