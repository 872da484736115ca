"""Flights through participating media, and what gets through on the way to an emitter.

A flight leads to the next *tentative* collision, at a distance sampled by a majorant of the
extinction (delta tracking; for this and ratio tracking see Novák, Georgiev, Hanika, Jarosz, "Monte
Carlo Methods for Volumetric Light Transport Simulation", 2018). In RGB variants the colour that
chooses the distance is drawn anew for each flight, and weights are taken with the mean density of
the colours. That is right for every spectrum, and less noisy than one colour for a whole path.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..interaction import Preliminary
from ..offsets import spawn_ray
from ..scene import SceneRays

__all__ = [
    "Media",
    "as_reference",
    "collision_at",
    "extinction_step",
    "flight_channel",
    "flight_weight",
    "hit_distance",
    "transmittance",
    "transmittance_by_colour",
    "with_coefficients",
]


class Media:
    """Which kinds of media a scene has, so that kernels hold nothing that is never used.

    Parameters
    ----------
    scene : mi.Scene
    initial : mi.Medium or None
        The medium of the sensor.
    """

    def __init__(self, scene: Any, initial: Any = None) -> None:
        media = [initial]
        grouped = False  # shapes of a group are not in the scene's list
        for shape in scene.shapes():
            media += [shape.interior_medium(), shape.exterior_medium()]
            grouped = grouped or "Instance" in shape.class_name()
        kinds = {bool(m.is_homogeneous()) for m in media if m is not None}
        self.homogeneous = grouped or True in kinds
        self.heterogeneous = grouped or False in kinds
        self.initial = initial

    def __bool__(self) -> bool:
        return self.homogeneous or self.heterogeneous


def flight_channel(sample: Any) -> Any:
    """Return the colour that chooses a flight's distance, from a uniform number."""
    return dr.minimum(mi.UInt32(sample * 3), 2) if mi.is_rgb else mi.UInt32(0)


def hit_distance(hit: Preliminary) -> Any:
    """Return the distance of a hit, infinite for none."""
    return dr.select(hit.pi.is_valid(), hit.pi.t, dr.inf)


def transmittance_by_colour(medium: Any, mei: Any, limit: Any, active: Any) -> tuple[Any, Any]:
    """Return transmittance and density of a flight, by colour."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = limit
    return medium.transmittance_eval_pdf(mei, si, active)


def flight_weight(medium: Any, mei: Any, limit: Any, active: Any) -> Any:
    """Return transmittance over density of a flight.

    Parameters
    ----------
    medium : mi.MediumPtr
    mei : mi.MediumInteraction3f
        ``t`` is infinite if the flight passes `limit`.
    limit : mi.Float
        Distance of a surface or of the end of the ray.
    active : mi.Bool

    Returns
    -------
    mi.UnpolarizedSpectrum
    """
    tr, pdf = transmittance_by_colour(medium, mei, limit, active)
    density = dr.mean(pdf) if mi.is_rgb else pdf[0]
    return dr.select(density > 0, tr * dr.rcp(density), 0.0)


def transmittance(
    rays: SceneRays,
    media: Media,
    ray: Any,
    medium: Any,
    sampler: Any,
    active: Any,
    reach: Any = None,
    adjoint: Any = None,
    boundaries: bool = False,
) -> Any:
    """Return what of the light gets along rays, through media and index-matched surfaces.

    Homogeneous media by their formula, others by ratio tracking, which is an unbiased estimate.
    Surfaces let pass what `eval_null_transmission` of their BSDF tells.

    Parameters
    ----------
    rays : SceneRays
    media : Media
    ray : mi.Ray3f
        Up to ``maxt``.
    medium : mi.MediumPtr
        Where it starts.
    sampler : mi.Sampler
    active : mi.Bool
    reach : mi.Float, optional
        Up to where media and patches count, as `offsets.Connection` has it: ``maxt`` or beyond.
    adjoint : callable, optional
        Takes derivatives of a part of the way: called with its weights by colour, and the sum of
        what earlier calls returned. That sum is then returned in place of the rest.
    boundaries : bool
        Whether boundaries have derivatives, which `adjoint` is to get.

    Returns
    -------
    mi.Spectrum
        A Mueller matrix in polarized variants.
    """
    reach = mi.Float(ray.maxt if reach is None else reach)
    state = {
        "ray": mi.Ray3f(ray),
        "left": reach,
        "short": mi.Float(reach - ray.maxt),
        "hit": Preliminary.miss(),
        "search": mi.Bool(active),
        "medium": mi.MediumPtr(medium),
        "through": mi.Spectrum(1.0),
        "active": mi.Bool(active),
        "sampler": sampler,
    }
    if adjoint is not None:
        state["sum"] = mi.Spectrum(0.0)

    def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
        ray, left, medium, sampler = mi.Ray3f(st["ray"]), st["left"], st["medium"], st["sampler"]
        active, through, short = st["active"], st["through"], st["short"]
        parts: list[Any] = []
        ray.maxt = left
        search = active & st["search"]
        hit = dr.select(search, rays.preliminary(ray, False, search), st["hit"])
        # Mitsuba's shapes do not count in the last part of the way: the emitter may be one
        distance = hit_distance(hit)
        distance = dr.select(hit.bezier | (distance < left - short), distance, dr.inf)
        collides = mi.Bool(False)

        if media:
            inside = active & (medium != None)  # noqa: E711
            limit = dr.minimum(distance, left)
            known = medium.is_homogeneous() if media.homogeneous else mi.Bool(False)
            sample, channel = mi.Float(0.0), mi.UInt32(0)
            if media.heterogeneous:
                sample = sampler.next_1d(inside & ~known)
                if mi.is_rgb:
                    channel = flight_channel(sampler.next_1d(inside & ~known))
            mei = medium.sample_interaction(ray, sample, channel, inside)
            collides = inside & ~known & (mei.t < limit)
            mei.t = dr.select(collides, mei.t, dr.inf)
            weight, _pdf = transmittance_by_colour(medium, mei, limit, inside)
            if media.heterogeneous:
                weight = dr.select(known, weight, flight_weight(medium, mei, limit, inside))
                weight = dr.select(collides, weight * mei.sigma_n, weight)
                ray.o = dr.select(collides, mei.p, ray.o)
                left = dr.select(collides, left - mei.t, left)
                hit.pi.t = dr.select(collides, hit.pi.t - mei.t, hit.pi.t)
            through = through * mi.Spectrum(dr.select(inside, weight, 1.0))
            if adjoint is not None:
                with dr.resume_grad():
                    moved = with_coefficients(medium, mei, inside)
                    value, _pdf = transmittance_by_colour(medium, moved, limit, inside)
                    value = dr.select(collides, value * moved.sigma_n, value)
                    parts.append(dr.select(inside, value, 1.0))

        surface = active & ~collides & (distance < left)
        si, p_err = rays.meet(hit, ray, mi.RayFlags.All, surface)
        with dr.resume_grad(when=adjoint is not None):
            passed = si.bsdf(ray).eval_null_transmission(si, surface)
            if adjoint is not None:
                parts.append(dr.select(surface, mi.unpolarized_spectrum(passed), 1.0))
            if boundaries and media:
                crosses = surface & si.is_medium_transition()
                step = extinction_step(medium, si.target_medium(ray.d), si, ray, crosses)
                t = rays.surface_interaction(hit, ray, mi.RayFlags.All, crosses).t
                parts.append(1 - step * dr.replace_grad(mi.Float(0), t))
        passed = dr.detach(passed)
        passed = si.to_world_mueller(passed, si.wi, si.wi)
        through = dr.select(surface, through * passed, through)
        onward = spawn_ray(si, p_err, ray.d)
        # The end stays where it is: what is left shrinks by the way of the origin and its error,
        # or a lamp would stand before its own points.
        way = distance if p_err is None else dr.dot(onward.o - ray.o, ray.d) + p_err
        left = dr.select(surface, left - way, left)
        ray = dr.select(surface, onward, ray)
        crosses = surface & si.is_medium_transition()
        medium = dr.select(crosses, si.target_medium(ray.d), medium)
        lit = dr.max(mi.unpolarized_spectrum(through)) != 0.0
        more = {} if adjoint is None else {"sum": adjoint(parts, st["sum"])}
        return (
            {
                "ray": ray,
                "left": left,
                "short": short,
                "hit": hit,
                "search": surface,
                "medium": medium,
                "through": through,
                "active": (collides | surface) & (left > 0.0) & lit,
                "sampler": sampler,
            }
            | more,
        )

    label = "beziervolpath: transmittance"
    (state,) = dr.while_loop((state,), cond=lambda st: st["active"], body=body, label=label)
    return state["through"] if adjoint is None else state["sum"]


def as_reference(p: Any, n: Any, like: Any) -> Any:
    """Return the point of a scattering event, as emitter sampling takes it."""
    ref = dr.zeros(mi.Interaction3f)
    ref.p, ref.n, ref.time, ref.wavelengths = p, n, like.time, like.wavelengths
    return ref


def collision_at(medium: Any, si: Any, ray: Any, active: Any) -> Any:
    """Return a collision at the point of an interaction, with the coefficients there."""
    mei = dr.zeros(mi.MediumInteraction3f, dr.width(si.p))
    mei.p, mei.t, mei.medium = si.p, si.t, medium
    mei.wi, mei.sh_frame = -ray.d, mi.Frame3f(-ray.d)
    mei.time, mei.wavelengths = ray.time, ray.wavelengths
    return with_coefficients(medium, mei, active & (medium != None))  # noqa: E711


def extinction_step(before: Any, beyond: Any, si: Any, ray: Any, active: Any) -> Any:
    """Return by how much the extinction is larger before a boundary than beyond it."""
    step = mi.UnpolarizedSpectrum(0.0)
    for medium, sign in ((before, 1.0), (beyond, -1.0)):
        inside = active & (medium != None)  # noqa: E711
        mei = collision_at(medium, si, ray, inside)
        step += dr.select(inside, sign * dr.detach(mei.sigma_t), 0.0)
    return step


def with_coefficients(medium: Any, mei: Any, active: Any) -> Any:
    """Return a collision at the same point with coefficients that have derivatives."""
    mei = mi.MediumInteraction3f(dr.detach(mei))
    mei.sigma_s, mei.sigma_n, mei.sigma_t = medium.get_scattering_coefficients(mei, active)
    mei.combined_extinction = medium.get_majorant(mei, active)
    return mei
