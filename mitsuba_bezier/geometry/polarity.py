"""Pole and polar of conics and quadrics, conjugate points, and curves reciprocated (Poncelet).

The polar of a point `p` by the symmetric matrix `A` is ``A p``: a line of the plane (3x3), a plane
of space (4x4). Two points are conjugate if each lies on the polar of the other, ``p' A q = 0``. A
polarity exchanges points and hyperplanes and keeps incidence: what is true of points and lines is
true of lines and points. It takes a curve to the envelope of the polars of its points.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .curves import BezierCurve
from .duality import DualBezierCurve
from .projective import TOLERANCE, elements, line_points, meet, norm, numbers, same_shape

__all__ = [
    "Polarity",
    "conjugacy",
    "conjugate_point",
    "line_intersections",
    "polar",
    "pole",
    "tangents_from",
]


def _symmetric(a: Any) -> np.ndarray:
    m = numbers(a, "A")
    if m.shape not in ((3, 3), (4, 4)) or not m.any():
        raise GeometryError.expected(
            "A", "a symmetric 3x3 or 4x4 matrix, not zero", f"shape {m.shape}"
        )
    m = m / np.abs(m).max()
    if np.abs(m - m.T).max() > 1e-9:  # leaves room for matrices that were computed
        raise GeometryError.expected("A", "a symmetric matrix", "one that is not")
    return (m + m.T) / (2 * np.linalg.norm(m))


def _regular(a: Any) -> np.ndarray:
    m = _symmetric(a)
    size = np.abs(np.linalg.eigvalsh(m))
    if not size.min() > TOLERANCE * size.max():
        what = "pair of lines" if len(m) == 3 else "cone or pair of planes"
        raise GeometryError.expected("A", "a regular matrix", f"a singular one: a {what}")
    return m


def polar(A: Any, points: Any) -> np.ndarray:
    """Return the polars ``A p`` of points: lines ``(..., 3)`` or planes ``(..., 4)``.

    Raises
    ------
    GeometryError
        If a point is the vertex of a degenerate conic or quadric: it has no polar.
    """
    a = _symmetric(A)
    p = elements("points", points, (len(a),))
    out = p @ a
    if (norm(out) <= TOLERANCE * norm(p)).any():
        raise GeometryError.expected("points", "points that have a polar", "the vertex of A")
    return out


def pole(A: Any, hyperplanes: Any) -> np.ndarray:
    """Return the poles of lines of the plane ``(..., 3)`` or planes ``(..., 4)``.

    Raises
    ------
    GeometryError
        If `A` is singular (a pair of lines, a cone): poles are not determined.
    """
    a = _regular(A)
    return elements("hyperplanes", hyperplanes, (len(a),)) @ np.linalg.inv(a)


def conjugacy(A: Any, p: Any, q: Any) -> np.ndarray:
    """Return how far points are from being conjugate: the `incidence` of one and a polar."""
    a = _symmetric(A)
    x, y = elements("p", p, (len(a),)), elements("q", q, (len(a),))
    same_shape("p, q", x, y)
    line = x @ a
    if (norm(line) <= TOLERANCE * norm(x)).any():
        raise GeometryError.expected("p", "a point that has a polar", "the vertex of A")
    return np.abs(np.sum(line * y, axis=-1)) / (norm(line) * norm(y))


def conjugate_point(A: Any, p: Any, line: Any) -> np.ndarray:
    """Return the point of a line that is conjugate to `p`.

    Parameters
    ----------
    A : (3, 3) or (4, 4) array_like
        Conic or quadric.
    p : (..., 3 | 4) array_like
        Points.
    line : (..., 3 | 6) array_like
        Lines of the plane, or of space.

    Raises
    ------
    GeometryError
        If a line is the polar of its point, or lies in it: all its points are conjugate to it.
    """
    return meet(polar(A, p), line)


def _binary_roots(a: float, b: float, c: float) -> list[tuple[float, float]]:
    """Return the real ``(x, y)`` with ``a x^2 + 2 b x y + c y^2 = 0``, without cancellation."""
    d = b * b - a * c
    # 1e-14: rounding of the difference; a double root then
    if abs(d) <= 1e-14 * (b * b + abs(a * c)):
        return [(-b, a) if abs(a) >= abs(c) else (c, -b)]
    if d < 0:
        return []
    q = -(b + np.copysign(np.sqrt(d), b))
    return [(q, a), (c, q)]


def line_intersections(A: Any, line: Any) -> np.ndarray:
    """Return the real points of one line on a conic or quadric, ``(k, 3 | 4)``, k = 0, 1, 2.

    Raises
    ------
    GeometryError
        If the line lies on it.
    """
    a = _symmetric(A)
    x = elements("line", line, (3,) if len(a) == 3 else (6,))
    if x.ndim != 1:
        raise GeometryError.expected("line", "one line", f"shape {x.shape}")
    if len(a) == 3:
        k = int(np.argmin(np.abs(x)))
        p = np.cross(x, np.eye(3)[k])
        q = np.cross(x, p)
    else:
        p, q = line_points(x)
    p, q = p / norm(p), q / norm(q)
    form = np.array([p @ a @ p, p @ a @ q, q @ a @ q])
    if np.abs(form).max() <= TOLERANCE:
        raise GeometryError.expected("line", "a line that does not lie on A", "one that does")
    return np.array([s * p + t * q for s, t in _binary_roots(*form)]).reshape(-1, len(a))


def tangents_from(A: Any, point: Any) -> np.ndarray:
    """Return the real tangents ``(k, 3)`` of a regular conic through one point, k = 0, 1, 2."""
    a = _regular(A)
    if len(a) != 3:
        raise GeometryError.expected("A", "a 3x3 matrix, a conic", f"{len(a)}x{len(a)}")
    # the lines of the conic are a conic of lines, and a point is a line of those
    return line_intersections(np.linalg.inv(a), point)


class Polarity:
    """The polarity of a regular conic (3x3) or quadric (4x4).

    Parameters
    ----------
    A : (3, 3) or (4, 4) array_like
        Symmetric and regular. It need not have real points.

    Raises
    ------
    GeometryError
        If it is not: a pair of lines, a cone, a pair of planes.

    Examples
    --------
    >>> circle = mb.Polarity(np.diag([1.0, 1, -1]))
    >>> line = circle.polar([2, 0, 1])
    >>> (line / line[0]).round(12).tolist()  # x = 1/2
    [1.0, 0.0, -0.5]
    """

    def __init__(self, A: Any) -> None:
        self.matrix = _regular(A)
        self.matrix.setflags(write=False)

    @property
    def dimension(self) -> int:
        """2 for a conic, 3 for a quadric."""
        return len(self.matrix) - 1

    def __repr__(self) -> str:
        return f"Polarity(dimension {self.dimension})"

    def polar(self, points: Any) -> np.ndarray:
        """Return the polars of points; see `polar`."""
        return polar(self.matrix, points)

    def pole(self, hyperplanes: Any) -> np.ndarray:
        """Return the poles of lines or planes; see `pole`."""
        return pole(self.matrix, hyperplanes)

    def reciprocal(self, figure: BezierCurve | DualBezierCurve) -> DualBezierCurve | BezierCurve:
        """Return the dual figure: polars of a curve's points, or poles of a dual curve's elements.

        The polars of a plane curve of degree n envelop its *polar reciprocal*, as point curve of
        degree ``2n - 2`` (`reciprocal_curve`). Twice, a figure comes back.

        Raises
        ------
        GeometryError
            If curve and polarity are not of one dimension.
        """
        if figure.dimension != self.dimension:
            raise GeometryError.expected(
                "figure", f"one of dimension {self.dimension}", f"{figure!r}"
            )
        if isinstance(figure, BezierCurve):
            return DualBezierCurve(figure.control_points @ self.matrix)
        return BezierCurve(figure.control_elements @ np.linalg.inv(self.matrix))

    def reciprocal_curve(self, curve: BezierCurve) -> BezierCurve:
        """Return the polar reciprocal as a point curve: the envelope of the polars.

        Its points are the poles of the curve's tangents (plane) or osculating planes (space).

        Raises
        ------
        GeometryError
            As `reciprocal` and `DualBezierCurve.point_form`: the polars of a line's points pass
            through one point.
        """
        lines = self.reciprocal(curve)
        assert isinstance(lines, DualBezierCurve)
        return lines.point_form()
