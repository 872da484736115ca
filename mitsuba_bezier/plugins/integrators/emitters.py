"""Sampling of emitters, with exact area sampling of those that sit on Bézier shapes."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..interaction import Preliminary
from ..native.originals import original
from ..offsets import own_error, spawn_ray, spawn_ray_to
from ..scene import SceneRays
from ..surface_sampling import SurfaceSampling, direction_sample, per_solid_angle

__all__ = ["EmitterSampling", "LightSample"]

_NONE = 0xFFFFFFFF


def _number(emitter: Any) -> int:
    return int(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter))[0])


class LightSample(NamedTuple):
    """A point sampled on an emitter, and whether it is seen."""

    ds: Any  #: mi.DirectionSample3f
    weight: Any
    hit: Preliminary  #: the point as a hit where it is on a patch
    lit: Any  #: Bool: nothing is between


class EmitterSampling:
    """What `mi.Scene` does for emitters, where the C++ side cannot see the surface.

    Emitters are chosen as the scene chooses them. An area light on a Bézier shape is sampled
    here; all others by their own plugin.
    """

    def __init__(self, rays: SceneRays) -> None:
        self.rays = rays
        self.scene = rays.scene
        self.surfaces: SurfaceSampling | None = None
        data = rays.data
        numbers = [i for i, s in enumerate(data.shapes) if s.is_emitter()] if data else []
        if not numbers:
            return
        assert data is not None
        self.surfaces = data.surface_sampling(tuple(numbers), by_emission=True)
        emitters = self.scene.emitters()
        of_emitter = np.full(len(emitters), _NONE, dtype=np.uint32)
        emitter_of = np.zeros(len(numbers), dtype=np.uint32)
        for light, number in enumerate(numbers):
            pointer = data.shapes[number].emitter().ptr
            index = next(i for i, e in enumerate(emitters) if e.ptr == pointer)
            of_emitter[index], emitter_of[light] = light, index
        of_shape = np.full(len(data.shapes), _NONE, dtype=np.uint32)
        of_shape[numbers] = np.arange(len(numbers))
        self.of_emitter, self.emitter_of, self.of_shape = (
            data.kept(mi.UInt32, table) for table in (of_emitter, emitter_of, of_shape)
        )
        self.pointers = self.scene.emitters_dr()
        #: Which of these emitters send light along the normal only
        self.beamed = [emitters[i].class_name() == "DirectionalArea" for i in emitter_of]
        #: Mitsuba's numbers of these emitters
        self.numbers = [_number(emitters[index]) for index in emitter_of]

    def sample(self, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return a direction sample, its weight and the error of its point.

        Visibility is not tested. The error is that of a point on a patch along the normal, and 0
        of other points.
        """
        return self.sample_hit(si, sample, active)[:3]

    def sample_visible(self, si: Any, p_err: Any, sample: Any, active: Any) -> LightSample:
        """Sample an emitter, and test whether it is seen from the point of an interaction.

        `p_err` is the error of the point, as `SceneRays.meet` returns it.
        """
        ds, weight, end_err, hit = self.sample_hit(si, sample, active)
        lit = active & (ds.pdf != 0.0)
        shadow = spawn_ray_to(si, p_err, ds.p, ds.n, end_err)
        return LightSample(ds, weight, hit, lit & ~self.rays.is_blocked(shadow, lit))

    def _on_patches(self, light: Any, sample: Any, ours: Any) -> tuple[Any, Any, Preliminary]:
        """Sample points of lights on patches; return them, their errors and the same as hits.

        The hits have neither shape nor distance.
        """
        assert self.surfaces is not None and self.rays.data is not None
        light = dr.select(ours, light, 0)
        patch, u, v, linear = self.surfaces.sample_parameters(light, mi.Point2f(sample), ours)
        ps, p_err = self.surfaces.position_and_error(patch, u, v, linear, ours)
        hit = Preliminary(dr.zeros(mi.PreliminaryIntersection3f), ours, patch)
        hit.pi.prim_uv, hit.pi.valid = mi.Point2f(u, v), ours
        hit.pi.shape, hit.pi.prim_index = self.rays.data.owner(patch, ours)
        return ps, p_err, hit

    def sample_hit(self, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any, Preliminary]:
        """Return what `sample` does, and the sampled point as a hit where it is on a patch."""
        if self.surfaces is None:
            return (
                *original(self.scene, "sample_emitter_direction")(si, sample, False, active),
                mi.Float(0.0),
                Preliminary.miss(),
            )
        index, weight, x = self.scene.sample_emitter(sample.x, active)
        sample = mi.Point2f(x, sample.y)
        light = dr.gather(mi.UInt32, self.of_emitter, index, active)
        ours = active & (light != _NONE)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index, active)
        ds, value = emitter.sample_direction(si, sample, active & ~ours)

        ps, p_err, hit = self._on_patches(light, sample, ours)
        exact = direction_sample(ps, si)
        exact.emitter = emitter
        hit.pi.t = exact.dist
        there = dr.zeros(mi.SurfaceInteraction3f, dr.width(exact.dist))
        there.p, there.n, there.uv = exact.p, exact.n, exact.uv
        there.sh_frame = mi.Frame3f(exact.n)
        there.shape, there.prim_index = hit.pi.shape, hit.pi.prim_index
        there.wi = there.to_local(-exact.d)
        there.wavelengths, there.time = si.wavelengths, si.time
        there.t = exact.dist
        radiance = emitter.eval(there, ours)
        ds = dr.select(ours, exact, ds)
        value = dr.select(ours, dr.select(exact.pdf > 0, radiance * dr.rcp(exact.pdf), 0.0), value)
        pmf = self.scene.pdf_emitter(index, active)
        ds.pdf = ds.pdf * pmf
        return ds, value * weight, dr.select(ours, p_err, 0.0), hit

    def pdf(self, ref: Any, ds: Any, si: Any, hit: Any, active: Any) -> Any:
        """Return the density of `sample` for a direction that met an emitter.

        Parameters
        ----------
        ref : mi.Interaction3f
            From where.
        ds : mi.DirectionSample3f
            The direction.
        si : mi.SurfaceInteraction3f
            What it met.
        hit : Preliminary
            The same, with the patch.
        active : Bool
        """
        if self.surfaces is None:
            return dr.select(
                active, original(self.scene, "pdf_emitter_direction")(ref, ds, active), 0.0
            )
        data = self.rays.data
        assert data is not None
        number = dr.gather(mi.UInt32, data.patch_shape, hit.patch, active & hit.bezier)
        light = dr.gather(mi.UInt32, self.of_shape, number, active & hit.bezier)
        ours = active & hit.bezier & (light != _NONE)
        light = dr.select(ours, light, 0)
        theirs = active & ~hit.bezier
        pdf = dr.select(theirs, original(self.scene, "pdf_emitter_direction")(ref, ds, theirs), 0.0)
        area = self.surfaces.pdf(light, hit.patch, hit.pi.prim_uv, ours)
        exact = per_solid_angle(area, ds, si.n)
        index = dr.gather(mi.UInt32, self.emitter_of, light, ours)
        return dr.select(ours, exact * self.scene.pdf_emitter(index, ours), pdf)

    def pdf_of_direction(self, ref: Any, ds: Any, active: Any) -> Any:
        """Return the density of `sample` for a direction sample that may be anybody's.

        Where its emitter sits on Bézier shapes, a short ray at ``ds.p`` along ``ds.n`` finds the
        patch.

        Parameters
        ----------
        ref : mi.Interaction3f
            From where.
        ds : mi.DirectionSample3f
            The direction, with point, normal and emitter.
        active : Bool
        """
        theirs = original(self.scene, "pdf_emitter_direction")
        if self.surfaces is None:
            return theirs(ref, ds, active)
        light, ours = self._light_of(ds.emitter, active)
        area = self.surfaces.pdf_at(light, ds.p, ds.n, ours)
        exact = per_solid_angle(area, ds, ds.n)
        index = dr.gather(mi.UInt32, self.emitter_of, light, ours)
        exact = exact * self.scene.pdf_emitter(index, ours)
        other = active & ~ours
        return dr.select(ours, exact, dr.select(other, theirs(ref, ds, other), 0.0))

    def _light_of(self, emitter: Any, active: Any) -> tuple[Any, Any]:
        """Return the numbers in `surfaces` of emitters on Bézier shapes, and which are such."""
        numbers = dr.reinterpret_array(mi.UInt32, emitter)
        light, ours = mi.UInt32(0), mi.Bool(False)
        for k, number in enumerate(self.numbers):
            same = numbers == number
            light, ours = dr.select(same, k, light), ours | same
        return light, ours & active

    def sample_position(
        self, index: Any, time: Any, sample: Any, active: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Sample a point on emitters of finite extent.

        Parameters
        ----------
        index : UInt32
            Numbers of emitters, of Bézier shapes or not.
        time : Float
        sample : Point2f
        active : Bool

        Returns
        -------
        mi.PositionSample3f, one over its density, mi.ShapePtr, Float
            The shape that the emitter sits on, and by how much rays start off it.
        """
        emitter = dr.gather(mi.EmitterPtr, self.scene.emitters_dr(), index, active)
        shape = emitter.get_shape()
        if self.surfaces is None:
            ps, weight = emitter.sample_position(time, sample, active)
            return ps, weight, shape, own_error(ps.p)
        light = dr.gather(mi.UInt32, self.of_emitter, index, active)
        ours = active & (light != _NONE)
        ps, weight = emitter.sample_position(time, sample, active & ~ours)
        exact, p_err, _hit = self._on_patches(light, sample, ours)
        exact.time = time
        inverse = dr.select(exact.pdf > 0, dr.rcp(exact.pdf), 0.0)
        p_err = dr.select(ours, p_err, own_error(ps.p))
        return dr.select(ours, exact, ps), dr.select(ours, inverse, weight), shape, p_err

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any
    ) -> tuple[Any, Any, Any]:
        """Sample a ray that leaves an emitter, as `mi.Scene.sample_emitter_ray` does.

        Returns
        -------
        mi.Ray3f, weight, mi.EmitterPtr
        """
        if self.surfaces is None:
            own = original(self.scene, "sample_emitter_ray")
            return own(time, sample1, sample2, sample3, active)
        index, weight, rest = self.scene.sample_emitter(sample1, active)
        light = dr.gather(mi.UInt32, self.of_emitter, index, active)
        ours = active & (light != _NONE)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index, active)
        ray, value = emitter.sample_ray(time, rest, sample2, sample3, active & ~ours)

        # as area lights do: a point by area, a direction by the cosine, whose density cancels
        light = dr.select(ours, light, 0)
        ps, p_err, hit = self._on_patches(light, sample2, ours)
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ps.pdf))
        si.p, si.n, si.uv, si.time = ps.p, ps.n, ps.uv, time
        si.sh_frame = mi.Frame3f(ps.n)
        si.shape, si.prim_index = hit.pi.shape, hit.pi.prim_index
        si.wavelengths, radiance = emitter.sample_wavelengths(si, rest, ours)
        local = mi.warp.square_to_cosine_hemisphere(sample3)
        angle = mi.Float(dr.pi)
        for k, beamed in enumerate(self.beamed):  # `directionalarea`: along the normal only
            if beamed:
                local = dr.select(light == k, mi.Vector3f(0, 0, 1), local)
                angle = dr.select(light == k, 1.0, angle)
        exact = spawn_ray(si, p_err, si.to_world(local))
        flux = mi.Spectrum(radiance) * dr.select(ps.pdf > 0, angle / ps.pdf, 0.0)
        return dr.select(ours, exact, ray), dr.select(ours, flux, value) * weight, emitter
