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
from .left_out import checked_parameters
from .media import Media, transmittance, transmittance_by_colour, with_coefficients
from .path_replay import relative

__all__ = ["MediumAdjoint"]


def _turning(found: list[tuple[str, Any, Any]]) -> list[str]:
    """Return the names of parameters that move what rays meet, or rays."""
    turning = []
    for key, node, flags in found:
        delta = isinstance(node, mi.BSDF) and mi.has_flag(node.flags(), mi.BSDFFlags.Delta)
        moves = isinstance(node, mi.Shape | mi.Emitter | mi.Sensor) or delta
        if moves and flags & mi.ParamFlags.Discontinuous:
            turning.append(key)
    return turning


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
        If something moves, and in polarized variants.
    """

    def __init__(self, scene: Any, mode: Any) -> None:
        if mi.is_polarized:
            raise BezierError.expected(
                "beziervolpath", "a variant without polarization for derivatives", mi.variant()
            )
        turning = _turning(checked_parameters("beziervolpath", scene))
        if turning:
            raise BezierError.expected(
                "beziervolpath",
                "derivatives by media, materials and lights only (bezierpath has those by what "
                "moves, without media)",
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

        total = transmittance(rays, media, ray, medium, sampler, active, reach, part)
        return total if forward else mi.Spectrum(0.0)

    def add(self, derivative: Any, total: Any) -> Any:
        """Take derivatives of the light of a vertex; return the sum so far (Forward)."""
        if not dr.grad_enabled(total):
            return derivative
        if self.mode == dr.ADMode.Backward:
            dr.backward_from(derivative * total)
            return derivative
        return derivative + mi.Spectrum(dr.forward_to(total))
