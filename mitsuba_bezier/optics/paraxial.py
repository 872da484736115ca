"""First-order optics: focal length, pupils, principal planes, by the paraxial ray trace.

Surfaces are taken as if they stood on one axis: tilts and decentrations have no first order here.
Indices are negative where light runs against the axis, so that mirrors need no case of their own
(Welford, *Aberrations of Optical Systems*, 1986, chapter 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import PrescriptionError
from .lens import Lens


@dataclass(frozen=True)
class FirstOrder:
    """First-order data of a lens at one wavelength.

    Lengths are in the lens's unit. Places before the lens are measured from the first vertex,
    places behind it from the last; both are positive along the axis. Afocal systems have infinite
    values. A focal length is positive if the lens converges, also if it has mirrors.

    Attributes
    ----------
    wavelength : float
        In micrometres.
    focal_length : float
        Effective focal length, 1 / power, in the image space's medium.
    front_focus, back_focus : float
        Focal points.
    front_principal, back_principal : float
        Principal points.
    image : float
        Where the axial object point is imaged.
    magnification : float
        Of the object at its distance; 0 for a distant one.
    entrance_pupil, exit_pupil : float
        Where the pupils stand; from the first and the last vertex.
    entrance_diameter, exit_diameter : float
        Their diameters; NaN if neither an aperture nor a stop of finite size is given.
    stop_semi_diameter : float
        Half the size of the stop that the aperture asks for.
    f_number : float
        Image-space f-number, of an axial beam from the object's distance as a thin pencil:
        focal length over entrance pupil diameter.
    working_f_number : float
        ``1 / (2 n' |u'|)`` of the marginal ray.
    petzval : float
        Radius of the Petzval surface.
    length : float
        From the first vertex to the last.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, first_order
    >>> ball = first_order(Lens([Surface(1 / 10, 20, Constant(1.5)), Surface(-1 / 10, 5)]))
    >>> round(ball.focal_length, 9), round(ball.back_focus, 9)  # n R / (2 (n - 1)), less R
    (15.0, 5.0)
    """

    wavelength: float
    focal_length: float
    front_focus: float
    back_focus: float
    front_principal: float
    back_principal: float
    image: float
    magnification: float
    entrance_pupil: float
    exit_pupil: float
    entrance_diameter: float
    exit_diameter: float
    stop_semi_diameter: float
    f_number: float
    working_f_number: float
    petzval: float
    length: float


def matrices(lens: Lens, wavelength: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return what the lens does to paraxial rays ``(y, n u)`` up to behind each surface.

    Returns
    -------
    systems : ndarray
        ``(S, 2, 2)`` from just before the first surface to just behind each.
    indices : ndarray
        ``(S + 1,)`` signed indices.
    """
    w = lens.wavelengths[lens.reference] if wavelength is None else wavelength
    n = lens.indices(w) * lens.directions()
    system = np.eye(2)
    systems = []
    for i, s in enumerate(lens.surfaces):
        if i:
            step = lens.surfaces[i - 1].thickness / n[i]
            system = np.array([[1, step], [0, 1]]) @ system
        power = (n[i + 1] - n[i]) * s.vertex_curvature
        system = np.array([[1, 0], [-power, 1]]) @ system
        systems.append(system)
    return np.array(systems), n


def trace_paraxial(
    lens: Lens, height: float, angle: float, wavelength: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return heights ``(S,)`` on the surfaces and slopes ``(S + 1,)`` before and behind each.

    Parameters
    ----------
    lens : Lens
        The lens.
    height, angle : float
        Height on the first vertex's plane and slope before it.
    wavelength : float, optional
        In micrometres; the reference wavelength by default.
    """
    systems, n = matrices(lens, wavelength)
    rays = systems @ np.array([height, n[0] * angle])
    return rays[:, 0], np.concatenate([[angle], rays[:, 1] / n[1:]])


def first_order(lens: Lens, wavelength: float | None = None) -> FirstOrder:
    """Return first-order data of a lens.

    Parameters
    ----------
    lens : Lens
        The lens.
    wavelength : float, optional
        In micrometres; the reference wavelength by default.

    Returns
    -------
    FirstOrder

    Examples
    --------
    >>> from mitsuba_bezier.optics import Abbe, Lens, Surface, first_order
    >>> thin = Lens([Surface(1 / 50, 0, Abbe(1.5, 60)), Surface(-1 / 50, 50)])
    >>> round(first_order(thin).focal_length, 9)  # 1 / ((n - 1) (c - c'))
    50.0
    >>> red, blue = (first_order(thin, w).focal_length for w in (0.6562725, 0.4861327))
    >>> round(1 / (50 / blue - 50 / red), 6)  # V_d
    60.0
    """
    w = float(lens.wavelengths[lens.reference] if wavelength is None else wavelength)
    systems, n = matrices(lens, w)
    (a, _b), (c, d) = systems[-1]
    n0, n1 = n[0], n[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        focal = np.divide(-n1, c) * np.sign(n1)  # the sign of power does not depend on mirrors
        back_focus = np.divide(-a * n1, c)
        front_focus = np.divide(d * n0, c)
        back_principal = np.divide(n1 * (1 - a), c)
        front_principal = np.divide(n0 * (d - 1), c)
        if np.isfinite(lens.object_distance):
            # an axial point: y = 0 at -object_distance
            y, v = systems[-1] @ np.array([lens.object_distance, n0])
            image = np.divide(-y * n1, v)
            magnification = np.divide(n0, v)
        else:
            image, magnification = back_focus, 0.0

        # the stop, seen from either side
        i = lens.stop
        before = _up_to(lens, systems, n, i)
        entrance = np.divide(before[0, 1] * n0, before[0, 0])
        behind = systems[-1] @ np.linalg.inv(systems[i])
        exit_ = np.divide(-behind[0, 1] * n1, behind[1, 1])

        diameter, stop_size = _beam(lens, n[0], before, entrance, focal)
        exit_diameter = np.abs(2 * stop_size * (behind[0, 0] + behind[1, 0] * exit_ / n1))
        f_number = np.abs(np.divide(focal, diameter))
        if np.isfinite(lens.object_distance):
            u = diameter / 2 / (lens.object_distance + entrance)
            last = systems[-1] @ np.array([u * lens.object_distance, n0 * u])
        else:
            last = systems[-1] @ np.array([diameter / 2, 0.0])
        working = np.abs(np.divide(1, 2 * last[1]))
        curvature = sum(
            (n[j + 1] - n[j]) * s.vertex_curvature / (n[j] * n[j + 1])
            for j, s in enumerate(lens.surfaces)
        )
        petzval = np.divide(-1.0, n1 * curvature)
    return FirstOrder(
        wavelength=w,
        focal_length=float(focal),
        front_focus=float(front_focus),
        back_focus=float(back_focus),
        front_principal=float(front_principal),
        back_principal=float(back_principal),
        image=float(image),
        magnification=float(magnification),
        entrance_pupil=float(entrance),
        exit_pupil=float(exit_),
        entrance_diameter=float(diameter),
        exit_diameter=float(exit_diameter),
        stop_semi_diameter=float(stop_size),
        f_number=float(f_number),
        working_f_number=float(working),
        petzval=float(petzval),
        length=float(sum(s.thickness for s in lens.surfaces[:-1])),
    )


def _up_to(lens: Lens, systems: np.ndarray, n: np.ndarray, i: int) -> np.ndarray:
    """Return the system from the first vertex to just before surface `i`."""
    if not i:
        return np.eye(2)
    step = lens.surfaces[i - 1].thickness / n[i]
    return np.array([[1, step], [0, 1]]) @ systems[i - 1]


def _beam(
    lens: Lens, first: float, before: np.ndarray, entrance: float, focal: float
) -> tuple[float, float]:
    """Return the entrance pupil's diameter and half the size of the stop."""
    # heights at the stop over those in the pupil
    magnified = before[0, 0] if before[0, 0] else np.nan
    kind, value = lens.aperture or ("stop", 0.0)
    if kind == "stop":
        size = value if value > 0 else lens.surfaces[lens.stop].semi_diameter
        if not np.isfinite(size):
            return np.nan, np.nan
        return abs(2 * size / magnified), size
    if kind == "diameter":
        diameter = value
    elif kind == "f_number":
        diameter = abs(focal / value)
    else:  # object-space numerical aperture
        if not np.isfinite(lens.object_distance):
            raise PrescriptionError.expected(
                "aperture object_na", "an object at a finite distance", "one at infinity"
            )
        sine = value / abs(first)
        if not 0 < sine < 1:
            raise PrescriptionError.expected("aperture object_na", "a number below n", value)
        slope = sine / np.sqrt(1 - sine * sine)
        diameter = 2 * slope * (lens.object_distance + entrance)
    return diameter, abs(diameter / 2 * magnified)
