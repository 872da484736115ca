"""When a path may end early: rays that can meet no emitter are not traced."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["all_end_at_once", "emitters_can_be_met", "goes_on", "run"]


def emitters_can_be_met(scene: Any) -> bool:
    """Return whether rays can meet an emitter of the scene: not points, nor single directions."""
    return any(not mi.has_flag(e.flags(), mi.EmitterFlags.Delta) for e in scene.emitters())


def goes_on(active: Any, depth: Any, max_depth: int, null: Any, met: bool) -> Any:
    """Return which paths go on to vertex number `depth`.

    Where no emitter can be met, the last vertex of a path adds no light. It still tells whether
    there is a surface, of rays that have passed nothing but null surfaces.

    Parameters
    ----------
    active : Bool
        Paths that are long enough up to here.
    depth : UInt32
    max_depth : int
    null : Bool
        Whether this ray passed a null surface.
    met : bool
        What `emitters_can_be_met` returns.
    """
    return active if met else active & ((depth + 1 < max_depth) | null)


def all_end_at_once(scene: Any, max_depth: int, met: bool) -> bool:
    """Return whether no path of a scene has a second vertex, whatever is met."""
    shapes = scene.shapes()
    if met or max_depth > 2 or any(s.class_name() == "Instance" for s in shapes):
        return False
    bsdfs = (shape.bsdf() for shape in shapes)
    return not any(b is not None and mi.has_flag(b.flags(), mi.BSDFFlags.Null) for b in bsdfs)


def run(
    state: dict[str, Any],
    body: Callable[[dict[str, Any]], tuple[dict[str, Any]]],
    once: bool,
    label: str,
) -> dict[str, Any]:
    """Run the loop of a path tracer over its state, whose ``active`` tells who goes on.

    Where all paths end at their first vertex (`once`) there is no loop: kernels are smaller, and
    recorded in half the time.
    """
    if once:
        with dr.isolate_grad():
            return body(state)[0]
    (state,) = dr.while_loop((state,), cond=lambda st: st["active"], body=body, label=label)
    return state
