"""Quadratic meshes of other programs through meshio (the extra ``[mesh]``).

Abaqus ``.inp``, Nastran ``.bdf`` and ``.nas``, Medit ``.mesh``. Gmsh and VTK files have readers
of their own here, which know all orders and need no other package.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .._files import temporary_folder, write_file
from ..errors import FileFormatError
from .cells import Cells, add_cells
from .files import damaged, read_text
from .isolated import read_isolated
from .lattices import hexahedron_lattice, quad_lattice, tetra_lattice, triangle_lattice
from .mesh_text import prepared
from .report import Collector, Model
from .tensor_nets import homogeneous
from .volume_faces import add_surface

__all__ = ["import_library", "read", "read_here"]

#: meshio's cell types, whose nodes are in the order of VTK: kind and lattice.
_TYPES: dict[str, tuple[str, np.ndarray]] = {
    "triangle": ("triangle", triangle_lattice(1)),
    "triangle6": ("triangle", triangle_lattice(2)),
    "quad": ("quad", quad_lattice(1, 1, "vtk")),
    "quad8": ("quad", quad_lattice(2, 2, "vtk")[:8]),
    "quad9": ("quad", quad_lattice(2, 2, "vtk")),
    "tetra": ("tetra", tetra_lattice(1, "vtk")),
    "tetra10": ("tetra", tetra_lattice(2, "vtk")),
    "hexahedron": ("hexahedron", hexahedron_lattice(1)),
}

#: The edges of VTK's 20-node hexahedron, as pairs of corners.
_HEXA_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_CORNERS = 2 * hexahedron_lattice(1)
_TYPES["hexahedron20"] = (
    "hexahedron",
    np.concatenate([_CORNERS, [(_CORNERS[a] + _CORNERS[b]) // 2 for a, b in _HEXA_EDGES]]),
)


def read(path: str | PathLike[str]) -> Model:
    """Read a mesh in a process of its own (see `isolated`).

    Raises
    ------
    FileFormatError
        If meshio is not installed, the file is missing or damaged, or holds no surface.
    """
    return read_isolated("meshes", path)


def read_here(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read a mesh in this process; no mesh has `trims`."""
    text = read_text(path)
    meshio = import_library()
    collector = Collector(path, "mesh")
    suffix = Path(path).suffix.lower()
    readers = {".inp": "abaqus", ".mesh": "medit"}
    text = prepared(path, suffix, text, collector.report)
    with temporary_folder() as folder:
        copy = Path(folder) / f"mesh{suffix}"
        write_file(copy, text.encode("ascii", "replace"))
        try:
            mesh = getattr(meshio, readers.get(suffix, "nastran")).read(str(copy))
        except MemoryError:
            raise
        except (Exception, SystemExit) as error:  # meshio ends the program on some bad files
            lines = str(error).splitlines()
            reason = f"{type(error).__name__}: {lines[0] if lines else ''}"
            raise damaged(path, "a file that meshio can read", reason[:200]) from None
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise damaged(path, "a mesh with points", "none")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    surfaces: list[Cells] = []
    volumes: list[Cells] = []
    for block in mesh.cells:
        nodes = np.asarray(block.data)
        if block.type == "vertex" or block.type.startswith("line"):
            collector.report.remarks.append(f"{len(nodes)} cells of type {block.type}")
        elif block.type not in _TYPES:
            collector.report.refuse(f"cells of type {block.type}", "not supported", len(nodes))
        elif ((nodes < 0) | (nodes >= len(points))).any():
            raise damaged(path, f"nodes from 0 to {len(points) - 1}", "others")
        else:
            kind, lattice = _TYPES[block.type]
            (surfaces if kind in ("triangle", "quad") else volumes).append(
                Cells(kind, lattice, nodes)
            )
    net = homogeneous(points)
    for cells in surfaces:
        source = collector.report.faces + np.arange(len(cells.nodes))
        add_cells(collector, cells, net, source)
    add_surface(collector, volumes, surfaces, net, collector.report.faces)
    return collector.model(lambda: damaged(path, "surface elements", "none in this file"))


def import_library() -> Any:
    """Return meshio, or raise `FileFormatError` with how to install it."""
    try:
        import meshio
    except ImportError as error:
        raise FileFormatError.expected(
            "path",
            "a file that can be read",
            f"a mesh, which needs meshio ({error}): pip install 'mitsuba-bezier[mesh]'",
        ) from None
    return meshio
