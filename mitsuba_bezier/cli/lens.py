"""``mitsuba-bezier lens``: describe and draw a lens by its prescription."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "lens",
        help="describe and draw a lens by its prescription",
        description="Read a prescription (.zmx, .seq, .csv, pbrt's .dat) and print its surfaces, "
        "first-order data, spots and distortion. Draw its section and its spot diagrams.",
    )
    parser.add_argument("file", metavar="FILE", help="the prescription")
    parser.add_argument("--section", metavar="OUT", help="draw the section: .svg, .png or .pdf")
    parser.add_argument("--spots", metavar="OUT", help="draw spot diagrams: .svg, .png or .pdf")
    parser.add_argument(
        "--wavelength", type=float, metavar="UM", help="of first-order data, in micrometres"
    )
    parser.add_argument("--json", action="store_true", help="print first-order data as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    from ..errors import PrescriptionError
    from ..optics import draw_section, draw_spots, first_order, load, report, save_figure

    if args.wavelength is not None and not 0 < args.wavelength < float("inf"):
        raise PrescriptionError.expected(
            "--wavelength", "a positive number of micrometres", args.wavelength
        )
    lens = load(args.file)
    if args.json:
        print(json.dumps(asdict(first_order(lens, args.wavelength)), indent=1))
    else:
        print(report(lens))
    if args.section:
        save_figure(draw_section(lens), args.section)
    if args.spots:
        save_figure(draw_spots(lens), args.spots)
    return 0
