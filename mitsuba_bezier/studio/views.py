"""Cameras of browsers: ours of theirs, and where they look at first."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry.camera import Camera

__all__ = ["camera_of", "first_view"]


def camera_of(view: Any, width: int) -> Camera:
    """Return our camera of a browser's: a rotation that looks along +z with +y down."""
    a, x, y, z = (float(v) for v in view.wxyz)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - a * z), 2 * (x * z + a * y)],
            [2 * (x * y + a * z), 1 - 2 * (x * x + z * z), 2 * (y * z - a * x)],
            [2 * (x * z - a * y), 2 * (y * z + a * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    to_world = np.eye(4)
    to_world[:3, :3] = rotation * [-1.0, -1.0, 1.0]  # Mitsuba's x is to the left, its y up
    to_world[:3, 3] = view.position
    # a narrow window gets as many pixels as a wide one
    aspect = float(view.aspect)
    if aspect < 1:
        size = (max(round(width * aspect), 16), width)
    else:
        size = (width, max(round(width / aspect), 16))
    return Camera(to_world, float(np.degrees(view.fov)), "y", size)


def first_view(
    places: np.ndarray, way: tuple[float, float, float], flat: bool, view: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return an eye and what it looks at, for a net to fill the window beside the controls.

    Parameters
    ----------
    places : (K, 3) array
        The net.
    way : tuple of float
        From the net to the eye.
    flat : bool
        The net stands in the plane y = 0: it is seen from the front.
    view : viser's camera
        Its field of view and proportions.
    """
    low, high = places.min(axis=0), places.max(axis=0)
    middle = (low + high) / 2
    radius = float(np.linalg.norm(places - middle, axis=1).max()) or 1.0
    d = np.array([0.0, -1.0, 0.08]) if flat else np.asarray(way, dtype=np.float64)
    d = d / np.linalg.norm(d)
    aspect = float(view.aspect)
    half = np.tan(view.fov / 2) * min(1.0, aspect)
    # a tenth of the window stays free around the ball of the net
    eye = middle + d * radius * np.sqrt(1 + 1 / half**2) * 1.1
    right = np.cross(-d, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, -d)
    # the controls lie on the right of a wide window, and over the lower half of a narrow one
    wide = float(np.linalg.norm(eye - middle)) * np.tan(view.fov / 2)
    shift = -0.42 * wide * up if aspect < 0.8 else 0.12 * wide * right
    return eye + shift, middle + shift
