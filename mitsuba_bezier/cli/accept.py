"""``mitsuba-bezier accept``: what a report shows becomes the reference."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ._streams import printable

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "accept",
        help="let what a report shows become the references",
        description="Let the pictures of a report, of pytest or of 'compare', take the place of "
        "their references: what has changed, what is new; what was removed goes. Nothing is "
        "rendered: what you have seen is what you get.",
        epilog="Exit code: 0, or 2 if something cannot be accepted; then nothing is.",
    )
    add = parser.add_argument
    add("report", metavar="REPORT", help="report.html, or results.json beside it")
    add(
        "names",
        metavar="NAME",
        nargs="*",
        help="images or tests, or patterns of them; all that differ, if none is given",
    )
    add("--root", metavar="DIR", type=Path, help="folder of the project, above the references")
    add("--list", action="store_true", help="show what would be done, and do nothing")


def run(args: argparse.Namespace) -> int:
    """Accept; return 0."""
    from ..verification import accept

    steps = accept.plan(args.report, args.names, args.root)
    if not args.list:
        accept.apply(steps)
    words = {"changed": "changed", "new": "new", "removed": "removed", "error": "changed"}
    for step in steps:
        print(printable(f"{words[step.record.state]:8} {step.record.reference}"))
    count = f"{len(steps)} reference{'' if len(steps) == 1 else 's'}"
    print(f"{count} to be accepted" if args.list else f"{count} accepted")
    return 0
