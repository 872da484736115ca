"""One leaf by itself: what a ray meets in it, and its box.

That is what Mitsuba 3.10 asks of a shape in Python: its primitives are met one by one, in a kernel
that Mitsuba makes of the function (docs/mitsuba-3.10.md). So both functions take the number of a
leaf, as an array or a number, and can be traced where they are called: they gather and loop, and
have no side effects.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..leaves.records import Leaves
from .arrays import types_of, upload
from .query import Hit, Nearest, Query, Rays
from .structure import Structure, leaf_boxes
from .traverse import cull_leaf, finish, meet

__all__ = ["leaf_bounds", "leaf_count", "meet_leaf", "upload_bounds"]


def leaf_count(s: Structure) -> int:
    """Return how many leaves there are to be met: those of one quadric are one."""
    count = s.graph_count + s.group_count
    return count if s.revolutions is None else count + s.revolutions.count


def meet_leaf(
    s: Structure, leaf: Any, o: Any, d: Any, t_max: Any, active: Any = True, any_hit: bool = False
) -> Hit:
    """Intersect rays with one leaf each.

    Parameters
    ----------
    s : Structure
        Whose leaves they are.
    leaf : UInt
        Their numbers, from 0 to ``leaf_count(s) - 1``.
    o, d : three Float arrays each
        Origin and direction; the direction need not have unit length.
    t_max : Float
        Hits have ``0 < t < t_max``.
    active : Bool
        Which rays to trace.
    any_hit : bool
        Only whether there is a hit; then only `valid` means something.

    Returns
    -------
    Hit
        As `intersect` does, of this leaf alone: patch and parameters are those of the patch.
    """
    ty = types_of(o[0], s.pairs)
    query, rays = Query(s, ty, any_hit), Rays.of(ty, o, d, t_max)
    leaf = ty.UInt(leaf)
    active = ty.Bool(active) & rays.are_valid() & (leaf < leaf_count(s))
    met, line = cull_leaf(query, leaf, rays, active)
    found = meet(query, leaf, line, rays, met)
    nearest = Nearest(found.t, found.leaf, found.u, found.v)
    return finish(query, nearest, active & met & found.hit)


def upload_bounds(leaves: Leaves, like: Any) -> Any:
    """Return the boxes of leaves on the device, six numbers each, rounded outwards.

    Parameters
    ----------
    leaves : Leaves
        Those that `build_structure` was given.
    like : Float
    """
    ty = types_of(like)
    boxes = leaf_boxes(leaves)
    if ty.Float is ty.Float32:
        # one step further than rounded: a hit is rounded, too
        rounded = boxes.astype(np.float32)
        boxes = np.stack(
            [
                np.nextafter(rounded[:, 0], np.float32(-np.inf)),
                np.nextafter(rounded[:, 1], np.float32(np.inf)),
            ],
            axis=1,
        )
    return upload(ty.Float, boxes.reshape(-1, 6))


def leaf_bounds(bounds: Any, leaf: Any, active: Any = True) -> tuple[list[Any], list[Any]]:
    """Return the low and the high corner of leaves' boxes, of what `upload_bounds` returned.

    Faces are infinite where the surface runs to infinity.
    """
    ty = types_of(bounds)
    first = ty.UInt(leaf) * 6
    faces = [dr.gather(ty.Float, bounds, first + k, active) for k in range(6)]
    return faces[:3], faces[3:]
