"""VTK's legacy files (``.vtk``), text and binary, versions 1.0 to 5.1.

Unstructured grids and polygons are read, with point and cell data; these files cannot say weights
of rational cells. Source: "VTK File Formats", "Simple Legacy Formats".
"""

from __future__ import annotations

import re
from os import PathLike
from typing import NoReturn
from urllib.parse import unquote

import numpy as np

from ..files import damaged, decode_text, has_mark, read_bytes
from ..limits import check_memory
from ..report import Collector, Model
from .grid import Array, add_grid, note_ghosts
from .parallel import plain_grid
from .reader import finished

__all__ = ["read"]

_TYPES = {
    "bit": "bit",
    "unsigned_char": "u1",
    "char": "i1",
    "unsigned_short": "u2",
    "short": "i2",
    "unsigned_int": "u4",
    "int": "i4",
    "unsigned_long": "u8",
    "long": "i8",
    "vtktypeint64": "i8",
    "vtktypeuint64": "u8",
    "vtkidtype": "i4",
    "float": "f4",
    "double": "f8",
}
#: Sections of polygons and the cell type of each.
_POLYGONS = {"VERTICES": 2, "LINES": 4, "POLYGONS": 7, "TRIANGLE_STRIPS": 6}
#: Components of attributes whose keyword tells their number.
_COMPONENTS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}


class _File:
    """The contents, read word by word or as numbers."""

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path
        data = read_bytes(path)
        if has_mark(data):
            data = decode_text(path, data).encode()
        form = re.search(rb"[\r\n]\s*(ASCII|BINARY)\s*[\r\n]", data[:2000], re.I)
        self.binary = form is not None and form[1].upper() == b"BINARY"
        if not self.binary:  # lines may end in any way
            data = decode_text(path, data).encode()
        self.data, self.at = data, 0
        first = self.line()
        match = re.match(r"#\s*vtk\s+DataFile\s+Version\s+(\d{1,3})\.(\d{1,3})", first, re.I)
        if not match:
            self.fail("# vtk DataFile Version 1.0 to 5.1", repr(first[:40]))
        self.version = int(match[1]), int(match[2])
        for _ in range(10):  # a title, empty lines
            if (word := self.line().strip().upper()) in ("ASCII", "BINARY"):
                break
        else:
            self.fail("ASCII or BINARY", repr(word[:40]))

    def fail(self, expected: str, got: object) -> NoReturn:
        raise damaged(self.path, expected, got, offset=self.at)

    def line(self) -> str:
        """Take the rest of the line."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        text = self.data[self.at : end].decode("utf-8", "replace")
        self.at = min(end + 1, len(self.data))
        return text.rstrip("\r")

    def words(self) -> list[str]:
        """Take the next line that is not empty, as words; none at the end."""
        while self.at < len(self.data):
            words = self.line().split()
            if words:
                return words
        return []

    def count(self, word: str, what: str) -> int:
        if not re.fullmatch(r"[0-9]{1,12}", word) or int(word) > 8 * len(self.data):
            self.fail(f"a number of {what} that fits the size of the file", repr(word[:40]))
        return int(word)

    def array(self, typename: str, count: int, what: str) -> np.ndarray:
        """Take numbers; float64, or int64 for integers."""
        dtype = _TYPES.get(typename.lower())
        if dtype is None:
            self.fail(f"a type of numbers for {what}", repr(typename[:40]))
        check_memory(self.path, 24 * count, f"{count} numbers for {what}")
        if self.binary:
            return self._binary(dtype, count, what)
        wide = np.float64 if dtype[0] == "f" else np.int64
        out: list[str] = []
        while len(out) < count:
            if self.at >= len(self.data):
                self.fail(f"{count} numbers for {what}", "the end of the file")
            out += self.line().split()
        if len(out) > count:
            self.fail(f"{count} numbers for {what}, and then a new line", f"{len(out)} words")
        try:
            return np.array(out, dtype=wide)
        except (ValueError, OverflowError):
            pass
        try:  # integers that are written as 1.0
            return np.array(out, dtype=np.float64).astype(wide)
        except (ValueError, OverflowError):
            self.fail(f"numbers for {what}", "other words")

    def _binary(self, dtype: str, count: int, what: str) -> np.ndarray:
        size = -(-count // 8) if dtype == "bit" else count * np.dtype(dtype).itemsize
        if size > len(self.data) - self.at:
            self.fail(f"{count} numbers for {what}", "the end of the file")
        if dtype == "bit":
            raw = np.frombuffer(self.data, np.uint8, size, self.at)
            self.at += size
            return np.unpackbits(raw)[:count].astype(np.int64)
        out = np.frombuffer(self.data, np.dtype(">" + dtype), count, self.at)
        self.at += size
        return out.astype(np.float64 if dtype[0] == "f" else np.int64)


def read(path: str | PathLike[str], fields: bool = False) -> Model:
    """Read a ``.vtk`` file.

    Raises
    ------
    FileFormatError
        If it is missing, damaged, of another kind of data, or without a surface.
    """
    file = _File(path)
    words = file.words()
    kind = words[1].upper() if len(words) > 1 and words[0].upper() == "DATASET" else ""
    if kind not in ("UNSTRUCTURED_GRID", "POLYDATA"):
        file.fail("DATASET UNSTRUCTURED_GRID or POLYDATA", repr(" ".join(words)[:60]))
    collector = Collector(path, "vtk")
    points = np.zeros((0, 3))
    blocks: list[tuple[int, np.ndarray, np.ndarray]] = []  # cell type, sizes, nodes
    types = np.zeros(0, np.int64)
    arrays: dict[str, dict[str, Array]] = {"POINT_DATA": {}, "CELL_DATA": {}}
    where = ""
    while words := file.words():
        keyword = words[0].upper()
        if keyword == "POINTS" and len(words) > 2:
            count = file.count(words[1], "points")
            points = file.array(words[2], 3 * count, "points").reshape(-1, 3).astype(np.float64)
        elif keyword in ("CELLS", *_POLYGONS) and len(words) > 2:
            sizes, nodes = _cells(file, words)
            blocks.append((_POLYGONS.get(keyword, 0), sizes, nodes))
        elif keyword == "CELL_TYPES" and len(words) > 1:
            types = file.array("int", file.count(words[1], "cells"), "cell types")
        elif keyword in ("POINT_DATA", "CELL_DATA") and len(words) > 1:
            where, count = keyword, file.count(words[1], "values")
        elif keyword == "METADATA":
            while file.at < len(file.data) and file.line().strip():
                pass
        elif keyword == "FIELD" and len(words) > 2:
            own = _field(file, file.count(words[2], "arrays"), collector)
            for name, array in own.items():
                if where and len(array) == count:
                    arrays[where][name] = Array(array.astype(np.float64))
                elif not where:
                    collector.report.remarks.append(f"field data that are not used: {name!r}")
        elif where:
            found = _attribute(file, words, count, collector)
            if found is not None:
                arrays[where][found[0]] = Array(found[1].astype(np.float64))
        else:
            file.fail("a section such as POINTS or CELLS", repr(keyword[:40]))
    _add(file, collector, points, blocks, types, arrays if fields else {})
    return finished(path, collector)


def _cells(file: _File, words: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return how many nodes cells have, and all nodes."""
    first, second = file.count(words[1], "cells"), file.count(words[2], "nodes")
    if file.version >= (5, 0):
        head = file.words()
        if len(head) != 2 or head[0].upper() != "OFFSETS":
            file.fail("OFFSETS and a type", repr(" ".join(head)[:40]))
        offsets = file.array(head[1], first, "offsets")
        head = file.words()
        if len(head) != 2 or head[0].upper() != "CONNECTIVITY":
            file.fail("CONNECTIVITY and a type", repr(" ".join(head)[:40]))
        nodes = file.array(head[1], second, "the nodes of cells")
        sizes = np.diff(offsets)
        if first and (offsets[0] != 0 or (sizes < 0).any() or offsets[-1] != len(nodes)):
            file.fail("offsets that grow to the number of nodes", "others")
        return sizes, nodes
    rows = file.array("int", second, "the nodes of cells")
    sizes = np.empty(first, np.int64)
    keep = np.ones(len(rows), bool)
    at = 0
    for k in range(first):
        if at >= len(rows) or not 0 <= rows[at] < len(rows) - at:
            file.fail(f"{first} cells in {second} numbers", f"others from cell {k} on")
        sizes[k] = rows[at]
        keep[at] = False
        at += int(rows[at]) + 1
    if at != len(rows):
        file.fail(f"{first} cells in {second} numbers", f"{at}")
    return sizes, rows[keep]


def _field(file: _File, count: int, collector: Collector) -> dict[str, np.ndarray]:
    """Read the arrays of a FIELD."""
    out: dict[str, np.ndarray] = {}
    while len(out) < count:
        words = file.words()
        if words and words[0].upper() == "METADATA":
            while file.at < len(file.data) and file.line().strip():
                pass
            continue
        if len(words) != 4:
            file.fail("name, components, tuples and type of an array", repr(" ".join(words)[:60]))
        if words[3].lower() == "string":
            file.fail("arrays of numbers", "strings")
        width, rows = file.count(words[1], "components"), file.count(words[2], "tuples")
        values = file.array(words[3], width * rows, f"array {words[0][:40]!r}")
        out[unquote(words[0])] = values.reshape(rows, max(width, 1))
    return out


def _attribute(
    file: _File, words: list[str], count: int, collector: Collector
) -> tuple[str, np.ndarray] | None:
    """Read an attribute of points or cells; None for one that is no field."""
    keyword, name = words[0].upper(), unquote(words[1]) if len(words) > 1 else ""
    if keyword == "SCALARS" and len(words) in (3, 4):
        width = file.count(words[3], "components") if len(words) == 4 else 1
        start = file.at
        if (file.words() or [""])[0].upper() != "LOOKUP_TABLE":
            file.at = start
        return name, file.array(words[2], width * count, f"array {name!r}").reshape(count, -1)
    if keyword in _COMPONENTS and len(words) == 3:
        width = _COMPONENTS[keyword]
        values = file.array(words[2], width * count, f"array {name!r}")
        return name, values.reshape(count, width)
    if keyword == "TEXTURE_COORDINATES" and len(words) == 4:
        width = file.count(words[2], "components")
        return name, file.array(words[3], width * count, f"array {name!r}").reshape(count, -1)
    if keyword in ("GLOBAL_IDS", "PEDIGREE_IDS") and len(words) == 3:
        return name, file.array(words[2], count, f"array {name!r}").reshape(count, 1)
    if keyword == "LOOKUP_TABLE" and len(words) == 3:
        size = file.count(words[2], "colours")
        file.array("unsigned_char" if file.binary else "float", 4 * size, "a lookup table")
        collector.report.remarks.append(f"a lookup table that is not used: {name!r}")
        return None
    if keyword == "COLOR_SCALARS" and len(words) == 3:
        width = file.count(words[2], "components")
        kind = "unsigned_char" if file.binary else "float"
        values = file.array(kind, width * count, f"array {name!r}").reshape(count, -1)
        return name, values / 255.0 if file.binary else values
    file.fail("an attribute such as SCALARS or FIELD", repr(" ".join(words)[:60]))


def _add(
    file: _File,
    collector: Collector,
    points: np.ndarray,
    blocks: list[tuple[int, np.ndarray, np.ndarray]],
    types: np.ndarray,
    arrays: dict[str, dict[str, Array]],
) -> None:
    """Convert what was read."""
    if not blocks:
        return
    order = sorted(blocks, key=lambda block: (2, 4, 7, 6, 0).index(block[0]))
    sizes = np.concatenate([block[1] for block in order])
    nodes = np.concatenate([block[2] for block in order])
    if order[0][0]:
        kinds = []
        for kind, own, _nodes in order:
            small = np.select([own == 3, own == 4], [5, 9], 7)
            kinds.append(small if kind == 7 else np.full(len(own), kind))
        types = np.concatenate(kinds)
    if len(types) != len(sizes):
        file.fail(f"{len(sizes)} cell types", len(types))
    grid = plain_grid(points, types, sizes, nodes)
    # VTK 9.1 changed the order of hexahedra, with version 5.1 of these files
    grid.old_order = file.version < (5, 1)
    for where, table in arrays.items():
        total = len(points) if where == "POINT_DATA" else len(types)
        for name, array in table.items():
            if len(array.values) != total:
                file.fail(f"{total} values of {name!r}", len(array.values))
        target = grid.point_arrays if where == "POINT_DATA" else grid.cell_arrays
        target.update(table)
    ghosts = add_grid(collector, grid, 0, lambda expected, got: damaged(file.path, expected, got))
    note_ghosts(collector, ghosts)
