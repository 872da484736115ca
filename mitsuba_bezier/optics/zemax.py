"""Read Zemax lens files (``.zmx``): sequential systems of conics, even aspheres and mirrors."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from os import PathLike

import numpy as np

from ..errors import FileFormatError, PrescriptionError
from .frames import shift, turn
from .glass import AIR, Abbe, Medium, glass
from .lens import Lens, Surface
from .text import read_prescription_text

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

    line: int
    kind: str = "STANDARD"
    curvature: float = 0.0
    thickness: float = 0.0
    glass: list[str] = field(default_factory=list)
    conic: float = 0.0
    diameter: float = 0.0
    given: bool = False
    inner: float = 0.0
    outer: float = 0.0
    stop: bool = False
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
        raise FileFormatError(f"{path}: expected a Zemax lens file with lines SURF, got none")
    head: dict[str, list[str]] = {}
    rows: list[_Row] = []
    notes: list[str] = []
    waves: dict[int, tuple[float, float]] = {}
    silent = True

    def number(words: list[str], at: int, line: int) -> float:
        try:
            return float(words[at])
        except (IndexError, ValueError):
            got = words[at] if at < len(words) else "nothing"
            raise FileFormatError(
                f"{path}, line {line}: expected a number as word {at + 1} of {words[0]}, got {got}"
            ) from None

    for count, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        key = words[0]
        if key == "SURF":
            rows.append(_Row(count))
            continue
        row = rows[-1] if rows and line[:1].isspace() else None
        if row is None:
            if key == "WAVM":
                waves[int(number(words, 1, count))] = (
                    number(words, 2, count),
                    number(words, 3, count) if len(words) > 3 else 1.0,
                )
            elif key == "MODE" and len(words) > 1 and words[1] != "SEQ":
                raise PrescriptionError(f"{path}: expected MODE SEQ, got MODE {words[1]}")
            elif key not in head:
                head[key] = words
        elif key == "TYPE":
            row.kind = words[1] if len(words) > 1 else "STANDARD"
        elif key == "CURV":
            row.curvature = number(words, 1, count)
        elif key == "DISZ":
            row.thickness = np.inf if words[1:2] == ["INFINITY"] else number(words, 1, count)
        elif key == "GLAS":
            row.glass = words[1:]
        elif key == "CONI":
            row.conic = number(words, 1, count)
        elif key == "DIAM":
            row.diameter = number(words, 1, count)
            row.given = len(words) > 2 and words[2] not in ("0",)
        elif key in ("CLAP", "FLAP"):
            row.inner, row.outer = number(words, 1, count), number(words, 2, count)
        elif key == "OBSC":
            row.inner = number(words, 2, count)
        elif key == "STOP":
            row.stop = True
        elif key == "COMM":
            row.comment = line.split("COMM", 1)[1].strip()
        elif key == "PARM":
            row.parameters[int(number(words, 1, count))] = number(words, 2, count)
        elif key in _APERTURES:
            row.notes.append(f"{_APERTURES[key]} is not followed")
        elif key not in _SILENT:
            row.notes.append(f"{key} is not followed")
            silent = False
    for key in head:
        if key not in _SILENT and silent:
            notes.append(f"{key} is not followed")

    unit = _UNITS.get(head.get("UNIT", ["UNIT", "MM"])[1].upper(), "mm")
    wavelengths, weights, reference = _wavelengths(head, waves)
    kind, fields = _fields(head)
    factors = [
        ([float(w) for w in head.get(n, [n])[1:]] + [0.0] * len(fields))[: len(fields)]
        for n in ("VDXN", "VDYN", "VCXN", "VCYN")
    ]
    object_distance = rows[0].thickness if rows else np.inf
    surfaces, said = _surfaces(rows[1:-1], path)
    notes += said
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
        title=" ".join(head.get("NAME", ["NAME"])[1:]),
        unit=unit,
        notes=notes,
    )


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


def _surfaces(rows: list[_Row], path: str | PathLike[str]) -> tuple[list[Surface], list[str]]:
    surfaces: list[Surface] = []
    notes: list[str] = []
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
        surfaces[-1] = Surface(
            **{**vars(last), "after": shift(z=last.thickness) @ motion, "thickness": 0.0}
        )
    return surfaces, notes


def _aperture(head: dict[str, list[str]]) -> tuple[str, float] | None:
    for key, kind in (("ENPD", "diameter"), ("FNUM", "f_number"), ("OBNA", "object_na")):
        if key in head and len(head[key]) > 1:
            value = float(head[key][1])
            if value > 0:
                return kind, value
    if "FLOA" in head:
        return "stop", 0.0
    return None


def _wavelengths(
    head: dict[str, list[str]], waves: dict[int, tuple[float, float]]
) -> tuple[list[float], list[float], int]:
    count = int(float(head["FTYP"][4])) if len(head.get("FTYP", [])) > 4 else 0
    primary = int(float(head.get("PWAV", ["PWAV", "1"])[1]))
    if waves:
        ordered = [waves[i] for i in sorted(waves)]
        if not 0 < count <= len(ordered):
            # older files fill the unused places with one wavelength
            count = len(dict.fromkeys(ordered))
        ordered = ordered[: max(count, 1)]
        values, weights = [w for w, _ in ordered], [s for _, s in ordered]
    elif "WAVL" in head:
        values = [float(w) for w in head["WAVL"][1:]]
        weights = [float(w) for w in head.get("WWGT", ["WWGT"])[1:]] or [1.0] * len(values)
    else:
        values, weights = [0.5875618], [1.0]
    return values, weights, min(max(primary - 1, 0), len(values) - 1)


def _fields(head: dict[str, list[str]]) -> tuple[str, list[tuple[float, float]]]:
    kinds = {0: "angle", 1: "object_height", 2: "image_height", 3: "image_height"}
    words = head.get("FTYP", ["FTYP", "0"])
    kind = kinds.get(int(float(words[1])), "angle")
    xs = [float(w) for w in head.get("XFLN", head.get("XFLD", ["XFLN"]))[1:]]
    ys = [float(w) for w in head.get("YFLN", head.get("YFLD", ["YFLN"]))[1:]]
    count = int(float(words[3])) if len(words) > 3 else max(len(xs), len(ys))
    count = max(count, 1)
    xs = (xs + [0.0] * count)[:count]
    ys = (ys + [0.0] * count)[:count]
    return kind, list(zip(xs, ys))
