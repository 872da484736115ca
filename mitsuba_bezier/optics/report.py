"""Describe a lens in text: its surfaces, first-order data, and spots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import PrescriptionError
from .beams import distortion, spot
from .lens import Lens
from .paraxial import first_order


def _number(value: float, digits: int = 6) -> str:
    return "infinity" if not np.isfinite(value) else f"{value:.{digits}g}"


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return rows of cells as lines whose columns stand under each other."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows)]
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths)).rstrip() for row in rows]


def report(lens: Lens, wavelength: float | None = None) -> str:
    """Return a description of a lens as text of several lines.

    First-order data, the surfaces, and for each field the distortion and the spot's radius (root
    mean square, all wavelengths about their common centroid).

    Parameters
    ----------
    lens : Lens
        The lens.
    wavelength : float, optional
        In micrometres, of first-order data; the reference wavelength by default.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, report
    >>> print(report(Lens([Surface(-1 / 200, -100, mirror=True)])).splitlines()[1].split())
    ['effective', 'focal', 'length', '100']
    """
    data = first_order(lens, wavelength)
    unit = lens.unit
    rows = [
        ("effective focal length", data.focal_length),
        ("front focus (from the first vertex)", data.front_focus),
        ("back focus (from the last vertex)", data.back_focus),
        ("front principal point", data.front_principal),
        ("back principal point", data.back_principal),
        ("paraxial image (from the last vertex)", data.image),
        ("magnification", data.magnification),
        ("f-number", data.f_number),
        ("working f-number", data.working_f_number),
        ("entrance pupil (from the first vertex)", data.entrance_pupil),
        ("entrance pupil diameter", data.entrance_diameter),
        ("exit pupil (from the last vertex)", data.exit_pupil),
        ("exit pupil diameter", data.exit_diameter),
        ("Petzval radius", data.petzval),
        ("length", data.length),
    ]
    out = [f"{lens.title or 'Lens'}: lengths in {unit}, at {data.wavelength:.4f} micrometres"]
    out += [f"{name:<39}{_number(value)}" for name, value in rows if not np.isnan(value)]
    table = [("surface", "radius", "thickness", "medium", "semi-diameter", "conic", "")]
    media, index = lens.media(), lens.indices(data.wavelength)
    for i, s in enumerate(lens.surfaces):
        what = "mirror" if s.mirror else (media[i + 1].name or f"n = {index[i + 1]:.5f}")
        marks = " stop" if i == lens.stop and s.stop else ""
        marks += f" asphere to r^{2 * len(s.coefficients)}" if not s.is_conic else ""
        size = "-" if not np.isfinite(s.semi_diameter) else _number(s.semi_diameter)
        cells = (_number(s.radius), _number(s.thickness), what, size, _number(s.conic))
        table.append((str(i + 1), *cells, marks.strip()))
    out += ["", *_aligned(table)]
    lines = []
    for x, y in lens.field_points():
        try:
            found = [spot(lens, (x, y), w) for w in lens.wavelengths]
            points = np.concatenate([f.points for f in found])
            rms = np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())
            passed = np.mean([f.transmitted for f in found])
            off = f"{distortion(lens, (x, y)):+.3%}"
            lines.append((f"{x:g}, {y:g}", _number(rms, 4), f"{passed:.1%}", off))
        except PrescriptionError as error:
            lines.append((f"{x:g}, {y:g}", str(error), "", ""))
    if np.isfinite(data.entrance_diameter):
        kind = {"angle": "degrees"}.get(
            lens.field_kind, f"{lens.field_kind.replace('_', ' ')}, {unit}"
        )
        head = (f"field ({kind})", "spot rms", "arrive", "distortion")
        out += ["", *_aligned([head, *lines])]
    notes = [*lens.notes, *lens.crossings()]
    if not any(s.stop for s in lens.surfaces):
        notes.append("no surface is marked as the stop: the first one is taken")
    out += [f"note: {note}" for note in notes]
    return "\n".join(out)
