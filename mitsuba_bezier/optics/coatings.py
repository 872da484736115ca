"""Reflectance of coated surfaces: thin films by the matrices of their layers.

Layers that do not absorb have matrices ``[[a, i b], [i c, d]]`` of real numbers, also where light
does not run in them but fades, so that real arithmetic is enough (Macleod, *Thin-Film Optical
Filters*, 2010, chapter 2). The same lines serve NumPy and Dr.Jit.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..errors import PrescriptionError
from .glass import glass

_NUMPY = SimpleNamespace(
    sqrt=np.sqrt,
    sin=np.sin,
    cos=np.cos,
    sinh=np.sinh,
    cosh=np.cosh,
    abs=np.abs,
    maximum=np.maximum,
    minimum=np.minimum,
    select=np.where,
)

#: Nanometres for which a quarter wave is made unless said otherwise; magnesium fluoride's index.
DESIGN, MAGNESIUM_FLUORIDE = 550.0, 1.38

#: A stack of layers from the air to the glass: index and thickness in nanometres of each.
Layers = tuple[tuple[float, float], ...]


def coating(text: str) -> Layers | None:
    """Return the layers that a text names, from the air to the glass; None reflects nothing.

    ``none`` is bare glass, ``ideal`` a coating without reflection, ``quarter_wave`` one layer of
    magnesium fluoride for 550 nm. ``quarter_wave:600`` is one for 600 nm. Others are pairs of index
    and thickness in nanometres, ``1.38:99.6, 2.1:131, 1.62:85``; an index may be a name of a
    material.

    Raises
    ------
    PrescriptionError
        If a pair is none.

    Examples
    --------
    >>> from mitsuba_bezier.optics import coating
    >>> coating("1.38:100, 2.1:130")
    ((1.38, 100.0), (2.1, 130.0))
    """
    word = text.strip().lower()
    if word == "ideal":
        return None
    if word in ("none", ""):
        return ()
    if match := re.fullmatch(r"quarter_wave(?::([0-9.]+))?", word):
        design = float(match[1]) if match[1] else DESIGN
        if not design > 0:
            raise PrescriptionError.expected("coating", "a positive wavelength", repr(text))
        return ((MAGNESIUM_FLUORIDE, design / (4 * MAGNESIUM_FLUORIDE)),)
    layers = []
    for pair in text.split(","):
        name, mark, size = pair.rpartition(":")
        try:
            thickness = float(size)
        except ValueError:
            thickness = float("nan")
        if not (mark and name.strip() and 0 < thickness < np.inf):
            raise PrescriptionError.expected(
                "coating",
                "none, ideal, quarter_wave or layers INDEX:NANOMETRES, ...",
                repr(text),
            )
        try:
            index = float(name)
        except ValueError:
            index = float(glass(name).index(1e-3 * DESIGN))
        if not 0 < index < np.inf:
            raise PrescriptionError.expected("coating", "positive indices", repr(text))
        layers.append((index, thickness))
    return tuple(layers)


def reflectance(
    outer: Any,
    inner: Any,
    cosine: Any,
    wavelength: Any = DESIGN,
    layers: Sequence[tuple[float, float]] = (),
    m: Any = _NUMPY,
) -> Any:
    """Return the share of unpolarised light that a surface reflects.

    Parameters
    ----------
    outer, inner : float or array
        Indices of the medium that light comes from, and of the one behind the layers.
    cosine : float or array
        Of the angle of incidence in the outer medium, 0 to 1.
    wavelength : float or array
        In nanometres, in vacuum.
    layers : sequence of (float, float)
        Index and thickness in nanometres, from the outer medium on.
    m : module
        NumPy's or Dr.Jit's functions.

    Examples
    --------
    >>> from mitsuba_bezier.optics import reflectance
    >>> float(reflectance(1.0, 1.5, 1.0).round(3))
    0.04
    """
    tiny = 1e-6  # of a cosine: at grazing incidence all is reflected, and nothing is divided by 0
    sine2 = outer * outer * (1 - cosine * cosine)
    first = m.maximum(cosine, tiny)
    left = 1 - sine2 / (inner * inner)
    last = m.sqrt(m.maximum(left, tiny * tiny))
    total = 0.0
    for polarisation in "sp":
        across = polarisation == "s"
        before = outer * first if across else outer / first
        behind = inner * last if across else inner / last
        a: Any = 1.0
        b: Any = 0.0
        c: Any = 0.0
        d: Any = 1.0
        for n, thickness in layers:
            square = 1 - sine2 / (n * n)
            wave = square >= 0
            k = m.maximum(m.sqrt(m.abs(square)), tiny)
            phase = 2 * np.pi * n * thickness * k / wavelength
            # what fades by e^-30 is gone, and its hyperbolic functions are still numbers
            faded = m.minimum(phase, 30.0)
            cos = m.select(wave, m.cos(phase), m.cosh(faded))
            sin = m.select(wave, m.sin(phase), m.sinh(faded))
            if across:
                eta, sign = n * k, m.select(wave, 1.0, 1.0)
            else:
                eta, sign = n / k, m.select(wave, 1.0, -1.0)
            b_layer = sign * sin / eta
            c_layer = m.select(wave, 1.0, -1.0) * sign * eta * sin
            a, b, c, d = (
                a * cos - b * c_layer,
                a * b_layer + b * cos,
                c * cos + d * c_layer,
                d * cos - c * b_layer,
            )
        real, imaginary = before * a, before * b * behind
        less = (real - d * behind) * (real - d * behind) + (imaginary - c) * (imaginary - c)
        more = (real + d * behind) * (real + d * behind) + (imaginary + c) * (imaginary + c)
        total = total + 0.5 * less / more
    return m.select(left > 0, total, 1.0)
