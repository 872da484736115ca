"""What a reader found: nets, and an account of every face it met."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..errors import FileFormatError
from ..geometry.triangles import BezierTriangles

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


@dataclass
class Model:
    """The contents of a file: nets grouped by degree, with the account of its faces.

    Attributes
    ----------
    groups : list of BezierTriangles
        One for each degree, lowest first.
    sources : list of (P,) int arrays
        For each group, the number of the face in the file that each patch comes from.
    report : Report
    """

    groups: list[BezierTriangles]
    sources: list[np.ndarray]
    report: Report

    def triangles(self) -> BezierTriangles:
        """Return all patches elevated to the highest degree, in the order of the file."""
        if len(self.groups) == 1:
            return self.groups[0]
        joined = BezierTriangles.join(self.groups)
        return joined[np.argsort(np.concatenate(self.sources), kind="stable")]


class Collector:
    """Gathers nets of several degrees while a file is read."""

    def __init__(self, path: object, format: str) -> None:
        self.report = Report(str(path), format)
        self._nets: dict[int, list[np.ndarray]] = {}
        self._sources: dict[int, list[np.ndarray]] = {}

    def add(self, nets: np.ndarray, sources: np.ndarray | int) -> None:
        """Add nets ``(P, K, 4)`` that come from the faces `sources` (one number, or ``(P,)``)."""
        key = nets.shape[1]
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
        for key in sorted(self._nets):
            nets = np.concatenate(self._nets[key])
            order = np.argsort(np.concatenate(self._sources[key]), kind="stable")
            where = np.concatenate(self._sources[key])[order]
            nets = nets[order]
            self._check(nets, where)
            groups.append(BezierTriangles(nets))
            sources.append(where)
        return Model(groups, sources, self.report)

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
