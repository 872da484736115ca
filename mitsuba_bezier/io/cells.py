"""High-order cells as Bézier triangles: Lagrange or Bézier nodes, surfaces of volume meshes.

A Lagrange cell interpolates its nodes, which lie on a regular lattice; the Bézier points are
``inv(B) @ nodes`` with the Bernstein polynomials ``B`` at the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np

from ..geometry import bernstein
from ..geometry.trims import Trims
from .files import damaged
from .report import Collector
from .tensor_nets import tensor_nets

__all__ = ["MAX_LAGRANGE", "Cells", "add_cells", "add_surface"]

#: Highest degree of interpolated cells. A function as smooth as a sine is off by 2e-8 at degree
#: 20, by 6e-6 at 25 and 1e5 at 40: between nodes at equal distances polynomials swing.
MAX_LAGRANGE = 20


@dataclass
class Cells:
    """Cells of one kind.

    Attributes
    ----------
    kind : str
        ``"triangle"``, ``"quad"``, ``"tetra"`` or ``"hexahedron"``.
    lattice : (K, d) int array
        Where the nodes lie, see `lattices`.
    nodes : (C, K) int array
        Rows of the points.
    bezier : bool
        The points are Bézier points, not interpolated nodes.
    copies : (C,) bool array, optional
        Volume cells that show no faces, but stand before those of others.
    """

    kind: str
    lattice: np.ndarray
    nodes: np.ndarray
    bezier: bool = False
    copies: np.ndarray | None = None


def _univariate(n: int, t: np.ndarray) -> np.ndarray:
    """Return the Bernstein polynomials of degree n at t, ``(N, n+1)``."""
    i = np.arange(n + 1)
    return np.array([comb(n, k) for k in i]) * t[:, None] ** i * (1 - t[:, None]) ** (n - i)


@lru_cache(maxsize=64)
def _order(kind: str, lattice: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """Return the nodes of the file in our order; for quadrilaterals t runs fastest."""
    index = np.array(lattice)
    if kind == "triangle":
        return np.lexsort((-index[:, 1], -index[:, 0]))
    return np.lexsort((index[:, 1], index[:, 0]))


@lru_cache(maxsize=16)
def _matrix(kind: str, lattice: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """Return the matrix from interpolated nodes, in the order of the file, to Bézier points."""
    index = np.array(lattice)
    if kind == "triangle":
        n = int(index[0].sum())
        basis = bernstein.basis(n, index[:, :2] / n)
    else:
        p, q = index.max(axis=0).tolist()
        if len(index) == 8 and p == q == 2:  # serendipity: the middle node follows
            return _matrix(kind, (*lattice, (1, 1))) @ _SERENDIPITY
        bu, bv = _univariate(p, index[:, 0] / p), _univariate(q, index[:, 1] / q)
        basis = (bu[:, :, None] * bv[:, None, :]).reshape(len(index), -1)
    return np.linalg.inv(basis)


#: The eight-node quadrilateral lacks the term s^2 t^2: corners weigh -1/4, edges 1/2.
_SERENDIPITY = np.concatenate([np.eye(8), [[-0.25] * 4 + [0.5] * 4]])


def add_cells(
    collector: Collector,
    cells: Cells,
    points: np.ndarray,
    sources: np.ndarray,
    trims: Trims | None = None,
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
        size = len(lattice)
    collector.expect(size * len(cells.nodes))
    if cells.bezier:
        nets = points[cells.nodes[:, _order(cells.kind, lattice)]]
    else:
        nets = _matrix(cells.kind, lattice) @ points[cells.nodes]
        nets[..., 3] = 1.0  # all weights are 1; the rounding of inv(B) has no place in them
    if cells.kind == "quad":
        p, q = degrees
        nets = tensor_nets(nets.reshape(-1, p + 1, q + 1, 4))
        sources = np.repeat(sources, 2)
    collector.add(nets, sources, trims)
    collector.report.accept(len(cells.nodes))


#: Outward faces of a tetrahedron: the corner that is missing, and the three in order.
_TETRA_OUTWARD = {3: (0, 2, 1), 2: (0, 1, 3), 0: (1, 2, 3), 1: (0, 3, 2)}


def _faces(cells: Cells) -> list[Cells]:
    """Return the faces of volume cells, normals pointing outward, in the order of the cells."""
    out = []
    lattice = cells.lattice
    if cells.kind == "tetra":
        for missing, corners in _TETRA_OUTWARD.items():
            on = lattice[:, missing] == 0
            out.append(
                Cells(
                    "triangle",
                    lattice[on][:, corners],
                    cells.nodes[:, on],
                    cells.bezier,
                    cells.copies,
                )
            )
    else:
        n = int(lattice.max())
        for axis in range(3):
            first, second = (axis + 1) % 3, (axis + 2) % 3
            for side, axes in ((n, (first, second)), (0, (second, first))):
                on = lattice[:, axis] == side
                out.append(
                    Cells(
                        "quad", lattice[on][:, axes], cells.nodes[:, on], cells.bezier, cells.copies
                    )
                )
    return out


def _corner_keys(cells: Cells) -> np.ndarray:
    """Return the sorted corner nodes of each face, ``(C, 4)``; -1 fills up triangles."""
    n = cells.lattice.max()
    if cells.kind == "triangle":
        corners = cells.nodes[:, (cells.lattice == n).any(axis=1)]
    else:
        ends = (cells.lattice == 0) | (cells.lattice == cells.lattice.max(axis=0))
        corners = cells.nodes[:, ends.all(axis=1)]
    keys = np.full((len(corners), 4), -1)
    keys[:, : corners.shape[1]] = np.sort(corners, axis=1)
    return keys


def add_surface(
    collector: Collector,
    volumes: list[Cells],
    surfaces: list[Cells],
    points: np.ndarray,
    first: int,
) -> None:
    """Convert the faces that belong to one volume cell only: the surface of a volume mesh.

    Parameters
    ----------
    collector : Collector
        Where they go.
    volumes : list of Cells
        Of kind ``"tetra"`` or ``"hexahedron"``.
    surfaces : list of Cells
        Triangles and quadrilaterals that are in the file themselves: where one of them lies on
        the surface, it is not converted twice.
    points : (N, 4) array
        Homogeneous points.
    first : int
        The number the first face gets.
    """
    faces = [face for cells in volumes for face in _faces(cells)]
    if not faces:
        return
    keys = np.concatenate([_corner_keys(face) for face in faces])
    _unique, inverse, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    outer = count[inverse.ravel()] == 1
    outer &= ~np.concatenate(
        [np.zeros(len(f.nodes), bool) if f.copies is None else f.copies for f in faces]
    )
    if surfaces:
        given = np.concatenate([_corner_keys(cells) for cells in surfaces])
        both = np.concatenate([given, keys])
        _unique, index, inverse = np.unique(both, axis=0, return_index=True, return_inverse=True)
        outer &= index[inverse.ravel()[len(given) :]] >= len(given)
    numbers = first + np.cumsum(outer) - 1
    start = 0
    for face in faces:
        here = slice(start, start + len(face.nodes))
        start = here.stop
        chosen = outer[here]
        if chosen.any():
            part = Cells(face.kind, face.lattice, face.nodes[chosen], face.bezier)
            add_cells(collector, part, points, numbers[here][chosen])
    cells = sum(len(v.nodes) for v in volumes)
    collector.report.remarks.append(
        f"the surface of {cells} volume cells: {outer.sum()} faces that belong to one cell only"
    )
