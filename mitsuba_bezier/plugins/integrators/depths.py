"""The parameters ``max_depth`` and ``rr_depth`` that path tracers share."""

from __future__ import annotations

import mitsuba as mi

from ...errors import BezierError

__all__ = ["check_depths"]


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
