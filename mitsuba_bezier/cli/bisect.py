"""``mitsuba-bezier bisect``: the commit that changed an image."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ._streams import printable

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "bisect",
        help="find the commit that changed an image",
        description="Find the first commit after GOOD, up to BAD, whose render differs from the "
        "reference that GOOD has. Each commit is checked out into a worktree of its own, in the "
        "folder of temporary files, and pytest runs the test there; your files stay as they are. "
        "Code of these commits is run.",
        epilog="Exit code: 0 if it is found, 2 if not.",
    )
    add = parser.add_argument
    add("good", metavar="GOOD", help="commit whose render is as its reference")
    add("bad", metavar="BAD", help="commit whose render is not")
    add("test", metavar="TEST", help="node id of the test, such as tests/test_lens.py::test_lens")
    add("--image", metavar="NAME", help="name of the image, if the test has several")
    add("--repository", metavar="DIR", type=Path, default=Path(), help="(the current folder)")
    add("--seconds", metavar="S", type=float, default=3600.0, help="for a commit at most (3600)")


def run(args: argparse.Namespace) -> int:
    """Bisect; return 0."""
    from ..verification.bisect import Bisection

    with Bisection(args.repository, args.test, args.image, args.seconds) as bisection:
        for step in bisection.search(args.good, args.bad):
            print(printable(f"{step.verdict:10} {step.commit[:10]} {step.subject}"), flush=True)
        first = bisection.first
    print(printable(f"first changed: {first.commit} {first.subject}"))
    if bisection.skipped:
        names = ", ".join(commit[:10] for commit in bisection.skipped)
        print(f"or one of those before it that could not be tested: {names}")
    return 0
