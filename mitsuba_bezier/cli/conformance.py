"""``mitsuba-bezier conformance``: a set of rays with known roots, and scores against it."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from .._files import check_target
from ..errors import GeometryError
from ._streams import printable

if TYPE_CHECKING:
    from ..oracles.conformance_score import Score

__all__ = ["add_parser", "markdown", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "conformance",
        help="make a set of rays with all their exact roots, score any intersector against it",
        description="Write patches, rays and all their intersections, with multiplicity and "
        "condition, found in rational arithmetic; or compare the answers of an intersector with "
        "them. docs/conformance.md describes both files and how to write answers.",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    make = actions.add_parser("make", help="write a set")
    add = make.add_argument
    add("output", metavar="SET", help="the file to write, JSON lines")
    add("--seed", type=_count, default=0, help="another set of the same kind (0)")
    add("--degrees", type=_degrees, default=(1, 2, 3, 4, 5), metavar="LIST", help="(1,2,3,4,5)")
    add("--patches", type=_count, default=8, metavar="N", help="patches a family and degree (8)")
    add("--rays", type=_count, default=6, metavar="N", help="rays a patch (6)")
    add("--family", action="append", metavar="NAME", help="only this one; may be given again")
    add(
        "--arithmetic",
        choices=("exact", "float64"),
        default="exact",
        help="rational numbers and elimination, or float64 and subdivision (exact)",
    )
    scores = actions.add_parser("score", help="compare answers with a set")
    scores.add_argument("set", metavar="SET", help="the set")
    scores.add_argument("answers", metavar="ANSWERS", nargs="+", help="files of answers to it")
    scores.add_argument("--degree", action="store_true", help="a row a degree, too")


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() else -1
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"expected an integer from 0 up, got {text!r}")
    return value


def _degrees(text: str) -> tuple[int, ...]:
    out = tuple(int(part) if part.isdecimal() else 0 for part in text.split(","))
    if not all(1 <= n <= 8 for n in out):  # elimination takes minutes a ray beyond
        raise argparse.ArgumentTypeError(f"expected degrees from 1 to 8, as 2,3; got {text!r}")
    return out


def run(args: argparse.Namespace) -> int:
    """Make or score; return 0, or 1 if a firm root was missed or a hit is no root."""
    if args.action == "make":
        return _make(args)
    from ..oracles.conformance_score import score

    failed = False
    for path in args.answers:
        head, scores = score(args.set, path)
        first = "first hits" if head["first"] else "all hits"
        print(printable(f"{head['name']}: {head['precision']} precision, {first}"))
        print(markdown(scores, args.degree))
        failed |= any(s.missed or s.extra for s in scores.values())
    return int(failed)


def _make(args: argparse.Namespace) -> int:
    from ..oracles.conformance import write_set
    from ..oracles.conformance_cases import FAMILIES, cases

    check_target(args.output, "SET")
    families = tuple(args.family or FAMILIES)
    for name in families:
        if name not in FAMILIES:
            raise GeometryError.expected("--family", " or ".join(FAMILIES), repr(name))
    chosen = cases(args.seed, args.degrees, args.patches, args.rays, families)
    count = write_set(args.output, chosen, args.arithmetic)
    print(printable(f"{args.output}: {count} rays"), file=sys.stderr)
    return 0


def markdown(scores: dict[str, Score], by_degree: bool = False) -> str:
    """Return scores as a Markdown table, a row a family or, `by_degree`, a row a degree too."""
    from ..oracles.conformance_score import Score

    rows: dict[str, Score] = {}
    for key, one in scores.items():
        for name in (key if by_degree else key.rsplit(" ", 1)[0], "all"):
            rows.setdefault(name, Score()).add(one)
    rows["all"] = rows.pop("all")
    lines = ["| family | rays | refused | roots | missed | extra | median error | worst error |"]
    lines.append("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, s in rows.items():
        errors = sorted(s.errors)
        figures = [f"{x:.2g}" for x in (errors[len(errors) // 2], errors[-1])] if errors else "--"
        cells = [name, s.rays, s.refused, s.firm, s.missed, s.extra, *figures]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)
