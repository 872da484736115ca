"""What a hit on a patch means to Mitsuba: the point, its partials, the normal, the interaction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..kernels.curvature import affine_second_partials, evaluate_second
from ..kernels.patch import affine_partials, evaluate
from .attached import follow_ray

__all__ = ["PatchTables", "Preliminary", "shading_frame", "surface_interaction"]

#: Sine between dp_du and dp_dv, squared, below which float32 cannot tell a normal any more.
_FLAT = 1e-10
#: Step towards the centroid, far enough for float32 to see an angle, near enough to be the limit.
_STEP = 1e-3
#: Ratio of the lengths of dp_du and dp_dv, squared, where second partials lose most digits, and
#: the step from there.
_THIN = 1e-5
_FAR = 5e-3


@dataclass
class Preliminary:
    """A hit of either kind: Mitsuba's record, and the patch where it is one of ours."""

    # Dr.Jit selects between records only if they have defaults
    pi: Any = None  #: mi.PreliminaryIntersection3f; prim_uv and prim_index are set for patches too
    bezier: Any = None  #: Bool
    patch: Any = None  #: UInt, number among all patches of the structure

    DRJIT_STRUCT = {"pi": Any, "bezier": Any, "patch": Any}

    @staticmethod
    def miss() -> Preliminary:
        """Return a record of no hit, as the state of a loop before its first query."""
        pi = dr.zeros(mi.PreliminaryIntersection3f)
        return Preliminary(pi, mi.Bool(False), mi.UInt32(0))


@dataclass
class PatchTables:
    """What is known of the patches of a list of shapes, numbered through.

    Patches have the same degree, lower ones are elevated.
    """

    nets: Any  #: Float, rows of `kernels.patch.pack`
    degree: int
    shape_of: Any  #: UInt, number of the shape of each patch
    orientation: Any  #: Float per shape, the sign of the normal along dp_du x dp_dv
    texcoords: Any = None  #: Float, six a patch (uv at A, B, C), or None: uv is (u, v)

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
        flat = active & _is_flat(n, pu, pv)
        if dr.grad_enabled(n):  # Dr.Jit differentiates selections, not what a branch gathers
            n = dr.select(flat, self._limit_normal(patch, u, v, flat), n)
        else:
            n = dr.if_stmt(
                args=(n, patch, u, v, flat),
                cond=flat,
                true_fn=lambda n, patch, u, v, flat: self._limit_normal(patch, u, v, flat),
                false_fn=lambda n, patch, u, v, flat: n,
            )
        return p, pu, pv, n * self.sign(patch, active)

    def normal_partials(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any]:
        """Return the partials of the unit normal by the parameters.

        With ``N = p_u x p_v`` they are the parts across ``N`` of its partials over ``|N|``.
        Where the patch is nearly collapsed, rounding leaves nothing of them. There the linear map
        from ``p_u, p_v`` to them, which is continuous, is that of a point nearby inside.
        """
        _p, pu, pv = self.partials(patch, u, v, active)
        least = dr.minimum(dr.squared_norm(pu), dr.squared_norm(pv))
        most = dr.maximum(dr.squared_norm(pu), dr.squared_norm(pv))
        singular = _is_flat(dr.cross(pu, pv), pu, pv) | ~(least > _THIN * most)
        h = evaluate_second(
            self.nets,
            self.degree,
            patch,
            dr.select(singular, u + _FAR * (1 / 3 - u), u),
            dr.select(singular, v + _FAR * (1 / 3 - v), v),
            active,
        )
        a, b, aa, ab, bb = (mi.Vector3f(*x) for x in affine_second_partials(h)[1:])
        n = dr.cross(a, b)
        inv = dr.rsqrt(dr.squared_norm(n))
        inv = dr.select(dr.isfinite(inv), inv, 0.0)
        n *= inv
        na = (dr.cross(aa, b) + dr.cross(a, ab)) * inv
        nb = (dr.cross(ab, b) + dr.cross(a, bb)) * inv
        na, nb = na - n * dr.dot(n, na), nb - n * dr.dot(n, nb)

        def mapped(x: Any) -> Any:
            # x = (x, b, n) / (a, b, n) a + (a, x, n) / (a, b, n) b in the tangent plane
            return (na * dr.dot(dr.cross(x, b), n) + nb * dr.dot(dr.cross(a, x), n)) * inv

        sign = self.sign(patch, active)
        nu = dr.select(singular, mapped(pu), na)
        nv = dr.select(singular, mapped(pv), nb)
        return nu * sign, nv * sign

    def point_and_normal(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the point, the unit normal and ``|dp_du x dp_dv|`` at parameters of a patch."""
        p, pu, pv, n = self.geometry(patch, u, v, active)
        return p, mi.Normal3f(dr.normalize(n)), dr.norm(dr.cross(pu, pv))

    def sign(self, patch: Any, active: Any) -> Any:
        """Return the sign of the normal along ``dp_du x dp_dv``."""
        number = dr.gather(mi.UInt32, self.shape_of, patch, active)
        return dr.gather(mi.Float, self.orientation, number, active)

    def texture(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the texture coordinates and their constant partials by the parameters."""
        if self.texcoords is None:
            return mi.Point2f(u, v), mi.Vector2f(1, 0), mi.Vector2f(0, 1)
        a, b, c = (
            mi.Vector2f(*(dr.gather(mi.Float, self.texcoords, 6 * patch + k, active) for k in ks))
            for ks in ((0, 1), (2, 3), (4, 5))
        )
        du, dv = a - c, b - c
        return mi.Point2f(dr.fma(u, du, dr.fma(v, dv, c))), du, dv

    def _limit_normal(self, patch: Any, u: Any, v: Any, flat: Any) -> Any:
        _p, pu, pv = self.partials(patch, u + _STEP * (1 / 3 - u), v + _STEP * (1 / 3 - v), flat)
        inner = dr.cross(pu, pv)
        return dr.select(dr.squared_norm(inner) > 0, inner, mi.Vector3f(0, 0, 1))


def _is_flat(n: Any, pu: Any, pv: Any) -> Any:
    return ~(dr.squared_norm(n) > _FLAT * dr.squared_norm(pu) * dr.squared_norm(pv))


def _by_texture(fu: Any, fv: Any, du: Any, dv: Any) -> tuple[Any, Any, Any]:
    """Turn partials by the parameters into those by texture coordinates.

    Returns
    -------
    partials by the first and the second texture coordinate, and whether they exist
    """
    det = dr.fma(du.x, dv.y, -du.y * dv.x)
    inv = dr.rcp(det)
    return (
        (dv.y * fu - du.y * fv) * inv,
        (du.x * fv - dv.x * fu) * inv,
        (det != 0) & dr.isfinite(inv),
    )


def shading_frame(n: Any, dp_du: Any) -> Any:
    """Return the frame of a unit normal, its first axis along `dp_du` if that has a direction."""
    across = dp_du - n * dr.dot(n, dp_du)
    # at a collapsed corner dp_du is a rounding error, of any direction: 1e-4 of it are still safe
    bad = ~(dr.squared_norm(across) > 1e-8 * dr.squared_norm(dp_du))
    s = dr.normalize(dr.select(bad, mi.coordinate_system(n)[0], across))
    frame = mi.Frame3f()
    frame.s, frame.t, frame.n = s, dr.cross(n, s), n
    return frame


def surface_interaction(
    tables: PatchTables, hit: Preliminary, ray: Any, flags: Any, active: Any
) -> Any:
    """Return `mi.SurfaceInteraction3f` for hits on patches; invalid elsewhere.

    All fields are those of Mitsuba's own shapes. ``dn_du``, ``dn_dv`` are computed on request
    (`mi.RayFlags.dNGdUV` or `dNSdUV`: the shading normal is the true one). Partials are by the
    texture coordinates `uv`. Where the nets or the ray carry derivatives, so do all fields: along
    the ray, or with `mi.RayFlags.FollowShape` at fixed parameters.
    """
    ours = hit.bezier & mi.Bool(active)
    if dr.grad_enabled(tables.nets, ray):  # Dr.Jit does not differentiate what a branch gathers
        return _interaction(tables, hit, ray, flags, ours)
    # a gather costs a packet the same for one ray as for all: none where no ray hits a patch
    return dr.if_stmt(
        args=(hit, ray, ours),
        cond=ours,
        true_fn=lambda hit, ray, ours: _interaction(tables, hit, ray, flags, ours),
        false_fn=lambda _hit, ray, _ours: _no_interaction(ray),
        label="bezier interaction",
    )


def _no_interaction(ray: Any) -> Any:
    """Return what Mitsuba takes for a miss."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    si.t = dr.inf
    si.time, si.wavelengths = ray.time, ray.wavelengths
    si.wi = -ray.d
    return si


def _interaction(tables: PatchTables, hit: Preliminary, ray: Any, flags: Any, ours: Any) -> Any:
    """Return the interactions of the hits `ours`; see `surface_interaction`."""
    pi = hit.pi
    u, v, t = pi.prim_uv.x, pi.prim_uv.y, pi.t
    attached = dr.grad_enabled(tables.nets, ray)
    follows_shape = mi.has_flag(flags, mi.RayFlags.FollowShape)
    if attached and not follows_shape:
        u, v, t = follow_ray(tables, hit.patch, u, v, t, ray, ours)
    p, pu, pv, n = tables.geometry(hit.patch, u, v, ours)
    n = dr.normalize(n)
    # The hit point is the patch's, not o + t d. But (u, v) are float32 numbers too, and where
    # a patch runs to infinity a rounding of them moves the point further than one of t.
    reach = dr.max(dr.abs(ray.o)) + pi.t * dr.norm(ray.d)
    p = dr.select(dr.norm(pu) + dr.norm(pv) > reach, dr.fma(t, ray.d, ray.o), p)
    if attached and follows_shape:
        t = dr.replace_grad(t, dr.norm(dr.select(ours, p - ray.o, 1.0)) / dr.norm(ray.d))
    uv, duv_du, duv_dv = tables.texture(hit.patch, u, v, ours)
    wants_dn = mi.has_flag(flags, mi.RayFlags.dNGdUV) or mi.has_flag(flags, mi.RayFlags.dNSdUV)
    nu = nv = mi.Vector3f(0.0)
    if wants_dn:
        nu, nv = tables.normal_partials(hit.patch, u, v, ours)
    if tables.texcoords is not None:
        pu, pv, regular = _by_texture(pu, pv, duv_du, duv_dv)
        # as Mitsuba's meshes: any basis where texture coordinates do not tell one
        some, other = mi.coordinate_system(n)
        pu, pv = dr.select(regular, pu, some), dr.select(regular, pv, other)
        if wants_dn:
            nu, nv, _ = _by_texture(nu, nv, duv_du, duv_dv)
            nu, nv = dr.select(regular, nu, 0.0), dr.select(regular, nv, 0.0)

    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(pi.t))
    si.t = dr.select(ours, t, dr.inf)
    si.p = dr.select(ours, p, 0.0)
    si.n = dr.select(ours, mi.Normal3f(n), 0.0)
    si.uv = dr.select(ours, uv, 0.0)
    si.dp_du = dr.select(ours, pu, 0.0)
    si.dp_dv = dr.select(ours, pv, 0.0)
    si.dn_du = dr.select(ours, nu, 0.0)
    si.dn_dv = dr.select(ours, nv, 0.0)
    si.sh_frame = shading_frame(si.n, si.dp_du)
    si.time = ray.time
    si.wavelengths = ray.wavelengths
    si.shape = dr.select(ours, pi.shape, dr.zeros(mi.ShapePtr))
    si.prim_index = dr.select(ours, pi.prim_index, 0)
    si.wi = dr.select(ours, si.to_local(-ray.d), -ray.d)
    return si
