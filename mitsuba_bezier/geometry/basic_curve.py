"""Bézier's first idea: a curve as the intersection of two elliptic cylinders in a parallelepiped.

Before polynomials, Bézier described the *basic curve* as the intersection of two elliptic cylinders
that are inscribed in a box. Whoever moves the box by an affine map, a shear for instance, moves
the curve with it: a shape is changed by what stands around it. Polynomials over a polygon of the
box's edges came next, and with them degrees above three (Farin, "A history of curves and surfaces
in CAGD", 2002).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .collineations import matrix
from .curves import BezierCurve
from .projective import TOLERANCE, numbers

__all__ = ["BasicCurve"]


class BasicCurve:
    """The curve on two elliptic cylinders in a parallelepiped, from corner to opposite corner.

    In coordinates x, y, z along the three edges, from 0 to 1, the cylinders are
    ``x^2 + (y - 1)^2 = 1`` (parallel to the third edge) and ``y^2 + (z - 1)^2 = 1`` (parallel to
    the first): a quarter of each. The curve leaves along the first edge, its osculating plane
    there is the face of the first two, and arrives along the third.

    Parameters
    ----------
    origin : (3,) array_like
        Corner where the curve begins.
    edges : (3, 3) array_like
        The box's edges from there, one a row, in the order in which the curve follows them.

    Raises
    ------
    GeometryError
        If they are not of this form, or in one plane: no box.

    Examples
    --------
    >>> curve = mb.BasicCurve()
    >>> curve.points(0.5).round(6).tolist()
    [0.92388, 0.617317, 0.213285]
    """

    def __init__(
        self, origin: Any = (0, 0, 0), edges: Any = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    ) -> None:
        o, e = numbers(origin, "origin"), numbers(edges, "edges")
        if o.shape != (3,) or e.shape != (3, 3):
            raise GeometryError.expected(
                "origin, edges", "a point and three edges", f"shapes {o.shape}, {e.shape}"
            )
        length = np.linalg.norm(e, axis=1)
        if not length.all() or abs(np.linalg.det(e / length[:, None])) <= TOLERANCE:
            raise GeometryError.expected("edges", "three independent edges", f"{e.tolist()}")
        self.origin, self.edges = o, e
        #: Affine map (4, 4) of the unit cube to the box.
        self.frame = np.eye(4)
        self.frame[:3, :3], self.frame[:3, 3] = e.T, o

    def __repr__(self) -> str:
        return f"BasicCurve(origin {self.origin.tolist()}, edges {self.edges.tolist()})"

    @property
    def cylinders(self) -> np.ndarray:
        """The matrices ``(2, 4, 4)`` of both cylinders."""
        back = np.linalg.inv(self.frame)
        first = np.array([[1, 0, 0, 0], [0, 1, 0, -1], [0, 0, 0, 0], [0, -1, 0, 0.0]])
        second = np.array([[0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1], [0, 0, -1, 0.0]])
        return np.stack([back.T @ a @ back for a in (first, second)])

    def points(self, t: Any) -> np.ndarray:
        """Return points ``(..., 3)`` for parameters ``(...)`` from 0 to 1.

        Raises
        ------
        GeometryError
            If a parameter is outside.
        """
        t = numbers(t, "t")
        if ((t < 0) | (t > 1)).any():
            raise GeometryError.expected("t", "parameters from 0 to 1", f"{t.min()} .. {t.max()}")
        # by the angle on the first cylinder, x = sin a, y = 1 - cos a, at whose end z turns up
        # like a root: a quarter turn is run through so that it comes to rest there
        angle = np.pi / 2 * (1 - (1 - t) ** 2)
        x, y = np.sin(angle), 2 * np.sin(angle / 2) ** 2
        # z = 1 - sqrt(1 - y^2) without cancellation; 1 - y = cos a
        rest = np.sqrt(np.maximum(np.cos(angle) * (1 + y), 0.0))
        z = y**2 / (1 + rest)
        return self.origin + np.stack([x, y, z], axis=-1) @ self.edges

    def transform(self, m: Any) -> BasicCurve:
        """Return the curve of the box's image under an affine map ``(4, 4)``: the curve's image.

        Raises
        ------
        GeometryError
            If the map is not affine and regular.
        """
        a = matrix("m", m, ((4, 4),))
        if not np.array_equal(a[3] / a[3, 3] if a[3, 3] else a[3], [0, 0, 0, 1]):
            raise GeometryError.expected("m", "an affine map, last row (0, 0, 0, 1)", f"{a[3]}")
        image = a / a[3, 3] @ self.frame
        return BasicCurve(image[:3, 3], image[:3, :3].T)

    def polygon(self) -> BezierCurve:
        """Return the Bézier cubic over the same three edges: the idea that came of it."""
        legs = np.vstack([self.origin, self.edges])
        return BezierCurve.from_points(np.cumsum(legs, axis=0))
