"""The integrator plugin ``bezieraov``: Mitsuba's `aov`, with exact Bézier shapes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi

from ... import _runtime
from ...errors import BezierError
from ..scene import SceneRays
from .boundary import boundary_test
from .nested import nested_integrators, sample_nested

__all__ = ["KINDS", "make_aov_class"]


@dataclass(frozen=True)
class _Seen:
    """What a ray saw first."""

    ray: Any
    rays: SceneRays
    hit: Any
    si: Any
    active: Any  #: whether it saw a surface


def _albedo(seen: _Seen) -> list[Any]:
    bsdf = seen.si.bsdf(mi.RayDifferential3f(seen.ray))
    colour = _colour(bsdf.eval_diffuse_reflectance(seen.si, seen.active), seen.ray)
    return [dr.select(seen.active, x, 0.0) for x in (colour.x, colour.y, colour.z)]


def _xyz(value: Any) -> list[Any]:
    return [value.x, value.y, value.z]


def _uv_partials(seen: _Seen, name: str) -> list[Any]:
    seen.si.compute_uv_partials(seen.ray)
    value = getattr(seen.si, name)
    return [dr.select(seen.active, x, 0.0) for x in (value.x, value.y)]


def _patch(seen: _Seen) -> list[Any]:
    return [dr.select(seen.active & seen.hit.bezier, mi.Float(seen.hit.patch), -1.0)]


#: Channels and values of each kind; names and order are Mitsuba's.
KINDS: dict[str, tuple[str, Callable[[_Seen], list[Any]]]] = {
    "albedo": ("RGB", _albedo),
    "depth": ("T", lambda s: [dr.select(s.active, s.si.t, 0.0)]),
    "position": ("XYZ", lambda s: _xyz(s.si.p)),
    "uv": ("UV", lambda s: [s.si.uv.x, s.si.uv.y]),
    "geo_normal": ("XYZ", lambda s: _xyz(s.si.n)),
    "sh_normal": ("XYZ", lambda s: _xyz(s.si.sh_frame.n)),
    "dp_du": ("XYZ", lambda s: _xyz(s.si.dp_du)),
    "dp_dv": ("XYZ", lambda s: _xyz(s.si.dp_dv)),
    "duv_dx": ("UV", lambda s: _uv_partials(s, "duv_dx")),
    "duv_dy": ("UV", lambda s: _uv_partials(s, "duv_dy")),
    "prim_index": ("I", lambda s: [mi.Float(s.si.prim_index)]),
    "shape_index": ("I", lambda s: [mi.Float(dr.reinterpret_array(mi.UInt32, s.si.shape))]),
    "boundary_test": ("", lambda s: [boundary_test(s.rays, s.hit, s.si, s.ray, s.active)]),
    "patch": ("I", _patch),
}


def _colour(value: Any, ray: Any) -> Any:
    """Return linear sRGB of a spectrum along rays sampled for sRGB sensors."""
    value = mi.unpolarized_spectrum(value)
    if mi.is_monochromatic:
        return mi.Color3f(value.x)
    if mi.is_rgb:
        return mi.Color3f(value)
    pdf = mi.pdf_rgb_spectrum(ray.wavelengths)
    value = value * dr.select(pdf != 0, dr.rcp(pdf), 0.0)
    return mi.spectrum_to_srgb(value, ray.wavelengths)


def _parse(text: Any) -> list[tuple[str, str]]:
    """Return pairs of name and kind of ``"name:kind, name:kind"``."""
    if not isinstance(text, str):
        raise BezierError.expected("aovs", 'a list "<name>:<type>, ..."', repr(text))
    pairs = []
    for token in text.replace(",", " ").split():
        name, colon, kind = token.partition(":")
        if not (name and colon and kind):
            raise BezierError.expected("aovs", "<name>:<type> pairs", f'"{token}"')
        if kind not in KINDS:
            raise BezierError.expected("aovs", f"a type among {', '.join(KINDS)}", f'"{token}"')
        pairs.append((name, kind))
    names = [name for name, _kind in pairs]
    for name in names:
        if names.count(name) > 1:
            raise BezierError.expected("aovs", "each name once", f'"{name}" several times')
    return pairs


def make_aov_class() -> type:
    """Return the class for the variant that is set now."""
    # Mitsuba reloads this module when the variant changes
    base = import_module("mitsuba.python.ad.integrators.common").ADIntegrator

    class BezierAOV(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezieraov:

        Arbitrary output variables with Bézier shapes (:monosp:`bezieraov`)
        -------------------------------------------------------------------

        .. pluginparameters::

         * - aovs
           - |string|
           - List of :monosp:`<name>:<type>` pairs: the channels wanted.
         * - (Nested plugin)
           - :paramtype:`integrator`
           - Integrators whose images are rendered along: of each the channels
             :monosp:`<name>.R`, :monosp:`.G`, :monosp:`.B`, :monosp:`.A` and its own. The first
             one's image is also the colour of the film.

        The types are those of Mitsuba's `aov`, whose parameters and channel names it has, of what
        a ray meets first:

        - :monosp:`albedo`: diffuse reflectance of the material.
        - :monosp:`depth`: distance along the ray.
        - :monosp:`position`: world space position.
        - :monosp:`uv`: texture coordinates.
        - :monosp:`geo_normal`, :monosp:`sh_normal`: normal, and that of the shading frame
          (without bump and normal maps).
        - :monosp:`dp_du`, :monosp:`dp_dv`: partials by texture coordinates.
        - :monosp:`duv_dx`, :monosp:`duv_dy`: texture coordinates by pixels.
        - :monosp:`prim_index`, :monosp:`shape_index`: number of the patch in its shape, and
          Mitsuba's number of the shape.
        - :monosp:`boundary_test`: 0 at silhouettes and open edges (not at trimming curves), 1
          where nothing is seen (as up to Mitsuba 3.5).
        - :monosp:`patch`: number of the patch among all Bézier patches of the scene, from 0 in
          the order of its shapes, and -1 elsewhere.

        Numbers (:monosp:`prim_index`, ...) are averaged over a pixel as all else; use a box
        filter and one sample where they matter. Nested integrators are differentiated as they
        do it themselves.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            if "aovs" not in props:
                raise BezierError.expected("aovs", 'a list "<name>:<type>, ..."', "nothing")
            self._wanted = _parse(props["aovs"])
            self._nested = nested_integrators(props)
            for key in ("max_depth", "rr_depth"):  # what the base class would take
                if key in props:
                    raise BezierError.expected(
                        "bezieraov", "no path depth, which belongs to nested integrators", key
                    )
            super().__init__(props)

        def aov_names(self) -> list[str]:
            """Return the names of the channels beside the film's own."""
            names = [f"{name}.{c}" for name, _nested in self._nested for c in "RGBA"]
            for name, nested in self._nested:
                names += [f"{name}.{own}" for own in nested.aov_names()]
            for name, kind in self._wanted:
                names += [f"{name}.{c}" if c else name for c in KINDS[kind][0] or [""]]
            return names

        def sample_rays(self, scene: Any, sensor: Any, sampler: Any) -> tuple[Any, ...]:
            """Sample rays; their differentials are those of a sample, as in Mitsuba's `aov`."""
            ray, weight, position = super().sample_rays(scene, sensor, sampler)
            ray.scale_differential(sampler.sample_count() ** -0.5)
            return ray, weight, position

        def sample(
            self,
            mode: Any,
            scene: Any,
            sampler: Any,
            ray: Any,
            active: Any = True,
            **kwargs: Any,
        ) -> tuple[Any, ...]:
            """Evaluate along rays; see `ADIntegrator.sample` in Mitsuba for the interface."""
            active = mi.Bool(active)
            rays = SceneRays(scene)
            images, others = [], []
            L, valid = mi.Spectrum(0.0), mi.Bool(False)
            for index, (_name, nested) in enumerate(self._nested):
                with dr.suspend_grad():
                    value, seen, own = sample_nested(nested, scene, sampler, ray, active)
                colour = _colour(value, ray)
                images += [*_xyz(colour), dr.select(seen, mi.Float(1.0), 0.0)]
                others += own
                if index == 0:
                    L, valid = value, seen
            # as the first interaction of a path; differentials have their own place in the ray
            hit = rays.preliminary(ray, True, active)
            si = rays.surface_interaction(hit, ray, mi.RayFlags.All, active)
            found = active & si.is_valid()
            si = dr.select(found, si, dr.zeros(mi.SurfaceInteraction3f))
            seen = _Seen(ray, rays, hit, si, found)
            for _name, kind in self._wanted:
                others += KINDS[kind][1](seen)
            return L, valid, images + others, None

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            """Render; the tensor has the layout of Mitsuba's `aov`."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            image = super().render(scene, sensor, seed, spp, develop, evaluate)
            order, _parts = self._layout(sensor.film().base_channels_count())
            return _take(image, order)

        def render_forward(
            self, scene: Any, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
        ) -> Any:
            """Differentiate; nested integrators do so by themselves."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            # these first: the base class clears the derivatives of the parameters
            images = [
                nested.render_forward(scene, params, sensor, seed, spp)
                for _name, nested in self._nested
            ]
            image = super().render_forward(scene, params, sensor, seed, spp)
            order, parts = self._layout(sensor.film().base_channels_count())
            image = _take(image, order)
            for part, nested_image in zip(parts, images):
                _put(image, part, nested_image)
            return image

        def render_backward(
            self,
            scene: Any,
            params: Any,
            grad_in: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
        ) -> None:
            """Differentiate; nested integrators do so by themselves."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            own = sensor.film().base_channels_count()
            order, parts = self._layout(own)
            film = dr.zeros(mi.TensorXf, (*grad_in.shape[:2], own + len(self.aov_names())))
            _put(film, order, grad_in)
            super().render_backward(scene, params, film, sensor, seed, spp)
            for (_name, nested), part in zip(self._nested, parts):
                nested.render_backward(scene, params, _take(grad_in, part), sensor, seed, spp)

        def _layout(self, own: int) -> tuple[list[int], list[list[int]]]:
            """Return the film's channels in the order of the tensor, and each nested image's part.

            The film has `own` channels, RGBA of each nested integrator, their variables, and ours.
            The tensor has of each nested one what it would return by itself, then ours.
            """
            colours = {1: [0], 2: [0, 3], 3: [0, 1, 2], 4: [0, 1, 2, 3]}[own]
            order: list[int] = []
            parts = []
            place = own + 4 * len(self._nested)
            for k, (_name, nested) in enumerate(self._nested):
                extra = len(nested.aov_names())
                film = list(range(own)) if k == 0 else [own + 4 * k + c for c in colours]
                film += range(place, place + extra)
                place += extra
                inner = list(range(own + extra))
                if isinstance(nested, BezierAOV):
                    inner = nested._layout(own)[0]
                parts.append(list(range(len(order), len(order) + len(inner))))
                order += [film[c] for c in inner]
            return [*order, *range(place, own + len(self.aov_names()))], parts

        def traverse(self, cb: Any) -> None:
            for index, (_name, nested) in enumerate(self._nested):
                cb.put(f"integrator_{index}", nested, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            inside = "\n".join(
                f"    {line}" for _n, i in self._nested for line in str(i).split("\n")
            )
            return (
                f"BezierAOV[\n  aovs = {', '.join(f'{n}:{k}' for n, k in self._wanted)},\n"
                f"  integrators = [\n{inside}\n  ]\n]"
            )

    return BezierAOV


def _take(image: Any, channels: list[int]) -> Any:
    """Return some channels of an image."""
    shape = (*image.shape[:2], len(channels))
    result = dr.zeros(mi.TensorXf, shape)
    pixel = dr.arange(mi.UInt32, shape[0] * shape[1])
    for k, channel in enumerate(channels):
        values = dr.gather(mi.Float, image.array, pixel * image.shape[2] + channel)
        dr.scatter(result.array, values, pixel * shape[2] + k)
    return result


def _put(image: Any, channels: list[int], values: Any) -> None:
    """Overwrite some channels of an image."""
    pixel = dr.arange(mi.UInt32, image.shape[0] * image.shape[1])
    for k, channel in enumerate(channels):
        value = dr.gather(mi.Float, values.array, pixel * values.shape[2] + k)
        dr.scatter(image.array, value, pixel * image.shape[2] + channel)
