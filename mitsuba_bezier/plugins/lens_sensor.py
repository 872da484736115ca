"""The sensor ``lens``: a film behind a real lens, whose surfaces refract every camera ray."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError, PrescriptionError
from ..optics import Lens, first_order, load, trace
from ..optics.backwards import backwards, pupil_bounds
from ..optics.patches import clear_radii
from ..optics.scaling import focused, stopped_down

__all__ = ["make_lens_class"]

#: Newton steps on an asphere in float32: the start is on its conic.
_STEPS = 6
#: Wavelengths in nanometres at which indices are tabulated.
_FIRST, _LAST, _COUNT = 360.0, 830.0, 95
#: Of the three channels of rgb variants, in micrometres (about where sRGB's primaries are).
_CHANNELS = (0.610, 0.550, 0.465)
#: Points across the exit pupil that find how bright the middle of the film is.
_BRIGHT = 400


def make_lens_class() -> type:
    """Return the class for the variant that is set now."""

    class LensSensor(mi.Sensor):
        r"""
        .. _sensor-lens:

        Film behind a lens (:monosp:`lens`)
        -----------------------------------

        .. pluginparameters::

         * - filename
           - |string|
           - The prescription: ``.zmx``, ``.seq``, ``.csv`` or pbrt's ``.dat`` (docs/lenses.md).
         * - film_width
           - |float|
           - Width of the film in the lens's unit (Default: 36).
         * - focus_distance
           - |float|
           - Distance of the plane in focus from the front vertex, in scene units (Default: the
             image plane stays where the prescription has it).
         * - f_number
           - |float|
           - Stop the lens down or up to this f-number (Default: the prescription's).
         * - scale
           - |float|
           - Scene units in a unit of the lens (Default: 0.001, a lens in mm and a scene in m).
         * - dispersion
           - |bool|
           - Refract each channel (rgb variants) or wavelength (spectral ones) by its own index
             (Default: in spectral variants; in rgb ones it takes three times the samples).
         * - to_world
           - |transform|
           - As for :monosp:`perspective`; the origin is in the middle of the entrance pupil.
             (|exposed|)
         * - (Nested plugin)
           - |film|, |sampler|
           - As for Mitsuba's own sensors.

        Rays start on the film, go through the bounded part of the rear element from which light
        arrives, and are refracted in order. Vignetting, distortion and the fall of brightness
        towards the corners come from the lens. A white field is 1 in the middle of the film.
        There are no ghosts: for these, put `optics.lens_shapes` into the scene.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            if "filename" not in props:
                raise BezierError.expected("filename", "a prescription of a lens", "none")
            name = str(mi.file_resolver().resolve(props["filename"]))
            where = props.get("to_world", mi.ScalarTransform4f())
            # of float64 in a file, of float32 in a dictionary
            self._origin = np.array(where.matrix, dtype=float).reshape(4, 4)[:3, 3].tolist()
            self._width = _positive(props, "film_width", 36.0)
            self._scale = _positive(props, "scale", 1e-3)
            self._dispersion = bool(props.get("dispersion", mi.is_spectral))
            lens = load(name)
            if "f_number" in props:
                lens = stopped_down(lens, _positive(props, "f_number", 1.0))
            if "focus_distance" in props:
                lens = focused(lens, _positive(props, "focus_distance", 1.0) / self._scale)
            self._prepare(lens)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = True

        def _prepare(self, lens: Lens) -> None:
            """Turn the lens round, bound the pupil, and find how bright the middle is."""
            size = self.film().size()
            self._height = self._width * size[1] / size[0]
            self._pupil = first_order(lens).entrance_pupil
            if not np.isfinite(self._pupil):
                raise PrescriptionError("stop: expected an entrance pupil at a finite place")
            self._distance = lens.surfaces[-1].thickness
            if not self._distance > 0:
                raise PrescriptionError(
                    f"lens: expected a film behind the last surface, got {self._distance:g}"
                )
            back = backwards(lens)
            # surfaces with the radii of a drawing where the prescription has none
            radii = clear_radii(lens)[::-1]
            back = _with_radii(back, radii)
            self._rows = back.surfaces
            w = lens.wavelengths[lens.reference]
            reach = 0.5 * float(np.hypot(self._width, self._height))
            bounds = pupil_bounds(back, self._distance, reach, w)
            self._bounds = [mi.Float(column) for column in bounds.T]
            self._reach = reach
            self._tables = [mi.Float(_table(m, w)) for m in back.media()]
            self._fixed = [_indices(back, c) for c in _CHANNELS]
            self._reference = _indices(back, w)
            self._bright = _middle(back, self._distance, bounds[0], w)

        def traverse(self, callback: Any) -> None:
            callback.put("to_world", self.m_to_world, mi.ParamFlags.NonDifferentiable)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(self._origin))

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """Return a ray into the scene and its weight."""
            wavelengths, color, index, sample3 = self._spectrum(sample1, sample3, active)
            # where light in the camera's axes goes is where the film's picture is turned to
            x = (1.0 - 2.0 * sample2.x) * (0.5 * self._width)
            y = (2.0 * sample2.y - 1.0) * (0.5 * self._height)
            p, weight = self._pupil_point(x, y, sample3)
            o = mi.Vector3f(x, y, -self._distance)
            d = dr.normalize(mi.Vector3f(p.x, p.y, 0.0) - o)
            # cos^4 / z^2 dA: irradiance of the film from the rear plane
            weight *= d.z * d.z * d.z * d.z / (self._distance * self._distance * self._bright)
            ok = mi.Mask(active) & (weight > 0)
            for i, row in enumerate(self._rows):
                o, d, ok = _through(row, o, d, index[i], index[i + 1], ok)
                o.z -= row.thickness
            weight = dr.select(ok, weight, 0.0)
            # the backward frame mirrors z, the camera looks along it
            o = mi.Point3f(-o.x, o.y, o.z + self._pupil) * self._scale
            d = dr.normalize(mi.Vector3f(-d.x, d.y, d.z))
            ray = mi.Ray3f(self.m_to_world @ o, self.m_to_world @ d, time, wavelengths)
            return ray, color * weight

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """Return what `sample_ray` does: a wide beam has no differentials of use."""
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def _spectrum(
            self, sample: Any, aperture: Any, active: Any
        ) -> tuple[Any, Any, list[Any], Any]:
            """Return wavelengths, weights of channels, indices of media, and a place in the pupil.

            Rgb variants have no number that chooses a wavelength: the one for the aperture chooses
            the channel, and what is left of it is uniform again.
            """
            if mi.is_spectral:
                si = dr.zeros(mi.SurfaceInteraction3f)
                wavelengths, color = self.sample_wavelengths(si, sample, active)
                if not self._dispersion:
                    return wavelengths, color, list(self._reference), aperture
                hero = wavelengths[0]
                place = (hero - _FIRST) * ((_COUNT - 1) / (_LAST - _FIRST))
                place = dr.clip(place, 0.0, _COUNT - 1.001)
                i = mi.UInt32(place)
                f = place - mi.Float(i)
                index = [
                    dr.lerp(dr.gather(mi.Float, t, i), dr.gather(mi.Float, t, i + 1), f)
                    for t in self._tables
                ]
                # the others would have gone elsewhere
                alone = dr.zeros(mi.Spectrum)
                alone[0] = float(len(alone))
                return wavelengths, color * alone, index, aperture
            none: Any = []
            if mi.is_monochromatic or not self._dispersion:
                return none, mi.Spectrum(1.0), list(self._reference), aperture
            channel = dr.minimum(mi.UInt32(aperture.x * 3.0), 2)
            rest = mi.Point2f(aperture.x * 3.0 - mi.Float(channel), aperture.y)
            index = [
                dr.select(channel == 0, a, dr.select(channel == 1, b, c))
                for a, b, c in zip(*self._fixed)
            ]
            color = mi.Spectrum(
                dr.select(channel == 0, 3.0, 0.0),
                dr.select(channel == 1, 3.0, 0.0),
                dr.select(channel == 2, 3.0, 0.0),
            )
            return none, color, index, rest

        def _pupil_point(self, x: Any, y: Any, sample: Any) -> tuple[Any, Any]:
            """Return a point of the bounded rear plane, and the area it stands for."""
            r = dr.sqrt(x * x + y * y)
            place = r * ((dr.width(self._bounds[0]) - 1) / self._reach)
            # bounds hold for the cell on either side of a radius
            i = dr.minimum(mi.UInt32(place + 0.5), dr.width(self._bounds[0]) - 1)
            x0, y0, x1, y1 = (dr.gather(mi.Float, b, i) for b in self._bounds)
            u, v = dr.lerp(x0, x1, sample.x), dr.lerp(y0, y1, sample.y)
            # found for a film point on the x axis: turn to where this one is
            c, s = dr.select(r > 0, x / r, 1.0), dr.select(r > 0, y / r, 0.0)
            return mi.Point2f(c * u - s * v, s * u + c * v), (x1 - x0) * (y1 - y0)

        def to_string(self) -> str:
            return f"LensSensor[{len(self._rows)} surfaces, film {self._width:g} wide]"

    return LensSensor


def _positive(props: mi.Properties, key: str, default: float) -> float:
    value = props.get(key, default)
    if not isinstance(value, (int, float)) or not 0 < value < np.inf:
        raise BezierError.expected(key, "a positive number", repr(value))
    return float(value)


def _with_radii(back: Lens, radii: np.ndarray) -> Lens:
    surfaces = [replace(s, semi_diameter=float(r)) for s, r in zip(back.surfaces, radii)]
    return replace(back, surfaces=surfaces)


def _indices(back: Lens, wavelength: float) -> list[float]:
    return [float(n) for n in back.indices(wavelength)]


def _table(medium: Any, reference: float) -> np.ndarray:
    """Return indices at equal steps; beyond the range of a glass those at its ends."""
    steps = np.linspace(_FIRST, _LAST, _COUNT) * 1e-3
    out = np.full(_COUNT, np.nan)
    for i, w in enumerate(steps):
        try:
            out[i] = float(medium.index(w))
        except PrescriptionError:
            continue
    known = np.isfinite(out)
    if not known.any():
        return np.full(_COUNT, float(medium.index(reference)))
    return np.interp(steps, steps[known], out[known])


def _middle(back: Lens, distance: float, bounds: np.ndarray, wavelength: float) -> float:
    """Return the irradiance of the middle of the film under a white field of radiance 1."""
    x0, y0, x1, y1 = bounds
    u = x0 + (np.arange(_BRIGHT) + 0.5) / _BRIGHT * (x1 - x0)
    v = y0 + (np.arange(_BRIGHT) + 0.5) / _BRIGHT * (y1 - y0)
    x, y = (a.ravel() for a in np.meshgrid(u, v))
    o = np.tile([0.0, 0.0, -distance], (len(x), 1))
    d = np.stack([x, y, np.full_like(x, distance)], axis=1)
    cosine = distance / np.linalg.norm(d, axis=1)
    ok = trace(back, o, d, wavelength).valid
    return float((cosine[ok] ** 4).mean() * ok.mean() * (x1 - x0) * (y1 - y0) / distance**2)


def _through(
    row: Any, o: Any, d: Any, before: Any, behind: Any, active: Any
) -> tuple[Any, Any, Any]:
    """Refract rays by one surface in its own frame, all of them towards positive z."""
    c, k = row.curvature, row.conic
    if c:
        a = c * (d.x * d.x + d.y * d.y + (1 + k) * d.z * d.z)
        b = c * (o.x * d.x + o.y * d.y + (1 + k) * o.z * d.z) - d.z
        q = c * (o.x * o.x + o.y * o.y + (1 + k) * o.z * o.z) - 2 * o.z
        disc = b * b - a * q
        active = active & (disc >= 0)
        t = q / (-b + dr.sqrt(dr.maximum(disc, 0.0)))
    else:
        t = -o.z / d.z
    p = o + d * t
    if not row.is_conic:
        for _ in range(_STEPS):
            sag, slope = _sag(row, p.x * p.x + p.y * p.y)
            t -= (p.z - sag) / (d.z - slope * (p.x * d.x + p.y * d.y))
            p = o + d * t
    s = p.x * p.x + p.y * p.y
    active = active & (s <= row.semi_diameter**2) & (s >= row.inner**2)
    _z, slope = _sag(row, s)
    n = dr.normalize(mi.Vector3f(-slope * p.x, -slope * p.y, 1.0))
    m = before / behind
    along = dr.dot(n, d)
    left = 1 - m * m * (1 - along * along)
    active = active & (left >= 0) & (along > 0)
    return p, m * d + (dr.sqrt(dr.maximum(left, 0.0)) - m * along) * n, active


def _sag(row: Any, s: Any) -> tuple[Any, Any]:
    """Return sag and slope over r at squared distances `s` from the axis."""
    c = row.curvature
    root = dr.sqrt(dr.maximum(1 - (1 + row.conic) * c * c * s, 1e-6))
    sag, slope = c * s / (1 + root), c / root
    power = 1.0
    for i, a in enumerate(row.coefficients, start=1):
        slope = slope + 2 * i * a * power
        power = power * s
        sag = sag + a * power
    return sag, slope
