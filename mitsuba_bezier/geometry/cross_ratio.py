"""Cross ratios and affine ratios, and the points that have given ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .projective import TOLERANCE, affine, elements, norm, number, same_shape

__all__ = ["affine_ratio", "cross_ratio", "pencil_coordinates", "point_from_cross_ratio"]


def _pencil(parameter: str, vectors: list[np.ndarray], tolerance: float) -> np.ndarray:
    """Return coordinates ``(..., k, 2)`` of vectors within the 2-space that they span."""
    same_shape(parameter, *vectors)
    v = np.stack(np.broadcast_arrays(*vectors), axis=-2)
    v = v / norm(v)[..., None]
    _u, sigma, vh = np.linalg.svd(v)
    if v.shape[-1] > 2 and (sigma[..., 2] > tolerance * sigma[..., 0]).any():
        raise GeometryError.expected(
            parameter,
            "elements of one pencil (points on a line, lines through a point, planes through a "
            "line)",
            f"elements that span more (relative distance {sigma[..., 2].max():.2g})",
        )
    return np.einsum("...kc,...rc->...kr", v, vh[..., :2, :])


def _bracket(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    out = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.where(np.abs(out) <= TOLERANCE, 0.0, out)  # a, b have unit length


def cross_ratio(a: Any, b: Any, c: Any, d: Any, tolerance: float = 1e-9) -> np.ndarray:
    """Return the cross ratio ``cr(a, b, c, d) = [ab][cd] / ([ac][bd])``.

    This is Farin's ``ratio(a, b, d) / ratio(a, c, d)``: with coordinates 0, 1, x, ∞ of
    `a`, `b`, `c`, `d` on their line it is ``1/x``.

    Parameters
    ----------
    a, b, c, d : (..., 2 | 3 | 4 | 6) array_like
        Elements of one pencil, all of one kind: points on a line, lines of the plane
        through a point, planes through a line, lines of space through a point and in a
        plane, or pairs of homogeneous parameters.
    tolerance : float
        How far from one pencil they may be, relative to unit vectors.

    Returns
    -------
    (...) array
        Infinity where ``a = c`` or ``b = d``.

    Raises
    ------
    GeometryError
        If they do not belong to one pencil, or three of them coincide.
    """
    v = [elements(name, x, (2, 3, 4, 6)) for name, x in zip("abcd", (a, b, c, d))]
    if len({x.shape[-1] for x in v}) != 1:
        raise GeometryError.expected(
            "a, b, c, d", "elements of one kind", f"lengths {[x.shape[-1] for x in v]}"
        )
    p = np.moveaxis(_pencil("a, b, c, d", v, tolerance), -2, 0)
    p = p / norm(p)[..., None]
    above = _bracket(p[0], p[1]) * _bracket(p[2], p[3])
    below = _bracket(p[0], p[2]) * _bracket(p[1], p[3])
    if ((above == 0) & (below == 0)).any():
        raise GeometryError.expected("a, b, c, d", "no three equal elements", "three equal ones")
    with np.errstate(divide="ignore"):
        return np.where(below == 0, np.inf, above / np.where(below == 0, 1.0, below))


def pencil_coordinates(
    x: np.ndarray, a: np.ndarray, d: np.ndarray, parameter: str, tolerance: float = 1e-9
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``alpha, delta`` with ``x = alpha a + delta d``, each of shape ``(..., 1)``.

    Raises
    ------
    GeometryError
        If `a` and `d` coincide or `x` is not in their pencil.
    """
    same_shape(parameter, x, a, d)
    na, nd, nx = norm(a), norm(d), norm(x)
    g = np.sum(a * d, axis=-1) / (na * nd)
    a1, d1 = a / na[..., None], d / nd[..., None]
    # the part of d at right angles to a, computed without the cancellation in 1 - g^2
    across = d1 - g[..., None] * a1
    height = norm(across)
    if not (height > TOLERANCE).all():
        raise GeometryError.expected(parameter, "two different end elements", "the same one twice")
    across = across / height[..., None]
    delta = np.sum(x * across, axis=-1) / height
    alpha = np.sum(x * a1, axis=-1) - g * delta
    rest = x - alpha[..., None] * a1 - delta[..., None] * d1
    if (norm(rest) > tolerance * nx).any():
        raise GeometryError.expected(
            parameter,
            "an element of the pencil of its neighbours",
            f"one outside (relative distance {np.max(norm(rest) / nx):.2g})",
        )
    return (alpha / na)[..., None], (delta / nd)[..., None]


def point_from_cross_ratio(a: Any, b: Any, d: Any, value: Any) -> np.ndarray:
    """Return the element `c` with ``cross_ratio(a, b, c, d) == value``.

    Parameters
    ----------
    a, b, d : (..., 2 | 3 | 4 | 6) array_like
        Three different elements of one pencil.
    value : float or pair of float
        The cross ratio; a pair ``(x, y)`` stands for ``x / y`` and may be infinite.

    Raises
    ------
    GeometryError
        If two of the elements coincide, they do not belong to one pencil, or `value` is
        not a number.
    """
    va, vb, vd = (elements(n, x, (2, 3, 4, 6)) for n, x in zip("abd", (a, b, d)))
    pair = value if isinstance(value, (tuple, list)) and len(value) == 2 else (value, 1.0)
    above, below = (number(x, "value") for x in pair)
    if not (above or below):
        raise GeometryError.expected("value", "a number or a pair other than (0, 0)", value)
    alpha, delta = pencil_coordinates(vb, va, vd, "a, b, d")
    size = norm(vb)[..., None]
    if (np.abs(alpha) * norm(va)[..., None] <= TOLERANCE * size).any() or (
        np.abs(delta) * norm(vd)[..., None] <= TOLERANCE * size
    ).any():
        raise GeometryError.expected("b", "an element other than a and d", "one of them")
    return above * alpha * va + below * delta * vd


def affine_ratio(a: Any, b: Any, c: Any, tolerance: float = 1e-9) -> np.ndarray:
    """Return Farin's ``ratio(a, b, c) = |ab| / |bc|`` of collinear finite points, with sign.

    Raises
    ------
    GeometryError
        If the points are not collinear, one is ideal, or ``b = c``.
    """
    p, q, r = (affine(x) for x in (a, b, c))
    same_shape("a, b, c", p, q, r)
    ab, bc, ac = q - p, r - q, r - p
    size = norm(ab) + norm(bc)
    if not (norm(bc) > TOLERANCE * size).all():
        raise GeometryError.expected("b, c", "two different points", "the same point twice")
    k = np.sum(ab * bc, axis=-1) / norm(bc) ** 2
    if (norm(ab - k[..., None] * bc) > tolerance * (norm(ac) + size)).any():
        raise GeometryError.expected("a, b, c", "three points on a line", "a triangle")
    return k
