"""Derivatives of `bezierptracer`: light that moves over what it falls on, forward and reverse.

The paths of light are traced again. A ray that leaves an emitter stays; behind ideal mirrors and
glass it follows them (`chains`), and the point that it reaches moves, with its place on the film.
So the derivative of a pixel has two parts: the light that a point sends to the sensor changes, and
the reconstruction filter is seen from elsewhere.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...errors import BezierError
from ..offsets import spawn_ray, spawn_ray_to
from ..scene import SceneRays
from .chains import Bend, Chains, Vertex, has_delta, is_followed
from .emitters import EmitterSampling
from .left_out import checked_parameters, warn_of_outlines
from .path_replay import relative, solid_angle
from .path_tracing import russian_roulette

__all__ = ["Footprint", "LightReplay", "correction", "shutter_time"]


class Footprint:
    """The pixels that a splat reaches, and the reconstruction filter there.

    Parameters
    ----------
    film : mi.Film

    Raises
    ------
    BezierError
        If the filter is a box: what crosses the border of a pixel has no derivative then.
    """

    def __init__(self, film: Any) -> None:
        self.filter = film.rfilter()
        if self.filter.is_box_filter():
            raise BezierError.expected(
                "rfilter",
                "a filter without a step for derivatives of bezierptracer, as gaussian",
                "box",
            )
        self.size = film.crop_size()
        self.radius = self.filter.radius()
        self.count = int(-(-2 * self.radius // 1))

    def weights(self, position: Any) -> tuple[Any, list[list[Any]]]:
        """Return the first pixel, and weights along both axes, as `mi.ImageBlock` has them."""
        at = mi.Point2f(position) - 0.5
        first = mi.Point2i(dr.ceil(dr.detach(at) - self.radius))
        axes = [
            [self.filter.eval(mi.Float(first[k] + i) - at[k]) for i in range(self.count)]
            for k in range(2)
        ]
        # their sum is 1 wherever the splat is
        return first, [[w / sum(axis) for w in axis] for axis in axes]

    def pixels(self, first: Any, active: Any) -> Any:
        """Yield number of the pixel, mask, and the places of its weights."""
        for j in range(self.count):
            for i in range(self.count):
                x, y = first.x + i, first.y + j
                inside = (x >= 0) & (y >= 0) & (x < int(self.size[0])) & (y < int(self.size[1]))
                yield mi.UInt32(y * int(self.size[0]) + x), active & inside, i, j

    def seen(self, image: Any, channels: int, position: Any, active: Any) -> Any:
        """Return colours of an image (flat, `channels` a pixel) through the filter."""
        first, (wx, wy) = self.weights(position)
        result = mi.Color3f(0.0)
        for pixel, mask, i, j in self.pixels(first, active):
            here = (dr.gather(mi.Float, image, pixel * channels + k, mask) for k in range(3))
            result += mi.Color3f(*here) * (wx[i] * wy[j])
        return result

    def splat(self, image: Any, channels: int, position: Any, value: Any, active: Any) -> None:
        """Add the derivative of a splat to an image.

        Parameters
        ----------
        position, value : pairs
            `mi.Point2f` and `mi.Color3f`, each with its derivative.
        """
        (at, speed), (colour, change) = position, value
        at = mi.Point2f(dr.detach(at))
        with dr.resume_grad():
            dr.enable_grad(at)
            first, axes = self.weights(at)
            slopes = []
            for k, axis in enumerate(axes):
                dr.set_grad(at, mi.Point2f(*(1.0 if i == k else 0.0 for i in range(2))))
                dr.forward_to(*axis, flags=dr.ADFlag.ClearNone)
                slopes.append([dr.grad(w) for w in axis])
                axes[k] = [dr.detach(w) for w in axis]
                for w in axis:
                    dr.clear_grad(w)
        (wx, wy), (sx, sy) = axes, slopes
        for pixel, mask, i, j in self.pixels(first, active):
            moved = sx[i] * wy[j] * speed.x + wx[i] * sy[j] * speed.y
            total = change * (wx[i] * wy[j]) + colour * moved
            for k in range(3):
                dr.scatter_reduce(dr.ReduceOp.Add, image, total[k], pixel * channels + k, mask)


def correction(wi: Any, wi_shading: Any, wo: Any, wo_shading: Any) -> Any:
    """Return the factor of an adjoint BSDF for cosines to both normals (Veach 1997, p. 155).

    It is 0 where light would pass a surface only by its shading normal.
    """
    good = (wi * wi_shading > 0) & (wo * wo_shading > 0)
    return dr.select(good, dr.abs(wi_shading * wo / (wo_shading * wi)), 0.0)


def shutter_time(sensor: Any, sampler: Any) -> Any:
    """Return a time at which the sensor's shutter is open."""
    time = mi.Float(sensor.shutter_open())
    if sensor.shutter_open_time() > 0:
        time += sampler.next_1d() * sensor.shutter_open_time()
    return time


def _colour(value: Any, wavelengths: Any) -> Any:
    """Return what a film records."""
    if mi.is_spectral:
        return mi.spectrum_to_srgb(value, wavelengths)
    return mi.Color3f(value.x) if mi.is_monochromatic else mi.Color3f(value)


def _is_end(node: Any) -> bool:
    """Return whether what moves there is a light or a sensor."""
    lamp = isinstance(node, mi.Shape) and node.is_emitter()
    return bool(lamp or isinstance(node, mi.Emitter | mi.Sensor))


def _reverse_only() -> BezierError:
    return BezierError.expected(
        "bezierptracer",
        "reverse mode for derivatives by the radiance of lights (bezierpath has them forward)",
        "forward mode",
    )


class LightReplay:
    """The paths of light of one render, as often as its derivative takes them.

    It has what `ptracer._visible_emitters` asks of a splat.

    Parameters
    ----------
    integrator : BezierPTracer
    rays : SceneRays
    sensor : mi.Sensor
    mode : dr.ADMode
    image : Float
        The derivative of the image, flat, that is summed up (Forward), or the adjoint of the
        image (Backward).
    channels : int
        Channels of a pixel.
    scale : float
        What splats are multiplied by.

    Raises
    ------
    BezierError
        If a light or the sensor moves.
    """

    def __init__(
        self,
        integrator: Any,
        rays: SceneRays,
        sensor: Any,
        mode: Any,
        image: Any,
        channels: int,
        scale: float,
    ) -> None:
        self.integrator, self.rays, self.sensor, self.mode = integrator, rays, sensor, mode
        self.image, self.channels, self.scale = image, channels, scale
        found = checked_parameters("bezierptracer", rays.scene)
        warn_of_outlines("bezierptracer", found, False)
        moving = [(key, node) for key, node, flags in found if is_followed(node, flags)]
        ends = [key for key, node in moving if _is_end(node)]
        if ends:
            raise BezierError.expected(
                "bezierptracer",
                "no derivatives by the place of lights and sensors, and by pictures of skies "
                "(bezierpath has those by the place of area lights, and by pictures)",
                ", ".join(ends),
            )
        self.footprint = Footprint(sensor.film())
        self.emitters = EmitterSampling(rays)
        self.delta = has_delta(rays.scene)
        self.moves = bool(moving)
        self.sampler: Any = None

    @property
    def forward(self) -> bool:
        return bool(self.mode == dr.ADMode.Forward)

    def time(self) -> Any:
        """Return when light leaves."""
        return shutter_time(self.sensor, self.sampler)

    # ------------------------------------------------------------------ emitters

    def connect(self, si: Any, p_err: Any, ds: Any, value: Any, alpha: float, active: Any) -> None:
        """Differentiate the light that reaches the sensor at once, by what is emitted."""
        if not dr.grad_enabled(value):
            return
        lit = self._lit(dr.detach(si), p_err, dr.detach(ds), value, active)
        colour = _colour(dr.select(lit, value, 0.0) * self.scale, si.wavelengths)
        position = mi.Point2f(dr.detach(ds.uv))
        if self.forward:
            raise _reverse_only()
        seen = self.footprint.seen(self.image, self.channels, position, lit)
        dr.backward_from(dr.sum(colour * dr.detach(seen)))

    def _lit(self, si: Any, p_err: Any, ds: Any, value: Any, active: Any) -> Any:
        with dr.suspend_grad():
            lit = active & (ds.pdf > 0) & dr.any(dr.detach(value) != 0)
            return lit & ~self.rays.is_blocked(spawn_ray_to(si, p_err, ds.p), lit)

    # ------------------------------------------------------------------ paths

    def start(self, sampler: Any) -> tuple[Any, Any]:
        """Return rays that leave the emitters, and what they carry, with derivatives."""
        self.sampler = sampler
        with dr.resume_grad():
            ray, carried, _emitter = self.emitters.sample_ray(
                self.time(), sampler.next_1d(), sampler.next_2d(), sampler.next_2d(), mi.Bool(True)
            )
            # within: a copy made while derivatives are suspended has none
            return mi.Ray3f(dr.detach(ray)), mi.Spectrum(carried)

    def trace(self, sampler: Any, rest: Any = None) -> Any:
        """Follow the light from surface to surface.

        Parameters
        ----------
        sampler : mi.Sampler
            In the same state each time.
        rest : mi.Spectrum, optional
            What a first call returned, for derivatives in reverse mode.

        Returns
        -------
        mi.Spectrum
            The sum of all that arrives, with the adjoint of the image: its parts by wavelength.
        """
        derives = self.forward or rest is not None
        chains = Chains(
            self.rays, self.mode, derives and self.moves, self.delta, self.integrator.longest
        )
        ray, carried = self.start(sampler)
        change = mi.Spectrum(0.0)
        with dr.resume_grad():
            if derives and dr.grad_enabled(carried):
                if self.forward:
                    raise _reverse_only()
                dr.backward_from(dr.sum(rest * relative(carried)))
        carried = dr.detach(carried)
        state = {
            "ray": ray,
            "chain": chains.initial(dr.width(ray)),
            "throughput": carried,
            "change": change,
            "rest": mi.Spectrum(0.0 if rest is None else rest),
            "eta": mi.Float(1.0),
            "depth": mi.UInt32(1),
            "active": dr.any(carried != 0),
            "arrived": mi.Bool(True),
            "sampler": sampler,
        }

        def body(st: dict[str, Any]) -> tuple[dict[str, Any]]:
            return (self._step(dict(st), chains, derives),)

        (state,) = dr.while_loop(
            (state,), lambda st: st["active"], body, label=f"bezierptracer ({self.mode.name})"
        )
        return state["rest"]

    def _step(self, st: dict[str, Any], chains: Chains, derives: bool) -> dict[str, Any]:
        rays, sampler, ray, arrived = self.rays, st["sampler"], st["ray"], st["arrived"]
        context = mi.BSDFContext(mi.TransportMode.Importance)
        hit = rays.preliminary(ray, False, st["active"])
        active = st["active"] & hit.pi.is_valid()
        with dr.resume_grad(when=derives):
            throughput = mi.Spectrum(st["throughput"])
            if self.forward:
                dr.enable_grad(throughput)
                dr.set_grad(throughput, st["change"])
            attached = chains.arrive(st["chain"], ray)
            si, p_err = chains.meet(hit, ray, attached, arrived, active)
            bsdf = si.bsdf(ray)
            inward, inward_shading = dr.dot(si.n, -attached.d), mi.Frame3f.cos_theta(si.wi)

            # ---- to the sensor
            ds, importance = self.sensor.sample_direction(si, sampler.next_2d(), active)
            towards = dr.normalize(ds.p - si.p)
            wo = si.to_local(towards)
            value = bsdf.eval(context, si, wo, active) * importance * throughput
            value *= correction(
                inward, inward_shading, dr.dot(si.n, towards), mi.Frame3f.cos_theta(wo)
            )
            here = dr.detach(si)
            lit = self._lit(here, p_err, dr.detach(ds), value, active)
            value = dr.select(lit, value * self.scale, 0.0)
            colour = _colour(value, ray.wavelengths)
            position = mi.Point2f(dr.select(lit, ds.uv, 0.0))

        # ---- the next surface
        sample1, sample2 = sampler.next_1d(active), sampler.next_2d(active)
        sample, weight = bsdf.sample(context, here, sample1, sample2, active)
        onward = here.to_world(sample.wo)
        carried = st["throughput"] * weight
        carried *= correction(
            dr.detach(inward),
            dr.detach(inward_shading),
            dr.dot(here.n, onward),
            mi.Frame3f.cos_theta(sample.wo),
        )
        eta, depth = st["eta"] * sample.eta, st["depth"] + 1
        goes_on = active & (depth < self.integrator.longest)
        carried, survives = russian_roulette(
            sampler, carried, eta, depth > self.integrator.roulette_from, goes_on
        )
        goes_on = goes_on & survives
        ideal = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        next_ray = spawn_ray(here, p_err, onward)
        out = {
            "ray": next_ray,
            "chain": st["chain"],
            "throughput": carried,
            "change": st["change"],
            "rest": st["rest"],
            "eta": eta,
            "depth": depth,
            "active": goes_on,
            "arrived": ideal,
            "sampler": sampler,
        }
        if not self.forward:
            after = self._parts(value, ray.wavelengths, position, lit)
            out["rest"] = st["rest"] + after if not derives else st["rest"] - after
        if not derives:
            return out

        # ---- derivatives
        following = rays.intersect(
            next_ray, mi.RayFlags.Minimal | mi.RayFlags.DetachShape, False, goes_on
        )
        met = goes_on & following.is_valid()
        bend = Bend(goes_on & ideal, sample1, sample2, met, following.p)
        with dr.resume_grad():
            wo, relation = mi.Vector3f(0, 0, 1), mi.Spectrum(0.0)
            if self.delta:
                moved, weight = bsdf.sample(context, si, sample1, sample2, bend.delta)
                wo, relation = moved.wo, weight * moved.pdf
            next_o, next_d = chains.leave(si, bend, wo, next_ray.d)
            rough = goes_on & ~ideal
            local = si.to_local(next_d)
            turned = bsdf.eval(context, si, local, rough)
            turned *= correction(
                inward, inward_shading, dr.dot(si.n, next_d), mi.Frame3f.cos_theta(local)
            )
            relation = relative(dr.select(rough, turned, relation))
            relation *= relative(solid_angle(si.p, following.p, following.n, met & rough))
            if self.forward:
                # sums with 0 keep targets apart that may be one variable
                after = carried * relative(throughput) * relation + 0.0
                colour, position = colour + 0.0, position + 0.0
                next_o, next_d = mi.Vector3f(next_o) + 0.0, next_d + 0.0
                moving = (next_o, next_d) if self.moves else ()
                dr.forward_to(colour, position, after, *moving, flags=dr.ADFlag.ClearEdges)
                out["change"] = mi.Spectrum(dr.grad(after))
                if self.moves:
                    out["chain"] = {"o": dr.grad(next_o), "d": dr.grad(next_d)}
                place = dr.detach(position), dr.grad(position)
                light = dr.detach(colour), mi.Color3f(dr.grad(colour))
                with dr.suspend_grad():
                    self.footprint.splat(self.image, self.channels, place, light, lit)
            else:
                seen = self.footprint.seen(self.image, self.channels, position, lit)
                total = dr.sum(colour * seen)
                total += dr.sum(dr.select(goes_on, out["rest"], 0.0) * relation)
                if dr.grad_enabled(total):
                    vertex = Vertex(ray, attached, hit, arrived, bend)
                    out["chain"] = chains.step_backward(
                        st["chain"], total, vertex, st["active"], goes_on
                    )
        return out

    def _parts(self, value: Any, wavelengths: Any, position: Any, lit: Any) -> Any:
        """Return the adjoint of the image times a splat, by wavelength."""
        value, position = mi.Spectrum(dr.detach(value)), mi.Point2f(dr.detach(position))
        seen = self.footprint.seen(self.image, self.channels, position, lit)
        parts = mi.Spectrum(0.0)
        for k in range(dr.size_v(mi.Spectrum)):
            unit = dr.zeros(mi.Spectrum)
            unit[k] = 1.0
            parts[k] = value[k] * dr.sum(_colour(unit, wavelengths) * seen)
        return parts
