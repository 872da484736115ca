"""Path replay: derivatives of `bezierpath`, forward and reverse, in constant memory."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...errors import BezierError
from ..native.originals import original
from ..offsets import spawn_ray
from ..scene import SceneRays
from .chains import Bend, Chains, Vertex, has_delta, what_moves
from .emitters import EmitterSampling, LightSample
from .last_rays import all_end_at_once, emitters_can_be_met, goes_on, run
from .path_tracing import mis_weight, russian_roulette, skip_emitters
from .shadow_edges import shadow_edge

__all__ = ["relative", "replay", "solid_angle"]


def solid_angle(o: Any, p: Any, n: Any, active: Any) -> Any:
    """Return ``cos / distance^2`` at `p` seen from `o`: how solid angle follows area."""
    d = p - o
    square = dr.squared_norm(dr.select(active, d, 1.0))
    return dr.select(active, dr.abs_dot(n, d) / (square * dr.sqrt(square)), 1.0)


def replay(
    integrator: Any,
    mode: Any,
    scene: Any,
    sampler: Any,
    ray: Any,
    δL: Any,
    state_in: Any,
    active: Any,
) -> tuple[Any, Any, Any]:
    """Trace the paths of a primal pass again and differentiate each of their vertices.

    The estimator is that of Mitsuba's `prb` (Vicini, Speierer and Jakob, "Path replay
    backpropagation", 2021): directions of rough surfaces are sampled without derivatives. Motion
    of a vertex moves it along the fixed ray that met it; towards the next vertex and towards a
    point sampled on an emitter, which stay where they are, it changes direction and solid angle.
    Directions of ideal mirrors and glass follow their surface, and what the ray meets then moves
    with it (`chains`). What passes edges and silhouettes has no part in it.

    Parameters
    ----------
    integrator : BezierPath
    mode : dr.ADMode
        Forward or Backward.
    scene, sampler, ray, active
        As for the primal pass, the sampler in the same state.
    δL : mi.Spectrum or None
        Derivative of the loss by the radiance of each ray (Backward).
    state_in : mi.Spectrum
        The radiances that the primal pass returned.

    Returns
    -------
    derivative of the radiance (Forward; else `δL`), whether the ray met anything, what is left
    of `state_in`: roundings
    """
    if mi.is_polarized:
        raise BezierError.expected(
            "bezierpath", "a variant without polarization for derivatives", mi.variant()
        )
    rays = SceneRays(scene)
    with rays.attach(mode):
        return _replay(integrator, rays, mode, sampler, ray, δL, state_in, active)


def _replay(
    integrator: Any,
    rays: SceneRays,
    mode: Any,
    sampler: Any,
    ray: Any,
    δL: Any,
    state_in: Any,
    active: Any,
) -> tuple[Any, Any, Any]:
    scene = rays.scene
    emitters = EmitterSampling(rays)
    context = mi.BSDFContext()
    max_depth, rr_depth = integrator.max_depth, integrator.rr_depth
    hide, lights_met = integrator.hide_emitters, emitters_can_be_met(scene)
    once = all_end_at_once(scene, max_depth, lights_met)

    ray = mi.Ray3f(dr.detach(ray))
    active = mi.Bool(active)
    if max_depth == 0:
        return mi.Spectrum(0.0), dr.zeros(mi.Bool, dr.width(ray)), state_in
    if hide:
        ray = skip_emitters(rays, ray, active)

    delta = has_delta(scene)
    chains = Chains(rays, mode, bool(what_moves(scene)), delta, max_depth)
    state = {
        "ray": ray,
        "hit": rays.preliminary(ray, True, active),
        "chain": chains.initial(dr.width(ray)),
        "throughput": mi.Spectrum(1.0),
        "rest": mi.Spectrum(state_in),
        "derivative": mi.Spectrum(0.0 if δL is None else δL),
        "eta": mi.Float(1.0),
        "depth": mi.UInt32(0),
        "valid": mi.Bool(not hide and scene.environment() is not None),
        "active": active,
        "prev_si": dr.zeros(mi.SurfaceInteraction3f),
        "prev_pdf": mi.Float(1.0),
        "prev_delta": mi.Bool(True),
        "sampler": sampler,
    }

    def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
        st = dict(st)
        ray, hit, sampler, active = st["ray"], st["hit"], st["sampler"], st["active"]
        throughput, prev, arrived = st["throughput"], st["prev_si"], st["prev_delta"]
        with dr.resume_grad():
            attached = chains.arrive(st["chain"], ray)
            si, p_err = chains.meet(hit, ray, attached, arrived, active)

        # ---- emission met by the BSDF's sample
        emitted = mi.Spectrum(0.0)
        if lights_met:
            emitter = si.emitter(scene, active)
            ds = mi.DirectionSample3f(scene, si=dr.detach(si), ref=prev)
            emits = active & (emitter != None)  # noqa: E711
            if hide:
                emits = emits & ~((st["depth"] == 0) & ~si.is_valid())
            pdf = emitters.pdf(prev, ds, dr.detach(si), hit, emits & ~arrived)
            weight = mis_weight(st["prev_pdf"], pdf)
            with dr.resume_grad():
                emitted = dr.select(emits, throughput * ds.emitter.eval(si, emits) * weight, 0.0)

        active_next = active & (st["depth"] + 1 < max_depth) & si.is_valid()
        bsdf = si.bsdf(ray)
        here = dr.detach(si)

        # ---- a sample of the emitters
        smooth = active_next & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light = emitters.sample_visible(here, p_err, sampler.next_2d(active_next), smooth)
        ds = light.ds
        with dr.resume_grad():
            weight, direction = _attached_light(rays, si, here, light)
            wo = si.to_local(direction)
            value, pdf = bsdf.eval_pdf(context, si, wo, light.lit)
            mis = dr.select(ds.delta, 1.0, mis_weight(ds.pdf, pdf))
            direct = dr.select(light.lit, throughput * value * weight * mis, 0.0)

        # ---- the next ray: by the numbers and in the form of the primal pass
        sample1, sample2 = sampler.next_1d(active_next), sampler.next_2d(active_next)
        edge = mi.Spectrum(0.0)
        if chains.moves and integrator.shadow_steps:
            with dr.resume_grad():
                numbers = sample1, sample2.x
                found = shadow_edge(
                    rays, emitters, si, p_err, numbers, integrator.shadow_steps, smooth
                )
                value = bsdf.eval(context, here, here.to_local(found.d), found.found)
                edge = throughput * dr.detach(value) * found.weight * found.shift
        _value, _pdf, sample, bsdf_weight = bsdf.eval_pdf_sample(
            context, here, here.to_local(ds.d), sample1, sample2, active_next
        )
        ideal = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        next_ray = spawn_ray(here, p_err, here.to_world(sample.wo))
        rest = st["rest"] - dr.detach(emitted) - dr.detach(direct)
        throughput = throughput * bsdf_weight
        eta = st["eta"] * sample.eta
        null = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        valid = st["valid"] | (active & si.is_valid() & ~null)
        depth = dr.select(si.is_valid(), st["depth"] + 1, st["depth"])

        throughput, survives = russian_roulette(
            sampler, throughput, eta, depth >= rr_depth, active_next
        )
        active_next = goes_on(active_next & survives, depth, max_depth, null, lights_met)

        # ---- derivatives
        if once:
            next_hit, following = hit, dr.zeros(mi.SurfaceInteraction3f)
        else:
            next_hit = rays.preliminary(next_ray, False, active_next)
            following = rays.surface_interaction(
                next_hit, next_ray, mi.RayFlags.Minimal | mi.RayFlags.DetachShape, active_next
            )
        met = active_next & following.is_valid()
        bend = Bend(active_next & ideal, sample1, sample2, met, following.p)
        with dr.resume_grad():
            wo, value = mi.Vector3f(0, 0, 1), mi.Spectrum(0.0)
            if delta:  # by the same numbers, which choose the same lobe
                moved, weight = bsdf.sample(context, si, sample1, sample2, bend.delta)
                wo, value = moved.wo, weight * moved.pdf
            next_o, next_d = chains.leave(si, bend, wo, next_ray.d)
            rough = active_next & ~ideal
            value = dr.select(rough, bsdf.eval(context, si, si.to_local(next_d), rough), value)
            solid = solid_angle(si.p, following.p, following.n, met & rough)
            # `rest` is what arrives along the next ray, with the throughput up to here
            reflected = dr.select(active_next, rest * relative(value) * relative(solid), 0.0)
            total = emitted + direct + reflected + edge
            derivative, chain = st["derivative"], st["chain"]
            if not dr.grad_enabled(total) and not integrator.interior_may_be_constant:
                raise BezierError.expected(
                    "bezierpath",
                    "a parameter that the image depends on",
                    "none with derivatives enabled",
                )
            if not dr.grad_enabled(total):
                pass
            elif mode == dr.ADMode.Backward:
                vertex = Vertex(ray, attached, hit, arrived, bend)
                weighted = derivative * total
                chain = chains.step_backward(chain, weighted, vertex, active, active_next)
            else:
                change, chain = chains.step_forward(total, next_o, next_d)
                derivative = derivative + change
        return (
            {
                "ray": next_ray,
                "hit": next_hit,
                "chain": chain,
                "throughput": throughput,
                "rest": rest,
                "derivative": dr.detach(derivative),
                "eta": eta,
                "depth": depth,
                "valid": valid,
                "active": active_next,
                "prev_si": here,
                "prev_pdf": sample.pdf,
                "prev_delta": ideal,
                "sampler": sampler,
            },
        )

    try:
        state = run(state, body, once, f"bezierpath ({mode.name})")
    except RuntimeError as error:
        if isinstance(error.__cause__, BezierError):
            raise error.__cause__ from None
        raise
    return state["derivative"], state["valid"], state["rest"]


def relative(value: Any) -> Any:
    """Return 1 with the derivative of the logarithm of `value`; plain 1 where that is 0."""
    return dr.replace_grad(1.0, dr.select(value != 0, value / dr.detach(value), 1.0))


def _attached_light(rays: SceneRays, si: Any, here: Any, light: LightSample) -> tuple[Any, Any]:
    """Return weight and direction of an emitter sample, with derivatives.

    The sampled direction does not move with the emitter: where that moves, another point of it
    lies in this direction, which matters to a textured emitter. With the vertex `si` it does.
    """
    scene, ds, hit, active = rays.scene, light.ds, light.hit, light.lit
    flags = ds.emitter.flags()
    surface = active & mi.has_flag(flags, mi.EmitterFlags.Surface)
    infinite = mi.has_flag(flags, mi.EmitterFlags.Infinite)
    direction = dr.normalize(dr.select(active & ~infinite, ds.p - si.p, ds.d))
    direction = dr.replace_grad(ds.d, dr.select(active & ~infinite, direction, ds.d))

    ours = active & hit.bezier
    ray = here.spawn_ray(ds.d)
    ray.o = here.p
    there = rays.surface_interaction(hit, ray, mi.RayFlags.All, ours)
    there.wi = dr.replace_grad(there.wi, there.to_local(-direction))
    value = dr.select(ours, ds.emitter.eval(there, ours), 0.0)
    theirs = active & ~hit.bezier
    varying = theirs & surface & mi.has_flag(flags, mi.EmitterFlags.SpatiallyVarying)
    near = here.spawn_ray_to(ds.p)
    near.o = dr.fma(near.d, near.maxt, near.o)
    near.maxt = dr.largest(mi.Float)
    met = original(scene, "ray_intersect")(near, varying)
    moved = mi.DirectionSample3f(scene, met, here)
    moved.d = direction
    attached = dr.replace_grad(ds, dr.select(varying & met.is_valid(), moved, ds))
    attached.d = direction
    # the cone of a spot, and the picture of a projector, follow the vertex only in a new sample
    placed = theirs & mi.has_flag(flags, mi.EmitterFlags.DeltaPosition)
    _same, again = ds.emitter.sample_direction(si, mi.Point2f(0.5), placed)
    value += dr.select(placed, again, 0.0)
    theirs = theirs & ~placed
    value += dr.select(theirs, scene.eval_emitter_direction(si, attached, theirs), 0.0)

    inverse = dr.select(ds.pdf != 0, dr.rcp(ds.pdf), 0.0)
    weight = dr.replace_grad(light.weight, value * inverse)
    solid = solid_angle(si.p, ds.p, ds.n, surface)
    return weight * relative(solid), direction
