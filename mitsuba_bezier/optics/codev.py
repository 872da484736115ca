"""Read CODE V sequence files (``.seq``): conics, polynomial aspheres, mirrors, tilts."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from os import PathLike

import numpy as np

from ..errors import PrescriptionError
from ..io.files import damaged
from .frames import shift, turn
from .glass import AIR, Medium, glass
from .lens import Lens, Surface
from .text import Statement, columns, read_prescription_text

_UNITS = {"M": "mm", "MM": "mm", "C": "cm", "CM": "cm", "I": "in", "IN": "in"}

#: Commands that change no ray: variables, merit functions, vignetting factors, comments, plots.
_SILENT = frozenset(
    (
        "AC", "ADC", "ADX", "ADY", "ASP", "BC", "BDC", "CA", "CC",
        "CCY", "CDC", "CIR", "CLS", "CON", "CUF", "CUM", "DC", "DER",
        "DIM", "EC", "END", "EPD", "FC", "FNO", "GC", "GO", "HC",
        "IC", "INI", "JC", "K", "KC", "LEN", "NA", "NAO", "OUT",
        "PIK", "PIM", "POL", "PRV", "PWL", "RDM", "REF", "REX", "REY",
        "S", "SI", "SLB", "SO", "STO", "SUR", "TEM", "THC", "THM",
        "TIT", "TITLE", "VIE", "VLX", "VLY", "VUX", "VUY", "WL", "WTF",
        "WTW", "XAN", "XDC", "XIM", "XOB", "XRI", "YAN", "YDC", "YIM",
        "YOB", "YRI", "ZDC",
    )
)  # fmt: skip

#: Coefficients of r^4, r^6, ...
_COEFFICIENTS = "ABCDEFGHIJ"


@dataclass
class _Row:
    """One surface, as written."""

    line: int
    number: float = 0.0
    thickness: float = 0.0
    glass: str = ""
    mirror: bool = False
    stop: bool = False
    conic: float = 0.0
    coefficients: dict[str, float] = field(default_factory=dict)
    asphere: bool = False
    size: float = np.inf
    edge: float = np.inf
    inner: float = 0.0
    moved: dict[str, float] = field(default_factory=dict)
    way: str = ""


class _Table:
    """A private glass: indices at wavelengths in nanometres, interpolated in 1 / w^2."""

    def __init__(self, name: str, wavelengths: list[float], indices: list[float]):
        self.name = name
        self._x = np.array(wavelengths) ** -2.0 * 1e6
        order = np.argsort(self._x)
        self._x, self._n = self._x[order], np.array(indices)[order]

    def index(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return indices at wavelengths in micrometres, by a cubic through the four nearest."""
        x = np.asarray(wavelength, float) ** -2.0
        flat = np.atleast_1d(x).ravel()
        margin = 1e-9 * self._x[-1]
        if (flat < self._x[0] - margin).any() or (flat > self._x[-1] + margin).any():
            raise PrescriptionError(
                f"glass {self.name}: expected wavelengths from {self._x[-1] ** -0.5:.4g} to "
                f"{self._x[0] ** -0.5:.4g} micrometres, got {np.atleast_1d(wavelength).ravel()}"
            )
        first = np.clip(np.searchsorted(self._x, flat) - 2, 0, max(len(self._x) - 4, 0))
        out = np.zeros(len(flat))
        near = min(4, len(self._x))
        for j in range(near):
            term = self._n[first + j].astype(float)
            for k in range(near):
                if k != j:
                    term = (
                        term
                        * (flat - self._x[first + k])
                        / (self._x[first + j] - self._x[first + k])
                    )
            out += term
        return out.reshape(x.shape)


def _statements(path: str | PathLike[str]) -> list[Statement]:
    """Return the statements of a file; ``;`` ends one, ``&`` goes on, ``!`` comments."""
    out = []
    held, start = "", 1
    for count, line in enumerate(read_prescription_text(path).splitlines(), start=1):
        line = re.sub(r"!.*", "", line)
        if not held:
            start = count
        if line.rstrip().endswith("&"):
            held += line.rstrip()[:-1] + " "
            continue
        for part in re.split(r";(?=(?:[^'\"]*['\"][^'\"]*['\"])*[^'\"]*$)", held + line):
            words = re.findall(r"'[^']*'|\"[^\"]*\"|\S+", part)
            if words:
                out.append(Statement(path, start, words))
        held = ""
    return out


def read_codev(path: str | PathLike[str]) -> Lens:
    """Return the lens of a CODE V ``.seq`` file.

    Followed are conics, aspheres ``ASP`` with coefficients A to J, ``REFL``, circular apertures,
    tilts (basic, ``DAR``, ``REV``, ``BEN``), private glasses, wavelengths, fields, vignetting.
    What else the file says is in `Lens.notes`.

    Raises
    ------
    FileFormatError
        If the file is missing, no text, or not of this format.
    PrescriptionError
        If a surface or glass is not followed.
    """
    statements = _statements(path)
    if not {"SO", "SI"} <= {said.key.upper() for said in statements}:
        raise damaged(path, "CODE V statements SO and SI", "none")
    rows: list[_Row] = []
    head: dict[str, Statement] = {}
    notes: list[str] = []
    private: dict[str, Medium] = {}
    powers: list[float] = []
    stops: list[Statement] = []
    by_radius = False
    inside = False

    for said in statements:
        words, line, key = said.words, said.line, said.key.upper()
        if inside:
            if key == "END":
                inside = False
            elif key == "PWL":
                powers = said.numbers()
            elif powers and len(words) > 1:
                name = words[0].strip("'\"")
                private[name.upper()] = _private_glass(name, powers, said)
            continue
        if key == "PRV":
            inside = True
        elif key == "RDM":
            by_radius = words[1:2] == [] or words[1].upper().startswith("Y")
        elif key in ("SO", "SI", "S") or re.fullmatch(r"S\d+", key):
            rows.append(_Row(line))
            row = rows[-1]
            row.number, row.thickness = said.number(1, 0.0), said.number(2, 0.0)
            for word in words[3:]:
                if word.upper() == "REFL":
                    row.mirror = True
                elif not row.glass:
                    row.glass = word.strip("'\"")
        elif rows and key in ("STO", "STOP"):
            if len(words) > 1:  # S3 names a surface, wherever this stands
                stops.append(said)
            else:
                rows[-1].stop = True
        elif rows and key == "CIR":
            kinds = [w.upper() for w in words[1:-1]]
            value = said.number(max(len(words) - 1, 1))
            if "EDG" in kinds:
                rows[-1].edge = value
            elif "OBS" in kinds or "HOL" in kinds:
                rows[-1].inner = value
            else:
                rows[-1].size = value
        elif rows and key == "ASP":
            rows[-1].asphere = True
        elif rows and key == "CON":
            continue
        elif rows and key == "K":
            rows[-1].conic = said.number(1)
        elif rows and key in tuple(_COEFFICIENTS) and rows[-1].asphere:
            rows[-1].coefficients[key] = said.number(1)
        elif rows and key in ("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"):
            rows[-1].moved[key] = said.number(1)
        elif rows and key in ("DAR", "REV", "BEN"):
            rows[-1].way = key
        elif rows and key == "REFL":
            rows[-1].mirror = True
        elif rows and key == "CUY":
            curvature = said.number(1)
            rows[-1].number = 1 / curvature if by_radius and curvature else curvature
        elif rows and key in ("GLA", "GL1"):
            rows[-1].glass = words[-1].strip("'\"")
        elif rows and key == "THI":
            rows[-1].thickness = said.number(max(len(words) - 1, 1))
        elif rows and key in ("DIF", "HOR", "HWL", "HCT", "HCO", "HCC", "HOE", "SPS", "GRT", "LAM"):
            what = f"{key} (a diffractive or special surface)"
            note = f"surface {len(rows) - 1}: {what} is not followed"
            if key in ("SPS", "GRT", "LAM"):
                raise PrescriptionError(f"{path}, line {line}: {note}")
            notes.append(note)
        elif key not in _SILENT:
            notes.append(f"line {line}: {words[0]} is not followed")
        elif key not in head:
            head[key] = said
    if len(rows) < 3:
        raise PrescriptionError(f"{path}: expected a surface between SO and SI, got none")

    _mark_stops(rows, stops)
    unit = "".join(head["DIM"].words[1:2]).upper() if "DIM" in head else "M"
    if unit not in _UNITS:
        raise damaged(path, f"one of {', '.join(_UNITS)} as DIM", unit, line=head["DIM"].line)
    surfaces = [_surface(row, by_radius, private, path) for row in rows[1:-1]]
    image = rows[-1]
    if image.moved:
        last = surfaces[-1]
        way = shift(z=last.thickness + image.thickness) @ _basic(image.moved)
        surfaces[-1] = replace(last, after=last.after @ way, thickness=0.0)
    elif image.thickness:
        surfaces[-1] = replace(surfaces[-1], thickness=surfaces[-1].thickness + image.thickness)
    far = rows[0].thickness
    kind, fields = _fields(head)
    wavelengths = [1e-3 * w for w in head["WL"].numbers()] if "WL" in head else [0.5875618]
    reference = len(wavelengths) // 2
    if "REF" in head:
        reference = head["REF"].whole(1) - 1
    title = head.get("TITLE", head.get("TIT"))
    factors = columns(head, ("VUX", "VLX", "VUY", "VLY"), len(fields))
    vignetting = [
        ((lx - ux) / 2, (ly - uy) / 2, (ux + lx) / 2, (uy + ly) / 2)
        for ux, lx, uy, ly in zip(*factors)
    ]
    return Lens(
        surfaces,
        object_distance=far if 0 < far < 1e9 else np.inf,
        aperture=_aperture(head),
        wavelengths=wavelengths,
        weights=head["WTW"].numbers() if "WTW" in head else None,
        reference=reference,
        field_kind=kind,
        fields=fields,
        vignetting=vignetting,
        title=" ".join(title.words[1:]).strip("'\" ") if title else "",
        unit=_UNITS[unit],
        notes=notes,
    )


def _mark_stops(rows: list[_Row], stops: list[Statement]) -> None:
    """Mark the stops that are named by surface, and refuse ones that no surface has."""
    for said in stops:
        number = re.fullmatch(r"S(\d+)", said.words[1].upper())
        if not number or not 0 < int(number[1]) < len(rows) - 1:
            expected = f"a stop among S1 to S{len(rows) - 2}"
            raise damaged(said.path, expected, said.words[1], line=said.line)
        rows[int(number[1])].stop = True
    for row, name in ((rows[0], "SO"), (rows[-1], "SI")):
        if row.stop:
            raise PrescriptionError.expected("stop", "a surface between object and image", name)


def _private_glass(name: str, powers: list[float], said: Statement) -> _Table:
    indices = said.numbers()
    if len(indices) != len(powers) or len(set(powers)) < len(powers) or not min(powers) > 0:
        expected = f"one index at each of {len(powers)} wavelengths, all different and positive"
        raise damaged(said.path, expected, f"{len(indices)} of glass {name}", line=said.line)
    return _Table(name, powers, indices)


def _basic(moved: dict[str, float]) -> np.ndarray:
    decentred = shift(*(moved.get(k, 0.0) for k in ("XDE", "YDE", "ZDE")))
    return decentred @ turn(*(moved.get(k, 0.0) for k in ("ADE", "BDE", "CDE")))


def _surface(
    row: _Row, by_radius: bool, private: dict[str, Medium], path: str | PathLike[str]
) -> Surface:
    medium: Medium = AIR
    if row.glass and not row.mirror:
        if row.glass.upper() in private:
            medium = private[row.glass.upper()]
        else:
            try:
                medium = glass(row.glass)
            except PrescriptionError as error:
                raise PrescriptionError(f"{path}, line {row.line}: {error}") from None
    curvature = row.number
    if by_radius:
        curvature = 1 / row.number if row.number else 0.0
    highest = max((_COEFFICIENTS.index(k) for k, v in row.coefficients.items() if v), default=-1)
    coefficients: tuple[float, ...] = ()
    if highest >= 0:
        coefficients = (
            0.0,
            *(row.coefficients.get(k, 0.0) for k in _COEFFICIENTS[: highest + 1]),
        )
    before, after = np.eye(4), np.eye(4)
    if row.moved:
        motion = _basic(row.moved)
        if row.way == "REV":
            after = np.linalg.inv(motion)
        elif row.way == "DAR":
            before, after = motion, np.linalg.inv(motion)
        elif row.way == "BEN":
            before = motion
            after = turn(*(row.moved.get(k, 0.0) for k in ("ADE", "BDE", "CDE")))
        else:
            before = motion
    size = row.size if np.isfinite(row.size) else row.edge
    return Surface(
        curvature=curvature,
        thickness=row.thickness,
        medium=medium,
        semi_diameter=size,
        conic=row.conic,
        coefficients=coefficients,
        mirror=row.mirror,
        stop=row.stop,
        inner=row.inner,
        before=before,
        after=after,
    )


def _aperture(head: dict[str, Statement]) -> tuple[str, float] | None:
    for key, kind in (("EPD", "diameter"), ("FNO", "f_number"), ("NAO", "object_na")):
        if key in head:
            return kind, head[key].number(1)
    return None


def _fields(head: dict[str, Statement]) -> tuple[str, list[tuple[float, float]]]:
    for kind, names in (
        ("angle", ("XAN", "YAN")),
        ("object_height", ("XOB", "YOB")),
        ("image_height", ("XIM", "YIM")),
        ("image_height", ("XRI", "YRI")),
    ):
        count = max(len(head[name].words) - 1 if name in head else 0 for name in names)
        if count:
            return kind, list(zip(*columns(head, names, count)))
    return "angle", [(0.0, 0.0)]
