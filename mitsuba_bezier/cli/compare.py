"""``mitsuba-bezier compare``: two images or two folders of images, with a verdict and a report."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._files import check_target, is_same, refuse_inputs, write_file
from ..errors import FileFormatError
from ._streams import printable
from .render import stops

if TYPE_CHECKING:
    from ..verification.comparison import Comparison
    from ..verification.records import Record

__all__ = ["add_parser", "check_reports", "run"]

_MEASURES = ("RMSE", "relative MSE", "max", "FLIP", "Z-test")


def _limit(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not value >= 0:
        raise argparse.ArgumentTypeError(f"expected a number >= 0, got {text!r}")
    return value


def _samples(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a number of samples >= 1, got {text!r}")
    return int(text)


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "compare",
        help="compare images or folders of images",
        description="Compare two images (.exr, .png), or the images of two folders by their "
        "names, layer by layer: RMSE, relative MSE, largest difference, FLIP, and a Z-test where "
        "the variance is known. Without a limit and a variance, images must be equal.",
        epilog="Exit code: 0 all pass, 1 some fail, 2 some could not be compared. "
        "'mitsuba-bezier accept report.html' lets B take the place of A.",
    )
    add = parser.add_argument
    add("reference", metavar="A", help="reference image or folder")
    add("test", metavar="B", help="image or folder to be tested")
    add("--html", metavar="FILE", help="write a report to look at")
    add(
        "--html-form",
        choices=("auto", "page", "folder"),
        default="auto",
        help="all of it in one page, pictures in a folder FILE_files beside it, or one page up to "
        "20 MB (auto)",
    )
    add("--json", metavar="FILE", help="write the numbers; '-' for standard output")
    add("--only", metavar="PATTERN", default="*", help="compare only images of such names")
    limits = parser.add_argument_group("limits (over those of --thresholds)")
    limit = limits.add_argument
    limit("--thresholds", metavar="FILE", help="TOML file with limits by image")
    limit("--rmse", metavar="X", type=_limit, help="largest root mean square difference")
    limit("--relative-mse", metavar="X", type=_limit, help="largest mean of d^2 / (a^2 + 0.01)")
    limit("--max-abs", metavar="X", type=_limit, help="largest difference of any pixel")
    limit("--flip", metavar="X", type=_limit, help="largest mean FLIP error")
    z_test = limits.add_mutually_exclusive_group()
    z_test.add_argument(
        "--z-test",
        action="store_true",
        default=None,
        help="demand the Z-test (by default it counts where it is possible)",
    )
    z_test.add_argument(
        "--no-z-test", action="store_false", dest="z_test", help="leave the Z-test out"
    )
    limit("--z-share", metavar="X", type=_limit, help="share of pixels that must pass it (0.9975)")
    limit("--allow-nan", action="store_true", default=None, help="let NaN and infinity pass")
    add("--spp", metavar="N", type=_samples, help="samples of B, if its header tells none")
    add("--exposure", metavar="EV", type=stops, help="stops, for the report (by the reference)")


def run(args: argparse.Namespace) -> int:
    """Compare, print the table, write the files; return 0, 1 or 2."""
    from ..verification import comparison, report
    from ..verification.origin import commit_of, machine
    from ..verification.records import without_folders
    from ..verification.thresholds import Thresholds

    for name, value in (("A", args.reference), ("B", args.test)):
        if not value:
            raise FileFormatError.expected(name, "an image or a folder", "an empty name")
    check_reports(args, [args.reference, args.test, args.thresholds])
    names = ("rmse", "relative_mse", "max_abs", "flip", "z_test", "z_share", "allow_nan")
    flags = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.thresholds:
        thresholds = Thresholds.load(args.thresholds, flags)
    else:
        thresholds = Thresholds(flags=flags)

    found, entries = [], []
    started = time.perf_counter()
    for result in comparison.compare_paths(
        args.reference, args.test, thresholds, args.spp, only=args.only
    ):
        if args.html:
            made = report.entry(result, _repeat(args, result.name), args.exposure)
            entries.append(report.from_record(made, _record(args, result), result.state))
        found.append((result.as_json(), result.state))
        del result  # only one pair of images is in memory at a time

    outcome = [data for data, _ in found]
    note = ""
    if args.html:
        note = report.write_report(
            args.html,
            entries,
            "Comparison of images",
            f"Reference: {Path(args.reference).name}, test: {Path(args.test).name}",
            without_folders(shlex.join(args.argv)),
            run={
                **commit_of(Path()),
                "machine": machine(),
                "seconds": round(time.perf_counter() - started, 2),
                "root": ".",
                "report": without_folders(args.html),
                "accept": True,
            },
            form=args.html_form,
        )
    if args.json == "-":
        print(json.dumps(outcome, indent=2))  # in ASCII, whatever the locale
    else:
        if args.json:
            _write_json(args.json, outcome)
        _print(outcome)
        if args.html:
            print(f"report: {args.html}" + (f"\nreport: {note}" if note else ""))
    states = {state for _, state in found}
    return 2 if "error" in states else 1 if "fail" in states else 0


def _record(args: argparse.Namespace, result: Comparison) -> Record:
    """Return what a report tells of a comparison; its paths are relative to the report."""
    from ..verification.accept import digest
    from ..verification.records import Record, measures, relative

    folder = Path(args.html).resolve().parent
    a, b = result.reference, result.test
    if a is None and b is not None:  # where it would have its counterpart
        a = Path(args.reference) / b.relative_to(args.test)
    return Record(
        title=result.name,
        name=result.name,
        state=result.change,
        reference="" if a is None else relative(a, folder),
        image="" if b is None else relative(b, folder),
        candidate="" if b is None else relative(b, folder),
        message=result.error,
        measures=measures(result),
        notes=result.notes,
        was="" if a is None else digest(a),
    )


def _repeat(args: argparse.Namespace, name: str) -> str:
    """Return the command line for one image alone, without the files that it would overwrite."""
    words: list[str] = []
    skip = False
    for word in args.argv:
        is_output = word in ("--html", "--json")
        if not (skip or is_output or word.startswith(("--html=", "--json="))):
            words.append(word)
        skip = is_output
    if Path(args.reference).is_dir() and args.only == "*":
        words += ["--only", name]
    return shlex.join(words)


def check_reports(args: argparse.Namespace, inputs: Sequence[str | None] = ()) -> None:
    """Make sure, before any work, that the files of ``--html`` and ``--json`` can be written.

    Raises
    ------
    FileFormatError
        If not, or if they are one file, or one of those that are read.
    """
    for flag, path, suffixes in (
        ("--html", args.html, (".html", ".htm")),
        ("--json", None if args.json == "-" else args.json, None),
    ):
        if path is None:
            continue
        check_target(path, flag, make_folders=True)
        suffix = Path(path).suffix.lower()
        if suffixes and suffix not in suffixes:
            raise FileFormatError.expected(flag, "a name that ends in .html", path)
        if suffix in (".exr", ".png"):
            raise FileFormatError.expected(flag, "a name that is none of an image", path)
        refuse_inputs(path, filter(None, inputs), flag)
    if args.html and args.json and is_same(args.html, args.json):
        raise FileFormatError.expected("--json", "another file than --html", args.json)


def _write_json(path: str, outcome: list[dict[str, Any]]) -> None:
    text = json.dumps(outcome, indent=2, ensure_ascii=False) + "\n"
    # a file name may hold bytes that are no text; JSON has the same escape for them
    write_file(path, text.encode("utf-8", "backslashreplace"), make_folders=True)


def _print(outcome: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(file=sys.stdout)
    styles = {"pass": "green", "fail": "bold red", "error": "yellow"}
    table = Table(show_edge=False, pad_edge=False)
    table.add_column("image", overflow="fold")
    table.add_column("")
    for measure in _MEASURES:
        table.add_column(measure, justify="right")
    lines: list[tuple[str, str]] = []
    for image in outcome:
        state, name = image["state"], printable(image["name"])
        if state == "error":
            table.add_row(Text(name), Text(state, style=styles[state]))
            lines.append((f"{name}: {image['error']}", styles[state]))
        for layer in image["layers"]:
            title = name + (printable(f":{layer['name']}") if layer["name"] else "")
            failed = [check for check in layer["checks"] if check["passed"] is False]
            verdict = "fail" if failed else "pass"
            values = {check["name"]: check for check in layer["checks"]}
            cells = [_cell(values.get(measure)) for measure in _MEASURES]
            table.add_row(Text(title), Text(verdict, style=styles[verdict]), *cells)
            lines += [(f"{title}: {check['text']}", styles["fail"]) for check in failed]
    console.print(table)
    for line, style in lines:
        console.print(Text(printable(line), style=style), soft_wrap=True)
    states = [image["state"] for image in outcome]
    words = [("pass", "passed"), ("fail", "failed"), ("error", "not compared")]
    counts = [f"{states.count(s)} {word}" for s, word in words if s in states]
    console.print(Text(f"{len(states)} compared: " + ", ".join(counts)))


def _cell(check: dict[str, Any] | None) -> Any:
    from rich.text import Text

    if check is None or check["value"] is None:
        return Text("")
    value = check["value"]
    text = f"{100 * value:.2f} %" if check["name"] == "Z-test" else f"{value:.4g}"
    return Text(text, style="red" if check["passed"] is False else "")
