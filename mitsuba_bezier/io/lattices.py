"""Node positions of high-order cells, in the orders of Gmsh and VTK.

A lattice is an integer array with one row a node, in the order of the file: barycentric
coordinates that sum to the order for triangles and tetrahedra, ``0 .. n`` along each axis for
quadrilaterals and hexahedra; of wedges barycentric coordinates and a height, of pyramids ``i`` and
``j`` from 0 to ``n - k`` at height ``k``.

Sources: the Gmsh reference manual, "Node ordering"; vtkHigherOrderTriangle,
vtkHigherOrderQuadrilateral and vtkHigherOrderTetra of VTK.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

__all__ = [
    "hexahedron_lattice",
    "pyramid_lattice",
    "quad_lattice",
    "tetra_lattice",
    "triangle_lattice",
    "wedge_lattice",
]


def _frozen(rows: list[Any]) -> np.ndarray:
    out = np.array(rows, dtype=int)
    out.setflags(write=False)
    return out


@cache
def triangle_lattice(n: int) -> np.ndarray:
    """Return the nodes of a triangle, ``(K, 3)``; Gmsh and VTK agree.

    The corners, the edges 01, 12, 20, then the interior as a triangle of order ``n - 3``.
    """
    if n == 0:
        return _frozen([(0, 0, 0)])
    rows = [(n, 0, 0), (0, n, 0), (0, 0, n)]
    rows += [(n - t, t, 0) for t in range(1, n)]
    rows += [(0, n - t, t) for t in range(1, n)]
    rows += [(t, 0, n - t) for t in range(1, n)]
    if n >= 3:
        rows += (triangle_lattice(n - 3) + 1).tolist()
    return _frozen(rows)


@cache
def quad_lattice(p: int, q: int, flavor: str) -> np.ndarray:
    """Return the nodes of a quadrilateral of orders p, q, ``((p+1)(q+1), 2)``.

    Gmsh goes round the edges and orders the interior in the same way again; VTK takes opposite
    edges in one direction and the interior row by row.
    """
    if p == 0 or q == 0:
        return _frozen([(s, t) for t in range(q + 1) for s in range(p + 1)])
    rows = [(0, 0), (p, 0), (p, q), (0, q)]
    rows += [(s, 0) for s in range(1, p)] + [(p, t) for t in range(1, q)]
    if flavor == "gmsh":
        rows += [(p - s, q) for s in range(1, p)] + [(0, q - t) for t in range(1, q)]
        if p >= 2 and q >= 2:
            rows += (quad_lattice(p - 2, q - 2, flavor) + 1).tolist()
    else:
        rows += [(s, q) for s in range(1, p)] + [(0, t) for t in range(1, q)]
        rows += [(s, t) for t in range(1, q) for s in range(1, p)]
    return _frozen(rows)


_TETRA_EDGES = {
    "gmsh": ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1)),
    "vtk": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
}
_TETRA_FACES = {
    "gmsh": ((0, 2, 1), (0, 1, 3), (0, 3, 2), (3, 1, 2)),
    "vtk": ((0, 1, 3), (2, 3, 1), (0, 3, 2), (0, 2, 1)),
}


@cache
def tetra_lattice(n: int, flavor: str) -> np.ndarray:
    """Return the nodes of a tetrahedron, ``(K, 4)``: corners, edges, faces, interior."""
    unit = np.eye(4, dtype=int)
    if n == 0:
        return _frozen([(0, 0, 0, 0)])
    rows = (n * unit).tolist()
    for a, b in _TETRA_EDGES[flavor]:
        rows += [((n - t) * unit[a] + t * unit[b]).tolist() for t in range(1, n)]
    if n >= 3:
        for face in _TETRA_FACES[flavor]:
            rows += ((triangle_lattice(n - 3) + 1) @ unit[list(face)]).tolist()
    if n >= 4:
        rows += (tetra_lattice(n - 4, flavor) + 1).tolist()
    return _frozen(rows)


_HEXA_CORNERS = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)
_HEXA_EDGES = (
    *((0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3)),
    *((2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)),
)
_HEXA_FACES = (
    *((0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 7, 3)),
    *((1, 2, 6, 5), (2, 3, 7, 6), (4, 5, 6, 7)),
)


@cache
def hexahedron_lattice(n: int) -> np.ndarray:
    """Return the nodes of Gmsh's hexahedron of order n, ``((n+1)^3, 3)``."""
    if n == 0:
        return _frozen([(0, 0, 0)])
    corners = _HEXA_CORNERS
    rows = (n * corners).tolist()
    for a, b in _HEXA_EDGES:
        rows += [((n - t) * corners[a] + t * corners[b]).tolist() for t in range(1, n)]
    if n >= 2:
        for a, b, _c, d in _HEXA_FACES:
            inner = quad_lattice(n - 2, n - 2, "gmsh") + 1
            along = inner @ np.stack([corners[b] - corners[a], corners[d] - corners[a]])
            rows += (n * corners[a] + along).tolist()
        rows += (hexahedron_lattice(n - 2) + 1).tolist()
    return _frozen(rows)


def _with_middles(
    corners: np.ndarray, edges: tuple[tuple[int, int], ...], faces: tuple[tuple[int, ...], ...]
) -> np.ndarray:
    """Return corners, and the middles of edges and faces."""
    middles = [corners[list(part)].sum(axis=0) // len(part) for part in (*edges, *faces)]
    return _frozen(np.concatenate([corners, middles]).tolist())


@cache
def wedge_lattice(n: int) -> np.ndarray:
    """Return the nodes of Gmsh's prism of order 1 or 2; 15 of the 18 make the incomplete one."""
    corners = np.array([(*row, t) for t in (0, n) for row in (n * np.eye(3, dtype=int)).tolist()])
    if n == 1:
        return _frozen(corners.tolist())
    edges = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 4), (2, 5), (3, 4), (3, 5), (4, 5))
    return _with_middles(corners, edges, ((0, 1, 4, 3), (0, 3, 5, 2), (1, 2, 5, 4)))


@cache
def pyramid_lattice(n: int) -> np.ndarray:
    """Return the nodes of Gmsh's pyramid of order 1 or 2; 13 of the 14 make the incomplete one."""
    corners = n * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)])
    if n == 1:
        return _frozen(corners.tolist())
    edges = ((0, 1), (0, 3), (0, 4), (1, 2), (1, 4), (2, 3), (2, 4), (3, 4))
    return _with_middles(corners, edges, ((0, 1, 2, 3),))
