"""Stereographic projection of a quadric: from one of its points onto a plane, and back.

The map is one to one except in the tangent plane of the centre. It takes plane sections of the
quadric to conics, and those through the centre to lines; from the sphere to a plane parallel to the
centre's tangent plane, circles to circles. A plane triangle goes back to a rational quadratic
Bézier triangle: `quadric_patch`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .projective import TOLERANCE, elements, incidence, norm
from .quadrics import quadric_matrix, quadric_patch
from .triangles import BezierTriangles

__all__ = ["StereographicProjection"]


class StereographicProjection:
    """The projection of a quadric from one of its points onto a plane.

    Parameters
    ----------
    A : (4, 4) array_like, optional
        Symmetric matrix of the quadric, also a cone or cylinder; the unit sphere if not given.
    center : (4,) array_like
        Point of the quadric, homogeneous, not its vertex; ideal for a parallel projection, such
        as that of ``z = x^2 + y^2`` along its axis.
    plane : (4,) array_like
        Plane that does not contain the centre.

    Raises
    ------
    GeometryError
        If they are not of this kind.

    Examples
    --------
    >>> sphere = StereographicProjection()  # from the north pole onto the equator's plane
    >>> sphere.inverse([3.0, 4, 0, 1]) / sphere.inverse([3.0, 4, 0, 1])[3]
    array([0.23076923, 0.30769231, 0.92307692, 1.        ])
    """

    def __init__(
        self,
        A: Any = None,
        center: Any = (0, 0, 1, 1),
        plane: Any = (0, 0, 1, 0),
    ) -> None:
        a = quadric_matrix(np.diag([1.0, 1, 1, -1]) if A is None else A)
        s, e = elements("center", center, (4,)), elements("plane", plane, (4,))
        if s.shape != (4,) or e.shape != (4,):
            raise GeometryError.expected(
                "center, plane", "one point and one plane", f"shapes {s.shape}, {e.shape}"
            )
        terms = np.abs(s) @ np.abs(a) @ np.abs(s)
        # 1e-9: leaves room for a centre that was computed to lie on the quadric
        if abs(s @ a @ s) > 1e-9 * terms:
            raise GeometryError.expected(
                "center", "a point on the quadric", f"S'AS = {s @ a @ s:.3g} of {terms:.3g}"
            )
        if np.abs(a @ s).max() <= 1e-9 * np.abs(a).max() * np.abs(s).max():
            raise GeometryError.expected("center", "a regular point of the quadric", "its vertex")
        if incidence(s, e) <= TOLERANCE:
            raise GeometryError.expected("plane", "a plane without the centre", "one through it")
        self.matrix, self.center, self.plane = a, s, e

    @property
    def tangent_plane(self) -> np.ndarray:
        """The tangent plane ``(4,)`` of the quadric in the centre."""
        return self.matrix @ self.center

    def forward(self, points: Any) -> np.ndarray:
        """Return the images ``(..., 4)`` in the plane of points of the quadric.

        A point of the tangent plane of the centre goes to the line that this plane and the image
        plane share, the ideal one if they are parallel.

        Raises
        ------
        GeometryError
            If a point is not on the quadric, or is the centre itself.
        """
        p = elements("points", points, (4,))
        value = np.einsum("...i,ij,...j->...", p, self.matrix, p)
        terms = np.einsum("...i,ij,...j->...", np.abs(p), np.abs(self.matrix), np.abs(p))
        if (np.abs(value) > 1e-9 * terms).any():
            raise GeometryError.expected("points", "points of the quadric", "one off it")
        out = (self.plane @ self.center) * p - (p @ self.plane)[..., None] * self.center
        size = norm(self.plane) * norm(self.center) * norm(p)
        if (norm(out) <= TOLERANCE * size).any():
            raise GeometryError.expected("points", "points other than the centre", "the centre")
        return out

    def inverse(self, points: Any) -> np.ndarray:
        """Return the points ``(..., 4)`` of the quadric on the lines from the centre to `points`.

        ``2 (S'A P) P - (P'A P) S``. The points need not lie in the plane. Those in the tangent
        plane of the centre go to the centre.

        Raises
        ------
        GeometryError
            If a point is the centre, or its line to the centre lies on the quadric.
        """
        p = elements("points", points, (4,))
        polar = p @ self.matrix @ self.center
        gram = np.einsum("...i,ij,...j->...", p, self.matrix, p)
        out = 2 * polar[..., None] * p - gram[..., None] * self.center
        size = norm(p) ** 2 * norm(self.center) * np.abs(self.matrix).max()
        if (norm(out) <= TOLERANCE * size).any():
            raise GeometryError.expected(
                "points", "points whose lines to the centre meet the quadric once more", "others"
            )
        return out

    def triangle(self, points: Any) -> BezierTriangles:
        """Return the patch over a triangle ``(3, 4)``: its image on the quadric, exactly."""
        return BezierTriangles(quadric_patch(self.matrix, self.center, points))
