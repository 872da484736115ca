"""The integrators ``bezierdirect`` and ``bezierdepth``: Mitsuba's `direct` and `depth`."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi

from ... import _runtime
from ...errors import BezierError
from ..offsets import spawn_ray
from ..scene import SceneRays
from .depths import check_count
from .emitters import EmitterSampling
from .path_tracing import mis_weight, skip_emitters

__all__ = ["make_depth_class", "make_direct_class"]


def make_depth_class() -> type:
    """Return the class of ``bezierdepth`` for the variant that is set now."""
    base = import_module("mitsuba.python.ad.integrators.common").ADIntegrator

    class BezierDepth(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezierdepth:

        Depth with Bézier shapes (:monosp:`bezierdepth`)
        ------------------------------------------------

        Returns the distance along the ray to what it meets first, 0 where that is nothing. It has
        no parameters, as Mitsuba's `depth`.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            super().__init__(props)

        def sample(
            self, mode: Any, scene: Any, sampler: Any, ray: Any, active: Any = True, **kwargs: Any
        ) -> tuple[Any, ...]:
            """Return depths; see `ADIntegrator.sample` in Mitsuba for the interface."""
            hit = SceneRays(scene).preliminary(ray, True, mi.Bool(active))
            valid = hit.pi.is_valid()
            return mi.Spectrum(dr.select(valid, hit.pi.t, 0.0)), valid, [], None

        def to_string(self) -> str:
            return "BezierDepth[]"

    return BezierDepth


def make_direct_class() -> type:
    """Return the class of ``bezierdirect`` for the variant that is set now."""
    base = import_module("mitsuba.python.ad.integrators.common").ADIntegrator

    class BezierDirect(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezierdirect:

        Direct light with Bézier shapes (:monosp:`bezierdirect`)
        --------------------------------------------------------

        .. pluginparameters::

         * - shading_samples
           - |int|
           - Sets both of the following (Default: 1).
         * - emitter_samples, bsdf_samples
           - |int|
           - Samples of emitters and of the BSDF at each visible point (Default:
             `shading_samples`). One of them may be 0.
         * - hide_emitters
           - |bool|
           - Hide directly visible emitters (Default: |false|).

        Mitsuba's `direct`, whose estimator it has, with exact Bézier shapes. Derivatives: use
        `bezierpath` with ``max_depth`` 2, or `bezier_direct_projective`.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            if "shading_samples" in props and (
                "emitter_samples" in props or "bsdf_samples" in props
            ):
                raise BezierError.expected(
                    "shading_samples", "not together with emitter_samples or bsdf_samples", "both"
                )
            both = check_count("shading_samples", props.get("shading_samples", 1))
            self.emitter_samples, self.bsdf_samples = (
                check_count(key, props.get(key, both))
                for key in ("emitter_samples", "bsdf_samples")
            )
            if self.emitter_samples + self.bsdf_samples == 0:
                raise BezierError.expected("shading_samples", "at least one sample", "none")
            super().__init__(props)

        def sample(
            self, mode: Any, scene: Any, sampler: Any, ray: Any, active: Any = True, **kwargs: Any
        ) -> tuple[Any, ...]:
            """Return radiances; see `ADIntegrator.sample` in Mitsuba for the interface."""
            if mode != dr.ADMode.Primal:
                raise BezierError.expected(
                    "bezierdirect",
                    "an integrator with derivatives: bezierpath with max_depth 2, or "
                    "bezier_direct_projective",
                    "bezierdirect",
                )
            rays = SceneRays(scene)
            emitters = EmitterSampling(rays)
            context = mi.BSDFContext()
            lights, scatterings = self.emitter_samples, self.bsdf_samples
            share = 1.0 / (lights + scatterings)
            ray = mi.RayDifferential3f(ray)
            active = mi.Bool(active)

            if self.hide_emitters:
                moved = skip_emitters(rays, mi.Ray3f(ray), active)
                ray.o = moved.o
            hit = rays.preliminary(ray, True, active)
            si, p_err = rays.meet(hit, ray, mi.RayFlags.All, active)
            result = mi.Spectrum(0.0)
            if not self.hide_emitters:
                result += si.emitter(scene, active).eval(si, active)
            valid = active & si.is_valid()

            bsdf = si.bsdf(ray)
            smooth = valid & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            for _ in range(lights):
                light = emitters.sample_visible(si, p_err, sampler.next_2d(smooth), smooth)
                ds = light.ds
                wo = si.to_local(ds.d)
                value, pdf = bsdf.eval_pdf(context, si, wo, light.lit)
                value = si.to_world_mueller(value, -wo, si.wi)
                mis = dr.select(ds.delta, 1.0, mis_weight(ds.pdf * lights, pdf * scatterings))
                result += dr.select(light.lit, value * light.weight * mis / lights, 0.0)

            for _ in range(scatterings):
                sample, value = bsdf.sample(
                    context, si, sampler.next_1d(valid), sampler.next_2d(valid), valid
                )
                value = si.to_world_mueller(value, -sample.wo, si.wi)
                goes_on = valid & dr.any(mi.unpolarized_spectrum(value) != 0.0)
                onward = spawn_ray(si, p_err, si.to_world(sample.wo))
                hit = rays.preliminary(onward, False, goes_on)
                met = rays.surface_interaction(hit, onward, mi.RayFlags.All, goes_on)
                emitter = met.emitter(scene, goes_on)
                emits = goes_on & (emitter != None)  # noqa: E711
                delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
                ds = mi.DirectionSample3f(scene, met, si)
                pdf = emitters.pdf(si, ds, met, hit, emits & ~delta)
                mis = mis_weight(sample.pdf * scatterings * share, pdf * lights * share)
                result += dr.select(
                    emits, value * emitter.eval(met, emits) * mis / scatterings, 0.0
                )
            return result, valid, [], None

        def to_string(self) -> str:
            return (
                f"BezierDirect[\n  emitter_samples = {self.emitter_samples},\n"
                f"  bsdf_samples = {self.bsdf_samples},\n  hide_emitters = {self.hide_emitters}\n]"
            )

    return BezierDirect
