"""The integrator plugin ``bezierpath``: Mitsuba's `path`, with exact Bézier shapes."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi

from ... import _runtime
from .depths import check_count, check_depths
from .left_out import checked_parameters, warn_of_outlines
from .path_replay import replay
from .path_tracing import trace

__all__ = ["make_path_class"]


def make_path_class() -> type:
    """Return the class for the variant that is set now."""
    # Mitsuba reloads this module when the variant changes
    base = import_module("mitsuba.python.ad.integrators.common").RBIntegrator

    class BezierPath(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezierpath:

        Path tracer with Bézier shapes (:monosp:`bezierpath`)
        -----------------------------------------------------

        .. pluginparameters::

         * - max_depth
           - |int|
           - Longest path depth in the image, -1 for no limit; 1 shows directly visible
             emitters only, 2 direct light, and so on (Default: -1).
         * - rr_depth
           - |int|
           - Path depth from which Russian roulette ends paths (Default: 5).
         * - hide_emitters
           - |bool|
           - Hide directly visible emitters (Default: |false|).
         * - shadow_steps
           - |int|
           - Intervals across a light in which derivatives look for the edges of its shadows, 16
             for example (Default: 0, soft shadows have no derivatives).

        Samples BSDFs and emitters and combines both by multiple importance sampling, as
        Mitsuba's `path` does, whose parameters and defaults it has. It sees `beziertriangle`
        shapes exactly, and every other shape of Mitsuba. Derivatives, forward and reverse, by path
        replay have the estimator of `prb`, with edges of soft shadows on what the camera sees,
        through mirrors and glass too. They leave out what moves at outlines, which
        `bezier_prb_projective` takes in.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            check_depths(props)
            super().__init__(props)
            #: Whether a derivative without any contribution within surfaces is no mistake
            self.interior_may_be_constant = False
            #: Its name, and whether it has derivatives of outlines of patches
            self.spelled, self.has_outlines = "bezierpath", False
            #: Intervals in which edges of soft shadows are searched for; 0: nowhere
            self.shadow_steps = check_count("shadow_steps", props.get("shadow_steps", 0))

        def sample(
            self,
            mode: Any,
            scene: Any,
            sampler: Any,
            ray: Any,
            δL: Any = None,
            state_in: Any = None,
            active: Any = True,
            **kwargs: Any,
        ) -> tuple[Any, ...]:
            """Trace paths; see `ADIntegrator.sample` in Mitsuba for the interface."""
            if mode == dr.ADMode.Primal:
                L, valid = trace(self, scene, sampler, ray, active)
                return L, valid, [], L
            found = checked_parameters(self.spelled, scene)
            warn_of_outlines(self.spelled, found, self.has_outlines)
            δL, valid, rest = replay(self, mode, scene, sampler, ray, δL, state_in, active)
            return δL, valid, [], rest

        def to_string(self) -> str:
            return (
                f"BezierPath[\n  max_depth = {self.max_depth},\n"
                f"  rr_depth = {self.rr_depth},\n  hide_emitters = {self.hide_emitters}\n]"
            )

    return BezierPath
