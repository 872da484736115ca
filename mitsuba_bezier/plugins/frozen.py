"""What frozen functions (`dr.freeze`) must be able to find of a structure.

A frozen function replays its kernels with the arrays that its arguments hold. Those of a scene are
found by way of its shapes, in their attributes: so each shape holds the arrays of all structures
that it is a part of, and the numbers that became code of the kernels. Where numbers, or the number
of arrays, are not those of the recording the function is recorded anew. A change of a shape empties
its list: nothing is replayed with what is out of date.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

__all__ = ["contents", "is_bezier"]

#: Attributes that do not become code.
_DATA = ("bytes", "leaf_count", "graph_count", "group_count", "count", "_name")


def is_bezier(shape: Any) -> bool:
    """Return whether a shape of the scene is one of ours."""
    return hasattr(shape, "patches") and hasattr(shape, "orientation")


def contents(value: Any) -> dict[str, Any]:
    """Return what is in the attributes of our objects, except those of shapes.

    Returns
    -------
    dict
        ``arrays``, a list of all Dr.Jit arrays, and ``code``, text that is the same only where
        kernels are.
    """
    arrays: list[Any] = []
    code: list[Any] = []
    seen: set[int] = set()

    def visit(value: Any) -> None:
        if value is None or isinstance(value, (bool, int, float, str)):
            code.append(value)
            return
        if id(value) in seen:
            return
        seen.add(id(value))
        if dr.is_array_v(value):
            if dr.is_jit_v(value):
                arrays.append(value)
            return
        if isinstance(value, frozenset):
            code.append(sorted(value))
            return
        if isinstance(value, (list, tuple)):
            code.append(len(value))
            parts = list(value)
        elif isinstance(value, dict):
            parts = list(value.values())
        elif type(value).__module__.startswith(__package__.partition(".")[0]):
            own = {} if is_bezier(value) else getattr(value, "__dict__", {})
            parts = [part for name, part in own.items() if name not in _DATA]
        else:
            return
        for part in parts:
            visit(part)

    visit(value)
    return {"arrays": arrays, "code": repr(code)}
