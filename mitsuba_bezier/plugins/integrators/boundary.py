"""The boundary test: how near a hit is to where its surface ends or turns away."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..interaction import Preliminary
from ..scene import SceneRays

__all__ = ["boundary_test"]


def boundary_test(rays: SceneRays, hit: Preliminary, si: Any, ray: Any, active: Any) -> Any:
    """Return a number that goes to 0 at silhouettes and, on Bézier shapes, at open edges.

    It is the smaller one of the cosine between the ray and the normal and of the barycentric
    coordinate that is 0 on the open edge; 1 where nothing was hit. Up to version 3.5 Mitsuba's
    spheres had the first, its rectangles the second. Trimming curves are no edges here.
    """
    result = dr.abs(dr.dot(si.n, dr.normalize(ray.d)))
    if rays.data is not None:
        ours = active & hit.bezier
        edges = dr.gather(mi.UInt32, rays.data.open_edges(), hit.patch, ours)
        u, v = hit.pi.prim_uv.x, hit.pi.prim_uv.y
        # what is 0 on the edges AB, BC, CA
        for bit, distance in enumerate((1.0 - u - v, u, v)):
            is_open = ours & ((edges & (1 << bit)) != 0)
            result = dr.select(is_open, dr.minimum(result, dr.maximum(distance, 0.0)), result)
    return dr.select(active, result, 1.0)
