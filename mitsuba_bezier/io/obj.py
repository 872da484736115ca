"""Free-form surfaces of Wavefront's ``.obj``: Bézier and B-spline, rational or not.

Read: ``v`` (with weight), ``cstype [rat] bezier`` and ``[rat] bspline``, ``deg``, ``parm``,
``surf`` with its parameter range, ``trim`` and ``hole`` by curves (``curv2``, of the bases cardinal
and taylor, too), ``end`` and the older ``bzp``. Surfaces of other bases are reported, as are the
older patches ``bsp`` and ``cdp``. Polygons (``f``) are left to programs for meshes, and counted;
so is every statement that is not known.

Source: "Advanced Visualizer Manual, Appendix B1: Object Files", Wavefront; for instance
http://paulbourke.net/dataformats/obj/
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from .files import damaged, read_text
from .limits import check_memory
from .nurbs import bezier_matrices, check_knots
from .obj_trims import bezier_form, grid_of_range, trimmed_surface
from .report import Collector, Model
from .tensor_nets import homogeneous, tensor_nets
from .text import numbers
from .trims import rectilinear, trimmed

__all__ = ["read"]

_MAX_DEGREE = 30

#: Bytes a piece of a trimming curve takes, as an array of its own and in the tests of its loop.
_PIECE = 1000

_INDEX = re.compile(r"[+-]?[0-9]{1,18}")

#: Statements of names, which may end in a backslash that belongs to a path.
_NAMES = frozenset(
    ("g", "o", "mtllib", "usemtl", "usemap", "maplib", "call", "csh", "shadow_obj", "trace_obj")
)
#: Statements that say nothing about surfaces.
_HARMLESS = _NAMES - {"call", "csh"} | frozenset(
    ("vt", "vn", "s", "mg", "lod", "bevel", "c_interp", "d_interp", "ctech", "stech", "res")
)
#: Statements whose effect on the surfaces is not reproduced, or which are none: told as remarks.
_REMARKS = {
    "p": "points",
    "l": "lines",
    "curv": "curves in space",
    "cdc": "curves in space",
    "con": "connections of surfaces",
    "scrv": "special curves on surfaces",
    "sp": "special points on surfaces",
    "bmat": "matrices of bases that are not read",
    "step": "steps of bases that are not read",
}
#: Patches of an older time.
_OLD_PATCHES = {"bsp": "B-spline", "cdp": "Cardinal"}


@dataclass
class _Block:
    """A free-form element between ``surf`` or ``curv2`` and ``end``."""

    kind: str
    arguments: list[str]
    line: int
    cstype: tuple[bool, str]
    degrees: list[int]
    parm: dict[str, list[float]] = field(default_factory=dict)
    loops: list[tuple[str, list[str]]] = field(default_factory=list)


@dataclass
class _Curve:
    """A B-spline curve in (u, v): points ``(m, 3)``, homogeneous, positive weights."""

    net: np.ndarray
    knots: np.ndarray
    degree: int

    def pieces(self, start: float, stop: float) -> np.ndarray:
        """Return Bézier points ``(S, p+1, 3)``, homogeneous, from parameter `start` to `stop`."""
        low, high = sorted((start, stop))
        matrices, first, intervals = bezier_matrices(self.knots, self.degree, (low, high))
        inside = (intervals.mean(axis=1) > low) & (intervals.mean(axis=1) < high)
        net = self.net[first[inside, None] + np.arange(self.degree + 1)]
        out = matrices[inside] @ net
        return out if start <= stop else out[::-1, ::-1]


class _Reader:
    def __init__(self, path: str | PathLike[str], trims: bool = False) -> None:
        self.path = path
        self.trims = trims
        self.collector = Collector(path, "obj")
        self.vertices: list[list[float]] = []  # x, y, z, weight
        self.parameters: list[list[float]] = []  # u, v, weight
        self.cstype = (False, "")
        self.degrees: list[int] = []
        self.block: _Block | None = None
        self.curves: list[_Curve | None] = []  # None: of a type that is not read
        self.faces = 0
        self.pieces = 0  # of trimming curves, as often as they are used
        self.remarks: dict[str, int] = {}
        self.unknown: dict[str, list[int]] = {}  # their lines
        self.line = 0

    def error(self, expected: str, got: object) -> Any:
        return damaged(self.path, expected, got, line=self.line)

    def numbers(self, words: list[str], low: int, high: int, name: str) -> list[float]:
        if not low <= len(words) <= high:
            wanted = f"{low} to {high}" if high < 10**9 else f"at least {low}"
            raise self.error(f"{wanted} numbers after {name!r}", len(words))
        out = numbers(words)
        if out is None:
            bad = next(word for word in words if numbers([word]) is None)
            raise self.error(f"finite numbers after {name!r}", repr(bad[:60]))
        return out.tolist()

    def index(self, word: str, count: int, name: str) -> int:
        """Return an index from 0: from 1 in the file, negative ones count from the end."""
        text = word.split("/")[0]
        number = int(text) if _INDEX.fullmatch(text) else 0
        at = number - 1 if number > 0 else count + number
        if number == 0 or not 0 <= at < count:
            raise self.error(f"the number of one of the {count} {name} so far", repr(word[:40]))
        return at

    def statement(self, keyword: str, words: list[str]) -> None:
        if keyword == "v":
            x = self.numbers(words, 3, 8, "v")  # programs append colours
            self.vertices.append([*x[:3], x[3] if len(x) == 4 else 1.0])
        elif keyword == "vp":
            x = self.numbers(words, 1, 3, "vp")
            self.parameters.append([x[0], x[1] if len(x) > 1 else 0.0, x[2] if len(x) > 2 else 1.0])
        elif keyword in ("f", "fo"):
            self.faces += 1
        elif keyword == "cstype":
            rational = words[:1] == ["rat"]
            rest = words[rational:]
            if len(rest) != 1:
                raise self.error("'cstype [rat] TYPE'", " ".join(words)[:60])
            self.cstype = (rational, rest[0])
        elif keyword == "deg":
            degrees = self.numbers(words, 1, 2, "deg")
            if not all(d == int(d) and 1 <= d <= _MAX_DEGREE for d in degrees):
                raise self.error(f"degrees from 1 to {_MAX_DEGREE}", " ".join(words)[:60])
            self.degrees = [int(d) for d in degrees]
        elif keyword in ("surf", "curv", "curv2"):
            self.closed()
            if keyword == "curv":
                self.remark("curv")
            self.block = _Block(keyword, words, self.line, self.cstype, self.degrees)
        elif keyword == "parm":
            if self.block is None or not words:
                raise self.error("'parm u ...' after 'surf' or 'curv'", " ".join(words)[:60])
            if words[0] not in ("u", "v"):
                raise self.error("'parm u' or 'parm v'", repr(words[0][:40]))
            self.block.parm[words[0]] = self.numbers(words[1:], 2, 10**9, "parm")
        elif keyword in ("trim", "hole"):
            if self.block is None:
                raise self.error(f"{keyword!r} after 'surf'", "none before it")
            self.block.loops.append((keyword, words))
        elif keyword == "end" and self.block is not None:
            block, self.block = self.block, None
            if block.kind == "surf":
                self.surface(block)
            elif block.kind == "curv2":
                self.curves.append(self.curve(block))
        elif keyword == "bzp":
            self.block = None
            points = self.points(words)
            if len(points) != 16:
                raise self.error("16 vertices after 'bzp'", len(points))
            face = self.collector.report.faces
            tensor = points.reshape(1, 4, 4, 4).swapaxes(1, 2)
            self.collector.add(tensor_nets(tensor), face)
            self.collector.report.accept()
        elif keyword in _OLD_PATCHES:
            name = f"{keyword} in line {self.line}"
            kind = _OLD_PATCHES[keyword]
            self.collector.report.refuse(name, f"{kind} patches of the older form are not read")
        elif keyword in _REMARKS:
            self.remark(keyword)
        elif keyword not in _HARMLESS:
            self.unknown.setdefault(keyword, []).append(self.line)

    def remark(self, keyword: str) -> None:
        self.remarks[keyword] = self.remarks.get(keyword, 0) + 1

    def closed(self) -> None:
        """Raise an error if a free-form element is not ended yet."""
        if self.block is not None:
            raise damaged(
                self.path,
                f"'end' after {self.block.kind!r}",
                f"none before line {self.line}",
                line=self.block.line,
            )

    def account(self) -> None:
        """Record what was not read."""
        report = self.collector.report
        if self.faces:
            report.refuse("f", "polygons, not free-form surfaces", self.faces)
        for keyword, count in self.remarks.items():
            report.remarks.append(f"{count} statements {keyword!r}: {_REMARKS[keyword]}")
        for keyword, lines in list(self.unknown.items())[:20]:
            report.notes.append(
                f"{len(lines)} statements {keyword[:40]!r} (line {lines[0]}) are not known, and "
                "not read"
            )
        if len(self.unknown) > 20:
            report.notes.append(f"{len(self.unknown) - 20} more words are not known, and not read")

    def points(self, words: list[str]) -> np.ndarray:
        """Return homogeneous control points; the weight counts for rational types only."""
        count = len(self.vertices)
        return np.array([self.vertices[self.index(word, count, "vertices")] for word in words])

    def curve(self, block: _Block) -> _Curve | None:
        """Return a curve in (u, v), None if it is of a type that is not read."""
        rational, kind = block.cstype
        if kind not in ("bezier", "bspline", "cardinal", "taylor") or not block.degrees:
            return None
        count = len(self.parameters)
        rows = [self.parameters[self.index(w, count, "vp")] for w in block.arguments]
        net = np.array(rows).reshape(-1, 3)
        if not rational:
            net[:, 2] = 1.0
        if kind != "taylor":
            if (net[:, 2] <= 0).any():  # then the curve may leave the hull of its points
                return None
            net[:, :2] *= net[:, 2:]
        p = block.degrees[0]
        if kind in ("cardinal", "taylor"):
            spans = len(block.parm.get("u", ())) - 1
            form = bezier_form(kind, net if rational else net[:, :2], p, spans)
            if form is None:
                return None
            net, kind = form if rational else np.column_stack([form, np.ones(len(form))]), "bezier"
            if (net[:, 2] <= 0).any():
                return None
        try:
            knots = check_knots(self.knots(block, "u", p, len(net), kind), p, len(net))
        except GeometryError as error:
            raise damaged(self.path, "a curve in (u, v)", error, line=block.line) from None
        return _Curve(net, knots, p)

    def knots(self, block: _Block, axis: str, degree: int, count: int, kind: str) -> list[float]:
        """Return the knots; those of a Bézier curve are its breaks, p-fold."""
        parm = block.parm.get(axis)
        if parm is None:
            raise damaged(self.path, f"'parm {axis}' before 'end'", "none", line=block.line)
        if kind == "bspline":
            return parm
        if count != degree * (len(parm) - 1) + 1:
            raise damaged(
                self.path,
                f"{degree * (len(parm) - 1) + 1} control points along {axis} for "
                f"{len(parm) - 1} Bézier pieces of degree {degree}",
                count,
                line=block.line,
            )
        return [parm[0], *(t for t in parm for _ in range(degree)), parm[-1]]

    def surface(self, block: _Block) -> None:
        report = self.collector.report
        face = report.faces
        name = f"surf in line {block.line}"
        rational, kind = block.cstype
        if kind not in ("bezier", "bspline"):
            report.refuse(name, f"cstype {kind or 'not given'}: only bezier and bspline are read")
            return
        if len(block.degrees) != 2:
            raise damaged(self.path, "'deg' with two degrees", block.degrees, line=block.line)
        here, self.line = self.line, block.line
        s0, s1, t0, t1 = self.numbers(block.arguments[:4], 4, 4, "surf")
        net = self.points(block.arguments[4:]).reshape(-1, 4)
        self.line = here
        if not rational:
            net = net.copy()
            net[:, 3] = 1.0
        net = homogeneous(net[:, :3], net[:, 3])
        p, q = block.degrees
        parm_u, parm_v = block.parm.get("u"), block.parm.get("v")
        if parm_u is None or parm_v is None:
            raise damaged(self.path, "'parm u' and 'parm v' before 'end'", "none", line=block.line)
        if kind == "bspline":
            m, n = len(parm_u) - p - 1, len(parm_v) - q - 1
        else:
            m, n = p * (len(parm_u) - 1) + 1, q * (len(parm_v) - 1) + 1
        if m < 1 or n < 1 or len(net) != m * n:
            raise damaged(
                self.path, f"{m} x {n} control points after 'surf'", len(net), line=block.line
            )
        knots_u = self.knots(block, "u", p, m, kind)
        knots_v = self.knots(block, "v", q, n, kind)
        if not (s0 < s1 and t0 < t1):
            raise damaged(
                self.path, "a range s0 < s1, t0 < t1", f"{s0} {s1} {t0} {t1}", line=block.line
            )
        # 1e-9 of the range: parameters are written with nine digits or so
        tolerance = 1e-9 * np.array([s1 - s0, t1 - t0])
        outer = np.array([[s0, t0], [s1, t0], [s1, t1], [s0, t1]])
        edges = [np.stack([outer, np.roll(outer, -1, axis=0)], axis=1)]
        if block.loops:
            loops = self.loops(block)
            if loops is None:
                report.refuse(name, "trimmed by curves of a type that is not read")
                return
            flat = [[c[:, :2] / c[:, 2:] for c in loop] for loop in loops]
            found = rectilinear(flat, tolerance)
            if found is None:
                if not any(kind == "trim" for kind, _words in block.loops):
                    sides = np.stack([outer, np.roll(outer, -1, axis=0)], axis=1)
                    loops.append([np.column_stack([side, np.ones(2)]) for side in sides])
                box = np.array([[s0, s1], [t0, t1]])
                self.curved(block, name, net.reshape(n, m, 4), (knots_u, knots_v), box, loops)
                return
            if any(kind == "trim" for kind, _words in block.loops):
                edges = found
            else:
                edges += found
        tensor = net.reshape(n, m, 4).swapaxes(0, 1)  # u runs fastest
        try:
            each = 2 * bernstein.size(p + q)
            patches = trimmed(
                tensor,
                (knots_u, knots_v),
                (p, q),
                edges,
                tolerance,
                lambda count: self.collector.expect(each * count),
            )
        except GeometryError as error:
            raise damaged(self.path, "a surface", error, line=block.line) from None
        if isinstance(patches, str):
            report.refuse(name, patches)
            return
        self.collector.add(tensor_nets(patches), face)
        report.accept()

    def curved(
        self,
        block: _Block,
        name: str,
        net: np.ndarray,
        knots: tuple[list[float], list[float]],
        box: np.ndarray,
        loops: list[list[np.ndarray]],
    ) -> None:
        """Enter a surface with trims that are no parameter lines."""
        report = self.collector.report
        face = report.faces
        degrees = block.degrees[0], block.degrees[1]
        try:
            grid = grid_of_range(net.swapaxes(0, 1), knots, degrees, box)  # u runs fastest
        except GeometryError as error:
            raise damaged(self.path, "a surface", error, line=block.line) from None
        parts = grid if isinstance(grid, str) else trimmed_surface(grid, loops, self.trims)
        if isinstance(parts, str):
            report.refuse(name, parts)
            return
        for nets, trims in parts:
            self.collector.add(nets, face, trims)
        report.accept()

    def loops(self, block: _Block) -> list[list[np.ndarray]] | None:
        """Return the trimming loops as curves in (u, v), None if one cannot be used."""
        out = []
        for name, words in block.loops:
            if not words or len(words) % 3:
                raise damaged(
                    self.path, f"u0 u1 curve after {name!r}", " ".join(words)[:60], line=block.line
                )
            loop = []
            for at in range(0, len(words), 3):
                start, stop = self.numbers(words[at : at + 2], 2, 2, name)
                curve = self.curves[self.index(words[at + 2], len(self.curves), "curv2")]
                if curve is None:
                    return None
                loop += list(curve.pieces(start, stop))
                self.pieces += len(curve.knots)
                check_memory(self.path, self.pieces * _PIECE, "pieces of trimming curves")
            out.append(loop)
        return out


def read(path: str | PathLike[str], trims: bool = False) -> Model:
    """Read the free-form surfaces of an ``.obj`` file.

    Parameters
    ----------
    path : path
        The file.
    trims : bool
        Whether patches may have trims.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or holds no such surface.
    """
    reader = _Reader(path, trims)
    for reader.line, words in _statements(read_text(path)):
        reader.statement(words[0], words[1:])
    reader.line += 1
    reader.closed()
    reader.account()
    return reader.collector.model(
        lambda: damaged(path, "free-form surfaces ('surf')", "none in this file")
    )


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the statements: the line each begins in, and its words.

    A line that ends in a backslash goes on in the next. What stands behind ``#`` is no part of
    it, nor are blanks at its end. Lines of comment between two parts of a statement are passed
    over, and a backslash at the end of a name, as of a folder, belongs to the name.
    """
    words: list[str] = []
    first, goes_on = 0, False
    for number, full in enumerate(text.split("\n"), start=1):
        line, mark, _comment = full.partition("#")
        line = line.strip()
        if goes_on and mark and not line:
            continue
        if not goes_on:
            first = number
        goes_on = line.endswith("\\")
        if goes_on and not words and line.split()[0] in _NAMES:
            goes_on = line[-2:-1].isspace()
        words += line[:-1].split() if goes_on else line.split()
        if words and not goes_on:
            yield first, words
            words = []
    if words:
        yield first, words
