"""Integrators with derivatives of visibility: ``bezier_prb_projective``, ``..._direct_...``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...errors import BezierError
from .bezierpath import make_path_class
from .depths import check_count
from .indirect_silhouette import indirect_silhouette_image
from .primary_silhouette import primary_silhouette_image
from .rough_outlines import rough_outline_image
from .specular_silhouette import specular_silhouette_image

__all__ = ["make_direct_projective_class", "make_prb_projective_class"]


def make_prb_projective_class() -> type:
    """Return the class for the variant that is set now."""
    base = make_path_class()

    class BezierPRBProjective(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezier_prb_projective:

        Path tracer with derivatives of silhouettes (:monosp:`bezier_prb_projective`)
        -----------------------------------------------------------------------------

        .. pluginparameters::

         * - max_depth, rr_depth, hide_emitters
           - |int|, |int|, |bool|
           - As `bezierpath`.
         * - sppc, sppp, sppi, spps
           - |int|
           - Samples per pixel for derivatives within surfaces, of silhouettes and edges as
             the camera sees them, as surfaces see them (shadows, reflections), and as both see
             them in ideal mirrors and through smooth glass. Unless it is
             0, the `spp` of the render call comes first; without either, that of the sampler
             (Default: none).

        Renders as `bezierpath`. Its derivatives are those of `bezierpath` itself, and integrals
        over the silhouettes, open edges and creases of those `beziertriangle` shapes whose
        parameters carry derivatives, also in ideal mirrors and behind smooth glass. Shadows of
        lights without extent have no part in them.
        """

        def __init__(self, props: mi.Properties) -> None:
            for key in ("sppc", "sppp", "sppi", "spps"):
                value = props.get(key, None)
                setattr(self, "_" + key, None if value is None else check_count(key, value))
            if "shadow_steps" in props:
                raise BezierError.expected(
                    "shadow_steps",
                    "none beside sppi, which has shadows",
                    repr(props["shadow_steps"]),
                )
            super().__init__(props)
            self.interior_may_be_constant = True
            self.spelled, self.has_outlines = props.plugin_name(), True

        def _samples(self, own: int | None, spp: int, sensor: Any) -> int:
            if own == 0:
                return 0
            return int(spp or own or sensor.sampler().sample_count())

        def _silhouettes(self, scene: Any, sensor: Any, seed: Any, spp: int) -> list[Any]:
            """Return images that have the derivatives of the silhouettes."""
            images = []
            for own, image in (
                (self._sppp, primary_silhouette_image),
                (self._sppi, indirect_silhouette_image),
                (self._spps, specular_silhouette_image),
                (self._spps, rough_outline_image),
            ):
                count = self._samples(own, spp, sensor)
                images.append(image(self, scene, sensor, seed, count) if count else None)
            return [image for image in images if image is not None and dr.grad_enabled(image)]

        def render_forward(
            self, scene: Any, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
        ) -> Any:
            """Return the derivative of the image; see `ADIntegrator.render_forward`."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            count = self._samples(self._sppc, spp, sensor)
            out = None
            if count:
                out = super().render_forward(scene, params, sensor, seed, count)
            for image in self._silhouettes(scene, sensor, seed, spp):
                dr.forward_to(image, flags=dr.ADFlag.ClearNone)
                out = dr.grad(image) if out is None else out + dr.grad(image)
            if out is None:
                out = dr.zeros(mi.TensorXf, sensor.film().develop().shape)
            return out

        def render_backward(
            self,
            scene: Any,
            params: Any,
            grad_in: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
        ) -> None:
            """Accumulate derivatives in the parameters; see `ADIntegrator.render_backward`."""
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            count = self._samples(self._sppc, spp, sensor)
            if count:
                super().render_backward(scene, params, grad_in, sensor, seed, count)
            for image in self._silhouettes(scene, sensor, seed, spp):
                dr.set_grad(image, grad_in)
                dr.enqueue(dr.ADMode.Backward, image)
                dr.traverse(dr.ADMode.Backward)
            dr.eval()

        def to_string(self) -> str:
            return (
                f"{type(self).__name__}[\n  max_depth = {self.max_depth},\n"
                f"  rr_depth = {self.rr_depth},\n  hide_emitters = {self.hide_emitters},\n"
                f"  sppc = {self._sppc},\n  sppp = {self._sppp},\n  sppi = {self._sppi},\n"
                f"  spps = {self._spps}\n]"
            )

    return BezierPRBProjective


def make_direct_projective_class() -> type:
    """Return the class for the variant that is set now."""
    base = make_prb_projective_class()

    class BezierDirectProjective(base):  # type: ignore[misc, valid-type]
        r"""
        .. _integrator-bezier_direct_projective:

        Direct light with derivatives of silhouettes (:monosp:`bezier_direct_projective`)
        ---------------------------------------------------------------------------------

        `bezier_prb_projective` with ``max_depth`` 2; the other parameters are the same.
        """

        def __init__(self, props: mi.Properties) -> None:
            if "max_depth" in props:
                raise BezierError.expected(
                    "max_depth", "no value: direct light has depth 2", repr(props["max_depth"])
                )
            props["max_depth"] = 2
            super().__init__(props)

    return BezierDirectProjective
