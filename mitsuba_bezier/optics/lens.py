"""`Lens` and `Surface`: a prescription, as a sequence of surfaces that light meets in order.

Lengths are in the unit of the prescription (`Lens.unit`, millimetres unless a file says
otherwise), wavelengths in micrometres, angles in degrees. Each surface has a frame of its own: its
vertex is the origin, its axis is z. A positive curvature has its centre at positive z. After a
mirror light runs against the axis, and thicknesses are negative, as in design programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import numpy as np

from ..errors import PrescriptionError
from .checks import UNITS, check_lens, check_wavelength, crossings
from .glass import AIR, Medium


def _identity() -> np.ndarray:
    return np.eye(4)


@dataclass(frozen=True)
class Surface:
    """One surface of a lens, and the medium behind it.

    The sag is that of a conic of revolution and an even polynomial in the distance r from the axis,
    ``z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + a_1 r^2 + a_2 r^4 + ...``
    (Welford, *Aberrations of Optical Systems*, 1986, section 4.8).

    Parameters
    ----------
    curvature : float
        c, the reciprocal of the radius at the vertex; 0 is a plane.
    thickness : float
        Distance along the axis to the vertex of the next surface.
    medium : Medium
        What light runs in behind the surface; a mirror keeps the medium before it.
    semi_diameter : float
        Radius of the clear aperture. Infinite if the prescription has none.
    conic : float
        k: 0 a sphere, -1 a paraboloid, below -1 a hyperboloid, above -1 an ellipsoid.
    coefficients : tuple of float
        ``a_1, a_2, ...``.
    mirror, stop : bool
        Whether the surface reflects; whether it is the aperture stop.
    inner : float
        Radius of a central obstruction.
    before, after : ndarray
        Rigid motions ``(4, 4)``: of the frame before the surface, and behind it.
    label : str
        Comment of the prescription.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Surface
    >>> float(Surface(curvature=0.1, semi_diameter=2).sag(2.0).round(6))
    0.202041
    """

    curvature: float = 0.0
    thickness: float = 0.0
    medium: Medium = AIR
    semi_diameter: float = np.inf
    conic: float = 0.0
    coefficients: tuple[float, ...] = ()
    mirror: bool = False
    stop: bool = False
    inner: float = 0.0
    before: np.ndarray = field(default_factory=_identity)
    after: np.ndarray = field(default_factory=_identity)
    label: str = ""

    @property
    def radius(self) -> float:
        """Radius of curvature at the vertex; infinite for a plane."""
        return 1 / self.curvature if self.curvature else np.inf

    @property
    def vertex_curvature(self) -> float:
        """Curvature at the vertex, with the polynomial's part: what paraxial rays see."""
        return self.curvature + 2 * (self.coefficients[0] if self.coefficients else 0.0)

    @property
    def is_conic(self) -> bool:
        """Whether the surface has no polynomial: then it is a quadric."""
        return not any(self.coefficients)

    def sag(self, r: np.ndarray | float) -> np.ndarray:
        """Return z at distances `r` from the axis; NaN where the conic does not reach."""
        s = np.square(np.asarray(r, float))
        with np.errstate(invalid="ignore"):
            root = np.sqrt(1 - (1 + self.conic) * self.curvature**2 * s)
        z = self.curvature * s / (1 + root)
        for power, a in enumerate(self.coefficients, start=1):
            z = z + a * s**power
        return z

    def slope(self, r: np.ndarray | float) -> np.ndarray:
        """Return ``(dz/dr) / r`` at distances `r` from the axis, which is finite on it."""
        s = np.square(np.asarray(r, float))
        with np.errstate(invalid="ignore"):
            root = np.sqrt(1 - (1 + self.conic) * self.curvature**2 * s)
        slope = self.curvature / root
        for power, a in enumerate(self.coefficients, start=1):
            slope = slope + 2 * power * a * s ** (power - 1)
        return slope

    def reach(self) -> float:
        """Return the largest r at which the conic has a point."""
        k = (1 + self.conic) * self.curvature**2
        return 1 / np.sqrt(k) if k > 0 else np.inf


@dataclass(frozen=True)
class Lens:
    """A lens: surfaces in the order in which light meets them, and how it is used.

    Parameters
    ----------
    surfaces : sequence of Surface
        From the first behind the object to the last before the image. The thickness of the last
        is the distance to the image.
    object_distance : float
        From the object to the first vertex, positive; infinite for a distant object.
    aperture : tuple
        One of ``diameter`` (of the entrance pupil), ``f_number`` (of the image space),
        ``object_na`` (numerical aperture) and ``stop`` (its semi-diameter), and the number.
    wavelengths, weights : sequence of float
        In micrometres, and their weights.
    reference : int
        Index of the reference wavelength.
    field_kind : str
        ``angle``, ``object_height`` or ``image_height``.
    fields : sequence of (float, float)
        x and y of each field: degrees or lengths.
    vignetting : sequence of (float, float, float, float), optional
        For each field how its beam is cut in the pupil: shifts dx, dy and compressions cx, cy,
        ``x' = dx + (1 - cx) x``.
    title, unit : str
        Name and unit of length (``mm``, ``cm``, ``m``, ``in``).
    notes : sequence of str
        What the file says besides, and is not followed.
    object_medium : Medium
        What light runs in before the first surface.

    Raises
    ------
    PrescriptionError
        If numbers are not finite where they must be, no surface or more than one stop is given, a
        clear aperture is wider than its surface, or neighbours cross on the axis. (That they cross
        farther out `crossings` tells; `load` and `lens_shapes` refuse that.)

    Examples
    --------
    >>> from mitsuba_bezier.optics import Abbe, Lens, Surface, first_order
    >>> front = Surface(1 / 50, 4, Abbe(1.5168, 64.17), semi_diameter=10)
    >>> lens = Lens([front, Surface(-1 / 50, 47, semi_diameter=10)])
    >>> round(first_order(lens).focal_length, 3)
    49.043
    """

    surfaces: Sequence[Surface]
    object_distance: float = np.inf
    aperture: tuple[str, float] | None = None
    wavelengths: Sequence[float] = (0.5875618,)
    weights: Sequence[float] | None = None
    reference: int = 0
    field_kind: str = "angle"
    fields: Sequence[tuple[float, float]] = ((0.0, 0.0),)
    vignetting: Sequence[tuple[float, float, float, float]] | None = None
    title: str = ""
    unit: str = "mm"
    notes: Sequence[str] = ()
    object_medium: Medium = AIR

    def __post_init__(self) -> None:
        check_lens(self)

    @property
    def millimetres(self) -> float:
        """Millimetres in the lens's unit."""
        return UNITS[self.unit]

    def spectrum(self) -> list[tuple[float, float]]:
        """Return wavelengths in micrometres with their shares of the light, whose sum is 1."""
        weights = np.ones(len(self.wavelengths)) if self.weights is None else self.weights
        shares = np.array(weights, float) / np.sum(weights)
        return [(float(w), float(s)) for w, s in zip(self.wavelengths, shares) if s > 0]

    def field_points(self) -> list[tuple[float, float]]:
        """Return the fields, each once."""
        return list(dict.fromkeys((float(x), float(y)) for x, y in self.fields))

    def farthest_field(self) -> tuple[float, float]:
        """Return the field that is farthest from the axis."""
        return max(self.field_points(), key=lambda field: float(np.hypot(*field)))

    def vignetted(self, field: tuple[float, float], pupil: np.ndarray) -> np.ndarray:
        """Return points ``(N, 2)`` of the unit disk as the beam of a field fills the pupil."""
        for known, factors in zip(self.fields, self.vignetting or ()):
            if tuple(known) == tuple(field):
                dx, dy, cx, cy = factors
                return np.asarray(pupil, float) * [1 - cx, 1 - cy] + [dx, dy]
        return pupil

    @property
    def stop(self) -> int:
        """Index of the aperture stop; the first surface if none is marked."""
        marked = [i for i, s in enumerate(self.surfaces) if s.stop]
        return marked[0] if marked else 0

    def media(self) -> list[Medium]:
        """Return what light runs in before the first surface and behind each."""
        media: list[Medium] = [self.object_medium]
        for s in self.surfaces:
            media.append(media[-1] if s.mirror else s.medium)
        return media

    def indices(self, wavelength: float) -> np.ndarray:
        """Return refractive indices ``(S + 1,)`` before the first surface and behind each."""
        w = float(check_wavelength(wavelength))
        return np.array([float(m.index(w)) for m in self.media()])

    def directions(self) -> np.ndarray:
        """Return 1 or -1, ``(S + 1,)``: along or against the axis before and behind each."""
        turns = [1.0] + [-1.0 if s.mirror else 1.0 for s in self.surfaces]
        return np.cumprod(turns)

    def frames(self) -> np.ndarray:
        """Return ``(S + 1, 4, 4)`` maps from each surface's frame, and the image's, to the lens.

        The origin of the lens is the first vertex, and its axis that of the first surface's row.
        """
        frame = np.eye(4)
        frames = []
        for s in self.surfaces:
            frame = frame @ s.before
            frames.append(frame)
            along = np.eye(4)
            along[2, 3] = s.thickness
            frame = frame @ s.after @ along
        return np.array([*frames, frame])

    def crossings(self) -> list[str]:
        """Return a sentence for each pair of neighbours that cross inside their clear apertures."""
        return list(crossings(self))

    def report(self, wavelength: float | None = None) -> str:
        """Return first-order data, surfaces, distortion and spots as text of several lines.

        Parameters
        ----------
        wavelength : float, optional
            As of `optics.report`, which this is.

        Examples
        --------
        >>> from mitsuba_bezier.optics import Lens, Surface
        >>> print(Lens([Surface(-1 / 200, -100, mirror=True)]).report().splitlines()[1].split())
        ['effective', 'focal', 'length', '100']
        """
        # what this module knows nothing of
        return str(import_module(f"{__package__}.report").report(self, wavelength))

    def scene(self, **options: Any) -> dict[str, dict[str, Any]]:
        """Return the surfaces, edges and stop as shapes for a scene dictionary.

        Parameters
        ----------
        **options
            Those of `optics.lens_shapes`, which this is: ``to_world``, ``dispersion``, ...

        Examples
        --------
        >>> from mitsuba_bezier.optics import Abbe, Lens, Surface
        >>> front = Surface(1 / 50, 4, Abbe(1.5168, 64.17), semi_diameter=10)
        >>> lens = Lens([front, Surface(-1 / 50, 47, semi_diameter=10)])
        >>> sorted(lens.scene(stop=False))
        ['edge-1', 'surface-1', 'surface-2']
        """
        shapes: dict[str, dict[str, Any]]
        shapes = import_module(f"{__package__}.patches").lens_shapes(self, **options)
        return shapes

    def scaled(self, factor: float) -> Lens:
        """Return the lens `factor` times as large, with beams and fields of lengths as well."""
        if not (np.isfinite(factor) and factor > 0):
            raise PrescriptionError.expected("factor", "a positive number", factor)

        def moved(matrix: np.ndarray) -> np.ndarray:
            out = np.array(matrix, float)
            out[:3, 3] *= factor
            return out

        surfaces = [
            replace(
                s,
                curvature=s.curvature / factor,
                thickness=s.thickness * factor,
                semi_diameter=s.semi_diameter * factor,
                inner=s.inner * factor,
                coefficients=tuple(
                    a * factor ** (1 - 2 * i) for i, a in enumerate(s.coefficients, start=1)
                ),
                before=moved(s.before),
                after=moved(s.after),
            )
            for s in self.surfaces
        ]
        aperture = self.aperture
        if aperture is not None and aperture[0] == "diameter":
            aperture = ("diameter", aperture[1] * factor)
        fields = self.fields
        if self.field_kind != "angle":
            fields = [(x * factor, y * factor) for x, y in fields]
        return replace(
            self,
            surfaces=surfaces,
            object_distance=self.object_distance * factor,
            aperture=aperture,
            fields=fields,
        )
