"""The methods of `mi.Shape` for rays and for sampling, for `beziertriangle`."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...errors import BezierError
from ..interaction import Preliminary
from ..surface_sampling import SurfaceSampling, direction_sample, per_solid_angle

__all__ = ["METHODS"]


def ray_intersect_preliminary(shape: Any, ray: Any, active: Any = True) -> Any:
    """Return the nearest hit as `mi.PreliminaryIntersection3f`."""
    data = shape._alone()
    data.handed_out = True
    return data.preliminary(ray, active).pi


def ray_intersect(shape: Any, ray: Any, flags: Any = None, active: Any = True) -> Any:
    """Return the nearest hit as `mi.SurfaceInteraction3f`."""
    data = shape._alone()
    hit = data.preliminary(ray, active)
    flags = mi.RayFlags.All if flags is None else flags
    return data.surface_interaction(hit, ray, flags, active)


def compute_surface_interaction(
    shape: Any, ray: Any, pi: Any, flags: Any = None, active: Any = True
) -> Any:
    """Return the `mi.SurfaceInteraction3f` of what `ray_intersect_preliminary` found."""
    flags = mi.RayFlags.All if flags is None else flags
    hit = Preliminary(pi, pi.is_valid(), pi.prim_index)
    return shape._alone().surface_interaction(hit, ray, flags, active)


def ray_test(shape: Any, ray: Any, active: Any = True) -> Any:
    """Return whether the ray hits."""
    return shape._alone().test(ray, active)


def eval_parameterization(shape: Any, uv: Any, flags: Any = None, active: Any = True) -> Any:
    """Return the interaction at parameters of the patch.

    Raises
    ------
    BezierError
        If the shape has several patches, or texture coordinates of its own: the same
        coordinates may be anywhere then, or nowhere.
    """
    placed = shape.texture_corners is not None or shape.projection is not None
    if len(shape.patches) > 1 or placed:
        raise BezierError.expected(
            "eval_parameterization",
            "a shape of one patch without texcoords and uv (elsewhere evaluate `shape.patches`)",
            f"{len(shape.patches)} patches"
            + (" with texcoords" if shape.texture_corners is not None else "")
            + (" with uv" if shape.projection is not None else ""),
        )
    flags = mi.RayFlags.All if flags is None else flags
    uv, active = mi.Point2f(uv), mi.Bool(active)
    inside = active & (uv.x >= 0) & (uv.y >= 0) & (uv.x + uv.y <= 1)
    pi = dr.zeros(mi.PreliminaryIntersection3f, dr.width(uv))
    pi.t, pi.prim_uv, pi.valid = mi.Float(0.0), uv, inside
    pi.shape = mi.ShapePtr(shape)
    hit = Preliminary(pi, inside, mi.UInt32(0))
    ray = dr.zeros(mi.Ray3f, dr.width(uv))
    ray.o = mi.Point3f(dr.largest(mi.Float))  # no ray knows the point better than the patch
    si = shape._alone().surface_interaction(hit, ray, flags, inside)
    si.t = dr.select(inside, 0.0, dr.inf)
    return si


def _sampling(shape: Any) -> SurfaceSampling:
    return shape._alone().surface_sampling((0,))


def sample_position(shape: Any, time: Any, sample: Any, active: Any = True) -> Any:
    """Sample the surface nearly by area; return `mi.PositionSample3f`."""
    return sample_point(shape, time, sample, active)[0]


def sample_point(shape: Any, time: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
    """Return what `sample_position` does, and the error of the point along the normal."""
    sampling, active = _sampling(shape), mi.Bool(active)
    patch, u, v, linear = sampling.sample_parameters(mi.UInt32(0), mi.Point2f(sample), active)
    ps, p_err = sampling.position_and_error(patch, u, v, linear, active)
    ps.time = time
    return ps, p_err


def pdf_position(shape: Any, ps: Any, active: Any = True) -> Any:
    """Return the density of `sample_position`; reads ``ps.p`` and ``ps.n``."""
    return _sampling(shape).pdf_at(mi.UInt32(0), ps.p, ps.n, active)


def sample_direction(shape: Any, it: Any, sample: Any, active: Any = True) -> Any:
    """Sample a direction towards the surface; return `mi.DirectionSample3f`."""
    return direction_sample(sample_position(shape, it.time, sample, active), it)


def pdf_direction(shape: Any, it: Any, ds: Any, active: Any = True) -> Any:
    """Return the density of `sample_direction` by solid angle."""
    return per_solid_angle(pdf_position(shape, ds, active), ds, ds.n)


METHODS = (
    ray_intersect_preliminary,
    ray_intersect,
    compute_surface_interaction,
    ray_test,
    eval_parameterization,
    sample_position,
    sample_point,
    pdf_position,
    sample_direction,
    pdf_direction,
)
