"""A lens run backwards, from the film to the scene, and the pupil that film points see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import PrescriptionError
from .lens import Lens
from .paraxial import first_order
from .trace import trace

#: Film radii at which the pupil is bounded, and points across it at each.
_RADII, _ACROSS = 24, 48
#: Bounds are this much wider, in steps of the points that found them.
_MARGIN = 1.5


def backwards(lens: Lens) -> Lens:
    """Return the lens as light from the film meets it: turned round, with z towards the scene.

    Raises
    ------
    PrescriptionError
        If surfaces are tilted or mirrors: a lens with these has no axis that this could use.
    """
    for i, s in enumerate(lens.surfaces, start=1):
        if s.mirror or not (np.allclose(s.before, np.eye(4)) and np.allclose(s.after, np.eye(4))):
            raise PrescriptionError(
                f"surface {i}: expected refracting surfaces on one axis, got a mirror or a tilt"
            )
    media = lens.media()
    surfaces = []
    for i in reversed(range(len(lens.surfaces))):
        s = lens.surfaces[i]
        surfaces.append(
            replace(
                s,
                curvature=-s.curvature,
                coefficients=tuple(-a for a in s.coefficients),
                medium=media[i],
                thickness=lens.surfaces[i - 1].thickness if i else 0.0,
            )
        )
    return replace(
        lens,
        surfaces=surfaces,
        object_distance=np.inf,
        fields=((0.0, 0.0),),
        vignetting=None,
        aperture=("stop", 0.0),
        field_kind="angle",
        object_medium=media[-1],
    )


def pupil_bounds(back: Lens, distance: float, reach: float, wavelength: float) -> np.ndarray:
    """Bound the part of the rear vertex plane through which light reaches points of the film.

    Parameters
    ----------
    back : Lens
        A lens `backwards`.
    distance : float
        From the film to its first surface.
    reach : float
        Largest distance of a film point from the axis.
    wavelength : float
        In micrometres.

    Returns
    -------
    ndarray
        ``(R, 4)`` x and y from, x and y to, for film points (r, 0) at equal steps of r from 0 to
        `reach`; zeros where no light arrives.

    Raises
    ------
    PrescriptionError
        If no ray through the lens reaches the middle of the film.
    """
    size = back.surfaces[0].semi_diameter
    data = first_order(back, wavelength)
    # the paraxial pupil, as the film sees it on the rear plane
    shrink = distance / (distance + data.entrance_pupil)
    half = abs(0.5 * data.entrance_diameter * shrink)
    steps = (np.arange(_ACROSS) + 0.5) / _ACROSS * 2 - 1
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))

    def found(r: float, low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
        """Return the box of the points of a grid through which light arrives, a step wider."""
        middle, extent = (low + high) / 2, (high - low) / 2
        o = np.tile([r, 0.0, -distance], (len(x), 1))
        target = np.stack([middle[0] + extent[0] * x, middle[1] + extent[1] * y, 0 * x], axis=1)
        ok = trace(back, o, target - o, wavelength).valid
        if not ok.any():
            return None
        step = _MARGIN * 2 * extent / _ACROSS
        reached = target[ok][:, :2]
        return np.array([reached.min(axis=0) - step, reached.max(axis=0) + step])

    bounds = np.zeros((_RADII, 4))
    for i, r in enumerate(np.linspace(0, reach, _RADII)):
        # real pupils wander from the paraxial one: a wide look first, then a close one
        wide = np.array([1.6 * half + 0.02 * size, 1.6 * half + 0.02 * size])
        middle = np.array([r * (1 - shrink), 0.0])
        box = found(r, middle - wide, middle + wide)
        if box is None or (np.abs(box - middle) > wide).any():  # it is cut off by the look
            box = found(r, np.array([-size, -size]), np.array([size, size]))
        if box is not None:
            box = found(r, *box)
        if box is not None:
            bounds[i] = box.ravel()
    if not bounds[0].any():
        raise PrescriptionError("lens: expected one through which light reaches the film")
    # between two radii the pupil may reach as far as at either
    wide = bounds.copy()
    for j, pick in ((0, np.minimum), (1, np.minimum), (2, np.maximum), (3, np.maximum)):
        wide[:-1, j] = pick(bounds[:-1, j], bounds[1:, j])
        wide[1:, j] = pick(wide[1:, j], bounds[:-1, j])
    return wide
