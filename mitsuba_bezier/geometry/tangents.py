"""Two theorems on tangents: three of a parabola, four of a conic (Farin, *NURBS*, 1999)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .cross_ratio import affine_ratio, cross_ratio
from .curves import BezierCurve
from .projective import TOLERANCE, meet, norm, numbers

__all__ = ["four_tangent_cross_ratios", "three_tangent_ratios"]


def three_tangent_ratios(arc: BezierCurve, r: float, s: float, t: float) -> np.ndarray:
    """Return the three ratios of the three tangents theorem, ``(3,)``.

    Let a, b, c be the points at `r`, `s`, `t`, and d, e, f the meets of the tangents at a, c;
    at a, b; at b, c. The ratios ``(a e d)``, ``(e b f)``, ``(d f c)`` are equal exactly if the
    conic is a parabola; for a polynomial one they are ``(s-r)/(t-s)``.

    Raises
    ------
    GeometryError
        If the curve is no regular quadratic, two parameters coincide, or a point is ideal.
    """
    a, b, c = _quadratic(arc).evaluate([r, s, t])
    ta, tb, tc = arc.tangent([r, s, t])
    d, e, f = meet(ta, tc), meet(ta, tb), meet(tb, tc)
    return np.array([affine_ratio(a, e, d), affine_ratio(e, b, f), affine_ratio(d, f, c)])


def four_tangent_cross_ratios(arc: BezierCurve, fixed: Any, moving: Any) -> np.ndarray:
    """Return the cross ratios of the four tangents theorem.

    The tangents of a conic at four fixed parameters cut every other tangent in points of the
    same cross ratio, that of the four parameters; a fixed tangent takes its own point of
    contact.

    Parameters
    ----------
    arc : BezierCurve
        Quadratic with independent control points, in the plane or in space.
    fixed : (4,) array_like
        Four different parameters.
    moving : (m,) array_like
        Parameters of the tangents that are cut.

    Returns
    -------
    (m,) array
    """
    t, m = numbers(fixed, "fixed"), np.atleast_1d(numbers(moving, "moving"))
    if t.shape != (4,) or len(np.unique(t)) != 4:
        raise GeometryError.expected("fixed", "four different parameters", f"{t.tolist()}")
    tangents = _quadratic(arc).tangent(t)
    out = np.empty(m.shape)
    for k, s in enumerate(m):
        own = arc.tangent(s)
        p, q, u, v = (
            arc.evaluate(s) if s == fix else meet(own, line) for fix, line in zip(t, tangents)
        )
        out[k] = cross_ratio(p, q, u, v)
    return out


def _quadratic(arc: BezierCurve) -> BezierCurve:
    """Return `arc` if its three control points are independent."""
    if arc.degree != 2:
        raise GeometryError.expected("arc", "a curve of degree 2", f"{arc!r}")
    net = arc.control_points
    if not norm(net).all():
        raise GeometryError.expected("arc", "independent control points", "a zero vector")
    sigma = np.linalg.svd(net / norm(net)[:, None], compute_uv=False)
    if not sigma[2] > TOLERANCE * sigma[0]:
        raise GeometryError.expected(
            "arc", "independent control points", "control points on a line"
        )
    return arc
