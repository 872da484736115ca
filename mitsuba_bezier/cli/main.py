"""The program ``mitsuba-bezier``: one subcommand a module of this package.

A command module has ``add_parser(subparsers)``, which adds its parser, and ``run(args)``, which
returns the exit code. It imports Mitsuba in `run` only, so that ``--help`` is fast. To add a
command, write the module and put its name into `COMMANDS`.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from .. import _runtime, _signals
from .._version import __version__
from ..errors import BezierError
from . import _streams
from ._limits import limits

__all__ = ["COMMANDS", "main", "parse"]

PROGRAM = "mitsuba-bezier"

#: The subcommands, in the order of ``--help``; each is the module of the same name.
COMMANDS = (
    "render",
    "verify",
    "compare",
    "accept",
    "report",
    "history",
    "bisect",
    "merge",
    "plan",
    "convert",
    "info",
    "conformance",
    "figure",
    "film",
    "studio",
    "lens",
    "doctor",
)

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130  # what shells report for a program that Ctrl-C ended, see `_signals`


class _Parser(argparse.ArgumentParser):
    """A parser whose errors take one line, like all others."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        # of argparse itself, which takes -1 for a value, but -1,1 and -1e-3 for options
        self._negative_number_matcher = re.compile(r"-[0-9.][0-9.,eE+-]*$")

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_ERROR, f"{PROGRAM}: error: {message} (see '{self.prog} --help')\n")


def _parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    parser = _Parser(
        prog=PROGRAM,
        description="Exact rational Bézier triangles for Mitsuba 3.",
        epilog=f"'{PROGRAM} COMMAND --help' describes a command.",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    debug: dict[str, Any] = {
        "action": "store_true",
        "help": "show the traceback of an error, not one line",
    }
    parser.add_argument("--debug", **debug)
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    # the module of the command that is asked for is enough
    named = [word for word in argv if not word.startswith("-")][:1]
    for name in named if named and named[0] in COMMANDS else COMMANDS:
        import_module(f".{name}", __package__).add_parser(subparsers)
    for command in subparsers.choices.values():  # --debug may stand behind the command, too
        command.add_argument("--debug", default=argparse.SUPPRESS, **debug)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments, by default those of the process.

    Returns
    -------
    int
        0 on success, 1 if a check of the command failed, 2 on a user's error (told in one line
        on stderr), 130 after Ctrl-C, 143 after SIGTERM.
    """
    if argv is not None:
        return _run(list(argv))
    _signals.begin()
    _streams.prepare()
    try:
        code = _run(sys.argv[1:])
    except SystemExit as end:  # argparse ends this way
        code = int(end.code or 0)
    try:
        sys.stdout.flush()
    except BezierError as error:  # what was printed has not arrived
        code = _tell(error)
    return code


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Return the arguments of a command line as commands get them."""
    args = _parser(words).parse_args(words)
    args.argv = [PROGRAM, *words]
    return args


def _run(words: list[str]) -> int:
    args = parse(words)
    try:
        _runtime.check_folder()
        with limits(args):
            return import_module(f".{args.command}", __package__).run(args)
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except (BezierError, OSError, MemoryError, RuntimeError, ImportError) as error:
        if args.debug or not _is_users(error):
            raise
        return _tell(error)


def _is_users(error: Exception) -> bool:
    """Return whether an error is reported in one line; mistakes of ours keep their traceback."""
    if isinstance(error, RuntimeError):
        return "out of memory" in str(error)  # of Dr.Jit
    if isinstance(error, ImportError):  # a library that is not there, or finds no memory
        return not (error.name or "").startswith("mitsuba_bezier")
    return True


def _tell(error: Exception) -> int:
    """Report an error in one line and return the exit code."""
    text = " ".join(str(error).split())
    if isinstance(error, (MemoryError, RuntimeError)):
        text = "this takes more memory than there is"
    print(f"{PROGRAM}: error: {_streams.printable(text)}", file=sys.stderr)
    return EXIT_ERROR


if __name__ == "__main__":
    sys.exit(main())
