"""Convert NURBS to Bézier patches: knot insertion by blossoms.

The Bézier points of a B-spline on an interval ``[a, b]`` inside one knot span are the values of
its blossom at ``a`` and ``b`` (Ramshaw); de Boor's algorithm evaluates it. So one small matrix
an interval takes the ``p + 1`` control points of the span to those of the Bézier curve. It works
for any knot vector, clamped or not, and restricts to parts of a span as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry.splines import checked_knots

__all__ = ["bezier_matrices", "check_knots", "curve_to_bezier", "surface_to_bezier"]


def check_knots(knots: Any, degree: int, count: int, parameter: str = "knots") -> np.ndarray:
    """Return a knot vector as float64, checked.

    Parameters
    ----------
    knots : (count + degree + 1,) array_like
        Not falling.
    degree : int
        At least 1.
    count : int
        Number of control points.
    parameter : str
        Its name in messages.

    Raises
    ------
    GeometryError
        If the length is wrong, a knot is not finite or falls, or no span has a length.
    """
    if degree < 1 or count <= degree:
        raise GeometryError.expected(
            parameter, "degree >= 1 and more control points than that", f"{degree} and {count}"
        )
    # a knot may be repeated more often than the degree: such curves come apart there
    return checked_knots(parameter, knots, degree, count, gaps=True)


#: Numbers in the matrices of intervals that are found together.
_CHUNK = 1 << 18


def _blossoms(
    knots: np.ndarray, degree: int, spans: np.ndarray, a: np.ndarray, b: np.ndarray
) -> np.ndarray:
    """Return the matrices ``(S, p+1, p+1)`` from control points to Bézier points on [a, b].

    Those of an interval in a span are the control points ``span - p .. span``.
    """
    p = degree
    near = knots[spans[:, None] + np.arange(1 - p, p + 1)]  # from span - p + 1 to span + p
    out = np.empty((len(spans), p + 1, p + 1))
    for row in range(p + 1):
        level = np.broadcast_to(np.eye(p + 1), out.shape)  # rows: control points span - p .. span
        for r in range(1, p + 1):
            t = (a if r <= p - row else b)[:, None]
            lower, upper = near[:, r - 1 : p], near[:, p : 2 * p - r + 1]
            alpha = ((t - lower) / (upper - lower))[..., None]
            level = (1 - alpha) * level[:, :-1] + alpha * level[:, 1:]
        out[:, row] = level[:, 0]
    return out


def bezier_matrices(
    knots: np.ndarray, degree: int, cuts: Any = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the matrices that take B-spline control points to Bézier points.

    Parameters
    ----------
    knots : (m,) array
        A checked knot vector.
    degree : int
        The degree p.
    cuts : array_like, optional
        Further parameters at which to cut; those outside of the domain do nothing.

    Returns
    -------
    matrices : (S, p+1, p+1) array
        One for each interval of positive length.
    first : (S,) int array
        The first control point each matrix acts on.
    intervals : (S, 2) array
    """
    p = degree
    low, high = knots[p], knots[-p - 1]
    breaks = np.unique(np.concatenate([knots[p : len(knots) - p], np.ravel(cuts)]))
    breaks = breaks[(breaks >= low) & (breaks <= high)]
    a, b = breaks[:-1], breaks[1:]
    spans = np.searchsorted(knots, a, side="right") - 1
    step = max(1, _CHUNK // (p + 1) ** 2)
    parts = [slice(at, at + step) for at in range(0, len(a), step)]
    matrices = [_blossoms(knots, p, spans[part], a[part], b[part]) for part in parts]
    none = np.zeros((0, p + 1, p + 1))
    return np.concatenate([none, *matrices]), spans - p, np.stack([a, b], axis=1)


def curve_to_bezier(net: Any, knots: Any, degree: int, cuts: Any = ()) -> np.ndarray:
    """Return the Bézier pieces ``(S, p+1, d)`` of a B-spline curve with points ``(m, d)``.

    Raises
    ------
    GeometryError
        If the knots do not fit.
    """
    net = np.asarray(net, dtype=np.float64)
    knots = check_knots(knots, degree, len(net))
    matrices, first, _intervals = bezier_matrices(knots, degree, cuts)
    return matrices @ net[first[:, None] + np.arange(degree + 1)]


def surface_to_bezier(
    net: Any,
    knots_u: Any,
    knots_v: Any,
    degrees: tuple[int, int],
    cuts: tuple[Any, Any] = ((), ()),
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Bézier patches of a NURBS surface.

    Parameters
    ----------
    net : (m, n, 4) array_like
        Homogeneous control points, the first index along u.
    knots_u, knots_v : array_like
        ``m + p + 1`` and ``n + q + 1`` knots.
    degrees : (int, int)
        The degrees p, q.
    cuts : pair of array_like
        Further parameters at which to cut, along u and along v.

    Returns
    -------
    patches : (S, p+1, q+1, 4) array
    domains : (S, 2, 2) array
        ``[[u0, u1], [v0, v1]]`` of each patch.

    Raises
    ------
    GeometryError
        If the knots do not fit.
    """
    net = np.asarray(net, dtype=np.float64)
    p, q = degrees
    knots_u = check_knots(knots_u, p, net.shape[0], "knots_u")
    knots_v = check_knots(knots_v, q, net.shape[1], "knots_v")
    mu, first_u, domain_u = bezier_matrices(knots_u, p, cuts[0])
    mv, first_v, domain_v = bezier_matrices(knots_v, q, cuts[1])
    rows = mu @ net[first_u[:, None] + np.arange(p + 1)].reshape(len(mu), p + 1, -1)
    rows = rows.reshape(len(mu), p + 1, net.shape[1], 4)
    columns = rows[:, :, first_v[:, None] + np.arange(q + 1)]  # (Su, p+1, Sv, q+1, 4)
    patches = np.einsum("vij,upvjc->uvpic", mv, columns, optimize=True)
    domains = np.empty((len(mu), len(mv), 2, 2))
    domains[:, :, 0] = domain_u[:, None]
    domains[:, :, 1] = domain_v[None]
    return patches.reshape(-1, p + 1, q + 1, 4), domains.reshape(-1, 2, 2)
