"""``mitsuba-bezier figure``: the figures and films of the lecture, as SVG, PDF, PNG, GIF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .._files import check_target
from ..errors import BezierError
from ._limits import add_limits
from ._streams import printable

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "figure",
        help="draw a figure of the lecture",
        description="Draw a figure of the lecture by its name, with weights, parameters and angles "
        "as you like. Needs the extra 'figures' (matplotlib).",
    )
    add = parser.add_argument
    add("name", metavar="NAME", nargs="*", help="which figures; without any they are listed")
    add(
        "-o",
        "--output",
        metavar="FILE",
        help="where to write it: .svg, .pdf, .png, .webp, .jpg; a folder for several (default: "
        "NAME.svg)",
    )
    add(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="an argument of the figure, such as t=0.3 or weight=-0.5; may be given again",
    )
    add("--width", metavar="PIXELS", type=int, default=1600, help="of images (default: 1600)")
    add(
        "--style",
        default="screen",
        help="'screen', or 'print' for black and grey alone (default: screen)",
    )
    add("-q", "--quiet", action="store_true", help="show errors only")
    add_limits(parser)


def arguments(words: list[str]) -> dict[str, Any]:
    """Return ``KEY=VALUE`` words as keywords; values are numbers.

    Raises
    ------
    BezierError
        If a word is not of this form.
    """
    out: dict[str, Any] = {}
    for word in words:
        key, sign, value = word.partition("=")
        try:
            if not sign or not key.isidentifier():
                raise ValueError
            number = float(value)
        except ValueError:
            raise BezierError.expected("--set", "KEY=NUMBER", repr(printable(word))) from None
        out[key] = number
    return out


def run(args: argparse.Namespace) -> int:
    """Draw the figures, or list them; return 0."""
    from .. import figures

    if not args.name:
        known = figures.names()
        width = max(map(len, known))
        for name, text in known.items():
            print(f"{name:{width}}  {text}")
        return 0
    values = arguments(args.set)
    output = Path(args.output or ".")
    folder = len(args.name) > 1 or args.output is None or output.is_dir() or not output.suffix
    for name in args.name:
        path = output / f"{name}.svg" if folder else output
        if path.suffix.lower() not in figures.SUFFIXES:
            raise BezierError.expected(
                "-o", "a suffix " + ", ".join(figures.SUFFIXES), repr(printable(path.suffix))
            )
        if path.parent.is_dir():
            check_target(str(path), "-o")
        figures.draw(name, style=args.style, **values).save(path, args.width)
        if not args.quiet:
            print(f"wrote {printable(str(path))}")
    return 0
