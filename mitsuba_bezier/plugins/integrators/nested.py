"""The integrators ``beziermoment`` and ``bezierstokes``: Mitsuba's `moment` and `stokes`."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi

from ... import _runtime
from ...errors import BezierError

__all__ = ["make_moment_class", "make_stokes_class", "nested_integrators", "sample_nested"]


def nested_integrators(props: mi.Properties) -> list[tuple[str, Any]]:
    """Return names and objects of the integrators in `props`."""
    nested = []
    for key in props.keys():  # noqa: SIM118 (Properties is no dict)
        if props.type(key) != mi.Properties.Type.Object:
            continue
        value = props[key]
        if not isinstance(value, mi.SamplingIntegrator):
            raise BezierError.expected(
                key, "an integrator that samples rays of the sensor", repr(value)
            )
        nested.append((key, value))
    return nested


def sample_nested(nested: Any, scene: Any, sampler: Any, ray: Any, active: Any) -> tuple[Any, ...]:
    """Sample a nested integrator; return radiance, validity and its own channels."""
    if isinstance(nested, mi.CppADIntegrator):  # written in Python, with another signature
        value, valid, own, _state = nested.sample(
            mode=dr.ADMode.Primal,
            scene=scene,
            sampler=sampler,
            ray=ray,
            depth=mi.UInt32(0),
            δL=None,
            δaovs=None,
            state_in=None,
            active=active,
        )
    else:
        value, valid, own = nested.sample(scene, sampler, ray, None, active)
    return value, valid, list(own)


def _densities(ray: Any) -> Any:
    """Return one over the densities of the wavelengths that sensors for colours sample."""
    pdf = mi.pdf_rgb_spectrum(ray.wavelengths)
    return dr.select(pdf != 0, dr.rcp(pdf), 0.0)


def _xyz(value: Any, ray: Any) -> list[Any]:
    value = mi.unpolarized_spectrum(value)
    if mi.is_monochromatic:
        return [value.x] * 3
    if mi.is_rgb:
        colour = mi.srgb_to_xyz(mi.Color3f(value))
    else:
        colour = mi.spectrum_to_xyz(value * _densities(ray), ray.wavelengths)
    return [colour.x, colour.y, colour.z]


def _rgb(value: Any, ray: Any) -> list[Any]:
    if mi.is_monochromatic:
        return [value.x] * 3
    if mi.is_rgb:
        return [value.x, value.y, value.z]
    colour = mi.spectrum_to_srgb(value * _densities(ray), ray.wavelengths)
    return [colour.x, colour.y, colour.z]


def make_moment_class() -> type:
    """Return the class of ``beziermoment`` for the variant that is set now."""
    base = import_module("mitsuba.python.ad.integrators.common").ADIntegrator

    class BezierMoment(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-beziermoment:

        Moments of samples with Bézier shapes (:monosp:`beziermoment`)
        --------------------------------------------------------------

        .. pluginparameters::

         * - (Nested plugin)
           - :paramtype:`integrator`
           - Integrators whose samples are recorded. The channels are those of Mitsuba's `moment`:
             of each its own variables, then :monosp:`<name>.X`, :monosp:`.Y`, :monosp:`.Z`, and of
             all of these the squares, :monosp:`m2_...`.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            self._nested = nested_integrators(props)
            super().__init__(props)

        def aov_names(self) -> list[str]:
            """Return the names of the channels beside the film's own."""
            names: list[str] = []
            for name, nested in self._nested:
                names += [f"{name}.{own}" for own in nested.aov_names()]
                names += [f"{name}.{c}" for c in "XYZ"]
            return [*names, *(f"m2_{name}" for name in names)]

        def sample(
            self, mode: Any, scene: Any, sampler: Any, ray: Any, active: Any = True, **kwargs: Any
        ) -> tuple[Any, ...]:
            """Evaluate along rays; see `ADIntegrator.sample` in Mitsuba for the interface."""
            channels: list[Any] = []
            L, valid = mi.Spectrum(0.0), mi.Bool(False)
            for index, (_name, nested) in enumerate(self._nested):
                value, seen, own = sample_nested(nested, scene, sampler, ray, mi.Bool(active))
                channels += [*own, *_xyz(value, ray)]
                if index == 0:
                    L, valid = value, seen
            return L, valid, [*channels, *(dr.square(x) for x in channels)], None

        def traverse(self, cb: Any) -> None:
            for index, (_name, nested) in enumerate(self._nested):
                cb.put(f"integrator_{index}", nested, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"BezierMoment[{', '.join(str(nested) for _name, nested in self._nested)}]"

    return BezierMoment


def make_stokes_class() -> type:
    """Return the class of ``bezierstokes`` for the variant that is set now."""
    base = import_module("mitsuba.python.ad.integrators.common").ADIntegrator

    class BezierStokes(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezierstokes:

        Stokes vectors with Bézier shapes (:monosp:`bezierstokes`)
        ----------------------------------------------------------

        .. pluginparameters::

         * - (Nested plugin)
           - :paramtype:`integrator`
           - The integrator whose light is measured; only one.

        Records the four entries of the Stokes vector as :monosp:`S0.R` to :monosp:`S3.B`, in the
        frame of the sensor, as Mitsuba's `stokes`. Needs a polarized variant.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            if not mi.is_polarized:
                raise BezierError.expected("bezierstokes", "a polarized variant", mi.variant())
            nested = nested_integrators(props)
            if len(nested) != 1:
                raise BezierError.expected("bezierstokes", "one nested integrator", len(nested))
            self._nested = nested[0][1]
            self._up: Any = None
            super().__init__(props)

        def aov_names(self) -> list[str]:
            """Return the names of the channels beside the film's own."""
            return [f"S{k}.{c}" for k in range(4) for c in "RGB"] + self._nested.aov_names()

        def sample_rays(self, scene: Any, sensor: Any, sampler: Any) -> tuple[Any, ...]:
            """Sample rays, and remember which way is up."""
            self._up = sensor.world_transform() @ mi.Vector3f(0, 1, 0)
            return super().sample_rays(scene, sensor, sampler)

        def sample(
            self, mode: Any, scene: Any, sampler: Any, ray: Any, active: Any = True, **kwargs: Any
        ) -> tuple[Any, ...]:
            """Evaluate along rays; see `ADIntegrator.sample` in Mitsuba for the interface."""
            value, seen, own = sample_nested(self._nested, scene, sampler, ray, mi.Bool(active))
            # from the frame that belongs to the ray to the sensor's
            turn = mi.mueller.rotate_stokes_basis(
                -ray.d, mi.mueller.stokes_basis(-ray.d), dr.cross(ray.d, self._up)
            )
            value = turn @ value
            channels = [x for k in range(4) for x in _rgb(value[k, 0], ray)]
            return value, seen, [*channels, *own], None

        def traverse(self, cb: Any) -> None:
            cb.put("integrator", self._nested, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"BezierStokes[{self._nested}]"

    return BezierStokes
