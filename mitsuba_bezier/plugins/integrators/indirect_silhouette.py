"""Derivatives of an image by silhouettes that surfaces see: shadows, reflections, occlusion."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..attached import attached_tables, is_attached
from ..boundary_lines import BoundaryLines
from ..offsets import spawn_ray, spawn_ray_to
from ..scene import SceneRays
from .path_tracing import trace
from .primary_silhouette import splatted, surface_at

__all__ = ["indirect_silhouette_image"]


def indirect_silhouette_image(integrator: Any, scene: Any, sensor: Any, seed: Any, spp: int) -> Any:
    """Return an image without values that has the derivatives of silhouettes seen indirectly.

    The integral is over all lines that touch a moving shape: points of the surface and tangent
    directions, with the normal curvature as density, and points of edges and all directions, with
    the sine to the edge (Zhang, Roussel and Jakob, "Projective sampling for differentiable
    rendering of geometry", 2023). A line is followed backwards to the surface that sees the
    silhouette there, and from that, by up to `max_depth` bounces, to the camera. Lights of no
    extent, whose shadows are borders, are met by no such line.

    Parameters and return value are those of `primary_silhouette_image`.
    """
    if integrator.max_depth < 2:
        return None
    rays = SceneRays(scene)
    data = rays.data
    numbers = [i for i, s in enumerate(data.shapes) if is_attached(s)] if data else []
    if not numbers:
        return None
    assert data is not None
    film = sensor.film()
    with dr.suspend_grad():
        sampler, spp = integrator.prepare(sensor, 0x9E3779B9 ^ seed, spp, [])
        sample = mi.Point3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d())
        lines = BoundaryLines(data, numbers)
        boundary = lines.sample(sample, mi.Bool(True))
        wavelength_sample = sampler.next_1d() if mi.is_spectral else mi.Float(0)
        wavelengths, weight = sensor.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), wavelength_sample, boundary.valid
        )
        # off the surface by some roundings: the line only touches it
        reach = mi.math.ShadowEpsilon * (1 + dr.max(dr.abs(boundary.p)))
        origin = boundary.p + reach * boundary.n
        ray = dr.zeros(mi.Ray3f, dr.width(origin))
        ray.o, ray.d, ray.maxt = origin, -boundary.d, dr.largest(mi.Float)
        ray.wavelengths, ray.time = wavelengths, sensor.shutter_open()
        importance, position, vertices, active = _importance(
            integrator, rays, sensor, sampler, ray, boundary.valid
        )
        ray.d = boundary.d
        background, _valid = trace(integrator, scene, sampler, ray, active, vertices=vertices)
        ray, start = surface_at(data, boundary, boundary.d, reach, ray, active)
        foreground, _valid = trace(integrator, scene, sampler, ray, active, start, vertices)
        value = weight * importance * (foreground - background)
        value *= dr.select(active, boundary.density / (boundary.pdf * spp), 0.0)
        active = active & dr.any(value != 0)

    tables = attached_tables(data.tables, data.shapes)
    p = lines.edges.moving(tables, boundary, active)
    moving = dr.select(active, dr.dot(p, boundary.n), 0.0)
    value = dr.select(active, value, 0.0) * dr.replace_grad(mi.Float(0), moving)

    return splatted(film, position, wavelengths, value, spp, active)


def _importance(
    integrator: Any, rays: SceneRays, sensor: Any, sampler: Any, ray: Any, active: Any
) -> tuple[Any, Any, Any, Any]:
    """Follow rays to surfaces that the camera sees.

    Of the vertices met, one that can be connected is kept, each with the same probability.

    Returns
    -------
    importance, film position, number of vertices from the camera on, whether there is one
    """
    context = mi.BSDFContext(mi.TransportMode.Importance)
    state = {
        "ray": mi.Ray3f(ray),
        "throughput": mi.Spectrum(1.0),
        "kept": mi.Spectrum(0.0),
        "position": mi.Point2f(0.0),
        "vertices": mi.UInt32(0),
        "depth": mi.UInt32(1),
        "found": mi.UInt32(0),
        "turned": mi.Bool(False),  # by ideal surfaces only, so far
        "active": mi.Bool(active),
        "sampler": sampler,
    }

    def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
        st = dict(st)
        ray, sampler, active = st["ray"], st["sampler"], st["active"]
        hit = rays.preliminary(ray, False, active)
        si, p_err = rays.meet(hit, ray, mi.RayFlags.All, active)
        active = active & si.is_valid()
        bsdf = si.bsdf()
        # what this surface sees in mirrors and through glass is for `rough_outlines`
        smooth = active & ~st["turned"] & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        ds, weight = sensor.sample_direction(si, sampler.next_2d(), smooth)
        smooth = smooth & (ds.pdf > 0) & dr.any(weight > 0)
        smooth = smooth & ~rays.is_blocked(spawn_ray_to(si, p_err, ds.p), smooth)
        value = bsdf.eval(context, si, si.to_local(ds.d), smooth)
        value = st["throughput"] * value * weight / ds.pdf
        found = st["found"] + dr.select(smooth, mi.UInt32(1), 0)
        keep = smooth & (sampler.next_1d() * mi.Float(found) <= 1)

        depth = st["depth"] + 1
        active = active & (depth < integrator.max_depth)
        sample, bsdf_weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        throughput = st["throughput"] * bsdf_weight
        ideal = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        turned = ideal & (st["turned"] | (st["depth"] == 1))
        return (
            {
                "ray": spawn_ray(si, p_err, si.to_world(sample.wo)),
                "throughput": throughput,
                "kept": dr.select(keep, value, st["kept"]),
                "position": dr.select(keep, ds.uv, st["position"]),
                "vertices": dr.select(keep, st["depth"], st["vertices"]),
                "depth": depth,
                "found": found,
                "turned": turned,
                "active": active & dr.any(throughput != 0),
                "sampler": sampler,
            },
        )

    (state,) = dr.while_loop(
        (state,), cond=lambda st: st["active"], body=body, label="bezier importance"
    )
    found = state["found"]
    return state["kept"] * mi.Float(found), state["position"], state["vertices"], found > 0
