"""Derivatives of an image by silhouettes that surfaces see: shadows, reflections, occlusion."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.curvature import evaluate_second
from .attached import attached_tables, is_attached
from .bezierpath import trace
from .primary_silhouette import surface_at
from .scene import SceneRays
from .silhouette import BoundarySample, Discrete, SilhouetteCurves, outward

__all__ = ["indirect_silhouette_image", "sample_boundary"]


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
        boundary = sample_boundary(data, numbers, sample, mi.Bool(True))
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
    p, _pu, _pv = tables.partials(boundary.patch, boundary.u, boundary.v, active)
    moving = dr.select(active, dr.dot(p, boundary.n), 0.0)
    value = dr.select(active, value, 0.0) * dr.replace_grad(mi.Float(0), moving)

    block = film.create_block(normalize=True)
    block.set_coalesce(block.coalesce() and spp >= 4)
    block.put(
        pos=position,
        wavelengths=wavelengths,
        value=value,
        weight=0,
        alpha=1,
        active=active,
    )
    film.put_block(block)
    return film.develop()


def sample_boundary(data: Any, numbers: list[int], sample: Any, active: Any) -> BoundarySample:
    """Sample lines that touch shapes of a structure.

    Parameters
    ----------
    data : SceneData
    numbers : list of int
        Which of its shapes; each is as probable.
    sample : Point3f
        Uniform in the unit cube. The first is used for the kind, the shape and the angle.
    active : Bool
    """
    curves = SilhouetteCurves(data, numbers, None)
    x = sample.x
    is_edge = mi.Bool(False)
    choice = mi.Float(1)
    if len(curves):
        is_edge = x < 0.5
        choice = mi.Float(0.5)
        x = dr.minimum(dr.select(is_edge, 2 * x, 2 * x - 1), dr.one_minus_epsilon(mi.Float))
    surface = _tangents(data, numbers, mi.Point3f(x, sample.y, sample.z), active & ~is_edge)
    if not len(curves):
        return surface
    edges = _edge_lines(curves, mi.Point3f(x, sample.y, sample.z), active & is_edge)
    out = dr.select(is_edge, edges, surface)
    out.pdf = out.pdf * choice
    return out


def _tangents(data: Any, numbers: list[int], sample: Any, active: Any) -> BoundarySample:
    sampling = data.surface_sampling(tuple(numbers))
    scaled = sample.x * len(numbers)
    which = dr.minimum(mi.UInt32(scaled), len(numbers) - 1)
    angle = dr.two_pi * (scaled - mi.Float(which))
    patch, u, v, linear = sampling.sample_parameters(which, mi.Point2f(sample.y, sample.z), active)
    ps = sampling.position(patch, u, v, linear, active)
    frame = mi.Frame3f(ps.n)
    sine, cosine = dr.sincos(angle)
    d = frame.s * cosine + frame.t * sine
    tables = data.tables
    h = evaluate_second(tables.nets, tables.degree, patch, u, v, active)
    n, curvature = outward(h, d)
    out = BoundarySample(patch, u, v, ps.p, d, n, curvature)
    out.pdf = ps.pdf * dr.inv_two_pi / len(numbers)
    out.is_edge = mi.Bool(False)
    out.valid = active & (ps.pdf > 0) & dr.isfinite(curvature) & (curvature > 0)
    return out


def _edge_lines(curves: SilhouetteCurves, sample: Any, active: Any) -> BoundarySample:
    a, b = curves.ends()
    choice = Discrete(np.linalg.norm(b - a, axis=1))
    index, s, pmf = choice.sample(sample.x, active)
    d = mi.warp.square_to_uniform_sphere(mi.Point2f(sample.y, sample.z))
    point = curves.point(index, s, active)
    length = dr.norm(point.tangent)
    sine = dr.norm(dr.cross(d, point.tangent)) / length
    n = curves.edge_normal(d, point.patch, point.u, point.v, point.tangent, active)
    out = BoundarySample(point.patch, point.u, point.v, point.p, d, n, sine)
    out.pdf = pmf / length / (4 * dr.pi)
    out.is_edge = mi.Bool(True)
    out.valid = active & point.valid & (length > 0) & (sine > 0)
    return out


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
        "active": mi.Bool(active),
        "sampler": sampler,
    }

    def body(st: dict) -> tuple[dict]:
        st = dict(st)
        ray, sampler, active = st["ray"], st["sampler"], st["active"]
        si = rays.intersect(ray, mi.RayFlags.All, False, active)
        active = active & si.is_valid()
        bsdf = si.bsdf()
        smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        ds, weight = sensor.sample_direction(si, sampler.next_2d(), smooth)
        smooth = smooth & (ds.pdf > 0) & dr.any(weight > 0)
        smooth = smooth & ~rays.test(si.spawn_ray_to(ds.p), smooth)
        value = bsdf.eval(context, si, si.to_local(ds.d), smooth)
        value = st["throughput"] * value * weight / ds.pdf
        found = st["found"] + dr.select(smooth, mi.UInt32(1), 0)
        keep = smooth & (sampler.next_1d() * mi.Float(found) <= 1)

        depth = st["depth"] + 1
        active = active & (depth < integrator.max_depth)
        sample, bsdf_weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        throughput = st["throughput"] * bsdf_weight
        return (
            {
                "ray": si.spawn_ray(si.to_world(sample.wo)),
                "throughput": throughput,
                "kept": dr.select(keep, value, st["kept"]),
                "position": dr.select(keep, ds.uv, st["position"]),
                "vertices": dr.select(keep, st["depth"], st["vertices"]),
                "depth": depth,
                "found": found,
                "active": active & dr.any(throughput != 0),
                "sampler": sampler,
            },
        )

    (state,) = dr.while_loop(
        (state,), cond=lambda st: st["active"], body=body, label="bezier importance"
    )
    found = state["found"]
    return state["kept"] * mi.Float(found), state["position"], state["vertices"], found > 0
