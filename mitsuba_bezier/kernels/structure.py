"""The buffers a traversal reads: tree nodes, leaf records, leaf nets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..geometry import bernstein
from ..geometry.leaves import Leaves
from ..geometry.tree import build_tree
from .arrays import types_of, upload

__all__ = ["NODE", "RECORD", "Structure", "build_structure"]

#: Floats in a tree node: lower corner, upper corner, skip, leaf (the last two as bits).
NODE = 8
#: Floats in a leaf record: shift 3, height bound, frame 16, form 10, patch, flags (as bits).
RECORD = 32

FLAG_EXACT = 1


@dataclass
class Structure:
    """All leaves of a scene under one tree, on the device of one array type."""

    nodes: Any  #: Float32, 8 octants x N nodes x `NODE`
    node_count: Any  #: N, opaque: kernels do not depend on it
    records: Any  #: Float32, L x `RECORD`
    nets: Any  #: Float32, L x K*4, each padded to packets of eight
    degree: int  #: degree of `nets`; lower degrees are padded with zero monomials
    domain: Any  #: Float32, L x 16: nine entries of the leaf-to-patch map, shift 3
    forms: Any  #: Float64, L x 16: the quadric of exact leaves, ten entries
    has_exact: bool
    has_graph: bool
    projective: bool  #: some chart is not affine
    leaf_count: int
    bytes: int


def build_structure(leaves: Leaves, like: Any) -> Structure:
    """Pack `leaves` for the array types of `like` (a Dr.Jit float array or type)."""
    ty = types_of(like)
    count = len(leaves)
    boxes = _padded(leaves.box)
    bounds, skip, leaf = build_tree(boxes)
    n_nodes = skip.shape[1]
    nodes = np.zeros((8, n_nodes, NODE), dtype=np.float32)
    nodes[..., 0:3] = bounds[:, :, 0]
    nodes[..., 3:6] = bounds[:, :, 1]
    base = np.arange(8, dtype=np.uint32)[:, None] * np.uint32(n_nodes)
    nodes[..., 6] = (skip + base).astype(np.uint32).view(np.float32)
    nodes[..., 7] = leaf.view(np.float32)

    records = np.zeros((count, RECORD), dtype=np.float32)
    records[:, 0:3] = leaves.shift
    records[:, 3] = _height(leaves)
    records[:, 4:20] = leaves.frame.reshape(count, 16)
    records[:, 20:30] = leaves.form[:, :10]
    records[:, 30] = leaves.patch.astype(np.uint32).view(np.float32)
    flags = np.where(leaves.exact, FLAG_EXACT, 0).astype(np.uint32)
    records[:, 31] = flags.view(np.float32)

    domain = np.zeros((count, 16), dtype=np.float32)
    domain[:, :9] = leaves.domain.reshape(count, 9)
    forms = np.zeros((count, 16))
    forms[:, :10] = leaves.form[:, :10]
    forms[:, 10:13] = leaves.shift

    graph = ~leaves.exact
    width = leaves.net.shape[1] * 4
    padded = -(-width // 8) * 8
    nets = np.zeros((count if graph.any() else 1, padded), dtype=np.float32)
    if graph.any():
        nets[:, :width] = leaves.net.reshape(count, width)
    affine = (leaves.frame[graph, 3] == (0.0, 0.0, 0.0, 1.0)).all()
    arrays = (nodes, records, nets, domain, forms)
    return Structure(
        nodes=upload(ty.Float32, nodes),
        node_count=dr.opaque(ty.UInt, n_nodes),
        records=upload(ty.Float32, records),
        nets=upload(ty.Float32, nets),
        degree=bernstein.degree_of(leaves.net.shape[1]),
        domain=upload(ty.Float32, domain),
        forms=upload(ty.Float64, forms),
        has_exact=bool(leaves.exact.any()),
        has_graph=bool(graph.any()),
        projective=not bool(affine),
        leaf_count=count,
        bytes=sum(a.nbytes for a in arrays),
    )


def _padded(box: np.ndarray) -> np.ndarray:
    """Grow boxes by what float32 may lose of their faces, their size and the slab test."""
    finite = np.where(np.isfinite(box), box, 0.0)
    pad = 4e-7 * np.abs(finite).max(axis=1, keepdims=True)
    pad = pad + 1e-6 * np.abs(finite[:, 1:] - finite[:, :1]).max(axis=2, keepdims=True)
    return np.concatenate([box[:, :1] - pad, box[:, 1:] + pad], axis=1)


def _height(leaves: Leaves) -> np.ndarray:
    """Return a bound on ``|z|`` over each graph leaf, from its stored quadratic."""
    quadratic = np.abs(leaves.form[:, :3]).sum(axis=1)
    grown = 0.25 * quadratic * (1 + 3 * leaves.form[:, 6]) ** 2 + leaves.form[:, 3]
    return np.where(leaves.exact, 0.0, 1.01 * grown + 1e-6)
