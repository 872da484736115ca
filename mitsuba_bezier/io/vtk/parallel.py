"""Files that name the pieces of a VTK grid (``.pvtu``), and polygons (``.vtp``)."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path, PurePosixPath

import numpy as np

from ..files import damaged
from ..report import Collector, Model
from .grid import Grid, add_grid, note_ghosts
from .reader import finished, read_arrays, read_pieces
from .xml import Element, VtkXml

__all__ = ["read_polygons", "read_pvtu"]

#: The arrays of cells of a piece of polygons: number attribute, element, cell type by the number of
#: points (None: always the last).
_POLYGONS = (
    ("NumberOfVerts", "Verts", 2),
    ("NumberOfLines", "Lines", 4),
    ("NumberOfPolys", "Polys", 7),
    ("NumberOfStrips", "Strips", 6),
)
#: Pieces of one file.
_MAX_PIECES = 100_000


def read_pvtu(path: str | PathLike[str], trims: bool = False, fields: bool = False) -> Model:
    """Read a ``.pvtu`` file: the pieces that it names, which are files in its folder or below.

    Raises
    ------
    FileFormatError
        If the file or a piece is missing or damaged, or a piece is elsewhere.
    """
    xml = VtkXml(path)
    grid = xml.root.first("PUnstructuredGrid")
    if xml.root.attributes.get("type") != "PUnstructuredGrid" or grid is None:
        got = repr(xml.root.attributes.get("type"))
        raise damaged(path, "a VTKFile of type 'PUnstructuredGrid'", got, line=xml.root.line)
    pieces = list(grid.all("Piece"))
    if len(pieces) > _MAX_PIECES:
        raise damaged(path, f"at most {_MAX_PIECES} pieces", len(pieces))
    collector = Collector(path, "pvtu")
    first = 0
    for piece in pieces:
        name = piece.attributes.get("Source", "")
        source = PurePosixPath(name.replace("\\", "/"))
        if not name or source.is_absolute() or ".." in source.parts or ":" in name:
            expected = "a Source in the folder of the file, or below"
            raise damaged(path, expected, repr(name[:100]), line=piece.line)
        file = Path(os.fspath(path)).parent / source
        collector.size += file.stat().st_size if file.is_file() else 0
        first = read_pieces(file, collector, first, trims, fields)
    return finished(path, collector)


def read_polygons(path: str | PathLike[str], fields: bool = False) -> Model:
    """Read a ``.vtp`` file: polygons and strips of triangles.

    Raises
    ------
    FileFormatError
        If the file is missing or damaged, or has no such faces.
    """
    xml = VtkXml(path)
    data = xml.root.first("PolyData")
    if xml.root.attributes.get("type") != "PolyData" or data is None:
        got = repr(xml.root.attributes.get("type"))
        raise damaged(path, "a VTKFile of type 'PolyData'", got, line=xml.root.line)
    collector = Collector(path, "vtp")
    first = 0
    for piece in data.all("Piece"):
        first += _add_piece(xml, piece, collector, first, fields)
    return finished(path, collector)


def _add_piece(xml: VtkXml, piece: Element, collector: Collector, first: int, fields: bool) -> int:
    count = xml.count(piece, "NumberOfPoints")
    types, sizes, connectivity = [], [], []
    for attribute, tag, kind in _POLYGONS:
        cells = xml.count(piece, attribute) if attribute in piece.attributes else 0
        element = piece.first(tag)
        if not cells or element is None:
            continue
        named = {e.attributes.get("Name"): e for e in element.all("DataArray")}
        for name in ("connectivity", "offsets"):
            if name not in named:
                raise damaged(
                    xml.path, f"a DataArray {name!r} in <{tag}>", "none", line=element.line
                )
        offsets = np.concatenate([[0], xml.array(named["offsets"], cells, "integer")])
        own = np.diff(offsets)
        if (own < 0).any() or offsets[-1] > 2**62:
            raise damaged(xml.path, "offsets that grow", "others", line=element.line)
        connectivity.append(xml.array(named["connectivity"], int(offsets[-1]), "integer"))
        # triangles and quadrilaterals are what they are
        small = np.select([own == 3, own == 4], [5, 9], 7)
        types.append(small if kind == 7 else np.full(cells, kind))
        sizes.append(own)
    if not types:
        return 0
    holder = piece.first("Points")
    points = holder.first("DataArray") if holder is not None else None
    if points is None or points.attributes.get("NumberOfComponents", "3") != "3":
        raise damaged(xml.path, "points of 3 components", "none", line=piece.line)
    x = xml.array(points, 3 * count).reshape(-1, 3).astype(np.float64)
    kinds = np.concatenate(types)
    total = len(kinds)
    grid = plain_grid(x, kinds, np.concatenate(sizes), np.concatenate(connectivity))
    if fields:
        skip: set[str | None] = {"vtkGhostType"}
        grid.point_arrays = read_arrays(xml, piece.first("PointData"), count, skip, collector)
        grid.cell_arrays = read_arrays(xml, piece.first("CellData"), total, skip, collector)
    ghosts = add_grid(
        collector, grid, first, lambda expected, got: damaged(xml.path, expected, got)
    )
    note_ghosts(collector, ghosts)
    return total


def plain_grid(
    points: np.ndarray, types: np.ndarray, sizes: np.ndarray, connectivity: np.ndarray
) -> Grid:
    """Return a grid without weights, ghosts and degrees."""
    none = np.zeros(len(types), bool)
    return Grid(
        points,
        np.concatenate([points, np.ones((len(points), 1))], axis=1),
        types,
        np.concatenate([[0], np.cumsum(sizes)]),
        connectivity,
        np.zeros((len(types), 3), int),
        none,
        none,
        np.zeros(len(points), bool),
    )
