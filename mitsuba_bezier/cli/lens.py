"""``mitsuba-bezier lens``: describe and draw a lens by its prescription."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from typing import Any

__all__ = ["add_parser", "run"]


_DRAWINGS = {
    "section": "the section, with rays of every field",
    "spots": "spot diagrams",
    "mtf": "the geometric modulation transfer function",
    "distortion": "distortion by field",
    "field-curvature": "tangential and sagittal foci by field",
    "focus": "spots and modulation before and behind the image plane",
}


def _check_rays(lens: Any) -> None:
    """Raise an error if no field has a ray that arrives; what else is known has been printed."""
    from ..errors import PrescriptionError
    from ..optics import first_order, spot

    if not math.isfinite(first_order(lens).entrance_diameter):
        return  # nobody has said how wide the beam is
    for field in lens.field_points():
        try:
            spot(lens, field)
            return
        except PrescriptionError:
            continue
    raise PrescriptionError.expected(
        "fields", "one at least from which rays arrive", f"none of {len(lens.field_points())}"
    )


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "lens",
        help="describe and draw a lens by its prescription",
        description="Read a prescription (.zmx, .seq, .csv, pbrt's .dat) and print its surfaces, "
        "first-order data, spots and distortion. Draw its section and charts of its image; "
        "OUT is a .svg, .png or .pdf.",
    )
    parser.add_argument("file", metavar="FILE", help="the prescription")
    for name, what in _DRAWINGS.items():
        parser.add_argument(f"--{name}", metavar="OUT", help=f"draw {what}")
    parser.add_argument(
        "--frequency",
        type=float,
        metavar="F",
        help="in periods per unit of length: where --mtf ends, and what --focus shows",
    )
    parser.add_argument(
        "--wavelength", type=float, metavar="UM", help="of first-order data, in micrometres"
    )
    parser.add_argument("--json", action="store_true", help="print first-order data as JSON")
    from . import _lens_render

    _lens_render.add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    from .. import optics
    from .._files import is_same
    from ..errors import PrescriptionError
    from ..optics.drawing import check_drawing
    from . import _lens_render

    _lens_render.check_options(args)

    if args.frequency is not None and not 0 < args.frequency < float("inf"):
        raise PrescriptionError.expected("--frequency", "a positive number", args.frequency)
    if args.wavelength is not None and not 0 < args.wavelength < float("inf"):
        raise PrescriptionError.expected(
            "--wavelength", "a positive number of micrometres", args.wavelength
        )
    drawings = {
        "section": optics.draw_section,
        "spots": optics.draw_spots,
        "mtf": lambda lens: optics.draw_mtf(lens, args.frequency),
        "distortion": optics.draw_distortion,
        "field-curvature": optics.draw_field_curvature,
        "focus": lambda lens: optics.draw_focus(lens, args.frequency),
    }
    outputs = {name: getattr(args, name.replace("-", "_")) for name in drawings}
    used: list[str] = []
    for name, path in outputs.items():  # before any work
        if path is not None:
            check_drawing(path, f"--{name}")
            if any(is_same(path, other) for other in used):
                raise PrescriptionError.expected(f"--{name}", "a file of its own", repr(path))
            used.append(path)
    lens = optics.load(args.file)
    if args.json:
        data = asdict(optics.first_order(lens, args.wavelength))
        # JSON has no infinity
        print(json.dumps({k: v if math.isfinite(v) else None for k, v in data.items()}, indent=1))
    else:
        print(optics.report(lens, args.wavelength))
        _check_rays(lens)
    for name, path in outputs.items():
        if path is not None:
            optics.save_figure(drawings[name](lens), path)
    if args.render is not None:
        _lens_render.render(args, lens)
    return 0
