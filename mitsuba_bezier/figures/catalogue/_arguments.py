"""Checks of what figures take: how many of something."""

from __future__ import annotations

from ...errors import GeometryError
from ...geometry.projective import count

__all__ = ["few"]


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
