"""Focus a lens at a distance, and stop it down."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import PrescriptionError
from .lens import Lens
from .paraxial import first_order


def focused(lens: Lens, distance: float) -> Lens:
    """Return the lens with its image plane moved to where a plane at `distance` is in focus.

    What a design has its image plane off the paraxial one, to balance aberrations, stays.

    Parameters
    ----------
    lens : Lens
        The lens.
    distance : float
        From the first vertex, in the lens's unit; infinity is allowed.

    Raises
    ------
    PrescriptionError
        If the distance is within the focal length: such a plane has no real image.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, focused
    >>> ball = Lens([Surface(1 / 10, 20, Constant(1.5)), Surface(-1 / 10, 5)])  # focal length 15
    >>> round(focused(ball, 20).surfaces[-1].thickness, 9)  # 2 f from the centre on both sides
    20.0
    """
    last = lens.surfaces[-1]
    design = first_order(lens).image
    offset = last.thickness - design if np.isfinite(design) else 0.0
    image = first_order(replace(lens, object_distance=float(distance))).image
    thickness = image + offset
    if not (np.isfinite(thickness) and thickness > 0):
        raise PrescriptionError(
            f"focus_distance: expected more than the front focal length, got {distance:g} "
            f"{lens.unit}"
        )
    surfaces = [*lens.surfaces[:-1], replace(last, thickness=thickness)]
    return replace(lens, surfaces=surfaces, object_distance=float(distance))


def stopped_down(lens: Lens, f_number: float) -> Lens:
    """Return the lens with its stop at an f-number.

    Raises
    ------
    PrescriptionError
        If no surface is marked as the stop, or the f-number is below 0.5.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, stopped_down
    >>> thin = Lens([Surface(1 / 50, 0, Constant(1.5), stop=True), Surface(-1 / 50, 50)])
    >>> round(stopped_down(thin, 5).surfaces[0].semi_diameter, 9)  # 50 / (2 * 5)
    5.0
    """
    if not any(s.stop for s in lens.surfaces):
        raise PrescriptionError("stop: expected a surface that is the stop, got none")
    if not 0 < f_number < np.inf:
        raise PrescriptionError(f"f_number: expected a positive number, got {f_number}")
    if f_number < 0.5:  # light would have to come from behind the film
        raise PrescriptionError.expected("f_number", "at least 0.5, as lenses in air", f_number)
    size = first_order(replace(lens, aperture=("f_number", f_number))).stop_semi_diameter
    surfaces = [replace(s, semi_diameter=size) if s.stop else s for s in lens.surfaces]
    return replace(lens, surfaces=surfaces, aperture=("f_number", f_number))
