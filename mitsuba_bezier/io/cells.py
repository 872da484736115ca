"""High-order cells as Bézier triangles, with the fields on them: Lagrange or Bézier nodes.

A Lagrange cell interpolates its nodes, which lie on a lattice; the Bézier points are
``inv(B) @ nodes`` with the Bernstein polynomials ``B`` at the lattice. A field is converted in the
same way, with nodes of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from math import comb

import numpy as np

from ..geometry import bernstein
from ..geometry.fields import BezierField
from ..geometry.tensor import tensor_matrices
from ..geometry.trims import Trims
from .files import damaged
from .report import Collector
from .tensor_nets import tensor_nets

__all__ = ["MAX_LAGRANGE", "CellField", "Cells", "add_cells"]

#: Highest degree of interpolated cells. A function as smooth as a sine is off by 2e-8 at degree
#: 20, by 6e-6 at 25 and 1e5 at 40: between nodes at equal distances polynomials swing.
MAX_LAGRANGE = 20


@dataclass
class CellField:
    """A field on cells of one kind: what their nodes hold, as `Cells` does for points.

    Attributes
    ----------
    lattice : (K, d) int array
        Where its nodes lie. One row of zeros: a constant on each cell.
    nodes : (C, K) int array
        Rows of `values`.
    values : (N, c) array
    weights : (N,) array, optional
        Of Bézier cells: the values are quotients with these weights.
    bezier : bool
        The values are Bernstein ordinates, not interpolated.
    spacing : tuple of float, optional
        As of `Cells`.
    unit : str
    """

    lattice: np.ndarray
    nodes: np.ndarray
    values: np.ndarray
    weights: np.ndarray | None = None
    bezier: bool = False
    spacing: tuple[float, ...] | None = None
    unit: str = ""


@dataclass
class Cells:
    """Cells of one kind.

    Attributes
    ----------
    kind : str
        ``"triangle"``, ``"quad"``, ``"tetra"``, ``"hexahedron"``, ``"wedge"`` or ``"pyramid"``.
    lattice : (K, d) int array
        Where the nodes lie, see `lattices`.
    nodes : (C, K) int array
        Rows of the points.
    bezier : bool
        The points are Bézier points, not interpolated nodes.
    copies : (C,) bool array, optional
        Volume cells that show no faces, but stand before those of others.
    spacing : tuple of float, optional
        Where the nodes of an edge lie, from 0 to 1 (default: at equal distances).
    fields : dict of CellField
    """

    kind: str
    lattice: np.ndarray
    nodes: np.ndarray
    bezier: bool = False
    copies: np.ndarray | None = None
    spacing: tuple[float, ...] | None = None
    fields: Mapping[str, CellField] = field(default_factory=dict)


_Lattice = tuple[tuple[int, ...], ...]


def _univariate(n: int, t: np.ndarray) -> np.ndarray:
    """Return the Bernstein polynomials of degree n at t, ``(N, n+1)``."""
    i = np.arange(n + 1)
    return np.array([comb(n, k) for k in i]) * t[:, None] ** i * (1 - t[:, None]) ** (n - i)


@lru_cache(maxsize=64)
def _order(kind: str, lattice: _Lattice) -> np.ndarray:
    """Return the nodes of the file in our order; for quadrilaterals t runs fastest."""
    index = np.array(lattice)
    if kind == "triangle":
        return np.lexsort((-index[:, 1], -index[:, 0]))
    return np.lexsort((index[:, 1], index[:, 0]))


@lru_cache(maxsize=64)
def _matrix(kind: str, lattice: _Lattice, spacing: tuple[float, ...] | None) -> np.ndarray:
    """Return the matrix from interpolated nodes, in the order of the file, to Bézier points."""
    index = np.array(lattice)
    if len(index) == 1:
        return np.ones((1, 1))
    if kind == "triangle":
        n = int(index[0].sum())
        if len(index) == 7:
            return _bubble_matrix(index)
        places = index[:, :2] / n
        if spacing is not None:  # as MFEM has them: those of the edges, brought to a sum of one
            at = np.array(spacing)[index]
            places = (at / at.sum(axis=1, keepdims=True))[:, :2]
        basis = bernstein.basis(n, places)
    else:
        p, q = index.max(axis=0).tolist()
        if len(index) == 8 and p == q == 2:  # serendipity: the middle node follows
            return _matrix(kind, (*lattice, (1, 1)), spacing) @ _SERENDIPITY
        s, t = index[:, 0] / p, index[:, 1] / q
        if spacing is not None:
            s, t = np.array(spacing)[index].T
        bu, bv = _univariate(p, s), _univariate(q, t)
        basis = (bu[:, :, None] * bv[:, None, :]).reshape(len(index), -1)
    return np.linalg.inv(basis)


def _bubble_matrix(index: np.ndarray) -> np.ndarray:
    """Return the matrix of a triangle of six nodes and its middle: a cubic with a bubble.

    The bubble ``27 u v w`` is 4.5 B_111, and takes what the quadratic lacks in the middle.
    """
    quadratic = bernstein.elevation_matrix(2) @ _matrix(
        "triangle", tuple(map(tuple, (index[:6] // 3).tolist())), None
    )
    out = np.concatenate([quadratic, np.zeros((10, 1))], axis=1)
    middle = bernstein.basis(3, np.full((1, 2), 1 / 3)) @ out
    out[bernstein.row(3, 1, 1)] += 4.5 * (np.eye(7)[6] - middle[0])
    return out


#: The eight-node quadrilateral lacks the term s^2 t^2: corners weigh -1/4, edges 1/2.
_SERENDIPITY = np.concatenate([np.eye(8), [[-0.25] * 4 + [0.5] * 4]])


def add_cells(
    collector: Collector,
    cells: Cells,
    points: np.ndarray,
    sources: np.ndarray,
    trims: Trims | None = None,
    *,
    edges: np.ndarray | None = None,
    faces: int | None = None,
) -> None:
    """Convert triangles or quadrilaterals and enter them in the report.

    Parameters
    ----------
    collector : Collector
        Where they go.
    cells : Cells
        Of kind ``"triangle"`` or ``"quad"``.
    points : (N, 4) array
        Homogeneous points; those of Lagrange cells have weight 1.
    sources : (C,) int array
        Numbers of the faces in the file.
    trims : Trims, optional
        Of triangles.
    edges : (C, 3) bool array, optional
        Whether sides of triangles are sides of faces; see `Model`.
    faces : int, optional
        How many faces they are, if triangles are pieces of faces.
    """
    lattice = tuple(map(tuple, cells.lattice.tolist()))
    degrees = cells.lattice.max(axis=0).tolist()
    nodes = cells.nodes
    if nodes.ndim != 2 or nodes.shape[1] != len(lattice):
        raise damaged(
            collector.report.path,
            f"{len(lattice)} nodes in each {cells.kind}",
            f"an array of shape {nodes.shape}",
        )
    if nodes.size and not (nodes.min() >= 0 and nodes.max() < len(points)):
        raise damaged(
            collector.report.path,
            f"cells of the {len(points)} nodes that the file has",
            f"node {int(nodes.max() if nodes.max() >= len(points) else nodes.min())}",
        )
    if cells.kind == "quad":
        size = 2 * bernstein.size(sum(degrees))
    else:
        size = max(len(lattice), 10 * (len(lattice) == 7))
    collector.expect(size * len(nodes))
    for name, own in cells.fields.items():
        wide = own.values.shape[1] + (own.weights is not None)
        collector.expect(-(-_size(cells.kind, own.lattice) * wide // 4) * len(nodes), name)
    if cells.bezier:
        nets = points[nodes[:, _order(cells.kind, lattice)]]
    else:
        nets = _matrix(cells.kind, lattice, cells.spacing) @ points[nodes]
        nets[..., 3] = 1.0  # all weights are 1; the rounding of inv(B) has no place in them
    if cells.kind == "quad":
        p, q = degrees
        nets = tensor_nets(nets.reshape(-1, p + 1, q + 1, 4))
        sources = np.repeat(sources, 2)
        edges = np.tile([True, True, False], (len(nets), 1))
    fields = {name: _ordinates(name, cells.kind, own) for name, own in cells.fields.items()}
    collector.add(nets, sources, trims, fields, edges)
    collector.report.accept(len(nodes) if faces is None else faces)


def _size(kind: str, lattice: np.ndarray) -> int:
    """Return how many ordinates a field has on a cell."""
    if kind == "quad":
        return 2 * bernstein.size(int(lattice.max(axis=0).sum()))
    return max(len(lattice), 10 * (len(lattice) == 7))


def _ordinates(name: str, kind: str, own: CellField) -> BezierField:
    """Convert a field on triangles or quadrilaterals."""
    lattice = tuple(map(tuple, own.lattice.tolist()))
    values = own.values
    if own.weights is not None:
        values = np.concatenate([values * own.weights[:, None], own.weights[:, None]], axis=1)
    if own.bezier:
        out = values[own.nodes[:, _order(kind, lattice)]]
    else:
        out = _matrix(kind, lattice, own.spacing) @ values[own.nodes]
    if kind == "quad":
        p, q = own.lattice.max(axis=0).tolist()
        if p == q == 0:
            out = np.repeat(out, 2, axis=0)
        else:
            both = np.stack([matrix @ out for matrix in tensor_matrices(p, q)], axis=1)
            out = both.reshape(2 * len(out), -1, out.shape[2])
    if own.weights is None:
        return BezierField(name, out, None, own.unit)
    return BezierField(name, out[..., :-1], out[..., -1], own.unit)
