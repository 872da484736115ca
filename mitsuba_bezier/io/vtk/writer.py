"""Write VTK unstructured grids (``.vtu``) of Bézier triangles; see `reader` for the format."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from os import PathLike
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from ...errors import FileFormatError
from ...geometry import bernstein
from ...geometry.fields import BezierField
from ...geometry.triangles import BezierTriangles
from ...geometry.trims import Trims
from ..files import write_bytes
from ..lattices import triangle_lattice
from ..trim_arrays import packed_trims
from .attributes import TCOORDS, vtk_arrays
from .field_arrays import field_arrays, own_name
from .reader import HOMOGENEOUS, TRIM_ARRAYS

__all__ = ["point_order", "write"]

_BEZIER_TRIANGLE = 76

#: VTK's way to tell the unit of an array.
_UNIT = 'InformationKey name="UNITS_LABEL" location="vtkDataArray"'

#: A control vector is shown to VTK as a point far away, of this weight relative to the largest:
#: a power of two, so that the vector itself is kept exactly.
_FAR = 2.0**-20


@cache
def point_order(n: int) -> np.ndarray:
    """Return the rows of our net in the order of VTK's points, ``(K,)`` integers.

    See `lattices.triangle_lattice`.
    """
    return np.array([bernstein.row(n, i, j) for i, j, _k in triangle_lattice(n).tolist()])


def write(
    triangles: BezierTriangles | list[BezierTriangles],
    path: str | PathLike[str],
    encoding: str = "appended",
    trims: Trims | Sequence[Trims | None] | None = None,
    attributes: Mapping[str, Any] | None = None,
    fields: Sequence[BezierField] = (),
    edges: np.ndarray | None = None,
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
    trims : Trims, or list of (Trims or None), optional
        The trims of the patches, for each item of a list of `triangles`. They are kept in arrays
        of our own (see `vtu`): other programs show the patches whole.
    attributes : mapping, optional
        Texture coordinates ``texcoords`` ``(P, 3, 2)``, attributes ``face_...`` ``(P, C)`` and
        ``vertex_...`` ``(P, K, C)`` of one item of `triangles`; see `vtu_attributes`.
    fields : sequence of BezierField
        On the patches of one item of `triangles`; see `field_arrays`.
    edges : (P, 3) array, optional
        Which sides of these patches are sides of faces; see `Model`.

    Raises
    ------
    FileFormatError
        If the encoding is unknown, trims or attributes are not those of the patches, or the
        file cannot be written.
    """
    if encoding not in ("appended", "binary", "ascii"):
        raise FileFormatError.expected(
            "encoding", "'appended', 'binary' or 'ascii'", repr(encoding)
        )
    groups = [triangles] if isinstance(triangles, BezierTriangles) else list(triangles)
    if not groups:
        raise FileFormatError.expected("triangles", "at least one BezierTriangles", "none")
    every = _trims(groups, trims)
    if attributes and len(groups) > 1:
        raise FileFormatError.expected("attributes", "patches of one degree", len(groups))
    own_points, own_cells = vtk_arrays(groups[0], attributes or {})
    if (fields or edges is not None) and len(groups) > 1:
        raise FileFormatError.expected("fields", "patches of one degree", len(groups))
    more_points, more_cells = field_arrays(groups[0], fields, edges)
    units = {name: f.unit for f in fields for name in (f.name, own_name(f)) if f.unit}
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
    if TCOORDS in own_points:
        flag += f' {TCOORDS}="{TCOORDS}"'
    own_points, own_cells = own_points | more_points, own_cells | more_cells
    point_data += [out.array(k, a, "Float64", unit=units.get(k, "")) for k, a in own_points.items()]
    cell_data = [out.array(k, a, "Float64", unit=units.get(k, "")) for k, a in own_cells.items()]
    field_data: list[str] = []
    if every is not None:
        for key, values in packed_trims(every).items():
            own = TRIM_ARRAYS[key]
            kind = "Float64" if values.dtype == np.float64 else "Int64"
            (field_data if own.field else cell_data).append(
                out.array(own.name, values, kind, tuples=own.field)
            )
        field_data = ["<FieldData>", *field_data, "</FieldData>"]
    if cell_data:
        cell_data = ["<CellData>", *cell_data, "</CellData>"]
    body = [
        *field_data,
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(sizes)}">',
        f"<PointData{flag}>",
        *point_data,
        "</PointData>",
        *cell_data,
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


def _trims(
    groups: list[BezierTriangles], trims: Trims | Sequence[Trims | None] | None
) -> Trims | None:
    """Return the trims of all patches, None if there are none."""
    parts = [trims] if trims is None or isinstance(trims, Trims) else list(trims)
    if all(part is None for part in parts):
        return None
    counts = [len(g) for g in groups]
    found = [len(t) if t is not None else n for t, n in zip(parts, counts)]
    if found != counts or len(parts) != len(groups):
        raise FileFormatError.expected("trims", f"those of {counts} patches", f"{found}")
    return Trims.join([Trims.none(n) if t is None else t for t, n in zip(parts, counts)])


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

    def array(
        self, name: str, values: np.ndarray, typename: str, tuples: bool = False, unit: str = ""
    ) -> str:
        name = escape(name, {'"': "&quot;", "\n": " "})
        told = f"<{_UNIT}>{escape(unit)}</InformationKey>\n" if unit else ""
        components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        if tuples:  # field data does not belong to points or cells, whose number is known
            components += f' NumberOfTuples="{len(values)}"'
        head = f'<DataArray type="{typename}" Name="{name}"{components} format="{self._encoding}"'
        if self._encoding == "ascii":
            rows = values if values.ndim == 2 else values[:, None]
            lines = (" ".join(map(repr, row)) for row in rows.tolist())
            return head + ">\n" + "\n".join(lines) + f"\n{told}</DataArray>"
        dtype = {"Float64": "<f8", "Int64": "<i8", "UInt8": "<u1"}[typename]
        header, data = self._compress(values.astype(dtype).tobytes())
        if self._encoding == "binary":
            text = (base64.b64encode(header) + base64.b64encode(data)).decode()
            return f"{head}>\n{text}\n{told}</DataArray>"
        offset = self._size
        self._appended += [header, data]
        self._size += len(header) + len(data)
        return f'{head} offset="{offset}"' + (f">{told}</DataArray>" if told else "/>")

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
