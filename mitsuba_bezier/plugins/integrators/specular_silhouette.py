"""Derivatives of an image by outlines that are seen in ideal mirrors and through smooth glass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..attached import attached_tables
from ..offsets import spawn_ray
from ..scene import SceneRays
from .chains import has_delta, what_moves
from .outline_motion import Outline
from .path_tracing import trace
from .primary_silhouette import FilmMap, splatted

__all__ = ["specular_silhouette_image"]

#: Vertices of a chain that are looked at, the one at its end among them.
_LONGEST = 8
#: Length of the pieces of lines on the film, in pixels: of outlines that are nearer to each other
#: a piece may see one, or none of two.
_PIECE = 1.0
#: Halvings of a piece: what is left is what float32 tells apart on a film.
_HALVINGS = 18
#: Pieces searched at a time, which bounds the memory.
_TOGETHER = 1 << 20
#: Outlines that a piece may cross.
_ROUNDS = 3
#: Share of the paths that go on through glass, where it also reflects.
_THROUGH = 0.75
#: How two chains differ that have not met the same: above all continuous measures.
_OTHER = 1e3
#: A jump of place (relative to the way) or normal that is no curvature: after all halvings that of
#: a grazing hit is a few thousandths.
_JUMP = 0.02
#: A piece is searched for such a jump if one of its halves changes by this much of both.
_UNEVEN = 0.8


class _Chains:
    """Chains from film positions through ideal mirrors and glass, by lobes that a number fixes.

    Parameters
    ----------
    rays : SceneRays
    camera : FilmMap
    longest : int
        Number of vertices of a chain, at most.
    """

    def __init__(self, rays: SceneRays, camera: FilmMap, longest: int) -> None:
        self.rays, self.camera, self.longest = rays, camera, longest
        self.reflects, self.transmits = mi.BSDFContext(), mi.BSDFContext()
        self.reflects.type_mask = mi.BSDFFlags.DeltaReflection
        self.transmits.type_mask = mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.Null

    def start(self, line: dict[str, Any], position: Any) -> tuple[Any, Any]:
        """Return the camera's ray, and its weight."""
        return self.camera.ray(None, position, line["wave"])

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
            hit = self.rays.preliminary(ray, False, active)
            si, p_err = self.rays.meet(hit, ray, mi.RayFlags.All, active)
            met = active & si.is_valid()
            way = st["way"] + dr.select(met, si.t, 0.0)
            what = 2 * dr.reinterpret_array(mi.UInt32, si.shape)
            what += dr.select(dr.dot(si.n, ray.d) > 0, mi.UInt32(1), 0)
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
            d = dr.select(a["what"][k] != b["what"][k], _OTHER, d)
            more = (d > most) & (most < _OTHER)
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
            hit = self.rays.preliminary(ray, False, good)
            si, p_err = self.rays.meet(hit, ray, mi.RayFlags.All, good)
            dr.eval(hit)
            out.append((mi.Ray3f(ray), hit))
            if depth == count:
                break
            more = good & (depth < last)
            met = more & si.is_valid()
            wo, factor, goes_on = self.bend(si, line, dr.opaque(mi.UInt32, depth), met)
            turned = spawn_ray(si, p_err, si.to_world(wo))
            good = good & (goes_on | (depth >= last))
            ray = dr.select(goes_on, turned, ray)
            weight = dr.select(goes_on, weight * factor, weight)
        return out, weight, good

    def attached(
        self, line: dict[str, Any], position: Any, last: Any, met: list[tuple[Any, Any]]
    ) -> Any:
        """Return the rays that arrive at the vertices `last`, with derivatives."""
        ray, _weight = self.start(line, position)
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


def specular_silhouette_image(integrator: Any, scene: Any, sensor: Any, seed: Any, spp: int) -> Any:
    """Return an image without values that has the derivatives of outlines behind ideal surfaces.

    Short pieces of lines along the rows and columns of the film are searched for places where
    chains of reflections and refractions begin to end on something else. There the image jumps; it
    changes by the jump times the speed of the place along the line, which follows by implicit
    differentiation from what is 0 there: the distance of the ray that arrives from the outline's
    tangent plane. Rows and columns are weighted by the squares of the slopes, so nothing becomes
    large where an outline runs along one of them.

    Parameters and return value are those of `primary_silhouette_image`.
    """
    longest = min(int(integrator.max_depth), _LONGEST)
    if longest < 2 or not has_delta(scene) or not what_moves(scene):
        return None
    rays = SceneRays(scene)
    if rays.data is None:
        return None
    film = sensor.film()
    camera = FilmMap(sensor)
    chains = _Chains(rays, camera, longest)
    with dr.suspend_grad():
        sampler, spp = integrator.prepare(sensor, 0x51ED270B ^ seed, spp, [])
        found = _crossings(chains, sampler, film, spp)
        if found is None:
            return None
        line, low, high, last, scale = found
        count = int(dr.max(last)[0])
        sides = [chains.vertices(line, at, last, count) for at in (low, high)]
        active = sides[0][2] & sides[1][2]
        radiance = []
        for met, weight, _good in sides:
            own = mi.load_dict({"type": "independent"})
            own.seed(0x2545F491 ^ seed, dr.width(last))  # the same numbers on both sides
            ray, hit = met[-1]
            value, _valid = trace(integrator, scene, own, ray, active, hit, last)
            radiance.append(value * weight)
        jump = radiance[0] - radiance[1]
        outline = Outline.passed_by(rays, [met[-1] for met, _weight, _good in sides], active)
        position = mi.Point2f(0.5 * (low + high))
        dr.eval(jump, outline, position)
        row = line["row"]

    def gap(place: Any) -> Any:
        ray = chains.attached(line, place, last, sides[0][0])
        return outline.gap(tables, ray)

    with rays.attach(dr.ADMode.Backward):
        assert rays.data is not None
        tables = rays.data.attached or attached_tables(rays.data.tables, rays.data.shapes)
        slope = [_slope(gap, position, k) for k in range(2)]
        square = dr.square(slope[0]) + dr.square(slope[1])
        good = outline.known & (square > 0) & dr.isfinite(square)
        factor = dr.select(good, -scale * dr.select(row, slope[0], slope[1]) / square, 0.0)
        moving = gap(position)
    value = dr.select(good, jump * factor, 0.0) * dr.replace_grad(mi.Float(0), moving)
    on_film = mi.Point2f(position + mi.Vector2f(mi.ScalarVector2f(film.crop_offset())))
    wavelengths = sides[0][0][0][0].wavelengths
    return splatted(film, on_film, wavelengths, value, spp, good)


def _slope(gap: Any, position: Any, k: int) -> Any:
    """Return how the gap changes along one coordinate on the film."""
    x = mi.Float(position[k])
    dr.enable_grad(x)
    # a second walk through one graph of derivatives ends the process: each has its own
    value = gap(mi.Point2f(x, position.y) if k == 0 else mi.Point2f(position.x, x)) + 0.0
    dr.forward_from(x)
    return dr.detach(mi.Float(dr.grad(value)))


def _crossings(chains: _Chains, sampler: Any, film: Any, spp: int) -> Any:
    """Return outlines that random pieces of lines cross.

    Returns
    -------
    line : dict
        What fixes the chains along a piece.
    low, high : Point2f
        Film positions on both sides of the outlines, as near as float32 tells.
    last : UInt
        The vertices at which the chains differ.
    scale : Float
        The inverse of the density of pieces across the outlines, over the number of samples.
    """
    size = mi.Vector2f(mi.ScalarVector2f(film.crop_size()))
    width, height = (int(x) for x in film.crop_size())
    total = width * height * spp
    index = dr.arange(mi.UInt32, total)
    pixel = index // dr.opaque(mi.UInt32, spp)
    at = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + sampler.next_2d()
    line = {
        "row": sampler.next_1d() < 0.5,
        "plan": mi.UInt32(sampler.next_1d() * (1 << 24)),
        "lobe": sampler.next_1d(),
        "wave": sampler.next_1d() if mi.is_spectral else dr.full(mi.Float, 0.5, total),
    }
    along = dr.select(line["row"], mi.Vector2f(1, 0), mi.Vector2f(0, 1))
    # pieces begin as far before the film as they are long
    at = at * (1 + along * _PIECE / size) - along * _PIECE
    dr.eval(line, at, along)
    chosen = []
    for start in range(0, total, _TOGETHER):
        lanes = start + dr.arange(mi.UInt32, min(_TOGETHER, total - start))
        some, begin, step = dr.gather(tuple, (line, at, along * _PIECE), lanes)
        ends = []
        for part in (0.0, 0.5, 1.0):  # one kernel for all
            ends.append(chains.follow(some, begin + step * dr.opaque(mi.Float, part)))
            dr.eval(ends[-1])
        whole, one, two = (
            chains.difference(ends[a], ends[b])[0] for a, b in ((0, 2), (0, 1), (1, 2))
        )
        uneven = (dr.maximum(one, two) > _UNEVEN * (one + two)) & (one + two > _JUMP)
        chosen.append(dr.gather(mi.UInt32, lanes, dr.compress((whole >= _OTHER) | uneven)))
    which = dr.concat(chosen)
    if dr.width(which) == 0:
        return None
    line, at, along = dr.gather(tuple, (line, at, along), which)
    line, low, high, last = _narrowed(chains, line, at, at + along * _PIECE, size)
    if dr.width(low) == 0:
        return None
    reach = dr.select(line["row"], width + _PIECE, height + _PIECE)
    across = dr.select(line["row"], mi.Float(height), mi.Float(width))
    return line, low, high, last, 2 * reach * across / (_PIECE * total)


def _narrowed(chains: _Chains, line: Any, low: Any, end: Any, size: Any) -> tuple[Any, ...]:
    """Return lines, both sides of outlines on them between `low` and `end`, and the vertices."""
    found: list[tuple[Any, ...]] = []
    begin = chains.follow(line, low)
    dr.eval(begin, line, low, end)
    for _ in range(_ROUNDS):
        high = end
        a, b = begin, chains.follow(line, high)
        dr.eval(b)
        for _step in range(_HALVINGS):
            middle_at = 0.5 * (low + high)
            middle = chains.follow(line, middle_at)
            one, _where = chains.difference(a, middle)
            two, _where = chains.difference(middle, b)
            left = (one >= _OTHER) | ((two < _OTHER) & (one > two))
            a = dr.select(left, a, middle)
            b = dr.select(left, middle, b)
            low, high = dr.select(left, low, middle_at), dr.select(left, middle_at, high)
            dr.eval(a, b, low, high)
        differ, last = chains.difference(a, b)
        # outlines that are seen directly are not of this kind
        inside = dr.all((low >= 0) & (low < size))
        real = dr.compress((differ > _JUMP) & (last > 0) & inside)
        if dr.width(real):
            found.append(dr.gather(tuple, (line, low, high, last), real))
        # what is left of the piece, if something is still to be found there
        rest, _where = chains.difference(b, chains.follow(line, end))
        again = dr.compress(rest >= _OTHER)
        if dr.width(again) == 0:
            break
        line, low, end, begin = dr.gather(tuple, (line, high, end, b), again)
        dr.eval(line, low, end, begin)
    if not found:
        found.append(dr.gather(tuple, (line, low, high, last), mi.UInt32()))
    return _joined(found)


def _joined(parts: list[Any]) -> Any:
    """Return the lanes of all of some nests of the same kind, one after the other."""
    first = parts[0]
    if len(parts) == 1:
        return first
    if isinstance(first, dict):
        return {key: _joined([part[key] for part in parts]) for key in first}
    if isinstance(first, (list, tuple)):
        return type(first)(_joined(list(group)) for group in zip(*parts))
    if len(first) != dr.width(first):  # a vector
        return type(first)(*(dr.concat([part[k] for part in parts]) for k in range(len(first))))
    return dr.concat(parts)
