"""The plate of a stop: a flat ring around a circle, or around the polygon of an iris's blades."""

from __future__ import annotations

import numpy as np

from ..errors import PrescriptionError
from ..geometry.tensor import tensor_to_triangles
from ..geometry.triangles import BezierTriangles

#: As many blades as an iris may have.
MOST_BLADES = 64


def stop_patches(
    inner: float, outer: float, blades: int = 0, rotation: float = 0.0
) -> BezierTriangles:
    """Return the plate of a stop in the plane z = 0. Normals are along -z.

    Parameters
    ----------
    inner, outer : float
        Radius of the opening, on which the corners of a polygon lie, and of the plate.
    blades : int
        Sides of the opening; 0 is a circle.
    rotation : float
        Degrees by which a polygon is turned: one corner is at that angle from the -x axis towards
        y, as the sensor ``lens`` has it, whose camera sees x mirrored.

    Returns
    -------
    BezierTriangles
        Of degree 3: between a third of a circle, or an edge, and an arc around it.

    Raises
    ------
    PrescriptionError
        If radii or blades cannot be.
    """
    if not 0 < inner < outer < np.inf:
        raise PrescriptionError.expected("inner, outer", "radii, 0 < inner < outer", (inner, outer))
    count, start = check_blades(blades, rotation)
    half = np.pi / count
    weight = np.cos(half)
    sectors = []
    for k in range(count):
        middle = start + (2 * k + 1) * half
        ends = [np.array([-np.cos(a), np.sin(a)]) for a in (middle - half, middle + half)]
        across = np.array([-np.cos(middle), np.sin(middle)])
        rows = []
        for r, straight in ((inner, blades > 0), (outer, False)):
            # the middle control point of an arc is 1 / cos as far out, with the weight cos
            point = r * across * (weight if straight else 1 / weight)
            corners = [[*(r * end), 0.0, 1.0] for end in ends]
            rows.append([corners[0], [*(weight * point), 0.0, weight], corners[1]])
        sectors.append(tensor_to_triangles(np.array(rows)).control_points)
    return BezierTriangles(np.concatenate(sectors))


def check_blades(blades: int, rotation: float) -> tuple[int, float]:
    """Return how many sectors the plate has, and where they start, in radians.

    Raises
    ------
    PrescriptionError
        If there is no such iris.
    """
    whole = isinstance(blades, (int, np.integer)) and not isinstance(blades, bool)
    if not whole or not (blades == 0 or 3 <= blades <= MOST_BLADES):
        raise PrescriptionError.expected(
            "blades", f"0 or a whole number from 3 to {MOST_BLADES}", repr(blades)
        )
    if not np.isfinite(rotation):
        raise PrescriptionError.expected("blade_rotation", "a finite number", rotation)
    return int(blades) or 3, float(np.radians(rotation))
