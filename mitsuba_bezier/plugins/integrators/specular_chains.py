"""Chains of ideal reflections and refractions that a few numbers fix: what outlines are seen by."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..interaction import Preliminary
from ..offsets import spawn_ray
from ..scene import SceneRays
from .primary_silhouette import FilmMap

__all__ = ["LONGEST", "OTHER", "FilmChains", "SpecularChains"]

#: Vertices of a chain that are looked at, the one at its end among them.
LONGEST = 8
#: Share of the paths that go on through glass, where it also reflects.
_THROUGH = 0.75
#: How two chains differ that have not met the same: above all continuous measures.
OTHER = 1e3


class SpecularChains:
    """Chains through ideal mirrors and glass, by lobes that a number fixes.

    Where they begin is for subclasses to say: at a position on the film, or on a square of
    directions.

    Parameters
    ----------
    rays : SceneRays
    longest : int
        Number of vertices of a chain, at most.
    """

    #: Whether the first ray moves by what it meets, which the two sides of an outline may differ in
    parts_first = False

    def __init__(self, rays: SceneRays, longest: int) -> None:
        self.rays, self.longest = rays, longest
        self.reflects, self.transmits = mi.BSDFContext(), mi.BSDFContext()
        self.reflects.type_mask = mi.BSDFFlags.DeltaReflection
        self.transmits.type_mask = mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.Null

    def start(self, line: dict[str, Any], position: Any) -> tuple[Any, Any]:
        """Return the first ray, and its weight."""
        raise NotImplementedError

    def attached_start(self, line: dict[str, Any], position: Any, first: Any) -> Any:
        """Return the first ray with derivatives; it goes to the hit `first`."""
        return self.start(line, position)[0]

    def bend(self, si: Any, line: dict[str, Any], depth: Any, active: Any) -> tuple[Any, ...]:
        """Return the direction in the frame of `si`, the weight, and whether there is any."""
        bsdf = si.bsdf()
        flags = bsdf.flags()
        back = mi.has_flag(flags, mi.BSDFFlags.DeltaReflection)
        on = mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission)
        on = on | mi.has_flag(flags, mi.BSDFFlags.Null)
        active = active & (back | on)
        byte = (line["plan"] >> (2 * depth)) & 3
        through = on & (~back | (mi.Float(byte) < 4 * _THROUGH))
        chance = dr.select(back & on, dr.select(through, _THROUGH, 1 - _THROUGH), 1.0)
        one, two = mi.Float(line["lobe"]), mi.Point2f(0.5)
        a, weight_a = bsdf.sample(self.reflects, si, one, two, active & ~through)
        b, weight_b = bsdf.sample(self.transmits, si, one, two, active & through)
        wo = dr.select(through, b.wo, a.wo)
        weight = dr.select(through, weight_b, weight_a)
        goes_on = active & dr.any(weight != 0)
        return wo, dr.select(goes_on, weight / chance, 0.0), goes_on

    def meet(self, ray: Any, active: Any) -> tuple[Any, ...]:
        """Return the hit, the interaction, the error of its point, and whether there is one."""
        hit = self.rays.preliminary(ray, False, active)
        si, p_err = self.rays.meet(hit, ray, mi.RayFlags.All, active)
        return hit, si, p_err, active & si.is_valid()

    def follow(self, line: dict[str, Any], position: Any) -> dict[str, list[Any]]:
        """Return what a chain meets: a number for each vertex, the places and normals there."""
        ray, _weight = self.start(line, position)
        width = dr.width(position)
        state = {
            "ray": ray,
            "way": dr.zeros(mi.Float, width),
            "depth": dr.zeros(mi.UInt32, width),
            "active": dr.full(mi.Bool, True, width),
            "what": [dr.zeros(mi.UInt32, width) for _ in range(self.longest)],
            "p": [dr.zeros(mi.Point3f, width) for _ in range(self.longest)],
            "n": [dr.zeros(mi.Vector3f, width) for _ in range(self.longest)],
        }

        def body(st: dict[str, Any], line: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
            st = dict(st)
            ray, depth, active = st["ray"], st["depth"], st["active"]
            hit, si, p_err, met = self.meet(ray, active)
            way = st["way"] + dr.select(met, si.t, 0.0)
            what = 2 * dr.reinterpret_array(mi.UInt32, si.shape)
            what += dr.select(dr.dot(si.n, ray.d) > 0, mi.UInt32(1), 0)
            if self.rays.data is not None and self.rays.data.instances is not None:
                what = dr.select(hit.bezier, what + hit.pi.shape_index * 0x9E3779B1, what)
            what = dr.select(met, what + 2, 1)  # 0: there is no such vertex
            p, n = dr.select(met, si.p / way, 0.0), dr.select(met, mi.Vector3f(si.n), 0.0)
            for k in range(self.longest):
                here = active & (depth == k)
                st["what"][k] = dr.select(here, what, st["what"][k])
                st["p"][k] = dr.select(here, p, st["p"][k])
                st["n"][k] = dr.select(here, n, st["n"][k])
            wo, _weight, goes_on = self.bend(si, line, depth, met & (depth + 1 < self.longest))
            st["ray"] = spawn_ray(si, p_err, si.to_world(wo))
            st["way"], st["depth"], st["active"] = way, depth + 1, goes_on
            return st, line

        state, _line = dr.while_loop(
            (state, line), lambda st, _line: st["active"], body, label="bezier outlines: chain"
        )
        return {k: state[k] for k in ("what", "p", "n")}

    def difference(self, a: dict[str, Any], b: dict[str, Any]) -> tuple[Any, Any]:
        """Return by how much two chains differ, and at which vertex first, or most."""
        most, where = mi.Float(0.0), mi.UInt32(0)
        for k in range(self.longest):
            d = dr.norm(a["p"][k] - b["p"][k]) + dr.norm(a["n"][k] - b["n"][k])
            d = dr.select(a["what"][k] != b["what"][k], OTHER, d)
            more = (d > most) & (most < OTHER)
            most, where = dr.select(more, d, most), dr.select(more, mi.UInt32(k), where)
        return most, where

    def vertices(
        self, line: dict[str, Any], position: Any, last: Any, count: int
    ) -> tuple[list[tuple[Any, Any]], Any, Any]:
        """Return rays and hits of vertices `0` to `last`, those of `last` in all after it.

        Returns
        -------
        list of (ray, hit), weight of what is to come, whether the chain gets so far
        """
        ray, weight = self.start(line, position)
        good = dr.full(mi.Bool, True, dr.width(position))
        out = []
        for depth in range(count + 1):
            dr.eval(ray, weight, good)
            hit, si, p_err, met = self.meet(ray, good)
            dr.eval(hit)
            out.append((mi.Ray3f(ray), hit))
            if depth == count:
                break
            more = met & (depth < last)
            wo, factor, goes_on = self.bend(si, line, dr.opaque(mi.UInt32, depth), more)
            turned = spawn_ray(si, p_err, si.to_world(wo))
            good = good & (goes_on | (depth >= last))
            ray = dr.select(goes_on, turned, ray)
            weight = dr.select(goes_on, weight * factor, weight)
        return out, weight, good

    def attached(
        self, line: dict[str, Any], position: Any, last: Any, met: list[tuple[Any, Any]]
    ) -> Any:
        """Return the rays that arrive at the vertices `last`, with derivatives."""
        ray = self.attached_start(line, position, met[0][1])
        for depth, (value, hit) in enumerate(met[:-1]):
            ray.o = dr.replace_grad(dr.detach(value.o), ray.o)
            ray.d = dr.replace_grad(dr.detach(value.d), ray.d)
            on = mi.UInt32(depth) < last
            si, _p_err = self.rays.meet(hit, ray, mi.RayFlags.All, on)
            wo, _weight, _goes_on = self.bend(si, line, mi.UInt32(depth), on)
            turned = mi.Ray3f(ray)
            turned.o = dr.select(on, si.p, ray.o)
            turned.d = dr.select(on, si.to_world(wo), ray.d)
            ray = turned
        value = met[-1][0]
        ray.o = dr.replace_grad(dr.detach(value.o), ray.o)
        ray.d = dr.replace_grad(dr.detach(value.d), ray.d)
        return ray


class FilmChains(SpecularChains):
    """Those that begin at positions on the film.

    Parameters
    ----------
    rays, longest
        As above.
    camera : FilmMap
    """

    def __init__(self, rays: SceneRays, longest: int, camera: FilmMap) -> None:
        super().__init__(rays, longest)
        self.camera = camera

    def start(self, line: dict[str, Any], position: Any) -> tuple[Any, Any]:
        """Return the camera's ray, and its weight."""
        return self.camera.ray(None, position, line["wave"])

    def ends(self, line: dict[str, Any], position: Any) -> dict[str, Any]:
        """Follow chains to the first rough surface.

        Where a surface is both, ``stops`` of `line` has a bit for each vertex.

        Returns
        -------
        dict
            ``ray`` and ``hit`` of that surface, its number ``depth``, the ``weight`` of what comes
            from there, and whether there is ``any``.
        """
        ray, weight = self.start(line, position)
        width = dr.width(position)
        state = {
            "ray": mi.Ray3f(ray),
            "hit": Preliminary.miss(),
            "weight": mi.Spectrum(weight),
            "depth": dr.zeros(mi.UInt32, width),
            "any": dr.zeros(mi.Bool, width),
            "active": dr.full(mi.Bool, True, width),
        }

        def body(st: dict[str, Any], line: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
            st = dict(st)
            ray, depth, active = st["ray"], st["depth"], st["active"]
            hit, si, p_err, met = self.meet(ray, active)
            wo, factor, goes_on = self.bend(si, line, depth, met & (depth + 1 < self.longest))
            rough = met & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
            both = rough & goes_on
            stops = rough & (~both | (((line["stops"] >> depth) & 1) == 1))
            goes_on = goes_on & ~stops
            st["weight"] = (
                st["weight"] * dr.select(goes_on, factor, 1.0) * dr.select(both, 2.0, 1.0)
            )
            st["hit"] = dr.select(stops, hit, st["hit"])
            st["any"] = st["any"] | stops
            turned = spawn_ray(si, p_err, si.to_world(wo))
            st["ray"] = dr.select(goes_on, turned, ray)
            st["depth"] = dr.select(goes_on, depth + 1, depth)
            st["active"] = goes_on
            return st, line

        state, _line = dr.while_loop(
            (state, line), lambda st, _line: st["active"], body, label="bezier outlines: ends"
        )
        return state
