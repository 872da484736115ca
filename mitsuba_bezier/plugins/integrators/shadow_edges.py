"""Derivatives of soft shadows: how the edge of a shadow crosses a light, seen from a point.

From a vertex of a path a light is the unit square of the numbers that sample it. Along a line
through that square, one number fixed and the other one from 0 to 1, the light appears and vanishes
behind what stands before it. Such places are searched for at equal steps, and found by bisection.
Each moves with the surface that hides the light there, and with the vertex; what the line gathers
changes by the light at that place times its speed. Lines in both directions count by the square of
the cosine between them and the normal of the edge, so that none that runs along it counts much. It
takes nothing but rays: whatever hides the light, by a contour, an edge or a trim, is seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..offsets import spawn_ray_to
from ..scene import SceneRays
from .emitters import EmitterSampling

__all__ = ["ShadowEdge", "shadow_edge"]

#: Bisections of an interval: a place is known to 1e-5 of the light then, if there are eight.
_HALVINGS = 14
#: Cosine below which a surface is seen along its contour; else the light ends at an edge of it.
_GRAZING = 0.05
#: To the side, in numbers that sample a light: the direction of an edge is found there.
_ASIDE = 2e-3
#: The step for the direction of the line.
_ALONG = 1e-3


@dataclass
class ShadowEdge:
    """A place at which a light appears or vanishes."""

    found: Any  #: Bool
    weight: Any  #: Spectrum, light over density there, times the number of places on the line
    d: Any  #: Vector3f, the direction towards it
    shift: Any  #: Float, 0 with derivatives: how much of the line becomes lit


def shadow_edge(
    rays: SceneRays,
    emitters: EmitterSampling,
    si: Any,
    p_err: Any,
    numbers: tuple[Any, Any],
    steps: int,
    active: Any,
) -> ShadowEdge:
    """Return one place where the light of an emitter ends, of those on a random line through it.

    Parameters
    ----------
    rays : SceneRays
    emitters : EmitterSampling
    si : mi.SurfaceInteraction3f
        The vertex, with derivatives.
    p_err : Float
        The error of its point.
    numbers : pair of Float
        Uniform numbers; they need not be independent of the path.
    steps : int
        Intervals of the line. What hides less than one of them may be missed.
    active : Bool
    """
    with dr.suspend_grad():
        here = dr.detach(si)
        seed = [dr.reinterpret_array(mi.UInt32, mi.Float(x)) for x in numbers]

        def number(k: Any) -> Any:
            return mi.sample_tea_float32(seed[0], seed[1] + k)

        # a light, a line across it, and where the intervals begin
        index, _weight, _x = emitters.scene.sample_emitter(number(mi.UInt32(0)), active)
        chance = emitters.scene.pdf_emitter(index, active)
        start = number(mi.UInt32(0)) - _x * chance
        upright = number(mi.UInt32(1)) < 0.5
        x, offset = number(mi.UInt32(2)), number(mi.UInt32(3))

        def sample(x: Any, y: Any) -> Any:
            u, v = dr.select(upright, x, y), dr.select(upright, y, x)
            return mi.Point2f(dr.fma(u, chance, start), v)

        def lit(x: Any, y: Any, mask: Any) -> Any:
            return emitters.sample_visible(here, p_err, sample(x, y), mask).lit

        def look(k: Any, y: Any, before: Any, found: Any, low: Any, high: Any, first: Any) -> Any:
            ahead = dr.minimum((mi.Float(k) + offset) / steps, 1.0)
            now = lit(x, ahead, active)
            changes = now != before
            found = found + dr.select(changes, mi.UInt32(1), 0)
            keep = changes & (number(k + 4) * mi.Float(found) <= 1)
            low, high = dr.select(keep, y, low), dr.select(keep, ahead, high)
            return k + 1, ahead, now, found, low, high, dr.select(keep, before, first)

        width = dr.width(x)
        zero, dark = dr.zeros(mi.Float, width), dr.zeros(mi.Bool, width)
        first = lit(x, zero, active)
        state = (
            dr.zeros(mi.UInt32, width),
            zero,
            first,
            dr.zeros(mi.UInt32, width),
            zero,
            zero,
            dark,
        )
        _k, _y, _now, count, low, high, first = dr.while_loop(
            state,
            lambda k, *_rest: active & (k <= steps),
            look,
            label="shadow: search",
        )
        found = active & (count > 0)

        def halved(x: Any, low: Any, high: Any, mask: Any) -> tuple[Any, Any]:
            def body(k: Any, low: Any, high: Any) -> Any:
                middle = 0.5 * (low + high)
                same = lit(x, middle, mask) == first
                return k + 1, dr.select(same, middle, low), dr.select(same, high, middle)

            _k, low, high = dr.while_loop(
                (dr.zeros(mi.UInt32, width), mi.Float(low), mi.Float(high)),
                lambda k, *_rest: mask & (k < _HALVINGS),
                body,
                label="shadow: place",
            )
            return low, high

        def towards(x: Any, y: Any, mask: Any) -> Any:
            return emitters.sample_hit(here, sample(x, y), mask)

        a, b = halved(x, low, high, found)
        bright, dim = dr.select(first, a, b), dr.select(first, b, a)
        ds, weight, _err, _hit = towards(x, bright, found)
        end, _weight, end_err, _hit = towards(x, dim, found)
        # where the numbers jump from one part of the lights to another nothing ends
        found &= ~ds.delta & (dr.squared_norm(ds.d - end.d) < 1e-6)
        way = spawn_ray_to(here, p_err, end.p, end.n, end_err)
        ray = mi.Ray3f(way.ray)
        ray.maxt = way.reach
        hit = rays.preliminary(ray, False, found)
        found &= hit.pi.is_valid()

        # ---- the plane through the vertex that touches the edge
        met = rays.surface_interaction(hit, ray, mi.RayFlags.Minimal, found)
        contour = met.n - ray.d * dr.dot(met.n, ray.d)
        sharp = found & (dr.abs(dr.dot(met.n, ray.d)) > _GRAZING)
        sides = []
        for side in (dr.maximum(x - _ASIDE, 0.0), dr.minimum(x + _ASIDE, 1.0)):
            room = 8 * _ASIDE
            below, above = dr.maximum(low - room, 0.0), dr.minimum(high + room, 1.0)
            good = sharp & (lit(side, below, sharp) == first) & (lit(side, above, sharp) != first)
            below, above = halved(side, below, above, good)
            there = towards(side, 0.5 * (below + above), good)[0]
            sides.append((there.d, good))
        (left, good_left), (right, good_right) = sides
        along = right - left
        good = good_left & good_right & (dr.squared_norm(along) < 0.01)
        n = dr.select(sharp, dr.cross(ray.d, along), contour)
        size = dr.norm(n)
        found &= (size > 0) & (~sharp | good)
        n = dr.select(found, n / size, 0.0)

        # ---- how the direction follows both numbers
        slopes = []
        for along_line in (True, False):
            place = bright if along_line else x
            ends = dr.maximum(place - _ALONG, 0.0), dr.minimum(place + _ALONG, 1.0)
            pairs = [(x, e) if along_line else (e, bright) for e in ends]
            back, ahead = (towards(*pair, found)[0].d for pair in pairs)
            slopes.append(dr.dot(n, ahead - back) / (ends[1] - ends[0]))
        square = dr.square(slopes[0]) + dr.square(slopes[1])
        found &= square > 0
        inverse = dr.select(found, dr.select(first, 2.0, -2.0) * slopes[0] / square, 0.0)
        near = dr.select(found, dr.norm(met.p - here.p), 1.0)
        infinite = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        far = dr.select(found & ~infinite, dr.rcp(ds.dist), 0.0)
        weight = dr.select(found, weight * mi.Float(count), 0.0)

    moved = rays.surface_interaction(hit, ray, mi.RayFlags.Minimal | mi.RayFlags.FollowShape, found)
    speed = (mi.Vector3f(moved.p) - mi.Vector3f(si.p)) / near + mi.Vector3f(si.p) * far
    shift = dr.replace_grad(mi.Float(0.0), dr.select(found, dr.dot(n, speed) * inverse, 0.0))
    return ShadowEdge(found, weight, ds.d, shift)
