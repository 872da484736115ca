"""Intersect rays with instances of objects under affine maps: a BVH over those of the objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..leaves.bvh import NO_LEAF
from .arrays import dot3, reciprocal, types_of, upload
from .nodes import Nodes, build_nodes
from .query import Found, Hit, Nearest, Query, Rays
from .records import Record, bits
from .structure import Structure
from .traverse import finish, search
from .two_float import fma
from .walk import BvhRays, begin, begin_at_root, next_leaf, prepare

__all__ = ["Instances", "build_instances", "intersect_instances"]

#: An instance: a ball around it in space, the inverse map about its centre, the first node of the
#: BVH of its object, and 1 if the root of that is a leaf.
INSTANCE = Record(
    np.float32, centre=(3,), radius=(), rows=(3, 3), middle=(3,), first=bits(), single=bits()
)


@dataclass
class Instances:
    """The instances of some objects."""

    structure: Structure  #: of the objects
    nodes: Nodes  #: the BVH of the instances
    records: Any  #: Float32, x `INSTANCE`
    count: int
    bytes: int  #: of the instances, without the objects


def build_instances(
    structure: Structure, boxes: np.ndarray, objects: np.ndarray, matrices: np.ndarray, like: Any
) -> Instances:
    """Build the BVH of instances.

    Parameters
    ----------
    structure : Structure
        Of the objects, built with `objects`.
    boxes : (N, 2, 3) array
        A finite box around each instance.
    objects : (N,) int array
        Which object it is an instance of.
    matrices : (N, 4, 4) array
        Affine maps from object to space.
    like : Float
    """
    ty = types_of(like)
    nodes = build_nodes(boxes, ty)
    centre = boxes.mean(axis=1).astype(np.float32).astype(np.float64)
    inverse = np.linalg.inv(matrices)
    out = INSTANCE.pack(
        len(boxes),
        centre=centre,
        # rounded up: rays are traced from in front of the ball
        radius=np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1) / 2 * 1.001 + 1e-30,
        rows=inverse[:, :3, :3],
        middle=np.einsum("nij,nj->ni", inverse[:, :3, :3], centre) + inverse[:, :3, 3],
        first=structure.nodes.first[objects],
        single=structure.nodes.single[objects],
    )
    return Instances(
        structure=structure,
        nodes=nodes,
        records=upload(ty.Float32, out),
        count=len(boxes),
        bytes=nodes.bytes + out.nbytes,
    )


def intersect_instances(
    c: Instances, o: Any, d: Any, t_max: Any, active: Any = True, any_hit: bool = False
) -> tuple[Hit, Any]:
    """Intersect rays with all instances; see `traverse.intersect`.

    A ray is taken to an object's space from its point in front of the instance, which is a wide
    number: so an instance far from the origin, or from the camera, is as exact as one that is not.

    Returns
    -------
    hit : Hit
    instance : UInt
    """
    s = c.structure
    ty = types_of(o[0], s.pairs)
    query, rays = Query(s, ty, any_hit), Rays.of(ty, o, d, t_max)
    o, d = rays.o, rays.d
    active = ty.Bool(active) & rays.are_valid()
    bvh = BvhRays(c.nodes, ty, ty.UInt(0), prepare(ty, o, d))
    start_of_walk = begin(ty, c.nodes, bvh.slabs, rays.t_max)
    inv_length2 = reciprocal(dot3(d, d))
    inv_length = dr.sqrt(inv_length2)

    def body(run: Any, walk: Any, nearest: Any, instance: Any) -> Any:
        walk, index = next_leaf(bvh, walk, nearest.t, run)
        found = run & (index != NO_LEAF)
        m = INSTANCE.gather(c.records, index, found)
        away = [ty.widen(m.centre[i]) - ty.widen(o[i]) for i in range(3)]
        ahead = ty.narrow(dot3(away, [ty.widen(x) for x in d])) * inv_length2
        start = dr.maximum(ahead - m.radius * inv_length, 0.0)
        p = [ty.narrow(fma(ty.widen(start), ty.widen(d[i]), -away[i])) for i in range(3)]
        local_o = [dot3(row, p) + middle for row, middle in zip(m.rows, m.middle)]
        local = Rays(local_o, [dot3(row, d) for row in m.rows], nearest.t - start)
        inside = BvhRays(s.nodes, ty, m.first, prepare(ty, local.o, local.d))
        found = found & (local.t_max > 0.0)
        root = begin_at_root(ty, s.nodes, m.single != 0, found)
        there = search(query, inside, local, root, found)
        accept = found & (there.leaf != NO_LEAF)
        t = ty.narrow(ty.widen(start) + ty.widen(there.t))
        nearest = nearest.updated(Found(accept, t, there.u, there.v, there.leaf))
        instance = dr.select(accept, index, instance)
        run = run & walk.goes_on()
        if any_hit:
            run = run & (nearest.leaf == NO_LEAF)
        return run, walk, nearest, instance

    active = active & start_of_walk.goes_on()
    _run, _walk, nearest, instance = dr.while_loop(
        (active, start_of_walk, Nearest.none(ty, rays.t_max), dr.zeros(ty.UInt)),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "walk", "nearest", "instance"),
        label="bezier instances",
    )
    return finish(query, nearest, active), instance
