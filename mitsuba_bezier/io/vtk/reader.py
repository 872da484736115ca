"""Read VTK unstructured grids (``.vtu``) of Bézier triangles, cell type 76.

The points of a cell are Euclidean; their weights are a point array that must be flagged,
``<PointData RationalWeights="...">``: VTK ignores it otherwise. A weight of zero cannot be said
that way, so nets that the two do not hold exactly are written a second time, as the 4-component
point array `HOMOGENEOUS` of ``(w x, w y, w z, w)``, which the reader here prefers.

Trims (see `geometry.trims`) are arrays of our own, which VTK keeps but does not know:
``TrimRegion`` and ``TrimMap`` for the cells, ``TrimCurves`` and ``TrimPoints`` as field data;
`trim_arrays` says what they hold.

Corners 0, 1, 2 of VTK are our corners ``(n,0,0)``, ``(0,n,0)``, ``(0,0,n)``, so VTK's parametric
coordinates are ``(r, s) = (v, w)`` and the orientation is the same.

Sources: "VTK XML Formats" (see `vtk_xml`), vtkHigherOrderTriangle for the order of the points.
"""

from __future__ import annotations

import re
from os import PathLike
from typing import NamedTuple

import numpy as np

from ...errors import GeometryError
from ...geometry.trims import Trims
from ..files import damaged
from ..report import Collector, Model
from ..trim_arrays import unpacked_trims
from .field_arrays import SIDES
from .ghosts import ghost_cells, hidden_points
from .grid import Array, Grid, add_grid, needed, note_ghosts
from .xml import Element, VtkXml

__all__ = ["HOMOGENEOUS", "TRIM_ARRAYS", "finished", "read", "read_arrays", "read_pieces"]

#: Name of the point array of homogeneous control points.
HOMOGENEOUS = "HomogeneousPoints"


class TrimArray(NamedTuple):
    """How an array of `packed_trims` is stored."""

    name: str
    components: int
    kind: str
    field: bool  #: field data, not cell data


#: The arrays of trims.
TRIM_ARRAYS = {
    "region": TrimArray("TrimRegion", 1, "integer", False),
    "map": TrimArray("TrimMap", 12, "number", False),
    "curves": TrimArray("TrimCurves", 2, "integer", True),
    "points": TrimArray("TrimPoints", 3, "number", True),
}

#: Point and cell arrays that are no fields.
_NO_FIELDS = {HOMOGENEOUS, "vtkGhostType", "vtkGhostLevels"}


#: The version of files since which edges of hexahedra of high order go round.
_NEW_ORDER = (2, 1)


def read(path: str | PathLike[str], trims: bool = False, fields: bool = False) -> Model:
    """Read a ``.vtu`` file.

    Bézier triangles are taken as they are. All other cells of `cell_types.READ` are converted, of
    volume cells their surface; so are convex polygons and strips of triangles. What is left is
    counted in the report as refused.

    Cells that VTK does not show (`ghosts`) are left out, and noted.

    A `RationalWeights` array that is not flagged is not used, as in VTK, and noted in the report.

    Parameters
    ----------
    path : path
        The file.
    trims : bool
        Whether patches may have trims; if not, trimmed patches are returned whole, with a note.
    fields : bool
        Whether point and cell data are read.

    Raises
    ------
    FileFormatError
        If the file is missing or damaged, or holds no such cell.
    """
    collector = Collector(path, "vtu")
    read_pieces(path, collector, 0, trims, fields)
    return finished(path, collector)


def read_pieces(
    path: str | PathLike[str], collector: Collector, first: int, trims: bool, fields: bool
) -> int:
    """Read all pieces of a ``.vtu`` file; return the number of the cell that follows."""
    xml = VtkXml(path)
    grid = xml.root.first("UnstructuredGrid")
    if xml.root.attributes.get("type") != "UnstructuredGrid" or grid is None:
        raise damaged(
            path,
            "a VTKFile of type 'UnstructuredGrid'",
            repr(xml.root.attributes.get("type")),
            line=xml.root.line,
        )
    field_data = grid.first("FieldData")
    for piece in grid.all("Piece"):
        first = _read_piece(xml, piece, collector, first, field_data if trims else None, fields)
    if not trims and _named(field_data, "points") is not None:
        collector.report.notes.append("trims are not used: patches are returned whole")
    own = {array.name for array in TRIM_ARRAYS.values()}
    others = [e.attributes.get("Name", "") for e in _arrays(field_data)]
    if told := [repr(name[:40]) for name in others if name not in own]:
        collector.report.remarks.append(f"field data that are not used: {', '.join(told[:20])}")
    return first


def finished(path: str | PathLike[str], collector: Collector) -> Model:
    """Return the model of a file of VTK."""
    ghosts = "only ghost cells" if any("ghost" in n for n in collector.report.notes) else "none"
    return collector.model(
        lambda: damaged(path, "Bézier triangles (cells of type 76) or other surfaces",
                        f"{ghosts} in this file")
    )  # fmt: skip


def _arrays(data: Element | None) -> list[Element]:
    return [*data.all("DataArray"), *data.all("Array")] if data is not None else []


def _child(xml: VtkXml, parent: Element, tag: str) -> Element:
    found = parent.first(tag)
    if found is None:
        raise damaged(xml.path, f"a <{tag}> in <{parent.tag}>", "none", line=parent.line)
    return found


def _cell_array(xml: VtkXml, cells: Element, name: str) -> Element:
    for element in cells.all("DataArray"):
        if element.attributes.get("Name") == name:
            return element
    raise damaged(xml.path, f"a DataArray {name!r} in <Cells>", "none", line=cells.line)


def _named(data: Element | None, key: str) -> Element | None:
    """Return an array of trims."""
    for element in data.all("DataArray") if data is not None else ():
        if element.attributes.get("Name") == TRIM_ARRAYS[key].name:
            return element
    return None


def _piece_trims(
    xml: VtkXml, piece: Element, count: int, field_data: Element | None
) -> Trims | None:
    """Return the trims of the cells of a piece, None if they are whole."""
    cell_data = piece.first("CellData")
    arrays: dict[str, np.ndarray] = {}
    for key, own in TRIM_ARRAYS.items():
        element = _named(field_data if own.field else cell_data, key)
        if element is None:
            return None
        components = element.attributes.get("NumberOfComponents", "1")
        if components != str(own.components):
            raise damaged(
                xml.path,
                f"{own.components} components in {own.name!r}",
                components,
                line=element.line,
            )
        length = xml.count(element, "NumberOfTuples") if own.field else count
        values = xml.array(element, own.components * length, own.kind)
        arrays[key] = values if own.components == 1 else values.reshape(length, -1)
    try:
        return unpacked_trims(arrays)
    except GeometryError as error:
        raise damaged(xml.path, "trims that fit together", f"others ({error})") from None


def _read_piece(
    xml: VtkXml,
    piece: Element,
    collector: Collector,
    first: int,
    field_data: Element | None,
    fields: bool,
) -> int:
    """Convert the cells of a piece; `first` is the number of its first cell.

    Returns
    -------
    int
        The number of the first cell of the next piece.
    """
    points_count = xml.count(piece, "NumberOfPoints")
    cells_count = xml.count(piece, "NumberOfCells")
    if not cells_count:
        return first
    copies, hidden = ghost_cells(xml, piece, cells_count)
    cells = _child(xml, piece, "Cells")
    types = xml.array(_cell_array(xml, cells, "types"), cells_count, "integer")
    offsets_element = _cell_array(xml, cells, "offsets")
    offsets = np.concatenate([[0], xml.array(offsets_element, cells_count, "integer")])
    sizes = np.diff(offsets)
    if (sizes < 0).any() or offsets[-1] > 2**62:
        cell = int(np.argmax(sizes < 0))
        raise damaged(xml.path, "offsets that grow", f"less at cell {cell}", line=cells.line)
    some = needed(types, copies, hidden).any()
    size = int(offsets[-1]) if some else 0
    points = _Net(np.zeros((0, 3)), np.zeros((0, 4)), False)
    connectivity = np.zeros(0, np.int64)
    if some:
        connectivity = xml.array(_cell_array(xml, cells, "connectivity"), size, "integer")
        points = _points(xml, piece, points_count, collector)
    grid = Grid(
        points.points,
        points.net,
        types,
        offsets,
        connectivity,
        _degrees(xml, piece, cells_count),
        copies,
        hidden,
        hidden_points(xml, piece, points_count),
        _piece_trims(xml, piece, cells_count, field_data),
        rational=points.rational,
        old_order=_before_9_1(xml),
    )
    if fields and some:
        data = piece.first("PointData")
        flagged = data.attributes.get("RationalWeights") if data is not None else None
        skip = {*_NO_FIELDS, flagged, *(a.name for a in TRIM_ARRAYS.values())}
        grid.point_arrays = read_arrays(xml, data, points_count, skip, collector)
        grid.cell_arrays = read_arrays(xml, piece.first("CellData"), cells_count, skip, collector)
        sides = grid.cell_arrays.pop(SIDES, None)
        if sides is not None and sides.values.shape[1] == 3:
            grid.sides = sides.values != 0
    ghosts = add_grid(
        collector, grid, first, lambda expected, got: damaged(xml.path, expected, got,
                                                              line=cells.line)
    )  # fmt: skip
    note_ghosts(collector, ghosts)
    return first + cells_count


def read_arrays(
    xml: VtkXml, data: Element | None, count: int, skip: set[str | None], collector: Collector
) -> dict[str, Array]:
    """Return the arrays of point or cell data, but for those to `skip`."""
    out: dict[str, Array] = {}
    degrees = data.attributes.get("HigherOrderDegrees") if data is not None else None
    for element in _arrays(data):
        name = element.attributes.get("Name", "")
        if name in skip or name == degrees:
            continue
        if element.tag == "Array" or element.attributes.get("type") in ("String", "Bit"):
            collector.report.notes.append(f"array {name[:40]!r} is not of numbers: it is not read")
            continue
        text = element.attributes.get("NumberOfComponents", "1").strip()
        if not text.isdecimal() or len(text) > 4 or int(text) < 1:
            raise damaged(xml.path, "a number of components", repr(text[:40]), line=element.line)
        values = xml.array(element, int(text) * count).reshape(count, -1).astype(np.float64)
        unit = next((" ".join("".join(e.texts).split()) for e in element.all("InformationKey")
                     if e.attributes.get("name") == "UNITS_LABEL"), "")  # fmt: skip
        out[name] = Array(values, unit, name.startswith("vertex_"))
    return out


def _before_9_1(xml: VtkXml) -> bool:
    """Return whether hexahedra of high order have the order that VTK had before 9.1."""
    words = re.fullmatch(r"\s*(\d{1,4})\.(\d{1,4})\s*", xml.root.attributes.get("version", ""))
    return words is None or (int(words[1]), int(words[2])) < _NEW_ORDER


def _degrees(xml: VtkXml, piece: Element, count: int) -> np.ndarray:
    """Return the degrees of cells, ``(count, 3)``; 0 where they are not given."""
    data = piece.first("CellData")
    name = data.attributes.get("HigherOrderDegrees") if data is not None else None
    for element in data.all("DataArray") if data is not None and name else ():
        if element.attributes.get("Name") == name:
            if element.attributes.get("NumberOfComponents") != "3":
                raise damaged(xml.path, f"3 components in {name!r}", "others", line=element.line)
            values = xml.array(element, 3 * count).reshape(-1, 3)
            good = (values >= 0) & (values <= 1000)  # what is higher is refused later
            return np.where(good, values, 0).astype(int)
    return np.zeros((count, 3), int)


class _Net(NamedTuple):
    points: np.ndarray  # (N, 3), as VTK sees them
    net: np.ndarray  # (N, 4), homogeneous
    rational: bool  # they have weights


def _points(xml: VtkXml, piece: Element, count: int, collector: Collector) -> _Net:
    """Return the points of a piece."""
    array = _child(xml, _child(xml, piece, "Points"), "DataArray")
    components = array.attributes.get("NumberOfComponents", "3")
    if components != "3":
        raise damaged(
            xml.path, "points of 3 components", f"{components} components", line=array.line
        )
    points = xml.array(array, 3 * count).reshape(-1, 3)
    weights = np.ones(count)
    data = piece.first("PointData") or Element("PointData", {}, piece.line)
    flagged = data.attributes.get("RationalWeights")
    named = {e.attributes.get("Name"): e for e in data.all("DataArray")}
    homogeneous = named.get(HOMOGENEOUS)
    if flagged:
        if flagged not in named:
            raise damaged(
                xml.path, f"the DataArray {flagged!r} named as weights", "none", line=data.line
            )
        weights = xml.array(named[flagged], count)
    elif "RationalWeights" in named and homogeneous is None:
        collector.report.notes.append(
            f"the point array 'RationalWeights' (line {named['RationalWeights'].line}) is not "
            "flagged and not used, as in VTK; to use it, write "
            f'<PointData RationalWeights="RationalWeights"> in line {data.line}'
        )
    out = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
    if homogeneous is None:
        return _Net(points, out, bool(flagged))
    components = homogeneous.attributes.get("NumberOfComponents", "1")
    if components != "4":
        raise damaged(
            xml.path,
            f"4 components in {HOMOGENEOUS!r}",
            components,
            line=homogeneous.line,
        )
    exact = xml.array(homogeneous, 4 * count).reshape(-1, 4)
    scale = np.abs(exact).max(initial=0.0)
    # 1e-5: above the stand-in weights of control vectors and the rounding of float32 points
    if not np.abs(exact - out).max(initial=0.0) <= 1e-5 * scale:
        raise damaged(
            xml.path,
            f"{HOMOGENEOUS!r} to agree with the points and weights",
            "other points: some program changed only one of them; delete the array "
            "to use the points and weights",
            line=homogeneous.line,
        )
    return _Net(points, exact, bool((exact[:, 3] != 1).any()))
