"""``mitsuba-bezier merge``: add up renders of one scene with different seeds."""

from __future__ import annotations

import argparse
import shlex
import sys
from typing import Any

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "merge",
        help="add up renders of one scene with different seeds",
        description="Merge EXR files of one scene rendered with different seeds into one, "
        "weighted by their samples per pixel. The headers must tell 'spp' and 'seed', as those "
        "of 'mitsuba-bezier render' do. The order of the parts does not matter.",
    )
    add = parser.add_argument
    add("parts", metavar="PART", nargs="+", help="EXR files")
    add("-o", "--output", metavar="OUT.exr", required=True, help="the merged file")
    add(
        "--keep-sums",
        action="store_true",
        help="also write the exact sums, so that the result can be merged again without loss",
    )
    add("--allow-nan", action="store_true", help="let NaN and infinity pass; they stay")
    add("-q", "--quiet", action="store_true", help="show errors only")


def run(args: argparse.Namespace) -> int:
    """Merge and write the file; return 0."""
    from ..verification.merge import merge_files

    total, rounded = merge_files(
        args.parts, args.output, shlex.join(args.argv), args.keep_sums, args.allow_nan
    )
    if not args.quiet:
        if rounded:
            print(
                "mitsuba-bezier: note: rounded before, so the result is not that of one process "
                f"to the last bit: {', '.join(rounded)}",
                file=sys.stderr,
            )
        print(
            f"mitsuba-bezier: wrote {args.output}: {len(args.parts)} parts, {total.spp} spp",
            file=sys.stderr,
        )
    return 0
