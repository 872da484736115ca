"""What kernels hand on: rays, what is asked of a structure, and what is found."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import drjit as dr

from ..leaves.bvh import NO_LEAF
from .arrays import Types, dot3
from .structure import Structure

__all__ = ["Found", "Hit", "Nearest", "Query", "Rays"]


@dataclass
class Rays:
    """Rays ``o + t d``, of which the hits with ``0 < t < t_max`` count."""

    o: list[Any]  #: three Float
    d: list[Any]  #: three Float, of any length
    t_max: Any

    @staticmethod
    def of(ty: Types, o: Any, d: Any, t_max: Any) -> Rays:
        """Return rays of the array types `ty`."""
        o, d = [ty.Float(o[i]) for i in range(3)], [ty.Float(d[i]) for i in range(3)]
        return Rays(o, d, ty.Float(t_max))

    def until(self, t_max: Any) -> Rays:
        """Return the same rays with another end."""
        return replace(self, t_max=t_max)

    def are_valid(self) -> Any:
        """Return a mask of rays that are some; others, with NaN or no direction, are misses."""
        length2 = dot3(self.d, self.d)
        # NaN fails all comparisons
        valid = (dot3(self.o, self.o) < dr.inf) & (length2 > 0.0) & (length2 < dr.inf)
        return valid & (self.t_max > 0.0)


@dataclass(frozen=True)
class Query:
    """What is asked: the nearest hit, or if `any_hit` only whether there is one."""

    s: Structure
    ty: Types
    any_hit: bool

    @property
    def ends_where_certain(self) -> bool:
        """Whether culling is to find where there certainly is a hit."""
        return self.any_hit and self.s.has_certain_hits


@dataclass
class Found:
    """What is found in a leaf, or in a group of them."""

    hit: Any  #: Bool
    t: Any
    u: Any  #: of the leaf
    v: Any
    leaf: Any  #: UInt; for a group, the member


@dataclass
class Nearest:
    """The nearest hits so far."""

    t: Any
    leaf: Any  #: UInt, `NO_LEAF` at none
    u: Any  #: of the leaf
    v: Any

    @staticmethod
    def none(ty: Types, t_max: Any) -> Nearest:
        """Return what is so before anything is found."""
        zero = dr.zeros(ty.Float)
        return Nearest(t_max, ty.UInt(NO_LEAF), zero, zero)

    def updated(self, found: Found) -> Nearest:
        """Return what is so after a hit that is nearer."""
        hit = found.hit
        return Nearest(
            t=dr.select(hit, found.t, self.t),
            leaf=dr.select(hit, found.leaf, self.leaf),
            u=dr.select(hit, found.u, self.u),
            v=dr.select(hit, found.v, self.v),
        )


class Hit(NamedTuple):
    """Result of `traverse.intersect`, all of the rays' width."""

    valid: Any  #: Bool
    t: Any  #: Float, infinite where not valid
    patch: Any  #: UInt
    u: Any  #: Float, patch barycentrics
    v: Any
