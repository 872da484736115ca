"""``mitsuba-bezier convert``: from any file that can be read to any that can be written."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from .._files import check_target, refuse_inputs
from ._limits import add_limits
from ._streams import printable

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "convert",
        help="convert curved surfaces between file formats",
        description="Read surfaces and write them as Bézier triangles. The suffixes tell the "
        "formats: .vtu, Gmsh .msh, Geomview .bez and .off, BezierView .bv, OBJ free form, STEP, "
        "IGES, BREP, .3dm in; .vtu, .bv and .ply (flat triangles) out. Faces that cannot be "
        "converted are named on stderr.",
    )
    add = parser.add_argument
    add("input", metavar="IN", help="the file to read")
    add("output", metavar="OUT", help="the file to write")
    add(
        "--chord-error",
        metavar="LENGTH",
        type=float,
        help="for .ply: largest distance of an edge from the surface (default: 1/1000 of the "
        "bounding box's diagonal)",
    )
    add(
        "--encoding",
        choices=("appended", "binary", "ascii"),
        help="for .vtu: raw, base64 or text (default: appended)",
    )
    add(
        "--trims",
        action="store_true",
        help="for .vtu: keep faces that are trimmed by curves as patches with trims, which "
        "renders here show exactly and other programs show whole (default: restrict the patches)",
    )
    add("--elevate", action="store_true", help="elevate all patches to the highest degree")
    add("--strict", action="store_true", help="exit with 1 if a face was refused")
    add("-q", "--quiet", action="store_true", help="show errors only")
    add_limits(parser)


def run(args: argparse.Namespace) -> int:
    """Convert the file; return 0, or 1 if faces were refused and ``--strict`` is given."""
    from ..io import read, save, writer_options

    options: dict[str, Any] = {
        name: value
        for name, value in (
            ("chord_error", args.chord_error),
            ("encoding", args.encoding),
            ("trims", args.trims or None),
        )
        if value is not None
    }
    writer_options(args.output, options)  # a wrong suffix is told before the work is done
    check_target(args.output, "OUT")
    refuse_inputs(args.output, [args.input], "OUT")
    model = read(args.input, trims=args.trims)
    report = model.report
    groups, trims = model.groups, model.trims or [None] * len(model.groups)
    if args.elevate:
        joined, joined_trims = model.trimmed()
        groups, trims = [joined], [joined_trims]
    if args.trims:
        options["trims"] = trims
    told = _fields(model, groups, args.output, options)
    save(groups, args.output, **options)
    if not args.quiet:
        for note in report.notes:
            print(f"mitsuba-bezier: note: {printable(note)}", file=sys.stderr)
        if told:
            print(f"mitsuba-bezier: note: {printable(told)}", file=sys.stderr)
        for refusal in report.refused:
            print(f"mitsuba-bezier: refused: {printable(str(refusal))}", file=sys.stderr)
        patches = sum(map(len, groups))
        degrees = ", ".join(str(g.degree) for g in groups)
        print(
            f"mitsuba-bezier: wrote {args.output}: {patches} patches of degree {degrees} from "
            f"{report.converted} of {report.faces} faces",
            file=sys.stderr,
        )
    return 1 if args.strict and report.refused else 0


def _fields(model: Any, groups: list[Any], output: str, options: dict[str, Any]) -> str:
    """Add the fields of a model to the options of its writer; return a note if that cannot be."""
    if not model.fields:
        return ""
    names = ", ".join(repr(name) for name in list(model.fields)[:20])
    if not output.lower().endswith(".vtu"):
        return f"fields are not written, which only .vtu can hold: {names}"
    if len(groups) > 1:
        return f"fields are not written for patches of several degrees (see --elevate): {names}"
    options["fields"] = list(model.fields.values())
    options["edges"] = model.edges
    return ""
