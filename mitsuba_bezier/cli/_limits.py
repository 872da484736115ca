"""Command-line flags that raise or lower the limits of readers."""

from __future__ import annotations

import argparse
import math
from contextlib import AbstractContextManager, nullcontext

__all__ = ["add_limits", "limits", "positive"]


def positive(text: str) -> float:
    """Return a positive number, for a flag."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number above 0 and below 1e9, got {text!r}")
    return value


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser of a command that reads models."""
    parser.add_argument(
        "--read-seconds",
        metavar="S",
        type=positive,
        help="processor time that reading a CAD, Rhino or finite element file may take (default: "
        "10, and 1 more for each 10 kB; or MITSUBA_BEZIER_READ_SECONDS)",
    )
    parser.add_argument(
        "--read-memory",
        metavar="GIB",
        type=positive,
        help="memory that reading a model may take, in GiB (default: 0.5, and 0.25 more for each "
        "MiB; or MITSUBA_BEZIER_READ_MEMORY)",
    )


def limits(args: argparse.Namespace) -> AbstractContextManager[None]:
    """Return a context in which the flags of a command hold."""
    seconds, memory = (getattr(args, f"read_{name}", None) for name in ("seconds", "memory"))
    if seconds is None and memory is None:
        return nullcontext()
    from ..io.limits import chosen

    return chosen(seconds, memory)
