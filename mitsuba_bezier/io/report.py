"""The result of a reader: nets, and a record of every face it met."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..errors import FileFormatError
from ..geometry import bernstein
from ..geometry.fields import BezierField, nearest_names
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from .limits import check_control_points
from .parts import Part, flattened

__all__ = ["FormatWarning", "Model", "Refusal", "Report"]


class FormatWarning(UserWarning):
    """A file that could be read, but not all of it, or not as its author may think."""


@dataclass(frozen=True)
class Refusal:
    """Faces that were not converted: how they are named in the file, how many, and why."""

    face: str
    reason: str
    count: int = 1

    def __str__(self) -> str:
        return f"{self.face}: {self.reason}"


@dataclass
class Report:
    """Account of one file.

    Attributes
    ----------
    path, format : str
        The file and the name of its format.
    faces : int
        Faces (cells, patches, surfaces) in the file.
    converted : int
        Faces that became Bézier triangles.
    refused : list of Refusal
        Faces that did not; their counts and `converted` sum to `faces`.
    notes : list of str
        What the author of the file may not expect, one line each; `warn` says them.
    remarks : list of str
        What else is worth knowing.
    """

    path: str
    format: str
    faces: int = 0
    converted: int = 0
    refused: list[Refusal] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def refuse(self, face: str, reason: str, count: int = 1) -> None:
        """Enter faces that cannot be converted."""
        self.faces += count
        self.refused.append(Refusal(face, reason, count))

    def accept(self, count: int = 1) -> None:
        """Enter faces that were converted."""
        self.faces += count
        self.converted += count

    def summary(self) -> str:
        """Return one line: faces in, converted, refused with the reasons."""
        line = f"{self.path}: {self.converted} of {self.faces} faces converted"
        if self.refused:
            reasons: dict[str, int] = {}
            for r in self.refused:
                reasons[r.reason] = reasons.get(r.reason, 0) + r.count
            line += "; refused: " + "; ".join(f"{n} ({reason})" for reason, n in reasons.items())
        return line

    def warn(self) -> None:
        """Issue a `FormatWarning` for each note, and one for the refused faces."""
        for note in self.notes:
            warnings.warn(f"{self.path}: {note}", FormatWarning, stacklevel=3)
        if self.refused:
            warnings.warn(self.summary(), FormatWarning, stacklevel=3)


class Model:
    """The contents of a file: nets grouped by degree, with the account of its faces.

    Parameters
    ----------
    groups, sources, report, trims
        As the attributes.
    parts : list of Part, optional
        The parts; then groups, sources and trims are those of all their places, put together when
        they are asked for.
    unit : str
        As the attribute.

    Attributes
    ----------
    groups : list of BezierTriangles
        One for each degree, lowest first.
    sources : list of (P,) int arrays
        For each group, the number of the face in the file that each patch comes from.
    report : Report
    trims : list of (Trims or None)
        For each group the trims of its patches, None if they are whole. Empty if none is
        trimmed.
    parts : list of Part
        What the file tells apart; one part if it tells nothing.
    unit : str
        The unit of its lengths, such as ``mm``; empty if the file does not tell.
    fields : dict of BezierField
        What the file tells of its points and cells, on the patches of `triangles`, in their order.
    edges : (P, 3) bool array or None
        For these patches, whether the sides opposite of the corners A, B, C are sides of a face of
        the file; quadrilaterals are two patches, and what is between them is none. None: all are.
    """

    def __init__(
        self,
        groups: list[BezierTriangles] | None = None,
        sources: list[np.ndarray] | None = None,
        report: Report | None = None,
        trims: list[Trims | None] | None = None,
        parts: list[Part] | None = None,
        unit: str = "",
        fields: dict[str, BezierField] | None = None,
        edges: np.ndarray | None = None,
    ) -> None:
        self.report = Report("", "") if report is None else report
        self.unit = unit
        self.fields = {} if fields is None else fields
        self.edges = edges
        self._flat = None if groups is None else (groups, sources or [], trims or [])
        self._parts = parts

    @property
    def groups(self) -> list[BezierTriangles]:
        return self._flattened()[0]

    @property
    def sources(self) -> list[np.ndarray]:
        return self._flattened()[1]

    @property
    def trims(self) -> list[Trims | None]:
        return self._flattened()[2]

    def _flattened(
        self,
    ) -> tuple[list[BezierTriangles], list[np.ndarray], list[Trims | None]]:
        if self._flat is None:
            parts = self._parts or []
            points = sum(
                len(part.placements) * sum(g.control_points[..., 0].size for g in part.groups)
                for part in parts
            )
            check_control_points(self.report.path, points)
            self._flat = flattened(parts)
        return self._flat

    @property
    def has_parts(self) -> bool:
        """Whether the file tells parts."""
        return self._parts is not None

    @property
    def parts(self) -> list[Part]:
        if self._parts is None:
            name = Path(self.report.path).stem or "model"
            groups, sources, trims = self._flattened()
            self._parts = [Part(name, groups, sources, list(trims))]
        return self._parts

    def field(self, name: str) -> BezierField:
        """Return the field of a name.

        Raises
        ------
        FileFormatError
            If there is none; the message offers the nearest names.
        """
        if name in self.fields:
            return self.fields[name]
        known = list(self.fields)
        near = ", ".join(repr(k) for k in nearest_names(name, known))
        more = f" ({len(known)} in all)" if len(known) > 5 else ""
        raise FileFormatError.expected(
            f"field of {self.report.path}",
            f"{near}{more}" if known else "a file with fields; this one has none",
            repr(name),
        )

    #: What draws it in notebooks; the package sets it.
    draw: ClassVar[Callable[[Any], bytes | None] | None] = None

    def _repr_png_(self) -> bytes | None:
        draw = type(self).draw
        return None if draw is None else draw(self)

    def triangles(self) -> BezierTriangles:
        """Return all patches elevated to the highest degree, in the order of the file."""
        return self.trimmed()[0]

    def trimmed(self) -> tuple[BezierTriangles, Trims | None]:
        """Return what `triangles` does, and the trims of these patches, None if all are whole."""
        parts = self.trims or [None] * len(self.groups)
        some = any(part is not None for part in parts)
        if len(self.groups) == 1:
            return self.groups[0], parts[0]
        top = max(group.degree for group in self.groups)
        count = sum(map(len, self.groups)) * bernstein.size(top)
        check_control_points(self.report.path, count, f"{count} control points of degree {top}")
        order = np.argsort(np.concatenate(self.sources), kind="stable")
        joined = BezierTriangles.join(self.groups)[order]
        if not some:
            return joined, None
        filled = [Trims.none(len(g)) if t is None else t for t, g in zip(parts, self.groups)]
        return joined, Trims.join(filled)[order]


class Collector:
    """Gathers nets of several degrees while a file is read."""

    def __init__(self, path: object, format: str) -> None:
        self.report = Report(str(path), format)
        #: Bytes of further files, by which it may take more memory.
        self.size = 0
        self._points = 0
        self._nets: dict[int, list[np.ndarray]] = {}
        self._sources: dict[int, list[np.ndarray]] = {}
        self._trims: dict[int, list[Trims | None]] = {}
        self._fields: dict[int, list[Mapping[str, BezierField]]] = {}
        self._edges: dict[int, list[np.ndarray | None]] = {}

    def expect(self, points: int, what: str = "") -> None:
        """Announce this many control points, or as much for field `what`, before they are made.

        Raises
        ------
        FileFormatError
            If all of them take more memory than a file of this size may.
        """
        self._points += points
        name = f"field {what!r}" if what else ""
        check_control_points(self.report.path, self._points, name, self.size)

    def add(
        self,
        nets: np.ndarray,
        sources: np.ndarray | int,
        trims: Trims | None = None,
        fields: Mapping[str, BezierField] | None = None,
        edges: np.ndarray | None = None,
    ) -> None:
        """Add nets ``(P, K, 4)`` that come from the faces `sources` (one number, or ``(P,)``).

        `fields` are on these patches; `edges` are those of `Model`.
        """
        key = nets.shape[1]
        self._fields.setdefault(key, []).append(fields or {})
        self._edges.setdefault(key, []).append(edges)
        self._trims.setdefault(key, []).append(trims)
        self._nets.setdefault(key, []).append(nets)
        self._sources.setdefault(key, []).append(np.broadcast_to(sources, len(nets)))

    def model(self, nothing: Callable[[], FileFormatError]) -> Model:
        """Return the model.

        Parameters
        ----------
        nothing : callable
            Makes the error for a file in which no face could be converted.
        """
        if not self._nets:
            error = nothing()
            if self.report.refused:
                raise FileFormatError(f"{error} ({self.report.summary()})")
            raise error
        groups, sources = [], []
        trims: list[Trims | None] = []
        for key in sorted(self._nets):
            nets = np.concatenate(self._nets[key])
            order = np.argsort(np.concatenate(self._sources[key]), kind="stable")
            where = np.concatenate(self._sources[key])[order]
            nets = nets[order]
            self._check(nets, where)
            groups.append(BezierTriangles(nets))
            sources.append(where)
            trims.append(self._joined_trims(key, order))
        some = any(t is not None for t in trims)
        model = Model(groups, sources, self.report, trims if some else [])
        order = np.argsort(
            np.concatenate([s for key in sorted(self._nets) for s in self._sources[key]]),
            kind="stable",
        )
        parts = [part for key in sorted(self._nets) for part in self._fields[key]]
        counts = [len(nets) for key in sorted(self._nets) for nets in self._nets[key]]
        names = dict.fromkeys(name for part in parts for name in part)
        for name in names:
            if (joined := self._joined_field(name, parts, counts)) is not None:
                model.fields[name] = joined[order]
        edges = [part for key in sorted(self._nets) for part in self._edges[key]]
        if any(part is not None for part in edges):
            whole = [np.ones((n, 3), bool) if e is None else e for e, n in zip(edges, counts)]
            model.edges = np.concatenate(whole)[order]
        return model

    def _joined_field(
        self, name: str, parts: list[Mapping[str, BezierField]], counts: list[int]
    ) -> BezierField | None:
        """Return a field on all patches, NaN where it has no values."""
        found = [part[name] for part in parts if name in part]
        width = {f.components for f in found}
        if len(width) > 1:
            self.report.notes.append(
                f"field {name!r} is left out: it has {sorted(width)} components in different parts"
            )
            return None
        top = max(f.degree for f in found)
        size, rational = bernstein.size(top), any(f.weights is not None for f in found)
        ordinates, weights = [], []
        for part, count in zip(parts, counts):
            if name in part:
                own = part[name].elevate(top)
                ordinates.append(own.ordinates)
                weights.append(np.ones((count, size)) if own.weights is None else own.weights)
            else:
                ordinates.append(np.full((count, size, width.copy().pop()), np.nan))
                weights.append(np.ones((count, size)))
        joined = np.concatenate(ordinates)
        return BezierField(
            name, joined, np.concatenate(weights) if rational else None, found[0].unit
        )

    def _joined_trims(self, key: int, order: np.ndarray) -> Trims | None:
        parts = self._trims[key]
        if all(t is None for t in parts):
            return None
        filled = [
            Trims.none(len(nets)) if t is None else t for t, nets in zip(parts, self._nets[key])
        ]
        joined = Trims.join(filled)[order]
        return joined if (joined.region >= 0).any() else None

    def _check(self, nets: np.ndarray, where: np.ndarray) -> None:
        """Turn unusable numbers into an error that names the file and the face."""
        for bad, what in (
            (~np.isfinite(nets).all(axis=(1, 2)), "a control point that is not finite"),
            (~nets.any(axis=(1, 2)), "only zero control points"),
        ):
            if bad.any():
                face = int(where[np.argmax(bad)])
                raise FileFormatError(
                    f"{self.report.path}, face {face}: expected finite control points "
                    f"that are not all zero, got {what}"
                )
