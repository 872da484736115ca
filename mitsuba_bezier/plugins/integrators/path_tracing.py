"""One path a lane: the estimator of `bezierpath`, and what all path tracers here share."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..interaction import Preliminary
from ..offsets import spawn_ray
from ..scene import SceneRays
from .emitters import EmitterSampling
from .last_rays import all_end_at_once, emitters_can_be_met, goes_on, run

__all__ = ["mis_weight", "russian_roulette", "skip_emitters", "trace"]


def mis_weight(pdf_a: Any, pdf_b: Any) -> Any:
    """Return the weight of strategy a under the power heuristic.

    By the ratio of the densities: in the plane of a light its density comes near 1e20, whose
    square is infinite.
    """
    usable = (pdf_a > 0) & (pdf_a < dr.inf)
    return dr.detach(dr.select(usable, dr.rcp(1 + dr.square(pdf_b / pdf_a)), 0), True)


def russian_roulette(
    sampler: Any, throughput: Any, eta: Any, plays: Any, draws: Any
) -> tuple[Any, Any]:
    """End paths by chance where they carry little.

    Parameters
    ----------
    sampler : mi.Sampler
    throughput : Spectrum
    eta : Float
        Its square undoes the solid angle compression of refraction.
    plays : Bool
        Paths that are long enough.
    draws : Bool
        Paths that take a number, these among them.

    Returns
    -------
    throughput : Spectrum
    survives : Bool
        Also of those that do not play, unless they carry nothing.
    """
    strongest = dr.max(mi.unpolarized_spectrum(throughput))
    survive = dr.minimum(strongest * dr.square(eta), 0.95)
    goes_on = sampler.next_1d(draws) < survive
    throughput = dr.select(plays, throughput * dr.rcp(survive), throughput)
    return throughput, (~plays | goes_on) & (strongest != 0.0)


def skip_emitters(rays: SceneRays, ray: Any, active: Any) -> Any:
    """Move rays past directly visible area lights; return the rays."""
    if not any(shape.is_emitter() for shape in rays.scene.shapes()):
        return ray

    def body(ray: Any, seen: Any) -> tuple[Any, ...]:
        hit = rays.preliminary(ray, True, seen)
        seen = seen & hit.pi.is_valid() & (hit.pi.shape.emitter() != None)  # noqa: E711
        moved = spawn_ray(*rays.meet(hit, ray, mi.RayFlags.Minimal, seen), ray.d)
        ray.o = dr.select(seen, moved.o, ray.o)
        return ray, seen

    ray, _seen = dr.while_loop(
        (ray, mi.Bool(active)),
        cond=lambda ray, seen: seen,
        body=body,
        label="bezierpath: hide emitters",
    )
    return ray


def trace(
    integrator: Any,
    scene: Any,
    sampler: Any,
    ray: Any,
    active: Any,
    start: Preliminary | None = None,
    vertices: Any = 0,
) -> tuple[Any, Any]:
    """Trace one path a lane; return its radiance and whether it met anything.

    Parameters
    ----------
    integrator : BezierPath
    scene : mi.Scene
    sampler : mi.Sampler
    ray : mi.Ray3f
    active : Bool
    start : Preliminary, optional
        What the rays hit, if that is known.
    vertices : int or UInt32
        Number of vertices before those of `ray`.
    """
    rays = SceneRays(scene)
    emitters = EmitterSampling(rays)
    context = mi.BSDFContext()
    max_depth, rr_depth = integrator.max_depth, integrator.rr_depth
    hide, met = integrator.hide_emitters, emitters_can_be_met(scene)

    ray = mi.Ray3f(dr.detach(ray))
    active = mi.Bool(active)
    if max_depth == 0:  # as `path`: black, not even what is seen directly
        return mi.Spectrum(0.0), dr.zeros(mi.Bool, dr.width(ray))
    if hide and start is None and isinstance(vertices, int):
        ray = skip_emitters(rays, ray, active)
    once = all_end_at_once(scene, max_depth, met)

    state = {
        "ray": ray,
        "throughput": mi.Spectrum(1.0),
        "result": mi.Spectrum(0.0),
        "eta": mi.Float(1.0),
        "depth": mi.UInt32(vertices),
        "valid": mi.Bool(not hide and scene.environment() is not None),
        "active": active,
        "prev_si": dr.zeros(mi.Interaction3f),
        "prev_pdf": mi.Float(1.0),
        "prev_delta": mi.Bool(True),
        "sampler": sampler,
    }

    def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
        st = dict(st)
        ray, sampler, active = st["ray"], st["sampler"], st["active"]
        if start is None:
            hit = rays.preliminary(ray, False, active)
        elif once:
            hit = start
        else:
            first = st["depth"] == vertices
            hit = dr.select(first, start, rays.preliminary(ray, False, active & ~first))
        si, p_err = rays.meet(hit, ray, mi.RayFlags.All, active)

        # ---- emission met by the BSDF's sample
        result = st["result"]
        if met:
            emitter = si.emitter(scene, active)
            prev = dr.zeros(mi.SurfaceInteraction3f)
            prev.p, prev.n, prev.time = st["prev_si"].p, st["prev_si"].n, st["prev_si"].time
            prev.wavelengths = st["prev_si"].wavelengths
            ds = mi.DirectionSample3f(scene, si=si, ref=prev)
            emits = active & (emitter != None)  # noqa: E711
            if hide:
                emits = emits & ~((st["depth"] == 0) & ~si.is_valid())
            pdf = emitters.pdf(prev, ds, si, hit, emits & ~st["prev_delta"])
            weight = mis_weight(st["prev_pdf"], pdf)
            result = result + dr.select(
                emits, st["throughput"] * ds.emitter.eval(si, emits) * weight, 0.0
            )

        active_next = active & (st["depth"] + 1 < max_depth) & si.is_valid()
        bsdf = si.bsdf(ray)

        # ---- a sample of the emitters
        smooth = active_next & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        light = emitters.sample_visible(si, p_err, sampler.next_2d(active_next), smooth)
        ds = light.ds
        wo = si.to_local(ds.d)
        value, pdf, sample, bsdf_weight = bsdf.eval_pdf_sample(
            context, si, wo, sampler.next_1d(active_next), sampler.next_2d(active_next), active_next
        )
        value = si.to_world_mueller(value, -wo, si.wi)
        mis = dr.select(ds.delta, 1.0, mis_weight(ds.pdf, pdf))
        result = result + dr.select(light.lit, st["throughput"] * value * light.weight * mis, 0.0)

        # ---- the next ray
        bsdf_weight = si.to_world_mueller(bsdf_weight, -sample.wo, si.wi)
        ray = spawn_ray(si, p_err, si.to_world(sample.wo))
        throughput = st["throughput"] * bsdf_weight
        eta = st["eta"] * sample.eta
        null = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        valid = st["valid"] | (active & si.is_valid() & ~null)
        depth = dr.select(si.is_valid(), st["depth"] + 1, st["depth"])

        throughput, survives = russian_roulette(
            sampler, throughput, eta, depth >= rr_depth, active_next
        )

        prev_si = dr.zeros(mi.Interaction3f)
        prev_si.p, prev_si.n, prev_si.time = si.p, si.n, si.time
        prev_si.wavelengths, prev_si.t = si.wavelengths, si.t
        return (
            {
                "ray": ray,
                "throughput": throughput,
                "result": result,
                "eta": eta,
                "depth": depth,
                "valid": valid,
                "active": goes_on(active_next & survives, depth, max_depth, null, met),
                "prev_si": prev_si,
                "prev_pdf": sample.pdf,
                "prev_delta": mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta),
                "sampler": sampler,
            },
        )

    state = run(state, body, once, "bezierpath")
    return state["result"], state["valid"]
