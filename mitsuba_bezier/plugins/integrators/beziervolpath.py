"""The integrator plugin ``beziervolpath``: Mitsuba's `volpath`, with exact Bézier shapes."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi

from ... import _runtime
from ..interaction import Preliminary
from ..offsets import spawn_ray, spawn_ray_to
from ..scene import SceneRays
from .chains import has_delta
from .depths import check_depths
from .emitters import EmitterSampling
from .media import Media, as_reference, flight_channel, flight_weight, hit_distance, transmittance
from .medium_adjoint import MediumAdjoint
from .medium_boundary import Crossing, medium_boundary_image
from .path_replay import relative
from .path_tracing import mis_weight, russian_roulette

__all__ = ["make_volpath_class"]


def make_volpath_class() -> type:
    """Return the class for the variant that is set now."""
    # Mitsuba reloads this module when the variant changes
    base = import_module("mitsuba.python.ad.integrators.common").RBIntegrator

    class BezierVolPath(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-beziervolpath:

        Volumetric path tracer with Bézier shapes (:monosp:`beziervolpath`)
        -------------------------------------------------------------------

        .. pluginparameters::

         * - max_depth
           - |int|
           - Longest path depth in the image, -1 for no limit; 1 shows directly visible
             emitters only, 2 light scattered once, and so on (Default: -1).
         * - rr_depth
           - |int|
           - Path depth beyond which Russian roulette ends paths (Default: 5).
         * - hide_emitters
           - |bool|
           - Hide directly visible emitters (Default: |false|).

        Path tracer for scenes with homogeneous and heterogeneous media, with the parameters and
        defaults of Mitsuba's `volpath`. Media are bounded by `beziertriangle` shapes, which it
        sees exactly, or by any other shape of Mitsuba. Collisions are sampled by delta tracking;
        light is sampled, too, and reaches into media through boundaries with a `null` BSDF.

        Three things differ from `volpath`: light on its way through a homogeneous medium is
        taken by the formula, not by chance; the colour that chooses a distance is drawn for each
        flight, not for each path; and hidden emitters let rays pass inside of media, too.

        Derivatives by path replay have the estimator of `prbvolpath`: by media, materials and
        lights, and by shapes with a `null` BSDF, which bound media. By other shapes that move
        they are refused.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            check_depths(props)
            super().__init__(props)
            self._sensor_medium: Any = None

        def prepare(self, sensor: Any, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
            """Make sampler and film ready; remember in which medium the sensor is."""
            self._sensor_medium = sensor.get_medium()
            return super().prepare(sensor, *args, **kwargs)

        def sample(
            self,
            mode: Any,
            scene: Any,
            sampler: Any,
            ray: Any,
            δL: Any = None,
            state_in: Any = None,
            active: Any = True,
            **kwargs: Any,
        ) -> tuple[Any, ...]:
            """Trace paths; see `ADIntegrator.sample` in Mitsuba for the interface."""
            if mode == dr.ADMode.Primal:
                L, valid = trace_media(self, scene, sampler, ray, active, self._sensor_medium)
                return L, valid, [], L
            adjoint = MediumAdjoint(scene, mode)
            with SceneRays(scene).attach(mode):
                δL, valid = trace_media(
                    self, scene, sampler, ray, active, self._sensor_medium, adjoint, δL, state_in
                )
            return δL, valid, [], state_in

        def _boundaries(self, scene: Any, sensor: Any, seed: Any, spp: int) -> Any:
            """Return an image with the derivatives of what is scattered where boundaries move."""
            return medium_boundary_image(self, trace_media, scene, sensor, seed, spp)

        def render_forward(
            self, scene: Any, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
        ) -> Any:
            """Return the derivative of the image; see `ADIntegrator.render_forward`."""
            out = super().render_forward(scene, params, sensor, seed, spp)
            image = self._boundaries(scene, sensor, seed, spp)
            if image is not None and dr.grad_enabled(image):
                dr.forward_to(image, flags=dr.ADFlag.ClearNone)
                out = out + dr.grad(image)
            return out

        def render_backward(
            self,
            scene: Any,
            params: Any,
            grad_in: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
        ) -> None:
            """Accumulate derivatives in the parameters; see `ADIntegrator.render_backward`."""
            super().render_backward(scene, params, grad_in, sensor, seed, spp)
            image = self._boundaries(scene, sensor, seed, spp)
            if image is not None and dr.grad_enabled(image):
                dr.set_grad(image, grad_in)
                dr.enqueue(dr.ADMode.Backward, image)
                dr.traverse(dr.ADMode.Backward)
            dr.eval()

        def to_string(self) -> str:
            return (
                f"BezierVolPath[\n  max_depth = {self.max_depth},\n"
                f"  rr_depth = {self.rr_depth},\n  hide_emitters = {self.hide_emitters}\n]"
            )

    return BezierVolPath


def trace_media(
    integrator: Any,
    scene: Any,
    sampler: Any,
    ray: Any,
    active: Any,
    sensor_medium: Any,
    adjoint: MediumAdjoint | None = None,
    δL: Any = None,
    radiance: Any = None,
    start: dict[str, Any] | None = None,
    crossing: Crossing | None = None,
) -> tuple[Any, Any]:
    """Trace one path a lane; return its radiance and whether it met anything.

    With `adjoint` the paths of `radiance` are traced again, and differentiated: what is returned
    is then the derivative of the radiance (Forward), or `δL` (Backward). `start` has what paths do
    not begin with as those of the sensor do; `crossing` keeps one boundary that a path crosses.
    """
    rays = SceneRays(scene)
    emitters = EmitterSampling(rays)
    media = Media(scene, sensor_medium)
    delta = adjoint is not None and has_delta(scene)
    context = mi.BSDFContext()
    max_depth, rr_depth = integrator.max_depth, integrator.rr_depth
    hide = integrator.hide_emitters

    ray = mi.Ray3f(dr.detach(ray))
    if max_depth == 0:
        return mi.Spectrum(0.0), dr.zeros(mi.Bool, dr.width(ray))
    first = dr.zeros(mi.MediumPtr) if sensor_medium is None else mi.MediumPtr(sensor_medium)
    state = {
        "ray": ray,
        "hit": Preliminary.miss(),
        "search": mi.Bool(True),  # the next hit of the ray is not known yet
        "medium": first,
        "throughput": mi.Spectrum(1.0),
        "result": mi.Spectrum(0.0),
        "eta": mi.Float(1.0),
        "depth": mi.UInt32(0),
        "valid": mi.Bool(not hide and scene.environment() is not None),
        "active": mi.Bool(active),
        # the last scattering that was no straight passage: what sampled the direction since
        "last": dr.zeros(mi.Interaction3f),
        "last_pdf": mi.Float(1.0),
        "direct": mi.Bool(True),  # emitters met now cannot have been sampled from there
        "sampler": sampler,
    }
    state |= start or {}
    if crossing is not None:
        state["crossing"] = crossing
    if adjoint is not None:  # what is to come, and the derivative
        state["result"] = mi.Spectrum(radiance)
        state["derivative"] = mi.Spectrum(0.0 if δL is None else δL)

    def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
        ray, medium, sampler = mi.Ray3f(st["ray"]), st["medium"], st["sampler"]
        active, depth, throughput = st["active"], st["depth"], st["throughput"]
        collides = scatters = mi.Bool(False)
        before = st["result"]
        more: dict[str, Any] = {}

        # ---- a flight through the medium, up to the next surface at the most
        if media:
            inside = active & (medium != None)  # noqa: E711
            channel = flight_channel(sampler.next_1d(inside)) if mi.is_rgb else mi.UInt32(0)
            mei = medium.sample_interaction(ray, sampler.next_1d(inside), channel, inside)
            if media.homogeneous:  # it ends there or before, so look no further
                ends = inside & mei.is_valid() & medium.is_homogeneous()
                ray.maxt = dr.select(ends, mei.t, ray.maxt)
        search = active & st["search"]
        hit = dr.select(search, rays.preliminary(ray, False, search), st["hit"])
        if media:
            distance = hit_distance(hit)
            collides = inside & mei.is_valid() & ~(distance < mei.t)
            mei.t = dr.select(collides, mei.t, dr.inf)
            weight = flight_weight(medium, mei, distance, inside)
            scatters = collides
            if media.heterogeneous:
                chance = dr.mean(mei.sigma_t / mei.combined_extinction)
                scatters = collides & (sampler.next_1d(collides) < chance)
                # a null collision: the ray goes on from there
                null = collides & ~scatters
                weight = dr.select(null, weight * mei.sigma_n * dr.rcp(1.0 - chance), weight)
                weight = dr.select(scatters, weight * dr.rcp(chance), weight)
                ray.o = dr.select(null, mei.p, ray.o)
                hit.pi.t = dr.select(null, hit.pi.t - mei.t, hit.pi.t)
            weight = dr.select(scatters, weight * mei.sigma_s, weight)
            flight = (medium, mei, distance, inside, scatters, collides & ~scatters)
            throughput = throughput * mi.Spectrum(dr.select(inside, weight, 1.0))
            depth = dr.select(scatters, depth + 1, depth)
            active = active & (depth < max_depth)
            scatters = scatters & active

        # ---- emission of what the ray met
        surface = active & ~collides
        si, p_err = rays.meet(hit, ray, mi.RayFlags.All, surface)
        emitter = si.emitter(scene, surface)
        ds = mi.DirectionSample3f(scene, si=si, ref=st["last"])
        emits = surface & (emitter != None)  # noqa: E711
        passes = mi.Bool(False)
        if hide:
            seen = emits & (depth == 0)
            emits = emits & ~seen
            passes = seen & si.is_valid()
        direct = st["direct"] | (depth == 0)
        pdf = emitters.pdf(st["last"], ds, si, hit, emits & ~direct)
        share = dr.select(direct, 1.0, mis_weight(st["last_pdf"], pdf))
        met = emits, si, ds.emitter, throughput * share
        emitted = dr.select(emits, met[3] * met[2].eval(si, emits), 0.0)
        result = st["result"] + emitted if adjoint is None else before - emitted
        surface = surface & si.is_valid()
        bounces = surface & ~passes
        bsdf = si.bsdf(ray)

        # ---- a sample of the emitters, from a surface or from inside of a medium
        asks = bounces & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth) & (depth + 1 < max_depth)
        ref = as_reference(si.p, si.n, ray)
        if media:
            asks = asks | (scatters & medium.use_emitter_sampling())
            ref.p, ref.n = dr.select(scatters, mei.p, si.p), dr.select(scatters, 0.0, si.n)
        ds, em_weight, end_err, end = emitters.sample_hit(ref, sampler.next_2d(asks), asks)
        asks = asks & (ds.pdf != 0.0)
        crosses = surface & si.is_medium_transition()
        if crossing is not None:  # without lights: that is all it is for
            asks = mi.Bool(False)
            more["crossing"] = st["crossing"].kept(ray, hit, medium, throughput, depth, crosses)
        into = dr.select(crosses, si.target_medium(ds.d), medium)
        shadow = spawn_ray_to(ref, p_err, ds.p, ds.n, end_err)
        again = None if adjoint is None else sampler.clone()
        through = transmittance(rays, media, shadow.ray, into, sampler, asks, shadow.reach)
        arrives = em_weight * through
        wo = si.to_local(ds.d)
        sample1, sample2 = sampler.next_1d(bounces), sampler.next_2d(bounces)
        value, pdf, sample, new_weight = bsdf.eval_pdf_sample(
            context, si, wo, sample1, sample2, bounces
        )
        value = si.to_world_mueller(value, -wo, si.wi)
        new_weight = si.to_world_mueller(new_weight, -sample.wo, si.wi)
        new_pdf, new_ray = sample.pdf, spawn_ray(si, p_err, si.to_world(sample.wo))
        if media:
            phase_context = mi.PhaseFunctionContext(sampler)
            phase = medium.phase_function()
            phase_value, phase_pdf = phase.eval_pdf(phase_context, mei, ds.d, scatters & asks)
            value = dr.select(scatters, phase_value, value)
            pdf = dr.select(scatters, phase_pdf, pdf)
            d, weight, density = phase.sample(
                phase_context, mei, sampler.next_1d(scatters), sampler.next_2d(scatters), scatters
            )
            new_weight = dr.select(scatters, weight, new_weight)
            new_pdf = dr.select(scatters, density, new_pdf)
            new_ray = dr.select(scatters, mei.spawn_ray(d), new_ray)
        mis = dr.select(ds.delta, 1.0, mis_weight(ds.pdf, pdf))
        arrived = dr.select(asks, throughput * value * arrives * mis, 0.0)
        result = result + arrived if adjoint is None else result - arrived
        if adjoint is not None:
            way = shadow.ray, into, again, asks, shadow.reach
            # before all else: a loop within takes no derivatives out of what is attached before
            change = adjoint.way(rays, media, way, arrived, st["derivative"])
            with dr.resume_grad():
                emits, seen_si, emitter, carried = met
                terms = [dr.select(emits, carried * emitter.eval(seen_si, emits), 0.0)]
                if media:
                    terms.append(before * adjoint.flight(*flight))
                if media and adjoint.boundaries:
                    there = dr.detach(si)
                    moved = adjoint.crossing(rays, hit, ray, there, medium, crosses)
                    terms.append(result * moved)
                lit = adjoint.light(rays, si, scatters, ref, ds, end, em_weight, asks)
                seen = bsdf.eval(context, si, wo, asks & ~scatters)
                leaves = bsdf.eval(context, si, sample.wo, bounces)
                if delta:
                    ideal = bounces & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
                    turned, factor = bsdf.sample(context, si, sample1, sample2, ideal)
                    leaves = dr.select(ideal, factor * turned.pdf, leaves)
                if media:
                    towards = phase.eval_pdf(phase_context, mei, ds.d, scatters & asks)[0]
                    onward = phase.eval_pdf(phase_context, mei, d, scatters)[0]
                    seen = dr.select(scatters, towards, seen)
                    leaves = dr.select(scatters, onward, leaves)
                terms.append(arrived * relative(lit) * relative(seen))
                terms.append(dr.select(bounces | scatters, result, 0.0) * relative(leaves))
                derivative = adjoint.add(st["derivative"], sum(terms)) + change

        # ---- the next ray
        turns = bounces | scatters
        new_ray = dr.select(passes, spawn_ray(si, p_err, ray.d), new_ray)
        ray = dr.select(turns | passes, new_ray, ray)
        throughput = dr.select(turns, throughput * new_weight, throughput)
        eta = dr.select(bounces, st["eta"] * sample.eta, st["eta"])
        straight = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        bends = bounces & ~straight
        depth = dr.select(bends, depth + 1, depth)
        last = dr.select(bends | scatters, ref, st["last"])
        last_pdf = dr.select(bends | scatters, new_pdf, st["last_pdf"])
        direct = st["direct"] | (bends & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta))
        direct = direct & ~(bounces & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Smooth))
        if media:
            direct = dr.select(scatters, ~medium.use_emitter_sampling(), direct)
        medium = dr.select(crosses, si.target_medium(ray.d), medium)

        active = (turns | passes | (active & collides)) & (depth < max_depth)
        plays = active & (depth > rr_depth)
        throughput, survives = russian_roulette(sampler, throughput, eta, plays, plays)
        if adjoint is not None:
            more["derivative"] = dr.detach(derivative)
        return (
            {
                "ray": ray,
                "hit": hit,
                "search": turns | passes,
                "medium": medium,
                "throughput": throughput,
                "result": result,
                "eta": eta,
                "depth": depth,
                "valid": st["valid"] | bends | scatters,
                "active": active & survives,
                "last": last,
                "last_pdf": last_pdf,
                "direct": direct,
                "sampler": sampler,
            }
            | more,
        )

    label = "beziervolpath"
    (state,) = dr.while_loop((state,), cond=lambda st: st["active"], body=body, label=label)
    if crossing is not None:
        return state["crossing"], state["valid"]
    return state["result" if adjoint is None else "derivative"], state["valid"]
