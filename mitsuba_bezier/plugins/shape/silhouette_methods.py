"""The methods of `mi.Shape` for silhouettes, for `beziertriangle`.

Samples are `mi.SilhouetteSample3f`. Their ``uv`` are the parameters in the patch ``prim_index``,
whatever texture coordinates the shape has; ``n`` points away from the surface, across ``d`` and
the curve, also where the normal of the surface points the other way; ``projection_index`` is the
segment of an edge, ``scene_index`` 1 + the number of the instance, or 0. Shapes with
instances raise `BezierError` where an interaction does not tell which, and trimmed ones where it
would have to tell the curve.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import BezierError
from ..attached import attached_tables
from ..boundary_lines import BoundaryLines
from ..silhouette import SilhouetteCurves, facing, outward

__all__ = ["METHODS"]

_NEWTON = 8


def _lines(shape: Any) -> BoundaryLines:
    """Return the lines that touch a shape, made once for its present state."""
    data = shape._alone()
    return data.made_once("boundary lines", lambda: BoundaryLines(data, [0]))


def _sample(shape: Any, line: Any, flags: int) -> Any:
    """Return a `mi.SilhouetteSample3f` of a `BoundarySample`."""
    kinds = mi.DiscontinuityFlags
    ss = dr.zeros(mi.SilhouetteSample3f, dr.width(line.p))
    ss.p, ss.n, ss.d, ss.uv = line.p, mi.Normal3f(line.n), line.d, mi.Point2f(line.u, line.v)
    ss.silhouette_d = dr.select(line.is_edge, line.along, dr.cross(line.d, line.n))
    ss.prim_index, ss.projection_index = line.patch, line.index
    ss.scene_index = line.instance
    ss.pdf = dr.select(line.valid, line.pdf, 0)
    ss.foreshortening = line.density
    kind = dr.select(
        line.is_edge, mi.UInt32(kinds.PerimeterType.value), mi.UInt32(kinds.InteriorType.value)
    )
    ss.discontinuity_type = dr.select(line.valid, kind, mi.UInt32(kinds.Empty.value))
    ss.flags = flags
    ss.shape = mi.ShapePtr(shape)
    ss.offset = mi.math.ShadowEpsilon
    return ss


def _kinds(flags: Any) -> tuple[bool, bool]:
    value = getattr(flags, "value", flags)
    kinds = mi.DiscontinuityFlags
    return bool(value & kinds.InteriorType.value), bool(value & kinds.PerimeterType.value)


def silhouette_discontinuity_types(shape: Any) -> int:
    """Return the kinds of discontinuities, bits of `mi.DiscontinuityFlags`."""
    kinds = mi.DiscontinuityFlags
    edges = kinds.PerimeterType.value if len(_lines(shape).edges) else 0
    return int(kinds.InteriorType.value | edges)


def silhouette_sampling_weight(shape: Any) -> float:
    """Return the weight of the shape among others."""
    return 1.0


def sample_silhouette(shape: Any, sample: Any, flags: Any, active: Any = True) -> Any:
    """Map the unit cube to lines that touch the shape; return `mi.SilhouetteSample3f`.

    Interior: a point by area and an angle in its tangent plane, and the normal curvature in that
    direction as ``foreshortening``. Perimeter: a point of an open edge or crease and any direction,
    and the sine between both. If both are asked for and there are edges, each has one half.
    """
    interior, perimeter = _kinds(flags)
    line = _lines(shape).sample(mi.Point3f(sample), mi.Bool(active), interior, perimeter)
    return _sample(shape, line, int(getattr(flags, "value", flags)))


def invert_silhouette_sample(shape: Any, ss: Any, active: Any = True) -> Any:
    """Return numbers of the unit cube that `sample_silhouette` takes to this sample.

    ``ss.flags`` tell which kinds it was drawn from.
    """
    kinds = mi.DiscontinuityFlags
    _need_whole(shape)
    lines = _lines(shape)
    both = (ss.flags & kinds.AllTypes.value) == kinds.AllTypes.value
    is_edge = ss.discontinuity_type == kinds.PerimeterType.value
    return lines.invert(ss, is_edge, both, mi.Bool(active))


def _curves(shape: Any, eye: np.ndarray, again: bool = False) -> SilhouetteCurves:
    """Return the silhouettes seen from a point; those of the last point if it is the same."""
    data = shape._alone()

    def make() -> tuple[np.ndarray, SilhouetteCurves]:
        return eye, SilhouetteCurves(data, [0], eye)

    seen_from, curves = data.made_once("silhouettes", make, again)
    # 1e-5: the caller's point went through float32 and a transformation
    if np.abs(seen_from - eye).max() > 1e-5 * (1 + np.abs(eye).max()):
        return _curves(shape, eye, again=True)
    return curves


def precompute_silhouette(shape: Any, viewpoint: Any) -> tuple[Any, Any]:
    """Return the segments of the silhouettes seen from a point, and their lengths in space.

    Returns
    -------
    indices : UInt32
        For `sample_precomputed_silhouette`, which keeps the segments of the last point asked for.
    weights : Float
    """
    eye = np.array(viewpoint, dtype=np.float64).reshape(3)
    curves = _curves(shape, eye, again=True)
    a, b = curves.ends()
    return dr.arange(mi.UInt32, max(1, len(curves))), mi.Float(
        np.linalg.norm(b - a, axis=1).astype(np.float32) if len(curves) else np.zeros(1, np.float32)
    )


def sample_precomputed_silhouette(
    shape: Any, viewpoint: Any, sample1: Any, sample2: Any, active: Any = True
) -> Any:
    """Return a point of a segment of `precompute_silhouette`; its density is by length in space.

    Parameters
    ----------
    shape : BezierTriangle
    viewpoint : Point3f
        That of `precompute_silhouette`.
    sample1 : UInt32
        Index of the segment.
    sample2 : Float
        Uniform between 0 and 1.
    active : Bool

    Returns
    -------
    mi.SilhouetteSample3f
    """
    kinds = mi.DiscontinuityFlags
    here = np.array(dr.slice(mi.Point3f(viewpoint), 0), dtype=np.float64).reshape(3)
    curves = _curves(shape, here)
    active = mi.Bool(active) & (len(curves) > 0)
    point = curves.point(mi.UInt32(sample1), mi.Float(sample2), active)
    length = dr.norm(point.tangent)
    ss = dr.zeros(mi.SilhouetteSample3f, dr.width(point.p))
    ss.p, ss.n, ss.uv = point.p, mi.Normal3f(point.n), mi.Point2f(point.u, point.v)
    ss.d = dr.normalize(point.p - curves.eye)
    ss.silhouette_d = point.tangent / length
    ss.prim_index, ss.scene_index = point.patch, point.instance
    kind = dr.select(
        point.is_edge, mi.UInt32(kinds.PerimeterType.value), mi.UInt32(kinds.InteriorType.value)
    )
    good = point.valid & (length > 0)
    ss.discontinuity_type = dr.select(good, kind, mi.UInt32(kinds.Empty.value))
    ss.flags = kind
    ss.pdf = dr.select(good, dr.rcp(length), 0)
    ss.shape = mi.ShapePtr(shape)
    ss.offset = mi.math.ShadowEpsilon
    return ss


def primitive_silhouette_projection(
    shape: Any, viewpoint: Any, si: Any, flags: Any, sample: Any, active: Any = True
) -> Any:
    """Move a point of a patch to a silhouette of that patch seen from `viewpoint`.

    Interior: Newton's method to the contour in the parameters, which fails (``is_valid()``) where
    it leaves the patch. Perimeter: the nearest point, in the parameters, of that open edge which
    `sample` chooses.

    Parameters
    ----------
    shape : BezierTriangle
    viewpoint : Point3f
    si : mi.SurfaceInteraction3f
        ``prim_index`` and, for the parameters, ``p`` are read.
    flags : int
        One kind of `mi.DiscontinuityFlags`.
    sample : Float
    active : Bool

    Returns
    -------
    mi.SilhouetteSample3f
    """
    _need_one(shape)
    interior, _perimeter = _kinds(flags)
    lines = _lines(shape)
    active = mi.Bool(active)
    viewpoint = mi.Point3f(viewpoint)
    tables = shape._alone().tables
    patch = mi.UInt32(si.prim_index)
    u, v = _parameters(shape, si, active)
    if not interior:
        line = lines.nearest_edge(patch, u, v, viewpoint, mi.Float(sample), active)
        return _sample(shape, line, int(getattr(flags, "value", flags)))

    near = tables.relative(viewpoint, patch, active)

    def newton(k: Any, u: Any, v: Any) -> tuple[Any, ...]:
        h = tables.second(patch, u, v, active)
        f, fu, fv = facing(h, near)
        square = fu * fu + fv * fv
        step = dr.select(square > 0, f / square, 0)
        # a third of the triangle at most: further off the linear part says nothing
        length = dr.abs(step) * dr.sqrt(square)
        step *= dr.minimum(1.0, 0.3 / dr.maximum(length, 1e-6))
        return k + 1, u - step * fu, v - step * fv

    _k, u, v = dr.while_loop(
        (mi.UInt32(0), u, v), cond=lambda k, u, v: k < _NEWTON, body=newton, label="bezier contour"
    )
    h = tables.second(patch, u, v, active)
    p, n, _density = tables.point_and_normal(patch, u, v, active)
    d = dr.normalize(p - viewpoint)
    away, curvature = outward(h, d)
    line = lines.empty(patch, u, v, p, d, away, curvature)
    # 1e-4: the sine of the view to the tangent plane that float32 reaches
    flat = dr.abs(dr.dot(d, n)) < 1e-4
    line.valid = active & flat & (u >= 0) & (v >= 0) & (u + v <= 1)
    return _sample(shape, line, int(getattr(flags, "value", flags)))


def _need_whole(shape: Any) -> None:
    """Refuse trims: of a trimming curve no segment is found by a point."""
    if shape.trims is not None:
        raise BezierError.expected(
            f'shape "{shape.id()}"', "no trims where an outline is to be found by a point", "trims"
        )


def _need_one(shape: Any) -> None:
    """Refuse instances: an interaction does not tell which of them it is on; and trims."""
    _need_whole(shape)
    if shape.instances is not None:
        raise BezierError.expected(
            f'shape "{shape.id()}"', "no instances where an interaction is to tell one", "instances"
        )


def _parameters(shape: Any, si: Any, active: Any) -> tuple[Any, Any]:
    """Return the parameters of an interaction: `si.uv` unless the shape has a texture's."""
    tables = shape._alone().tables
    if tables.texcoords is None and tables.projections is None:
        return si.uv.x, si.uv.y
    # the point, looked for along its normal
    reach = 2.0**-14 * (1 + dr.max(dr.abs(si.p)))
    ray = dr.zeros(mi.Ray3f, dr.width(si.p))
    ray.o, ray.d, ray.maxt = si.p + reach * si.n, -mi.Vector3f(si.n), 2 * reach
    uv = shape._alone().preliminary(ray, active).pi.prim_uv
    return uv.x, uv.y


def differential_motion(shape: Any, si: Any, active: Any = True) -> Any:
    """Return the point of an interaction, at fixed parameters of its patch, as it moves."""
    _need_one(shape)
    u, v = _parameters(shape, si, active)
    data = shape._alone()
    tables = attached_tables(data.tables, data.shapes)
    return tables.partials(si.prim_index, u, v, mi.Bool(active))[0]


METHODS = (
    silhouette_discontinuity_types,
    silhouette_sampling_weight,
    sample_silhouette,
    invert_silhouette_sample,
    precompute_silhouette,
    sample_precomputed_silhouette,
    primitive_silhouette_projection,
    differential_motion,
)
