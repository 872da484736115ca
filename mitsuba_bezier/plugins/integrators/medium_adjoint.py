"""Derivatives of `beziervolpath`: the parts of a path that depend on media, materials and lights.

The estimator is that of Mitsuba's `prbvolpath` (Vicini, Speierer and Jakob, "Path replay
backpropagation", 2021): distances, directions and choices are sampled without derivatives, and what
they are weighted with has some.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...errors import BezierError
from ..native.originals import original
from ..scene import SceneRays
from .chains import with_derivatives
from .left_out import checked_parameters
from .media import (
    Media,
    extinction_step,
    transmittance,
    transmittance_by_colour,
    with_coefficients,
)
from .path_replay import relative

__all__ = ["MediumAdjoint", "boundaries_move"]


def is_boundary(node: Any) -> bool:
    """Return whether light passes a shape as if it was not there, but for its media."""
    if not isinstance(node, mi.Shape) or node.is_emitter() or node.is_sensor():
        return False
    flags, kinds = node.bsdf().flags(), mi.BSDFFlags
    others = kinds.Smooth, kinds.DeltaReflection, kinds.DeltaTransmission
    return mi.has_flag(flags, kinds.Null) and not any(mi.has_flag(flags, kind) for kind in others)


def _turning(found: list[tuple[str, Any, Any]]) -> tuple[list[str], bool]:
    """Return the names of parameters that move what rays meet, or rays; whether boundaries move."""
    turning, boundaries = [], False
    for key, node, flags in found:
        delta = isinstance(node, mi.BSDF) and mi.has_flag(node.flags(), mi.BSDFFlags.Delta)
        # emitters that move are refused elsewhere: what is left are pictures
        moves = isinstance(node, mi.Shape | mi.Sensor) or delta
        if moves and flags & mi.ParamFlags.Discontinuous:
            if is_boundary(node):
                boundaries = True
            else:
                turning.append(key)
    return turning, boundaries


def boundaries_move(scene: Any) -> bool:
    """Return whether a boundary of media has derivatives."""
    return any(is_boundary(node) for _key, node, _flags in with_derivatives(scene))


class MediumAdjoint:
    """What a path through media is differentiated by.

    Parameters
    ----------
    scene : mi.Scene
    mode : dr.ADMode
        Forward or Backward.

    Raises
    ------
    BezierError
        If something moves that is no boundary of media without a surface, and in polarized
        variants.
    """

    def __init__(self, scene: Any, mode: Any) -> None:
        if mi.is_polarized:
            raise BezierError.expected(
                "beziervolpath", "a variant without polarization for derivatives", mi.variant()
            )
        turning, self.boundaries = _turning(checked_parameters("beziervolpath", scene))
        if turning:
            raise BezierError.expected(
                "beziervolpath",
                "derivatives by media, materials, lights, and shapes with a null BSDF, which bound "
                "media (bezierpath has those by other shapes that move, without media)",
                ", ".join(turning),
            )
        self.scene, self.mode = scene, mode

    def flight(
        self, medium: Any, mei: Any, distance: Any, inside: Any, scatters: Any, null: Any
    ) -> Any:
        """Return the relative change of the weight of a flight."""
        with dr.resume_grad():
            moved = with_coefficients(medium, mei, inside)
            value, _pdf = transmittance_by_colour(medium, moved, distance, inside)
            value = dr.select(scatters, value * moved.sigma_s, value)
            value = dr.select(null, value * moved.sigma_n, value)
            return relative(mi.Spectrum(dr.select(inside, value, 1.0)))

    def light(
        self,
        rays: SceneRays,
        si: Any,
        scatters: Any,
        ref: Any,
        ds: Any,
        hit: Any,
        weight: Any,
        active: Any,
    ) -> Any:
        """Return the weight of a sample of the emitters with derivatives."""
        ours = active & hit.bezier
        ray = ref.spawn_ray(ds.d)
        ray.o = ref.p
        there = rays.surface_interaction(hit, ray, mi.RayFlags.All, ours)
        value = dr.select(ours, ds.emitter.eval(there, ours), 0.0)
        at = mi.SurfaceInteraction3f(dr.detach(si))
        at.p = dr.select(scatters, ref.p, at.p)
        theirs = active & ~hit.bezier
        value += dr.select(
            theirs, original(self.scene, "eval_emitter_direction")(at, ds, theirs), 0.0
        )
        return dr.replace_grad(weight, value * dr.select(ds.pdf != 0, dr.rcp(ds.pdf), 0.0))

    def crossing(
        self, rays: SceneRays, hit: Any, ray: Any, si: Any, medium: Any, active: Any
    ) -> Any:
        """Return the relative change of the light beyond a boundary that moves along the ray.

        It is what the way through the one medium becomes longer by, and that through the other
        shorter. What the two scatter there is for `medium_boundary`.
        """
        beyond = si.target_medium(ray.d)
        step = extinction_step(medium, beyond, si, ray, active)
        with dr.resume_grad():
            t = rays.surface_interaction(hit, ray, mi.RayFlags.All, active).t
            change = -mi.Spectrum(step) * dr.replace_grad(mi.Float(0), t)
            return dr.select(active, change, 0.0)

    def way(self, rays: SceneRays, media: Media, way: Any, direct: Any, derivative: Any) -> Any:
        """Differentiate what gets through to an emitter; return what that adds (Forward).

        Parameters
        ----------
        way : tuple
            Ray, medium, sampler in the state of the first time, active, and reach.
        direct : mi.Spectrum
            The light that arrived.
        derivative : mi.Spectrum
            The adjoint of the radiance (Backward).
        """
        ray, medium, sampler, active, reach = way
        forward = self.mode == dr.ADMode.Forward

        def part(values: list[Any], total: Any) -> Any:
            with dr.resume_grad():
                change = mi.Spectrum(0.0)
                for value in values:
                    change = change + direct * relative(mi.Spectrum(value))
                if not dr.grad_enabled(change):
                    return total
                if forward:
                    return total + mi.Spectrum(dr.forward_to(change))
                dr.backward_from(derivative * change)
                return total

        total = transmittance(
            rays, media, ray, medium, sampler, active, reach, part, self.boundaries
        )
        return total if forward else mi.Spectrum(0.0)

    def add(self, derivative: Any, total: Any) -> Any:
        """Take derivatives of the light of a vertex; return the sum so far (Forward)."""
        if not dr.grad_enabled(total):
            return derivative
        if self.mode == dr.ADMode.Backward:
            dr.backward_from(derivative * total)
            return derivative
        return derivative + mi.Spectrum(dr.forward_to(total))
