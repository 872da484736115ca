"""The integrator ``bezierptracer``: Mitsuba's `ptracer`, with exact Bézier shapes.

Light is followed from the emitters, and each point that it reaches is connected to the sensor. So
caustics converge that a path tracer meets by chance only.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ... import _runtime
from ...errors import BezierError
from ..offsets import own_error, spawn_ray, spawn_ray_to
from ..scene import SceneRays
from .depths import check_depths
from .emitters import EmitterSampling
from .light_replay import LightReplay, correction, shutter_time
from .path_tracing import russian_roulette

__all__ = ["make_ptracer_class"]


def make_ptracer_class() -> type:
    """Return the class for the variant that is set now."""

    class BezierPTracer(mi.AdjointIntegrator):
        r"""
        .. _integrator-bezierptracer:

        Particle tracer with Bézier shapes (:monosp:`bezierptracer`)
        ------------------------------------------------------------

        .. pluginparameters::

         * - max_depth
           - |int|
           - Longest path depth in the image, -1 for no limit; 1 shows directly visible
             emitters only (Default: -1).
         * - rr_depth
           - |int|
           - Path depth from which Russian roulette ends paths (Default: 5).
         * - hide_emitters
           - |bool|
           - Hide directly visible emitters (Default: |false|).
         * - samples_per_pass
           - |int|
           - Samples per pixel of one pass (Default: all).

        Mitsuba's `ptracer`, whose estimator it has. What the sensor sees in mirrors and through
        glass is not in the picture: such points cannot be connected to it. It has no media. In
        polarized variants it keeps the order of the matrices, as path tracers do.

        Derivatives, forward and reverse, follow mirrors and glass to what they light, whose place
        in the image moves; they need a reconstruction filter without a step, as `gaussian`.

        .. code-block:: python

            mi.load_dict({"type": "bezierptracer", "max_depth": 8})
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            check_depths(props)
            #: Path depths, as numbers that Dr.Jit compares without a sign.
            depth = props["max_depth"]
            self.longest = 0xFFFFFFFF if depth < 0 else depth
            self.roulette_from = props["rr_depth"]
            self.hides = bool(props.get("hide_emitters", False))
            super().__init__(props)

        def sample(
            self, scene: Any, sensor: Any, sampler: Any, block: Any, sample_scale: float
        ) -> None:
            """Trace one path of light a lane and splat what arrives at the sensor."""
            splat = _Splat(SceneRays(scene), sensor, sampler, block, sample_scale)
            if self.longest > 0 and not self.hides:
                _visible_emitters(splat)
            if self.longest > 1:
                _trace(splat, self.longest, self.roulette_from)

        def render_forward(
            self, scene: Any, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
        ) -> Any:
            """Return the derivative of the image."""
            with dr.suspend_grad():
                render = _Derivative(self, scene, sensor, seed, spp, dr.ADMode.Forward)
                film, shape = render.film, render.film.create_block().tensor().shape
                image = dr.zeros(mi.Float, dr.prod(shape))
                render.run(image, shape[2])
                tensor = mi.TensorXf(image, shape=shape)
                film.put_block(mi.ImageBlock(tensor, mi.ScalarPoint2i(film.crop_offset())))
                return film.develop()

        def render_backward(
            self,
            scene: Any,
            params: Any,
            grad_in: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
        ) -> None:
            """Accumulate derivatives in the parameters."""
            with dr.suspend_grad():
                render = _Derivative(self, scene, sensor, seed, spp, dr.ADMode.Backward)
                film, shape = render.film, render.film.create_block().tensor().shape
                with dr.resume_grad():  # the film is linear: its adjoint
                    tensor = dr.zeros(mi.TensorXf, shape)
                    dr.enable_grad(tensor)
                    film.put_block(mi.ImageBlock(tensor, mi.ScalarPoint2i(film.crop_offset())))
                    developed = film.develop()
                    dr.set_grad(developed, grad_in)
                    dr.enqueue(dr.ADMode.Backward, developed)
                    dr.traverse(dr.ADMode.Backward)
                    adjoint = dr.grad(tensor)
                render.run(adjoint.array, shape[2])
                dr.eval()

        def to_string(self) -> str:
            depth = -1 if self.longest == 0xFFFFFFFF else self.longest
            return (
                f"BezierPTracer[\n  max_depth = {depth},\n  rr_depth = {self.roulette_from},\n"
                f"  hide_emitters = {self.hides}\n]"
            )

    return BezierPTracer


class _Derivative:
    """One render of derivatives: its sampler, film and scale, as in `mi.AdjointIntegrator`."""

    def __init__(
        self, integrator: Any, scene: Any, sensor: Any, seed: Any, spp: int, mode: Any
    ) -> None:
        if mi.is_polarized:
            raise BezierError.expected(
                "bezierptracer", "a variant without polarization for derivatives", mi.variant()
            )
        self.integrator, self.scene, self.mode, self.seed = integrator, scene, mode, seed
        self.sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        self.film = self.sensor.film()
        self.sampler = self.sensor.sampler().clone()
        if spp:
            self.sampler.set_sample_count(spp)
        self.spp = self.sampler.sample_count()
        self.film.prepare([])

    def run(self, image: Any, channels: int) -> None:
        """Trace the light; see `LightReplay` for the image."""
        integrator, sampler = self.integrator, self.sampler
        size, crop = self.film.size(), self.film.crop_size()
        count = int(size[0]) * int(size[1]) * self.spp
        sampler.set_samples_per_wavefront(self.spp)
        scale = int(crop[0]) * int(crop[1]) / count
        rays = SceneRays(self.scene)
        with rays.attach(self.mode):
            replay = LightReplay(integrator, rays, self.sensor, self.mode, image, channels, scale)
            if integrator.longest > 0 and not integrator.hides:
                sampler.seed(0x9E3779B9 ^ self.seed, count)
                replay.sampler = sampler
                with dr.resume_grad():
                    _visible_emitters(replay)
            if integrator.longest < 2:
                return
            rest = None
            if self.mode == dr.ADMode.Backward:
                sampler.seed(self.seed, count)
                rest = replay.trace(sampler)
                dr.eval(rest)
            sampler.seed(self.seed, count)
            replay.trace(sampler, rest)


class _Splat:
    """What connects points to the sensor: scene, sensor, samples and the image."""

    def __init__(
        self, rays: SceneRays, sensor: Any, sampler: Any, block: Any, scale: float
    ) -> None:
        self.rays, self.sensor, self.sampler = rays, sensor, sampler
        self.block, self.scale = block, scale
        self.emitters = EmitterSampling(rays)

    def time(self) -> Any:
        """Return when light leaves."""
        return shutter_time(self.sensor, self.sampler)

    def connect(self, si: Any, p_err: Any, ds: Any, value: Any, alpha: float, active: Any) -> None:
        """Add `value`, the light from `si` towards the sensor, unless something is between."""
        active = active & (ds.pdf > 0) & dr.any(mi.unpolarized_spectrum(value) != 0)
        active = active & ~self.rays.is_blocked(spawn_ray_to(si, p_err, ds.p), active)
        position = ds.uv + mi.Vector2f(self.block.offset())
        # no weights: the scale alone makes an estimate of the sum
        self.block.put(
            position, si.wavelengths, value * self.scale, mi.Float(alpha), mi.Float(0.0), active
        )


def _visible_emitters(splat: _Splat | LightReplay) -> None:
    """Connect points on emitters to the sensor."""
    scene, sampler, sensor = splat.rays.scene, splat.sampler, splat.sensor
    time = splat.time()
    index, weight, _rest = scene.sample_emitter(sampler.next_1d())
    emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), index)
    active = ~mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)

    # far away: directions seen from the sensor, whose density turns into one by area
    infinite = active & mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite)
    eye = dr.zeros(mi.Interaction3f)
    eye.time = time
    eye.p = sensor.world_transform().translation()
    ds, _value = emitter.sample_direction(eye, sampler.next_2d(active), infinite)
    far = mi.SurfaceInteraction3f(ds, eye.wavelengths)
    far_weight = dr.select(ds.pdf > 0, dr.square(ds.dist) / ds.pdf, 0.0)

    ps, near_weight, owner, p_err = splat.emitters.sample_position(
        index, time, sampler.next_2d(active), active & ~infinite
    )
    near = mi.SurfaceInteraction3f(ps, eye.wavelengths)
    si = dr.select(infinite, far, near)

    sensor_ds, importance = sensor.sample_direction(si, sampler.next_2d(), active)
    si.wi = sensor_ds.d
    si.shape = dr.select(infinite, dr.zeros(mi.ShapePtr), owner)
    si.wavelengths, radiance = emitter.sample_wavelengths(si, sampler.next_1d(active), active)
    value = (
        mi.Spectrum(radiance) * importance * weight * dr.select(infinite, far_weight, near_weight)
    )
    local = si.to_local(dr.normalize(sensor_ds.p - si.p))
    on_surface = si.shape != None  # noqa: E711
    cosine = mi.Frame3f.cos_theta(local)
    facing = dr.select(on_surface, dr.maximum(cosine, 0.0), dr.select(cosine > 0, 1.0, 0.0))
    known = splat.rays.data is not None
    p_err = dr.select(infinite, own_error(far.p), p_err) if known else None
    splat.connect(si, p_err, sensor_ds, value * facing, 0.0, active)


def _trace(splat: _Splat, longest: int, roulette_from: int) -> None:
    """Follow light from surface to surface."""
    rays, sampler, sensor = splat.rays, splat.sampler, splat.sensor
    ray, throughput, _emitter = splat.emitters.sample_ray(
        splat.time(), sampler.next_1d(), sampler.next_2d(), sampler.next_2d(), mi.Bool(True)
    )
    context = mi.BSDFContext(mi.TransportMode.Importance)
    state = {
        "ray": ray,
        "throughput": mi.Spectrum(throughput),
        "eta": mi.Float(1.0),
        "depth": mi.UInt32(1),
        "active": dr.any(mi.unpolarized_spectrum(throughput) != 0),
        "sampler": sampler,
    }

    def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
        st = dict(st)
        ray, active = st["ray"], st["active"]
        splat.sampler = sampler = st["sampler"]
        hit = rays.preliminary(ray, False, active)
        si, p_err = rays.meet(hit, ray, mi.RayFlags.All, active)
        active = active & si.is_valid()
        bsdf = si.bsdf(ray)
        inward = dr.dot(si.n, -ray.d)
        inward_shading = mi.Frame3f.cos_theta(si.wi)

        # ---- to the sensor
        ds, importance = sensor.sample_direction(si, sampler.next_2d(), active)
        towards = dr.normalize(ds.p - si.p)
        wo = si.to_local(towards)
        # light came along -wi: matrices of polarization are put before those of earlier vertices
        value = bsdf.eval(context, si, wo, active)
        value = importance * si.to_world_mueller(value, -si.wi, wo) * st["throughput"]
        outward, outward_shading = dr.dot(si.n, towards), mi.Frame3f.cos_theta(wo)
        value *= correction(inward, inward_shading, outward, outward_shading)
        splat.connect(si, p_err, ds, value, 1.0, active)

        # ---- the next surface
        sample, weight = bsdf.sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        onward = si.to_world(sample.wo)
        throughput = si.to_world_mueller(weight, -si.wi, sample.wo) * st["throughput"]
        throughput *= correction(
            inward, inward_shading, dr.dot(si.n, onward), mi.Frame3f.cos_theta(sample.wo)
        )
        eta = st["eta"] * sample.eta
        depth = st["depth"] + 1
        active = active & (depth < longest)
        throughput, survives = russian_roulette(
            sampler, throughput, eta, depth > roulette_from, active
        )
        return (
            {
                "ray": spawn_ray(si, p_err, onward),
                "throughput": throughput,
                "eta": eta,
                "depth": depth,
                "active": active & survives,
                "sampler": sampler,
            },
        )

    dr.while_loop((state,), cond=lambda st: st["active"], body=body, label="bezierptracer")
