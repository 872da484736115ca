"""Lens tables: CSV as patents print them, and the four columns of pbrt's realistic camera."""

from __future__ import annotations

import csv
import difflib
from os import PathLike

import numpy as np

from ..errors import FileFormatError, PrescriptionError
from ..io.files import damaged
from .glass import AIR, Abbe, Constant, Medium, glass
from .lens import Lens, Surface
from .text import read_prescription_text

#: Columns of a CSV table, and other names for them.
COLUMNS = {
    "radius": ("radius", "r", "radius of curvature"),
    "curvature": ("curvature", "c"),
    "thickness": ("thickness", "d", "distance", "t"),
    "glass": ("glass", "material", "medium"),
    "nd": ("nd", "n_d", "n", "index"),
    "vd": ("vd", "v_d", "abbe", "v"),
    "semi_diameter": ("semi_diameter", "semi-diameter", "semidiameter", "sd"),
    "diameter": ("diameter", "dia"),
    "conic": ("conic", "k"),
    "stop": ("stop",),
    "label": ("label", "comment", "name"),
}

#: Columns of the even polynomial, and their powers of r.
_POWERS = {f"a{power}": power for power in range(2, 41, 2)}

_SETTINGS = (
    "title",
    "unit",
    "object",
    "aperture",
    "wavelengths",
    "reference",
    "fields",
    "field_kind",
)


def _number(text: str, where: str, name: str) -> float:
    word = text.strip().lower()
    if word in ("inf", "infinity", "∞", "plano", "flat"):
        return np.inf
    try:
        value = float(word)
        if value != value:
            raise ValueError
        return value
    except ValueError:
        raise FileFormatError(
            f"{where}: expected a number as {name}, got {text.strip()!r}"
        ) from None


def _model(nd: float, vd: float | None) -> Medium:
    """Return the medium of an index, or of n_d and V_d; 1 is air."""
    if not nd >= 1:
        raise PrescriptionError.expected("nd", "an index from 1 on", nd)
    if nd == 1:
        return AIR
    return Constant(nd) if vd is None else Abbe(nd, vd)


def read_csv(path: str | PathLike[str]) -> Lens:
    """Return the lens of a CSV table: a header, a row for each surface.

    Columns are `COLUMNS`, and ``a2, a4, a6, ...`` for the even polynomial; `radius` (0 and inf are
    planes) or `curvature`, and `thickness` are needed. A glass is a name, a code, or the pair of nd
    and vd; ``mirror`` reflects. Lines ``# key: value`` before the header set title, unit, object
    (distance), aperture (``f_number 2``), wavelengths (micrometres), reference (from 1),
    field_kind and fields.

    Raises
    ------
    FileFormatError
        If a column is unknown or a number is none.
    PrescriptionError
        If the lens is impossible.
    """
    lines = read_prescription_text(path).splitlines()
    settings: dict[str, str] = {}
    body: list[tuple[int, str]] = []
    for count, line in enumerate(lines, start=1):
        if line.lstrip().startswith("#"):
            key, mark, value = line.lstrip("# ").partition(":")
            key = key.strip().lower().replace(" ", "_")
            near = difflib.get_close_matches(key, _SETTINGS, n=1, cutoff=0.8)
            if mark and key in _SETTINGS:
                settings[key] = value.strip()
            elif mark and near:  # else a comment
                raise damaged(path, f"'# {near[0]}: ...'", f"'# {key}: ...'", line=count)
        elif line.strip():
            body.append((count, line))
    if not body:
        raise damaged(path, "a header and rows of surfaces", "an empty table")
    names = {name: column for column, all_ in COLUMNS.items() for name in all_}
    # what spreadsheets of other countries put between cells
    between = max(",;\t", key=body[0][1].count)
    header = [cell.strip().lower() for cell in next(csv.reader([body[0][1]], delimiter=between))]
    columns: list[str | int] = []
    for cell in header:
        if cell in names:
            columns.append(names[cell])
        elif cell in _POWERS:
            columns.append(_POWERS[cell])
        else:
            near = difflib.get_close_matches(cell, names, n=2)
            hint = f" (nearest: {', '.join(near)})" if near else ""
            expected = f"columns {', '.join(COLUMNS)}, a2, a4, ..."
            raise damaged(path, expected, f"{cell!r}{hint}", line=body[0][0])
    if "thickness" not in columns or not {"radius", "curvature"} & set(map(str, columns)):
        raise damaged(path, "columns radius and thickness", ", ".join(header), line=body[0][0])
    for at, column in enumerate(columns):
        if column in columns[:at]:
            raise damaged(path, "each column once", f"{header[at]!r} twice", line=body[0][0])
    if len(body) < 2:
        raise damaged(path, "rows of surfaces", "a header only")
    surfaces = []
    for count, line in body[1:]:
        cells = next(csv.reader([line], delimiter=between))
        if len(cells) > len(columns):
            raise damaged(path, f"{len(columns)} cells", len(cells), line=count)
        row = {c: cell.strip() for c, cell in zip(columns, cells) if cell.strip()}
        surfaces.append(_surface(row, f"{path}, line {count}"))
    return _lens(surfaces, settings, path)


def _surface(row: dict[str | int, str], where: str) -> Surface:
    def get(name: str, default: float = 0.0) -> float:
        return _number(row[name], where, name) if name in row else default

    if "curvature" in row:
        curvature = get("curvature")
    else:
        radius = get("radius", np.inf)
        curvature = 0.0 if radius == 0 or not np.isfinite(radius) else 1 / radius
    mirror = row.get("glass", "").lower() in ("mirror", "refl")
    medium: Medium = AIR
    try:
        if "glass" in row and not mirror:
            medium = glass(row["glass"])
        elif "nd" in row:
            medium = _model(get("nd"), get("vd") if "vd" in row else None)
        elif "vd" in row and not mirror:
            raise PrescriptionError.expected("nd", "an index beside V_d", "none")
    except PrescriptionError as error:
        raise PrescriptionError(f"{where}: {error}") from None
    powers = sorted(k for k in row if isinstance(k, int))
    coefficients = [0.0] * (powers[-1] // 2 if powers else 0)
    for power in powers:
        coefficients[power // 2 - 1] = _number(row[power], where, f"a{power}")
    size = get("semi_diameter", np.inf)
    if "diameter" in row:
        size = get("diameter") / 2
    return Surface(
        curvature=curvature,
        thickness=get("thickness"),
        medium=medium,
        semi_diameter=size if size != 0 else np.inf,
        conic=get("conic"),
        coefficients=tuple(coefficients) if any(coefficients) else (),
        mirror=mirror,
        stop=_yes(row.get("stop", ""), where),
        label=row.get("label", ""),
    )


def _yes(word: str, where: str) -> bool:
    """Return what a cell of the column `stop` says."""
    if word.lower() in ("1", "yes", "true", "stop", "x", "*"):
        return True
    if word.lower() in ("", "0", "no", "false", "-"):
        return False
    raise FileFormatError(f"{where}: expected yes, no or nothing as stop, got {word!r}")


def _lens(surfaces: list[Surface], settings: dict[str, str], path: str | PathLike[str]) -> Lens:
    where = str(path)
    aperture = None
    if "aperture" in settings:
        words = settings["aperture"].split()
        if len(words) != 2:
            raise FileFormatError(
                f"{where}: expected 'aperture: KIND NUMBER', got {settings['aperture']!r}"
            )
        aperture = (words[0], _number(words[1], where, "aperture"))
    waves = [
        _number(w, where, "wavelengths")
        for w in settings.get("wavelengths", "0.5875618").replace(",", " ").split()
    ]
    fields = [
        (0.0, _number(w, where, "fields"))
        for w in settings.get("fields", "0").replace(",", " ").split()
    ]
    reference = _number(settings.get("reference", "1"), where, "reference")
    if not (1 <= reference < np.inf and reference == int(reference)):
        # how many there are is checked by the lens
        raise damaged(path, "a reference from 1 on", settings["reference"])
    return Lens(
        surfaces,
        object_distance=_number(settings.get("object", "inf"), where, "object"),
        aperture=aperture,
        wavelengths=waves,
        reference=int(reference) - 1,
        field_kind=settings.get("field_kind", "angle"),
        fields=fields,
        title=settings.get("title", ""),
        unit=settings.get("unit", "mm"),
    )


def read_pbrt(path: str | PathLike[str]) -> Lens:
    """Return the lens of a pbrt lens table: curvature radius, thickness, index, aperture diameter.

    Rows run from the front element to the film; radius 0 is the stop. A first row of one number is
    the focal length in some files, and is skipped.

    Raises
    ------
    FileFormatError
        If a row has no four numbers.
    """
    surfaces: list[Surface] = []
    for count, line in enumerate(read_prescription_text(path).splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words or (len(words) == 1 and not surfaces):
            continue
        if len(words) != 4:
            expected = "radius, thickness, index and diameter"
            raise damaged(path, expected, f"{len(words)} words", line=count)
        where = f"{path}, line {count}"
        radius, thickness, n, diameter = (_number(w, where, "cell") for w in words)
        try:  # the row of the stop has no index
            medium = _model(n or 1.0, None)
        except PrescriptionError as error:
            raise PrescriptionError(f"{where}: {error}") from None
        surfaces.append(
            Surface(
                curvature=1 / radius if radius else 0.0,
                thickness=thickness,
                medium=medium,
                semi_diameter=diameter / 2 if diameter else np.inf,
                stop=radius == 0 and not any(s.stop for s in surfaces),
            )
        )
    if not surfaces:
        raise damaged(path, "rows of four numbers", "none")
    if not any(s.stop for s in surfaces):
        raise damaged(path, "a row of radius 0, which is the stop", "none")
    return Lens(surfaces, aperture=("stop", 0.0))
