"""Rays from the film that may be reflected at each surface: ghosts and flare.

A ray that is reflected meets the neighbour on the other side next, so the walk needs no search.
What misses a clear aperture has met the black edge of an element or the barrel. What is
reflected is drawn by its share, or more often than that where coatings make it rare, with a
weight.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...optics import reflectance
from .glass import Glass, Light
from .surfaces import Blades, Surfaces, meet, refracted

__all__ = ["mirrored_share", "reflected", "walk"]

#: Reflections are tried at least this often: those of good coatings would hardly ever be seen.
_TRIED = 0.04
#: Surfaces that a ray meets at most; light that is still inside then has lost all but e^-20.
_EVENTS = 400


def mirrored_share(
    before: Any, behind: Any, cosine: Any, light: Light, layers: Any, cemented: Any = False
) -> Any:
    """Return the share that a surface reflects, a weight's component each.

    Layers stand on the side of the lower index; cemented surfaces have none.
    """
    bare = None if layers is None else ()
    share = mi.Spectrum(reflected(before, behind, cosine, light.waves, bare))
    if layers:
        coated = mi.Spectrum(reflected(before, behind, cosine, light.waves, layers))
        share = dr.select(mi.Mask(cemented), share, coated)
    return dr.select(before == behind, mi.Spectrum(0.0), share)


def reflected(before: Any, behind: Any, cosine: Any, waves: Any, layers: Any) -> Any:
    """Return the share that a surface reflects; layers stand on the side of the lower index.

    Without any (None) it reflects what it reflects totally.
    """
    if layers is None:
        inside = 1 - (before / behind) ** 2 * (1 - cosine * cosine)
        return dr.select(inside > 0, mi.Float(0.0), mi.Float(1.0))
    low, high = dr.minimum(before, behind), dr.maximum(before, behind)
    # the cosine in the medium of the lower index; there is none where light is totally reflected
    ratio = before / low
    square = 1 - ratio * ratio * (1 - cosine * cosine)
    share = reflectance(low, high, dr.sqrt(dr.maximum(square, 0.0)), waves, layers, m=dr)
    return dr.select(square > 0, dr.clip(share, 0.0, 1.0), 1.0)


def walk(
    surfaces: Surfaces,
    glass: Glass,
    blades: Blades,
    light: Light,
    layers: Any,
    absorption: bool,
    o: Any,
    d: Any,
    seeds: tuple[Any, Any],
    active: Any,
) -> tuple[Any, Any, Any, Any]:
    """Return the rays that leave the front, in the frame of the front vertex, weights, and which.

    Parameters
    ----------
    surfaces, glass, blades, layers
        The lens.
    light : Light
        What the rays are made of.
    absorption : bool
        Whether glass absorbs.
    o, d : Vector3f
        Rays in the frame of the surface next to the film.
    seeds : tuple of UInt32
        Of the random numbers.
    active : Mask
        Which rays there are.
    """
    count = surfaces.count
    air = 1.0 + 1e-2

    def on(_number: Any, i: Any, *state: Any) -> Any:
        return (i >= 0) & (i < count)

    def step(
        number: Any, i: Any, sheet: Any, o: Any, d: Any, weight: Any, alive: Any
    ) -> tuple[Any, ...]:
        towards = sheet > 0
        medium, other = dr.select(towards, i, i + 1), dr.select(towards, i + 1, i)
        before, behind = glass.index(light, medium), glass.index(light, other)
        p, slope, met = meet(surfaces.shape(i), o, d, sheet)
        s = p.x * p.x + p.y * p.y
        alive = alive & met & surfaces.clear(i, s)
        if blades.normals:
            radius = dr.sqrt(dr.gather(mi.Float, surfaces.outer2, mi.UInt32(i)))
            alive &= (i != surfaces.stop) | blades.open(p.x, p.y, radius)
        if absorption:
            weight = weight * glass.faded(light, medium, dr.norm(p - o))
        through, n, cosine, passed = refracted(p, slope, d, before, behind, sheet)
        alive &= cosine > 0  # else it has met the surface from behind, beyond its neighbour
        cemented = dr.minimum(before, behind) > air
        share = mirrored_share(before, behind, dr.minimum(cosine, 1.0), light, layers, cemented)
        mean = dr.mean(share)
        tried = dr.select(mean > 0, dr.maximum(mean, _TRIED), 0.0)
        tried = dr.select(passed, dr.minimum(tried, 0.96), 1.0)
        back = mi.sample_tea_float32(seeds[0], seeds[1] + number) < tried
        weight = weight * dr.select(
            back, share / dr.maximum(tried, 1e-6), (1.0 - share) / dr.maximum(1.0 - tried, 1e-6)
        )
        d = dr.select(back, d - 2.0 * cosine * n, through)
        sheet = dr.select(back, -sheet, sheet)
        alive &= (d.z * sheet > 0) & (dr.max(weight) > 0) & (number < _EVENTS)
        gap = dr.select(sheet > 0, surfaces.gap(i), -surfaces.gap(i - 1))
        o = mi.Vector3f(p.x, p.y, p.z - gap)
        i = dr.select(alive, i + dr.select(sheet > 0, 1, -1), -1)
        return number + 1, i, sheet, o, d, weight, alive

    width = dr.width(o)
    state = (
        dr.zeros(mi.UInt32, width),
        dr.select(active, mi.Int32(0), mi.Int32(-1)),
        dr.full(mi.Float, 1.0, width),
        mi.Vector3f(o),
        mi.Vector3f(d),
        mi.Spectrum(1.0),
        mi.Mask(active),
    )
    with dr.suspend_grad():
        _n, i, _s, o, d, weight, alive = dr.while_loop(state, on, step)
    # the vertex of the front surface is where the last gap of 0 has left it
    return o, d, weight, alive & (i >= count)
