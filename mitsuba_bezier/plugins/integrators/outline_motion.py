"""How an outline moves before a ray that passes it: a number that is 0 there, with derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ...kernels.trim import keep
from ..interaction import Preliminary
from ..scene import SceneRays
from .trim_motion import TrimMotion

__all__ = ["Outline"]

#: Cosine between ray and normal below which a hit is at a contour: it is a few thousandths there.
_GRAZING = 0.05
#: Barycentric coordinate below which a hit is at an edge.
_AT_EDGE = 1e-3
#: Relative difference of distances below which two surfaces meet.
_TOGETHER = 1e-3
#: Radius of a circle on which a border is looked for, far above rounding: in parameters of a
#: patch, or relative to the distance.
_CIRCLE = 1e-3
#: Relative difference of distances below which a hit on the same shape is beside another one.
_SAME = 1e-3
#: Parts of it that are looked at, and halvings of these.
_SECTORS, _HALVINGS = 16, 10


@dataclass
class Outline:
    """Points of outlines that rays pass, without derivatives, and what is 0 there."""

    near: Any = None  #: Preliminary, the hit on the surface that ends there
    far: Any = None  #: Preliminary, the hit on the other side
    p: Any = None  #: Point3f of the first
    q: Any = None  #: Point3f of the second
    n: Any = None  #: Vector3f, across ray and outline; what distances from `p` count
    m: Any = None  #: Vector3f, what distances from `q` count
    t: Any = None  #: Float, where on the ray
    known: Any = None  #: Bool, False where it is not clear

    cut: Any = None  #: Bool: it is a trimming curve with derivatives
    row: Any = None  #: UInt, of its segment
    s: Any = None  #: Float, where on that

    DRJIT_STRUCT = dict.fromkeys(
        ("near", "far", "p", "q", "n", "m", "t", "known", "cut", "row", "s"), Any
    )

    @staticmethod
    def passed_by(
        rays: SceneRays,
        sides: list[tuple[Any, Preliminary]],
        active: Any,
        trims: TrimMotion | None = None,
    ) -> Outline:
        """Return the outlines between rays that are next to each other.

        Parameters
        ----------
        rays : SceneRays
        sides : list of (mi.Ray3f, Preliminary)
            A ray on each side, and what it meets.
        active : Bool
        trims : TrimMotion, optional
            Trimming curves with derivatives.
        """
        data = rays.data
        assert data is not None
        (ray_a, a), (ray_b, b) = sides
        d = ray_a.d
        before = _distance(a) <= _distance(b)
        near = dr.select(before, a, b)
        far = dr.select(before, b, a)
        si = rays.surface_interaction(near, dr.select(before, ray_a, ray_b), None, active)
        behind = rays.surface_interaction(far, dr.select(before, ray_b, ray_a), None, active)
        ours = active & near.bezier
        cosine = dr.abs(dr.dot(si.n, d))
        # the nearest edge, and the nearest that is open
        uv, edges = near.pi.prim_uv, dr.gather(mi.UInt32, data.open_edges(), near.patch, ours)
        place = data.tables.place(near.pi.shape_index, ours)
        _p, pu, pv = data.tables.partials(near.patch, uv.x, uv.y, ours, place)
        nearest, open_ = mi.Float(dr.inf), mi.Float(dr.inf)
        tangent, open_tangent = mi.Vector3f(0.0), mi.Vector3f(0.0)
        for bit, (x, line) in enumerate(((1 - uv.x - uv.y, pu - pv), (uv.x, pv), (uv.y, pu))):
            x = dr.abs(x)
            tangent = dr.select(x < nearest, line, tangent)
            nearest = dr.minimum(x, nearest)
            is_open = ((edges & (1 << bit)) != 0) & (x < open_)
            open_tangent = dr.select(is_open, line, open_tangent)
            open_ = dr.select(is_open, x, open_)
        # the number that is nearer to 0, the sizes of both as they are at an outline
        grazes = cosine < _GRAZING
        edge = ours & (open_ < _AT_EDGE) & (~grazes | (_GRAZING / _AT_EDGE * open_ < cosine))
        contour = active & grazes & ~edge & near.pi.is_valid()
        close = dr.abs(_distance(b) - _distance(a)) < _TOGETHER * _distance(near)
        same = si.shape == behind.shape
        crease = ours & close & same & (nearest < _AT_EDGE) & ~edge & ~contour
        meeting = active & close & ~same & ~edge & ~contour & far.pi.is_valid()
        line = dr.select(crease, tangent, open_tangent)
        cut = mi.Bool(False)
        if data.trim is not None:
            cut = ours & ~(edge | contour | crease | meeting)
            du, dv, found = _border(_in_trims(data.trim, near.patch, uv, cut), cut)
            cut = cut & found
            line = dr.select(cut, pu * du + pv * dv, line)
        row, s, moves = mi.UInt32(0), mi.Float(0.0), mi.Bool(False)
        if trims is not None:
            row, s, moves = trims.nearest(near.patch, uv, cut)
        if data.scene_has_others:
            other = active & ~near.bezier & near.pi.is_valid() & ~(contour | meeting)
            ray = dr.select(before, ray_a, ray_b)
            du, dv, found = _border(_on_shape(rays, near, ray, si, other), other)
            other = other & found
            cut = cut | other
            frame = mi.Frame3f(si.n)
            line = dr.select(other, frame.s * du + frame.t * dv, line)
        n = dr.select(contour, si.n - d * dr.dot(si.n, d), dr.cross(d, line))
        n = dr.normalize(n)
        known = edge | contour | crease | meeting | cut
        n = dr.select(meeting, si.n / dr.dot(si.n, d), n)
        other = dr.select(meeting, -behind.n / dr.dot(behind.n, d), 0.0)
        t = near.pi.t
        n = dr.select(known, n, 0.0)
        return Outline(near, far, si.p, behind.p, n, other, t, known, moves, row, s)

    def gap(self, tables: Any, ray: Any, trims: TrimMotion | None = None) -> Any:
        """Return what is 0 where a ray passes the outline, with derivatives by ray and shapes.

        Of a contour or an edge it is the distance between ray and outline, across both; of a line
        in which two surfaces meet, the distance between them along the ray.
        """
        along = ray.o + self.t * ray.d
        gap = dr.dot(self.n, _moving(tables, self.near, self.p) - along)
        if trims is not None:
            uv, place = self.near.pi.prim_uv, tables.place(self.near.pi.shape_index, self.cut)
            _p, pu, pv = tables.partials(self.near.patch, uv.x, uv.y, self.cut, place)
            du, dv = trims.shift(self.row, self.s, self.cut)
            shift = dr.dot(self.n, dr.detach(pu)) * du + dr.dot(self.n, dr.detach(pv)) * dv
            gap += dr.select(self.cut, shift, 0.0)
        return gap + dr.dot(self.m, _moving(tables, self.far, self.q) - along)


def _in_trims(table: Any, patch: Any, uv: Any, active: Any) -> Callable[[Any, Any], Any]:
    """Return what tells whether there is surface beside `uv`, by parameters of the patch."""

    def inside(x: Any, y: Any) -> Any:
        return mi.Bool(keep(table, patch, uv.x + x * _CIRCLE, uv.y + y * _CIRCLE, active))

    return inside


def _on_shape(
    rays: SceneRays, hit: Preliminary, ray: Any, si: Any, active: Any
) -> Callable[[Any, Any], Any]:
    """Return what tells whether there is surface beside a hit on a shape of any kind.

    Rays ask for it, so nothing has to be known of the shape. Coordinates are those of the tangent
    plane, in thousandths of the distance.
    """
    frame, radius = mi.Frame3f(si.n), _CIRCLE * hit.pi.t

    def inside(x: Any, y: Any) -> Any:
        to = si.p + radius * (x * frame.s + y * frame.t) - ray.o
        distance = dr.norm(to)
        there = mi.Ray3f(ray)
        there.d, there.maxt = to / distance, dr.largest(mi.Float)
        met = rays.preliminary(there, False, active)
        near = dr.abs(met.pi.t - distance) < _SAME * distance
        return met.pi.is_valid() & (met.pi.shape == hit.pi.shape) & near

    return inside


def _border(inside: Callable[[Any, Any], Any], active: Any) -> tuple[Any, Any, Any]:
    """Return the direction of a border that a point is on, and whether there is one.

    It is that between the two places where a circle around the point crosses the border.

    Parameters
    ----------
    inside : callable
        Whether there is surface at a place on the unit circle.
    active : Bool
    """

    def at(turn: Any) -> Any:
        sine, cosine = dr.sincos(dr.two_pi * turn)
        return inside(cosine, sine)

    def step(k: Any, last: Any, enter: Any, leave: Any) -> tuple[Any, ...]:
        turn = mi.Float(k) / _SECTORS
        here = at(turn)
        before = turn - 1 / _SECTORS
        return (
            k + 1,
            here,
            dr.select(here & ~last, before, enter),
            dr.select(~here & last, before, leave),
        )

    width = dr.width(active)
    none = dr.full(mi.Float, -1, width)
    _k, _last, enter, leave = dr.while_loop(
        (mi.UInt32(1), at(dr.zeros(mi.Float, width)), none, none),
        lambda k, _last, _enter, _leave: k <= _SECTORS, step, label="bezier outlines: sectors",
    )  # fmt: skip

    def halve(k: Any, size: Any, enter: Any, leave: Any) -> tuple[Any, ...]:
        size = 0.5 * size
        enter = dr.select(at(enter + size), enter, enter + size)
        leave = dr.select(at(leave + size), leave + size, leave)
        return k + 1, size, enter, leave

    found = active & (enter >= 0) & (leave >= 0)
    _k, _size, enter, leave = dr.while_loop(
        (mi.UInt32(0), mi.Float(1 / _SECTORS), enter, leave),
        lambda k, _size, _enter, _leave: k < _HALVINGS, halve, label="bezier outlines: circle",
    )  # fmt: skip
    (s0, c0), (s1, c1) = dr.sincos(dr.two_pi * enter), dr.sincos(dr.two_pi * leave)
    return c1 - c0, s1 - s0, found


def _distance(hit: Preliminary) -> Any:
    return dr.select(hit.pi.is_valid(), hit.pi.t, dr.largest(mi.Float))


def _moving(tables: Any, hit: Preliminary, p: Any) -> Any:
    """Return the point of a hit as it moves with its patch."""
    uv = hit.pi.prim_uv
    place = tables.place(hit.pi.shape_index, hit.bezier)
    moved, _pu, _pv = tables.partials(hit.patch, uv.x, uv.y, hit.bezier, place)
    return dr.replace_grad(p, dr.select(hit.bezier, moved, p))
