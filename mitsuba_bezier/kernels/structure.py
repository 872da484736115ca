"""The buffers a traversal reads: tree nodes, leaf records, leaf nets, groups of quadrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..geometry import bernstein
from ..leaves.records import INWARD, LEAST_REACH, OUTWARD, SECTION, Leaves
from .arrays import types_of, upload
from .nodes import Nodes, build_nodes
from .quadric_records import (
    MEMBER,
    axes_records,
    cell_records,
    group_records,
    inverse_records,
    member_records,
    member_sides,
    ranges,
    section_records,
    shared_section,
)
from .trim_table import TrimTable

__all__ = ["Structure", "build_structure", "leaf_boxes"]

#: Floats in an affine leaf's record: shift 3, rows of the 3x3 chart 9, a b c, the remainder,
#: and bits for more, see below.
AFFINE = 16
#: Floats in a projective leaf's record: shift 3, remainder, 4x4 chart 16, a b c, margin.
PROJECTIVE = 24
#: Floats before the net: variation, bending, the six numbers of the parameter quadratics.
HEAD = 8
#: Floats in a domain record: leaf-to-patch map 9, then as bits the patch, and 1 + the trim cell;
#: `SECTION`.
DOMAIN = 16

#: Bits of exponent and mantissa of the bounds of an affine leaf, which begin at the least they can
#: be: the remainder has the lowest bits of the record's last word, three numbers `outward` those
#: from `OUTWARD_BITS` on, three numbers `inward` the lowest of a, b and c.
REMAINDER_DIGITS, LEAST_REMAINDER = (5, 6), 2.0**-29
REACH_DIGITS = (4, 3)
OUTWARD_BITS = (11, 18, 25)


@dataclass
class Structure:
    """All leaves of a scene under one tree, on the device of one array type.

    Leaves are numbered: affine charts first, then projective ones, then groups of exact
    leaves. Domain records follow the same order, with the members of groups at the end.
    """

    nodes: Nodes  #: one tree for each object
    first_projective: Any  #: UInt, number of the first leaf of the second kind; opaque as the next
    first_group: Any  #: UInt, and of the third
    affine: Any  #: Float32, x `AFFINE`
    projective: Any  #: Float32, x `PROJECTIVE`
    nets: Any  #: Float32, x (`HEAD` + K * `components`), padded to packets of eight; affine leaves
    far_nets: Any  #: Float64, the same for projective leaves, four components
    groups: Any  #: Float64, x `GROUP`
    axes: Any  #: Float64, x `AXES`: of each group, if one has others than those of space
    #: The record of the group if there is but one, as data of the kernel: no ray gathers it.
    only_group: list[Any] | None
    #: see `quadric_records.shared_section`: data of the kernel, too, if not None
    shared_section: list[Any] | None
    members: Any  #: Float32, x `MEMBER`
    cells: Any  #: Float32, x `CELLS`: of groups with a member for which `has_inverted`
    rows: Any  #: Float64, x `MEMBER`: the rows of each member, unscaled
    planes: Any  #: Float32, x K * 4: P and Q of each member (`plane_sections`), if one is a section
    domain: Any  #: Float32, x `DOMAIN`; nothing where leaves are patches, all of one kind
    degree: int  #: of `nets`; lower degrees are padded with zero monomials
    components: int  #: of `nets`: 4, or 3 where all weights are one
    affine_count: int
    graph_count: int  #: affine and projective
    group_count: int
    #: whether what the sides of a member are at a hit tells its parameters, mostly
    by_sides: bool
    has_sections: bool  #: whether parameters of some exact leaves take an iteration
    has_axes: bool  #: whether rays change to axes of their own for groups
    has_inverted: bool  #: ... and to tell whether a point is on them at all
    only_inverted: bool  #: ... as on all exact leaves
    has_apexes: bool  #: whether some exact leaves have a point where their quadric is singular
    has_cones: bool  #: whether some exact leaves are sectors of cones
    leaf_count: int  #: all leaves, members of groups counted singly
    bytes: int
    trim: TrimTable | None = None  #: only where some leaf has trims

    @property
    def kinds(self) -> tuple[bool | int, ...]:
        """What the code of kernels depends on beside the other attributes, but counts."""
        return (
            self.has_affine,
            self.has_projective,
            self.has_groups,
            self.shared_section is not None,
            self.by_sides,
            self.has_axes,
            self.has_inverted,
            self.only_inverted,
            self.has_apexes,
            self.has_cones,
            dr.width(self.domain) < self.leaf_count * DOMAIN,
            dr.width(self.members) > dr.width(self.rows),
            dr.width(self.planes) * MEMBER // max(1, dr.width(self.rows)),
        )

    @property
    def decides(self) -> bool:
        """Whether culling may tell that a ray certainly meets a leaf, trimmed nowhere."""
        return self.has_affine and self.trim is None

    @property
    def has_affine(self) -> bool:
        """Whether there is a leaf with an affine chart."""
        return self.affine_count > 0

    @property
    def has_projective(self) -> bool:
        """Whether there is a leaf with a projective chart."""
        return self.graph_count > self.affine_count

    @property
    def has_graphs(self) -> bool:
        """Whether there is a leaf without a closed form."""
        return self.graph_count > 0

    @property
    def has_groups(self) -> bool:
        """Whether there is a leaf with a closed form."""
        return self.group_count > 0


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
    ty = types_of(like)
    affine, projective, exact, group_first, group_size = _order(leaves)
    graph = np.concatenate([affine, projective])
    order = np.concatenate([graph, exact])
    boxes = leaf_boxes(leaves)
    owner = None
    if objects is not None:
        owner = np.concatenate([objects[graph], objects[exact[group_first]]])
    nodes = build_nodes(boxes, ty, owner, object_count)
    # polynomial patches have weight one on all leaves, up to rounding of float64
    rational = bool((np.abs(leaves.net[affine, :, 3]) > 1e-12).any())
    components = 4 if rational else 3
    sides = member_sides(leaves, exact)
    arrays = {
        "affine": _affine_records(leaves, affine),
        "projective": _projective_records(leaves, projective),
        "nets": _nets(leaves, affine, components).astype(np.float32),
        "far_nets": _nets(leaves, projective),
        "groups": group_records(leaves, exact, group_first, group_size),
        "axes": axes_records(leaves, exact[group_first]),
        "members": member_records(leaves, exact, sides, len(graph)),
        "rows": inverse_records(leaves, exact),
        "planes": section_records(leaves, exact),
        "domain": _domain(leaves, order, None if trims is None else trims[1]),
    }
    arrays["cells"] = cell_records(leaves, exact, sides, arrays["groups"])
    single = ty.Float is ty.Float32  # as members are
    shared = shared_section(leaves, exact, sides) if single else None
    only = None
    if len(group_first) == 1:
        only = [dr.opaque(ty.Float64, float(x)) for x in arrays["groups"][0]]
    return Structure(
        **{
            name: upload(ty.Float64 if a.dtype == np.float64 else ty.Float32, _at_least_one(a))
            for name, a in arrays.items()
        },
        nodes=nodes,
        only_group=only,
        shared_section=shared and [dr.opaque(ty.Float, x) for x in shared],
        first_projective=dr.opaque(ty.UInt, len(affine)),
        first_group=dr.opaque(ty.UInt, len(graph)),
        degree=bernstein.degree_of(leaves.net.shape[1]),
        components=components,
        affine_count=len(affine),
        graph_count=len(graph),
        group_count=len(group_first),
        has_sections=bool(leaves.are_sections.any()),
        by_sides=shared is not None
        or (single and trims is None and not leaves.form[exact, SECTION].any()),
        has_axes=len(arrays["axes"]) > 0,
        has_inverted=bool(leaves.are_inverted.any()),
        only_inverted=len(exact) > 0 and bool(leaves.are_inverted[exact].all()),
        has_apexes=bool((leaves.are_cones | _have_sides(leaves)).any()),
        has_cones=bool(leaves.are_cones.any()),
        leaf_count=len(leaves),
        bytes=sum(a.nbytes for a in arrays.values())
        + nodes.bytes
        + (trims[0].bytes if trims else 0),
        trim=None if trims is None else trims[0],
    )


def leaf_boxes(leaves: Leaves) -> np.ndarray:
    """Return the boxes ``(L, 2, 3)`` of leaves in the order of the structure, one for a group."""
    affine, projective, exact, group_first, _size = _order(leaves)
    boxes = leaves.box[np.concatenate([affine, projective])]
    if not len(exact):
        return boxes
    low = np.minimum.reduceat(leaves.box[exact, 0], group_first)
    high = np.maximum.reduceat(leaves.box[exact, 1], group_first)
    return np.concatenate([boxes, np.stack([low, high], axis=1)])


def _order(leaves: Leaves) -> tuple[np.ndarray, ...]:
    """Return which leaves are affine, projective and exact, and first and size of the groups."""
    straight = (leaves.frame[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    exact = np.flatnonzero(leaves.exact)
    exact = exact[np.argsort(leaves.group[exact], kind="stable")]
    affine = np.flatnonzero(~leaves.exact & straight)
    projective = np.flatnonzero(~leaves.exact & ~straight)
    return affine, projective, exact, *ranges(leaves.group[exact])


def _have_sides(leaves: Leaves) -> np.ndarray:
    """Tell which inverted leaves are projected along a line: those at the apex of a cone."""
    return leaves.are_inverted & leaves.frame[:, 3].any(axis=1)


def _at_least_one(a: np.ndarray) -> np.ndarray:
    return a if len(a) else np.zeros((1, *a.shape[1:]), a.dtype)


def _affine_records(leaves: Leaves, which: np.ndarray) -> np.ndarray:
    out = np.zeros((len(which), AFFINE), dtype=np.float32)
    out[:, 0:3] = leaves.shift[which]
    out[:, 3:12] = leaves.frame[which, :3, :3].reshape(-1, 9)
    out[:, 12:16] = _bounds_records(leaves.form[which]).view(np.float32)
    return out


def _bounds_records(form: np.ndarray) -> np.ndarray:
    """Return the last four floats of affine records, as bits."""
    out = np.zeros((len(form), 4), dtype=np.uint32)
    out[:, :3] = form[:, :3].astype(np.float32).view(np.uint32)
    out[:, :3] |= _code(form[:, INWARD], REACH_DIGITS, LEAST_REACH)
    out[:, 3] = _code(form[:, 3], REMAINDER_DIGITS, LEAST_REMAINDER)
    outward = _code(form[:, OUTWARD], REACH_DIGITS, LEAST_REACH)
    for e, shift in enumerate(OUTWARD_BITS):
        out[:, 3] |= outward[:, e] << np.uint32(shift)
    return out


def _code(x: np.ndarray, digits: tuple[int, int], least: float) -> np.ndarray:
    """Return numbers, rounded up, as so many bits of an exponent and of a mantissa."""
    mantissa, exponent = np.frexp(np.maximum(x, least) / least)  # from 0.5 to 1
    code = np.ceil((2 * mantissa - 2 + exponent) * 2 ** digits[1])
    return np.minimum(code, 2 ** sum(digits) - 1).astype(np.uint32)


def _projective_records(leaves: Leaves, which: np.ndarray) -> np.ndarray:
    out = np.zeros((len(which), PROJECTIVE), dtype=np.float32)
    out[:, 0:3] = leaves.shift[which]
    out[:, 3] = leaves.form[which, 3]
    out[:, 4:20] = leaves.frame[which].reshape(-1, 16)
    out[:, 20:23] = leaves.form[which, :3]
    out[:, 23] = leaves.form[which, 6]
    return out


def _nets(leaves: Leaves, which: np.ndarray, components: int = 4) -> np.ndarray:
    width = HEAD + leaves.net.shape[1] * components
    out = np.zeros((len(which), -(-width // 8) * 8))
    out[:, 0:2] = leaves.form[which, 4:6]
    out[:, 2:8] = leaves.form[which, 7:13]
    out[:, HEAD:width] = leaves.net[which, :, :components].reshape(len(which), width - HEAD)
    return out


def _domain(leaves: Leaves, order: np.ndarray, cells: np.ndarray | None) -> np.ndarray:
    section = np.where(leaves.exact[order], leaves.form[order, SECTION], 0.0)
    if (
        cells is None
        and len(order) > 1
        and leaves.exact.all()
        and (leaves.patch[order] == np.arange(len(order))).all()
        and (section == section[0]).all()
        and section[0] >= 0
        and (leaves.domain[order] == np.eye(3)).all()
    ):
        return np.zeros((0, DOMAIN), dtype=np.float32)  # leaf and patch are the same
    out = np.zeros((len(order), DOMAIN), dtype=np.float32)
    out[:, :9] = leaves.domain[order].reshape(-1, 9)
    out[:, 9] = leaves.patch[order].astype(np.uint32).view(np.float32)
    out[:, 11] = section
    if cells is not None:
        out[:, 10] = (cells[order] + 1).astype(np.uint32).view(np.float32)
    return out
