"""Rays that follow the surfaces they leave: derivatives along chains of ideal mirrors and glass.

A path is cut where nothing has to be passed on. Behind a rough surface the next vertex stays where
it is, so the direction towards it, with its solid angle, follows the vertex before; behind a mirror
or glass the ray itself moves, and so does what it meets. Forward, a ray carries its tangent. In
reverse, the vertices of a chain are kept until it ends, in memory of the thread that does not grow
with the number of rays, and gone through backwards: each is met once more, with derivatives, and
hands the adjoint of the ray that left it on to the one that arrived.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from ..interaction import Preliminary
from ..scene import SceneRays

__all__ = [
    "LONGEST",
    "Bend",
    "Chains",
    "Vertex",
    "has_delta",
    "is_followed",
    "what_moves",
    "with_derivatives",
]

#: Vertices of a chain that pass on derivatives in reverse mode; a longer one is cut there. It is
#: what a thread keeps: about 100 bytes each.
LONGEST = 32

_BEZIER, _ARRIVED, _LEAVES, _MET = (1 << k for k in range(4))


def has_delta(scene: Any) -> bool:
    """Return whether a surface of the scene reflects or refracts into single directions."""
    bsdfs = (shape.bsdf() for shape in scene.shapes())
    return any(b is not None and mi.has_flag(b.flags(), mi.BSDFFlags.Delta) for b in bsdfs)


def with_derivatives(scene: Any) -> list[tuple[str, Any, Any]]:
    """Return the parameters that have derivatives now: names, the objects they are of, flags.

    Also those that nothing has derivatives by; see `left_out.checked_parameters`.
    """
    params = mi.traverse(scene)
    found = []
    with dr.resume_grad():
        for key in params.keys():  # noqa: SIM118 (no dict)
            if dr.grad_enabled(params[key]):
                _value, _kind, node, flags = params.properties[key]
                found.append((key, node, flags))
    return found


def is_followed(node: Any, flags: Any) -> bool:
    """Return whether rays may follow a parameter: a place, a normal, an ior."""
    moves = flags & mi.ParamFlags.Discontinuous or isinstance(node, mi.Shape | mi.BSDF)
    return bool(moves and not flags & mi.ParamFlags.NonDifferentiable)


def what_moves(scene: Any) -> list[str]:
    """Return the names of parameters with derivatives that rays may follow."""
    return [key for key, node, flags in with_derivatives(scene) if is_followed(node, flags)]


@dataclass
class Bend:
    """How a path goes on from a vertex."""

    delta: Any = None  #: Bool: by an ideal lobe
    sample1: Any = None  #: Float, the number that chose the lobe
    sample2: Any = None  #: Point2f
    met: Any = None  #: Bool: there is a next vertex, and it stays where it is
    target: Any = None  #: Point3f, that vertex

    DRJIT_STRUCT = {"delta": Any, "sample1": Any, "sample2": Any, "met": Any, "target": Any}


class Vertex(NamedTuple):
    """A vertex of a path that is being differentiated."""

    ray: Any  #: mi.Ray3f that arrived there
    attached: Any  #: the same with derivatives, as `Chains.arrive` made it
    hit: Preliminary
    arrived: Any  #: Bool: from an ideal mirror or glass, or the sensor
    bend: Bend


@cache
def _link_class(_variant: str) -> type:
    """Return the record of a vertex. Dr.Jit's local memory of LLVM takes no masks."""

    class Link:
        DRJIT_STRUCT = {
            "o": mi.Point3f,
            "d": mi.Vector3f,
            "t": mi.Float,
            "uv": mi.Point2f,
            "prim_index": mi.UInt32,
            "shape": mi.UInt32,
            "shape_index": mi.UInt32,
            "instance": mi.UInt32,
            "patch": mi.UInt32,
            "flags": mi.UInt32,
            "sample1": mi.Float,
            "sample2": mi.Point2f,
            "target": mi.Point3f,
            "adjoint_o": mi.Vector3f,
            "adjoint_d": mi.Vector3f,
        }

        def __init__(self, **fields: Any) -> None:
            for name, value in fields.items():
                setattr(self, name, value)

    return Link


class Chains:
    """Attached rays of the vertices of paths, in the loop of an integrator.

    Parameters
    ----------
    rays : SceneRays
    mode : dr.ADMode
    moves : bool
        Whether anything that rays follow has derivatives; else all of this costs nothing.
    delta : bool
        Whether the scene has ideal mirrors or glass.
    longest : int
        Depth of the longest path.
    """

    def __init__(self, rays: SceneRays, mode: Any, moves: bool, delta: bool, longest: int) -> None:
        self.rays, self.moves, self.delta = rays, moves, delta
        self.forward = mode == dr.ADMode.Forward
        self.capacity = min(LONGEST, max(longest, 1)) if delta else 1

    def initial(self, width: int) -> dict[str, Any]:
        """Return what the loop has to carry."""
        if not self.moves:
            return {}
        if self.forward:
            zero = dr.zeros(mi.Vector3f, width)
            return {"o": zero, "d": mi.Vector3f(zero)}
        links = dr.alloc_local(_link_class(str(mi.variant())), self.capacity)
        return {"links": links, "count": dr.zeros(mi.UInt32, width)}

    # ------------------------------------------------------------------ a vertex

    def arrive(self, state: dict[str, Any], ray: Any) -> Any:
        """Return the ray with derivatives; its origin and direction are leaves of their own."""
        if not self.moves:
            return ray
        ray = mi.Ray3f(ray)
        ray.o, ray.d = mi.Point3f(dr.detach(ray.o)), mi.Vector3f(dr.detach(ray.d))
        dr.enable_grad(ray.o, ray.d)
        if self.forward:
            dr.set_grad(ray.o, mi.Point3f(state["o"]))
            dr.set_grad(ray.d, state["d"])
        return ray

    def meet(
        self, hit: Preliminary, ray: Any, attached: Any, arrived: Any, active: Any
    ) -> tuple[Any, Any]:
        """Return the interaction of a vertex, and the error of its point.

        It moves with its shape along the ray, and where a mirror or glass turned the ray
        (`arrived`) with the ray, too. Where light comes from always follows the ray.
        """
        followed = ray
        if self.moves and self.delta:
            followed = mi.Ray3f(ray)
            followed.o = dr.select(arrived, attached.o, ray.o)
            followed.d = dr.select(arrived, attached.d, ray.d)
        si, p_err = self.rays.meet(hit, followed, mi.RayFlags.All, active)
        if self.moves:
            wi = dr.select(si.is_valid(), si.to_local(-attached.d), -attached.d)
            si.wi = dr.replace_grad(si.wi, dr.select(active, wi, si.wi))
        return si, p_err

    def leave(self, si: Any, bend: Bend, wo: Any, d: Any) -> tuple[Any, Any]:
        """Return origin and direction of the next ray, with derivatives.

        Parameters
        ----------
        si : mi.SurfaceInteraction3f
            With derivatives.
        bend : Bend
        wo : mi.Vector3f
            Sampled by the numbers of `bend`, with derivatives.
        d : mi.Vector3f
            The direction without.
        """
        to = dr.normalize(dr.select(bend.met, bend.target - si.p, mi.Vector3f(0, 0, 1)))
        turned = dr.select(bend.met, to, d)
        if self.delta:
            turned = dr.select(bend.delta, si.to_world(wo), turned)
        return si.p, dr.replace_grad(d, turned)

    # ------------------------------------------------------------------ the loop

    def step_forward(self, total: Any, o: Any, d: Any) -> tuple[Any, dict[str, Any]]:
        """Return the derivative of the light at a vertex, and the tangent of the next ray."""
        if not self.moves:
            return mi.Spectrum(dr.forward_to(total)), {}
        # roundings of 0 keep targets apart that may be one variable
        o, d = mi.Vector3f(o) + 0.0, d + 0.0
        dr.forward_to(total, o, d, flags=dr.ADFlag.ClearEdges)
        return mi.Spectrum(dr.grad(total)), {"o": dr.grad(o), "d": dr.grad(d)}

    def step_backward(
        self,
        state: dict[str, Any],
        weighted: Any,
        vertex: Vertex,
        active: Any,
        active_next: Any,
    ) -> dict[str, Any]:
        """Take the adjoint of the light at a vertex to the parameters, and note the vertex.

        Parameters
        ----------
        state : dict
            As `initial` made it.
        weighted : mi.Spectrum
            Light times the adjoint of the radiance.
        vertex : Vertex
        active, active_next : Bool
            Whether there is a vertex, and a next one.
        """
        dr.backward_from(weighted)
        if not self.moves:
            return {}
        arrived, bend = vertex.arrived, vertex.bend
        link = self._link(vertex)
        links, count = state["links"], state["count"]
        # where what is to come does not depend on the ray that arrived, its chain ends
        ends = active & ~(active_next & (arrived | bend.delta))
        ends = ends | (active & (count >= self.capacity))
        links = self._hand_back(
            links, dr.select(ends, count, 0), link.adjoint_o, link.adjoint_d, vertex.ray
        )
        count = dr.select(ends, 0, count)
        links.write(link, dr.select(active, count, 0), active)
        return {"links": links, "count": dr.select(active, count + 1, count)}

    def _link(self, vertex: Vertex) -> Any:
        ray, attached, hit, arrived, bend = vertex
        pi = hit.pi
        flags = dr.select(hit.bezier, mi.UInt32(_BEZIER), 0)
        for mask, bit in ((arrived, _ARRIVED), (bend.delta, _LEAVES), (bend.met, _MET)):
            flags |= dr.select(mask, mi.UInt32(bit), 0)
        return _link_class(str(mi.variant()))(
            o=dr.detach(ray.o),
            d=dr.detach(ray.d),
            t=pi.t,
            uv=pi.prim_uv,
            prim_index=pi.prim_index,
            shape=dr.reinterpret_array(mi.UInt32, pi.shape),
            shape_index=pi.shape_index,
            instance=dr.reinterpret_array(mi.UInt32, pi.instance),
            patch=hit.patch,
            flags=flags,
            sample1=bend.sample1,
            sample2=bend.sample2,
            target=bend.target,
            adjoint_o=mi.Vector3f(dr.grad(attached.o)),
            adjoint_d=dr.grad(attached.d),
        )

    def _hand_back(self, links: Any, count: Any, o: Any, d: Any, like: Any) -> Any:
        """Take the adjoint of a ray through the vertices before it; return `links`."""
        context = mi.BSDFContext()

        def body(links: Any, k: Any, o: Any, d: Any) -> tuple[Any, ...]:
            k = k - 1
            link = links.read(k)
            arrived, leaves = (link.flags & _ARRIVED) != 0, (link.flags & _LEAVES) != 0
            pi = dr.zeros(mi.PreliminaryIntersection3f)
            pi.valid, pi.t, pi.prim_uv, pi.prim_index = (
                mi.Bool(True),
                link.t,
                link.uv,
                link.prim_index,
            )
            pi.shape = dr.reinterpret_array(mi.ShapePtr, link.shape)
            pi.instance = dr.reinterpret_array(mi.ShapePtr, link.instance)
            pi.shape_index = link.shape_index
            hit = Preliminary(pi, (link.flags & _BEZIER) != 0, link.patch)
            bend = Bend(leaves, link.sample1, link.sample2, (link.flags & _MET) != 0, link.target)
            ray = dr.zeros(mi.Ray3f)
            ray.o, ray.d, ray.maxt = link.o, link.d, dr.largest(mi.Float)
            ray.time, ray.wavelengths = like.time, like.wavelengths
            with dr.resume_grad():
                attached = self.arrive({}, ray)
                si, _p_err = self.meet(hit, ray, attached, arrived, mi.Bool(True))
                wo = mi.Vector3f(0, 0, 1)
                if self.delta:
                    bsdf = si.bsdf(ray)
                    sample, _w = bsdf.sample(context, si, bend.sample1, bend.sample2, leaves)
                    wo = sample.wo
                next_o, next_d = self.leave(si, bend, wo, dr.detach(si.to_world(wo)))
                adjoint = dr.dot(o, next_o) + dr.dot(d, next_d)
                if dr.grad_enabled(adjoint):
                    dr.backward_from(adjoint)
            o, d = mi.Vector3f(dr.grad(attached.o)), dr.grad(attached.d)
            goes_on = arrived | leaves
            o = link.adjoint_o + dr.select(goes_on, o, 0.0)
            d = link.adjoint_d + dr.select(goes_on, d, 0.0)
            return links, dr.select(goes_on, k, 0), o, d

        links, _k, _o, _d = dr.while_loop(
            (links, count, o, d), lambda _l, k, _o, _d: k > 0, body, label="bezierpath: chain"
        )
        return links
