"""Derivatives by boundaries of media that move: what the media scatter at the boundary.

Where the boundary moves along a ray, one medium fills what the other one did. It takes away and it
scatters into the ray, per length, and all that happens beyond stays. What is taken away is the
transmittance, which path replay differentiates on the way. What is scattered in asks for the light
that arrives at the boundary, from all directions: a path of its own, for one boundary that a path
of the camera crosses. Where a ray touches a boundary its way inside has no length, so outlines of
media that nothing but their density shows have no part of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..interaction import Preliminary
from ..offsets import spawn_ray, spawn_ray_to
from ..scene import SceneRays
from .emitters import EmitterSampling
from .media import Media, as_reference, collision_at, transmittance
from .medium_adjoint import boundaries_move
from .path_tracing import mis_weight
from .primary_silhouette import splatted

__all__ = ["Crossing", "medium_boundary_image"]


@dataclass
class Crossing:
    """One of the boundaries of media that a path crosses, each as probable."""

    ray: Any = None  #: mi.Ray3f that arrives there
    hit: Any = None  #: Preliminary
    medium: Any = None  #: mi.MediumPtr before it
    throughput: Any = None  #: Spectrum
    depth: Any = None  #: UInt, scattering events before
    found: Any = None  #: UInt, how many there were
    dice: Any = None  #: mi.Sampler that chooses

    DRJIT_STRUCT = dict.fromkeys(
        ("ray", "hit", "medium", "throughput", "depth", "found", "dice"), Any
    )

    @staticmethod
    def none(ray: Any, seed: Any) -> Crossing:
        """Return the state before paths begin with `ray`."""
        dice = mi.load_dict({"type": "independent"})
        width = dr.width(ray)
        dice.seed(seed, width)
        return Crossing(
            mi.Ray3f(ray),
            Preliminary.miss(),
            dr.zeros(mi.MediumPtr, width),
            dr.zeros(mi.Spectrum, width),
            dr.zeros(mi.UInt32, width),
            dr.zeros(mi.UInt32, width),
            dice,
        )

    def kept(
        self, ray: Any, hit: Any, medium: Any, throughput: Any, depth: Any, crosses: Any
    ) -> Crossing:
        """Return the choice among those before and one more, where there is one."""
        found = self.found + dr.select(crosses, mi.UInt32(1), 0)
        keep = crosses & (self.dice.next_1d(crosses) * mi.Float(found) <= 1)
        return Crossing(
            dr.select(keep, ray, self.ray),
            dr.select(keep, hit, self.hit),
            dr.select(keep, medium, self.medium),
            dr.select(keep, throughput, self.throughput),
            dr.select(keep, depth, self.depth),
            found,
            self.dice,
        )


def medium_boundary_image(
    integrator: Any,
    trace: Callable[..., tuple[Any, Any]],
    scene: Any,
    sensor: Any,
    seed: Any,
    spp: int,
) -> Any:
    """Return an image without values that has the derivatives of in-scattering at boundaries.

    Parameters
    ----------
    integrator : BezierVolPath
    trace : callable
        Traces its paths: `beziervolpath.trace_media`.
    scene : mi.Scene
    sensor : mi.Sensor or int
    seed : int
    spp : int
        Samples per pixel.

    Returns
    -------
    TensorXf or None
        None if no boundary moves.
    """
    if not boundaries_move(scene):
        return None
    sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
    film = sensor.film()
    rays = SceneRays(scene)
    with dr.suspend_grad():
        sampler, spp = integrator.prepare(sensor, 0x2F6E2B1 ^ seed, spp, [])
        media = Media(scene, sensor.get_medium())
        if not media:
            return None
        ray, weight, position = integrator.sample_rays(scene, sensor, sampler)
        ray = mi.Ray3f(ray)
        wavelengths = ray.wavelengths
        none = Crossing.none(ray, 0x5BD1E995 ^ seed)
        active = mi.Bool(True)
        one, _valid = trace(
            integrator, scene, sampler, ray, active, sensor.get_medium(), crossing=none
        )
        dr.eval(one, weight, position, sampler)
        light, active = _scattered(integrator, trace, rays, media, sampler, one)
        value = light * weight * one.throughput * mi.Float(one.found) / spp
        dr.eval(value, active)
    with rays.attach(dr.ADMode.Backward):
        t = rays.surface_interaction(one.hit, one.ray, mi.RayFlags.All, active).t
        value = dr.select(active, value, 0.0) * dr.replace_grad(mi.Float(0), t)
    return splatted(film, mi.Point2f(position), wavelengths, value, spp, active)


def _scattered(
    integrator: Any,
    trace: Callable[..., tuple[Any, Any]],
    rays: SceneRays,
    media: Media,
    sampler: Any,
    one: Crossing,
) -> tuple[Any, Any]:
    """Return what the medium before a boundary scatters there, less what that beyond does."""
    ray = one.ray
    depth = one.depth + 1
    active = (one.found > 0) & (depth < integrator.max_depth)
    si, p_err = rays.meet(one.hit, ray, mi.RayFlags.All, active)
    beyond = si.target_medium(ray.d)
    has_before, has_beyond = one.medium != None, beyond != None  # noqa: E711
    further = has_beyond & (~has_before | (sampler.next_1d() < 0.5))
    medium = dr.select(further, beyond, one.medium)
    active = active & (has_before | has_beyond)
    factor = dr.select(has_before & has_beyond, 2.0, 1.0) * dr.select(further, -1.0, 1.0)

    mei = collision_at(medium, si, ray, active)
    phase, context = medium.phase_function(), mi.PhaseFunctionContext(sampler)
    # light from emitters
    emitters = EmitterSampling(rays)
    asks = active & medium.use_emitter_sampling()
    ref = as_reference(si.p, mi.Normal3f(0.0), ray)
    ds, weight, end_err, _end = emitters.sample_hit(ref, sampler.next_2d(asks), asks)
    asks = asks & (ds.pdf != 0.0)
    shadow = spawn_ray_to(si, p_err, ds.p, ds.n, end_err)
    into = si.target_medium(ds.d)
    through = transmittance(rays, media, shadow.ray, into, sampler, asks, shadow.reach)
    value, pdf = phase.eval_pdf(context, mei, ds.d, asks)
    mis = dr.select(ds.delta, 1.0, mis_weight(ds.pdf, pdf))
    light = dr.select(asks, mi.Spectrum(value) * weight * through * mis, 0.0)
    # light from everywhere
    d, weight, pdf = phase.sample(context, mei, sampler.next_1d(), sampler.next_2d(), active)
    dr.eval(light, d, weight, pdf, sampler)
    start = {
        "medium": si.target_medium(d),
        "depth": depth,
        "last": ref,
        "last_pdf": pdf,
        "direct": ~medium.use_emitter_sampling(),
    }
    onward = spawn_ray(si, p_err, d)
    more, _valid = trace(
        integrator, rays.scene, sampler, onward, active, media.initial, start=start
    )
    light += dr.select(active, mi.Spectrum(weight) * more, 0.0)
    return light * factor * mi.Spectrum(mei.sigma_s), active
