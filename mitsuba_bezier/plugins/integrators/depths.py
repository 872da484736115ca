"""Parameters of integrators that are numbers: depths of paths, and counts."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ...errors import BezierError

__all__ = ["check_count", "check_depths"]


def check_count(key: str, value: Any) -> int:
    """Return a number of samples or steps, checked.

    Raises
    ------
    BezierError
        If it is not an integer, or negative.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise BezierError.expected(key, "an integer >= 0", repr(value))
    return value


def check_depths(props: mi.Properties) -> None:
    """Check both, and give them the defaults of Mitsuba's `path`.

    Mitsuba's base class has `path`'s rule for -1 but other defaults.

    Raises
    ------
    BezierError
        If one is not an integer, or too small.
    """
    for key, default, least, words in (
        ("max_depth", -1, -1, "an integer >= 0, or -1 for no limit"),
        ("rr_depth", 5, 1, "an integer > 0"),
    ):
        if key not in props:
            props[key] = default
        value = props[key]
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise BezierError.expected(key, words, repr(value))
