"""Collineations: from point pairs, on points, lines and planes; homologies, central projection.

A collineation of the plane (space) is a regular 3x3 (4x4) matrix `M`, up to a factor; points
are columns, ``x -> M x``. Planes (lines of the plane) map by ``e -> M^-T e``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .projective import TOLERANCE, elements, incidence, norm, number, numbers, plucker_matrix

__all__ = [
    "central_projection",
    "collineation",
    "homology",
    "matrix",
    "transform_hyperplanes",
    "transform_lines",
    "transform_points",
]


def matrix(name: str, value: Any, shapes: tuple[tuple[int, int], ...]) -> np.ndarray:
    """Return `value` as a float64 matrix of full rank, or say what is wrong with it.

    Raises
    ------
    GeometryError
        If it has none of the `shapes`, is not finite or not of full rank.
    """
    out = numbers(value, name)
    if out.shape not in shapes:
        kinds = " or ".join(f"{r}x{c}" for r, c in shapes)
        raise GeometryError.expected(name, f"a {kinds} matrix", f"shape {out.shape}")
    sigma = np.linalg.svd(out, compute_uv=False)
    if not sigma[-1] > 1e-14 * sigma[0]:  # as BezierTriangles.transform
        raise GeometryError.expected(
            name, "a matrix of full rank", f"singular values {sigma[0]:.3g} to {sigma[-1]:.3g}"
        )
    return out


def transform_points(m: Any, points: Any) -> np.ndarray:
    """Return the images ``M x`` of points ``(..., c)`` under a regular `m` ``(c, c)``."""
    p = elements("points", points, (2, 3, 4))
    c = p.shape[-1]
    return p @ matrix("m", m, ((c, c),)).T


def transform_hyperplanes(m: Any, hyperplanes: Any) -> np.ndarray:
    """Return the images of lines of the plane ``(..., 3)`` or planes ``(..., 4)``.

    The factor is that of ``det(M) M^-T``, so that ``e' . x' = det(M) (e . x)``: where the
    collineation keeps orientation, the positive side stays the positive side.
    """
    e = elements("hyperplanes", hyperplanes, (3, 4))
    c = e.shape[-1]
    m = matrix("m", m, ((c, c),))
    return np.linalg.det(m) * (e @ np.linalg.inv(m))


def transform_lines(m: Any, lines: Any) -> np.ndarray:
    """Return the images of lines of space ``(..., 6)``: ``join(p, q) -> join(M p, M q)``."""
    m = matrix("m", m, ((4, 4),))
    image = m @ plucker_matrix(lines) @ m.T
    moment = np.stack([image[..., 1, 2], image[..., 2, 0], image[..., 0, 1]], axis=-1)
    return np.concatenate([image[..., 3, :3], moment], axis=-1)


def _frame(name: str, points: np.ndarray) -> np.ndarray:
    """Return the matrix that takes the unit points and (1, ..., 1) to ``c + 1`` points."""
    base, unit = points[:-1].T, points[-1]
    sigma = np.linalg.svd(base, compute_uv=False)
    if not sigma[-1] > TOLERANCE * sigma[0]:
        raise GeometryError.expected(
            name, f"points in general position, no {len(base)} dependent", "dependent points"
        )
    factor = np.linalg.solve(base, unit)
    if not (np.abs(factor) > TOLERANCE * np.abs(factor).max()).all():
        raise GeometryError.expected(
            name, f"points in general position, no {len(base)} dependent", "dependent points"
        )
    return base * factor


def _whitening(points: np.ndarray, name: str) -> np.ndarray:
    """Return the matrix that makes the second moments of the (unit) points the identity."""
    # not by eigenvalues of the moments: those are squares, of which half of the digits are rounding
    _u, size, axes = np.linalg.svd(points, full_matrices=False)
    if not size[-1] > TOLERANCE * size[0]:
        raise GeometryError.expected(
            name, f"points that span all {points.shape[1]} dimensions", "dependent points"
        )
    return (axes.T / size) @ axes


def collineation(source: Any, target: Any) -> np.ndarray:
    """Return the collineation that takes the points `source` to the points `target`.

    Parameters
    ----------
    source, target : (N, c) array_like
        Pairs of homogeneous points, ``c = 2`` on a line, 3 in the plane, 4 in space. For
        ``N = c + 1`` points in general position the result is exact; for more it minimises
        the sum of squares of the exterior products ``target ∧ M source`` of unit vectors, after
        both sides have been brought to unit second moments.

    Returns
    -------
    (c, c) array
        Frobenius norm 1, its entry of largest size positive.

    Raises
    ------
    GeometryError
        If there are fewer than ``c + 1`` pairs, or they do not determine a regular matrix.
    """
    s, t = elements("source", source, (2, 3, 4)), elements("target", target, (2, 3, 4))
    c = s.shape[-1]
    if s.ndim != 2 or s.shape != t.shape or len(s) < c + 1:
        raise GeometryError.expected(
            "source, target",
            f"two arrays of shape (N, {c}) with N >= {c + 1} pairs",
            f"shapes {s.shape} and {t.shape}",
        )
    s, t = s / norm(s)[:, None], t / norm(t)[:, None]
    if len(s) == c + 1:
        m = _frame("target", t) @ np.linalg.inv(_frame("source", s))
    else:
        hs, ht = _whitening(s, "source"), _whitening(t, "target")
        a, b = s @ hs, t @ ht
        # b_i (M a)_j - b_j (M a)_i = 0 for all i < j, linear in the rows of M
        rows = []
        for i in range(c):
            for j in range(i + 1, c):
                block = np.zeros((len(a), c, c))
                block[:, j] = b[:, i, None] * a
                block[:, i] = -b[:, j, None] * a
                rows.append(block.reshape(len(a), c * c))
        _u, sigma, vh = np.linalg.svd(np.concatenate(rows))
        # 1e-10: the two smallest are both rounding, or noise that outweighs the pairs
        if not sigma[-2] > 1e-10 * sigma[0]:
            raise GeometryError.expected(
                "source, target", "pairs that determine one collineation", "dependent points"
            )
        m = np.linalg.inv(ht) @ vh[-1].reshape(c, c) @ hs
        sigma = np.linalg.svd(m, compute_uv=False)
        if not sigma[-1] > TOLERANCE * sigma[0]:
            raise GeometryError.expected(
                "source, target", "pairs of a regular collineation", "a singular best fit"
            )
    m = m / np.linalg.norm(m)
    return m * np.sign(m.flat[np.argmax(np.abs(m))])


def _centre_and_axis(center: Any, axis: Any) -> tuple[np.ndarray, np.ndarray, float]:
    c, e = elements("center", center, (3, 4)), elements("axis", axis, (3, 4))
    if c.ndim != 1 or c.shape != e.shape:
        raise GeometryError.expected(
            "center, axis",
            "one point and one line of the plane, or one point and one plane of space",
            f"shapes {c.shape} and {e.shape}",
        )
    if incidence(c, e) <= TOLERANCE:
        raise GeometryError.expected("center", "a point that is not on the axis", "one on it")
    return c, e, float(c @ e)


def central_projection(center: Any, plane: Any) -> np.ndarray:
    """Return the singular matrix ``(e.c) I - c e'`` of the central projection onto a plane.

    The image of `x` is the meet of ``join(center, x)`` with the plane; an ideal `center`
    gives a parallel projection. The centre itself has no image (the zero vector).

    Parameters
    ----------
    center : (3 | 4,) array_like
        Point of the plane or of space.
    plane : (3 | 4,) array_like
        Line of the plane, or plane of space, that does not contain `center`.

    Returns
    -------
    (3, 3) or (4, 4) array
        Of rank 2 or 3, with largest singular value of order 1.

    Raises
    ------
    GeometryError
        If the centre is on the plane.
    """
    c, e, ce = _centre_and_axis(center, plane)
    return (ce * np.eye(len(c)) - np.outer(c, e)) / (norm(c) * norm(e))


def homology(center: Any, axis: Any, factor: float) -> np.ndarray:
    """Return the collineation that fixes the lines through `center` and the points of `axis`.

    On each such line, `x` goes to `x'` with ``cross_ratio(c, x, x', a) == factor`` where
    `a` is its point on the axis. With an eye point as centre this is a relief perspective: all
    images seen from there stay as they are. ``factor -> 0`` is the central projection.

    Raises
    ------
    GeometryError
        If the centre is on the axis, or `factor` is zero or not finite.
    """
    c, e, ce = _centre_and_axis(center, axis)
    if number(factor, "factor") == 0:
        raise GeometryError.expected("factor", "a number other than 0", factor)
    return np.eye(len(c)) + (factor - 1) * np.outer(c, e) / ce
