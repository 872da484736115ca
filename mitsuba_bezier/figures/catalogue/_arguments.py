"""What figures take: how many of something, and numbers as they are written."""

from __future__ import annotations

from ...errors import GeometryError
from ...geometry.projective import count

__all__ = ["few", "shown"]


def few(name: str, value: float, least: int, most: int) -> int:
    """Return `value` as an integer between two bounds.

    Raises
    ------
    GeometryError
        If it is none: more would not be seen in a picture.
    """
    n = count(value, name, least)
    if n > most:
        raise GeometryError.expected(name, f"an integer from {least} to {most}", value)
    return n


def shown(value: float) -> str:
    """Return a number with two decimals at most, as formulas have it; in a film they run."""
    if abs(value) > 1e4:
        return "\\infty"
    return f"{round(value, 2) + 0.0:g}"
