"""Read Zemax lens files (``.zmx``): sequential systems of conics, even aspheres and mirrors."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from os import PathLike

import numpy as np

from ..errors import PrescriptionError
from ..io.files import damaged
from .frames import shift, turn
from .glass import AIR, Abbe, Medium, glass
from .lens import Lens, Surface
from .text import Statement, columns, read_prescription_text

_UNITS = {"MM": "mm", "CM": "cm", "IN": "in", "INCH": "in", "M": "m", "METER": "m", "METERS": "m"}

#: What changes no ray of a sequential trace: colours, tolerances, plots, coatings by file.
_SILENT = frozenset(
    (
        "ACOS", "BLNK", "CFWD", "CIGA", "CLAP", "COAT", "COFN", "COMM", "CONI",
        "CURV", "DIAM", "DISZ", "DMFS", "EFFL", "ENPD", "ENVD", "FIMP", "FLAP",
        "FLOA", "FNUM", "FTYP", "FWGN", "FWGT", "GCAT", "GFAC", "GLAS", "GLCB",
        "GLRS", "GSTD", "HIDE", "HYPR", "LANG", "MAZH", "MEMA", "MIRR", "MNUM",
        "MODE", "MOFF", "NAME", "NOTE", "NSCD", "OBDC", "OBNA", "OMMA", "OPDX",
        "PARM", "PFIL", "PICB", "PKUP", "POLS", "POPS", "PPAR", "PUSH", "PWAV",
        "PZUP", "RAIM", "REAX", "REAY", "ROPD", "RSCE", "RWRE", "SCBD", "SDMA",
        "SLAB", "STOP", "SURF", "TCE", "TCED", "TCMM", "TEMP", "TOL", "TOLE",
        "TRAC", "TYPE", "UNIT", "VANN", "VCXN", "VCYN", "VDSZ", "VDXN", "VDYN",
        "VERS", "WAVL", "WAVM", "WAVN", "WWGN", "WWGT", "XDAT", "XFLD", "XFLN",
        "YFLD", "YFLN",
    )
)  # fmt: skip

#: Aperture shapes of which only the outer circle is followed, or none of it.
_APERTURES = {
    "SQAP": "a rectangular aperture",
    "SQOB": "a rectangular obscuration",
    "ELAP": "an elliptical aperture",
    "ELOB": "an elliptical obscuration",
    "SPID": "a spider",
    "UDAD": "an aperture of a file",
}


@dataclass
class _Row:
    """One SURF block, as written."""

    kind: str = "STANDARD"
    curvature: float = 0.0
    thickness: float = 0.0
    glass: list[str] = field(default_factory=list)
    conic: float = 0.0
    diameter: float = 0.0
    inner: float = 0.0
    outer: float = 0.0
    stop: bool = False
    cut: bool = True  # its thickness is missing
    comment: str = ""
    parameters: dict[int, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_zemax(path: str | PathLike[str]) -> Lens:
    """Return the lens of a ``.zmx`` file.

    Followed are surfaces STANDARD, EVENASPH and COORDBRK, mirrors, the stop, circular apertures,
    wavelengths, fields, and the aperture's value. What else the file says is in `Lens.notes`.

    Raises
    ------
    FileFormatError
        If the file is missing, no text, or not of this format.
    PrescriptionError
        If it has a kind of surface that is not followed, or a glass that nobody knows.
    """
    text = read_prescription_text(path)
    lines = text.splitlines()
    if not any(line.startswith("SURF ") for line in lines):
        raise damaged(path, "a Zemax lens file with lines SURF", "none")
    head: dict[str, Statement] = {}
    rows: list[_Row] = []
    notes: list[str] = []
    waves: dict[int, tuple[float, float]] = {}

    for count, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        key = words[0]
        said = Statement(path, count, words)
        if key == "SURF":
            if said.whole(1) != len(rows):
                raise damaged(path, f"SURF {len(rows)}", " ".join(words[:2]), line=count)
            rows.append(_Row())
            continue
        row = rows[-1] if rows and line[:1].isspace() else None
        if row is None:
            if key == "WAVM":
                waves[said.whole(1)] = said.number(2), said.number(3, 1.0)
            elif key == "MODE" and len(words) > 1 and words[1] != "SEQ":
                raise PrescriptionError(f"{path}: expected MODE SEQ, got MODE {words[1]}")
            elif key not in head:
                head[key] = said
                if key not in _SILENT:
                    notes.append(f"{key} is not followed")
        elif key == "TYPE":
            row.kind = words[1] if len(words) > 1 else "STANDARD"
        elif key == "CURV":
            row.curvature = said.number(1)
        elif key == "DISZ":
            row.thickness = np.inf if words[1:2] == ["INFINITY"] else said.number(1)
            row.cut = False
        elif key == "GLAS":
            row.glass = words[1:]
        elif key == "CONI":
            row.conic = said.number(1)
        elif key == "DIAM":
            row.diameter = said.number(1)
            if row.diameter < 0:
                raise damaged(path, "a semi-diameter from 0 on", f"{words[1]}", line=count)
        elif key in ("CLAP", "FLAP"):
            row.inner, row.outer = said.number(1), said.number(2)
        elif key == "OBSC":
            row.inner = said.number(2)
        elif key == "STOP":
            row.stop = True
        elif key == "COMM":
            row.comment = line.split("COMM", 1)[1].strip()
        elif key == "PARM":
            row.parameters[said.whole(1)] = said.number(2)
        elif key in _APERTURES:
            row.notes.append(f"{_APERTURES[key]} is not followed")
        elif key not in _SILENT:
            row.notes.append(f"{key} is not followed")

    if len(rows) < 3:
        raise damaged(path, "an object, surfaces and an image (SURF)", f"{len(rows)} of them")
    if rows[-1].glass or (rows[-1].cut and not text.endswith("\n")):
        raise damaged(path, "an image behind the last surface", "a file that is cut off")
    for number in (0, len(rows) - 1):
        if rows[number].stop:
            raise PrescriptionError.expected(
                "stop", "a surface between object and image", f"SURF {number}"
            )
    unit = "".join(_words(head, "UNIT")[:1]).upper() or "MM"
    if unit not in _UNITS:
        raise damaged(path, f"one of {', '.join(_UNITS)} as UNIT", unit, line=head["UNIT"].line)
    wavelengths, weights, reference = _wavelengths(head, waves)
    kind, fields = _fields(head)
    factors = columns(head, ("VDXN", "VDYN", "VCXN", "VCYN"), len(fields))
    object_distance = rows[0].thickness if rows else np.inf
    surfaces = _surfaces(rows[1:-1], path, notes)
    return Lens(
        surfaces,
        object_distance=object_distance if object_distance > 0 else np.inf,
        aperture=_aperture(head),
        wavelengths=wavelengths,
        weights=weights,
        reference=reference,
        field_kind=kind,
        fields=fields,
        vignetting=list(zip(*factors)),
        title=" ".join(_words(head, "NAME")),
        unit=_UNITS[unit],
        notes=notes,
    )


def _words(head: dict[str, Statement], key: str) -> list[str]:
    """Return the words behind a keyword; none if it is missing."""
    return list(head[key].words[1:]) if key in head else []


def _medium(row: _Row, where: str, notes: list[str]) -> Medium:
    words = row.glass
    if not words:
        return AIR
    name = words[0]
    numbers = []
    for word in words[3:5]:
        with contextlib.suppress(ValueError):
            numbers.append(float(word))
    # 1.5 and 40 stand where the program has the glass in a catalogue of its own
    model = len(numbers) == 2 and numbers[0] > 1 and numbers[1] > 0 and numbers != [1.5, 40.0]
    if name in ("___BLANK", "BLANK") or name.startswith("___"):
        if not model:
            raise PrescriptionError(f"{where}: expected n_d and V_d of a model glass, got {words}")
        return Abbe(numbers[0], numbers[1], f"{numbers[0]:g}:{numbers[1]:g}")
    try:
        return glass(name)
    except PrescriptionError as error:
        if not model:
            raise PrescriptionError(f"{where}: {error}") from None
        notes.append(
            f"{where}: glass {name} is in no catalogue here; the file's n_d {numbers[0]:g} and V_d "
            f"{numbers[1]:g} are used"
        )
        return Abbe(numbers[0], numbers[1], name)


def _surfaces(rows: list[_Row], path: str | PathLike[str], notes: list[str]) -> list[Surface]:
    surfaces: list[Surface] = []
    motion = np.eye(4)  # of coordinate breaks since the last surface
    for number, row in enumerate(rows, start=1):
        where = f"surface {number}"
        notes += [f"{where}: {note}" for note in row.notes]
        if not np.isfinite(row.thickness):
            raise PrescriptionError(f"{path}, {where}: expected a finite thickness, got infinity")
        p = row.parameters
        if row.kind == "COORDBRK":
            step = shift(p.get(1, 0.0), p.get(2, 0.0))
            turned = turn(p.get(3, 0.0), p.get(4, 0.0), p.get(5, 0.0))
            if p.get(6, 0.0):  # tilts first, about z, y, x
                back = turn(0, 0, p.get(5, 0.0)) @ turn(0, p.get(4, 0.0)) @ turn(p.get(3, 0.0))
                motion = motion @ back @ step
            else:
                motion = motion @ step @ turned
            motion = motion @ shift(z=row.thickness)
            continue
        if row.kind not in ("STANDARD", "EVENASPH"):
            raise PrescriptionError(
                f"{path}, {where}: expected STANDARD, EVENASPH or COORDBRK, got {row.kind}"
            )
        mirror = bool(row.glass) and row.glass[0].upper() == "MIRROR"
        size = row.outer or row.diameter
        coefficients = tuple(p.get(i, 0.0) for i in range(1, 9)) if row.kind == "EVENASPH" else ()
        while coefficients and not coefficients[-1]:
            coefficients = coefficients[:-1]
        surfaces.append(
            Surface(
                curvature=row.curvature,
                thickness=row.thickness,
                medium=AIR if mirror else _medium(row, where, notes),
                semi_diameter=size if size > 0 else np.inf,
                conic=row.conic,
                coefficients=coefficients,
                mirror=mirror,
                stop=row.stop,
                inner=row.inner,
                before=motion,
                label=row.comment,
            )
        )
        motion = np.eye(4)
    if surfaces and not np.array_equal(motion, np.eye(4)):
        last = surfaces[-1]  # breaks before the image
        surfaces[-1] = replace(last, after=shift(z=last.thickness) @ motion, thickness=0.0)
    return surfaces


def _aperture(head: dict[str, Statement]) -> tuple[str, float] | None:
    for key, kind in (("ENPD", "diameter"), ("FNUM", "f_number"), ("OBNA", "object_na")):
        value = head[key].number(1, 0.0) if key in head else 0.0
        if value:
            return kind, value
    return ("stop", 0.0) if "FLOA" in head else None


def _wavelengths(
    head: dict[str, Statement], waves: dict[int, tuple[float, float]]
) -> tuple[list[float], list[float], int]:
    count = head["FTYP"].whole(4, 0) if "FTYP" in head else 0
    primary = head["PWAV"].whole(1, 1) if "PWAV" in head else 1
    if waves:
        ordered = [waves[i] for i in sorted(waves)]
        if not 0 < count <= len(ordered):
            # older files fill the unused places with one wavelength
            count = len(dict.fromkeys(ordered))
        ordered = ordered[: max(count, 1)]
        values, weights = [w for w, _ in ordered], [s for _, s in ordered]
    elif "WAVL" in head:
        values = head["WAVL"].numbers()
        weights = head["WWGT"].numbers() if "WWGT" in head else []
        weights = (weights + [1.0] * len(values))[: len(values)]
    else:
        values, weights = [0.5875618], [1.0]
    return values, weights, max(primary - 1, 0)


def _fields(head: dict[str, Statement]) -> tuple[str, list[tuple[float, float]]]:
    kinds = {0: "angle", 1: "object_height", 2: "image_height", 3: "image_height"}
    names = [new if new in head else old for new, old in (("XFLN", "XFLD"), ("YFLN", "YFLD"))]
    listed = max(len(_words(head, name)) for name in names)
    kind, count = "angle", listed
    if "FTYP" in head:
        kind = kinds.get(head["FTYP"].whole(1, 0), "angle")
        count = min(head["FTYP"].whole(3, listed), listed)
    return kind, list(zip(*columns(head, names, max(count, 1))))
