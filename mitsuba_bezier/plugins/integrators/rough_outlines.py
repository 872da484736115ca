"""Derivatives by outlines that rough surfaces see in mirrors and through glass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..offsets import spawn_ray
from ..scene import SceneRays
from .chains import has_delta, what_moves
from .crossings import Pieces, find_crossings
from .primary_silhouette import FilmMap, splatted
from .specular_chains import LONGEST, FilmChains, SpecularChains
from .specular_silhouette import crossing_light

__all__ = ["rough_outline_image"]

#: Length of the pieces of lines, in the unit square of directions: a piece may cross several
#: outlines, and those in its middle are then missed.
_PIECE = 1 / 16


class RoughChains(SpecularChains):
    """Chains that begin at rough surfaces, in directions of a hemisphere mapped to a square.

    Parameters
    ----------
    rays : SceneRays
    longest : int
        Number of vertices of a chain, at most.
    film : FilmChains
        Those that end on the rough surfaces.
    """

    parts_first = True

    def __init__(self, rays: SceneRays, longest: int, film: FilmChains) -> None:
        super().__init__(rays, longest)
        self.film = film
        self._before: list[tuple[Any, Any]] = []

    def start(self, line: dict[str, Any], position: Any) -> tuple[Any, Any]:
        """Return the ray that leaves the rough surface, without weight."""
        ray, _weight = self.film.start(line["film"], line["film"]["position"])
        ray = mi.Ray3f(ray)
        local = mi.warp.square_to_cosine_hemisphere(position)
        ray.o, ray.d = mi.Point3f(line["o"]), mi.Frame3f(line["n"]).to_world(local)
        ray.maxt = dr.largest(mi.Float)
        return ray, mi.Spectrum(1.0)

    def reflected(self, line: dict[str, Any], position: Any) -> Any:
        """Return what part of the light from a position gets to the camera, over its density.

        The vertices before are remembered for `attached_start`: lines are the same there.
        """
        before, depth = line["film"], line["film"]["depth"]
        at = before["position"]
        self._before, _weight, good = self.film.vertices(before, at, depth, int(dr.max(depth)[0]))
        ray, hit = self._before[-1]
        si = self.rays.surface_interaction(hit, ray, mi.RayFlags.All, good)
        local = mi.warp.square_to_cosine_hemisphere(position)
        wo = si.to_local(mi.Frame3f(line["n"]).to_world(local))
        value = si.bsdf(ray).eval(mi.BSDFContext(), si, wo, good)
        pdf = mi.warp.square_to_cosine_hemisphere_pdf(local)
        return line["weight"] * dr.select(good & (pdf > 0), value / pdf, 0.0)

    def attached_start(self, line: dict[str, Any], position: Any, first: Any) -> Any:
        """Return the first ray with derivatives: as in `path_replay`, what it meets stays.

        That is where the ray without derivatives goes, and the surface moves along the ray that
        arrives there.
        """
        ray = self.start(line, position)[0]
        before, depth = line["film"], line["film"]["depth"]
        arrives = self.film.attached(before, before["position"], depth, self._before)
        si = self.rays.surface_interaction(self._before[-1][1], arrives)
        valid = first.pi.is_valid()
        target = ray.o + dr.select(valid, first.pi.t, 1.0) * ray.d
        o = dr.replace_grad(mi.Point3f(ray.o), si.p)
        ray.d = dr.select(valid, dr.normalize(target - o), ray.d)
        ray.o = o
        return ray


def rough_outline_image(integrator: Any, scene: Any, sensor: Any, seed: Any, spp: int) -> Any:
    """Return an image without values that has the derivatives of outlines that surfaces see.

    It is the first rough surface that the camera sees, directly or by way of mirrors and glass.
    From there, directions are searched for outlines along short pieces of lines through a square
    that stands for a hemisphere: of outlines by way of mirrors and glass, and, if the camera sees
    the surface so, of all. Those that are left are for `indirect_silhouette`.

    Parameters and return value are those of `primary_silhouette_image`.
    """
    bsdfs = [shape.bsdf() for shape in scene.shapes()]
    rough = any(b is not None and mi.has_flag(b.flags(), mi.BSDFFlags.Smooth) for b in bsdfs)
    depth = int(integrator.max_depth)
    if depth < 3 or not rough or not has_delta(scene) or not what_moves(scene):
        return None
    rays = SceneRays(scene)
    if rays.data is None:
        return None
    film = sensor.film()
    longest = min(depth - 1, LONGEST)
    by_film = FilmChains(rays, longest, FilmMap(sensor))
    chains = RoughChains(rays, longest, by_film)
    with dr.suspend_grad():
        sampler, spp = integrator.prepare(sensor, 0x3C6EF372 ^ seed, spp, [])
        width, height = (int(x) for x in film.crop_size())
        total = width * height * spp
        pixel = dr.arange(mi.UInt32, total) // dr.opaque(mi.UInt32, spp)
        at = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + sampler.next_2d()
        before = {
            "plan": mi.UInt32(sampler.next_1d() * (1 << 24)),
            "stops": mi.UInt32(sampler.next_1d() * (1 << 24)),
            "lobe": sampler.next_1d(),
            "wave": sampler.next_1d() if mi.is_spectral else dr.full(mi.Float, 0.5, total),
        }
        end = by_film.ends(before, at)
        si, p_err = rays.meet(end["hit"], end["ray"], mi.RayFlags.All, end["any"])
        flags, kinds = si.bsdf().flags(), mi.BSDFFlags
        back, on = (
            mi.has_flag(flags, a) | mi.has_flag(flags, b)
            for a, b in (
                (kinds.DiffuseReflection, kinds.GlossyReflection),
                (kinds.DiffuseTransmission, kinds.GlossyTransmission),
            )
        )
        through = on & (~back | (sampler.next_1d() < 0.5))
        facing = dr.mulsign(mi.Vector3f(si.n), -dr.dot(si.n, end["ray"].d))
        n = dr.select(through, -facing, facing)
        line = {
            "row": sampler.next_1d() < 0.5,
            "plan": mi.UInt32(sampler.next_1d() * (1 << 24)),
            "lobe": sampler.next_1d(),
            "nearest": dr.select(end["depth"] > 0, mi.UInt32(0), 1),
            "o": spawn_ray(si, p_err, n).o,
            "n": n,
            "weight": end["weight"] * dr.select(back & on, 2.0, 1.0),
            "film": {**before, "position": at, "depth": end["depth"]},
        }
        numbers = mi.Point2f(sampler.next_2d())
        pieces = Pieces.within(line, numbers, sampler.next_1d(), mi.Vector2f(1.0), _PIECE)
        which = dr.compress(end["any"])
        if dr.width(which) == 0:
            return None
        some = dr.gather(tuple, (pieces.line, pieces.at, pieces.step, pieces.chance), which)
        pieces = Pieces(some[0], some[1], some[2], some[3], pieces.size)
        found = find_crossings(chains, pieces)
        if found is None:
            return None
        line = found.line
        middle = mi.Point2f(0.5 * (found.low + found.high))
        factor = chains.reflected(line, middle)
        dr.eval(factor, chains._before)
    density = mi.Float(2 * (1 + _PIECE) / (_PIECE * spp))
    seen = line["film"]["depth"] + 1
    value, _ray, good = crossing_light(integrator, scene, chains, found, seed, density, seen)
    value = value * dr.detach(factor)
    position = line["film"]["position"] + mi.Vector2f(mi.ScalarVector2f(film.crop_offset()))
    wavelengths = by_film.start(line["film"], line["film"]["position"])[0].wavelengths
    return splatted(film, mi.Point2f(position), wavelengths, value, spp, good)
