"""Ray queries on a whole scene: Bézier shapes and all other shapes of Mitsuba."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from .. import _runtime
from .interaction import Met, Preliminary
from .native.originals import original
from .offsets import Connection, own_error
from .scene_data import SceneData, data_for_scene

__all__ = ["SceneRays", "ray_intersect", "ray_test"]


class SceneRays:
    """The ray queries of `mi.Scene`, with exact patches. Made once for a render."""

    def __init__(self, scene: Any) -> None:
        _runtime.check(mi.variant())
        self.scene = scene
        self.data: SceneData | None = data_for_scene(scene)

    @contextmanager
    def attach(self, mode: Any) -> Iterator[None]:
        """Let interactions carry derivatives also in recorded loops; see `SceneData.attach`."""
        if self.data is None:
            yield
            return
        with self.data.attach(mode):
            yield

    def preliminary(self, ray: Any, coherent: bool = False, active: Any = True) -> Preliminary:
        """Return the nearest hit."""
        if self.data is not None and not self.data.scene_has_others:
            return self.data.preliminary(ray, active, None, coherent)
        pi = original(self.scene, "ray_intersect_preliminary")(
            ray, coherent=coherent, reorder=False, active=active
        )
        if self.data is None:
            return Preliminary(pi, mi.Bool(False), mi.UInt32(0))
        return self.data.preliminary(ray, active, pi, coherent)

    def surface_interaction(
        self, hit: Preliminary, ray: Any, flags: Any = None, active: Any = True
    ) -> Any:
        """Return the full interaction."""
        return self.meet(hit, ray, flags, active).si

    def meet(self, hit: Preliminary, ray: Any, flags: Any = None, active: Any = True) -> Met:
        """Return the full interaction, and the error of its point, which `offsets` takes."""
        flags = mi.RayFlags.All if flags is None else flags
        if self.data is None:
            return Met(original(hit.pi, "compute_surface_interaction")(ray, flags, active), None)
        ours = self.data.meet(hit, ray, flags, active)
        if not self.data.scene_has_others:
            return ours
        own = original(hit.pi, "compute_surface_interaction")
        theirs = own(ray, flags, mi.Bool(active) & ~hit.bezier)
        si = dr.select(hit.bezier, ours.si, theirs)
        p_err = dr.select(hit.bezier, ours.p_err, own_error(dr.detach(theirs.p)))
        return Met(si, p_err)

    def error_of(self, si: Any, active: Any = True) -> Any:
        """Return the error of the point of an interaction that somebody else has made."""
        if self.data is None:
            return None
        ours = self.data.error_of(si, active)
        return dr.select(ours > 0, ours, own_error(dr.detach(si.p)))

    def intersect(
        self, ray: Any, flags: Any = None, coherent: bool = False, active: Any = True
    ) -> Any:
        """Return the nearest `mi.SurfaceInteraction3f`."""
        return self.surface_interaction(self.preliminary(ray, coherent, active), ray, flags, active)

    def test(self, ray: Any, active: Any = True) -> Any:
        """Return whether anything is hit before ``ray.maxt``."""
        if self.data is None:
            return original(self.scene, "ray_test")(ray, active=active)
        if not self.data.scene_has_others:
            return self.data.test(ray, active)
        blocked = original(self.scene, "ray_test")(ray, active=active)
        return blocked | self.data.test(ray, mi.Bool(active) & ~blocked)

    def is_blocked(self, connection: Connection, active: Any = True) -> Any:
        """Return whether anything is between two points."""
        ray = connection.ray
        if self.data is None:
            return original(self.scene, "ray_test")(ray, active=active)
        at_patches = mi.Ray3f(ray)
        at_patches.maxt = connection.reach
        if not self.data.scene_has_others:
            return self.data.test(at_patches, active)
        blocked = original(self.scene, "ray_test")(ray, active=active)
        return blocked | self.data.test(at_patches, mi.Bool(active) & ~blocked)


def ray_intersect(
    scene: Any, ray: Any, ray_flags: Any = None, coherent: bool = False, active: Any = True
) -> Any:
    """Intersect rays with all shapes of a scene, Bézier or not.

    Parameters
    ----------
    scene : mi.Scene
    ray : mi.Ray3f
    ray_flags : mi.RayFlags, optional
        What to compute; default ``All``.
    coherent : bool
        Whether neighbouring rays go much the same way. If not told so, the rays of large arrays
        are looked at; see docs/performance.md.
    active : mi.Bool

    Returns
    -------
    mi.SurfaceInteraction3f

    Raises
    ------
    VariantError
        In a variant that cannot run a Dr.Jit kernel.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> scene = mi.load_dict({"type": "scene", "ball": mb.shape(mb.sphere())})
    >>> hit = mb.ray_intersect(scene, mi.Ray3f([0, -5, 0], [0, 1, 0]))
    >>> round(float(hit.t[0]), 6)
    4.0
    """
    return SceneRays(scene).intersect(ray, ray_flags, coherent, active)


def ray_test(scene: Any, ray: Any, active: Any = True) -> Any:
    """Return whether rays are blocked by any shape of a scene; see `ray_intersect`.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> scene = mi.load_dict({"type": "scene", "ball": mb.shape(mb.sphere())})
    >>> bool(mb.ray_test(scene, mi.Ray3f([0, -5, 0], [0, 1, 0]))[0])
    True
    """
    return SceneRays(scene).test(ray, active)
