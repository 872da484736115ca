"""Ideal elements and the completed plane: what central projection does with them.

A plane with its ideal points and its ideal line is *completed*: two different lines always meet in
one point. A central projection of one completed plane onto another is one to one, without any
exception: the vanishing line of the one, whose points have no image in an ordinary plane, goes to
the ideal line of the other (Poncelet, 1822).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .collineations import central_projection
from .projective import (
    IDEAL_LINE,
    IDEAL_PLANE,
    TOLERANCE,
    elements,
    incidence,
    is_ideal,
    join,
    meet,
    norm,
)

__all__ = [
    "Perspectivity",
    "are_parallel",
    "ideal_line",
    "ideal_point",
    "is_ideal_line",
    "is_ideal_plane",
    "is_ideal_point",
]


def is_ideal_point(points: Any, tolerance: float = TOLERANCE) -> np.ndarray:
    """Return a mask of the points ``(..., 3 | 4)`` that lie at infinity; see `is_ideal`."""
    return is_ideal(elements("points", points, (3, 4)), tolerance)


def is_ideal_line(lines: Any, tolerance: float = TOLERANCE) -> np.ndarray:
    """Return a mask of the ideal lines, of the plane ``(..., 3)`` or of space ``(..., 6)``."""
    return is_ideal(elements("lines", lines, (3, 6)), tolerance, dual=True)


def is_ideal_plane(planes: Any, tolerance: float = TOLERANCE) -> np.ndarray:
    """Return a mask of the planes ``(..., 4)`` that are the plane at infinity."""
    return is_ideal(elements("planes", planes, (4,)), tolerance, dual=True)


def ideal_point(lines: Any) -> np.ndarray:
    """Return the ideal points of lines of the plane ``(..., 3)`` or of space ``(..., 6)``.

    Raises
    ------
    GeometryError
        If a line is ideal: all its points are.
    """
    line = elements("lines", lines, (3, 6))
    if is_ideal_line(line).any():
        raise GeometryError.expected("lines", "lines with one ideal point", "an ideal line")
    return meet(line, IDEAL_LINE if line.shape[-1] == 3 else IDEAL_PLANE)


def ideal_line(planes: Any) -> np.ndarray:
    """Return the ideal lines ``(..., 6)`` of planes ``(..., 4)``, where their parallels end.

    Raises
    ------
    GeometryError
        If a plane is the plane at infinity.
    """
    plane = elements("planes", planes, (4,))
    if is_ideal_plane(plane).any():
        raise GeometryError.expected("planes", "planes with one ideal line", "the ideal plane")
    return meet(plane, IDEAL_PLANE)


def are_parallel(a: Any, b: Any, tolerance: float = 1e-9) -> np.ndarray:
    """Return whether two elements meet at infinity, or are the same.

    Parameters
    ----------
    a, b : (..., 3 | 4 | 6) array_like
        Two lines of the plane (3), planes (4), lines of space (6), or a plane and a line.
    tolerance : float
        Of the sine of their angle: computed elements are apart by rounding.

    Raises
    ------
    GeometryError
        If an element is ideal: it has no direction.
    """
    x, y = elements("a", a, (3, 4, 6)), elements("b", b, (3, 4, 6))
    sizes = {x.shape[-1], y.shape[-1]}
    if 3 in sizes and len(sizes) > 1:
        raise GeometryError.expected("a, b", "elements of one plane, or of space", f"{sizes}")
    for name, item in (("a", x), ("b", y)):
        if is_ideal(item, dual=True).any():
            raise GeometryError.expected(name, "an element with a direction", "an ideal one")
    u, v = (item[..., : 2 if item.shape[-1] == 3 else 3] for item in (x, y))
    size = norm(u) * norm(v)
    if sizes == {4, 6}:  # the line's direction is in the plane
        return np.abs(np.sum(u * v, axis=-1)) <= tolerance * size
    if sizes == {3}:
        return np.abs(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]) <= tolerance * size
    return norm(np.cross(u, v)) <= tolerance * size


class Perspectivity:
    """The one-to-one map of a completed plane onto another by projection from a point.

    Parameters
    ----------
    center : (4,) array_like
        The eye; an ideal one makes a parallel projection.
    source, target : (4,) array_like
        Two different planes, neither ideal nor through the centre.

    Raises
    ------
    GeometryError
        If they are not of this kind.

    Attributes
    ----------
    axis : (6,) array
        The line of both planes, whose points stay.
    vanishing_line : (6,) array
        The line of the source whose images are ideal: in the plane through the centre parallel
        to the target. The ideal line itself if the planes are parallel.
    horizon : (6,) array
        The line of the target that is the image of the source's ideal line: parallels of the
        source have images that meet on it.

    Examples
    --------
    >>> p = Perspectivity([0, 0, 1, 1], [0, 0, 1, 0], [0, 1, 0, -1])
    >>> x, y, z, w = p.image([1, 2, 0, 1])
    >>> (x / w).item(), (y / w).item(), (z / w).item()
    (0.5, 1.0, 0.5)
    """

    def __init__(self, center: Any, source: Any, target: Any) -> None:
        items = []
        for name, value in (("center", center), ("source", source), ("target", target)):
            item = elements(name, value, (4,))
            if item.shape != (4,):
                raise GeometryError.expected(name, "one vector of 4 numbers", f"{item.shape}")
            items.append(item)
        self.center, self.source, self.target = items
        for name, plane in (("source", self.source), ("target", self.target)):
            if is_ideal_plane(plane):
                raise GeometryError.expected(name, "a plane other than the ideal one", "that one")
        self._forth = central_projection(self.center, self.target)
        self._back = central_projection(self.center, self.source)
        self.axis = meet(self.source, self.target)
        self.vanishing_line = meet(self.source, join(self.center, ideal_line(self.target)))
        self.horizon = meet(self.target, join(self.center, ideal_line(self.source)))

    def image(self, points: Any) -> np.ndarray:
        """Return the images ``(..., 4)`` in the target of points of the source, ideal or not."""
        return self._on("source", self.source, points) @ self._forth.T

    def preimage(self, points: Any) -> np.ndarray:
        """Return the points ``(..., 4)`` of the source with the given images in the target."""
        return self._on("target", self.target, points) @ self._back.T

    @staticmethod
    def _on(name: str, plane: np.ndarray, points: Any) -> np.ndarray:
        p = elements("points", points, (4,))
        # 1e-9 leaves room for points that were computed to lie on the plane
        if (incidence(p, plane) > 1e-9).any():
            raise GeometryError.expected("points", f"points of the {name} plane", "one off it")
        return p
