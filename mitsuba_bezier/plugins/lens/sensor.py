"""The sensor ``lens``: a film behind a real lens, whose surfaces refract every camera ray."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import BezierError, PrescriptionError
from ...optics import Lens, coating, first_order, load, reflectance, trace
from ...optics.backwards import backwards, pupil_bounds
from ...optics.glass import CHANNELS
from ...optics.iris import check_blades
from ...optics.patches import clear_radii
from ...optics.scaling import focused, stopped_down
from ..one_color import chosen, time_of
from .ghosts import mirrored_share, walk
from .glass import Glass, Light, wavelength_place
from .surfaces import Blades, Surfaces, meet, refracted

__all__ = ["make_lens_class"]

#: Points across the exit pupil that find how bright the middle of the film is.
_BRIGHT = 20_000
_CHANNEL_NANOMETRES = tuple(1e3 * w for w in CHANNELS)
#: Share of the rays that go through the pupil if ghosts are looked for through all of the glass.
_PUPIL_SHARE = 0.75


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
         * - blades
           - |int|
           - Blades of the iris, 3 to 64: a regular polygon, whose corners lie on the round stop
             (Default: 0, a round stop).
         * - blade_rotation
           - |float|
           - Degrees by which the iris is turned about the axis (Default: 0).
         * - coating
           - |string|
           - ``ideal`` reflects nothing, ``none`` is bare glass, ``quarter_wave[:NANOMETRES]`` one
             layer of magnesium fluoride, ``INDEX:NANOMETRES, ...`` layers from the air to the
             glass (Default: ``ideal``; with ``ghosts`` a quarter wave).
         * - ghosts
           - |bool|
           - Follow light that is reflected inside of the lens (Default: false).
         * - absorption
           - |bool|
           - Glass absorbs as its catalogue says (Default: false).
         * - glass
           - |string|
           - ``sensor``: the lens is inside the sensor. ``scene``: rays go from the film straight
             to the rear element, and the glass is in the scene (`optics.lens_shapes`)
             (Default: ``sensor``).
         * - to_world
           - |transform|
           - As for :monosp:`perspective`; the origin is in the middle of the entrance pupil.
             (|exposed|)
         * - curvatures, conics, thicknesses, nd, vd, coefficients
           - |float| arrays
           - The prescription, front first; the last thickness is the distance of the film, nd and
             vd are those of the medium behind a surface. (|exposed|, |differentiable|)
         * - (Nested plugin)
           - |film|, |sampler|
           - As for Mitsuba's own sensors.

        Rays start on the film, go through the bounded part of the rear element from which light
        arrives, and are refracted in order. Vignetting, distortion and the fall of brightness
        towards the corners come from the lens. A white field is 1 in the middle of the film,
        ghosts not counted. Light that is reflected at the film is not followed.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            if not isinstance(props.get("filename"), str):
                got = repr(props["filename"]) if "filename" in props else "none"
                raise BezierError.expected("filename", "a prescription of a lens", got)
            name = str(mi.file_resolver().resolve(props["filename"]))
            where = props.get("to_world", mi.ScalarTransform4f())
            # of float64 in a file, of float32 in a dictionary
            self._origin = _placed(where)[:3, 3].tolist()
            self._width = _positive(props, "film_width", 36.0)
            self._scale = _positive(props, "scale", 1e-3)
            self._dispersion = _flag(props, "dispersion", mi.is_spectral)
            self._ghosts = _flag(props, "ghosts", False)
            self._absorption = _flag(props, "absorption", False)
            default = "quarter_wave" if self._ghosts else "ideal"
            self._layers = coating(str(props.get("coating", default)))
            self._blades = Blades(_blades(props), _finite(props, "blade_rotation", 0.0))
            self._in_scene = _one_of(props, "glass", ("sensor", "scene")) == "scene"
            if self._in_scene and self._ghosts:
                raise BezierError.expected("glass", "sensor, if ghosts are followed", "scene")
            lens = load(name)
            if "f_number" in props:
                lens = stopped_down(lens, _positive(props, "f_number", 1.0))
            if "focus_distance" in props:
                lens = focused(lens, _positive(props, "focus_distance", 1.0) / self._scale)
            if self._blades.normals and not any(s.stop for s in lens.surfaces):
                raise PrescriptionError("stop: expected a surface that has the blades, got none")
            self._given = lens
            self._prepare(lens)
            self._surfaces = Surfaces(lens, self._back)
            self._glass = Glass(lens)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = True

        def _prepare(self, lens: Lens) -> None:
            """Turn the lens round, bound the pupil, and find how bright the middle is."""
            size = self.film().size()
            self._height = self._width * size[1] / size[0]
            pupil = first_order(lens).entrance_pupil
            if not np.isfinite(pupil):
                raise PrescriptionError("stop: expected an entrance pupil at a finite place")
            distance = lens.surfaces[-1].thickness
            if not distance > 0:
                raise PrescriptionError(
                    f"lens: expected a film behind the last surface, got {distance:g}"
                )
            # surfaces with the radii of a drawing where the prescription has none
            back = _with_radii(backwards(lens), clear_radii(lens)[::-1])
            self._back = back
            w = lens.wavelengths[lens.reference]
            reach = 0.5 * float(np.hypot(self._width, self._height))
            bounds = pupil_bounds(back, distance, reach, w)
            self._bounds = [mi.Float(column) for column in bounds.T]
            self._reach = reach
            bright = _middle(back, distance, bounds[0], w, self._blades, self._layers)
            # no literals of kernels, which would be compiled anew for each lens of a search
            self._pupil, self._bright, self._rear = (
                dr.opaque(mi.Float, number)
                for number in (pupil, bright, _rear_radius(back, distance, reach))
            )

        def traverse(self, callback: Any) -> None:
            differentiable = mi.ParamFlags.Differentiable
            callback.put("to_world", self.m_to_world, mi.ParamFlags.NonDifferentiable)
            callback.put("curvatures", self._surfaces.curvatures, differentiable)
            callback.put("conics", self._surfaces.conics, differentiable)
            callback.put("thicknesses", self._surfaces.thicknesses, differentiable)
            if self._surfaces.terms:
                callback.put("coefficients", self._surfaces.coefficients, differentiable)
            callback.put("nd", self._glass.nd, differentiable)
            callback.put("vd", self._glass.vd, differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            """Bound the pupil of the lens as it is now."""
            known = {"curvatures", "conics", "thicknesses", "coefficients", "nd", "vd"}
            if keys and not known & set(keys):
                return
            self._glass.changed |= not keys or bool({"nd", "vd"} & set(keys))
            self._prepare(_moved(self._given, self._surfaces, self._glass))

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(self._origin))

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """Return a ray into the scene and its weight."""
            wavelengths, color, light, time, sample3 = self._spectrum(
                time, sample1, sample3, active
            )
            surfaces, distance = self._surfaces, self._surfaces.distance()
            # where light in the camera's axes goes is where the film's picture is turned to
            x = (1.0 - 2.0 * sample2.x) * (0.5 * self._width)
            y = (2.0 * sample2.y - 1.0) * (0.5 * self._height)
            p, weight = self._pupil_point(x, y, sample3)
            o = mi.Vector3f(x, y, -distance)
            d = dr.normalize(mi.Vector3f(p.x, p.y, 0.0) - o)
            # cos^4 / z^2 dA: irradiance of the film from the rear plane
            weight *= d.z * d.z * d.z * d.z / (distance * distance * self._bright)
            ok = mi.Mask(active) & (weight > 0)
            if self._in_scene:
                # from the front vertex: that is where the frame of the scene's side is
                o.z -= float(sum(s.thickness for s in self._back.surfaces))
            elif self._ghosts:
                seeds = mi.sample_tea_32(_bits(sample2.x), _bits(sample3.y))
                other = mi.sample_tea_32(_bits(sample2.y), _bits(sample3.x))
                seeds = seeds[0] ^ other[1], seeds[1] + other[0]
                o, d, share, ok = walk(
                    surfaces, self._glass, self._blades, light, self._layers,
                    self._absorption, o, d, seeds, ok,
                )  # fmt: skip
                color = color * share
            else:
                o, d, share, ok = self._through(o, d, light, ok)
                color = color * share
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

        def _through(self, o: Any, d: Any, light: Any, ok: Any) -> tuple[Any, Any, Any, Any]:
            """Refract rays by all surfaces in order; return rays, weights, and which arrive."""
            surfaces, glass = self._surfaces, self._glass
            share = mi.Spectrum(1.0)
            behind = glass.index(light, 0)
            for i in range(surfaces.count):
                before, behind = behind, glass.index(light, i + 1)
                p, slope, met = meet(surfaces.shape(i), o, d)
                ok &= met & surfaces.clear(i, p.x * p.x + p.y * p.y)
                if i == surfaces.stop:
                    ok &= self._blades.open(p.x, p.y, self._back.surfaces[i].semi_diameter)
                if self._absorption:
                    share *= glass.faded(light, i, dr.norm(p - o))
                d, _n, cosine, passed = refracted(p, slope, d, before, behind)
                ok &= passed
                if self._layers is not None and not _same(self._back, i):
                    share *= 1.0 - mirrored_share(
                        before, behind, dr.minimum(cosine, 1.0), light, self._layers,
                        _cemented(self._back, i),
                    )  # fmt: skip
                o = mi.Vector3f(p.x, p.y, p.z - surfaces.gap(i))
            return o, d, share, ok

        def _spectrum(
            self, time: Any, sample: Any, aperture: Any, active: Any
        ) -> tuple[Any, Any, Light, Any, Any]:
            """Return wavelengths, weights of channels, light, time, and a place in the pupil.

            Rgb variants have no number that chooses a wavelength: the one for the aperture chooses
            the channel, and what is left of it is uniform again. The ray carries its channel, or
            wavelength, to dispersive glass in the scene (`one_color`).
            """
            if mi.is_spectral:
                si = dr.zeros(mi.SurfaceInteraction3f)
                wavelengths, color = self.sample_wavelengths(si, sample, active)
                if not self._dispersion:
                    return (
                        wavelengths,
                        color,
                        Light(mi.UInt32(0), None, wavelengths),
                        time,
                        aperture,
                    )
                # the others would have gone elsewhere: all are that of the hero
                hero = type(wavelengths)(wavelengths[0])
                light = Light(None, wavelength_place(wavelengths[0]), hero)
                return hero, mi.Spectrum(color[0]), light, time, aperture
            none: Any = []
            if mi.is_monochromatic:
                nanometres = 1e3 * self._given.wavelengths[self._given.reference]
                light = Light(mi.UInt32(0), None, nanometres)
                return none, mi.Spectrum(1.0), light, time, aperture
            waves = mi.Color3f(*_CHANNEL_NANOMETRES)
            if not self._dispersion:
                return none, mi.Spectrum(1.0), Light(mi.UInt32(0), None, waves), time, aperture
            channel = dr.minimum(mi.UInt32(aperture.x * 3.0), 2)
            rest = mi.Point2f(aperture.x * 3.0 - mi.Float(channel), aperture.y)
            light = Light(channel + 1, None, waves)
            return none, chosen(channel), light, time_of(channel), rest

        def _pupil_point(self, x: Any, y: Any, sample: Any) -> tuple[Any, Any]:
            """Return a point of the rear plane, and the area it stands for."""
            r = dr.sqrt(x * x + y * y)
            place = r * ((dr.width(self._bounds[0]) - 1) / self._reach)
            # bounds hold for the cell on either side of a radius
            i = dr.minimum(mi.UInt32(place + 0.5), dr.width(self._bounds[0]) - 1)
            x0, y0, x1, y1 = (dr.gather(mi.Float, b, i) for b in self._bounds)
            area = (x1 - x0) * (y1 - y0)
            # found for a film point on the x axis: turn to where this one is
            c, s = dr.select(r > 0, x / r, 1.0), dr.select(r > 0, y / r, 0.0)
            if not self._ghosts:
                u, v = dr.lerp(x0, x1, sample.x), dr.lerp(y0, y1, sample.y)
                return mi.Point2f(c * u - s * v, s * u + c * v), area
            # ghosts come through all of the rear element: some rays go there, and both densities
            # weigh them
            narrow = (sample.x < _PUPIL_SHARE) & (area > 0)
            share = dr.select(area > 0, _PUPIL_SHARE, 0.0)
            rest = dr.select(narrow, sample.x / _PUPIL_SHARE, (sample.x - share) / (1.0 - share))
            u, v = dr.lerp(x0, x1, rest), dr.lerp(y0, y1, sample.y)
            disk = self._rear * mi.warp.square_to_uniform_disk(mi.Point2f(rest, sample.y))
            u, v = dr.select(narrow, u, disk.x), dr.select(narrow, v, disk.y)
            inside = (u >= x0) & (u <= x1) & (v >= y0) & (v <= y1) & (area > 0)
            density = dr.select(inside, share / dr.maximum(area, 1e-30), 0.0)
            rear2 = dr.square(self._rear)
            density += dr.select(u * u + v * v <= rear2, (1.0 - share) / (np.pi * rear2), 0.0)
            return mi.Point2f(c * u - s * v, s * u + c * v), dr.rcp(density)

        def to_string(self) -> str:
            return f"LensSensor[{self._surfaces.count} surfaces, film {self._width:g} wide]"

    return LensSensor


def _positive(props: mi.Properties, key: str, default: float) -> float:
    value = props.get(key, default)
    if not _is_number(value) or not 0 < value < np.inf:
        raise BezierError.expected(key, "a positive number", repr(value))
    return float(value)


def _finite(props: mi.Properties, key: str, default: float) -> float:
    value = props.get(key, default)
    if not _is_number(value) or not np.isfinite(value):
        raise BezierError.expected(key, "a finite number", repr(value))
    return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _flag(props: mi.Properties, key: str, default: bool) -> bool:
    value = props.get(key, default)
    if not isinstance(value, bool):
        raise BezierError.expected(key, "true or false", repr(value))
    return value


def _placed(where: Any) -> np.ndarray:
    """Return the matrix of `to_world`, which moves and turns, and does no more."""
    matrix = np.array(where.matrix, dtype=float).reshape(4, 4)
    turn = matrix[:3, :3]
    # some ten roundings of float32
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-5) or not np.isfinite(matrix).all():
        raise BezierError.expected("to_world", "a rotation and a translation", matrix.tolist())
    return matrix


def _blades(props: mi.Properties) -> int:
    value = props.get("blades", 0)
    check_blades(value, 0.0)
    return int(value)


def _one_of(props: mi.Properties, key: str, words: tuple[str, ...]) -> str:
    value = props.get(key, words[0])
    if value not in words:
        raise BezierError.expected(key, " or ".join(words), repr(value))
    return str(value)


def _bits(value: Any) -> Any:
    return dr.reinterpret_array(mi.UInt32, dr.detach(mi.Float(value)))


def _with_radii(back: Lens, radii: np.ndarray) -> Lens:
    surfaces = [replace(s, semi_diameter=float(r)) for s, r in zip(back.surfaces, radii)]
    return replace(back, surfaces=surfaces)


def _same(back: Lens, i: int) -> bool:
    """Return whether surface `i` has one medium on both sides, as a stop in air."""
    media = back.media()
    return media[i] == media[i + 1]


def _cemented(back: Lens, i: int) -> bool:
    n = back.indices(back.wavelengths[back.reference])
    return bool(min(n[i], n[i + 1]) > 1.01)


def _moved(given: Lens, surfaces: Surfaces, glass: Glass) -> Lens:
    """Return the lens with the numbers on the device: those that have changed, in float32."""
    arrays = {
        "curvature": np.array(dr.detach(surfaces.curvatures)),
        "conic": np.array(dr.detach(surfaces.conics)),
        "thickness": np.array(dr.detach(surfaces.thicknesses)),
    }
    nd, vd = np.array(dr.detach(glass.nd)), np.array(dr.detach(glass.vd))
    table = np.array(dr.detach(surfaces.coefficients))
    rows = []
    for i, s in enumerate(given.surfaces):
        new: dict[str, Any] = {
            key: float(values[i])
            for key, values in arrays.items()
            if values[i] != np.float32(getattr(s, key))
        }
        if glass.changed:
            new["medium"] = glass.medium(i, s.medium, float(nd[i]), float(vd[i]))
        if s.coefficients:
            own = table[i * surfaces.terms : i * surfaces.terms + len(s.coefficients)]
            new["coefficients"] = tuple(
                float(a) if a != np.float32(b) else b for a, b in zip(own, s.coefficients)
            )
        rows.append(replace(s, **new))
    return replace(given, surfaces=rows)


def _rear_radius(back: Lens, distance: float, reach: float) -> float:
    """Return how far from the axis rays from the film to the rear element pass its vertex plane."""
    first = back.surfaces[0]
    r = np.linspace(0, first.semi_diameter, 200)
    z = distance + np.nan_to_num(first.sag(r))
    z = np.maximum(z, 1e-3 * distance)
    return 1.001 * float(((r * distance + reach * np.abs(z - distance)) / z).max())


def _middle(
    back: Lens,
    distance: float,
    bounds: np.ndarray,
    wavelength: float,
    blades: Blades,
    layers: Any,
) -> float:
    """Return the irradiance of the middle of the film under a white field of radiance 1."""
    # all is round but the blades, so rays along one radius tell what all do
    reach = float(np.abs(bounds).max()) * np.sqrt(2.0)
    r = (np.arange(_BRIGHT) + 0.5) / _BRIGHT * reach
    zero = np.zeros_like(r)
    o = np.stack([zero, zero, zero - distance], axis=1)
    d = np.stack([r, zero, zero + distance], axis=1)
    cosine = distance / np.hypot(r, distance)
    result = trace(back, o, d, wavelength)
    at = result.local[back.stop]
    radius = back.surfaces[back.stop].semi_diameter
    with np.errstate(invalid="ignore"):
        share = blades.share(np.hypot(at[:, 0], at[:, 1]), radius)
    share = np.where(result.valid, share, 0.0)
    found = float((cosine**4 * share * r).sum() * 2 * np.pi * reach / _BRIGHT / distance**2)
    if layers is not None:  # what bare or coated glass lets through along the axis
        n = back.indices(wavelength)
        for before, behind in pairwise(n):
            if before == behind:  # a stop in air
                continue
            films = layers if min(before, behind) < 1.01 else ()
            if before > behind:
                films = films[::-1]
            found *= 1 - float(reflectance(before, behind, 1.0, 1e3 * wavelength, films))
    return found
