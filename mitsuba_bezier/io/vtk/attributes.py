"""Texture coordinates and attributes of Bézier triangles in ``.vtu`` files.

* Texture coordinates are the point array that the file flags with ``<PointData TCoords="...">``,
  as VTK does. They are affine over a patch, so those of its corners tell all.
* Cell arrays ``face_...`` have one entry a patch, point arrays ``vertex_...`` one a control point:
  the ordinates of a Bernstein polynomial on each patch (VTK, which takes point data for
  rational like the points, shows something else where weights differ).
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...geometry import bernstein
from ...geometry.triangles import BezierTriangles
from ..files import damaged
from ..lattices import triangle_lattice
from .ghosts import ghost_cells, hidden_points
from .xml import Element, VtkXml

__all__ = ["TCOORDS", "read_attributes", "vtk_arrays"]

_BEZIER_TRIANGLE = 76
#: VTK's name for texture coordinates.
TCOORDS = "TCoords"


def read_attributes(path: str | PathLike[str]) -> dict[str, np.ndarray]:
    """Read what a file tells beside the patches.

    Returns
    -------
    dict
        ``texcoords`` of shape ``(P, 3, 2)``, ``face_...`` of shape ``(P, C)`` and ``vertex_...``
        of shape ``(P, K, C)``, as far as the file has them, in the order of `io.load`. Empty for
        a file that has other cells than Bézier triangles, or triangles of several degrees.

    Raises
    ------
    FileFormatError
        If the file is damaged, or pieces of it have different arrays.
    """
    xml = VtkXml(path)
    grid = xml.root.first("UnstructuredGrid")
    parts: list[dict[str, np.ndarray]] = []
    for piece in grid.all("Piece") if grid is not None else ():
        if not xml.count(piece, "NumberOfCells"):
            continue
        part = _piece(xml, piece)
        if part is None:
            return {}
        parts.append(part)
    names = set(parts[0]) if parts else set()
    if any(set(part) != names for part in parts):
        raise damaged(path, "the same attributes in all pieces", "others")
    try:
        return {name: np.concatenate([part[name] for part in parts]) for name in sorted(names)}
    except ValueError:
        raise damaged(path, "attributes of one size in all pieces", "several") from None


def _piece(xml: VtkXml, piece: Element) -> dict[str, np.ndarray] | None:
    """Return the arrays of a piece, None if it is not of Bézier triangles of one degree."""
    cells, points = (xml.count(piece, f"NumberOf{x}") for x in ("Cells", "Points"))
    topology = {e.attributes.get("Name"): e for e in _arrays(piece.first("Cells"))}
    if not {"types", "offsets", "connectivity"} <= set(topology):
        return None  # `io.read` tells what is wrong
    types = xml.array(topology["types"], cells, "integer")
    sizes = np.diff(xml.array(topology["offsets"], cells, "integer"), prepend=0)
    size = int(sizes[0])
    if (types != _BEZIER_TRIANGLE).any() or (sizes != size).any() or size < 3:
        return None
    connectivity = xml.array(topology["connectivity"], cells * size, "integer").reshape(-1, size)
    if connectivity.min() < 0 or connectivity.max() >= points:
        return None
    copies, hidden = ghost_cells(xml, piece, cells)
    seen = ~(copies | hidden | hidden_points(xml, piece, points)[connectivity].any(axis=1))
    connectivity = connectivity[seen]
    out = {}
    data = piece.first("PointData")
    flagged = data.attributes.get(TCOORDS) if data is not None else None
    for element in _arrays(data):
        name = element.attributes.get("Name", "")
        components = _components(xml, element)
        if name == flagged and components >= 2:
            uv = xml.array(element, components * points).reshape(points, -1)[:, :2]
            out["texcoords"] = uv[connectivity[:, :3]]
        elif name.startswith("vertex_"):
            values = xml.array(element, components * points).reshape(points, -1)
            ordinates = np.empty((len(connectivity), size, components))
            ordinates[:, _order(size)] = values[connectivity]
            out[name] = ordinates
    for element in _arrays(piece.first("CellData")):
        name = element.attributes.get("Name", "")
        if name.startswith("face_"):
            components = _components(xml, element)
            out[name] = xml.array(element, components * cells).reshape(cells, -1)[seen]
    return out


def _arrays(data: Element | None) -> list[Element]:
    return list(data.all("DataArray")) if data is not None else []


def _components(xml: VtkXml, element: Element) -> int:
    text = element.attributes.get("NumberOfComponents", "1")
    if not text.isdecimal() or not 1 <= int(text) <= 9:
        raise damaged(xml.path, "1 to 9 components", repr(text), line=element.line)
    return int(text)


def _order(size: int) -> np.ndarray:
    """Return the rows of a net in the order of VTK's points."""
    n = bernstein.degree_of(size)
    return np.array([bernstein.row(n, i, j) for i, j, _k in triangle_lattice(n).tolist()])


def vtk_arrays(
    patches: BezierTriangles, attributes: Mapping[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return point and cell arrays by name; texture coordinates are called "TCoords".

    Parameters
    ----------
    patches : BezierTriangles
    attributes : mapping
        Arrays as `read_attributes` returns them; ``vertex_...`` of the degree of the patches.

    Raises
    ------
    FileFormatError
        If a name or a shape is another.
    """
    count, size = patches.control_points.shape[:2]
    order = _order(size)
    point_data, cell_data = {}, {}
    for name, given in attributes.items():
        values = np.asarray(given, dtype=np.float64)
        if name == "texcoords":
            _check(name, values, f"({count}, 3, 2)", values.shape == (count, 3, 2))
            share = bernstein.multi_indices(patches.degree)[order] / patches.degree
            point_data[TCOORDS] = np.einsum("kc,pcd->pkd", share, values).reshape(-1, 2)
        elif name.startswith("vertex_"):
            good = values.ndim == 3 and values.shape[:2] == (count, size)
            _check(name, values, f"({count}, {size}, C)", good)
            point_data[name] = values[:, order].reshape(count * size, -1)
        elif name.startswith("face_"):
            _check(name, values, f"({count}, C)", values.ndim == 2 and len(values) == count)
            cell_data[name] = values
        else:
            raise FileFormatError.expected(
                "attributes", 'names "texcoords", "face_..." or "vertex_..."', repr(name)
            )
    return point_data, cell_data


def _check(name: str, values: np.ndarray, shape: str, good: bool) -> None:
    if not good:
        raise FileFormatError.expected(name, f"shape {shape}", f"{values.shape}")
