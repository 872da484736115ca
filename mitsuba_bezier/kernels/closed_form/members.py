"""Find the patch of a quadric that a point is on, and its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import or_
from types import SimpleNamespace
from typing import Any

import drjit as dr

from ...leaves.records import CLOSED_FORMS, LeafKind
from ..arrays import dot3, gather_packets, reciprocal
from ..quadric_records import CELLS, INVERSE, MEMBER, MIN_GROUP_FOR_TABLE, TABLE
from ..query import Query
from ..records import is_kind
from ..structure import Structure
from ..trim import leaf_test
from ..two_float import fma, select
from .kinds import KINDS
from .polynomials import shared_rows

__all__ = ["Members", "OnMember", "Roots", "find_deferred", "find_members"]

#: Rounding of a member's rows, and of a point, in their own scale, some eight of float32. It
#: matters where all three coordinates are small, at the centre of projection (the tip of a lune),
#: and where a patch is narrow.
ROWS = 5e-7

#: Sums of sides, in their own scale, of which a rounding of float32 is 1e-6 at most.
ENOUGH = 0.1


@dataclass(frozen=True)
class Members:
    """The patches of a quadric, as the record of their group has them."""

    group: Any  #: UInt
    first: Any  #: UInt
    count: Any  #: UInt, see `GROUP`


@dataclass
class OnMember:
    """Which of two points is on a member of a group."""

    hit: Any  #: Bool
    second: Any  #: Bool: which point it is
    leaf: Any
    u: Any  #: of the leaf
    v: Any


@dataclass
class Roots:
    """Where a ray meets a quadric: pairs, the first root first."""

    wanted: list[Any]  #: Bool: whether it is there, and within the ray
    along: list[Any]  #: wide, ray parameter from `middle` on
    point: list[list[Any]]  #: three Float each, from the group's origin
    tolerance: list[Any]  #: Float, how far out of a patch it may be
    middle: list[Any]  #: three wide numbers, a point of the ray
    direction: list[Any]  #: three wide numbers

    def exactly(self, along: Any) -> list[Any]:
        """Return the point of the ray at a number as in `along`."""
        return [fma(along, d, p) for d, p in zip(self.direction, self.middle)]


def _inside(s: Structure, m: SimpleNamespace, p: list[Any], tolerance: Any) -> Any:
    """Return a mask of points that are between the three sides of a member."""
    bary = _values(m.sides, p)
    total = bary[0] + bary[1] + bary[2]
    # Compared before a division: near the centre of projection all four are roundings.
    # Only patches that reach the centre, the lunes, may have a hit there.
    size = dr.abs(total)
    # planes have sides, barycentrics have not
    signed = bary
    if s.has(LeafKind.LINEAR):
        sign = total
        if s.has(*CLOSED_FORMS - {LeafKind.LINEAR}):
            sign = dr.select(is_kind(m.kind, LeafKind.LINEAR), total, 1.0)
        signed = [dr.mulsign(b, sign) for b in bary]
    lowest = dr.minimum(dr.minimum(signed[0], signed[1]), signed[2])
    return (lowest >= -dr.fma(tolerance, size, ROWS)) & (size >= m.least_sum)


def find_members(query: Query, members: Members, roots: Roots) -> OnMember:
    """Find the first of two points that is on a member of a group."""
    s, ty, first, count = query.s, query.ty, members.first, members.count
    want1, want2 = roots.wanted
    k, following = first, first + 1
    if s.has_tables:
        first = first + (members.group + 1) * TABLE
        point = [dr.select(want1, a, b) for a, b in zip(*roots.point)]
        many = count >= MIN_GROUP_FOR_TABLE
        likely = _likely_member(query, first, point, many & (want1 | want2))
        k = dr.select(many, first + dr.minimum(likely, count - 1), first)
        following = dr.select(many, first, first + 1)
    last = first + count

    def parameters(leaf: Any, along: Any, active: Any) -> tuple[Any, Any]:
        return _barycentrics(query, leaf, roots.exactly(along), active)

    def body(
        run: Any, k: Any, following: Any, hit1: Any, hit2: Any, leaf1: Any, leaf2: Any, sides: Any
    ) -> Any:
        m = MEMBER.gather(s.members, k, run, "kind")
        leaf = m.leaf
        is_in1 = _inside(s, m, roots.point[0], roots.tolerance[0])
        is_in2 = _inside(s, m, roots.point[1], roots.tolerance[1])
        in1, in2 = want1 & ~hit1 & is_in1, want2 & ~hit2 & is_in2
        kept = leaf_test(s, leaf)
        if kept is not None:
            in1 = in1 & kept(*parameters(leaf, roots.along[0], in1), in1)
            in2 = in2 & kept(*parameters(leaf, roots.along[1], in2), in2)
        hit1, hit2 = hit1 | in1, hit2 | in2
        leaf1, leaf2 = dr.select(in1, leaf, leaf1), dr.select(in2, leaf, leaf2)
        if s.by_sides:
            at1, at2 = (_values(m.sides, p) for p in roots.point)
            sides = [
                dr.select(in1, x1, dr.select(in2, x2, x)) for x1, x2, x in zip(at1, at2, sides)
            ]
        run = run & (following < last) & ~hit1 & (want1 | ~hit2)
        return run, following, following + 1, hit1, hit2, leaf1, leaf2, sides

    none, no = dr.zeros(ty.UInt), ty.Bool(False)
    sides = [dr.zeros(ty.Float)] * 3 if s.by_sides else []  # their values at the hit
    _run, _k, _following, hit1, hit2, leaf1, leaf2, sides = dr.while_loop(
        (want1 | want2, k, following, no, no, none, none, sides),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "member", "following", "hit1", "hit2", "leaf1", "leaf2", "sides"),
        label="bezier group members",
    )
    hit, leaf = hit1 | hit2, dr.select(hit1, leaf1, leaf2)
    along = select(hit1, *roots.along)
    if not s.by_sides:
        return OnMember(hit, ~hit1, leaf, *parameters(leaf, along, hit))
    u, v = _from_sides(s, sides, leaf, along, hit, parameters)
    return OnMember(hit, ~hit1, leaf, u, v)


def _from_sides(
    s: Structure, sides: list[Any], leaf: Any, along: Any, hit: Any, parameters: Any
) -> tuple[Any, Any]:
    """Return the parameters of hits from the values of their sides, what else finds them if not."""
    x, y, rest = _values(shared_rows(s), sides) if s.shared_section else sides
    total = dr.select(hit, x + y + rest, 1.0)
    scale = reciprocal(total)
    u, v = x * scale, y * scale
    if s.shared_section:
        return u, v
    small = dr.abs(total) < ENOUGH  # as near the tip of a lune
    return dr.if_stmt(
        args=(leaf, along, u, v),
        cond=small,
        true_fn=lambda leaf, along, _u, _v: parameters(leaf, along, small),
        false_fn=lambda _leaf, _along, u, v: (u, v),
        label="bezier near a tip",
    )


def find_deferred(query: Query, members: Members, roots: Roots) -> OnMember:
    """As `find_members`, where parameters tell whether a point is on some of the members.

    Lanes look for a member that may have one of their points, and wait for the others: then all
    take Newton's method. The members to be looked at are the bits of a word: those that may have
    the first point from bit 0 on, those that may have the second one from bit 16 on.
    """
    s, ty = query.s, query.ty
    table = members.count >> 5
    count = members.count & 31
    many = table > 0
    masks = [
        dr.select(many, _possible_members(query, table - 1, point, many & wanted), (1 << count) - 1)
        for point, wanted in zip(roots.point, roots.wanted)
    ]
    masks = [dr.select(wanted, mask, 0) for wanted, mask in zip(roots.wanted, masks)]

    def body(run: Any, left: Any, hit: Any, second: Any, leaf: Any, u: Any, v: Any) -> Any:
        def step(go: Any, left: Any, found: Any, second: Any, leaf: Any, kind: Any) -> Any:
            place = ty.UInt(dr.tzcnt(left))
            left = left & (left - 1)
            m = MEMBER.gather(s.members, members.first + (place & 15), go, "kind")
            leaf, kind = m.leaf, m.kind
            second = place >= 16
            p = [dr.select(second, b, a) for a, b in zip(*roots.point)]
            tolerance = dr.select(second, roots.tolerance[1], roots.tolerance[0])
            found = go & _inside(s, m, p, tolerance)
            return go & ~found & (left != 0), left, found, second, leaf, kind

        no = ty.Bool(False)
        _go, left, found, second, leaf, kind = dr.while_loop(
            (run, left, no, no, leaf, dr.zeros(ty.UInt)),
            cond=lambda *st: st[0],
            body=step,
            labels=("go", "left", "found", "second", "leaf", "kind"),
            label="bezier likely members",
        )
        p = roots.exactly(select(second, roots.along[1], roots.along[0]))
        tolerance = dr.select(second, roots.tolerance[1], roots.tolerance[0])
        hit, u, v = _decide(query, leaf, kind, p, tolerance, found)
        kept = leaf_test(s, leaf)
        if kept is not None:
            hit = hit & kept(u, v, hit)
        return run & ~hit & (left != 0), left, hit, second, leaf, u, v

    zero, no = dr.zeros(ty.Float), ty.Bool(False)
    left = masks[0] | (masks[1] << 16)
    _run, _left, hit, second, leaf, u, v = dr.while_loop(
        (left != 0, left, no, no, dr.zeros(ty.UInt), zero, zero),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "left", "hit", "second", "leaf", "u", "v"),
        label="bezier group members",
    )
    return OnMember(hit, second, leaf, u, v)


def _decide(
    query: Query, leaf: Any, kind: Any, p: list[Any], tolerance: Any, found: Any
) -> tuple[Any, Any, Any]:
    """Find out whether points between the sides of members are on them, and their parameters."""
    kinds = query.s.kinds & CLOSED_FORMS
    hit, u, v = found, None, None
    by_sides = [k for k in kinds if KINDS[k].decide is None]
    if by_sides:
        others = _any_kind(kind, by_sides)
        u, v = _barycentrics(query, leaf, p, found & others)
    for decide in dict.fromkeys(KINDS[k].decide for k in sorted(kinds - set(by_sides))):
        assert decide is not None
        mine = _any_kind(kind, [k for k in kinds if KINDS[k].decide is decide])
        inside, its_u, its_v = decide(query, leaf, p, tolerance, found & mine)
        u = its_u if u is None else dr.select(mine, its_u, u)
        v = its_v if v is None else dr.select(mine, its_v, v)
        hit = hit & (inside | ~mine)
    return hit, u, v


def _any_kind(kind: Any, kinds: list[LeafKind]) -> Any:
    """Return a mask of leaves of one of these kinds."""
    return reduce(or_, (is_kind(kind, k) for k in sorted(kinds)))


def _possible_members(query: Query, table: Any, point: list[Any], active: Any) -> Any:
    """Look up which members of a group may have a point, as bits."""
    s, ty = query.s, query.ty
    at = table * CELLS.size
    scale = gather_packets(s.cells, at >> 3, 8, active)
    inside, cell = ty.Bool(True), ty.UInt(0)
    for a in range(3):
        x = dr.fma(point[a], scale[a], 4.0)
        inside = inside & (x >= 0.0) & (x < 8.0)
        cell = cell | ((ty.UInt(dr.clip(x, 0.0, 7.0)) & 7) << (3 * a))
    word = dr.gather(
        ty.Float32, s.cells, at + CELLS.first["members"] + (cell >> 1), active & inside
    )
    bits = dr.reinterpret_array(ty.UInt, word) >> ((cell & 1) << 4)
    return dr.select(inside, bits & 0xFFFF, 0)


def _likely_member(query: Query, first: Any, point: list[Any], active: Any) -> Any:
    """Look up which member of a group covers a point, most likely, in the table before them."""
    s, ty = query.s, query.ty
    floats, cell = first * MEMBER.size, ty.UInt(0)
    word = dr.gather(ty.Float32, s.members, floats + MEMBER.first["cells"], active)
    word = dr.reinterpret_array(ty.UInt, word)
    for a in range(3):
        scale = dr.reinterpret_array(ty.Float32, ((word >> (10 * a)) & 1023) << 21)
        along = ty.UInt(dr.clip(dr.fma(point[a], ty.Float(scale), 4.0), 0.0, 7.0))
        cell = cell | ((along & 7) << (3 * a))
    word = dr.gather(ty.Float32, s.members, floats - TABLE * MEMBER.size + (cell >> 3), active)
    return (dr.reinterpret_array(ty.UInt, word) >> ((cell & 7) << 2)) & 15


def _values(rows: list[list[Any]], p: list[Any]) -> list[Any]:
    """Return linear forms of a point."""
    return [dot3(row, p) + row[3] for row in rows]


def _barycentrics(query: Query, leaf: Any, p: list[Any], active: Any) -> tuple[Any, Any]:
    """Invert a patch at a wide point: near the tip of a lune little is left of ``U`` in float32.

    Of sectors of cones these are the first two from the corner on that is their apex.
    """
    s, ty = query.s, query.ty
    number = dr.select(active, leaf - s.first_group, 0)
    others = [f for k in sorted(s.kinds & CLOSED_FORMS) if (f := KINDS[k].at_point) is not None]
    m = INVERSE.gather(s.inverses, number, active, None if others else "rows")
    bary = _values(m.rows, p)
    total = ty.narrow(bary[0] + bary[1] + bary[2])
    inv = reciprocal(dr.select(total == 0.0, 1.0, total))
    b0, b1, b2 = (ty.narrow(b) for b in bary)
    u, v = b0 * inv, b1 * inv
    for at_point in others:
        u, v = at_point(ty, m, p, [b0, b1, b2], (u, v))
    return u, v
