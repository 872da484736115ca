"""Check users' arguments: arrays, vectors, lengths."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import BezierError, GeometryError

__all__ = ["finite_array", "length", "lengths", "vector"]


def finite_array(
    parameter: str,
    value: Any,
    shape: tuple[int | None, ...],
    error: type[BezierError],
) -> np.ndarray:
    """Return `value` as a float64 array of the given shape.

    Parameters
    ----------
    parameter : str
        Its name in messages.
    value : array_like
        What the user gave.
    shape : tuple
        Expected shape; None stands for any length from 1 up.
    error : type
        Class of the error raised.

    Raises
    ------
    BezierError
        If `value` is not an array of numbers, has another shape, or holds NaN or infinity.
    """
    words = "(" + ", ".join("N" if s is None else str(s) for s in shape)
    words += ",)" if len(shape) == 1 else ")"
    expected = f"finite numbers of shape {words}" if shape else "a finite number"
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise error.expected(parameter, expected, str(cause).split("\n")[0]) from None
    fits = array.ndim == len(shape) and all(
        n > 0 if s is None else n == s for n, s in zip(array.shape, shape)
    )
    if not fits:
        raise error.expected(parameter, expected, f"shape {array.shape}")
    if not np.isfinite(array).all():
        raise error.expected(parameter, expected, "NaN or infinity")
    return array


def vector(parameter: str, value: Any) -> np.ndarray:
    """Return a vector ``(3,)``; raise a GeometryError if it is none."""
    return finite_array(parameter, value, (3,), GeometryError)


def lengths(parameter: str, value: Any, size: int) -> np.ndarray:
    """Return positive lengths ``(size,)``; one number stands for `size` equal ones."""
    one = np.ndim(value) == 0
    v = finite_array(parameter, value, () if one else (size,), GeometryError)
    if not (v > 0).all():
        raise GeometryError.expected(parameter, "positive lengths", f"{value}")
    return np.full(size, v) if one else v


def length(parameter: str, value: Any) -> float:
    """Return a positive length."""
    v = float(finite_array(parameter, value, (), GeometryError))
    if not v > 0:
        raise GeometryError.expected(parameter, "a positive length", f"{value}")
    return v
