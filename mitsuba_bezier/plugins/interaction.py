"""What a hit on a patch means to Mitsuba: the point, its partials, the normal, the interaction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from ..kernels.curvature import affine_second_partials
from ..kernels.patch import affine_partials
from ..kernels.patch_nets import Layout
from ..kernels.two_float import TwoFloat, coarse, select
from .instances import placed_by
from .offsets import position_error
from .wide_vectors import (
    PairVector,
    along,
    choose,
    cross,
    detach,
    dot,
    dot_rows,
    narrow,
    normalized,
    single,
    times,
    vector,
    widen,
)

_XYZ = range(3)

__all__ = [
    "Met",
    "PatchTables",
    "Preliminary",
    "meet",
    "placed",
    "shading_frame",
    "surface_interaction",
]

#: Sine between dp_du and dp_dv, squared, below which float32 cannot tell a normal any more.
_FLAT = 1e-10
#: Step towards the centroid, far enough for float32 to see an angle, near enough to be the limit.
_STEP = 1e-3
#: Ratio of the lengths of dp_du and dp_dv, squared, where second partials lose most digits, and
#: the step from there.
_THIN = 1e-5
_FAR = 5e-3
#: A hit's parameters are good to 1e-6: what a step to the ray changes by more is none.
_NEAR = 1e-4
#: Relative change of the partials on the way up to which the step is taken for straight.
_BENT = 1e-2
#: What rounding makes of the ray parameter of a hit, relative.
_ALONG = 2.0**-22


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


class Met(NamedTuple):
    """What a ray met, and how exactly that is known."""

    si: Any  #: mi.SurfaceInteraction3f
    #: Float, how far ``si.p`` may be from the surface along ``si.n``: the field that interactions
    #: of Mitsuba 3.10 have themselves. None where all shapes are Mitsuba's.
    p_err: Any


@dataclass
class Jet:
    """A point of a patch relative to an origin, and its partials by the parameters.

    In wide numbers up to the first partials: so the only roundings are those of the net, which is
    relative to the origin, too, and of the results.
    """

    origin: Any  #: wide vector, as the next
    p: Any
    pu: Any
    pv: Any
    puu: Any  #: Vector3f
    puv: Any
    pvv: Any

    def moved(self, du: Any, dv: Any) -> Jet:
        """Return what it is at parameters that differ by so little that squares do not count."""
        pu, pv = self.change(du, dv)
        p = self.p + self.pu * du + self.pv * dv
        pu, pv = (vector(self.pairs, x) for x in (pu, pv))
        return replace(self, p=p, pu=self.pu + pu, pv=self.pv + pv)

    @property
    def pairs(self) -> bool:
        """Whether wide numbers are pairs of float32."""
        return isinstance(self.p, PairVector)

    @property
    def point(self) -> Any:
        """The point itself, a wide vector."""
        return self.p + self.origin

    def tangents(self) -> tuple[Any, Any, Any, Any]:
        """Return the first partials, where wide numbers are pairs over the numbers after them.

        Float32 has no squares of squares of what a patch that runs to infinity has for partials.
        """
        if not self.pairs:
            return self.pu, self.pv, 1.0, 1.0
        (pu, size_u), (pv, size_v) = normalized(self.pu), normalized(self.pv)
        return pu, pv, size_u, size_v

    def area(self) -> Any:
        """Return ``|dp_du x dp_dv|``, a `mi.Float`."""
        pu, pv, size_u, size_v = self.tangents()
        if not self.pairs:
            return mi.Float(dr.norm(cross(pu, pv)))
        return dr.norm(single(cross(pu, pv))) * size_u * size_v

    def change(self, du: Any, dv: Any) -> tuple[Any, Any]:
        """Return how the first partials change."""
        du, dv = narrow(du), narrow(dv)
        return self.puu * du + self.puv * dv, self.puv * du + self.pvv * dv

    def error(self, p: Any, n: Any) -> Any:
        """Return what the point `p`, rounded, may be off along the unit normal `n`."""
        n = dr.detach(mi.Vector3f(n))
        height = sum(dr.abs(dr.dot(n, dr.detach(x))) for x in (self.puu, self.puv, self.pvv))
        pu, pv = single(detach(self.pu)), single(detach(self.pv))
        return position_error(dr.detach(p), n, pu, pv, height)

    def step_to(self, ray: Any, t: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Return what the parameters and `t` of a hit are off, and how that changes.

        The hit is moved to the ray in the tangent plane. Its rounding leaves `t` off, too, but
        by no more than that: where the ray grazes, the point keeps its place along the ray. The
        derivatives by the ray and, with attached nets, by the shape are those of the implicit
        function theorem.

        Returns
        -------
        du, dv, dt : Float64, or Float where wide numbers are pairs
            The first two are zero where the point is not nearly on the ray.
        small : Bool
            Where it is.
        """
        pairs = self.pairs
        gap = along(t, ray.d, vector(pairs, ray.o) - self.origin) - self.p
        pu, pv, size_u, size_v = self.tangents()
        pu, pv, direction = detach(pu), detach(pv), dr.detach(ray.d)
        # far away on a patch that runs to infinity both partials have nearly one direction
        n, direction = cross(pu, pv), vector(pairs, direction)
        square, facing = dot(n, n), dot(n, direction)
        # at a silhouette, and where nothing was hit, nothing follows
        regular = active & (coarse(square) > 0) & (coarse(facing) != 0)
        inverse = select(regular, 1.0 / select(regular, square, 1.0), 0.0)
        free = select(regular, -dot(n, gap) / select(regular, facing, 1.0), 0.0)
        free = coarse(free)  # of no more than a rounding of t
        limit = type(free)(dr.abs(dr.detach(t)) * _ALONG)
        gap = gap + direction * dr.replace_grad(dr.clip(dr.detach(free), -limit, limit), free)
        du = inverse * dot(cross(pv, n), gap)
        dv = inverse * dot(cross(n, pu), gap)
        if pairs:
            du, dv = (select(regular, x / y, 0.0) for x, y in ((du, size_u), (dv, size_v)))
        # where a patch runs to infinity, its partials change at once
        bent = self.change(du, dv)
        small = dr.maximum(dr.abs(coarse(du)), dr.abs(coarse(dv))) < _NEAR
        small &= _size(*bent) < _BENT * _size(self.pu, self.pv)
        return _where(small, du), _where(small, dv), free, small

    def is_far(self, ray: Any, t: Any) -> Any:
        """Return a mask of hits that a rounding of parameters moves further than one of `t`."""
        reach = dr.max(dr.abs(ray.o)) + mi.Float(t) * dr.norm(ray.d)
        return _size(self.pu, self.pv) > reach


@dataclass
class PatchTables:
    """What is known of the patches of a list of shapes, numbered through."""

    nets: Any  #: Float, nets of `leaves.local_nets`, stored as `layout` says
    origins: Any  #: Float, four a patch, as there
    layout: Layout
    shape_of: Any  #: UInt, number of the shape of each patch
    orientation: Any  #: Float per shape, the sign of the normal along dp_du x dp_dv
    texcoords: Any = None  #: Float, six a patch (uv at A, B, C), or None: uv is (u, v)
    projections: Any = None  #: Projections, or None: no shape has one
    aspheres: Any = None  #: AsphereTables, or None: there is no asphere
    places: Any = None  #: Float, `InstanceTables.matrices`, or None: nothing has instances
    pairs: bool = False  #: whether wide numbers are pairs of float32, see `Types`

    def origin(self, patch: Any, active: Any) -> Any:
        """Return the origins of patches, `mi.Point3f`."""
        return mi.Point3f(*(dr.gather(mi.Float, self.origins, 4 * patch + k, active) for k in _XYZ))

    def heaviest(self, patch: Any) -> Any:
        """Return the row of the largest weight of patches."""
        return mi.UInt32(dr.gather(mi.Float, self.origins, 4 * patch + 3))

    def relative(self, point: Any, patch: Any, active: Any) -> Any:
        """Return a point relative to the origins of patches."""
        origin = self.origin(patch, active)
        if self.pairs:  # a difference of two numbers is rounded once
            return mi.Point3f(mi.Vector3f(point) - mi.Vector3f(origin))
        return mi.Point3f(mi.Vector3d(point) - mi.Vector3d(origin))

    def second(self, patch: Any, u: Any, v: Any, active: Any) -> list[list[Any]]:
        """Return homogeneous points and partials, see `Layout.second`, from the origins."""
        if not (isinstance(u, TwoFloat) and dr.grad_enabled(*self.sources, u.hi, v.hi)):
            return self._second(patch, u, v, active)
        # derivatives are those of float32
        attached = self._second(patch, u.hi, v.hi, active)
        with dr.suspend_grad():
            h = self._second(patch, u, v, active)
        return [
            [
                TwoFloat(dr.replace_grad(x.hi, y), x.lo)
                if isinstance(x, TwoFloat)
                else dr.replace_grad(x, y)
                for x, y in zip(*rows)
            ]
            for rows in zip(h, attached)
        ]

    def _second(self, patch: Any, u: Any, v: Any, active: Any) -> list[list[Any]]:
        h = self.layout.second(self.nets, patch, u, v, active)
        return h if self.aspheres is None else self.aspheres.lifted(h, patch, u, v, active)

    def _jet(self, patch: Any, u: Any, v: Any, active: Any, order: int = 1) -> list[list[Any]]:
        """Return homogeneous points and partials, see `Layout.jet`, from the origins."""
        h = self.layout.jet(self.nets, patch, u, v, active, order)
        return h if self.aspheres is None else self.aspheres.lifted(h, patch, u, v, active)

    @property
    def sources(self) -> list[Any]:
        """What may carry derivatives by the shapes."""
        more = [] if self.aspheres is None else [self.aspheres.values]
        return [self.nets, *more] if self.places is None else [self.nets, *more, self.places]

    def place(self, number: Any, active: Any) -> tuple[Any, Any] | None:
        """Return the maps of instances, see `placed_by`; None where nothing has any."""
        return None if self.places is None else placed_by(self.places, number, active, self.pairs)

    def jet(self, patch: Any, u: Any, v: Any, active: Any, place: Any = None) -> Jet:
        """Return points and partials; the second have no derivatives.

        Parameters
        ----------
        place : pair, optional
            Affine map of each to space, see `placed_by`.
        """
        u, v = (widen(self.pairs, mi.Float(x)) for x in (u, v))
        wide = self.pairs
        h = self.second(patch, u, v, active) if wide else self._jet(patch, u, v, active, 2)
        origin = vector(self.pairs, self.origin(patch, active))
        if place is not None:
            h = placed(h, place[0])
            origin = times(place[0], origin) + place[1]
        p, pu, pv = (vector(self.pairs, x) for x in affine_partials(*h[:3]))
        rounded = [[narrow(a) for a in x] for x in h]
        second = affine_second_partials(rounded)[3:]
        return Jet(origin, p, pu, pv, *(mi.Vector3f(*x) for x in second))

    def partials(
        self, patch: Any, u: Any, v: Any, active: Any, place: Any = None
    ) -> tuple[Any, Any, Any]:
        """Return the point and its first partials by the parameters."""
        jet = self.jet(patch, u, v, active, place)
        return mi.Point3f(single(jet.point)), single(jet.pu), single(jet.pv)

    def normal(self, jet: Jet, patch: Any, u: Any, v: Any, active: Any, place: Any = None) -> Any:
        """Return the unit normal at a point of patches, flipped as their shapes are."""
        pu, pv, *_sizes = jet.tangents()
        n = cross(pu, pv)
        if jet.pairs:
            n, pu, pv = single(n), single(pu), single(pv)
        # collapsed edges and corners: the limit from inside
        flat = active & _is_flat(n, pu, pv)
        if dr.grad_enabled(n):  # Dr.Jit differentiates selections, not what a branch gathers
            n = dr.select(flat, self._limit_normal(patch, u, v, flat, place), n)
        else:
            n = dr.if_stmt(
                args=(n, patch, u, v, flat, place),
                cond=flat,
                true_fn=lambda n, patch, u, v, flat, place: self._limit_normal(
                    patch, u, v, flat, place
                ),
                false_fn=lambda n, patch, u, v, flat, place: n,
            )
        return mi.Normal3f(_unit(n)) * self.sign(patch, active, place)

    def normal_partials(
        self,
        pu: Any,
        pv: Any,
        patch: Any,
        u: Any,
        v: Any,
        active: Any,
        place: Any = None,
        along: Any = (),
    ) -> list[Any]:
        """Return the partials of the unit normal by the parameters, given those of the point.

        How it changes along other tangents comes after them.

        With ``N = p_u x p_v`` they are the parts across ``N`` of its partials over ``|N|``.
        Where the patch is nearly collapsed, rounding leaves nothing of them. There the linear map
        from ``p_u, p_v`` to them, which is continuous, is that of a point nearby inside.
        """
        least = dr.minimum(dr.squared_norm(pu), dr.squared_norm(pv))
        most = dr.maximum(dr.squared_norm(pu), dr.squared_norm(pv))
        singular = _is_flat(dr.cross(pu, pv), pu, pv) | ~(least > _THIN * most)
        h = self.second(
            patch,
            dr.select(singular, u + _FAR * (1 / 3 - u), u),
            dr.select(singular, v + _FAR * (1 / 3 - v), v),
            active,
        )
        if place is not None:
            h = placed(h, mi.Matrix3f(place[0]))
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

        sign = self.sign(patch, active, place)
        nu = dr.select(singular, mapped(pu), na)
        nv = dr.select(singular, mapped(pv), nb)
        return [x * sign for x in (nu, nv, *map(mapped, along))]

    def point_and_normal(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return the point, the unit normal and ``|dp_du x dp_dv|`` at parameters of a patch."""
        return self.point_and_error(patch, u, v, active)[:3]

    def point_and_error(self, patch: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Return what `point_and_normal` does, and the error of the point along the normal."""
        jet = self.jet(patch, u, v, active)
        n = self.normal(jet, patch, u, v, active)
        p = mi.Point3f(single(jet.point))
        return p, n, jet.area(), jet.error(p, n)

    def sign(self, patch: Any, active: Any, place: Any = None) -> Any:
        """Return the sign of the normal along ``dp_du x dp_dv``."""
        number = dr.gather(mi.UInt32, self.shape_of, patch, active)
        sign = dr.gather(mi.Float, self.orientation, number, active)
        # a mirror image keeps its outside out
        return sign if place is None else dr.mulsign(sign, mi.Float(dr.det(dr.detach(place[0]))))

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

    def coordinates(self, patch: Any, u: Any, v: Any, active: Any) -> Any:
        """Return the texture coordinates `mi.Point2f` of a point that is on no copy."""
        uv = self.texture(patch, u, v, active)[0]
        if self.projections is None:
            return uv
        jet = self.jet(patch, u, v, active)
        shape = dr.gather(mi.UInt32, self.shape_of, patch, active)
        seen = self.projections.project(shape, jet.point, mi.Normal3f(0, 0, 1), active)
        return dr.select(seen.here, seen.uv, uv)

    def project(self, patch: Any, p: Any, n: Any, active: Any, place: Any) -> Any:
        """Return what `Projections.project` does."""
        shape = dr.gather(mi.UInt32, self.shape_of, patch, active)
        linear = None if place is None else place[0]
        return self.projections.project(shape, p, n, active, linear)

    def _limit_normal(self, patch: Any, u: Any, v: Any, flat: Any, place: Any) -> Any:
        inner, outer = (
            self._normal_inside(patch, u, v, flat, place, step) for step in (_STEP, 2 * _STEP)
        )
        limit = 2.0 * _unit(inner) - _unit(outer)
        limit = dr.select(dr.squared_norm(outer) > 0, limit, _unit(inner))
        return dr.select(dr.squared_norm(inner) > 0, limit, type(inner)(0, 0, 1))

    def _normal_inside(
        self, patch: Any, u: Any, v: Any, active: Any, place: Any, step: float
    ) -> Any:
        """Return ``dp_du x dp_dv`` a step towards the centroid."""
        u, v = (x + step * (1 / 3 - x) for x in (u, v))
        if self.pairs:
            return single(cross(*self.jet(patch, u, v, active, place).tangents()[:2]))
        u, v = (mi.Float64(mi.Float(x)) for x in (u, v))
        h = self._jet(patch, u, v, active)
        h = h if place is None else placed(h, place[0])
        _p, pu, pv = affine_partials(*h)
        return dr.cross(mi.Vector3d(*pu), mi.Vector3d(*pv))


def placed(h: list[list[Any]], a: Any) -> list[list[Any]]:
    """Return homogeneous points and partials under linear maps."""
    if isinstance(h[0][0], TwoFloat):
        wide = [[*dot_rows(a, x[:3]), x[3]] for x in h[:3]]
        return [*wide, *([*(a @ mi.Vector3f(*x[:3])), x[3]] for x in h[3:])]
    kind = mi.Vector3d if type(h[0][0]) is mi.Float64 else mi.Vector3f
    return [[*(a @ kind(*x[:3])), x[3]] for x in h]


def _size(a: Any, b: Any) -> Any:
    return dr.norm(single(a)) + dr.norm(single(b))


def _where(mask: Any, x: Any) -> Any:
    """Return a number where the mask is set and zero elsewhere, with its derivatives everywhere."""
    if isinstance(x, TwoFloat):
        return TwoFloat(_where(mask, x.hi), None if x.lo is None else dr.select(mask, x.lo, 0.0))
    return dr.replace_grad(dr.select(mask, x, 0.0), x)


def _unit(n: Any) -> Any:
    """Return vectors of length one; `dr.rsqrt` of float64 is not exact on CUDA."""
    return n * (1.0 / dr.sqrt(dr.squared_norm(n)))


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
    """Return the `mi.SurfaceInteraction3f` of `meet`."""
    return meet(tables, hit, ray, flags, active).si


def meet(tables: PatchTables, hit: Preliminary, ray: Any, flags: Any, active: Any) -> Met:
    """Return the interaction of hits on patches, and the error of its point; invalid elsewhere.

    All fields are those of Mitsuba's own shapes. ``dn_du``, ``dn_dv`` are computed on request
    (`mi.RayFlags.dNGdUV` or `dNSdUV`: the shading normal is the true one). Partials are by the
    texture coordinates `uv`. Where the nets or the ray carry derivatives, so do all fields: along
    the ray, or with `mi.RayFlags.FollowShape` at fixed parameters.
    """
    ours = hit.bezier & mi.Bool(active)
    if dr.grad_enabled(*tables.sources, ray):  # Dr.Jit does not differentiate what a branch gathers
        return Met(*_interaction(tables, hit, ray, flags, ours))
    # a gather costs a packet the same for one ray as for all: none where no ray hits a patch
    return Met(
        *dr.if_stmt(
            args=(hit, ray, ours),
            cond=ours,
            true_fn=lambda hit, ray, ours: _interaction(tables, hit, ray, flags, ours),
            false_fn=lambda _hit, ray, _ours: _no_interaction(ray),
            label="bezier interaction",
        )
    )


def _no_interaction(ray: Any) -> tuple[Any, Any]:
    """Return what Mitsuba takes for a miss."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    si.t = dr.full(mi.Float, dr.inf, dr.width(ray))  # as wide as hits would be
    si.time, si.wavelengths = ray.time, ray.wavelengths
    si.wi = -ray.d
    return si, dr.zeros(mi.Float, dr.width(ray))


def _interaction(
    tables: PatchTables, hit: Preliminary, ray: Any, flags: Any, ours: Any
) -> tuple[Any, Any]:
    """Return the interactions of the hits `ours`; see `meet`."""
    pi = hit.pi
    u, v, t = pi.prim_uv.x, pi.prim_uv.y, pi.t
    follows_shape = mi.has_flag(flags, mi.RayFlags.FollowShape)
    place = tables.place(hit.pi.shape_index, ours)
    jet = tables.jet(hit.patch, u, v, ours, place)
    du, dv, dt, small = jet.step_to(ray, t, ours)
    # The hit point is the patch's, not o + t d. But (u, v) are float32 numbers too, and where
    # a patch runs to infinity a rounding of them moves the point further than one of t.
    far = ~small & jet.is_far(ray, t)
    if follows_shape:
        du, dv = detach(du), detach(dv)
    else:
        t = dr.replace_grad(t, mi.Float(dt))
    jet = jet.moved(du, dv)
    u, v = (narrow(widen(jet.pairs, x) + y) for x, y in ((u, du), (v, dv)))
    n = tables.normal(jet, hit.patch, u, v, ours, place)
    exact = choose(far, along(t, ray.d, vector(jet.pairs, ray.o)), jet.point)
    p = mi.Point3f(single(exact))
    p_err = dr.select(ours, jet.error(p, n), 0.0)
    pu, pv = single(jet.pu), single(jet.pv)
    if follows_shape and dr.grad_enabled(*tables.sources, ray):
        t = dr.replace_grad(t, dr.norm(dr.select(ours, p - ray.o, 1.0)) / dr.norm(ray.d))
    uv, duv_du, duv_dv = tables.texture(hit.patch, u, v, ours)
    wants_dn = mi.has_flag(flags, mi.RayFlags.dNGdUV) or mi.has_flag(flags, mi.RayFlags.dNSdUV)
    nu = nv = mi.Vector3f(0.0)
    projected, tangents = None, []
    if tables.projections is not None:
        if place is not None:  # instances have the texture of what they are instances of
            first = tables.jet(hit.patch, pi.prim_uv.x, pi.prim_uv.y, ours).moved(du, dv)
            exact = first.point
        projected = tables.project(hit.patch, exact, n, ours, place)
        tangents = [projected.du, projected.dv]
    if wants_dn:
        nu, nv, *turned = tables.normal_partials(pu, pv, hit.patch, u, v, ours, place, tangents)
    if tables.texcoords is not None:
        pu, pv, regular = _by_texture(pu, pv, duv_du, duv_dv)
        # as Mitsuba's meshes: any basis where texture coordinates do not tell one
        some, other = mi.coordinate_system(n)
        pu, pv = dr.select(regular, pu, some), dr.select(regular, pv, other)
        if wants_dn:
            nu, nv, _ = _by_texture(nu, nv, duv_du, duv_dv)
            nu, nv = dr.select(regular, nu, 0.0), dr.select(regular, nv, 0.0)
    if projected is not None:
        here, regular = projected.here, projected.regular
        some, other = mi.coordinate_system(n)
        uv = dr.select(here, projected.uv, uv)
        pu = dr.select(here, dr.select(regular, projected.du, some), pu)
        pv = dr.select(here, dr.select(regular, projected.dv, other), pv)
        if wants_dn:
            # a unit normal changes across itself; beside a collapsed edge this is a point nearby
            turned = [x - n * dr.dot(n, x) for x in turned]
            nu, nv = (
                dr.select(here, dr.select(regular, a, 0.0), b) for a, b in zip(turned, (nu, nv))
            )

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
    return si, p_err
