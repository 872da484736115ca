"""Bounds of derivatives by inequalities of their own: quotients, and compositions with inverses.

The inequalities are those of `bounds`, where what they are for is told. Arrays are ``(L,)``, a
number for each leaf; NaN where there is no bound.
"""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np

__all__ = ["form_norm", "norm2", "norm2_symmetric", "quotient", "second_of_variation", "square"]


def _majorant(b1: Any, b2: Any, a11: Any, a12: Any, a21: Any, a22: Any) -> Any:
    """Return the largest `x` with ``x <= b + A x``, or NaN where there is none."""
    d1, d2 = 1 - a11, 1 - a22
    det = d1 * d2 - a12 * a21
    det = np.where((d1 > 0) & (d2 > 0) & (det > 0), det, np.nan)
    return (d2 * b1 + a12 * b2) / det, (a21 * b1 + d1 * b2) / det


def quotient(n3: Any, n4: Any, d: Any, s0: Any, s1: Any, s2: Any, c: Any) -> Any:
    """Bound the derivatives 0 to 4 of a quotient.

    Parameters
    ----------
    n3, n4 : (L,) arrays
        Of the numerator's derivatives.
    d : five (L,) arrays
        Lower bound of the denominator, bounds of its derivatives 1 to 4.
    s0, s1, s2 : (L,) arrays
        Largest samples of the quotient and its first two derivatives.
    c : float
        See `bounds`.
    """
    d0, d1, d2, d3, d4 = d
    near = s0 + c * s2  # f_0 <= near + c^2 f_4
    f3, f4 = _majorant(
        (n3 + 3 * d1 * s2 + 3 * d2 * s1 + d3 * near) / d0,
        (n4 + 6 * d2 * s2 + 4 * d3 * s1 + d4 * near) / d0,
        3 * c * d2 / d0,
        (3 * c * d1 + c * c * d3) / d0,
        (4 * d1 + 4 * c * d3) / d0,
        (6 * c * d2 + c * c * d4) / d0,
    )
    f2 = s2 + c * f4
    return s0 + c * f2, s1 + c * f3, f2, f3, f4


def square(weight: Any, most: Any) -> Any:
    """Return what `quotient` wants of the denominator ``W^2``, from that of ``W`` and its bound."""
    least, w1, w2, w3, w4 = weight
    return (
        least**2,
        2 * most * w1,
        2 * (w1**2 + most * w2),
        2 * (3 * w1 * w2 + most * w3),
        2 * (3 * w2**2 + 4 * w1 * w3 + most * w4),
    )


def second_of_variation(j: Any, f: Any, r3: Any, r4: Any, k: Any, g: Any, c: Any) -> Any:
    """Bound the second derivative of ``K`` along the parameters.

    Parameters
    ----------
    j : (L,) array
        Of ``|B|``.
    f : five (L,) arrays
        Of the derivatives of ``F``.
    r3, r4 : (L,) arrays
        Of the third and fourth derivatives of ``R``.
    k, g : (L,) arrays
        Largest samples of ``K`` and of the gradient.
    c : float
        See `bounds`.
    """
    _f0, f1, f2, f3, f4 = f
    j2 = j * j
    g = g + c * f2 * k  # g_0 <= this + c f_1 k_1 + c^2 f_2 k_2
    e1, e2 = 2 * j * f2 + j2 * f1 * f2, 2 * j * f3 + 3 * j2 * f2**2 + 2 * j2 * f1 * f3
    mixed = 4 * j * f2 + j2 * f1 * f2
    h1, h2 = j2 * f3, j2 * f4
    _k1, k2 = _majorant(
        j2 * r3 + e1 * k + h1 * g,
        j2 * r4 + e2 * k + h2 * g,
        c * h1 * f1,
        c * e1 + c * c * h1 * f2,
        mixed + c * h2 * f1,
        c * e2 + c * c * h2 * f2,
    )
    return k2


def form_norm(partials: np.ndarray, order: int) -> np.ndarray:
    """Return the largest norm of forms ``((order + 1) * rows, components, L)``: ``(L,)``."""
    weights = np.array([comb(order, a) for a in range(order + 1)], dtype=np.float64)
    square = np.square(partials).sum(axis=1).reshape(order + 1, -1, partials.shape[-1])
    return np.sqrt(np.tensordot(weights, square, axes=1).max(axis=0))


def norm2(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return the spectral norm of ``[[a, b], [c, d]]``."""
    f, det = a * a + b * b + c * c + d * d, a * d - b * c
    return np.sqrt((f + np.sqrt(np.maximum(f * f - 4 * det * det, 0.0))) / 2)


def norm2_symmetric(a: Any, b: Any, c: Any) -> Any:
    """Return the spectral norm of ``[[a, b], [b, c]]``."""
    return np.abs(a + c) / 2 + np.hypot((a - c) / 2, b)
