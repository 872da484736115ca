"""VTK unstructured grids (``.vtu``) of Bézier triangles, cell type 76.

The points of a cell are Euclidean; their weights are a point array that must be flagged,
``<PointData RationalWeights="...">``: VTK ignores it otherwise. A weight of zero cannot be said
that way, so nets that the two do not hold exactly are written a second time, as the 4-component
point array `HOMOGENEOUS` of ``(w x, w y, w z, w)``, which the reader here prefers.

Corners 0, 1, 2 of VTK are our corners ``(n,0,0)``, ``(0,n,0)``, ``(0,0,n)``, so VTK's parametric
coordinates are ``(r, s) = (v, w)`` and the orientation is the same.

Sources: "VTK XML Formats" (see `vtk_xml`), vtkHigherOrderTriangle for the order of the points.
"""

from __future__ import annotations

import base64
import zlib
from functools import cache
from os import PathLike

import numpy as np

from ..errors import FileFormatError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from .files import damaged, write_bytes
from .report import Collector, Model
from .vtk_xml import Element, VtkXml

__all__ = ["HOMOGENEOUS", "point_order", "read", "write"]

#: Name of the point array of homogeneous control points.
HOMOGENEOUS = "HomogeneousPoints"

#: A control vector is shown to VTK as a point far away, of this weight relative to the largest:
#: a power of two, so that the vector itself is kept exactly.
_FAR = 2.0**-20

_BEZIER_TRIANGLE = 76

#: Cell types of VTK by number, for messages.
_CELL_NAMES = {
    1: "VTK_VERTEX",
    2: "VTK_POLY_VERTEX",
    3: "VTK_LINE",
    4: "VTK_POLY_LINE",
    5: "VTK_TRIANGLE",
    6: "VTK_TRIANGLE_STRIP",
    7: "VTK_POLYGON",
    8: "VTK_PIXEL",
    9: "VTK_QUAD",
    10: "VTK_TETRA",
    11: "VTK_VOXEL",
    12: "VTK_HEXAHEDRON",
    13: "VTK_WEDGE",
    14: "VTK_PYRAMID",
    21: "VTK_QUADRATIC_EDGE",
    22: "VTK_QUADRATIC_TRIANGLE",
    23: "VTK_QUADRATIC_QUAD",
    24: "VTK_QUADRATIC_TETRA",
    25: "VTK_QUADRATIC_HEXAHEDRON",
    28: "VTK_BIQUADRATIC_QUAD",
    68: "VTK_LAGRANGE_CURVE",
    69: "VTK_LAGRANGE_TRIANGLE",
    70: "VTK_LAGRANGE_QUADRILATERAL",
    71: "VTK_LAGRANGE_TETRAHEDRON",
    72: "VTK_LAGRANGE_HEXAHEDRON",
    73: "VTK_LAGRANGE_WEDGE",
    74: "VTK_LAGRANGE_PYRAMID",
    75: "VTK_BEZIER_CURVE",
    76: "VTK_BEZIER_TRIANGLE",
    77: "VTK_BEZIER_QUADRILATERAL",
    78: "VTK_BEZIER_TETRAHEDRON",
    79: "VTK_BEZIER_HEXAHEDRON",
    80: "VTK_BEZIER_WEDGE",
    81: "VTK_BEZIER_PYRAMID",
}


@cache
def point_order(n: int) -> np.ndarray:
    """Return the rows of our net in the order of VTK's points, ``(K,)`` integers.

    VTK lists the corners, then the points inside the edges 01, 12, 20, then the same again for
    the interior as a triangle of degree ``n - 3``.
    """

    def indices(m: int) -> list[tuple[int, int, int]]:
        if m < 0:
            return []
        if m == 0:
            return [(0, 0, 0)]
        out = [(m, 0, 0), (0, m, 0), (0, 0, m)]
        out += [(m - t, t, 0) for t in range(1, m)]
        out += [(0, m - t, t) for t in range(1, m)]
        out += [(t, 0, m - t) for t in range(1, m)]
        return out + [(i + 1, j + 1, k + 1) for i, j, k in indices(m - 3)]

    return np.array([bernstein.row(n, i, j) for i, j, _k in indices(n)])


# ---------------------------------------------------------------------------- reading


def read(path: str | PathLike[str]) -> Model:
    """Read the Bézier triangles of a ``.vtu`` file.

    Other cells are counted in the report as refused. A `RationalWeights` array that is not
    flagged is not used, as in VTK, and noted in the report.

    Raises
    ------
    FileFormatError
        If the file is missing or damaged, or holds no Bézier triangle.
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
    for piece in grid.all("Piece"):
        _read_piece(xml, piece, collector)
    return collector.model(
        lambda: damaged(path, "Bézier triangles (cells of type 76)", "none in this file")
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


def _read_piece(xml: VtkXml, piece: Element, collector: Collector) -> None:
    points_count = xml.count(piece, "NumberOfPoints")
    cells_count = xml.count(piece, "NumberOfCells")
    if not cells_count:
        return
    cells = _child(xml, piece, "Cells")
    types = xml.array(_cell_array(xml, cells, "types"), cells_count, "integer")
    line = cells.line
    offsets_element = _cell_array(xml, cells, "offsets")
    offsets = np.concatenate([[0], xml.array(offsets_element, cells_count, "integer")])
    sizes = np.diff(offsets)
    if (sizes < 0).any() or offsets[-1] > 2**62:
        cell = int(np.argmax(sizes < 0))
        raise damaged(xml.path, "offsets that grow", f"less at cell {cell}", line=line)
    face = collector.report.faces + np.arange(cells_count)
    _refuse_others(types, collector)
    chosen = np.flatnonzero(types == _BEZIER_TRIANGLE)
    if not len(chosen):
        return
    connectivity = xml.array(_cell_array(xml, cells, "connectivity"), int(offsets[-1]), "integer")
    homogeneous = _points(xml, piece, points_count, collector)
    for size in np.unique(sizes[chosen]).tolist():
        group = chosen[sizes[chosen] == size]
        try:
            n = bernstein.degree_of(size)
        except ValueError:
            raise damaged(
                xml.path,
                "Bézier triangles of (n+1)(n+2)/2 points, n >= 1",
                f"{size} points in cell {group[0]}",
                line=line,
            ) from None
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
        nets = np.empty((len(group), size, 4))
        nets[:, point_order(n)] = homogeneous[index]
        collector.add(nets, face[group])
        collector.report.accept(len(group))


def _refuse_others(types: np.ndarray, collector: Collector) -> None:
    for kind, count in zip(*np.unique(types[types != _BEZIER_TRIANGLE], return_counts=True)):
        name = _CELL_NAMES.get(int(kind), "unknown")
        collector.report.refuse(f"cells of type {kind}", f"{name}, no Bézier triangle", int(count))


def _points(xml: VtkXml, piece: Element, count: int, collector: Collector) -> np.ndarray:
    """Return the homogeneous points ``(count, 4)`` of a piece."""
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
        return out
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
    return exact


# ---------------------------------------------------------------------------- writing


def write(
    triangles: BezierTriangles | list[BezierTriangles],
    path: str | PathLike[str],
    encoding: str = "appended",
) -> None:
    """Write Bézier triangles as a ``.vtu`` file that VTK and ParaView show.

    Parameters
    ----------
    triangles : BezierTriangles or list of BezierTriangles
        The patches; a list may mix degrees.
    path : path
        The file.
    encoding : str
        ``"appended"`` (raw, zlib), ``"binary"`` (base64, zlib) or ``"ascii"``.
        Each is lossless.

    Raises
    ------
    FileFormatError
        If the encoding is unknown or the file cannot be written.
    """
    if encoding not in ("appended", "binary", "ascii"):
        raise FileFormatError.expected(
            "encoding", "'appended', 'binary' or 'ascii'", repr(encoding)
        )
    groups = [triangles] if isinstance(triangles, BezierTriangles) else list(triangles)
    if not groups:
        raise FileFormatError.expected("triangles", "at least one BezierTriangles", "none")
    nets = [g.control_points[:, point_order(g.degree)] for g in groups]
    homogeneous = np.concatenate([net.reshape(-1, 4) for net in nets])
    sizes = np.concatenate([np.full(len(net), net.shape[1]) for net in nets])
    affine = [_euclidean(net) for net in nets]
    points = np.concatenate([p.reshape(-1, 3) for p, _w in affine])
    weights = np.concatenate([w.reshape(-1) for _p, w in affine])

    out = _Writer(encoding)
    flag = ""
    point_data = []
    if (weights != 1).any():
        flag = ' RationalWeights="RationalWeights"'
        point_data.append(out.array("RationalWeights", weights, "Float64"))
    if not np.array_equal(points * weights[:, None], homogeneous[:, :3]) or not np.array_equal(
        weights, homogeneous[:, 3]
    ):
        point_data.append(out.array(HOMOGENEOUS, homogeneous, "Float64"))
    body = [
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(sizes)}">',
        f"<PointData{flag}>",
        *point_data,
        "</PointData>",
        "<Points>",
        out.array("Points", points, "Float64"),
        "</Points>",
        "<Cells>",
        out.array("connectivity", np.arange(len(points)), "Int64"),
        out.array("offsets", np.cumsum(sizes), "Int64"),
        out.array("types", np.full(len(sizes), _BEZIER_TRIANGLE), "UInt8"),
        "</Cells>",
        "</Piece>",
    ]
    write_bytes(path, out.document(body))


def _euclidean(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points ``(P, K, 3)`` and weights ``(P, K)`` that VTK can evaluate.

    A control vector becomes a far point of small weight, of the sign that the weights of its
    net have; the zero vector becomes any point of weight 0.
    """
    weights = nets[..., 3].copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        points = nets[..., :3] / weights[..., None]
    vector = ~np.isfinite(points).all(axis=-1)  # w = 0, or so small that the point overflows
    if vector.any():
        largest = np.abs(weights).max() or np.abs(nets).max()
        sign = np.where(weights.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
        far = sign * _FAR * 2.0 ** np.floor(np.log2(largest))
        weights = np.where(vector, far, weights)
        points[vector] = nets[vector, :3] / weights[vector, None]
    zero = ~nets.any(axis=-1)
    weights[zero] = 0.0
    if zero.any() and not zero.all():  # a place that does not enlarge the bounding box
        points[zero] = points[~zero][0]
    return points, weights


class _Writer:
    """Turns arrays into ``DataArray`` elements of one encoding."""

    def __init__(self, encoding: str) -> None:
        self._encoding = encoding
        self._appended: list[bytes] = []
        self._size = 0

    def array(self, name: str, values: np.ndarray, typename: str) -> str:
        components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        head = f'<DataArray type="{typename}" Name="{name}"{components} format="{self._encoding}"'
        if self._encoding == "ascii":
            rows = values if values.ndim == 2 else values[:, None]
            lines = (" ".join(map(repr, row)) for row in rows.tolist())
            return head + ">\n" + "\n".join(lines) + "\n</DataArray>"
        dtype = {"Float64": "<f8", "Int64": "<i8", "UInt8": "<u1"}[typename]
        header, data = self._compress(values.astype(dtype).tobytes())
        if self._encoding == "binary":
            text = (base64.b64encode(header) + base64.b64encode(data)).decode()
            return f"{head}>\n{text}\n</DataArray>"
        offset = self._size
        self._appended += [header, data]
        self._size += len(header) + len(data)
        return f'{head} offset="{offset}"/>'

    @staticmethod
    def _compress(data: bytes, block: int = 1 << 20) -> tuple[bytes, bytes]:
        """Return VTK's header (blocks, block size, last partial block, sizes) and the blocks."""
        parts = [zlib.compress(data[i : i + block], 6) for i in range(0, len(data), block)]
        head = [len(parts), block, len(data) % block, *map(len, parts)]
        return np.array(head, dtype="<u8").tobytes(), b"".join(parts)

    def document(self, body: list[str]) -> bytes:
        compressor = "" if self._encoding == "ascii" else ' compressor="vtkZLibDataCompressor"'
        head = (
            '<?xml version="1.0"?>\n'
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
            f'header_type="UInt64"{compressor}>\n<UnstructuredGrid>\n'
        )
        parts = [head.encode(), "\n".join(body).encode(), b"\n</UnstructuredGrid>\n"]
        if self._encoding == "appended":
            parts += [b'<AppendedData encoding="raw">\n_', *self._appended, b"\n</AppendedData>\n"]
        return b"".join([*parts, b"</VTKFile>\n"])
