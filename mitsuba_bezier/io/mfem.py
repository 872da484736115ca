"""MFEM's meshes (``.mesh``, v1.0 to v1.3, and NURBS meshes v1.0), with grid functions (``.gf``).

Nodes and grid functions are H1 of any order, at Gauss-Lobatto or equal distances or by Bernstein
polynomials, L2, or NURBS. Of volume meshes the faces of one element only are shown.

Sources: "MFEM mesh formats", https://mfem.org/mesh-formats; fem/geom.cpp for the order of edges and
faces, fem/fe/fe_h1.cpp and fe_l2.cpp for that of nodes, mesh/nurbs.hpp for that of control points.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from .cells import MAX_LAGRANGE, CellField, Cells, add_cells
from .files import damaged, read_bytes
from .mfem_spaces import Space, read_space
from .mfem_topology import Topology
from .report import Collector, Model
from .tensor_nets import homogeneous
from .text import Tokens

__all__ = ["is_mfem", "read", "read_any"]

_HEAD = re.compile(rb"\s*MFEM (NURBS )?(NC |INLINE |NC-patch )?mesh v(1\.[0-9]+)")


def is_mfem(path: str | PathLike[str]) -> bool:
    """Return whether a file says that it is a mesh of MFEM."""
    return b"MFEM" in read_bytes(path)[:16]


def read_any(
    path: str | PathLike[str], fields: bool | Sequence[str | PathLike[str]] = False
) -> Model:
    """Read a ``.mesh`` file, of MFEM or of Medit (see `meshes`)."""
    if is_mfem(path):
        return read(path, fields)
    if not isinstance(fields, bool):
        raise damaged(path, "a mesh of MFEM, for grid functions", "another")
    from .meshes import read as read_medit

    return read_medit(path)


def read(path: str | PathLike[str], fields: bool | Sequence[str | PathLike[str]] = False) -> Model:
    """Read a mesh.

    Parameters
    ----------
    path : path
        The file.
    fields : bool or sequence of path
        Whether attributes of elements are read as a field; or files of grid functions, which become
        fields, too, of the names of their files.

    Raises
    ------
    FileFormatError
        If a file is missing, damaged, or of another kind.
    """
    head = _HEAD.match(read_bytes(path)[:200])
    if not head:
        raise damaged(path, "MFEM mesh v1.x or MFEM NURBS mesh v1.0", "another header", line=1)
    nurbs, kind, version = head[1], (head[2] or b"").decode().strip(), head[3].decode()
    if kind:
        what = f"an {kind} mesh"
        if kind != "INLINE":
            what += ", which has elements of several levels side by side"
        raise damaged(path, "MFEM mesh v1.x or MFEM NURBS mesh v1.0", what, line=1)
    if nurbs and version != "1.0":
        raise damaged(path, "MFEM NURBS mesh v1.0", f"v{version}", line=1)
    tokens = Tokens(path)
    for _ in range(4 if nurbs else 3):
        tokens.word("the header")
    collector = Collector(path, "mfem")
    topology = Topology(tokens, bool(nurbs))
    functions = [] if isinstance(fields, bool) else list(fields)
    if nurbs:
        from .mfem_nurbs import add_nurbs

        add_nurbs(collector, topology, tokens, functions, fields is not False)
    else:
        _add_mesh(collector, topology, tokens, functions, fields is not False)
    return collector.model(lambda: damaged(path, "elements with a surface", "none in this file"))


def _add_mesh(
    collector: Collector,
    topology: Topology,
    tokens: Tokens,
    functions: Sequence[str | PathLike[str]],
    fields: bool,
) -> None:
    path = tokens.path
    count = topology.read_vertices(tokens)
    if tokens.peek() == "nodes":
        tokens.word("nodes")
        space = read_space(tokens)
        points, width = space.values, space.components
    else:
        width = tokens.integer("the dimension of space", 1, 3)
        values = tokens.numbers(width * count, "vertices").reshape(count, width)
        space = Space("H1", 1, topology.dimension, "G", width, values)
        points = values
    for word in ("mfem_mesh_end", ""):
        if tokens.peek() not in (word, ""):
            left = tokens.peek()[:40]
            if left in ("vertex_parents", "coarse_elements"):
                raise damaged(path, "a conforming mesh", f"one with {left}")
            collector.report.remarks.append(f"what follows {left!r} is not used")
            break
    if space.kind not in ("H1", "L2"):
        raise damaged(path, "nodes of H1 or L2", space.name)
    net = homogeneous(np.pad(points, ((0, 0), (0, 3 - width))))
    others = []
    for file in functions:
        own = read_space(Tokens(file), file=True)
        if own.kind not in ("H1", "L2"):
            raise damaged(file, "a grid function of H1 or L2", own.name)
        others.append((Path(file).stem, own))
    shown = topology.shown(space)
    size = topology.size(space)
    if len(points) != size:
        raise damaged(path, f"{size} nodes of {space.name}", len(points))
    for name, own in others:
        if len(own.values) != topology.size(own):
            raise damaged(name, f"{topology.size(own)} values of {own.name}", len(own.values))
    first = 0
    for kind, elements, faces in shown:
        if space.order > MAX_LAGRANGE:
            raise damaged(path, f"nodes of an order up to {MAX_LAGRANGE}", space.order)
        lattice, nodes = topology.nodes(space, kind, elements, faces)
        found: dict[str, CellField] = {}
        if fields:
            zero = 0 * lattice[:1]
            attribute = topology.attributes.astype(np.float64)[:, None]
            found["attribute"] = CellField(zero, elements[:, None], attribute)
        for name, own in others:
            at, rows = topology.nodes(own, kind, elements, faces)
            found[name] = CellField(at, rows, own.values, None, own.basis == "P", own.spacing(kind))
        part = Cells(kind, lattice, nodes, space.basis == "P", None, space.spacing(kind), found)
        sources = first + np.arange(len(nodes))
        first += len(nodes)
        add_cells(collector, part, net, sources)
    for number, name in ((0, "point"), (1, "segment")):
        if count := int((topology.geometry == number).sum()):
            collector.report.remarks.append(f"{count} elements of type {name}")
