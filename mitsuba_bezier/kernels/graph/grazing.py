"""Make hits exact, at grazing angles and in projective charts, with wide numbers.

An error across the surface is an error along the ray divided by the cosine between the ray and the
normal. What float32 leaves of it, some 1e-7 of a leaf's size, is seen near silhouettes of large
leaves only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..buckets import Bucket
from ..leaf_nets import LeafNet, gather_net
from ..query import Query, Rays
from ..structure import AFFINE
from ..two_float import coarse, fma
from .chart import ChartRays, affine_rays

__all__ = ["LeafPlace", "correction", "polish"]

#: Hits are polished if the ray would come nearer to the surface by less than this, in leaf sizes,
#: on its whole way: 1e-7 of a leaf is then more than 1e-6 of the way.
_GRAZING = 0.1
#: Newton's step counts up to this share of the cosine, in leaf sizes: two roots are about twice
#: that apart, and after it the error is the step times half this share.
_SHARE = 0.1


@dataclass(frozen=True)
class LeafPlace:
    """Where an affine leaf is."""

    leaf: Any  #: UInt, its number
    bucket: Bucket  #: of its net
    number: Any  #: UInt, the net's


def correction(
    net: LeafNet, there: ChartRays, tau: Any, u: Any, v: Any, active: Any
) -> tuple[Any, Any, Any]:
    """Return the step of Newton's method from where a ray nearly meets a leaf.

    Parameters
    ----------
    there : ChartRays
        The ray, in wide numbers.
    tau, u, v : wide numbers
        Where it is, and the parameters there.

    Returns
    -------
    d_tau, du, dv
        Coarse, see `two_float.coarse`, as slopes are: only what is left of the way to the surface
        is a difference of wide numbers.
    """
    point, (xu, yu, zu), (xv, yv, zv) = net.point(u, v, active)
    # from the ray to the surface, and what the ray is in the tangent plane's coordinates
    rx, ry, rz = (coarse(fma(tau, e, x0) - x) for e, x0, x in zip(there.e, there.x0, point))
    ex, ey, ez = (coarse(e) for e in there.e)
    idet = 1.0 / dr.fma(xu, yv, -xv * yu)
    du, dv = dr.fma(yv, rx, -xv * ry) * idet, dr.fma(xu, ry, -yu * rx) * idet
    eu, ev = dr.fma(yv, ex, -xv * ey) * idet, dr.fma(xu, ey, -yu * ex) * idet
    slope = ez - dr.fma(zu, eu, zv * ev)
    delta = -(rz - dr.fma(zu, du, zv * dv)) / slope
    return delta, dr.fma(eu, delta, du), dr.fma(ev, delta, dv)


def polish(
    query: Query, place: LeafPlace, base: Any, rays: Rays, best: Any
) -> tuple[Any, Any, Any]:
    """Do a step of Newton's method from hits in affine leaves, where they are grazing.

    Parameters
    ----------
    place : LeafPlace
    base : wide number
        Ray parameter of a point near the leaf, see `chart.ChartLine`.
    best : march.Best
        The hits.

    Returns
    -------
    t, u, v : Float
    """
    s, ty = query.s, query.ty

    def step(t: Any, u: Any, v: Any, closing: Any, leaf: Any, number: Any, base: Any) -> Any:
        record = AFFINE.gather(s.affine, leaf, best.hit)
        net = gather_net(place.bucket, number, best.hit)
        there = affine_rays(ty, record, base, rays, wide=True)
        tau = ty.widen(t) - base
        delta, du, dv = correction(net, there, tau, ty.widen(u), ty.widen(v), best.hit)
        ex, ey, ez = (coarse(x) for x in there.e)
        speed2 = ty.Float(dr.fma(ex, ex, dr.fma(ey, ey, ez * ez)))
        usable = dr.abs(ty.Float(delta)) * speed2 < _SHARE * closing  # false for NaN
        return (
            dr.select(usable, ty.narrow(base + (tau + delta)), t),
            dr.select(usable, ty.narrow(ty.widen(u) + du), u),
            dr.select(usable, ty.narrow(ty.widen(v) + dv), v),
        )

    return dr.if_stmt(
        args=(best.t, best.u, best.v, best.closing, place.leaf, place.number, base),
        cond=best.hit & (best.closing * best.t < _GRAZING),
        true_fn=step,
        false_fn=lambda t, u, v, *_: (t, u, v),
        label="bezier grazing",
    )
