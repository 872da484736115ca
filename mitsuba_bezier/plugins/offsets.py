"""How far off a surface rays start and end: as far as the point's own error asks.

Mitsuba 3.9 moves every origin by 1500 roundings of ``1 + max|p|``, which jumps over a shell that is
near. A point on a patch is known better, and `position_error` tells how well. The number goes by
the name that it has in interactions of Mitsuba 3.10, ``p_err``; there, they carry it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from .native.originals import original

__all__ = ["Connection", "own_error", "position_error", "spawn_ray", "spawn_ray_to"]

#: A rounding of float32, half a unit of the last place.
_ROUNDING = 2.0**-24
#: Roundings of the coordinates along the normal: one of the point, one of the ray's origin, which
#: is as near as origins in float32 can come, and a little to spare.
_PLACE = 2.25
#: Roundings of the extents of the patch along the normal: what the kernels evaluate is as good.
#: Two were enough for all rays of `tests/test_leaving.py`.
_EXTENT = 4.0
#: What a patch may be off the quadric, or plane, that rays meet for it, in roundings of its size:
#: it counts as one up to 3e-7. One in a plane is off by no more than it bends.
_OFF_QUADRIC = 5.0
#: Rounding of float64 in what is left, as in planes through zero, in patch sizes.
_LEAST = 2.0**-40
#: Roundings of the way of a shadow ray, in its end: its length, direction and ray parameter.
_WAY = 4.0


def position_error(p: Any, n: Any, pu: Any, pv: Any, height: Any = None) -> Any:
    """Return how far a point of a patch may be from where rays meet it, along the normal.

    Parameters
    ----------
    p : mi.Point3f
        The point in space.
    n : mi.Normal3f
        Its unit normal.
    pu, pv : mi.Vector3f
        The partials by the patch's parameters: they tell the size of the patch there.
    height : mi.Float, optional
        By how much the patch bends off its tangent plane, if that is known.

    Returns
    -------
    mi.Float
    """
    across = dr.abs(mi.Vector3f(n))
    extent = dr.abs(pu) + dr.abs(pv)
    size = dr.norm(pu) + dr.norm(pv)
    error = dr.dot(across, dr.fma(dr.abs(mi.Vector3f(p)), _PLACE, extent * _EXTENT)) * _ROUNDING
    off = size * (_OFF_QUADRIC * _ROUNDING)
    if height is not None:
        off = dr.select(height < off, height, off)
    # where a patch runs to infinity, its partials grow as the square of the distance
    return dr.minimum(dr.fma(size, _LEAST, error + off), own_error(p))


def own_error(p: Any) -> Any:
    """Return by how much Mitsuba moves origins off its own shapes."""
    return (1.0 + dr.max(dr.abs(p))) * mi.math.RayEpsilon


def _moved(p: Any, n: Any, p_err: Any, d: Any) -> Any:
    """Return a point moved off its surface to the side of `d`."""
    return dr.fma(dr.mulsign(p_err, dr.dot(n, d)), n, p)


def spawn_ray(si: Any, p_err: Any, d: Any) -> Any:
    """Return the ray that leaves a surface.

    Parameters
    ----------
    si : mi.Interaction3f
        The point.
    p_err : mi.Float or None
        Its error along the normal; None for Mitsuba's offset.
    d : mi.Vector3f
        The direction.

    Returns
    -------
    mi.Ray3f
    """
    ray = original(si, "spawn_ray")(d)
    if p_err is not None:
        ray.o = _moved(si.p, si.n, p_err, d)
    return ray


class Connection(NamedTuple):
    """A ray from a point to another; `SceneRays.is_blocked` tells whether something is between."""

    ray: Any  #: mi.Ray3f, up to where Mitsuba's shapes count
    reach: Any  #: Float, up to where patches count


def spawn_ray_to(si: Any, p_err: Any, p: Any, n: Any = None, end_err: Any = None) -> Connection:
    """Return the ray from a surface to a point.

    Parameters
    ----------
    si : mi.Interaction3f
        Where it leaves.
    p_err : mi.Float or None
        The error of that point along its normal; None for Mitsuba's offset.
    p : mi.Point3f
        Where it goes to.
    n : mi.Normal3f, optional
        The normal there.
    end_err : mi.Float, optional
        The error of `p` along `n` if it is on a patch, which must not count as being between;
        0 where it is not on one. None if that is not known: the ray then ends before `p` by
        Mitsuba's part of the way, a thousandth.

    Returns
    -------
    Connection
    """
    ray = original(si, "spawn_ray_to")(p)
    if p_err is None:
        return Connection(ray, ray.maxt)
    o = _moved(si.p, si.n, p_err, p - si.p)
    rough = dr.norm(p - o)
    on_patch = mi.Bool(False)
    if end_err is not None:
        on_patch = end_err > 0.0
        margin = dr.fma(rough, _WAY * _ROUNDING, end_err)
        p = dr.select(on_patch, _moved(p, n, margin, o - p), p)
    way = p - o
    length = dr.norm(way)
    short = length * (1.0 - mi.math.ShadowEpsilon)
    reach = short if end_err is None else length * (1.0 - _WAY * _ROUNDING)
    ray.o, ray.d = o, way / length
    ray.maxt = dr.select(on_patch, reach, short)
    return Connection(ray, reach)
