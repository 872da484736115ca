"""Plane surfaces as Bézier triangles: the disk, and wedges that end at the horizon."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .checks import lengths, vector
from .revolution import disk_sectors, placed
from .triangles import BezierTriangles

__all__ = ["disk", "half_plane", "plane", "quarter_plane"]


def disk(center: Any = (0, 0, 0), radii: Any = (1, 1)) -> BezierTriangles:
    """Return a disk bounded by an ellipse, horizontal, oriented upwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre.
    radii : (2,) array_like or float
        Half axes.

    Returns
    -------
    BezierTriangles
        Three quadratic patches, sectors around the centre.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> (mb.disk(radii=2).area().sum() / np.pi).round(9).item()
    4.0
    """
    c, r = vector("center", center), lengths("radii", radii, 2)
    return placed(disk_sectors(1.0, 0.0, True), c, [*r, 1.0])


def _directions(u: Any, v: Any, names: tuple[str, str]) -> tuple[np.ndarray, np.ndarray]:
    a, b = vector(names[0], u), vector(names[1], v)
    # 1e-9: parallel up to the rounding of directions that were computed
    if np.linalg.norm(np.cross(a, b)) <= 1e-9 * np.linalg.norm(a) * np.linalg.norm(b):
        raise GeometryError.expected(
            f"{names[0]}, {names[1]}", "independent directions", f"{a.tolist()}, {b.tolist()}"
        )
    return a, b


def quarter_plane(
    corner: Any = (0, 0, 0), u: Any = (1, 0, 0), v: Any = (0, 1, 0)
) -> BezierTriangles:
    """Return the infinite wedge ``corner + a u + b v``, ``a, b >= 0``, as one linear patch.

    Two of its corners are the ideal points of `u` and `v`: it ends at the horizon.

    Parameters
    ----------
    corner : (3,) array_like
        Apex of the wedge.
    u, v : (3,) array_like
        Directions of its sides; the patch is oriented along ``u x v``. The barycentric
        coordinates of a point are ``(a, b, 1) / (a + b + 1)``.

    Raises
    ------
    GeometryError
        If the directions are dependent, or a vector is not of this form.

    Examples
    --------
    >>> wedge = mb.quarter_plane()
    >>> wedge.degree, wedge.points(0, [[0.25, 0.5]]).tolist()
    (1, [[1.0, 2.0, 0.0]])
    """
    p = vector("corner", corner)
    a, b = _directions(u, v, ("u", "v"))
    return BezierTriangles([[[*a, 0.0], [*b, 0.0], [*p, 1.0]]])


def half_plane(
    point: Any = (0, 0, 0), along: Any = (1, 0, 0), inwards: Any = (0, 1, 0)
) -> BezierTriangles:
    """Return the half plane on one side of a line, as two wedges to the horizon.

    Parameters
    ----------
    point : (3,) array_like
        A point of the line, the common corner.
    along, inwards : (3,) array_like
        Direction of the line, and one into the half plane; the surface is oriented along
        ``along x inwards``.

    Raises
    ------
    GeometryError
        If the directions are dependent, or a vector is not of this form.

    Examples
    --------
    >>> half = mb.half_plane()
    >>> len(half), half.degree
    (2, 1)
    """
    point = vector("point", point)
    a, b = _directions(along, inwards, ("along", "inwards"))
    return BezierTriangles.join([quarter_plane(point, a, b), quarter_plane(point, b, -a)])


def plane(point: Any = (0, 0, 0), u: Any = (1, 0, 0), v: Any = (0, 1, 0)) -> BezierTriangles:
    """Return a whole plane as four wedges around a point, to the horizon on all sides.

    Parameters
    ----------
    point : (3,) array_like
        The common corner. Where the picture is near it, parameters are finest.
    u, v : (3,) array_like
        Directions in the plane; their length sets how fast the parameters run out. The
        surface is oriented along ``u x v``.

    Raises
    ------
    GeometryError
        If the directions are dependent, or a vector is not of this form.

    Examples
    --------
    >>> floor = mb.plane()
    >>> len(floor), bool((floor.weights == 0).any())  # it has points at infinity
    (4, True)
    """
    point = vector("point", point)
    a, b = _directions(u, v, ("u", "v"))
    sides = (a, b, -a, -b)
    return BezierTriangles.join(
        [quarter_plane(point, sides[k], sides[(k + 1) % 4]) for k in range(4)]
    )
