"""Where narrow beams of a field point come to their two foci: field curvature and astigmatism."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import PrescriptionError
from .beams import beam
from .lens import Lens
from .mtf import field_axes
from .trace import trace

#: How far from the chief ray the rays beside it pass the stop, in its radii: they meet where
#: Coddington's equations say, to the square of this; rounding is some 1e-15 over it.
_BESIDE = 1e-4


@dataclass(frozen=True)
class Foci:
    """Foci of narrow beams around chief rays.

    Attributes
    ----------
    fields : ndarray
        ``(N, 2)`` the field points.
    tangential, sagittal : ndarray
        ``(N,)`` how far behind the image plane, along its normal, rays meet that lie in the plane
        of axis and field, and those across it. NaN where the chief ray is lost.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, field_curvature
    >>> sphere = Lens([Surface(thickness=200, stop=True, semi_diameter=5),
    ...                Surface(-1 / 200, -100, mirror=True)])
    >>> foci = field_curvature(sphere, [(0, 60)])  # a stop at the centre: foci are 100 from there
    >>> round(float(foci.sagittal[0]), 6)  # 100 cos 60 - 100
    -50.0
    """

    fields: np.ndarray
    tangential: np.ndarray
    sagittal: np.ndarray


def field_scan(lens: Lens, count: int = 33) -> np.ndarray:
    """Return field points ``(count, 2)`` from the axis to the lens's farthest field.

    Raises
    ------
    PrescriptionError
        If the lens has no field off its axis.
    """
    farthest = lens.farthest_field()
    if not np.hypot(*farthest) > 0:
        raise PrescriptionError.expected("fields", "one off the axis at least", list(lens.fields))
    return np.linspace(0, 1, count)[:, None] * np.array(farthest)


def field_curvature(
    lens: Lens,
    fields: Sequence[tuple[float, float]] | np.ndarray | None = None,
    wavelength: float | None = None,
    aim: bool = True,
) -> Foci:
    """Return the tangential and sagittal foci of field points.

    Rays close to the chief ray, through the whole lens, meet where Coddington's equations say.

    Parameters
    ----------
    lens : Lens
        The lens.
    fields : sequence of (float, float), optional
        As those of `beam`; steps from the axis to the lens's farthest field by default.
    wavelength : float, optional
        In micrometres; the reference wavelength by default.
    aim : bool
        Whether chief rays go through the middle of the real stop, or of the paraxial pupil.

    Returns
    -------
    Foci

    Raises
    ------
    PrescriptionError
        If the lens has no field off its axis, and none is given.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, field_curvature
    >>> sphere = Lens([Surface(thickness=200, stop=True, semi_diameter=5),
    ...                Surface(-1 / 200, -100, mirror=True)])
    >>> foci = field_curvature(sphere, [(0, 3)])  # a stop at the centre: the image is a sphere
    >>> bool(abs(foci.tangential[0] - foci.sagittal[0]) < 1e-6)
    True
    """
    points = field_scan(lens) if fields is None else np.asarray(fields, float)
    if points.ndim != 2 or points.shape[1:] != (2,) or not np.isfinite(points).all():
        raise PrescriptionError.expected("fields", "finite pairs (N, 2)", points.shape)
    frame = lens.frames()[-1][:3, :3]
    found = np.full((len(points), 2), np.nan)
    for row, field in zip(found, points):
        sides = field_axes(field)
        rays = beam(lens, tuple(field), _BESIDE * np.array([*sides, *-sides]), wavelength, aim)
        result = trace(lens, *rays, wavelength, False)
        d = result.directions[-1] @ frame
        p, m = result.local[-1][:, :2], d[:, :2] / d[:, 2:]
        apart, spread = (np.sum((v[:2] - v[2:]) * sides, axis=1) for v in (p, m))
        with np.errstate(divide="ignore", invalid="ignore"):
            row[:] = -apart / spread
    return Foci(points, *found.T)
