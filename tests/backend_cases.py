"""Dr.Jit's backend of the tests: LLVM, or what ``MITSUBA_BEZIER_BACKEND=cuda`` names.

Tests take array types from here, or by the fixture `backend`, and never from `drjit.llvm`, so
that a machine with a GPU runs the same tests on it.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import mitsuba_bezier  # noqa: F401 (before Dr.Jit, for which it finds LLVM)

__all__ = ["NAME", "VARIANT", "Float", "Float64", "UInt", "ad", "has_float64", "plain"]

NAME = os.environ.get("MITSUBA_BEZIER_BACKEND", "llvm")
if NAME not in ("llvm", "cuda"):
    raise ValueError(f"MITSUBA_BEZIER_BACKEND: expected llvm or cuda, got {NAME}")

#: Arrays without derivatives, and with them.
plain: Any = import_module(f"drjit.{NAME}")
ad: Any = import_module(f"drjit.{NAME}.ad")

Float, Float64, UInt = plain.Float, plain.Float64, plain.UInt

#: Mitsuba's variant with these arrays.
VARIANT = f"{NAME}_ad_rgb"


def has_float64(code: str) -> bool:
    """Return whether generated code has numbers in float64; PTX always declares registers."""
    return any("double" in x or (".f64" in x and ".reg" not in x) for x in code.splitlines())
