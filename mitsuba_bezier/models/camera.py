"""Place the camera: views by name, and the place from which all points just fit."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import BezierError

__all__ = ["UPS", "VIEWS", "Frame", "View", "fitted", "read_up", "read_view", "view_frame"]

#: Azimuth and elevation in degrees: from the front round to the right, and upwards.
VIEWS = {
    "iso": (45.0, float(np.degrees(np.arctan(np.sqrt(0.5))))),
    "front": (0.0, 0.0),
    "right": (90.0, 0.0),
    "back": (180.0, 0.0),
    "left": (-90.0, 0.0),
    "top": (0.0, 90.0),
    "bottom": (0.0, -90.0),
}

#: For each direction that is up: rows right, backward (away from who stands in front), up.
UPS = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


def read_view(view: Any) -> tuple[float, float]:
    """Return azimuth and elevation, in degrees, of a name or of ``AZ,EL``.

    Raises
    ------
    BezierError
        If it is neither.
    """
    words = [str(x) for x in view] if isinstance(view, (tuple, list)) else str(view).split(",")
    if len(words) == 1 and words[0].strip().lower() in VIEWS:
        return VIEWS[words[0].strip().lower()]
    try:
        azimuth, elevation = (float(word) for word in words)
    except ValueError:
        near = difflib.get_close_matches(str(view).lower(), VIEWS, n=1)
        hint = f" (did you mean '{near[0]}'?)" if near else ""
        expected = f"one of {', '.join(VIEWS)}, or AZ,EL in degrees"
        raise BezierError.expected("view", expected, f"{view!r}{hint}") from None
    if not (abs(azimuth) <= 3600 and abs(elevation) <= 90):
        raise BezierError.expected(
            "view", "an azimuth in degrees and an elevation from -90 to 90", f"{view!r}"
        )
    return azimuth, elevation


def read_up(up: Any) -> np.ndarray:
    """Return the rows right, backward and up of a name of an axis.

    Raises
    ------
    BezierError
        If it is none.
    """
    name = str(up).strip().lower().removeprefix("+")
    if name not in UPS:
        raise BezierError.expected("up", f"one of {', '.join(UPS)}", repr(up))
    return np.array(UPS[name], dtype=np.float64)


#: The camera stays that far from the nearest point, relative to the size of the model.
_CLEAR = 0.2


@dataclass(frozen=True)
class Frame:
    """Unit vectors of a view: to the right in the picture, upwards in it, towards the camera."""

    right: np.ndarray
    up: np.ndarray
    back: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """The three as rows."""
        return np.stack([self.right, self.up, self.back])


def view_frame(azimuth: float, elevation: float, axes: np.ndarray) -> Frame:
    """Return the directions of a view, with `axes` of `read_up`."""
    a, e = np.radians(azimuth), np.radians(elevation)
    right = np.array([np.cos(a), np.sin(a), 0.0])
    back = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
    return Frame(right @ axes, np.cross(back, right) @ axes, back @ axes)


@dataclass(frozen=True)
class View:
    """A camera.

    Attributes
    ----------
    origin, target, up : (3,) arrays
        Where it stands, where it looks, what is up in the picture.
    fov : float or None
        Angle of view along the smaller side of the picture, in degrees; None: orthographic.
    scale : float
        Half the width of an orthographic picture.
    near, far : float
        Distances that it sees.
    """

    origin: np.ndarray
    target: np.ndarray
    up: np.ndarray
    fov: float | None
    scale: float
    near: float
    far: float


def fitted(
    points: np.ndarray, frame: Frame, fov: float | None, aspect: float, margin: float = 0.06
) -> View:
    """Return the camera that sees all points, as near as it can be.

    Parameters
    ----------
    points : (N, 3) array
    frame : Frame
        Its directions.
    fov : float or None
        Angle of view along the smaller side; None: orthographic.
    aspect : float
        Width over height.
    margin : float
        What stays free at each side of the picture, as a part of its half.

    Returns
    -------
    View
    """
    local = points @ frame.rows.T
    low, high = local.min(axis=0), local.max(axis=0)
    size = float(np.linalg.norm(high - low))
    free = 1.0 - margin
    if fov is None:
        half = (high - low)[:2] / 2 / free
        scale = max(half[0], half[1] * aspect, 1e-9 * size)
        middle = (low + high) / 2
        place = np.array([middle[0], middle[1], high[2] + size])
        distance = place[2] - middle[2]
    else:
        smaller = np.tan(np.radians(fov) / 2)
        tangent = free * smaller * np.array([max(aspect, 1.0), max(1.0 / aspect, 1.0)])
        # |x - c| <= (d - z) tan: two bounds of c that are linear in d
        first = (local[:, :2] + local[:, 2:] * tangent).max(axis=0)
        second = (local[:, :2] - local[:, 2:] * tangent).min(axis=0)
        depth = max(float(((first - second) / (2 * tangent)).max()), high[2] + _CLEAR * size)
        centre = (first - depth * tangent + second + depth * tangent) / 2
        place, scale = np.array([*centre, depth]), 1.0
        distance = depth - (low[2] + high[2]) / 2
    origin = place @ frame.rows
    target = (place - [0.0, 0.0, distance]) @ frame.rows
    near = max((place[2] - high[2]) / 2, 1e-3 * distance)
    return View(origin, target, frame.up, fov, float(scale), float(near), 1e4 * float(distance))
