"""VTK's cell types: what they are called, which are read, and where their points lie.

Lattices are those of `io.lattices`, of wedges barycentric coordinates and a height, of pyramids
``i`` and ``j`` from 0 to ``n - k`` at height ``k``.

Sources: vtkCellType.h; vtkHigherOrderHexahedron and vtkHigherOrderWedge (`PointIndexFromIJK`), and
the parametric coordinates of the cells of fixed degree, as VTK 9.7 lists them.
"""

from __future__ import annotations

from functools import cache
from math import comb, isqrt

import numpy as np

from ...geometry import bernstein
from ..lattices import quad_lattice, tetra_lattice, triangle_lattice

__all__ = ["CELL_NAMES", "READ", "cell_lattice", "hexahedron_lattice", "wedge_lattice"]

#: Cell types that are read: number to (kind, are the points Bézier points).
READ = {
    5: ("triangle", False),
    22: ("triangle", False),
    34: ("triangle", False),
    69: ("triangle", False),
    76: ("triangle", True),
    8: ("quad", False),
    9: ("quad", False),
    23: ("quad", False),
    28: ("quad", False),
    30: ("quad", False),
    70: ("quad", False),
    77: ("quad", True),
    10: ("tetra", False),
    24: ("tetra", False),
    71: ("tetra", False),
    78: ("tetra", True),
    11: ("hexahedron", False),
    12: ("hexahedron", False),
    25: ("hexahedron", False),
    29: ("hexahedron", False),
    33: ("hexahedron", False),
    72: ("hexahedron", False),
    79: ("hexahedron", True),
    13: ("wedge", False),
    26: ("wedge", False),
    31: ("wedge", False),
    32: ("wedge", False),
    73: ("wedge", False),
    80: ("wedge", True),
    14: ("pyramid", False),
    27: ("pyramid", False),
    37: ("pyramid", False),
    74: ("pyramid", False),
    81: ("pyramid", True),
}

#: Names of VTK's cell types.
CELL_NAMES = {
    0: "EMPTY_CELL",
    1: "VERTEX",
    2: "POLY_VERTEX",
    3: "LINE",
    4: "POLY_LINE",
    5: "TRIANGLE",
    6: "TRIANGLE_STRIP",
    7: "POLYGON",
    8: "PIXEL",
    9: "QUAD",
    10: "TETRA",
    11: "VOXEL",
    12: "HEXAHEDRON",
    13: "WEDGE",
    14: "PYRAMID",
    15: "PENTAGONAL_PRISM",
    16: "HEXAGONAL_PRISM",
    21: "QUADRATIC_EDGE",
    22: "QUADRATIC_TRIANGLE",
    23: "QUADRATIC_QUAD",
    24: "QUADRATIC_TETRA",
    25: "QUADRATIC_HEXAHEDRON",
    26: "QUADRATIC_WEDGE",
    27: "QUADRATIC_PYRAMID",
    28: "BIQUADRATIC_QUAD",
    29: "TRIQUADRATIC_HEXAHEDRON",
    30: "QUADRATIC_LINEAR_QUAD",
    31: "QUADRATIC_LINEAR_WEDGE",
    32: "BIQUADRATIC_QUADRATIC_WEDGE",
    33: "BIQUADRATIC_QUADRATIC_HEXAHEDRON",
    34: "BIQUADRATIC_TRIANGLE",
    35: "CUBIC_LINE",
    36: "QUADRATIC_POLYGON",
    37: "TRIQUADRATIC_PYRAMID",
    42: "POLYHEDRON",
    68: "LAGRANGE_CURVE",
    69: "LAGRANGE_TRIANGLE",
    70: "LAGRANGE_QUADRILATERAL",
    71: "LAGRANGE_TETRAHEDRON",
    72: "LAGRANGE_HEXAHEDRON",
    73: "LAGRANGE_WEDGE",
    74: "LAGRANGE_PYRAMID",
    75: "BEZIER_CURVE",
    76: "BEZIER_TRIANGLE",
    77: "BEZIER_QUADRILATERAL",
    78: "BEZIER_TETRAHEDRON",
    79: "BEZIER_HEXAHEDRON",
    80: "BEZIER_WEDGE",
    81: "BEZIER_PYRAMID",
}

#: Corners of a hexahedron.
_CUBE = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def _array(rows: object) -> np.ndarray:
    out = np.array(rows, dtype=int)
    out.setflags(write=False)
    return out


@cache
def hexahedron_lattice(p: int, q: int, r: int, old: bool = False) -> np.ndarray:
    """Return the nodes of a hexahedron of degrees p, q, r, ``((p+1)(q+1)(r+1), 3)``.

    Upright edges go round, as corners do; before VTK 9.1 (files `old`) they went row by row.
    """
    ends = np.array([p, q, r])
    rows = [tuple((ends * corner).tolist()) for corner in _CUBE]
    for k in (0, r):
        rows += [(i, 0, k) for i in range(1, p)] + [(p, j, k) for j in range(1, q)]
        rows += [(i, q, k) for i in range(1, p)] + [(0, j, k) for j in range(1, q)]
    last = ((0, q), (p, q)) if old else ((p, q), (0, q))
    for i, j in ((0, 0), (p, 0), *last):
        rows += [(i, j, k) for k in range(1, r)]
    rows += [(i, j, k) for i in (0, p) for k in range(1, r) for j in range(1, q)]
    rows += [(i, j, k) for j in (0, q) for k in range(1, r) for i in range(1, p)]
    rows += [(i, j, k) for k in (0, r) for j in range(1, q) for i in range(1, p)]
    rows += [(i, j, k) for k in range(1, r) for j in range(1, q) for i in range(1, p)]
    return _array(rows)


@cache
def wedge_lattice(n: int, m: int) -> np.ndarray:
    """Return the nodes of a wedge, of degree n in its triangles and m between them."""
    corners = [(n, 0, 0), (0, n, 0), (0, 0, n)]
    rim = [(n - t, t, 0) for t in range(1, n)]
    rim += [(0, n - t, t) for t in range(1, n)]
    rim += [(t, 0, n - t) for t in range(1, n)]
    inner = [(n - i - j, i, j) for j in range(1, n) for i in range(1, n - j)]
    rows = [(*c, t) for t in (0, m) for c in corners]
    rows += [(*c, t) for t in (0, m) for c in rim]
    rows += [(*c, t) for c in corners for t in range(1, m)]
    rows += [(*c, t) for t in (0, m) for c in inner]
    for side in range(3):
        part = rim[side * (n - 1) : (side + 1) * (n - 1)]
        rows += [(*c, t) for t in range(1, m) for c in part]
    rows += [(*c, t) for t in range(1, m) for c in inner]
    return _array(rows)


#: Twice the places of quadratic hexahedra: corners, edges, faces, the middle.
_HEXA_EDGES = (
    *((1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)),
    *((0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)),
)
_HEXA_FACES = ((0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2), (1, 1, 1))
_HEXA = _array([*(tuple(2 * x for x in c) for c in _CUBE), *_HEXA_EDGES, *_HEXA_FACES])

#: Pyramids: corners, edges, then the middles of faces, which need sixths.
_PYRAMID = _array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (1, 0, 0), (2, 1, 0),
                   (1, 2, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1),
                   (1, 1, 0)])  # fmt: skip
_PYRAMID_MIDDLES = [(2, 0, 2), (4, 2, 2), (2, 4, 2), (0, 2, 2), (3, 3, 1)]
_PYRAMID_19 = _array([*(3 * _PYRAMID).tolist(), *_PYRAMID_MIDDLES])

_TRIANGLE_7 = _array([*(3 * triangle_lattice(2)).tolist(), (2, 2, 2)])
_WEDGE_21 = _array(
    [
        *(np.array([3, 3, 3, 1]) * wedge_lattice(2, 2)).tolist(),
        *((2, 2, 2, t) for t in (0, 2, 1)),
    ]
)

#: Lattices of cells of fixed degree.
_FIXED = {
    5: triangle_lattice(1),
    8: _array([(0, 0), (1, 0), (0, 1), (1, 1)]),
    9: quad_lattice(1, 1, "vtk"),
    10: tetra_lattice(1, "vtk"),
    11: _array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)]),
    12: hexahedron_lattice(1, 1, 1),
    13: wedge_lattice(1, 1),
    14: _array(_PYRAMID[:5] // 2),
    22: triangle_lattice(2),
    23: quad_lattice(2, 2, "vtk")[:8],
    24: tetra_lattice(2, "vtk"),
    25: _HEXA[:20],
    26: wedge_lattice(2, 2)[:15],
    27: _PYRAMID[:13],
    28: quad_lattice(2, 2, "vtk"),
    29: _HEXA,
    30: quad_lattice(2, 1, "vtk"),
    31: wedge_lattice(2, 1),
    32: wedge_lattice(2, 2),
    33: _HEXA[:24],
    34: _TRIANGLE_7,
    37: _PYRAMID_19,
}


def _triangular(size: int) -> int:
    n = (isqrt(8 * size + 1) - 3) // 2
    return n if n >= 1 and bernstein.size(n) == size else 0


def cell_lattice(
    number: int, size: int, degrees: tuple[int, int, int], old: bool = False
) -> np.ndarray | None:
    """Return where the points of a cell lie; None if it cannot have so many.

    Parameters
    ----------
    number : int
        One of `READ`.
    size : int
        How many points it has.
    degrees : (int, int, int)
        Its degrees, as the file gives them; zeros where it does not.
    old : bool
        As of `hexahedron_lattice`.
    """
    if number in _FIXED:
        lattice = _FIXED[number]
        return lattice if len(lattice) == size else None
    kind = READ[number][0]
    p, q, r = degrees
    if kind == "triangle":
        if size == 7 and number == 69:  # VTK's other way to say a biquadratic triangle
            return _TRIANGLE_7
        n = _triangular(size)
        return triangle_lattice(n) if n else None
    if kind == "tetra":
        n = next((n for n in range(1, 60) if comb(n + 3, 3) >= size), 0)
        return tetra_lattice(n, "vtk") if n and comb(n + 3, 3) == size else None
    if kind == "quad":
        if p < 1 or q < 1:
            if size == 8:  # without the middle node
                return quad_lattice(2, 2, "vtk")[:8]
            p = q = isqrt(size) - 1
        return quad_lattice(p, q, "vtk") if p >= 1 and (p + 1) * (q + 1) == size else None
    if kind == "hexahedron":
        if min(degrees) < 1:
            p = q = r = round(size ** (1 / 3)) - 1
        fits = min(p, q, r) >= 1 and (p + 1) * (q + 1) * (r + 1) == size
        return hexahedron_lattice(p, q, r, old) if fits else None
    if kind == "wedge":
        if size == 21 and number == 73:
            return _WEDGE_21
        if min(degrees) < 1:
            p = r = next((n for n in range(1, 60) if bernstein.size(n) * (n + 1) >= size), 0)
            q = p
        fits = p == q and bernstein.size(p) * (r + 1) == size
        return wedge_lattice(p, r) if min(p, r) >= 1 and fits else None
    # pyramids have an order in VTK up to degree 2 only
    return {5: _FIXED[14], 13: _FIXED[27], 14: _PYRAMID, 19: _PYRAMID_19}.get(size)
