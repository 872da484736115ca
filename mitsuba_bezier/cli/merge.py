"""``mitsuba-bezier merge``: add up renders of one scene with different seeds."""

from __future__ import annotations

import argparse
import shlex
import sys
from typing import Any

from ._streams import printable

__all__ = ["add_parser", "run"]

#: `verification.merge.MISSING`, `UNFINISHED`, `DIFFERENCES`, which would take a second to import.
ALLOWED = ("missing", "unfinished", "scene", "sensor", "integrator", "filter", "colours")


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "merge",
        help="add up renders of one scene with different seeds",
        description="Merge EXR files of one scene rendered with different seeds into one, "
        "weighted by their samples per pixel. The headers must tell 'spp' and 'seed', as those "
        "of 'mitsuba-bezier render' do. The order of the parts does not matter. What does not "
        "belong together is refused: parts of another scene, sensor, integrator, filter or kind "
        "of colours, and a render of which a part is missing or was interrupted.",
    )
    add = parser.add_argument
    add("parts", metavar="PART", nargs="+", help="EXR files")
    add("-o", "--output", metavar="OUT.exr", required=True, help="the merged file")
    add(
        "--keep-sums",
        action="store_true",
        help="also write the exact sums, so that the result can be merged again without loss",
    )
    add(
        "--allow",
        metavar="NAME",
        choices=ALLOWED,
        action="append",
        default=[],
        help=f"merge nevertheless, one of {', '.join(ALLOWED)}; may be given several times",
    )
    add("--allow-nan", action="store_true", help="let NaN and infinity pass; they stay")
    add("-q", "--quiet", action="store_true", help="show errors only")


def run(args: argparse.Namespace) -> int:
    """Merge and write the file; return 0."""
    from ..verification.merge import merge_files
    from . import _images

    output = _images.check_output(args.output, preview=False)
    total, rounded = merge_files(
        args.parts, output, shlex.join(args.argv), args.keep_sums, args.allow_nan, args.allow
    )
    if not args.quiet:
        if rounded:
            print(
                "mitsuba-bezier: note: rounded before, so the result is not that of one process "
                f"to the last bit: {printable(', '.join(rounded))}",
                file=sys.stderr,
            )
        print(
            f"mitsuba-bezier: wrote {printable(args.output)}: {len(args.parts)} parts, "
            f"{total.spp} spp",
            file=sys.stderr,
        )
    return 0
