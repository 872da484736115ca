"""Pieces of surfaces of revolution around the z axis, from which the shapes are built.

All are nets of degree 2 with corner weights 1, so that neighbours have equal parameters along
their common edge. The first two lie on a quadric, projected by `quadric_patch` from one of its
points:

* a *cap*, cut off by the plane of a circle, projected from the point S of the circle at 180
  degrees. From there the circle is a line and the cap a half plane, which two parallel rays
  from the points at -60 and 60 degrees cut into a half strip and two quarter planes: patches
  with one, two and two ideal corners, all of which lie in S;
* a *band* between two circles, in three sectors of two patches each, one for the arc on either
  circle. Seen from above, the upper arc from -60 to 60 degrees is projected from the point of
  the upper circle at 120 degrees, the lower arc from that of the lower circle at -120 degrees.
  Chords of concentric circles are parallel when the angles of their ends have equal sums, so
  the planes that project a common edge from either side coincide: the six patches
  share their edges, without lunes between them;
* *sectors* between a circle and a point of the axis, for cones and disks.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .bernstein import permutation
from .quadrics import quadric_patch
from .triangles import BezierTriangles

__all__ = [
    "band",
    "cap",
    "circle_point",
    "disk_sectors",
    "outward",
    "placed",
    "sectors",
]


def circle_point(angle: float, radius: float, z: float) -> np.ndarray:
    """Return a homogeneous point ``(4,)`` of a circle around the z axis."""
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z, 1.0])


_REVERSED = permutation(2, (0, 2, 1))


def outward(a: np.ndarray, net: np.ndarray) -> np.ndarray:
    """Return a net turned so that its normal points where ``x'Ax`` grows."""
    h = BezierTriangles(net)
    uv = np.full((1, 2), 1 / 3)
    x = h.points(0, uv)[0]
    gradient = (a @ [*x, 1.0])[:3]
    return net if h.normals(0, uv)[0] @ gradient > 0 else net[_REVERSED]


def _standard(net: np.ndarray) -> np.ndarray:
    """Return the net with corner weights 1, for equal parameters along common edges.

    The corners of caps and bands have positive weights.
    """
    f = 1 / np.sqrt(net[[0, 3, 5], 3])
    return net * np.array(
        [f[0] * f[0], f[0] * f[1], f[0] * f[2], f[1] * f[1], f[1] * f[2], f[2] * f[2]]
    ).reshape(6, 1)


def band(a: np.ndarray, low: tuple[float, float], high: tuple[float, float]) -> list[np.ndarray]:
    """Return the band of a quadric of revolution between two circles ``(radius, z)``."""
    third = np.pi / 3
    nets = []
    for k in range(3):
        start, end = (2 * k - 1) * third, (2 * k + 1) * third
        for (r0, z0), (r1, z1), turn in ((high, low, 1.0), (low, high, -1.0)):
            # the arc, and on the other circle the point on the side where the patch tapers off
            other = start if turn > 0 else end
            points = [
                circle_point(start, r0, z0),
                circle_point(end, r0, z0),
                circle_point(other, r1, z1),
            ]
            center = circle_point(2 * k * third + turn * 2 * third, r0, z0)
            nets.append(outward(a, _standard(quadric_patch(a, center, points))))
    return nets


def cap(a: np.ndarray, radius: float, z: float) -> list[np.ndarray]:
    """Return three patches of an oval quadric of revolution, cut off by a circle."""
    center = np.array([-radius, 0.0, z, 1.0])
    gradient = a @ center
    inwards = np.array([1.0, 0.0, -gradient[0] / gradient[2], 0.0])  # tangent of the meridian
    aside = np.array([0.0, 1.0, 0.0, 0.0])  # tangent of the circle
    left, right = circle_point(np.pi / 3, radius, z), circle_point(-np.pi / 3, radius, z)
    triangles = ([right, left, inwards], [left, aside, inwards], [right, -aside, inwards])
    return [outward(a, _standard(quadric_patch(a, center, t))) for t in triangles]


def sectors(rim_z: float, radius: float, tip: np.ndarray, middle: float) -> list[np.ndarray]:
    """Return three sectors between a circle and a point on its axis; arcs as in `band`.

    `middle` is how much of the rim is in the middle control point of an edge to the tip.
    """
    third = np.pi / 3
    nets = []
    for k in range(3):
        start, end = (circle_point((2 * k + s) * third, radius, rim_z) for s in (-1, 1))
        # a third of a circle: weight cos(60 degrees), and the point twice as far out
        arc = 0.5 * circle_point(2 * k * third, 2 * radius, rim_z)
        legs = [(1 - middle) * tip + middle * corner for corner in (start, end)]
        nets.append(np.array([start, arc, legs[0], end, legs[1], tip]))
    return nets


def disk_sectors(radius: float, z: float, up: bool) -> list[np.ndarray]:
    """Return a horizontal disk in three sectors, oriented upwards or downwards."""
    nets = sectors(z, radius, circle_point(0.0, 0.0, z), 0.5)
    return nets if up else [net[_REVERSED] for net in nets]


def placed(nets: list[np.ndarray], center: np.ndarray, scale: Any) -> BezierTriangles:
    """Return patches scaled along the axes and moved by `center`."""
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = center
    return BezierTriangles(nets).transform(matrix)
