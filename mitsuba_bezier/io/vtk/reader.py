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

from math import comb, isqrt
from os import PathLike
from typing import NamedTuple

import numpy as np

from ...errors import GeometryError
from ...geometry import bernstein
from ...geometry.trims import Trims
from ..cells import MAX_LAGRANGE, Cells, add_cells, add_surface
from ..files import damaged
from ..lattices import quad_lattice, tetra_lattice, triangle_lattice
from ..report import Collector, Model
from ..trim_arrays import unpacked_trims
from .ghosts import ghost_cells, hidden_points
from .xml import Element, VtkXml

__all__ = ["HOMOGENEOUS", "TRIM_ARRAYS", "read"]

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

#: Highest degree of triangles, read or made; VTK itself stops at 10 for most cells.
MAX_DEGREE = 40

#: Cell types that are read: number to (kind, are the points Bézier points).
_READ = {
    22: ("triangle", False),
    69: ("triangle", False),
    76: ("triangle", True),
    23: ("quad", False),
    28: ("quad", False),
    70: ("quad", False),
    77: ("quad", True),
    24: ("tetra", False),
    71: ("tetra", False),
    78: ("tetra", True),
}

#: The cells that can be trimmed.
_TRIMMED = 76

#: Names of VTK's cell types.
_CELL_NAMES = {
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
    21: "QUADRATIC_EDGE",
    22: "QUADRATIC_TRIANGLE",
    23: "QUADRATIC_QUAD",
    24: "QUADRATIC_TETRA",
    25: "QUADRATIC_HEXAHEDRON",
    26: "QUADRATIC_WEDGE",
    28: "BIQUADRATIC_QUAD",
    29: "TRIQUADRATIC_HEXAHEDRON",
    34: "BIQUADRATIC_TRIANGLE",
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


def read(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read a ``.vtu`` file.

    Bézier triangles are taken as they are. Bézier quadrilaterals, Lagrange and quadratic
    triangles and quadrilaterals are converted, as is the surface of Bézier, Lagrange and
    quadratic tetrahedra. Other cells are counted in the report as refused; so are linear ones,
    which make a plain mesh that Mitsuba renders itself.

    Cells that VTK does not show (`vtu_ghosts`) are left out, and noted.

    A `RationalWeights` array that is not flagged is not used, as in VTK, and noted in the report.

    Parameters
    ----------
    path : path
        The file.
    trims : bool
        Whether patches may have trims; if not, trimmed patches are returned whole, with a note.

    Raises
    ------
    FileFormatError
        If the file is missing or damaged, or holds no such cell.
    """
    xml = VtkXml(path)
    grid = xml.root.first("UnstructuredGrid")
    if xml.root.attributes.get("type") != "UnstructuredGrid" or grid is None:
        raise damaged(
            path,
            "a VTKFile of type 'UnstructuredGrid'",
            repr(xml.root.attributes.get("type")),
            line=xml.root.line,
        )
    collector = Collector(path, "vtu")
    first = 0
    field_data = grid.first("FieldData")
    for piece in grid.all("Piece"):
        first = _read_piece(xml, piece, collector, first, field_data if trims else None)
    if not trims and _named(field_data, "points") is not None:
        collector.report.notes.append("trims are not used: patches are returned whole")
    ghosts = "only ghost cells" if any("ghost" in n for n in collector.report.notes) else "none"
    return collector.model(
        lambda: damaged(path, "Bézier triangles (cells of type 76)", f"{ghosts} in this file")
    )


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
    xml: VtkXml, piece: Element, collector: Collector, first: int, field_data: Element | None
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
    line = cells.line
    offsets_element = _cell_array(xml, cells, "offsets")
    offsets = np.concatenate([[0], xml.array(offsets_element, cells_count, "integer")])
    sizes = np.diff(offsets)
    if (sizes < 0).any() or offsets[-1] > 2**62:
        cell = int(np.argmax(sizes < 0))
        raise damaged(xml.path, "offsets that grow", f"less at cell {cell}", line=line)
    known = np.isin(types, list(_READ))
    shown = ~(copies | hidden)
    for kind, count in zip(*np.unique(types[~known & shown], return_counts=True)):
        name = _CELL_NAMES.get(int(kind), "?")
        reason = "linear" if kind < 20 else "not supported"
        collector.report.refuse(f"cells of type {kind}", f"VTK_{name}: {reason}", int(count))
    volume = np.isin(types, [n for n, (kind, _bezier) in _READ.items() if kind == "tetra"])
    chosen = known & ~hidden & (volume | ~copies)
    ghosts = int((~shown).sum())
    if not chosen.any():
        _note_ghosts(collector, ghosts)
        return first + cells_count
    connectivity = xml.array(_cell_array(xml, cells, "connectivity"), int(offsets[-1]), "integer")
    homogeneous = _points(xml, piece, points_count, collector)
    plain = np.concatenate([homogeneous.points, np.ones((points_count, 1))], axis=1)
    degrees = _degrees(xml, piece, cells_count)
    trims = _piece_trims(xml, piece, cells_count, field_data)
    no_points = hidden_points(xml, piece, points_count)
    keys = np.column_stack([types, sizes, degrees])
    surfaces: list[Cells] = []
    volumes: list[Cells] = []
    found, inverse = np.unique(keys[chosen], axis=0, return_inverse=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    ends = np.searchsorted(inverse.ravel()[order], np.arange(1, len(found)))
    for key, group in zip(found, np.split(np.flatnonzero(chosen)[order], ends)):
        number, size, p, q = key.tolist()
        kind, is_bezier = _READ[number]
        most = MAX_DEGREE if is_bezier else MAX_LAGRANGE
        degree = _degree(kind, size, p, q)
        if degree is None:
            raise damaged(
                xml.path,
                f"a number of points that fits VTK_{_CELL_NAMES[number]}",
                f"{size} points in cell {group[0]}",
                line=line,
            )
        if max(degree) > most or (kind == "quad" and sum(degree) > MAX_DEGREE):
            reason = f"degree above {most} (the sum of both above {MAX_DEGREE}): not supported"
            seen = int((~copies[group]).sum())
            collector.report.refuse(f"cells of type {number}, degree {max(degree)}", reason, seen)
            continue
        lattice = _lattice(kind, size, degree)
        index = connectivity[offsets[group][:, None] + np.arange(size)]
        bad = ((index < 0) | (index >= points_count)).any(axis=1)
        if bad.any():
            cell = int(np.argmax(bad))
            raise damaged(
                xml.path,
                f"point numbers from 0 to {points_count - 1}",
                f"{index[cell].tolist()} in cell {group[cell]}",
                line=line,
            )
        seen = ~no_points[index].any(axis=1)
        if not seen.all():
            ghosts += int((~seen & ~copies[group]).sum())
            group, index = group[seen], index[seen]
        part = Cells(kind, lattice, index, is_bezier, copies[group])
        if not len(group):
            continue
        if kind == "tetra":
            volumes.append(part)
        else:
            surfaces.append(part)
            net = homogeneous.net if is_bezier else plain
            own = trims[group] if trims is not None and number == _TRIMMED else None
            add_cells(collector, part, net, first + group, own)
    _note_ghosts(collector, ghosts)
    for is_bezier in (False, True):
        some = [v for v in volumes if v.bezier == is_bezier]
        net = homogeneous.net if is_bezier else plain
        add_surface(collector, some, surfaces, net, first + cells_count)
    return first + cells_count


def _note_ghosts(collector: Collector, count: int) -> None:
    if count:
        collector.report.notes.append(
            f"{count} ghost cells (vtkGhostType: copies of cells of other pieces, or hidden) are "
            "left out"
        )


def _degree(kind: str, size: int, p: int, q: int) -> tuple[int, int] | None:
    """Return the degrees of a cell of `size` points; None if their number is not possible."""
    if kind == "quad":
        if p < 1 or q < 1:
            p = q = 2 if size == 8 else isqrt(size) - 1  # 8: without the middle node
        return (p, q) if p >= 1 and size in ((p + 1) * (q + 1), 8 * (p == q == 2)) else None
    count = {"triangle": bernstein.size, "tetra": lambda n: comb(n + 3, 3)}[kind]
    n = next((n for n in range(1, size) if count(n) >= size), 0)
    return (n, n) if n >= 1 and count(n) == size else None


def _lattice(kind: str, size: int, degree: tuple[int, int]) -> np.ndarray:
    """Return where the points of a cell lie."""
    if kind == "quad":
        return quad_lattice(*degree, "vtk")[:size]
    return triangle_lattice(degree[0]) if kind == "triangle" else tetra_lattice(degree[0], "vtk")


def _degrees(xml: VtkXml, piece: Element, count: int) -> np.ndarray:
    """Return the degrees (p, q) of quadrilaterals, ``(count, 2)``; 0 where they are not given."""
    data = piece.first("CellData")
    name = data.attributes.get("HigherOrderDegrees") if data is not None else None
    for element in data.all("DataArray") if data is not None and name else ():
        if element.attributes.get("Name") == name:
            if element.attributes.get("NumberOfComponents") != "3":
                raise damaged(xml.path, f"3 components in {name!r}", "others", line=element.line)
            values = xml.array(element, 3 * count).reshape(-1, 3)[:, :2]
            good = (values >= 0) & (values <= 1000)  # what is higher is refused below
            return np.where(good, values, 0).astype(int)
    return np.zeros((count, 2), int)


class _Net(NamedTuple):
    points: np.ndarray  # (N, 3), as VTK sees them
    net: np.ndarray  # (N, 4), homogeneous


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
        return _Net(points, out)
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
    return _Net(points, exact)
