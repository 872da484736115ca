"""Builders of quadrics and the torus as exact Bézier triangles.

Every shape has the z axis as its axis and is placed by `center`; turn it with
`BezierTriangles.transform`. Surfaces that bound a solid are oriented outwards, with caps or
without; the hyperbolic paraboloid is oriented upwards. Lengths are in scene units.

`plane_shapes` has the disk and what runs to the horizon; its names are available here, too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .checks import length, lengths, vector
from .covers import sphere
from .plane_shapes import disk, half_plane, plane, quarter_plane
from .quadrics import quadric_patch
from .revolution import band, cap, circle_point, disk_sectors, outward, placed, sectors
from .tensor import tensor_to_triangles
from .triangles import BezierTriangles

__all__ = [
    "cone",
    "cylinder",
    "disk",
    "ellipsoid",
    "elliptic_paraboloid",
    "half_plane",
    "hyperbolic_paraboloid",
    "hyperboloid_one_sheet",
    "hyperboloid_two_sheets",
    "plane",
    "quarter_plane",
    "torus",
]


def ellipsoid(
    center: Any = (0, 0, 0), radii: Any = (1, 1, 1), cover: str | BezierTriangles = "octants"
) -> BezierTriangles:
    """Return an ellipsoid, closed, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre.
    radii : (3,) array_like or float
        Half axes along x, y, z.
    cover : {"octants", "tetrahedral", "lunes"} or BezierTriangles
        As for `covers.sphere`.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> egg = mb.ellipsoid(radii=(3, 2, 1))
    >>> egg.bounds()[:, 1].max(axis=0).tolist()
    [3.0, 2.0, 1.0]
    """
    c, r = vector("center", center), lengths("radii", radii, 3)
    return placed(list(sphere(cover=cover).control_points), c, r)


def elliptic_paraboloid(
    center: Any = (0, 0, 0), radii: Any = (1, 1), height: float = 1, capped: bool = False
) -> BezierTriangles:
    """Return the bowl ``z = height ((x/rx)^2 + (y/ry)^2)`` up to `height`, oriented downwards.

    Parameters
    ----------
    center : (3,) array_like
        Vertex, the lowest point.
    radii : (2,) array_like or float
        Half axes of the rim.
    height : float
        Height of the rim above the vertex. The focus of a round bowl of radius r lies
        ``r^2 / (4 height)`` above the vertex.
    capped : bool
        Close the bowl with a disk.

    Returns
    -------
    BezierTriangles
        Three quadratic patches, and three for the disk.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> bowl = mb.elliptic_paraboloid(radii=2, height=1)
    >>> len(bowl), bowl.degree
    (3, 2)
    """
    c, r, h = vector("center", center), lengths("radii", radii, 2), length("height", height)
    a = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])
    nets = cap(a, 1.0, 1.0)
    if capped:
        nets = nets + disk_sectors(1.0, 1.0, True)
    return placed(nets, c, [*r, h])


def hyperbolic_paraboloid(
    center: Any = (0, 0, 0), radii: Any = (1, 1), height: float = 1
) -> BezierTriangles:
    """Return the saddle ``z = height ((x/rx)^2 - (y/ry)^2)``, oriented upwards.

    Parameters
    ----------
    center : (3,) array_like
        The saddle point.
    radii : (2,) array_like or float
        The patch lies over the rectangle ``|x| <= rx``, ``|y| <= ry`` around it.
    height : float
        Height of the two raised edges' middles above the saddle point.

    Returns
    -------
    BezierTriangles
        Two polynomial quadratic patches, projected along z from the ideal point of the axis.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> saddle = mb.hyperbolic_paraboloid()
    >>> len(saddle), saddle.degree
    (2, 2)
    """
    c, r, h = vector("center", center), lengths("radii", radii, 2), length("height", height)
    a = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])
    corners = [np.array([x, y, 0.0, 1.0]) for x, y in ((1, -1), (-1, 1), (-1, -1), (1, 1))]
    axis = [0.0, 0.0, 1.0, 0.0]
    nets = [
        quadric_patch(a, axis, [corners[i] for i in triple]) for triple in ((0, 1, 2), (1, 0, 3))
    ]
    return placed(nets, c, [*r, h])


def hyperboloid_one_sheet(
    center: Any = (0, 0, 0), radii: Any = (1, 1, 1), height: float = 2, capped: bool = False
) -> BezierTriangles:
    """Return ``(x/rx)^2 + (y/ry)^2 - (z/rz)^2 = 1`` for ``|z| <= height/2``, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre of the waist.
    radii : (3,) array_like or float
        Half axes; the first two are those of the waist, and ``rz`` how high the asymptotic
        cone rises over one of them.
    height : float
        Distance of the rims.
    capped : bool
        Close both ends with disks.

    Returns
    -------
    BezierTriangles
        Six quadratic patches, and six for the disks.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> tower = mb.hyperboloid_one_sheet(radii=(1, 1, 2), height=4)
    >>> mb.classify_quadric(mb.fit_quadric(tower.control_points[0]))
    'hyperboloid of one sheet'
    """
    c, r, h = vector("center", center), lengths("radii", radii, 3), length("height", height)
    z = h / (2 * r[2])
    rim = float(np.sqrt(1 + z * z))
    nets = band(np.diag([1.0, 1.0, -1.0, -1.0]), (rim, -z), (rim, z))
    if capped:
        nets = nets + disk_sectors(rim, -z, False) + disk_sectors(rim, z, True)
    return placed(nets, c, r)


def hyperboloid_two_sheets(
    center: Any = (0, 0, 0), radii: Any = (1, 1, 1), height: float = 1, capped: bool = False
) -> BezierTriangles:
    """Return ``(x/rx)^2 + (y/ry)^2 - (z/rz)^2 = -1``, both sheets, oriented outwards.

    Outwards means: away from the two focal sides, so the upper sheet is seen from below.

    Parameters
    ----------
    center : (3,) array_like
        Centre, midway between the sheets.
    radii : (3,) array_like or float
        Half axes; the vertices are ``rz`` above and below the centre.
    height : float
        Extent of each sheet along z, from its vertex.
    capped : bool
        Close each sheet with a disk.

    Returns
    -------
    BezierTriangles
        Three quadratic patches for the upper sheet (and three for its disk), then the lower one.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> sheets = mb.hyperboloid_two_sheets()
    >>> mb.classify_quadric(mb.fit_quadric(sheets.control_points[0]))
    'hyperboloid of two sheets'
    """
    c, r, h = vector("center", center), lengths("radii", radii, 3), length("height", height)
    a = np.diag([1.0, 1.0, -1.0, 1.0])
    z = 1 + h / r[2]
    rim = float(np.sqrt((z - 1) * (z + 1)))
    # exchanging z and w takes the unit sphere to the hyperboloid; digits are kept for tall ones
    on_sphere = cap(np.diag([1.0, 1.0, 1.0, -1.0]), rim / z, 1 / z)
    upper = [outward(a, z * net[:, [0, 1, 3, 2]]) for net in on_sphere]
    lower = [outward(a, net * [1, 1, -1, 1]) for net in upper]
    nets = []
    for sheet, height_of_rim in ((upper, z), (lower, -z)):
        nets += sheet
        if capped:
            nets += disk_sectors(rim, height_of_rim, height_of_rim > 0)
    return placed(nets, c, r)


def cone(
    center: Any = (0, 0, 0), radii: Any = (1, 1), height: float = 1, capped: bool = False
) -> BezierTriangles:
    """Return a cone with its base at `center` and its apex `height` above, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre of the base.
    radii : (2,) array_like or float
        Half axes of the base.
    height : float
        Height of the apex.
    capped : bool
        Close the base with a disk.

    Returns
    -------
    BezierTriangles
        Three quadratic patches, and three for the disk. The derivatives of a patch vanish in
        the apex, which no rational patch can avoid.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> hat = mb.cone(height=2, capped=True)
    >>> len(hat), hat.bounds()[:, 1, 2].round(12).tolist()  # three patches reach the apex
    (6, [2.0, 2.0, 2.0, 0.0, 0.0, 0.0])
    """
    c, r, h = vector("center", center), lengths("radii", radii, 2), length("height", height)
    # All control points of a leg but the one on the rim lie in the apex: the patch is then
    # arc(u, v) + (2 u w + 2 v w + w^2) apex, homogeneous, which lies on the cone. Without
    # this, like every rational patch with a corner in the apex, it would be 0/0 there.
    nets = sectors(0.0, 1.0, circle_point(0.0, 0.0, 1.0), 0.0)
    if capped:
        nets = nets + disk_sectors(1.0, 0.0, False)
    return placed(nets, c, [*r, h])


def cylinder(
    center: Any = (0, 0, 0), radii: Any = (1, 1), height: float = 1, capped: bool = False
) -> BezierTriangles:
    """Return an elliptic cylinder standing on `center`, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre of the base.
    radii : (2,) array_like or float
        Half axes.
    height : float
        Height of the upper rim above the base.
    capped : bool
        Close both ends with disks.

    Returns
    -------
    BezierTriangles
        Six quadratic patches, and six for the disks.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> len(mb.cylinder(height=2)), len(mb.cylinder(height=2, capped=True))
    (6, 12)
    """
    c, r, h = vector("center", center), lengths("radii", radii, 2), length("height", height)
    nets = band(np.diag([1.0, 1.0, 0.0, -1.0]), (1.0, 0.0), (1.0, 1.0))
    if capped:
        nets = nets + disk_sectors(1.0, 0.0, False) + disk_sectors(1.0, 1.0, True)
    return placed(nets, c, [*r, h])


def _arcs(segments: int) -> np.ndarray:
    """Return a unit circle as quadratic arcs ``(segments, 3, 3)`` in ``(w x, w y, w)``."""
    half = np.pi / segments
    angles = np.arange(segments)[:, None] * 2 * half + np.array([0, half, 2 * half])
    # the middle control point lies 1 / cos(half) out and has the weight cos(half)
    weights = np.array([1.0, np.cos(half), 1.0])
    return np.stack(
        [np.cos(angles), np.sin(angles), np.broadcast_to(weights, angles.shape)], axis=-1
    )


def torus(
    center: Any = (0, 0, 0), radius: float = 1, tube: float = 0.25, segments: int = 4
) -> BezierTriangles:
    """Return a torus around the z axis, closed, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre.
    radius : float
        Radius of the circle in the middle of the tube.
    tube : float
        Radius of the tube, less than `radius`.
    segments : int
        Arcs, at least 3, into which both circles are cut.

    Returns
    -------
    BezierTriangles
        ``2 segments^2`` quartic patches, the exact halves of biquadratic ones.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> ring = mb.torus(radius=2, tube=0.5)
    >>> len(ring), ring.degree
    (32, 4)
    """
    c, big, small = vector("center", center), length("radius", radius), length("tube", tube)
    if not small < big:
        raise GeometryError.expected("tube", f"less than the radius {big:g}", f"{small:g}")
    if not isinstance(segments, int | np.integer) or segments < 3:
        raise GeometryError.expected("segments", "an integer of 3 or more", f"{segments}")
    ring = _arcs(int(segments))
    # meridian: (distance from the axis, height, weight)
    meridian = ring @ np.array([[small, 0, 0], [0, small, 0], [big, 0, 1.0]])
    nets = np.empty((len(ring), len(ring), 3, 3, 4))
    turned, distance = ring[:, None, :, None], meridian[None, :, None, :]
    nets[..., 0] = turned[..., 0] * distance[..., 0]
    nets[..., 1] = turned[..., 1] * distance[..., 0]
    nets[..., 2] = turned[..., 2] * distance[..., 1]
    nets[..., 3] = turned[..., 2] * distance[..., 2]
    matrix = np.eye(4)
    matrix[:3, 3] = c
    return tensor_to_triangles(nets.reshape(-1, 3, 3, 4)).transform(matrix)
