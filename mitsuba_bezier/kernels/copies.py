"""Many copies of objects under affine maps: a tree of copies over the trees of the objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..leaves.bvh import NO_LEAF
from .arrays import dot3, gather_packets, reciprocal, types_of, upload
from .nodes import Nodes, build_nodes
from .structure import Structure
from .traverse import Hit, finish, is_ray, search
from .walk import begin, begin_at_root, next_leaf, prepare

__all__ = ["Copies", "build_copies", "intersect_copies"]

#: Floats in the record of a copy: centre 3 and radius in space, rows of the inverse map 9, centre
#: in the object 3; as bits the first node of the object's tree, and 1 if its root is a leaf.
COPY = 24


@dataclass
class Copies:
    """The copies of some objects."""

    structure: Structure  #: of the objects
    nodes: Nodes  #: the tree of the copies
    records: Any  #: Float32, x `COPY`
    count: int
    bytes: int  #: of the copies, without the objects


def build_copies(
    structure: Structure, boxes: np.ndarray, objects: np.ndarray, matrices: np.ndarray, like: Any
) -> Copies:
    """Build the tree of copies.

    Parameters
    ----------
    structure : Structure
        Of the objects, built with `objects`.
    boxes : (N, 2, 3) array
        A finite box around each copy.
    objects : (N,) int array
        Which object it is a copy of.
    matrices : (N, 4, 4) array
        Affine maps from object to space.
    like : Float
    """
    ty = types_of(like)
    nodes = build_nodes(boxes, ty)
    centre = boxes.mean(axis=1).astype(np.float32).astype(np.float64)
    inverse = np.linalg.inv(matrices)
    out = np.zeros((len(boxes), COPY), dtype=np.float32)
    out[:, 0:3] = centre
    # rounded up: rays are traced from in front of the ball
    out[:, 3] = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1) / 2 * 1.001 + 1e-30
    out[:, 4:13] = inverse[:, :3, :3].reshape(-1, 9)
    out[:, 13:16] = np.einsum("nij,nj->ni", inverse[:, :3, :3], centre) + inverse[:, :3, 3]
    out[:, 16] = structure.nodes.first[objects].view(np.float32)
    out[:, 17] = structure.nodes.single[objects].astype(np.uint32).view(np.float32)
    return Copies(
        structure=structure,
        nodes=nodes,
        records=upload(ty.Float32, out),
        count=len(boxes),
        bytes=nodes.bytes + out.nbytes,
    )


def intersect_copies(
    c: Copies, o: Any, d: Any, t_max: Any, active: Any = True, any_hit: bool = False
) -> tuple[Hit, Any]:
    """Intersect rays with all copies; see `traverse.intersect`.

    A ray is taken to an object's space from its point in front of the copy, which is found in
    float64: so a copy far from the origin, or from the camera, is as exact as one that is not.

    Returns
    -------
    hit : Hit
    copy : UInt
    """
    s = c.structure
    ty = types_of(o[0])
    f64 = ty.Float64
    o, d = [ty.Float(o[i]) for i in range(3)], [ty.Float(d[i]) for i in range(3)]
    t_max = ty.Float(t_max)
    active = ty.Bool(active) & is_ray(o, d, t_max)
    slabs = prepare(ty, o, d)
    start_of_walk = begin(ty, c.nodes, slabs, t_max)
    inv_length2 = reciprocal(dot3(d, d))
    inv_length = dr.sqrt(inv_length2)

    def body(run: Any, walk: Any, t: Any, leaf: Any, u: Any, v: Any, copy: Any) -> Any:
        walk, index = next_leaf(c.nodes, ty, ty.UInt(0), walk, slabs, t, run)
        found = run & (index != NO_LEAF)
        m = gather_packets(c.records, index, COPY, found)
        away = [f64(m[i]) - f64(o[i]) for i in range(3)]
        ahead = ty.Float(dot3(away, [f64(x) for x in d])) * inv_length2
        start = dr.maximum(ahead - m[3] * inv_length, 0.0)
        p = [ty.Float(dr.fma(f64(start), f64(d[i]), -away[i])) for i in range(3)]
        rows = [m[4 + 3 * r : 7 + 3 * r] for r in range(3)]
        local_o = [dot3(rows[r], p) + m[13 + r] for r in range(3)]
        local_d = [dot3(rows[r], d) for r in range(3)]
        local_slabs = prepare(ty, local_o, local_d)
        first, single = (dr.reinterpret_array(ty.UInt, m[k]) for k in (16, 17))
        limit = t - start
        found = found & (limit > 0.0)
        root = begin_at_root(ty, s.nodes, single != 0, found)
        t_new, leaf_new, u_new, v_new = search(
            s, ty, local_o, local_d, local_slabs, limit, first, root, found, any_hit
        )
        accept = found & (leaf_new != NO_LEAF)
        t = dr.select(accept, ty.Float(f64(start) + f64(t_new)), t)
        leaf, copy = dr.select(accept, leaf_new, leaf), dr.select(accept, index, copy)
        u, v = dr.select(accept, u_new, u), dr.select(accept, v_new, v)
        run = run & walk.goes_on()
        if any_hit:
            run = run & (leaf == NO_LEAF)
        return run, walk, t, leaf, u, v, copy

    zero = dr.zeros(ty.Float)
    none = ty.UInt(NO_LEAF)
    active = active & start_of_walk.goes_on()
    _run, _walk, t, leaf, u, v, copy = dr.while_loop(
        (active, start_of_walk, t_max, none, zero, zero, dr.zeros(ty.UInt)),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "walk", "t", "leaf", "u", "v", "copy"),
        label="bezier copies",
    )
    return finish(s, ty, t, leaf, u, v, active, any_hit), copy
