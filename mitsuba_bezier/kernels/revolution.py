"""March rays with certainty to their first meeting with an even asphere.

In axes in which the aperture's radius is one, the height ``z - f(x^2 + y^2)`` of a ray over the
surface is a function h of one number. Where the ray is in one cell of ``s = x^2 + y^2`` (see
`leaves.revolution`), its second derivative ``-(f'' s'^2 + f' s'')`` has a bound: s is quadratic
along the ray, and f' and f'' are bounded in the cell. So a step to the first zero of a quadratic
function below the height, or to the cell's end, passes no root, and close to one it is Newton's.
This is done in float32. Each root is then made exact in float64, with the sag's own formula, before
it is asked whether it is within the rims and the ray: so both are decided as exactly as the
numbers of the prescription are known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..geometry.aspheres import LEG, START
from ..leaves.revolution import MARGIN
from .arrays import dot3, gather_packets, reciprocal
from .graph.chart import root_fraction
from .query import Found, Query, Rays
from .revolution_records import revolution_record, sag_and_slopes
from .two_float import absolute, coarse, fma, full, select, sqrt

__all__ = ["revolution_hit"]

#: All lengths are in units of the aperture's radius.
#: Roundings of float32 in the height, over its gradient: a height below this may be a root.
_NOISE = 3e-7
#: The march begins so far before the ray, and ends behind it: roots at its ends are found, and made
#: exact before they are turned down.
_BEFORE = 1e-3
#: How far a step goes on from a cell's end, a root, or a place that was taken for one.
_PUSH = 1e-6
#: A root that float32 has is not further off than this, even where the ray grazes.
_FAR = 0.05
#: The rims' tolerance, in radii: that of all edges.
_RIM = 1e-6
#: A march that has not ended after this many steps is given up as a miss. Most take three to ten.
_MAX_STEPS = 8192
#: Steps in wide numbers; two are enough but where two roots nearly meet. Between two sides, half of
#: the steps are bisections.
_EXACT_STEPS, _BETWEEN_STEPS = 6, 80
#: The step from a place where there was no root after all.
_ON = 1e-4
#: Before all marches.
_NOWHERE = -1e30


@dataclass
class _Place:
    """Where a march is."""

    step: Any  #: UInt
    tau: Any
    sign: Any  #: side of the surface on which the ray is, zero if not known
    #: Bool: whether the ray comes from a root: then a small height is no other one, while it grows
    fresh: Any
    known: Any  #: where the ray was on that side for certain, last; `_NOWHERE` if nowhere
    #: Bool: whether it is on the other side now, though no root was seen: there the surface and the
    #: ray have more than a direction in common
    between: Any


@dataclass
class _Exact:
    """A root in wide numbers."""

    step: Any  #: UInt
    tau: Any
    low: Any  #: bounds of it, where there are some
    high: Any
    real: Any  #: Bool: whether there is a root at all
    side: Any  #: of the surface on which the ray is where the search began


def revolution_hit(query: Query, number: Any, rays: Rays, active: Any) -> Found:
    """Find the first hit with an even asphere."""
    return _March(query, number, rays, active).run(rays.t_max, active)


class _March:
    """The march along the image ``x0 + tau e`` of a ray, `e` of length one."""

    def __init__(self, query: Query, number: Any, rays: Rays, active: Any) -> None:
        assert query.s.revolutions is not None
        self.ty, self.leaves, self.number = query.ty, query.s.revolutions, number
        ty = self.ty
        self.record = revolution_record(self.leaves.coefficients)
        m = self.record.gather(self.leaves.records, number, active, "steps")
        o = [ty.widen(rays.o[i]) - m.shift[i] for i in range(3)]
        d = [ty.widen(x) for x in rays.d]
        x, e = ([dot3(row, y) for row in m.axes] for y in (o, d))
        self.scale = 1.0 / sqrt(dot3(e, e))
        e = [y * self.scale for y in e]
        # from the point of the ray that is nearest to the middle of the leaf
        self.tau0 = -dot3([x[0], x[1], x[2] - 0.5 * (m.low + m.high)], e)
        x = [fma(self.tau0, e[i], x[i]) for i in range(3)]
        self.exact = x, e
        self.x0, self.e = [ty.narrow(y) for y in x], [ty.narrow(y) for y in e]
        self.a = dr.fma(self.e[0], self.e[0], self.e[1] * self.e[1])
        self.inner2 = m.inner2
        self.grading = ty.narrow(m.grading)
        self.spread = reciprocal(self.grading)
        self.shift = 23 - ty.whole(m.steps)
        self.cells = ty.whole(m.cells)
        self._bound(ty.narrow(m.low), ty.narrow(m.high), rays.t_max)

    def _bound(self, low: Any, high: Any, t_max: Any) -> None:
        """Find the piece of the ray within the leaf's cylinder."""
        ty = self.ty
        (x, y, z), (ex, ey, ez) = self.x0, self.e
        # along the axis both ends are far away
        a = dr.maximum(self.a, 1e-20)
        b = dr.fma(x, ex, y * ey)
        c = dr.fma(x, x, y * y) - (1.0 + MARGIN / 2)
        disc = dr.fma(b, b, -a * c)
        h = -(b + dr.copysign(dr.sqrt(dr.maximum(disc, 0.0)), b))
        one, other = c / h, h / a
        begin, end = dr.minimum(one, other), dr.maximum(one, other)
        rising = reciprocal(dr.copysign(dr.maximum(dr.abs(ez), 1e-12), ez))
        pad = 1e-3
        one, other = (low - pad - z) * rising, (high + pad - z) * rising
        begin = dr.maximum(begin, dr.minimum(one, other))
        end = dr.minimum(end, dr.maximum(one, other))
        first, last = -self.tau0, ty.widen_end(t_max) / self.scale - self.tau0
        self.begin = dr.maximum(begin, ty.narrow(first) - _BEFORE)
        self.end = dr.minimum(end, ty.narrow(last) + _BEFORE)
        self.meets = (disc >= 0.0) & (self.begin <= self.end)

    def run(self, t_max: Any, active: Any) -> Found:
        """March to the first root that counts."""
        ty, zero, no = self.ty, dr.zeros(self.ty.Float), self.ty.Bool(False)
        place = _Place(ty.UInt(0), self.begin, zero, ty.Bool(True), dr.full(ty.Float, _NOWHERE), no)
        found = Found(no, t_max, zero, zero, self.number + self.leaves.first_domain)

        def body(run: Any, place: Any, found: Any) -> Any:
            _go, place, root = dr.while_loop(
                (run, place, ty.Bool(False)),
                cond=lambda *st: st[0],
                body=self._advance,
                labels=("go", "place", "root"),
                label="bezier asphere steps",
            )
            root = run & root
            exact = self._exactly(place, root)
            found, hit = self._accept(root & exact.real, exact, found)
            # on the other side, if there was one; where it only had to find its side, as before
            asked = root & (place.sign == 0.0)
            ahead = ty.narrow(exact.tau) - place.tau
            ahead = dr.select(exact.real, ahead + _PUSH, dr.clip(ahead, _ON, _BEFORE))
            ahead = dr.select(place.between | asked, 0.0, ahead)
            sign = dr.select(root & exact.real, -place.sign, place.sign)
            known = dr.select(root & exact.real, _NOWHERE, place.known)
            place = _Place(
                place.step,
                dr.select(root, place.tau + ahead, place.tau),
                dr.select(asked, exact.side, sign),
                place.fresh | root,
                dr.select(asked, place.tau, known),
                place.between & ~root,
            )
            run = root & ~hit & (place.tau <= self.end) & (place.step < _MAX_STEPS)
            return run, place, found

        return dr.while_loop(
            (active & self.meets, place, found),
            cond=lambda *st: st[0],
            body=body,
            labels=("run", "place", "found"),
            label="bezier asphere",
        )[2]

    def _advance(self, go: Any, place: Any, _root: Any) -> Any:
        """Do a step: return whether to go on, where to, and whether there may be a root."""
        ty = self.ty
        (x0, y0, z0), (ex, ey, ez) = self.x0, self.e
        tau, a = place.tau, self.a
        x, y, z = dr.fma(tau, ex, x0), dr.fma(tau, ey, y0), dr.fma(tau, ez, z0)
        s = dr.fma(x, x, y * y)
        ds = 2.0 * dr.fma(x, ex, y * ey)
        # the cell, its ends, and the sag there
        grade = dr.fma(-self.grading, dr.minimum(s, 1.0 + 0.75 * MARGIN), 1.0)
        code = dr.reinterpret_array(ty.UInt, ty.Float32(grade)) >> self.shift
        one, other = (
            (1.0 - ty.Float(dr.reinterpret_array(ty.Float32, (code + k) << self.shift)))
            * self.spread
            for k in (0, 1)
        )
        cell = gather_packets(self.leaves.cells, code + self.cells, 8, go)
        c0, c1, c2, c3, c4, least, most, off = (ty.Float(c) for c in cell)
        low, high = dr.minimum(one, other), dr.maximum(one, other)
        q = s - 0.5 * (low + high)
        f = dr.fma(q, dr.fma(q, dr.fma(q, dr.fma(q, c4, c3), c2), c1), c0)
        f1 = dr.fma(q, dr.fma(q, dr.fma(4.0 * q, c4, 3.0 * c3), 2.0 * c2), c1)
        value, slope = z - f, dr.fma(-f1, ds, ez)
        # steps to the cell's ends: inwards while s falls, if it falls so far, and outwards
        fall, rise = dr.maximum(s - low, 0.0), dr.maximum(high - s, 1e-9)
        disc = dr.fma(ds, ds, -4.0 * a * fall)
        inwards = 2.0 * fall * reciprocal(dr.sqrt(dr.maximum(disc, 0.0)) - ds)
        root = dr.sqrt(dr.fma(ds, ds, 4.0 * a * rise))
        outwards = dr.select(
            ds < 0.0,
            (root - ds) * reciprocal(2.0 * dr.maximum(a, 1e-20)),
            2.0 * rise * reciprocal(root + ds),
        )
        stay = dr.select((ds < 0.0) & (disc > 0.0), inwards, outwards)
        stay = dr.minimum(stay, self.end - tau + _BEFORE)
        # a bound of the second derivative up to there
        last = dr.fma(2.0 * a, stay, ds)
        square, square_last = ds * ds, last * last
        largest = dr.maximum(square, square_last)
        smallest = dr.select(ds * last < 0.0, 0.0, dr.minimum(square, square_last))
        noise = _NOISE * dr.maximum(1.0, dr.abs(z)) * dr.sqrt(dr.fma(4.0 * s, f1 * f1, 1.0))
        # The side is that on which the ray is first. Where the surface and the ray have more than a
        # direction in common, roots are below rounding: so the ray may be on the other side now
        wrong = place.fresh & (place.sign * value < -8.0 * noise)
        between = wrong & (place.known > _NOWHERE)
        # where the march begins close to the surface, wide numbers tell the side
        unknown = (place.sign == 0.0) & (dr.abs(value) <= 8.0 * noise)
        unsure = ((place.sign == 0.0) & ~unknown) | (wrong & ~between)
        sign = dr.select(unsure, dr.copysign(ty.Float(1), value), place.sign)
        bend = dr.select(sign > 0.0, -most, least)
        bend = bend * dr.select(bend < 0.0, largest, smallest)
        spread = (high - low) * dr.maximum(dr.abs(least), dr.abs(most))
        half = 0.5 * bend - a * dr.fma(sign, f1, spread)
        height, falling = sign * value - off, sign * slope
        fresh = place.fresh & (height < 4.0 * noise)
        root = (~fresh | (falling < 0.0)) & (height <= 2.0 * noise)
        root = root | between | unknown
        known = dr.select(height > 4.0 * noise, tau, place.known)
        # less what rounding may add to the height: they decide whether a ray grazes or misses
        num, den, exists = root_fraction(dr.maximum(height - noise, 0.0), falling, half)
        step = dr.select(exists, num / den, dr.inf)
        step = dr.maximum(dr.minimum(step, stay + _PUSH), _PUSH)
        tau = dr.select(root, tau, tau + step)
        count = place.step + 1
        go = go & ~root & (tau <= self.end) & (count < _MAX_STEPS)
        return go, _Place(count, tau, sign, fresh, known, between), root

    def _exactly(self, place: _Place, root: Any) -> _Exact:
        """Make a root exact: that at which the ray leaves its side of the surface."""
        ty = self.ty
        (x0, y0, z0), (ex, ey, ez) = self.exact
        cx, cy, cz = (coarse(x) for x in (ex, ey, ez))
        a = dr.fma(cx, cx, cy * cy)
        side = type(a)(place.sign)

        def body(go: Any, found: Any) -> Any:
            m = self.record.gather(self.leaves.records, self.number, go)
            tau = found.tau
            x, y, z = fma(tau, ex, x0), fma(tau, ey, y0), fma(tau, ez, z0)
            s = fma(x, x, y * y)
            ds = 2.0 * dr.fma(coarse(x), cx, coarse(y) * cy)
            f, f1, f2 = sag_and_slopes(m.curvature, m.bend, m.coefficients, s)
            # only the height is a difference of wide numbers
            value, slope = coarse(z - f), dr.fma(-f1, ds, cz)
            second = -dr.fma(f2, ds * ds, 2.0 * a * f1)
            # the root of the quadratic there at which it goes to the other side
            disc = dr.fma(slope, slope, -2.0 * second * value)
            out = -side * dr.sqrt(dr.maximum(disc, 0.0))
            ahead = slope * out >= 0.0
            num = dr.select(ahead, -2.0 * value, out - slope)
            den = dr.select(ahead, slope + out, second)
            move = dr.clip(num / dr.select(den == 0.0, 1.0, den), -_FAR, _FAR)
            real = (disc >= 0.0) & (dr.abs(move) <= 1e-6) & (side != 0.0)
            here = dr.select(found.step == 0, dr.copysign(ty.Float(1), ty.Float(value)), found.side)
            low = select(side * value > 0.0, tau, found.low)
            high = select(side * value > 0.0, found.high, tau)
            after = tau + move
            bisect = ((found.step & 1) == 1) | (after <= low) | (after >= high)
            bisect = place.between & (bisect | (disc < 0.0))
            then = select(bisect, 0.5 * (low + high), after)
            step = found.step + 1
            most = dr.select(place.between, ty.UInt(_BETWEEN_STEPS), _EXACT_STEPS)
            go = go & (absolute(then - tau) > 1e-9) & (step < most) & (side != 0.0)
            return go, _Exact(step, then, low, high, real | place.between, here)

        tau = ty.widen(place.tau)
        low = select(place.between, ty.widen(place.known), tau)
        begins = _Exact(
            ty.UInt(0),
            full(0.5 * (low + tau)),
            full(low),
            full(tau),
            ty.Bool(False),
            dr.zeros(ty.Float),
        )
        return dr.while_loop(
            (root, begins),
            cond=lambda *st: st[0],
            body=body,
            labels=("go", "found"),
            label="bezier asphere root",
        )[1]

    def _accept(self, real: Any, exact: _Exact, found: Found) -> tuple[Found, Any]:
        """Return the hit if a root is one, within the rims and the ray, and whether it is."""
        ty = self.ty
        (x0, y0, _z0), (ex, ey, _ez) = self.exact
        x, y = fma(exact.tau, ex, x0), fma(exact.tau, ey, y0)
        s = fma(x, x, y * y)
        inside = (s <= (1.0 + _RIM) ** 2) & (s >= self.inner2 * (1.0 - _RIM) ** 2)
        t = ty.narrow((self.tau0 + exact.tau) * self.scale)
        hit = real & inside & (t > 0.0) & (t < found.t)
        return Found(
            found.hit | hit,
            dr.select(hit, t, found.t),
            dr.select(hit, ty.narrow((x + START) * (1.0 / LEG)), found.u),
            dr.select(hit, ty.narrow((y + START) * (1.0 / LEG)), found.v),
            found.leaf,
        ), hit
