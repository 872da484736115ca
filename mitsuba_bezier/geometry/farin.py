"""Evaluate curves by cross ratios: a polygon and Farin points instead of weights.

The Farin point ``q_i`` on the leg ``b_i b_{i+1}`` (any multiple of ``b_i + b_{i+1}``) says as a
point what the weights say as numbers. At every level of de Casteljau's algorithm

    cr(b_i, q_i, b_i', b_{i+1}) = (1 - t) / t

(Farin, *NURBS*, 1999), and the next Farin point is the meet of the line ``q_i q_{i+1}`` with
the leg ``b_i' b_{i+1}'``. Only points enter, in whatever multiples: a collineation of polygon
and Farin points is a collineation of the curve.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .cross_ratio import pencil_coordinates
from .curves import BezierCurve
from .projective import TOLERANCE, elements, norm, number

__all__ = ["cross_ratio_scheme", "curve_from_farin_points", "evaluate_by_cross_ratios"]


def _polygon(points: Any, farin: Any) -> tuple[np.ndarray, np.ndarray]:
    b, q = elements("points", points, (3, 4)), elements("farin", farin, (3, 4))
    if b.ndim != 2 or len(b) < 2 or q.shape != (len(b) - 1, b.shape[1]):
        raise GeometryError.expected(
            "points, farin",
            "n+1 >= 2 control points and n Farin points of one dimension",
            f"shapes {b.shape} and {q.shape}",
        )
    return b, q


def _legs(b: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``alpha, delta`` with ``q_i = alpha_i b_i + delta_i b_{i+1}``."""
    alpha, delta = pencil_coordinates(q, b[:-1], b[1:], "points, farin")
    size = TOLERANCE * norm(q)[..., None]
    if (np.abs(alpha) * norm(b[:-1])[..., None] <= size).any() or (
        np.abs(delta) * norm(b[1:])[..., None] <= size
    ).any():
        raise GeometryError.expected(
            "farin", "Farin points other than the ends of their legs", "an end of a leg"
        )
    return alpha, delta


def cross_ratio_scheme(points: Any, farin: Any, t: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the levels of the evaluation by cross ratios.

    Parameters
    ----------
    points : (n+1, 3 | 4) array_like
        Control points in any multiples; neighbours must differ.
    farin : (n, 3 | 4) array_like
        Farin points on the legs in any multiples.
    t : float
        Parameter.

    Returns
    -------
    list of (points, farin)
        Level `r` has ``n + 1 - r`` points and ``n - r`` Farin points; the one point of the
        last level is on the curve.

    Raises
    ------
    GeometryError
        If a Farin point is not on its leg or is one of its ends, or two neighbours coincide
        at some level (as they do at a cusp): a leg is then no line.

    Notes
    -----
    With ``q_i = alpha_i b_i + delta_i b_{i+1}`` the point of the given cross ratio is
    ``(1-t) alpha_i b_i + t delta_i b_{i+1}``. The meet of ``q_i q_{i+1}`` with the new leg is
    ``(1-t) alpha_{i+1} q_i + t delta_i q_{i+1}``: Menelaus' theorem for the triangle
    ``b_i b_{i+1} b_{i+2}``, in a form that also holds when the three are collinear and the
    two lines are one.
    """
    b, q = _polygon(points, farin)
    s = number(t, "t")
    scheme = [(b, q)]
    while len(b) > 1:
        alpha, delta = _legs(b, q)
        level = (1 - s) * alpha * b[:-1] + s * delta * b[1:]
        q = (1 - s) * alpha[1:] * q[:-1] + s * delta[:-1] * q[1:]
        b = level
        # multiples are free: unit length keeps every level in range
        b, q = b / norm(b)[:, None], q / norm(q)[:, None]
        scheme.append((b, q))
    return scheme


def evaluate_by_cross_ratios(points: Any, farin: Any, t: float) -> np.ndarray:
    """Return the curve point ``(3 | 4,)`` at `t`, as a unit vector; see `cross_ratio_scheme`."""
    return cross_ratio_scheme(points, farin, t)[-1][0][0]


def curve_from_farin_points(points: Any, farin: Any) -> BezierCurve:
    """Return the rational curve with the given polygon and Farin points, first point as given.

    Raises
    ------
    GeometryError
        As `cross_ratio_scheme`, for the given polygon.
    """
    b, q = _polygon(points, farin)
    alpha, delta = _legs(b, q)
    factor = np.concatenate([np.ones((1, 1)), np.cumprod(delta / alpha, axis=0)])
    return BezierCurve(factor * b)
