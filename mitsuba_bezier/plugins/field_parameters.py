"""What a `bezierfield` reads from its parameters, checked."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import BezierError, FileFormatError
from ..geometry.fields import BezierField

__all__ = [
    "MAX_LEVELS",
    "read_color",
    "read_count",
    "read_field",
    "read_limits",
    "read_projection",
    "read_width",
]

#: Bands and isolines that can be asked for.
MAX_LEVELS = 10_000


def read_limits(low: Any, high: Any, field: BezierField, component: Any) -> tuple[float, float]:
    """Return the ends of a colour scale: those given, or those of the field.

    Raises
    ------
    BezierError
        If they are no numbers, or nothing is between them.
    """
    own = (0.0, 0.0) if low is not None and high is not None else field.range(component)
    ends = [float(own[k] if x is None else x) for k, x in enumerate((low, high))]
    if low is None and high is None and ends[0] == ends[1]:
        size = abs(ends[0]) or 1.0  # a constant: its colour is the middle
        ends = [ends[0] - 1e-3 * size, ends[1] + 1e-3 * size]
    if not (np.isfinite(ends).all() and ends[0] < ends[1]):
        raise BezierError.expected(
            "range", "two numbers a,b with a < b", f"{ends[0]:.9g},{ends[1]:.9g}"
        )
    return ends[0], ends[1]


def read_field(props: mi.Properties) -> tuple[BezierField, np.ndarray | None]:
    """Return the field, and which sides of patches are sides of elements."""
    has = [key for key in ("ordinates", "filename") if key in props]
    if len(has) != 1:
        raise BezierError.expected(
            "bezierfield",
            'exactly one of the parameters "ordinates" and "filename"',
            "both" if has else "neither",
        )
    given = props.get("edges", None)
    if has == ["filename"]:
        from ..io import read

        for key in ("filename", "field"):
            if not isinstance(props.get(key, ""), str) or key not in props:
                raise BezierError.expected(key, "a text", repr(props.get(key, None)))
        name = str(mi.file_resolver().resolve(props["filename"]))
        try:
            model = read(name)
            field = model.field(props["field"])
        except FileFormatError as error:
            raise FileFormatError(f"filename: {str(error).removeprefix('path: ')}") from None
        edges = model.edges
    else:
        values = read_array(props, "ordinates")
        weights = read_array(props, "weights") if "weights" in props else None
        name = str(props.get("field", "field"))
        field = BezierField(name, values[..., None] if values.ndim == 2 else values, weights)
        edges = None
    if given is not None:
        edges = read_array(props, "edges") != 0
        if edges.shape != (len(field), 3):
            raise BezierError.expected("edges", f"shape ({len(field)}, 3)", f"{edges.shape}")
    return field, edges


def read_array(props: mi.Properties, key: str) -> np.ndarray:
    tensor = props[key]
    if not hasattr(tensor, "shape"):
        raise BezierError.expected(key, "a tensor", repr(tensor))
    return np.array(tensor, dtype=np.float64).reshape(tuple(tensor.shape))


def read_count(props: mi.Properties, key: str) -> int:
    value = props.get(key, 0)
    if not isinstance(value, int) or not 0 <= value <= MAX_LEVELS:
        raise BezierError.expected(key, f"an integer from 0 to {MAX_LEVELS}", repr(value))
    return value


def read_width(props: mi.Properties, key: str, default: float) -> float:
    value = props.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 1e6:
        raise BezierError.expected(key, "a number of pixels", repr(value))
    return float(value)


def read_color(props: mi.Properties, key: str) -> list[float]:
    """Return a colour of linear RGB: three numbers, or one."""
    value = props.get(key, 0.02)
    if isinstance(value, (int, float)):
        return [float(value)] * 3
    try:
        numbers = [float(x) for x in (value.split() if isinstance(value, str) else list(value))]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise BezierError.expected(key, "three numbers, or one", repr(value))
    return numbers


def read_projection(props: mi.Properties) -> list[list[float]] | None:
    text = props.get("world_to_pixel", None)
    if text is None:
        return None
    try:
        words = text.replace(",", " ").split() if isinstance(text, str) else np.ravel(text).tolist()
        numbers = [float(x) for x in words]
    except (AttributeError, TypeError, ValueError):
        numbers = []
    if len(numbers) != 16 or not np.isfinite(numbers).all():
        raise BezierError.expected("world_to_pixel", "sixteen finite numbers", repr(text)[:80])
    return [numbers[4 * k : 4 * k + 4] for k in range(4)]
