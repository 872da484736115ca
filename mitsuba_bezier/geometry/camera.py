"""`Camera`: the map of a Mitsuba `perspective` sensor from world to pixels, as a collineation.

Conventions of Mitsuba 3.9 (``perspective_projection`` and the `perspective` plugin):

* Camera space: the eye is the origin and looks along +z, +y is up, and +x is to the *left* in
  the image. ``to_world`` takes it to the world and must be rigid (a reflection is allowed).
* With the film size ``(w, h)`` and the horizontal field of view `f`, the focal length in pixels
  is ``w / (2 tan(f/2))``, the same in both directions.
* Pixels are counted from the upper left corner of the crop window, x to the right, y down;
  pixel ``(i, j)`` covers ``[i, i+1] x [j, j+1]``, its centre is at ``(i + 0.5, j + 0.5)``.
* A positive ``principal_point_offset`` moves the image to the left (up) by that fraction of the
  whole film, crop window or not.
* Depth is 0 at the near and 1 at the far clipping distance; it does not affect pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import GeometryError
from .projective import TOLERANCE, elements, ideal, norm, number, numbers, point

__all__ = ["Camera", "fov_of_focal_length", "horizontal_fov", "look_at"]

#: Values of `fov_axis`.
AXES = ("x", "y", "diagonal", "smaller", "larger")


def horizontal_fov(fov: float, fov_axis: str, film_size: Any) -> float:
    """Return the horizontal field of view in degrees, as Mitsuba's ``parse_fov``.

    Parameters
    ----------
    fov : float
        Field of view in degrees along `fov_axis`.
    fov_axis : {"x", "y", "diagonal", "smaller", "larger"}
        Of a square film both "smaller" and "larger" are the same.
    film_size : (2,) array_like
        Width and height of the whole film.

    Raises
    ------
    GeometryError
        If the axis is none of these or an angle not between 0 and 180 degrees.
    """
    width, height = _pair("film_size", film_size, 1)
    if fov_axis not in AXES:
        raise GeometryError.expected("fov_axis", "one of " + ", ".join(AXES), repr(fov_axis))
    if not 0 < number(fov, "fov") < 180:
        raise GeometryError.expected("fov", "an angle between 0 and 180 degrees", fov)
    aspect = width / height
    half = np.tan(np.radians(fov) / 2)
    wide = aspect > 1
    if fov_axis == "y" or (fov_axis == "smaller" and wide) or (fov_axis == "larger" and not wide):
        half *= aspect
    elif fov_axis == "diagonal":
        half /= np.sqrt(1 + 1 / aspect**2)
    return float(2 * np.degrees(np.arctan(half)))


def fov_of_focal_length(millimetres: float) -> float:
    """Return the field of view in degrees, along "diagonal", of a lens on 36 x 24 mm film.

    Mitsuba's ``focal_length``, 50 where a sensor has neither that nor ``fov``.
    """
    if not number(millimetres, "millimetres") > 0:
        raise GeometryError.expected("millimetres", "a number > 0", millimetres)
    return float(2 * np.degrees(np.arctan(np.hypot(36, 24) / (2 * millimetres))))


def look_at(origin: Any, target: Any, up: Any = (0.0, 1.0, 0.0)) -> np.ndarray:
    """Return ``to_world`` (4, 4) of a camera at `origin` looking at `target`, as Mitsuba does.

    Raises
    ------
    GeometryError
        If origin and target coincide or `up` is parallel to the view.
    """
    o, t, u = (numbers(x, n) for x, n in ((origin, "origin"), (target, "target"), (up, "up")))
    if not o.shape == t.shape == u.shape == (3,):
        raise GeometryError.expected("origin, target, up", "vectors of 3 numbers", f"{o.shape}")
    view = t - o
    left = np.cross(u, view)
    if norm(left) <= TOLERANCE * norm(view) * norm(u):
        raise GeometryError.expected(
            "origin, target, up", "different points and an independent up", "dependent vectors"
        )
    z, x = view / norm(view), left / norm(left)
    out = np.eye(4)
    out[:3] = np.stack([x, np.cross(z, x), z, o], axis=1)
    return out


def _pair(name: str, value: Any, least: float) -> np.ndarray:
    out = numbers(value, name)
    if out.shape != (2,) or (out < least).any():
        bound = f" of at least {least:g}" if np.isfinite(least) else ""
        raise GeometryError.expected(name, "two numbers" + bound, out.tolist())
    return out


class Camera:
    """The camera map of a Mitsuba `perspective` sensor.

    Parameters
    ----------
    to_world : (4, 4) array_like
        Rigid, as `look_at` returns it; up to 1e-5 off, since Mitsuba holds float32.
    fov : float
        Field of view in degrees.
    fov_axis : {"x", "y", "diagonal", "smaller", "larger"}
        Its direction.
    film_size : (2,) array_like
        Width and height of the film in pixels.
    crop_offset, crop_size : (2,) array_like
        Crop window in pixels; the whole film if not given.
    principal_point_offset : (2,) array_like
        As fractions of the film's width and height.
    near_clip, far_clip : float
        Clipping distances.

    Raises
    ------
    GeometryError
        If a parameter is not of this kind.

    Attributes
    ----------
    matrix : (4, 4) array
        World to ``(w x, w y, w depth, w)`` in pixels. `w` is the distance along the axis of
        view: positive in front of the camera.
    image_matrix : (3, 4) array
        The same without depth: world to ``(w x, w y, w)``.

    Examples
    --------
    >>> from mitsuba_bezier.geometry.camera import look_at
    >>> camera = mb.Camera(look_at([0, 0, 0], [0, 0, 1]), fov=90, film_size=(200, 100))
    >>> camera.pixels([0, 0.25, 1]).round(9).tolist()
    [100.0, 25.0]
    """

    matrix: np.ndarray
    image_matrix: np.ndarray

    def __init__(
        self,
        to_world: Any,
        fov: float,
        fov_axis: str = "x",
        film_size: Any = (768, 576),
        crop_offset: Any = (0, 0),
        crop_size: Any = None,
        principal_point_offset: Any = (0, 0),
        near_clip: float = 1e-2,
        far_clip: float = 1e4,
    ) -> None:
        m = numbers(to_world, "to_world")
        rigid = m.shape == (4, 4) and np.array_equal(m[3], [0, 0, 0, 1])
        if not rigid or np.abs(m[:3, :3].T @ m[:3, :3] - np.eye(3)).max() > 1e-5:
            raise GeometryError.expected(
                "to_world", "a rigid 4x4 matrix (Mitsuba refuses scale)", f"{m.tolist()}"
            )
        film = _pair("film_size", film_size, 1)
        offset = _pair("crop_offset", crop_offset, 0)
        crop = film - offset if crop_size is None else _pair("crop_size", crop_size, 1)
        if (offset + crop > film).any():
            raise GeometryError.expected(
                "crop_offset, crop_size",
                f"a window within the film {film.tolist()}",
                f"{offset.tolist()}, {crop.tolist()}",
            )
        shift = _pair("principal_point_offset", principal_point_offset, -np.inf)
        if not 0 < number(near_clip, "near_clip") < number(far_clip, "far_clip"):
            raise GeometryError.expected(
                "near_clip, far_clip", "0 < near_clip < far_clip", f"{near_clip}, {far_clip}"
            )
        self.to_world = m
        self.x_fov = horizontal_fov(fov, fov_axis, film)
        self.film_size, self.crop_offset, self.crop_size = film, offset, crop
        focal = film[0] / (2 * np.tan(np.radians(self.x_fov) / 2))
        x, y = film / 2 - shift * film - offset
        depth = far_clip / (far_clip - near_clip)
        sample = np.array(
            [[-focal, 0, x, 0], [0, -focal, y, 0], [0, 0, depth, -near_clip * depth], [0, 0, 1, 0]]
        )
        self.matrix = sample @ np.linalg.inv(m)
        self.image_matrix = self.matrix[[0, 1, 3]]
        for a in (self.to_world, self.matrix, self.image_matrix):
            a.setflags(write=False)

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any], prefix: str = "") -> Camera:
        """Return the camera of a Mitsuba sensor from its parameters.

        Parameters
        ----------
        values : mapping
            ``mi.traverse(sensor)``, or ``mi.traverse(scene)`` with the sensor's id and a dot
            as `prefix`. Only ``x_fov``, ``film.*`` and the like are read, and ``to_world``
            through its ``matrix``; nothing of Mitsuba is imported. Float32 values are taken
            as they are, so that the map is that of the sensor and not of its description.
        prefix : str
            Put before each key.

        Raises
        ------
        GeometryError
            If a key is missing: not a `perspective` sensor, nor a `thinlens` one, whose map
            through the centre of the lens is the same.
        """

        def get(key: str, shape: tuple[int, ...] = (), default: float | None = None) -> np.ndarray:
            value = values.get(prefix + key, default)
            if value is None:
                raise GeometryError.expected(
                    "values", "the parameters of a perspective sensor", f"no {prefix + key!r}"
                )
            if shape == (4, 4):
                value = getattr(value, "matrix", value)
            # a JIT variant adds an axis of length 1
            return np.asarray(value, dtype=np.float64).reshape(shape)

        return cls(
            get("to_world", (4, 4)),
            float(get("x_fov")),
            "x",
            get("film.size", (2,)),
            get("film.crop_offset", (2,)),
            get("film.crop_size", (2,)),
            [float(get(f"principal_point_offset_{c}", default=0.0)) for c in "xy"],
            float(get("near_clip")),
            float(get("far_clip")),
        )

    @property
    def center(self) -> np.ndarray:
        """The eye point, homogeneous ``(4,)``."""
        return self.to_world[:, 3]

    def image(self, points: Any) -> np.ndarray:
        """Return homogeneous pixels ``(..., 3)`` of homogeneous points ``(..., 4)``.

        The last coordinate is positive for points of positive weight in front of the camera,
        negative behind, 0 in the plane through the eye that has no image in the film.

        Raises
        ------
        GeometryError
            If a point is the eye itself, or no point.

        Examples
        --------
        >>> from mitsuba_bezier.geometry.camera import look_at
        >>> camera = mb.Camera(look_at([0, 0, 0], [0, 0, 1]), fov=90, film_size=(200, 100))
        >>> camera.image([0, 0, 2, 1]).round(9).tolist()
        [200.0, 100.0, 2.0]
        """
        p = elements("points", points, (4,))
        out = p @ self.image_matrix.T
        if (norm(out) <= TOLERANCE * np.abs(self.image_matrix).max() * norm(p)).any():
            raise GeometryError.expected("points", "points other than the eye", "the eye")
        return out

    def pixels(self, points: Any) -> np.ndarray:
        """Return pixels ``(..., 2)`` of Euclidean points ``(..., 3)`` in front of the camera.

        Raises
        ------
        GeometryError
            If a point is not in front of the camera.

        Examples
        --------
        >>> from mitsuba_bezier.geometry.camera import look_at
        >>> camera = mb.Camera(look_at([0, 0, 0], [0, 0, 1]), fov=90, film_size=(200, 100))
        >>> camera.pixels([0.5, 0, 1]).round(9).tolist()  # +x is to the left
        [50.0, 50.0]
        """
        x = numbers(points, "points")
        if x.ndim == 0 or x.shape[-1] != 3:
            raise GeometryError.expected("points", "three coordinates a point", f"shape {x.shape}")
        image = self.image(point(x))
        if (image[..., 2] <= 0).any():
            raise GeometryError.expected(
                "points", "points in front of the camera", "one beside or behind it"
            )
        return image[..., :2] / image[..., 2:]

    def vanishing_point(self, direction: Any) -> np.ndarray:
        """Return the vanishing point ``(..., 3)`` of directions ``(..., 3)``, homogeneous.

        It is an ideal point of the image for directions parallel to the image plane, and has
        a negative last coordinate for directions that lead away behind the camera.

        Examples
        --------
        >>> from mitsuba_bezier.geometry.camera import look_at
        >>> camera = mb.Camera(look_at([0, 0, 0], [0, 0, 1]), fov=90, film_size=(200, 100))
        >>> u, v, w = camera.vanishing_point([0, 0, 1])
        >>> (u / w).round(9).item(), (v / w).round(9).item()
        (100.0, 50.0)
        """
        return self.image(ideal(elements("direction", direction, (3,))))

    def horizon(self, plane: Any) -> np.ndarray:
        """Return the horizon ``(..., 3)`` of planes ``(..., 4)``, a line of the image.

        It holds the vanishing points of all directions in the plane. ``horizon . (x, y, 1)`` is
        ``n . d`` for the direction d in which pixel (x, y) looks, of depth 1: positive on the
        side where rays leave the plane towards its normal.

        Raises
        ------
        GeometryError
            If a plane is the plane at infinity.

        Examples
        --------
        >>> from mitsuba_bezier.geometry.camera import look_at
        >>> camera = mb.Camera(look_at([0, 0, 0], [0, 0, 1]), fov=90, film_size=(200, 100))
        >>> a, b, c = camera.horizon([0, 1, 0, 1])  # of the plane y = -1
        >>> (-c / b).round(9).item()  # the row of pixels in the middle
        50.0
        """
        e = elements("plane", plane, (4,))
        if (norm(e[..., :3]) <= TOLERANCE * norm(e)).any():
            raise GeometryError.expected("plane", "a plane other than that at infinity", "that one")
        return e[..., :3] @ np.linalg.inv(self.image_matrix[:, :3])

    def direction(self, pixel: Any) -> np.ndarray:
        """Return the direction ``(..., 3)`` of depth 1 in which pixels ``(..., 2)`` look.

        Examples
        --------
        >>> from mitsuba_bezier.geometry.camera import look_at
        >>> camera = mb.Camera(look_at([0, 0, 0], [0, 0, 1]), fov=90, film_size=(200, 100))
        >>> camera.direction([50, 50]).round(9).tolist()
        [0.5, 0.0, 1.0]
        """
        x = numbers(pixel, "pixel")
        if x.ndim == 0 or x.shape[-1] != 2:
            raise GeometryError.expected("pixel", "two numbers a pixel", f"shape {x.shape}")
        return point(x) @ np.linalg.inv(self.image_matrix[:, :3]).T
