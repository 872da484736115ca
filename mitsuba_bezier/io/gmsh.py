"""Gmsh meshes (``.msh``, versions 2.2 and 4.1, text and binary) of any order.

Triangles, quadrilaterals (also the eight-node one) and the surface of tetrahedra, hexahedra, and
prisms and pyramids up to order 2 are converted, with the fields on them; what is left is reported.

Source: the Gmsh reference manual, "Gmsh file formats", https://gmsh.info/doc/texinfo/gmsh.html
"""

from __future__ import annotations

import re
from os import PathLike
from typing import Any

import numpy as np

from ..errors import FileFormatError
from .cells import Cells, add_cells
from .files import damaged, decode_text, has_mark, read_bytes
from .gmsh_fields import SECTIONS, View, named_views, read_view
from .lattices import (
    hexahedron_lattice,
    pyramid_lattice,
    quad_lattice,
    tetra_lattice,
    triangle_lattice,
    wedge_lattice,
)
from .report import Collector, Model
from .tensor_nets import homogeneous
from .text import Tokens
from .volume_faces import VOLUMES, add_surface, corner_keys, corner_keys_of_faces, part_of

__all__ = ["read"]

#: Element types: number to (kind, order, nodes).
_TYPES: dict[int, tuple[str, int, int]] = {15: ("point", 0, 1)}
for _n, _line, _tri, _quad, _tet, _hex in zip(
    range(1, 11),
    (1, 8, 26, 27, 28, 62, 63, 64, 65, 66),
    (2, 9, 21, 23, 25, 42, 43, 44, 45, 46),
    (3, 10, 36, 37, 38, 47, 48, 49, 50, 51),
    (4, 11, 29, 30, 31, 71, 72, 73, 74, 75),
    (5, 12, 92, 93, 94, 95, 96, 97, 98, 0),
):
    _TYPES[_line] = ("line", _n, _n + 1)
    _TYPES[_tri] = ("triangle", _n, (_n + 1) * (_n + 2) // 2)
    _TYPES[_quad] = ("quad", _n, (_n + 1) ** 2)
    _TYPES[_tet] = ("tetra", _n, (_n + 1) * (_n + 2) * (_n + 3) // 6)
    if _hex:
        _TYPES[_hex] = ("hexahedron", _n, (_n + 1) ** 3)
_TYPES |= {16: ("quad", 2, 8), 17: ("hexahedron", 2, 20)}
_TYPES |= {6: ("wedge", 1, 6), 13: ("wedge", 2, 18), 18: ("wedge", 2, 15)}
for _n, _prism in zip(range(3, 10), (90, 91, 106, 107, 108, 109, 110)):
    _TYPES[_prism] = ("prism", _n, (_n + 1) ** 2 * (_n + 2) // 2)
_TYPES |= {7: ("pyramid", 1, 5), 14: ("pyramid", 2, 14), 19: ("pyramid", 2, 13)}
_TYPES |= {20: ("incomplete triangle", 3, 9), 22: ("incomplete triangle", 4, 12)}
_TYPES |= {39: ("incomplete quad", 3, 12)}


#: Sections that hold no elements of their own.
_OTHERS = {
    *(
        "Comments",
        "PhysicalNames",
        "Entities",
        "PartitionedEntities",
        "Periodic",
        "Parametrizations",
    ),
    *(*SECTIONS, "InterpolationScheme", "GhostElements"),
}


class _Text:
    """A file of words."""

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path
        self._tokens = Tokens(path, comment="\0")  # there are no comments
        self.size = len(self._tokens)

    def error(self, expected: str, got: object) -> FileFormatError:
        return self._tokens.error(expected, got, back=1)

    def done(self) -> bool:
        return not len(self._tokens)

    def word(self, expected: str) -> str:
        return self._tokens.word(expected)

    header = word

    def quoted(self) -> str:
        """Take a string in quotation marks, which may have blanks."""
        words = [self.word("a string")]
        while not (words[-1].endswith('"') and len(" ".join(words)) > 1):
            if not words[0].startswith('"'):
                break
            words.append(self.word("a string in quotation marks"))
        return " ".join(words).strip('"')

    def real(self) -> float:
        return float(self.take("f8", 1, "a number")[0])

    def integer(self) -> int:
        return int(self.take("i4", 1, "a number")[0])

    def pair(self) -> tuple[int, int]:
        first, second = self.take("i4", 2, "an element and its nodes").tolist()
        return first, second

    def rows(self, count: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Take numbers of nodes or elements, each with values."""
        values = self.take("f8", (1 + width) * count, "values").reshape(count, -1)
        if not (np.abs(values[:, 0]) < 2**53).all():
            raise self.error("integers as numbers of nodes and elements", "others")
        return values[:, 0].astype(np.int64), values[:, 1:]

    def skip_to(self, word: str) -> bool:
        return self._tokens.skip_to(word)

    def take(self, dtype: str, count: int, name: str) -> np.ndarray:
        if dtype == "f8":
            return self._tokens.numbers(count, name)
        return self._tokens.integers(count, name)


class _Binary:
    """A file of binary numbers between lines of text."""

    def __init__(self, path: str | PathLike[str], data: bytes) -> None:
        self.path = path
        self._data = data
        self.size = len(data)
        self._at = 0
        self._order = "<"

    def error(self, expected: str, got: object) -> FileFormatError:
        return damaged(self.path, expected, got, offset=self._at)

    def done(self) -> bool:
        return not self._data[self._at :].strip() if self._at > self.size - 64 else False

    def word(self, expected: str) -> str:
        """Take the next word, and the character after it."""
        match = re.compile(rb"\s*(\S{1,64})").match(self._data, self._at)
        if not match:
            raise self.error(expected, "the end of the file")
        self._at = match.end() + 1
        return match[1].decode("latin-1")

    def header(self, expected: str) -> str:
        """Take a number in a line of its own; binary data follow at once."""
        return self.word(expected)

    def quoted(self) -> str:
        """Take a string in quotation marks, in a line of its own."""
        match = re.compile(rb"\s*([^\n]{0,1000})\n").match(self._data, self._at)
        if not match:
            raise self.error("a string in a line of its own", "other data")
        self._at = match.end()
        return match[1].decode("utf-8", "replace").strip().strip('"')

    def _line(self, pattern: str, expected: str) -> str:
        word = self.word(expected)
        if not re.fullmatch(pattern, word):
            raise self.error(expected, repr(word[:40]))
        return word

    def real(self) -> float:
        return float(self._line(r"[-+0-9.eE]{1,40}|-?nan|-?inf", "a number"))

    def integer(self) -> int:
        return int(self._line(r"-?[0-9]{1,18}", "an integer"))

    def pair(self) -> tuple[int, int]:
        first, second = self.take("i4", 2, "an element and its nodes").tolist()
        return first, second

    def rows(self, count: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Take numbers of nodes or elements, each with values."""
        row = np.dtype([("tag", self._order + "i4"), ("x", self._order + "f8", (width,))])
        if count * row.itemsize > self.size - self._at:
            raise self.error(f"{count} rows of values", "the end of the file")
        rows = np.frombuffer(self._data, row, count, self._at)
        self._at += count * row.itemsize
        return rows["tag"].astype(np.int64), rows["x"].astype(np.float64).reshape(count, width)

    def skip_to(self, word: str) -> bool:
        at = self._data.find(word.encode(), self._at)
        self._at = max(at, self._at)
        return at >= 0

    def take(self, dtype: str, count: int, name: str) -> np.ndarray:
        kind = np.dtype(self._order + dtype)
        if count * kind.itemsize > self.size - self._at:
            raise self.error(f"{count} numbers for {name}", "the end of the file")
        out = np.frombuffer(self._data, kind, count, self._at)
        self._at += count * kind.itemsize
        if dtype == "u8" and count and out.max() > np.iinfo(np.int64).max:
            raise self.error(f"numbers below 2**63 for {name}", out.max())
        return out.astype(np.float64 if dtype[0] == "f" else np.int64)

    def nodes(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Take the nodes of version 2.2: numbers and coordinates interleaved."""
        row = np.dtype([("tag", self._order + "i4"), ("x", self._order + "f8", 3)])
        if count * row.itemsize > self.size - self._at:
            raise self.error(f"{count} nodes", "the end of the file")
        rows = np.frombuffer(self._data, row, count, self._at)
        self._at += count * row.itemsize
        return rows["tag"].astype(np.int64), rows["x"].astype(np.float64)

    def byte_order(self) -> None:
        """Take the number 1, which tells the byte order."""
        one = self._data[self._at : self._at + 4]
        if one not in (b"\0\0\0\1", b"\1\0\0\0"):
            raise self.error("the number 1 in binary", repr(one))
        self._order = ">" if one[3] else "<"
        self._at += 4


_File = _Text | _Binary


def _count(file: _File, dtype: str, name: str) -> int:
    """Take a number of things, each of which takes a byte or a word at least."""
    value = int(file.take(dtype, 1, name)[0])
    if not 0 <= value <= file.size:
        raise file.error(f"{name} that fits the size of the file", value)
    return value


def _header(file: _File, name: str) -> int:
    """Take a number in a line of its own, which is text in version 2.2 always."""
    text = file.header(name)
    if not re.fullmatch(r"[0-9]{1,18}", text) or int(text) > file.size:
        raise file.error(f"{name} that fits the size of the file", repr(text[:40]))
    return int(text)


def read(path: str | PathLike[str], fields: bool = False) -> Model:
    """Read the surface elements of a ``.msh`` file, and the surface of its volume elements.

    Parameters
    ----------
    path : path
        The file.
    fields : bool
        Whether node and element data are read.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, of another version, or holds no surface.
    """
    data = read_bytes(path)
    if has_mark(data):
        data = decode_text(path, data).encode()
    start = re.match(rb"\s*\$MeshFormat\s+(\S{1,20})\s+([01])\s+(\S{1,20})[ \t\r]*\n?", data)
    if not start:
        raise damaged(
            path, "$MeshFormat with version, file type and data size", "other text", line=1
        )
    version = {b"2.2": 2, b"2": 2, b"4.1": 4}.get(start[1])
    if version is None:
        got = start[1].decode("latin-1")
        raise damaged(path, "version 2.2 or 4.1 (gmsh IN -save -format msh41)", repr(got), line=2)
    file: _File
    if start[2] == b"1":
        if start[3] != b"8":
            got = start[3].decode("latin-1")
            raise damaged(path, "a data size of 8 bytes", repr(got), line=2)
        file = _Binary(path, data)
    else:
        file = _Text(path)
    nodes: list[tuple[np.ndarray, np.ndarray]] = []
    elements: dict[int, list[np.ndarray]] = {}
    unknown: set[str] = set()
    views: list[View] = []
    for _ in range(4):  # $MeshFormat and its three words
        file.word("$MeshFormat")
    if isinstance(file, _Binary):
        file.byte_order()
    _end(file, "$MeshFormat")
    while not file.done():
        name = file.word("a section such as $Nodes")
        if not re.fullmatch(r"\$\w+", name):
            raise file.error("a section such as $Nodes", repr(name[:40]))
        if name == "$Nodes":
            (_read_nodes_2 if version == 2 else _read_nodes_4)(file, nodes)
        elif name == "$Elements":
            (_read_elements_2 if version == 2 else _read_elements_4)(file, elements)
        elif fields and name[1:] in SECTIONS:
            views.append(read_view(file, name[1:]))
        elif not file.skip_to(f"$End{name[1:]}"):
            raise file.error(f"$End{name[1:]}", "the end of the file")
        elif name[1:] not in _OTHERS:
            unknown.add(name[:40])
        _end(file, name)
    collector = Collector(path, "msh")
    if unknown:
        collector.report.notes.append(
            f"unknown sections, which are not read: {', '.join(sorted(unknown)[:20])}"
        )
    if elements:
        tags = np.concatenate([np.zeros(0, np.int64), *(tag for tag, _x in nodes)])
        points = np.concatenate([np.zeros((0, 3)), *(x for _tag, x in nodes)])
        _convert(file, collector, tags, points, elements, views)
    return collector.model(lambda: damaged(path, "surface elements", "none in this file"))


def _end(file: _File, name: str) -> None:
    word = file.word(f"$End{name[1:]}")
    if word != f"$End{name[1:]}":
        raise file.error(f"$End{name[1:]}", repr(word[:40]))


def _read_nodes_2(file: _File, nodes: list[Any]) -> None:
    count = _header(file, "the number of nodes")
    if isinstance(file, _Binary):
        nodes.append(file.nodes(count))
        return
    values = file.take("f8", 4 * count, "the nodes").reshape(-1, 4)
    if not (np.abs(values[:, 0]) < 2**53).all():
        raise file.error("integers as numbers of nodes", "others")
    nodes.append((values[:, 0].astype(np.int64), values[:, 1:]))


def _read_nodes_4(file: _File, nodes: list[Any]) -> None:
    blocks = _count(file, "u8", "the number of blocks of nodes")
    file.take("u8", 3, "the header of $Nodes")
    for _ in range(blocks):
        dim, _tag, parametric = file.take("i4", 3, "a block of nodes").tolist()
        count = _count(file, "u8", "the number of nodes")
        tags = file.take("u8", count, "numbers of nodes")
        if not 0 <= dim <= 3:
            raise file.error("a dimension from 0 to 3", dim)
        width = 3 + (dim if parametric else 0)
        nodes.append((tags, file.take("f8", width * count, "nodes").reshape(-1, width)[:, :3]))


def _size(file: _File, kind: int) -> int:
    if kind not in _TYPES:
        raise file.error("a known type of element", f"type {kind}")
    return _TYPES[kind][2]


def _read_elements_2(file: _File, elements: dict[int, Any]) -> None:
    left = _header(file, "the number of elements")
    if isinstance(file, _Text):
        for _ in range(left):
            number, kind, labels = file.take("i4", 3, "an element").tolist()
            if not 0 <= labels <= 1000:
                raise file.error("a number of tags", labels)
            row = file.take("i4", labels + _size(file, kind), "the nodes of an element")
            keep = [number, *row[labels:].tolist()]
            elements.setdefault(kind, []).append(np.array([keep], dtype=np.int64))
        return
    while left > 0:
        kind, count, labels = file.take("i4", 3, "a block of elements").tolist()
        if not (0 < count <= left and 0 <= labels <= 1000):
            raise file.error("a count and a number of tags", f"{count}, {labels}")
        width = 1 + labels + _size(file, kind)
        rows = file.take("i4", width * count, "elements").reshape(-1, width)
        elements.setdefault(kind, []).append(np.delete(rows, slice(1, 1 + labels), axis=1))
        left -= count


def _read_elements_4(file: _File, elements: dict[int, Any]) -> None:
    blocks = _count(file, "u8", "the number of blocks of elements")
    file.take("u8", 3, "the header of $Elements")
    for _ in range(blocks):
        _dim, _tag, kind = file.take("i4", 3, "a block of elements").tolist()
        count = _count(file, "u8", "the number of elements")
        width = 1 + _size(file, kind)
        rows = file.take("u8", width * count, "elements").reshape(-1, width)
        elements.setdefault(kind, []).append(rows)


def _lattice(kind: str, n: int) -> np.ndarray:
    """Return where the nodes of an element of order n lie."""
    if kind in ("wedge", "pyramid"):
        return (wedge_lattice if kind == "wedge" else pyramid_lattice)(n)
    if kind == "quad":
        return quad_lattice(n, n, "gmsh")
    if kind == "tetra":
        return tetra_lattice(n, "gmsh")
    return triangle_lattice(n) if kind == "triangle" else hexahedron_lattice(n)


def _better(surfaces: list[Cells], volumes: list[Cells]) -> list[Cells]:
    """Leave out surface elements on which a field has no values that a volume element has."""
    names = {name for part in surfaces + volumes for name in part.fields}
    corners = {tuple(row) for v in volumes for row in corner_keys_of_faces(v).tolist()}
    out = []
    for part in surfaces:
        lacks = np.zeros(len(part.nodes), bool)
        for name in names:
            if name in part.fields:
                own = part.fields[name]
                lacks |= np.isnan(own.values[own.nodes]).all(axis=(1, 2))
            else:
                lacks[:] = True
        if lacks.any():
            on = [tuple(row) in corners for row in corner_keys(part).tolist()]
            part = part_of(part, ~(lacks & on))
        if len(part.nodes):
            out.append(part)
    return out


def _convert(
    file: _File,
    collector: Collector,
    tags: np.ndarray,
    points: np.ndarray,
    elements: dict[int, list[np.ndarray]],
    views: list[View],
) -> None:
    """Convert elements, rows of a number and nodes; `tags` are those of nodes, in any order."""
    order = np.argsort(tags, kind="stable")
    ordered = tags[order]
    surfaces: list[Cells] = []
    volumes: list[Cells] = []
    schemes = sorted({repr(v.name[:40]) for v in views if v.scheme})
    if schemes:
        collector.report.notes.append(
            f"fields with interpolation schemes of their own are not read: {', '.join(schemes)}"
        )
    named = named_views([v for v in views if not v.scheme])
    at_nodes = {name: v.at_nodes(tags) for name, v in named.items() if v.kind == "node"}
    for number in sorted(elements):
        kind, n, _size = _TYPES[number]
        rows = np.concatenate(elements[number])
        numbers, nodes = rows[:, 0], rows[:, 1:]
        if kind in ("point", "line"):
            collector.report.remarks.append(f"{len(nodes)} elements of type {number} ({kind})")
            continue
        if kind not in ("triangle", "quad", *VOLUMES):
            name = f"elements of type {number}"
            collector.report.refuse(name, f"{kind}: not supported", len(nodes))
            continue
        at = np.searchsorted(ordered, nodes)
        at[at == len(ordered)] = 0
        if not len(ordered) or (ordered[at] != nodes).any():
            raise damaged(
                file.path, "elements of nodes that are in $Nodes", f"others (type {number})"
            )
        rows = order[at]
        lattice = _lattice(kind, n)[: rows.shape[1]]
        found = {}
        for name, view in named.items():
            own = view.on_cells(numbers, lattice, rows, at_nodes.get(name, tags))
            if own is not None:
                found[name] = own
        into = volumes if kind in VOLUMES else surfaces
        into.append(Cells(kind, lattice, rows, fields=found))
    net_points = homogeneous(points)
    if named:
        surfaces = _better(surfaces, volumes)
    for cells in surfaces:
        source = collector.report.faces + np.arange(len(cells.nodes))
        add_cells(collector, cells, net_points, source)
    add_surface(collector, volumes, surfaces, net_points, collector.report.faces)
