"""``mitsuba-bezier history``: how the measures of images went over many runs."""

from __future__ import annotations

import argparse
from typing import Any

from .._files import check_target, write_file

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "history",
        help="plot the measures of images over many runs",
        description="Plot the measures of each image over the runs that 'pytest --bezier-history "
        "FOLDER' wrote there, with limits and what noise alone gives, as a page.",
    )
    parser.add_argument("folder", metavar="FOLDER", help="one JSON file for each run")
    parser.add_argument("-o", "--output", metavar="FILE.html", default="history.html")


def run(args: argparse.Namespace) -> int:
    """Plot; return 0."""
    from ..verification.history import read_history, render_history

    check_target(args.output, "--output", make_folders=True)
    runs = read_history(args.folder)
    text = render_history(runs).encode("utf-8", "backslashreplace")
    write_file(args.output, text, make_folders=True)
    print(f"{len(runs)} runs: {args.output}")
    return 0
