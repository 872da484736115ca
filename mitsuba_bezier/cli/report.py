"""``mitsuba-bezier report``: runs of pytest, shards of one, as one report."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .._files import check_target
from ..errors import FileFormatError

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "report",
        help="merge runs of pytest into one report",
        description="Merge what runs of pytest left (shards, retries, machines) into one report. "
        "What comes twice counts as the last run has it.",
        epilog="Exit code: 0 if no image fails, 1 if some do, 2 if a run cannot be read.",
    )
    add = parser.add_argument
    add("runs", metavar="RUN", nargs="+", help="results.json, or the folder that has it")
    add("-o", "--output", metavar="FILE.html", default="report.html", help="(report.html)")
    add("--root", metavar="DIR", type=Path, default=Path(), help="folder of the project (.)")
    add("--form", choices=("auto", "page", "folder"), default="auto", help="as --html-form (auto)")
    add("--summary", metavar="FILE", help="add a summary in Markdown to a file")


def run(args: argparse.Namespace) -> int:
    """Merge and write; return 0 or 1."""
    from ..verification import runs
    from ..verification.records import relative
    from ..verification.summary import append_summary, markdown

    check_target(args.output, "--output", make_folders=True)
    if Path(args.output).suffix.lower() not in (".html", ".htm"):
        raise FileFormatError.expected("--output", "a name that ends in .html", args.output)
    about, found = runs.read_runs(args.runs)
    folders = {record.title: folder for record, folder in found}
    records = runs.sort([record for record, _folder in found])
    pairs = [(record, folders[record.title]) for record in records]
    target = Path(args.output)
    note = runs.write_run_report(target, args.root, about, pairs, args.form)
    about["report"] = relative(target.resolve(), args.root.resolve())
    text = markdown(about, records)
    if args.summary:
        append_summary(text, args.summary)
    print(text.splitlines()[0].lstrip("# "))
    print(f"report: {args.output}" + (f"\nreport: {note}" if note else ""))
    return 1 if any(record.failed for record in records) else 0
