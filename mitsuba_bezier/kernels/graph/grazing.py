"""Make hits at grazing angles exact, in float64.

An error across the surface is an error along the ray divided by the cosine between the ray and the
normal. What float32 leaves of it, some 1e-7 of a leaf's size, is seen near silhouettes of large
leaves only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..buckets import Bucket
from ..leaf_nets import gather_net
from ..query import Query, Rays
from ..structure import AFFINE
from .chart import affine_rays

__all__ = ["LeafPlace", "polish"]

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


def polish(
    query: Query, place: LeafPlace, base: Any, rays: Rays, best: Any
) -> tuple[Any, Any, Any]:
    """Do a step of Newton's method from hits in affine leaves, where they are grazing.

    Parameters
    ----------
    place : LeafPlace
    base : Float64
        Ray parameter of a point near the leaf, see `chart.ChartLine`.
    best : march.Best
        The hits.

    Returns
    -------
    t, u, v : Float
    """
    s, ty = query.s, query.ty

    def step(t: Any, u: Any, v: Any, closing: Any, leaf: Any, number: Any, base: Any) -> Any:
        f64 = ty.Float64
        record = AFFINE.gather(s.affine, leaf, best.hit)
        net = gather_net(place.bucket, number, best.hit)
        there = affine_rays(ty, record, base, rays, wide=True)
        (x0, y0, z0), (ex, ey, ez) = there.x0, there.e
        u64, v64, tau = f64(u), f64(v), f64(t) - base
        (x, y, z), (xu, yu, zu), (xv, yv, zv) = net.point(u64, v64, best.hit)
        # from the ray to the surface, and what the ray is in the tangent plane's coordinates
        rx, ry, rz = dr.fma(tau, ex, x0) - x, dr.fma(tau, ey, y0) - y, dr.fma(tau, ez, z0) - z
        idet = 1.0 / dr.fma(xu, yv, -xv * yu)
        du, dv = dr.fma(yv, rx, -xv * ry) * idet, dr.fma(xu, ry, -yu * rx) * idet
        eu, ev = dr.fma(yv, ex, -xv * ey) * idet, dr.fma(xu, ey, -yu * ex) * idet
        slope = ez - dr.fma(zu, eu, zv * ev)
        delta = -(rz - dr.fma(zu, du, zv * dv)) / slope
        speed2 = ty.Float(dr.fma(ex, ex, dr.fma(ey, ey, ez * ez)))
        usable = dr.abs(ty.Float(delta)) * speed2 < _SHARE * closing  # false for NaN
        u64, v64 = u64 + dr.fma(eu, delta, du), v64 + dr.fma(ev, delta, dv)
        return (
            dr.select(usable, ty.Float(base + (tau + delta)), t),
            dr.select(usable, ty.Float(u64), u),
            dr.select(usable, ty.Float(v64), v),
        )

    return dr.if_stmt(
        args=(best.t, best.u, best.v, best.closing, place.leaf, place.number, base),
        cond=best.hit & (best.closing * best.t < _GRAZING),
        true_fn=step,
        false_fn=lambda t, u, v, *_: (t, u, v),
        label="bezier grazing",
    )
