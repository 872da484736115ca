"""What frozen functions (`dr.freeze`) must be able to find of a structure.

A frozen function replays its kernels with the arrays that its arguments hold. Those of a scene are
found by way of its shapes, in their attributes: so each shape holds the arrays of all structures
that it is a part of. A change of a shape empties its list, a frozen function then sees another
layout of its arguments and is recorded anew, never replayed with what is out of date.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

__all__ = ["arrays_of", "is_bezier"]


def is_bezier(shape: Any) -> bool:
    """Tell whether a shape of the scene is one of ours."""
    return hasattr(shape, "patches") and hasattr(shape, "orientation")


def arrays_of(value: Any, seen: set[int] | None = None) -> list[Any]:
    """Return all Dr.Jit arrays in the attributes of our objects, but those of shapes."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return []
    seen.add(id(value))
    if dr.is_array_v(value):
        return [value] if dr.is_jit_v(value) else []
    if isinstance(value, (list, tuple)):
        parts: list[Any] = list(value)
    elif isinstance(value, dict):
        parts = list(value.values())
    elif type(value).__module__.startswith(__package__.partition(".")[0]) and not is_bezier(value):
        parts = list(getattr(value, "__dict__", {}).values())
    else:
        return []
    return [array for part in parts for array in arrays_of(part, seen)]
