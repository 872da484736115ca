"""Derivatives of an image by outlines that are seen in ideal mirrors and through smooth glass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..attached import attached_tables
from ..scene import SceneRays
from .chains import has_delta, what_moves
from .crossings import Crossings, Pieces, find_crossings
from .outline_motion import Outline
from .path_tracing import trace
from .primary_silhouette import FilmMap, splatted
from .specular_chains import LONGEST, FilmChains, SpecularChains
from .trim_motion import TrimMotion

__all__ = ["crossing_light", "specular_silhouette_image"]

#: Length of the pieces of lines on the film, in pixels.
_PIECE = 1.0


def specular_silhouette_image(integrator: Any, scene: Any, sensor: Any, seed: Any, spp: int) -> Any:
    """Return an image without values that has the derivatives of outlines behind ideal surfaces.

    Short pieces of lines along the rows and columns of the film are searched for places where
    chains of reflections and refractions begin to end on something else. There the image jumps.

    Parameters and return value are those of `primary_silhouette_image`.
    """
    longest = min(int(integrator.max_depth), LONGEST)
    if longest < 2 or not has_delta(scene) or not what_moves(scene):
        return None
    rays = SceneRays(scene)
    if rays.data is None:
        return None
    film = sensor.film()
    chains = FilmChains(rays, longest, FilmMap(sensor))
    with dr.suspend_grad():
        sampler, spp = integrator.prepare(sensor, 0x51ED270B ^ seed, spp, [])
        size = mi.Vector2f(mi.ScalarVector2f(film.crop_size()))
        width, height = (int(x) for x in film.crop_size())
        total = width * height * spp
        pixel = dr.arange(mi.UInt32, total) // dr.opaque(mi.UInt32, spp)
        at = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + sampler.next_2d()
        line = {
            "row": sampler.next_1d() < 0.5,
            # outlines that are seen directly are not of this kind
            "nearest": dr.full(mi.UInt32, 1, total),
            "plan": mi.UInt32(sampler.next_1d() * (1 << 24)),
            "lobe": sampler.next_1d(),
            "wave": sampler.next_1d() if mi.is_spectral else dr.full(mi.Float, 0.5, total),
        }
        pieces = Pieces.within(line, at, sampler.next_1d(), size, _PIECE)
        found = find_crossings(chains, pieces)
        if found is None:
            return None
        row = found.line["row"]
        reach = dr.select(row, width + _PIECE, height + _PIECE)
        across = dr.select(row, mi.Float(height), mi.Float(width))
        density = 2 * reach * across / (_PIECE * total)
    value, ray, good = crossing_light(integrator, scene, chains, found, seed, density)
    position = mi.Point2f(0.5 * (found.low + found.high))
    on_film = mi.Point2f(position + mi.Vector2f(mi.ScalarVector2f(film.crop_offset())))
    return splatted(film, on_film, ray.wavelengths, value, spp, good)


def crossing_light(
    integrator: Any,
    scene: Any,
    chains: SpecularChains,
    found: Crossings,
    seed: Any,
    density: Any,
    before: Any = 0,
) -> tuple[Any, Any, Any]:
    """Return what the light changes by where outlines move across lines, without a value.

    It is the jump of the light times the speed of the place along the line, which follows by
    implicit differentiation from what is 0 there: the distance of the ray that arrives from the
    outline's tangent plane. Rows and columns are weighted by the squares of the slopes, so nothing
    becomes large where an outline runs along one of them.

    Parameters
    ----------
    integrator : BezierPath
    scene : mi.Scene
    chains : SpecularChains
    found : Crossings
    seed : int
    density : Float
        One over the density of pieces across an outline.
    before : int or UInt
        Number of vertices before those of the chains.

    Returns
    -------
    value, mi.Ray3f at the beginning of the chains, whether there is one
    """
    rays = chains.rays
    line, low, high, last, weight = found
    with dr.suspend_grad():
        count = int(dr.max(last)[0])
        sides = [chains.vertices(line, at, last, count) for at in (low, high)]
        active = sides[0][2] & sides[1][2] & (before + last < integrator.max_depth)
        radiance = []
        for met, factor, _good in sides:
            own = mi.load_dict({"type": "independent"})
            own.seed(0x2545F491 ^ seed, dr.width(last))  # the same numbers on both sides
            ray, hit = met[-1]
            value, _valid = trace(integrator, scene, own, ray, active, hit, before + last)
            radiance.append(dr.select(active, value * factor, 0.0))
        assert rays.data is not None
        with dr.resume_grad():
            trims = TrimMotion.of(rays.data)
        met_last = [met[-1] for met, _weight, _good in sides]
        outline = Outline.passed_by(rays, met_last, active, trims)
        position = mi.Point2f(0.5 * (low + high))
        dr.eval(radiance, outline, position)

    def gap(place: Any, side: int = 0) -> Any:
        ray = chains.attached(line, place, last, sides[side][0])
        return outline.gap(tables, ray, trims)

    with rays.attach(dr.ADMode.Backward):
        tables = rays.data.attached or attached_tables(rays.data.tables, rays.data.shapes)
        slope = [_slope(gap, position, k) for k in range(2)]
        square = dr.square(slope[0]) + dr.square(slope[1])
        good = outline.known & (square > 0) & dr.isfinite(square)
        along = dr.select(line["row"], slope[0], slope[1]) / square
        factor = dr.select(good, -density * weight * along, 0.0)
        if chains.parts_first:
            moving = [dr.replace_grad(mi.Float(0), gap(position, side)) for side in range(2)]
            change = radiance[0] * factor * moving[0] - radiance[1] * factor * moving[1]
        else:
            moving = dr.replace_grad(mi.Float(0), gap(position))
            change = (radiance[0] - radiance[1]) * factor * moving
    return dr.select(good, change, 0.0), sides[0][0][0][0], good


def _slope(gap: Any, position: Any, k: int) -> Any:
    """Return how the gap changes along one coordinate of the place."""
    x = mi.Float(position[k])
    dr.enable_grad(x)
    # a second walk through one graph of derivatives ends the process: each has its own
    value = gap(mi.Point2f(x, position.y) if k == 0 else mi.Point2f(position.x, x)) + 0.0
    dr.forward_from(x)
    return dr.detach(mi.Float(dr.grad(value)))
