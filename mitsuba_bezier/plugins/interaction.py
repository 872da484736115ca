"""What a hit on a patch means to Mitsuba: the point, its partials, the normal, the interaction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..kernels.patch import affine_partials, evaluate

__all__ = ["PatchTables", "Preliminary", "surface_interaction"]


@dataclass
class Preliminary:
    """A hit of either kind: Mitsuba's record, and the patch where it is one of ours."""

    pi: Any  #: mi.PreliminaryIntersection3f; prim_uv and prim_index are set for patches too
    bezier: Any  #: Bool
    patch: Any  #: UInt, number among all patches of the structure

    DRJIT_STRUCT = {"pi": Any, "bezier": Any, "patch": Any}


@dataclass
class PatchTables:
    """What is known of the patches of a list of shapes, numbered through.

    Patches have the same degree, lower ones are elevated.
    """

    nets: Any  #: Float, rows of `kernels.patch.pack`
    degree: int
    shape_of: Any  #: UInt, number of the shape of each patch
    orientation: Any  #: Float per shape, the sign of the normal along dp_du x dp_dv

    def partials(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the point and its first partials by the parameters."""
        value = evaluate(self.nets, self.degree, patch, u, v, active)
        p, pu, pv = affine_partials(*value)
        return mi.Point3f(*p), mi.Vector3f(*pu), mi.Vector3f(*pv)

    def geometry(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Return point, partials, and the normal (not of unit length, flipped as the shape is)."""
        p, pu, pv = self.partials(patch, u, v, active)
        n = dr.cross(pu, pv)
        # collapsed edges and corners: the limit from inside
        flat = active & ~(dr.squared_norm(n) > 1e-10 * dr.squared_norm(pu) * dr.squared_norm(pv))
        n = dr.if_stmt(
            args=(n, patch, u, v, flat),
            cond=flat,
            true_fn=lambda n, patch, u, v, flat: self._limit_normal(patch, u, v, flat),
            false_fn=lambda n, patch, u, v, flat: n,
        )
        number = dr.gather(mi.UInt32, self.shape_of, patch, active)
        return p, pu, pv, n * dr.gather(mi.Float, self.orientation, number, active)

    def point_and_normal(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the point, the unit normal and ``|dp_du x dp_dv|`` at parameters of a patch."""
        p, pu, pv, n = self.geometry(patch, u, v, active)
        return p, mi.Normal3f(dr.normalize(n)), dr.norm(dr.cross(pu, pv))

    def _limit_normal(self, patch: Any, u: Any, v: Any, flat: Any) -> Any:
        step = 1e-3  # far enough for float32 to see an angle, near enough to be the limit
        _p, pu, pv = self.partials(patch, u + step * (1 / 3 - u), v + step * (1 / 3 - v), flat)
        inner = dr.cross(pu, pv)
        return dr.select(dr.squared_norm(inner) > 0, inner, mi.Vector3f(0, 0, 1))


def surface_interaction(
    tables: PatchTables, hit: Preliminary, ray: Any, flags: Any, active: Any
) -> Any:
    """Return `mi.SurfaceInteraction3f` for hits on patches; invalid elsewhere."""
    ours = hit.bezier & mi.Bool(active)
    pi = hit.pi
    u, v = pi.prim_uv.x, pi.prim_uv.y
    p, pu, pv, n = tables.geometry(hit.patch, u, v, ours)
    n = dr.normalize(n)
    # The hit point is the patch's, not o + t d. But (u, v) are float32 numbers too, and where
    # a patch runs to infinity a rounding of them moves the point further than one of t.
    reach = dr.max(dr.abs(ray.o)) + pi.t * dr.norm(ray.d)
    p = dr.select(dr.norm(pu) + dr.norm(pv) > reach, dr.fma(pi.t, ray.d, ray.o), p)

    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(pi.t))
    si.t = dr.select(ours, pi.t, dr.inf)
    si.p = dr.select(ours, p, 0.0)
    si.n = dr.select(ours, mi.Normal3f(n), 0.0)
    si.uv = dr.select(ours, mi.Point2f(u, v), 0.0)
    si.dp_du = dr.select(ours, pu, 0.0)
    si.dp_dv = dr.select(ours, pv, 0.0)
    si.sh_frame.n = si.n
    si.time = ray.time
    si.wavelengths = ray.wavelengths
    si.shape = dr.select(ours, pi.shape, dr.zeros(mi.ShapePtr))
    si.prim_index = dr.select(ours, pi.prim_index, 0)
    si.initialize_sh_frame()
    si.wi = dr.select(ours, si.to_local(-ray.d), -ray.d)
    return si
