"""BezierView's ``.bv`` files: polyhedra, triangular and tensor-product patches.

Kinds read: 1 polyhedron, 3 triangle, 4 and 5 tensor product, 8 rational tensor product,
9 and 10 triangle and tensor product with normals of their own (which are not used).

Source: "BezierViewer Data Format", https://www.cise.ufl.edu/research/SurfLab/bview/FORMAT.txt
"""

from __future__ import annotations

from functools import cache
from math import comb
from os import PathLike

import numpy as np

from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from .files import damaged, write_bytes
from .polygon_faces import PolygonFaces
from .report import Collector, Model
from .tensor_nets import homogeneous, tensor_nets
from .text import Tokens

__all__ = ["read", "triangle_order", "write"]

#: BezierView's own limit.
MAX_DEGREE = 40

_KINDS = {1: "polyhedron", 3: "triangle", 4: "tensor", 5: "tensor", 8: "rational tensor"}
_KINDS |= {9: "triangle with normals", 10: "tensor with normals"}


@cache
def triangle_order(n: int) -> np.ndarray:
    """Return the rows of our net in the order of the file, ``(K,)`` integers.

    The file goes along the edge from corner ``(n,0,0)`` to ``(0,n,0)``, then row by row
    towards ``(0,0,n)``.
    """
    return np.array(
        [bernstein.row(n, n - j - k, j) for k in range(n + 1) for j in range(n - k + 1)]
    )


def read(path: str | PathLike[str]) -> Model:
    """Read a ``.bv`` file.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, of an unknown kind, or holds no face.
    """
    tokens = Tokens(path)
    collector = Collector(path, "bv")
    # patches of one kind and degree are converted together
    tensors: dict[tuple[int, int], list[tuple[int, np.ndarray]]] = {}
    triangles: dict[int, list[tuple[int, np.ndarray]]] = {}
    polygons = PolygonFaces()
    normals = False
    face = 0
    while len(tokens):
        if tokens.peek() in ("group", "Group"):
            line = tokens.line()
            tokens.skip_line(line)  # colour, name, "#" and a level of subdivision
            continue
        kind = tokens.integer("the kind of a patch", 0, 99)
        if kind == 1:
            face = _read_polyhedron(tokens, polygons, face)
            continue
        if kind in (3, 9):
            n = tokens.integer("a degree", 1, MAX_DEGREE)
            m = tokens.integer("a degree of normals", 0, MAX_DEGREE) if kind == 9 else None
            points = tokens.numbers(3 * bernstein.size(n), f"patch {face}")
            triangles.setdefault(n, []).append((face, points))
            if m is not None:
                tokens.numbers(3 * bernstein.size(m), f"the normals of patch {face}")
        elif kind in (4, 5, 8, 10):
            p = tokens.integer("a degree", 1, MAX_DEGREE)
            q = p if kind == 4 else tokens.integer("a degree", 1, MAX_DEGREE)
            if kind == 10:
                pn = tokens.integer("a degree of normals", 0, MAX_DEGREE)
                qn = tokens.integer("a degree of normals", 0, MAX_DEGREE)
            dim = 4 if kind == 8 else 3
            points = tokens.numbers(dim * (p + 1) * (q + 1), f"patch {face}").reshape(-1, dim)
            if dim == 3:
                points = homogeneous(points)
            tensors.setdefault((p, q), []).append((face, points))
            if kind == 10:
                tokens.numbers(3 * (pn + 1) * (qn + 1), f"the normals of patch {face}")
        else:
            known = ", ".join(f"{k} ({name})" for k, name in _KINDS.items())
            raise tokens.error(f"a kind of patch out of {known}", kind, back=1)
        normals |= kind in (9, 10)
        collector.report.accept()
        face += 1
    polygons.convert(collector)
    for n, found in triangles.items():
        points = np.array([net for _face, net in found]).reshape(len(found), -1, 3)
        nets = np.empty((*points.shape[:2], 4))
        nets[:, triangle_order(n)] = homogeneous(points)
        collector.add(nets, np.array([face for face, _net in found]))
    for (p, q), found in tensors.items():
        tensor = np.array([net for _face, net in found]).reshape(-1, p + 1, q + 1, 4)
        collector.expect(2 * bernstein.size(p + q) * len(found))
        collector.add(tensor_nets(tensor), np.repeat([face for face, _net in found], 2))
    if normals:
        collector.report.notes.append(
            "the normals of kinds 9 and 10 are not used: shading follows the true surface"
        )
    return collector.model(lambda: damaged(path, "at least one patch", "none"))


def _read_polyhedron(tokens: Tokens, polygons: PolygonFaces, first: int) -> int:
    """Read the faces of a polyhedron; `first` is the number of its first face.

    Returns
    -------
    int
        The number of the face that follows.
    """
    limit = len(tokens)
    vertices = tokens.integer("the number of vertices", 1, limit)
    faces = tokens.integer("the number of faces", 0, limit)
    points = homogeneous(tokens.numbers(3 * vertices, "the vertices").reshape(-1, 3))
    for face in range(first, first + faces):
        size = tokens.integer("the number of corners of a face", 1, limit)
        index = [tokens.integer("a vertex of a face", 0, vertices - 1) for _ in range(size)]
        polygons.add(face, points[index])
    return first + faces


def write(triangles: BezierTriangles | list[BezierTriangles], path: str | PathLike[str]) -> None:
    """Write patches as a ``.bv`` file.

    Polynomial nets (all weights equal) become triangles, kind 3. The format has no rational
    triangles: those become rational tensor-product patches, kind 8, with one edge collapsed to
    the corner ``(n,0,0)``; the surface is the same, to the last bit of rounding.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    groups = [triangles] if isinstance(triangles, BezierTriangles) else list(triangles)
    lines = []
    for group in groups:
        n = group.degree
        for net in group.control_points:
            weight = net[0, 3]
            if weight != 0 and (net[:, 3] == weight).all():
                lines += ["3", str(n)]
                rows = (net[:, :3] / weight)[triangle_order(n)]
            else:
                lines += ["8", f"{n} {n}"]
                rows = _collapsed(net, n)
            lines += [" ".join(map(repr, row)) for row in rows.tolist()]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _collapsed(net: np.ndarray, n: int) -> np.ndarray:
    """Return the net as a tensor-product net of degree ``(n, n)``, row-major.

    With ``(u, v, w) = (1 - s, s (1 - t), s t)`` row i of the tensor net is the i-th row of the
    triangle, a curve of degree i in t, elevated to degree n.
    """
    rows = []
    for i in range(n + 1):
        curve = np.array([net[bernstein.row(n, n - i, i - j)] for j in range(i + 1)])
        elevation = np.array(
            [
                [
                    comb(i, j) * comb(n - i, k - j) / comb(n, k) if k >= j else 0.0
                    for j in range(i + 1)
                ]
                for k in range(n + 1)
            ]
        )
        rows.append(elevation @ curve)
    return np.concatenate(rows)
