"""``mitsuba-bezier film``: the films of the lecture, frame by frame, resumed."""

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
        "film",
        help="make a film of the lecture",
        description="Make a film of a figure whose parameter runs. Frames are kept in a folder "
        "beside it: a film that was broken off goes on. Needs the extra 'figures'.",
    )
    add = parser.add_argument
    add("name", metavar="NAME", nargs="?", help="which film; without one they are listed")
    add("-o", "--output", metavar="FILE", help=".gif or .mp4 (default: NAME.gif)")
    add("--frames", type=int, default=96, help="how many (default: 96)")
    add("--width", metavar="PIXELS", type=int, default=800, help="(default: 800)")
    add("--fps", type=int, default=24, help="frames a second (default: 24)")
    add("--style", default="screen", help="'screen' or 'print' (default: screen)")
    add("--keep", metavar="FOLDER", help="where frames are kept (default: NAME_frames)")
    add("-q", "--quiet", action="store_true", help="show errors only")
    add_limits(parser)


def run(args: argparse.Namespace) -> int:
    """Make the film, or list them; return 0."""
    from ..figures import films

    if args.name is None:
        width = max(map(len, films.FILMS))
        for name, film in films.FILMS.items():
            print(f"{name:{width}}  {film.text}")
        return 0
    output = Path(args.output or f"{args.name}.gif")
    if output.suffix.lower() not in films.SUFFIXES:
        raise BezierError.expected(
            "-o", "a suffix " + ", ".join(films.SUFFIXES), repr(printable(output.suffix))
        )
    check_target(str(output), "-o")
    films.save_film(
        args.name, output, args.frames, args.width, args.fps, args.style, args.keep
    )  # fmt: skip
    if not args.quiet:
        print(f"wrote {printable(str(output))}")
    return 0
