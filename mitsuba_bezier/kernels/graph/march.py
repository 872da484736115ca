"""March rays with certainty to their first meeting with a graph leaf.

``docs/intersection.md`` gives the argument.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from ...leaves.records import BENDING_LIMIT, SIZES, LeafKind
from ..arrays import inverse_root, reciprocal, types_of
from ..buckets import Bucket, by_bucket
from ..edges import edge_tolerance
from ..leaf_nets import LeafNet, gather_net
from ..query import Found, Query, Rays
from ..structure import AFFINE, PROJECTIVE
from ..trim import leaf_test
from ..two_float import TwoFloat
from .chart import (
    ChartLine,
    ChartRays,
    affine_quadratic,
    affine_rays,
    projective_rays,
    root_fraction,
)
from .grazing import LeafPlace, correction, polish

__all__ = ["march"]

#: Steps below this (in leaf sizes) are the last: the error after it is its square times what the
#: leaf's bounds leave open of the second derivative, below the rounding of float32.
LAST_STEP = 1e-4
#: ... and in projective charts, where a point at distance t lies 1/t of the leaf's size from
#: the plane at infinity: 1e-12 there is 1e-6 of t at t = 1e6.
LAST_STEP_PROJECTIVE = 1e-6
#: A march that has not ended after this many steps is given up as a miss. Nearly all take less than
#: ten; along the lines of a ruled surface, at a cosine `c`, it is some `1 / sqrt(c)`.
MAX_STEPS = 1024


def march(query: Query, leaf: Any, line: ChartLine, rays: Rays, active: Any) -> Found:
    """Find the first hit in a graph leaf; or only whether there is one, as the query asks."""
    s = query.s
    if not s.has(LeafKind.GRAPH_PROJECTIVE):
        return _march_affine(query, leaf, line, rays, active)
    if not s.has(LeafKind.GRAPH_AFFINE):
        return _march_projective(query, leaf, line, rays, active)
    return dr.if_stmt(
        args=(leaf, line, rays, active),
        cond=leaf < s.first_projective,
        true_fn=lambda leaf, line, rays, m: _march_affine(query, leaf, line, rays, m),
        false_fn=lambda leaf, line, rays, m: _march_projective(query, leaf, line, rays, m),
        label="bezier march",
    )


def _march_affine(query: Query, leaf: Any, line: ChartLine, rays: Rays, active: Any) -> Found:
    s, ty = query.s, query.ty

    def task(
        bucket: Bucket, number: Any, leaf: Any, line: ChartLine, rays: Rays, active: Any
    ) -> Found:
        record = AFFINE.gather(s.affine, leaf, active)
        net = gather_net(bucket, number, active)
        there = affine_rays(ty, record, line.base, rays)
        surface = _Surface(net, affine_quadratic(ty, record), leaf_test(s, leaf))
        best = _March(surface, there, line, LAST_STEP).run(rays.t_max, active)
        if query.any_hit:
            return Found(best.hit, best.t, best.u, best.v, leaf)
        place = LeafPlace(leaf, bucket, number)
        return Found(best.hit, *polish(query, place, line.base, rays, best), leaf)

    return by_bucket(s.nets, leaf, (leaf, line, rays, active), task)


def _march_projective(query: Query, leaf: Any, line: ChartLine, rays: Rays, active: Any) -> Found:
    """March in float64: distances to the plane at infinity are differences of numbers near one.

    Where wide numbers are pairs of float32 the march is in float32, and each root is made exact.
    """
    s, ty = query.s, query.ty

    def task(
        bucket: Bucket, number: Any, leaf: Any, line: ChartLine, rays: Rays, active: Any
    ) -> Found:
        record = PROJECTIVE.gather(s.projective, leaf - s.first_projective, active)
        net = gather_net(bucket, number, active)
        there = projective_rays(ty, record, rays)
        surface = _Surface(net, record.quadratic, leaf_test(s, leaf))
        if ty.pairs:
            x0, e = ([ty.narrow(x) for x in y] for y in (there.x0, there.e))
            single = replace(there, x0=x0, e=e)
            marched = _March(surface, single, line, LAST_STEP, exact=there)
        else:
            marched = _March(surface, there, line, LAST_STEP_PROJECTIVE)
        best = marched.run(rays.t_max, active)
        return Found(best.hit, best.t, ty.Float(best.u), ty.Float(best.v), leaf)

    number = leaf - s.first_projective
    return by_bucket(s.far_nets, number, (leaf, line, rays, active), task)


@dataclass(frozen=True)
class _Surface:
    """A leaf in its chart."""

    net: LeafNet
    quadratic: list[Any]  #: a, b, c
    kept: Callable[..., Any] | None  #: returns a mask of roots that are not trimmed away


@dataclass
class _Place:
    """Where a march is."""

    step: Any  #: UInt
    tau: Any  #: before this there is no (further) meeting with the surface
    u: Any  #: parameters near the chart point under the ray
    v: Any
    sign: Any  #: side of the surface on which the ray is, zero if not known


@dataclass
class _Root:
    """How the ray meets the surface where a march has come to."""

    found: Any  #: Bool
    slope: Any  #: of the ray's height over the surface
    normal2: Any  #: square of the length of the surface's normal, whose height is one


@dataclass
class Best:
    """The first hit so far."""

    hit: Any
    t: Any
    u: Any
    v: Any
    closing: Any  #: how fast the ray comes nearer to the surface, leaf sizes a unit of `t`


class _March:
    """The march along the image ``x0 + tau e`` of a ray, in the precision of that.

    It keeps a chart parameter ``tau`` before which there is no (further) meeting with the
    surface, and steps to the first zero of the quadratic lower bound that the value, the slope and
    the stored bound on the second derivative give, which never jumps over a root and converges
    quadratically to it, also when two roots are close.

    Parameters
    ----------
    surface : _Surface
    there : ChartRays
    line : ChartLine
        Where culling came to.
    last_step : float
        Steps below this are the last.
    exact : ChartRays, optional
        The same rays in wide numbers, with which roots are made exact.
    """

    def __init__(
        self,
        surface: _Surface,
        there: ChartRays,
        line: ChartLine,
        last_step: float,
        exact: ChartRays | None = None,
    ) -> None:
        self.surface, self.there, self.last_step = surface, there, last_step
        self.exact = exact
        self.ty = ty = types_of(there.x0[0])
        net = surface.net
        size = dr.floor(net.bending * (1.0 / BENDING_LIMIT))
        self.bending = dr.fma(size, -BENDING_LIMIT, net.bending)
        # the bounds hold for parameters with barycentrics down to `low`, up to `high`
        self.low = -SIZES[0] * dr.exp2(size * 0.5)
        self.high = 1.0 - 2.0 * self.low
        self.quadratic = a, b, c = tuple(ty.Float(x) for x in surface.quadratic)
        ex, ey, ez = there.e
        self.gamma, self.end = ty.Float(line.gamma), ty.Float(line.end)
        self.begin, self.side = ty.Float(line.tau), ty.Float(line.sign)
        lateral2 = dr.fma(ex, ex, ey * ey)
        self.wobble = 0.5 * net.variation * lateral2  # half what is open of the second derivative
        speed2 = dr.fma(ez, ez, lateral2)
        self.speed = dr.sqrt(speed2)
        self.longest = 2.0 * last_step * reciprocal(self.speed)
        self.tilt = 2.0 * self.bending * dr.sqrt(lateral2)
        # the quadratic's mixed second derivative along the ray and along the axes
        self.mixed_x = dr.fma(a, ey, -dr.fma(b, ex + ex + ey, c * ey))
        self.mixed_y = dr.fma(a, ex, -dr.fma(b, ex, c * (ex + ey + ey)))

    def run(self, t_max: Any, active: Any) -> Best:
        """March to the first root that counts."""
        ty, zero = self.ty, dr.zeros(self.ty.Float)
        place = _Place(ty.UInt(0), self.begin, *self._start(self.begin), self.side)
        best = Best(ty.Bool(False), t_max, zero, zero, zero)

        def body(run: Any, place: Any, best: Any) -> Any:
            one = dr.full(ty.Float, 1.0)
            _go, place, root = dr.while_loop(
                (run, place, _Root(ty.Bool(False), one, one)),
                cond=lambda *st: st[0],
                body=self._advance,
                labels=("go", "place", "root"),
                label="bezier leaf steps",
            )
            accept, best = self._accept(run, place, root, best)
            return *self._go_on(run, place, root, accept), best

        return dr.while_loop(
            (active, place, best),
            cond=lambda *st: st[0],
            body=body,
            labels=("run", "place", "best"),
            label="bezier leaf march",
        )[2]

    def _held(self, u: Any, v: Any) -> tuple[Any, Any]:
        """Return the parameters themselves, or others where the bounds hold."""
        low, high = self.low, self.high
        u = dr.select(u < low, low, dr.select(u > high, high, u))
        top = 1.0 - low - u
        return u, dr.select(v < low, low, dr.select(v > top, top, v))

    def _start(self, tau: Any) -> tuple[Any, Any]:
        """Return parameters near the chart point under the ray, where the bounds hold."""
        (x0, y0, _z0), (ex, ey, _ez) = self.there.x0, self.there.e
        x, y = dr.fma(tau, ex, x0), dr.fma(tau, ey, y0)
        w = 1.0 - x - y
        xy, xw, yw = x * y, x * w, y * w
        to_u, to_v = (dr.fma(q[0], xy, dr.fma(q[1], xw, q[2] * yw)) for q in self.surface.net.start)
        return self._held(x + to_u, y + to_v)

    def _advance(self, go: Any, place: Any, _root: Any) -> Any:
        """Do a step: return whether to go on, where to, and whether there is a root."""
        (x0, y0, z0), (ex, ey, ez) = self.there.x0, self.there.e
        (a, b, c), last_step, gamma = self.quadratic, self.last_step, self.gamma
        tau, u, v, sign = place.tau, place.u, place.v, place.sign
        point, d_du, d_dv = self.surface.net.point(u, v, go)
        (x, y, z), (xu, yu, zu), (xv, yv, zv) = point, d_du, d_dv
        idet = reciprocal(dr.fma(xu, yv, -xv * yu))
        rx, ry = dr.fma(tau, ex, x0) - x, dr.fma(tau, ey, y0) - y
        du, dv = dr.fma(yv, rx, -xv * ry) * idet, dr.fma(xu, ry, -yu * rx) * idet
        eu, ev = dr.fma(yv, ex, -xv * ey) * idet, dr.fma(xu, ey, -yu * ex) * idet
        # the surface on the ray's vertical: tangent plane and the quadratic's second derivative
        bent = dr.fma(rx, dr.fma(a, ry, -b * (rx + ry)), -c * ry * (rx + ry))
        value = dr.fma(tau, ez, z0) - z - dr.fma(zu, du, dr.fma(zv, dv, bent))
        slope = ez - dr.fma(zu, eu, zv * ev) - dr.fma(rx, self.mixed_x, ry * self.mixed_y)
        off2 = dr.fma(rx, rx, ry * ry)
        slack = self.bending * off2  # what that may miss
        # The side is known from the entry on, or as soon as the value says it for certain;
        # until then the march stays where it is and only (u, v) improve.
        certain = (sign != 0.0) | (dr.abs(value) > slack) | (off2 < 1e-3 * last_step * last_step)
        sign = dr.select(certain & (sign == 0.0), dr.copysign(self.ty.Float(1), value), sign)
        signed = sign * value
        signed_slope = dr.fma(sign, slope, -self.tilt * (dr.abs(rx) + dr.abs(ry)))
        sure = dr.select(signed > 0.0, dr.maximum(signed - slack, 0.0), signed)
        num, den, exists = root_fraction(sure, signed_slope, dr.fma(sign, gamma, -self.wobble))
        num, den = dr.select(certain, num, 0.0), dr.select(certain, den, 1.0)
        exists = exists | ~certain
        root = exists & (dr.abs(num) * self.speed < last_step * den)
        root = root & (dr.abs(value) * self.speed < last_step * dr.abs(slope))
        # No step leads past a root. On its other side, with the bound's zeros nowhere, there is no
        # other way to come but by rounding: the root is at hand
        root = certain & (off2 < last_step * last_step) & (root | (~exists & (signed < 0.0)))
        # the last step is Halley's, without the slack; Newton's where the two differ much
        square = slope * slope
        bend = dr.clip(gamma * value, -0.5 * square, 0.5 * square)
        delta = dr.select(root, -value * slope, num) / dr.select(root, square - bend, den)
        delta = dr.select(root, dr.clip(delta, -self.longest, self.longest), delta)
        tau = tau + delta
        u, v = u + dr.fma(eu, delta, du), v + dr.fma(ev, delta, dv)
        held_u, held_v = self._held(u, v)
        u, v = dr.select(root, u, held_u), dr.select(root, v, held_v)
        step = place.step + 1
        go = go & ~root & exists & (tau <= self.end) & (step < MAX_STEPS)
        normal2 = dr.fma(zu, zu, dr.fma(zv, zv, 1.0))
        return go, _Place(step, tau, u, v, sign), _Root(root, slope, normal2)

    def _accept(self, run: Any, place: _Place, root: _Root, best: Best) -> tuple[Any, Best]:
        """Return a mask of roots that are on the leaf and nearer than the best, and the best."""
        u, v, tau = place.u, place.v, place.tau
        if self.exact is not None:
            tau, *at = (TwoFloat(x) for x in (tau, u, v))
            found = run & root.found
            step = correction(self.surface.net, self.exact, tau, at[0], at[1], found)
            small = dr.abs(step[0]) * self.speed < self.last_step  # false for NaN
            tau = tau + dr.select(small, step[0], 0.0)
            u, v = (x + dr.select(small, y, 0.0) for x, y in zip((u, v), step[1:]))
        closing = dr.abs(root.slope) * inverse_root(root.normal2)
        tolerance = edge_tolerance(closing * reciprocal(self.speed))
        inside = dr.minimum(dr.minimum(u, v), 1.0 - u - v) >= -tolerance
        t = self.there.parameter(tau)
        accept = run & root.found & inside & (t > 0.0) & (t < best.t)
        if self.surface.kept is not None:
            accept = accept & self.surface.kept(u, v, accept)
        return accept, Best(
            hit=best.hit | accept,
            t=dr.select(accept, t, best.t),
            u=dr.select(accept, u, best.u),
            v=dr.select(accept, v, best.v),
            closing=dr.select(accept, closing, best.closing),
        )

    def _go_on(self, run: Any, place: _Place, root: _Root, accept: Any) -> tuple[Any, _Place]:
        """Go on from the other side of the surface, if the bound lets it come back."""
        back = dr.fma(place.sign, self.gamma, self.wobble)
        run = run & root.found & (~accept | self.there.turns) & (back > 0.0)
        tau = place.tau + dr.abs(root.slope) / back
        u, v = self._start(tau)
        run = run & (tau <= self.end) & (place.step < MAX_STEPS)
        return run, replace(place, tau=tau, u=u, v=v, sign=-place.sign)
