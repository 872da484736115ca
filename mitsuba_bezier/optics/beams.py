"""Beams of a lens: the rays from a field point through the stop, and the spots that they make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import PrescriptionError
from .checks import check_field
from .lens import Lens
from .paraxial import first_order, trace_paraxial
from .trace import trace

#: Newton steps to the aimed point of the stop; a pupil's aberrations need three to six.
_AIM_STEPS = 12


@dataclass(frozen=True)
class Spot:
    """Where a beam meets the image plane.

    Attributes
    ----------
    points : ndarray
        ``(N, 2)`` x and y in the image's frame, of the rays that arrive.
    centroid : ndarray
        ``(2,)`` their mean.
    rms, radius : float
        Root mean square, and largest, distance from the centroid.
    transmitted : float
        Share of the rays that arrive.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, spot
    >>> mirror = Surface(-1 / 200, -101, mirror=True, conic=-1, semi_diameter=25)
    >>> found = spot(Lens([mirror], aperture=("diameter", 40)))  # a paraboloid, focus 1 mm before
    >>> round(found.radius, 9) == round(20 / 99, 9)  # the ray at 20 mm has 99 mm to go
    True
    """

    points: np.ndarray
    centroid: np.ndarray
    rms: float
    radius: float
    transmitted: float


def pupil_grid(rings: int = 6) -> np.ndarray:
    """Return points ``(N, 2)`` of the unit disk, hexapolar: 6 i points on ring i.

    Examples
    --------
    >>> from mitsuba_bezier.optics import pupil_grid
    >>> len(pupil_grid(2))  # 1 + 6 + 12
    19
    """
    if not isinstance(rings, (int, np.integer)) or rings < 0:
        raise PrescriptionError.expected("rings", "a whole number from 0 on", repr(rings))
    points = [np.zeros((1, 2))]
    for i in range(1, rings + 1):
        angle = np.arange(6 * i) / (6 * i) * 2 * np.pi
        points.append(i / rings * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(points)


def beam(
    lens: Lens,
    field: tuple[float, float] = (0.0, 0.0),
    pupil: np.ndarray | None = None,
    wavelength: float | None = None,
    aim: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and directions of the rays from a field point.

    Parameters
    ----------
    lens : Lens
        The lens.
    field : (float, float)
        x and y, in the lens's kind of field: degrees, or heights of object or image.
    pupil : ndarray, optional
        ``(N, 2)`` points of the unit disk; `pupil_grid` by default.
    wavelength : float, optional
        In micrometres; the reference wavelength by default.
    aim : bool
        Whether rays are aimed at these points of the real stop. Else they go through those of the
        paraxial entrance pupil.

    Returns
    -------
    origins, directions : ndarray
        ``(N, 3)`` in the frame of the lens, in front of the first surface.

    Raises
    ------
    PrescriptionError
        If the field is none, neither aperture nor stop give the beam a size, the entrance pupil is
        at infinity, or an image height has no object.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, beam
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, semi_diameter=25)])
    >>> origins, directions = beam(mirror, (0, 45))
    >>> directions[0].round(6).tolist()  # a distant object: all rays are parallel
    [0.0, 0.707107, 0.707107]
    """
    at = check_field(lens, field)
    p = pupil_grid() if pupil is None else np.atleast_2d(np.asarray(pupil, float))
    if p.shape[1:] != (2,):
        raise PrescriptionError.expected("pupil", "points (N, 2) of the unit disk", p.shape)
    data = first_order(lens)
    radius, place = data.entrance_diameter / 2, data.entrance_pupil
    if not np.isfinite(radius):
        raise PrescriptionError(
            "aperture: expected a beam diameter, an f-number or a stop with a size, got none"
        )
    if not np.isfinite(place):
        raise PrescriptionError("stop: expected an entrance pupil at a finite place, got infinity")
    p = lens.vignetted(field, p)
    far = not np.isfinite(lens.object_distance)
    if lens.field_kind == "image_height":
        scale = data.focal_length if far else data.magnification
        if not (np.isfinite(scale) and scale):
            raise PrescriptionError("fields: expected image heights of a lens that forms an image")
        at = at / scale  # slopes of a distant object, heights of a near one
    elif lens.field_kind == "angle":
        at = np.tan(np.radians(at))
        if not far:
            at = -(lens.object_distance + place) * at
    front = _front(lens)

    def rays(pupil: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rays through points ``(N, 2)`` of the entrance pupil's plane."""
        through = np.concatenate([pupil, np.full((len(pupil), 1), place)], axis=1)
        if far:
            slope = np.broadcast_to([*at, 1.0], through.shape)
            start = through + slope * (front - place)
        else:
            source = np.array([*at, -lens.object_distance])
            slope = through - source
            slope = slope / slope[:, 2:]
            start = source + slope * max(front + lens.object_distance, 0.0)
        return start, slope / np.linalg.norm(slope, axis=1, keepdims=True)

    wanted = radius * p
    if aim:
        wanted = _aimed(lens, rays, wanted, data.stop_semi_diameter * p, radius, wavelength)
    return rays(wanted)


def _front(lens: Lens) -> float:
    """Return z of a plane in front of all of the first surface."""
    first = lens.surfaces[0]
    r = min(first.semi_diameter, first.reach())
    if not np.isfinite(r):
        return 0.0
    return float(min(np.nanmin(first.sag(np.linspace(0, r * (1 - 1e-12), 17))), 0.0))


def _aimed(
    lens: Lens,
    rays: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    wanted: np.ndarray,
    radius: float,
    wavelength: float | None,
) -> np.ndarray:
    """Return points of the entrance pupil from which rays reach `wanted` on the stop."""

    def miss(at: np.ndarray) -> np.ndarray:
        o, d = rays(at)
        return trace(lens, o, d, wavelength, False).local[lens.stop][:, :2] - wanted

    step = 1e-4 * radius
    along, across = np.array([step, 0.0]), np.array([0.0, step])
    best, error = start, miss(start)
    for _ in range(_AIM_STEPS):
        dx = (miss(best + along) - miss(best - along)) / (2 * step)
        dy = (miss(best + across) - miss(best - across)) / (2 * step)
        det = dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]
        det = np.where(det == 0, np.nan, det)
        x = (dy[:, 1] * error[:, 0] - dy[:, 0] * error[:, 1]) / det
        y = (dx[:, 0] * error[:, 1] - dx[:, 1] * error[:, 0]) / det
        move = np.clip(np.stack([x, y], axis=1), -radius, radius)
        # a ray that gets lost stays where it was: its trace will say so
        trial = np.where(np.isfinite(move), best - move, best)
        after = miss(trial)
        better = np.linalg.norm(after, axis=1) < np.linalg.norm(error, axis=1)
        best = np.where(better[:, None], trial, best)
        error = np.where(better[:, None], after, error)
        if not better.any():
            break
    return best


def spot(
    lens: Lens,
    field: tuple[float, float] = (0.0, 0.0),
    wavelength: float | None = None,
    pupil: np.ndarray | None = None,
    aim: bool = True,
) -> Spot:
    """Return where a beam meets the image plane; parameters as those of `beam`.

    Raises
    ------
    PrescriptionError
        If no ray arrives.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, spot
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1, semi_diameter=25)])
    >>> spot(mirror).rms < 1e-12
    True
    """
    result = trace(lens, *beam(lens, field, pupil, wavelength, aim), wavelength)
    points = result.local[-1][result.valid][:, :2]
    if not len(points):
        raise PrescriptionError(f"field: expected one from which rays arrive, got {tuple(field)}")
    centroid = points.mean(axis=0)
    distance = np.linalg.norm(points - centroid, axis=1)
    return Spot(
        points,
        centroid,
        float(np.sqrt((distance**2).mean())),
        float(distance.max()),
        float(result.valid.mean()),
    )


def used_semi_diameters(lens: Lens) -> np.ndarray:
    """Return the radii ``(S,)`` that the beams of all fields take up on the surfaces.

    Prescriptions often leave them out: a drawing, or a body, needs them.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, used_semi_diameters
    >>> stop = Surface(thickness=100, stop=True, semi_diameter=5)
    >>> lens = Lens([stop, Surface(thickness=-50, mirror=True)], fields=[(0, 45)])
    >>> used_semi_diameters(lens).round(6).tolist()  # the mirror is 100 behind the stop
    [5.0, 105.0]
    """
    radii = np.zeros(len(lens.surfaces))
    angle = np.arange(24) / 24 * 2 * np.pi
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for field in lens.field_points():
        result = trace(lens, *beam(lens, field, rim), vignetting=False)
        r = np.linalg.norm(result.local[:-1, :, :2], axis=2)
        radii = np.maximum(radii, np.where(np.isfinite(r), r, 0.0).max(axis=1))
    return radii


def distortion(lens: Lens, field: tuple[float, float], wavelength: float | None = None) -> float:
    """Return the height of the chief ray on the image over the paraxial one, less 1.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, distortion
    >>> water = Lens([Surface(thickness=10, medium=Constant(2**0.5), semi_diameter=1, stop=True)])
    >>> round(distortion(water, (0, 45)), 6)  # sin 30 = sin 45 / n, so tan 30 / (tan 45 / n) - 1
    -0.183503
    """
    chief = trace(lens, *beam(lens, field, np.zeros((1, 2)), wavelength), wavelength, False)
    real = np.hypot(*chief.local[-1][0, :2])
    data = first_order(lens, wavelength)
    ideal = np.hypot(*field)
    if lens.field_kind == "object_height":
        ideal = abs(ideal * data.magnification)
    elif lens.field_kind == "angle":
        slope = np.hypot(*np.tan(np.radians(field)))
        heights, slopes = trace_paraxial(lens, -slope * data.entrance_pupil, slope, wavelength)
        ideal = abs(heights[-1] + lens.surfaces[-1].thickness * slopes[-1])
    return float(real / ideal - 1) if ideal else 0.0
