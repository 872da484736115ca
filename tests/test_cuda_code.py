"""What the kernels must not ask of CUDA."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import mitsuba_bezier

#: All but the one that has `reciprocal` and `inverse_root`, which the others use.
KERNELS = sorted(
    path
    for path in (Path(mitsuba_bezier.__file__).parent / "kernels").glob("*.py")
    if path.stem not in ("__init__", "arrays")
)

#: All that Dr.Jit turns into `rcp.approx.ftz.f64`, which has 20 bits, for float64.
ROUGH = re.compile(r"\bdr\.(rcp|rsqrt|normalize|tanh?)\(")


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.stem)
def test_kernels_divide_in_float64(path):
    assert not ROUGH.findall(path.read_text(encoding="utf-8"))
