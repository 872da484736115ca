"""Sampling of emitters, with exact area sampling of those that sit on Bézier shapes."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .scene import SceneRays
from .scene_data import is_bezier

__all__ = ["EmitterSampling"]


class EmitterSampling:
    """What `mi.Scene` does for emitters, where the C++ side cannot see the surface.

    Emitters are chosen as the scene chooses them. An area light on a Bézier shape is sampled
    here; all others by their own plugin.
    """

    def __init__(self, rays: SceneRays) -> None:
        self.scene = rays.scene
        self.lights = [s for s in self.scene.shapes() if is_bezier(s) and s.is_emitter()]

    def sample(self, si: Any, sample: Any, active: Any) -> tuple[Any, Any]:
        """Return a direction sample and its weight; visibility is not tested."""
        return self.scene.sample_emitter_direction(si, sample, False, active)

    def pdf(self, ref: Any, ds: Any, si: Any, active: Any) -> Any:
        """Return the density of `sample` for a direction that met an emitter at `si`."""
        if self.lights:
            mesh = si.is_valid()
            for light in self.lights:
                mesh = mesh & (si.shape != mi.ShapePtr(light))
            active = active & (mesh | ~si.is_valid())
        return dr.select(active, self.scene.pdf_emitter_direction(ref, ds, active), 0.0)
