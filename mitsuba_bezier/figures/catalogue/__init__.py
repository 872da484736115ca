"""The figures of the lecture by name: each one function, with all that can move as arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import conics, curves, dual, projection, quadrics, triangles

__all__ = ["CATALOGUE"]

#: Name of a figure, and the function that draws it; in the order of the lecture.
CATALOGUE: dict[str, Callable[..., Any]] = {
    name: make
    for module in (projection, conics, curves, dual, triangles, quadrics)
    for name, make in module.FIGURES.items()
}
