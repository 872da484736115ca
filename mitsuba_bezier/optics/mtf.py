"""Modulation transfer from rays, and how sharp a lens is in front of its image plane and behind it.

The geometric transfer function is the Fourier transform of the spot (Smith, *Modern Optical
Engineering*, 3rd edition, section 11.9). It leaves diffraction out: where a lens is nearly
perfect, the diffraction-limited curve beside it is what can be reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import PrescriptionError
from .beams import beam
from .checks import check_field
from .lens import Lens
from .paraxial import first_order
from .trace import trace

#: Rings and spokes of rays in the pupil; a spot without vignetting is then exact to some 1e-9.
RINGS, SPOKES = 32, 72


@dataclass(frozen=True)
class Modulation:
    """Contrast of a sine wave in the image, by its frequency.

    Attributes
    ----------
    frequencies : ndarray
        Periods in a unit of length of the lens.
    tangential, sagittal : ndarray
        Of waves along the field's direction from the axis, and across it.
    diffraction : ndarray
        Of a perfect lens with the same working f-number, on the axis.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, mtf
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1, semi_diameter=12.5)])
    >>> found = mtf(mirror, frequencies=[0, 50])  # a perfect image: only diffraction is left
    >>> [round(float(x), 6) for x in (found.tangential[1], found.sagittal[1], found.diffraction[0])]
    [1.0, 1.0, 1.0]
    """

    frequencies: np.ndarray
    tangential: np.ndarray
    sagittal: np.ndarray
    diffraction: np.ndarray


@dataclass(frozen=True)
class Arrivals:
    """Rays of a field point at the image plane.

    Attributes
    ----------
    points, slopes : ndarray
        ``(N, 2)`` where they meet it, and dx/dz, dy/dz, along the field's direction from the axis
        and across it.
    weights : ndarray
        ``(N,)`` shares of the light, whose sum is 1: by area of the stop and by wavelength.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, arrivals
    >>> mirror = Lens([Surface(-1 / 200, -101, mirror=True, conic=-1, semi_diameter=25)])
    >>> found = arrivals(mirror)  # a paraboloid: its focus is 1 mm closer to it
    >>> round(found.best(), 9), round(found.rms(1.0), 9)
    (1.0, 0.0)
    """

    points: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray

    def moved(self, defocus: float) -> np.ndarray:
        """Return the points on a plane `defocus` behind the image plane."""
        return self.points + defocus * self.slopes

    def centred(self, defocus: float = 0.0) -> np.ndarray:
        """Return the points there from their centroid."""
        p = self.moved(defocus)
        return p - self.weights @ p

    def rms(self, defocus: float = 0.0) -> float:
        """Return the spot's radius there: root mean square about its centroid."""
        p = self.centred(defocus)
        return float(np.sqrt(self.weights @ (p**2).sum(axis=1)))

    def best(self) -> float:
        """Return the defocus at which the spot is smallest; 0 for parallel rays."""
        p = self.centred()
        m = self.slopes - self.weights @ self.slopes
        spread = self.weights @ (m**2).sum(axis=1)
        return float(-(self.weights @ (p * m).sum(axis=1)) / spread) if spread > 0 else 0.0


def pupil_quadrature(rings: int = RINGS, spokes: int = SPOKES) -> tuple[np.ndarray, np.ndarray]:
    """Return points ``(N, 2)`` of the unit disk and weights ``(N,)``, whose sum is 1.

    Gauss and Legendre's rule in r^2, equal steps in the angle.
    """
    x, w = np.polynomial.legendre.leggauss(rings)
    r = np.sqrt((x + 1) / 2)
    turn = np.arange(rings)[:, None] * (0.5 * (np.sqrt(5) - 1))
    angle = 2 * np.pi * (np.arange(spokes) + turn % 1) / spokes
    points = np.stack([r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)], axis=-1)
    return points.reshape(-1, 2), np.repeat(w / (2 * spokes), spokes)


def field_axes(field: np.ndarray) -> np.ndarray:
    """Return unit vectors ``(2, 2)`` from the axis to a field, y for the one on it, and across."""
    length = np.hypot(*field)
    x, y = field / length if length else (0.0, 1.0)
    return np.array([[x, y], [y, -x]])


def arrivals(
    lens: Lens,
    field: tuple[float, float] = (0.0, 0.0),
    wavelength: float | None = None,
    pupil: tuple[np.ndarray, np.ndarray] | None = None,
    aim: bool = True,
) -> Arrivals:
    """Return the rays of a field point at the image plane.

    Parameters
    ----------
    lens : Lens
        The lens.
    field : (float, float)
        As those of `beam`.
    wavelength : float, optional
        In micrometres; all of the lens, by their weights, by default.
    pupil : (ndarray, ndarray), optional
        Points of the stop and their weights; `pupil_quadrature` by default.
    aim : bool
        Whether they are points of the real stop, or of the paraxial entrance pupil.

    Raises
    ------
    PrescriptionError
        If no ray arrives.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, arrivals
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, conic=-1, semi_diameter=25)])
    >>> bool(abs(arrivals(mirror).points).max() < 1e-9)  # a paraboloid: all rays meet
    True
    """
    points, areas = pupil_quadrature() if pupil is None else pupil
    given = lens.spectrum() if wavelength is None else [(wavelength, 1.0)]
    turn = field_axes(check_field(lens, field)).T
    frame = lens.frames()[-1][:3, :3]
    found = []
    for w, weight in given:
        result = trace(lens, *beam(lens, field, points, w, aim), w)
        ok = result.valid
        d = (result.directions[-1] @ frame)[ok]
        at = result.local[-1][ok][:, :2]
        found.append((at @ turn, d[:, :2] / d[:, 2:] @ turn, weight * areas[ok]))
    p, m, shares = (np.concatenate(parts) for parts in zip(*found))
    if not shares.sum() > 0:
        raise PrescriptionError(f"field: expected one from which rays arrive, got {tuple(field)}")
    return Arrivals(p, m, shares / shares.sum())


def diffraction_limit(
    lens: Lens, frequencies: np.ndarray, wavelength: float | None = None
) -> np.ndarray:
    """Return the contrast that a perfect lens with this lens's working f-number has on the axis.

    ``2 / pi (acos x - x sqrt(1 - x^2))`` with x the frequency over ``1 / (wavelength N)``.

    Raises
    ------
    PrescriptionError
        If the lens has no working f-number, because it forms no image.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, diffraction_limit
    >>> mirror = Lens([Surface(-1 / 200, -100, mirror=True, semi_diameter=12.5)])  # f/4
    >>> diffraction_limit(mirror, [0, 250, 500], 0.5).round(6).tolist()  # 500 = 1 / (0.0005 * 4)
    [1.0, 0.391002, 0.0]
    """
    out = np.zeros(len(frequencies))
    for w, weight in lens.spectrum() if wavelength is None else [(wavelength, 1.0)]:
        x = np.clip(np.asarray(frequencies, float) / _cutoff(lens, w), 0.0, 1.0)
        out += weight * 2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x * x))
    return out


def _cutoff(lens: Lens, wavelength: float) -> float:
    """Return the frequency at which a perfect lens has no contrast."""
    number = first_order(lens, wavelength).working_f_number
    if not 0 < number < np.inf:
        raise PrescriptionError.expected("lens", "one that forms an image", "an afocal one")
    return lens.millimetres / (1e-3 * wavelength * number)


def transfer(rays: Arrivals, frequencies: np.ndarray, defocus: float = 0.0) -> np.ndarray:
    """Return the contrast ``(2, F)``, tangential and sagittal, of rays on a plane."""
    p = rays.centred(defocus)  # small phases
    # as many frequencies at a time as take some 50 MB
    step = max(1, 1_500_000 // len(p))
    out = [
        np.abs(np.tensordot(rays.weights, np.exp(-2j * np.pi * p[..., None] * f), 1))
        for f in np.split(frequencies, range(step, len(frequencies), step))
    ]
    return np.concatenate(out, axis=1)


def mtf(
    lens: Lens,
    field: tuple[float, float] = (0.0, 0.0),
    frequencies: Sequence[float] | np.ndarray | None = None,
    wavelength: float | None = None,
    defocus: float = 0.0,
) -> Modulation:
    """Return the geometric modulation transfer function of a field point.

    Parameters
    ----------
    lens : Lens
        The lens.
    field : (float, float)
        As those of `beam`.
    frequencies : sequence of float, optional
        Periods in a unit of length; 101 from 0 to `highest_frequency` by default.
    wavelength : float, optional
        In micrometres; all of the lens, by their weights, by default.
    defocus : float
        How far behind the image plane.

    Returns
    -------
    Modulation

    Raises
    ------
    PrescriptionError
        If no ray arrives, the lens is afocal, or a frequency is negative.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, mtf
    >>> lens = Lens([Surface(1 / 50, 4, Constant(1.5), 8), Surface(-1 / 50, 47, semi_diameter=8)])
    >>> curve = mtf(lens, frequencies=[0, 2, 4])
    >>> curve.tangential.round(3).tolist()
    [1.0, 0.52, 0.123]
    """
    rays = arrivals(lens, field, wavelength)
    if frequencies is None:
        frequencies = np.linspace(0, highest_frequency(lens, [rays]), 101)
    f = np.asarray(frequencies, float)
    if f.ndim != 1 or not len(f) or not (np.isfinite(f).all() and (f >= 0).all()):
        raise PrescriptionError.expected("frequencies", "numbers from 0 on", frequencies)
    if not np.isfinite(defocus):
        raise PrescriptionError.expected("defocus", "a finite length", defocus)
    limit = diffraction_limit(lens, f, wavelength)
    tangential, sagittal = transfer(rays, f, defocus)
    return Modulation(f, tangential, sagittal, limit)


def highest_frequency(lens: Lens, beams: Sequence[Arrivals]) -> float:
    """Return a round frequency at which the sharpest of the beams has lost nearly all contrast.

    At most where diffraction ends it.
    """
    cutoff = max(_cutoff(lens, w) for w, _ in lens.spectrum())
    least = min(rays.rms() for rays in beams)
    wanted = min(cutoff, 0.5 / max(least, 1e-300))
    power = 10 ** np.floor(np.log10(wanted))
    return float(next(n * power for n in (1, 2, 3, 5, 8, 10) if n * power >= wanted * 0.999))
