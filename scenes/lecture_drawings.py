"""Drawings of curves on a board, and the relief of the lute, for `make_lecture`.

The board is the plane y = 0; drawn points (a, b) stand at (a, 0, b).
"""

from __future__ import annotations

import duerer_machine
import numpy as np

from mitsuba_bezier.geometry.collineations import homology
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.farin import cross_ratio_scheme
from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = [
    "CUBIC",
    "DRAWINGS",
    "RATIONAL",
    "RELIEF",
    "T_CUBIC",
    "T_RATIONAL",
    "relief",
    "scheme",
    "standing",
]

#: The cubic of the de Casteljau picture and its parameter.
CUBIC = BezierCurve.from_points([[-2.2, -0.9], [-1.5, 1.3], [1.4, 1.5], [2.2, -0.8]])
T_CUBIC = 0.25
#: The same polygon with other weights, and the parameter, for the picture with Farin points.
RATIONAL = BezierCurve.from_points(
    [[-2.2, -0.9], [-1.5, 1.3], [1.4, 1.5], [2.2, -0.8]], [1, 1.8, 0.6, 1]
)
T_RATIONAL = 0.4
#: The drawings: name, curve, parameter.
DRAWINGS = (("decasteljau", CUBIC, T_CUBIC), ("farin", RATIONAL, T_RATIONAL))
#: The collineation that flattens the lute for the eye: the plane x = 0.35 stays, the eye is centre.
RELIEF = homology(duerer_machine.EYE, [1.0, 0, 0, -0.35], 0.22)


def standing(x: np.ndarray) -> np.ndarray:
    """Return points of the plane, homogeneous ``(..., 3)``, as affine points on the board."""
    x = np.asarray(x, dtype=np.float64)
    a = x[..., :2] / x[..., 2:]
    return np.stack([a[..., 0], np.zeros(a.shape[:-1]), a[..., 1]], axis=-1)


def scheme(curve: BezierCurve, t: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the levels of the evaluation by cross ratios, on the board: points and Farin points.

    For a curve whose weights are equal it is de Casteljau's scheme.
    """
    levels = cross_ratio_scheme(curve.control_points, curve.farin_points(), t)
    return [(standing(points), standing(farin)) for points, farin in levels]


def relief() -> dict[str, BezierTriangles]:
    """Return the parts of the lute under `RELIEF`."""
    return {name: p.transform(RELIEF) for name, p in duerer_machine.lute().items()}
