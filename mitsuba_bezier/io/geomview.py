"""Geomview's Bézier patches (``.bez``, ``.bbp``) and polygons (``.off``).

Source: the Geomview manual, "BBP and BEZ" and "OFF", http://www.geomview.org/docs/html/
"""

from __future__ import annotations

import re
from os import PathLike

import numpy as np

from ..geometry import bernstein
from .files import damaged, read_bytes
from .polygon_faces import PolygonFaces
from .report import Collector, Model
from .tensor_nets import homogeneous, tensor_nets
from .text import Tokens

__all__ = ["read", "read_off"]

_BEZ = re.compile(
    r"(?P<stbbp>(ST)?BBP)|(?P<color>C)?BEZ(?P<degrees>[1-6]{2})(?P<dim>[34])(?P<st>_ST)?"
)
_OFF = re.compile(r"(?P<st>ST)?(?P<color>C)?(?P<normal>N)?(?P<four>4)?(?P<n>n)?OFF")


def _skip_blocks(tokens: Tokens) -> None:
    """Skip opening braces and ``appearance { ... }`` before the object."""
    while tokens.peek() in ("{", "appearance"):
        if tokens.word("a keyword") == "{":
            continue
        depth = 0
        while True:
            word = tokens.word("the closing brace of 'appearance'")
            depth += (word == "{") - (word == "}")
            if depth <= 0:
                break


def _binary(path: str | PathLike[str]) -> None:
    head = read_bytes(path)[:4096]
    if re.search(rb"^\s*\w*(OFF|BEZ\d*|BBP)\w*\s+BINARY\b", head):
        raise damaged(path, "a text file", "Geomview's BINARY variant, which is not supported")


def read(path: str | PathLike[str]) -> Model:
    """Read a ``.bez`` or ``.bbp`` file: tensor-product patches of degree 1 to 6.

    Four components are homogeneous coordinates ``(w x, w y, w z, w)``, so control points may lie
    at infinity. Texture coordinates and colours are skipped and noted.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or holds no patch.
    """
    _binary(path)
    tokens = Tokens(path, apart="{}")
    _skip_blocks(tokens)
    keyword = tokens.word("a header such as BEZ334 or BBP")
    match = _BEZ.fullmatch(keyword)
    if not match:
        raise tokens.error("a header such as BEZ334 or BBP", repr(keyword[:40]), back=1)
    if match["stbbp"]:
        p = q = dim = 3
        textured = keyword.startswith("ST")
    else:
        p, q = map(int, match["degrees"])
        dim = int(match["dim"])
        textured = bool(match["st"])
    points = (p + 1) * (q + 1) * dim
    extra = 8 * textured + 16 * bool(match["color"])
    collector = Collector(path, "bez")
    count, rest = divmod(len(tokens), points + extra)
    if rest and not (rest <= 2 and count):  # closing braces are left
        count += 1
    rows = [tokens.numbers(points + extra, f"patch {k}")[:points] for k in range(count)]
    while len(tokens):
        if tokens.word("}") != "}":
            raise tokens.error("the end of the file", "more text", back=1)
    if rows:
        collector.expect(2 * bernstein.size(p + q) * count)
        nets = np.array(rows).reshape(count, q + 1, p + 1, dim).swapaxes(1, 2)  # v-major
        if dim == 3:
            nets = homogeneous(nets)
        collector.add(tensor_nets(nets), np.repeat(np.arange(count), 2))
        collector.report.accept(count)
    if extra:
        collector.report.notes.append("texture coordinates and colours of the corners are not used")
    return collector.model(lambda: damaged(path, "at least one patch", "none"))


def read_off(path: str | PathLike[str]) -> Model:
    """Read an ``.off`` file: convex polygons as Bézier triangles of degree 1.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or holds no face.
    """
    _binary(path)
    tokens = Tokens(path, apart="{}")
    _skip_blocks(tokens)
    match = _OFF.fullmatch(tokens.peek())
    if match:
        tokens.word("OFF")
    dim = 3
    if match and match["n"]:
        dim = tokens.integer("the dimension of nOFF", 3, 3)
    four = bool(match and match["four"])
    limit = len(tokens)  # each vertex and each face takes more than one word
    vertices = tokens.integer("the number of vertices", 1, limit)
    faces = tokens.integer("the number of faces", 0, limit)
    tokens.integer("the number of edges", -1, 10**12)
    width = dim + four
    if match:
        width += 3 * bool(match["normal"]) + 4 * bool(match["color"]) + 2 * bool(match["st"])
    points = tokens.numbers(vertices * width, "the vertices").reshape(vertices, width)
    corners = points[:, :4] if four else homogeneous(points[:, :3])
    collector = Collector(path, "off")
    polygons = PolygonFaces()
    for number in range(faces):
        size = tokens.integer(f"the number of corners of face {number}", 1, limit)
        line = tokens.line(back=1)
        name = f"a vertex of face {number}"
        index = [tokens.integer(name, 0, vertices - 1) for _ in range(size)]
        tokens.skip_line(line)  # colours
        polygons.add(number, corners[index])
    polygons.convert(collector)
    while tokens.peek() == "}":
        tokens.word("}")
    if len(tokens):
        collector.report.notes.append(
            f"{len(tokens)} words from line {tokens.line()} on stand behind the {faces} faces that "
            "the header announces, and are not read"
        )
    return collector.model(lambda: damaged(path, "at least one face", "none"))
