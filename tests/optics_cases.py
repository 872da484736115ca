"""Sample lenses as ``tests/optics/record_optiland.py`` has recorded them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mitsuba_bezier.optics import AIR, Constant, Lens, Surface


def recorded() -> dict[str, dict[str, Any]]:
    """Return the records by the names of the lenses."""
    path = Path(__file__).with_name("optics") / "optiland.json"
    return json.loads(path.read_text())["lenses"]


def lens_of(record: dict[str, Any]) -> Lens:
    """Return the recorded lens, with the indices of its glass; its field is the largest one."""
    rows = record["surfaces"]
    surfaces = [
        Surface(
            curvature=row["curvature"],
            thickness=rows[i + 1]["z"] - row["z"],
            medium=AIR if row["mirror"] else Constant(row["n"]),
            conic=row["conic"],
            mirror=row["mirror"],
            stop=row["stop"],
        )
        for i, row in enumerate(rows[1:-1], start=1)
    ]
    kind, value = record["aperture"]
    return Lens(
        surfaces,
        aperture=({"EPD": "diameter", "imageFNO": "f_number"}[kind], value),
        wavelengths=[record["wavelength"]],
        fields=[(0, record["field"])],
    )
