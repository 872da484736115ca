"""Values of command-line flags: times and errors."""

from __future__ import annotations

import argparse
import math
import re

__all__ = ["duration", "flip_level", "noise_level", "seconds"]

#: Of the pixels, which a FLIP error is asked of.
SHARE = 0.95
_UNITS = {"": 1, "s": 1, "min": 60, "m": 60, "h": 3600, "d": 86400}


def duration(text: str) -> float:
    """Return the seconds of a text such as ``90``, ``10m`` or ``1h30m``, for a flag."""
    words = re.findall(r"([\d.]+)\s*([a-z]*)\s*", text.lower())
    try:
        if "".join(f"{n}{u}" for n, u in words) != re.sub(r"\s", "", text.lower()):
            raise ValueError
        value = sum(float(number) * _UNITS[unit] for number, unit in words)
    except (KeyError, ValueError):
        value = 0.0
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"expected a time such as 90s, 10m or 1h30m, got {text!r}")
    return value


def noise_level(text: str) -> float:
    """Return a relative error, as ``0.02`` or ``2%``, for a flag."""
    try:
        value = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        value = math.nan
    if not 1e-6 <= value < 1:
        raise argparse.ArgumentTypeError(
            f"expected a relative error such as 0.02 or 2%, from 0.000001 to below 1, got {text!r}"
        )
    return value


def flip_level(text: str) -> tuple[float, float]:
    """Return a FLIP error and a share of the pixels, as ``0.05`` or ``0.05@99%``, for a flag."""
    first, at, second = text.partition("@")
    try:
        error, share = float(first), SHARE
        if at:
            share = float(second[:-1]) / 100 if second.endswith("%") else float(second)
    except ValueError:
        error = share = math.nan
    if not (1e-4 <= error < 1 and 0 < share < 1):
        raise argparse.ArgumentTypeError(
            "expected a FLIP error from 0.0001 to below 1, and maybe of how many pixels, such as "
            f"0.05 or 0.05@99%, got {text!r}"
        )
    return error, share


def seconds(text: str) -> float:
    """Return seconds, 0 or more, for a flag."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < 1e9:
        raise argparse.ArgumentTypeError(f"expected seconds, 0 or more, got {text!r}")
    return value
