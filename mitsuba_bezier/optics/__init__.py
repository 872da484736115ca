"""Lenses and mirrors by prescription: readers, glass, paraxial data, ray traces, drawings.

This layer stands above geometry; it needs no Mitsuba. Glass by name needs the extra ``[optics]``.
"""

from __future__ import annotations

from .glass import AIR, Abbe, Catalogue, Constant, Medium, glass
from .lens import Lens, Surface
from .paraxial import FirstOrder, first_order
from .readers import load
from .trace import Trace, trace

__all__ = [
    "AIR",
    "Abbe",
    "Catalogue",
    "Constant",
    "FirstOrder",
    "Lens",
    "Medium",
    "Surface",
    "Trace",
    "first_order",
    "glass",
    "load",
    "trace",
]
