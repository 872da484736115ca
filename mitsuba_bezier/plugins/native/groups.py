"""Mitsuba's `shapegroup` with a Bézier shape in it is an error that names the way.

Instances of a group are met in C++, which cannot see the patches: without this they would be
missing from the picture without a word.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi

from ...errors import BezierError
from ..frozen import is_bezier
from .names import take_name

__all__ = ["register"]


def register() -> None:
    """Take the name of `shapegroup`, in the variant that is set."""
    take_name("shape", "shapegroup", _make)


def _make(props: Any, own: Callable[[Any], Any]) -> Any:
    for key in props.keys():  # noqa: SIM118 (Properties is no dict)
        if props.type(key) == mi.Properties.Type.Object and is_bezier(props[key]):
            raise BezierError.expected(
                "shapegroup",
                "shapes other than beziertriangle, whose parameter `instances` makes instances",
                f"the beziertriangle {key!r}",
            )
    return own(props)
