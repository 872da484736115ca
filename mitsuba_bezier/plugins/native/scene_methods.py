"""Queries of Mitsuba's scenes that see Bézier shapes, in the place of Mitsuba's own.

Code that nobody here wrote calls `scene.ray_intersect` and its kin. Once a Bézier shape exists in a
variant, these methods of `mi.Scene`, and `PreliminaryIntersection3f.compute_surface_interaction`,
are replaced by methods that answer exactly for scenes with Bézier shapes and hand all other scenes
to Mitsuba's own. So are `spawn_ray` and `spawn_ray_to` of interactions: rays leave patches as
`offsets` has it. What stays C++ from end to end, as the integrator `path`, is not reached in this
way: `counterparts` takes care of it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import drjit as dr
import mitsuba as mi

from ..frozen import is_bezier
from ..integrators.emitters import EmitterSampling
from ..interaction import Preliminary
from ..offsets import spawn_ray, spawn_ray_to
from ..scene import SceneRays
from ..scene_data import SceneData, check_variant, data_for_scene, known_data
from .originals import original, replace

__all__ = ["handed_out", "install", "is_on", "native", "prepare", "watch_renders"]

_on = True


class native:
    """Let Mitsuba's own names see Bézier shapes, or not.

    On from the start: integrators by their own names (`path`, `prb`, ...) and the queries of
    `mi.Scene` are exact in scenes with Bézier shapes. Off, they are Mitsuba's own throughout, which
    see nothing of such shapes.

    Parameters
    ----------
    on : bool
        At once, until the next call; or as long as the block lasts.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> scene = mi.load_dict({"type": "scene", "ball": mb.shape(mb.sphere())})
    >>> ray = mi.Ray3f([0, -5, 0], [0, 1, 0])
    >>> with mb.native(False):  # as without this package
    ...     scene.ray_test(ray)
    [False]
    >>> scene.ray_test(ray)
    [True]
    """

    def __init__(self, on: bool = True) -> None:
        global _on
        self.before, _on = _on, bool(on)

    def __enter__(self) -> native:
        return self

    def __exit__(self, *_error: object) -> None:
        global _on
        _on = self.before


def is_on() -> bool:
    """Return whether scenes answer for Bézier shapes."""
    return _on


def install() -> None:
    """Replace the methods in the variant that is set; once is enough."""
    for name, method in _SCENE.items():
        replace(mi.Scene, name, method)
    replace(mi.PreliminaryIntersection3f, "compute_surface_interaction", _interaction)
    replace(mi.SurfaceInteraction3f, "spawn_ray", _spawn_ray)
    replace(mi.SurfaceInteraction3f, "spawn_ray_to", _spawn_ray_to)


def watch_renders() -> None:
    """Let `mi.render` prepare scenes with Bézier shapes, and refuse those of another variant."""
    if not hasattr(mi.render, "prepares"):
        mi.render = _preparing(mi.render)


def _preparing(render: Any) -> Any:
    """Return `mi.render` that builds what an integrator may first ask for in a recorded loop."""

    @wraps(render)
    def prepared(scene: Any, *args: Any, **kwargs: Any) -> Any:
        if _on and isinstance(scene, mi.Scene):
            prepare(scene)
        elif type(scene).__name__ == "Scene":  # of another variant
            check_variant([shape for shape in scene.shapes() if is_bezier(shape)])
        return render(scene, *args, **kwargs)

    prepared.prepares = True  # type: ignore[attr-defined]
    return prepared


def _rays(scene: Any) -> SceneRays | None:
    """Return the exact queries of a scene with Bézier shapes, None for any other."""
    if not _on or not prepare(scene):
        return None
    return SceneRays(scene)


def prepare(scene: Any) -> bool:
    """Build what the queries of a scene need, unless it is there; return whether we are needed.

    Outside of recorded loops, that is: within, nothing can be built any more.
    """
    data = data_for_scene(scene)
    if data is None:
        return False
    if not data.prepared and not dr.flag(dr.JitFlag.SymbolicScope):
        data.prepared = True
        EmitterSampling(SceneRays(scene))
    return True


def handed_out(rays: SceneRays, hit: Preliminary) -> Any:
    """Return the record of a hit for others, who may ask for its interaction at any time."""
    if rays.data is not None:
        rays.data.handed_out = True
    return hit.pi


def _flag(coherent: Any) -> bool:
    # Mitsuba takes a mask; ours decides for all rays of a call
    return coherent if isinstance(coherent, bool) else False


def _is_mask(value: Any) -> bool:
    return isinstance(value, bool) or (
        value is not None and not isinstance(value, int | mi.RayFlags)
    )


# Signatures of Mitsuba's overloads. The reordering of threads is a hint for OptiX; patches are
# traced by a kernel of their own, which it does not concern.


def _ray_intersect(
    self: Any,
    ray: Any,
    ray_flags: Any = None,
    coherent: Any = None,
    *rest: Any,
    active: Any = None,
    **hints: Any,
) -> Any:
    rays = _rays(self)
    if rays is None:
        given = [x for x in (ray_flags, coherent) if x is not None]
        if active is not None:
            hints["active"] = active
        return original(self, "ray_intersect")(ray, *given, *rest, **hints)
    if coherent is None and _is_mask(ray_flags):
        ray_flags, active = None, ray_flags  # ray_intersect(ray, active)
    if active is None:
        active = rest[-1] if len(rest) in (1, 4) else True
    flags = mi.RayFlags.All if ray_flags is None else ray_flags
    return rays.intersect(ray, flags, _flag(coherent), active)


def _ray_intersect_preliminary(
    self: Any, ray: Any, coherent: Any = False, *rest: Any, active: Any = None, **hints: Any
) -> Any:
    rays = _rays(self)
    if rays is None:
        if active is not None:
            hints["active"] = active
        return original(self, "ray_intersect_preliminary")(ray, coherent, *rest, **hints)
    if active is None:
        active = rest[-1] if len(rest) in (1, 4) else True
    return handed_out(rays, rays.preliminary(ray, _flag(coherent), active))


def _ray_test(self: Any, ray: Any, *rest: Any, active: Any = None, **hints: Any) -> Any:
    rays = _rays(self)
    if rays is None:
        if active is not None:
            hints["active"] = active
        return original(self, "ray_test")(ray, *rest, **hints)
    if active is None:
        active = rest[-1] if rest else True  # (ray, active) or (ray, coherent, active)
    return rays.test(ray, active)


def _sample_emitter_direction(
    self: Any, ref: Any, sample: Any, test_visibility: bool = True, active: Any = True
) -> tuple[Any, Any]:
    rays = _rays(self)
    if rays is None:
        own = original(self, "sample_emitter_direction")
        return own(ref, sample, test_visibility, active)
    active = mi.Bool(active)
    ds, weight, end_err = EmitterSampling(rays).sample(ref, mi.Point2f(sample), active)
    if test_visibility:
        seen = active & (ds.pdf != 0.0)
        p_err = rays.error_of(ref, seen)
        blocked = seen & rays.is_blocked(spawn_ray_to(ref, p_err, ds.p, ds.n, end_err), seen)
        weight = dr.select(blocked, 0.0, weight)
        ds.pdf = dr.select(blocked, 0.0, ds.pdf)
    return ds, weight


def _pdf_emitter_direction(self: Any, ref: Any, ds: Any, active: Any = True) -> Any:
    rays = _rays(self)
    if rays is None:
        return original(self, "pdf_emitter_direction")(ref, ds, active)
    return EmitterSampling(rays).pdf_of_direction(ref, ds, mi.Bool(active))


def _sample_emitter_ray(
    self: Any, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
) -> tuple[Any, Any, Any]:
    rays = _rays(self)
    if rays is None:
        return original(self, "sample_emitter_ray")(time, sample1, sample2, sample3, active)
    return EmitterSampling(rays).sample_ray(time, sample1, sample2, sample3, mi.Bool(active))


def _sensors(self: Any) -> Any:
    """Return the sensors; who asks for them is about to render, often first in a recorded loop."""
    if _on and not dr.flag(dr.JitFlag.SymbolicScope) and not dr.flag(dr.JitFlag.FreezingScope):
        prepare(self)
    return original(self, "sensors")()


_SCENE: dict[str, Callable[..., Any]] = {
    "sensors": _sensors,
    "ray_intersect": _ray_intersect,
    "ray_intersect_preliminary": _ray_intersect_preliminary,
    "ray_test": _ray_test,
    "sample_emitter_direction": _sample_emitter_direction,
    "pdf_emitter_direction": _pdf_emitter_direction,
    "sample_emitter_ray": _sample_emitter_ray,
}


def _structures() -> list[SceneData]:
    """Return structures that hold all shapes that are known, each as few times as can be."""
    structures = known_data() if _on else []
    # within a render that tracks derivatives, it is the scene's that is rendered
    structures = [data for data in structures if data.attached is not None] or structures
    covered: set[int] = set()
    kept = []
    for data in structures:
        versions = {shape.version for shape in data.shapes}
        if not versions <= covered:
            kept.append(data)
            covered |= versions
    return kept


def _error_of(si: Any) -> Any:
    """Return the error of a point on a patch, 0 on other shapes, None if there are no patches."""
    p_err = None
    for data in _structures():
        error = data.error_of(si, True)
        p_err = error if p_err is None else dr.select(error > 0, error, p_err)
    return p_err


def _spawn_ray(self: Any, d: Any) -> Any:
    theirs, p_err = original(self, "spawn_ray")(d), _error_of(self)
    if p_err is None:
        return theirs
    return dr.select(p_err > 0, spawn_ray(self, p_err, mi.Vector3f(d)), theirs)


def _spawn_ray_to(self: Any, t: Any) -> Any:
    theirs, p_err = original(self, "spawn_ray_to")(t), _error_of(self)
    if p_err is None:
        return theirs
    return dr.select(p_err > 0, spawn_ray_to(self, p_err, mi.Point3f(t)).ray, theirs)


def _interaction(self: Any, ray: Any, ray_flags: Any = None, active: Any = True) -> Any:
    """Return the interaction of a preliminary hit, on whatever shape of whatever scene.

    The record tells the shape and the number of the patch in it; the structures that are alive
    tell which patch that is.
    """
    flags = mi.RayFlags.All if ray_flags is None else ray_flags
    active = mi.Bool(active)
    own = original(self, "compute_surface_interaction")
    structures = _structures()
    if not structures:
        return own(ray, flags, active)
    left = active
    found = []
    for data in structures:
        hit = _preliminary(data, self, left)
        found.append((hit.bezier, data.surface_interaction(hit, ray, flags, left)))
        left = left & ~hit.bezier
    si = own(ray, flags, left)
    for mask, ours in found:
        si = dr.select(mask, ours, si)
    return si


def _preliminary(data: SceneData, pi: Any, active: Any) -> Preliminary:
    """Find the patch of a hit by its shape and its number there."""
    patch, ours = data.patch_of(pi, active)
    return Preliminary(pi, ours, patch)
