"""Lines that touch Bézier shapes: the space in which indirect silhouettes are sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.arrays import upload
from .silhouette import Discrete, SilhouetteCurves, in_place, outward
from .wide_vectors import single

__all__ = ["BoundaryLines", "BoundarySample"]

_NONE = 0xFFFFFFFF
#: Segments of an edge, as `contours.edge_segments` cuts it.
_PARTS = 16


@dataclass
class BoundarySample:
    """A line that touches a shape."""

    # Dr.Jit selects between records only if they have defaults
    patch: Any = None  #: UInt, number among the patches of the structure
    u: Any = None
    v: Any = None
    p: Any = None  #: Point3f
    d: Any = None  #: Vector3f, unit, along the line
    n: Any = None  #: Vector3f, unit, across the line, away from the surface
    along: Any = None  #: Vector3f, unit, along an edge
    density: Any = None  #: Float, the curvature in direction d, or the sine between d and edge
    pdf: Any = None  #: Float, by area and angle, or by length and solid angle
    index: Any = None  #: UInt, segment of an edge
    is_edge: Any = None  #: Bool
    valid: Any = None  #: Bool
    instance: Any = None  #: UInt, 1 + the number of the instance; 0: the patch is where it is
    cut: Any = None  #: see `SilhouettePoint`
    s: Any = None

    DRJIT_STRUCT = dict.fromkeys(
        ("patch", "u", "v", "p", "d", "n", "along", "density", "pdf", "index", "is_edge", "valid",
         "instance", "cut", "s"),
        Any,
    )  # fmt: skip


class BoundaryLines:
    """Sampling of the lines that touch some shapes of a structure.

    Parameters
    ----------
    data : SceneData
    numbers : list of int
        Which of its shapes; each is as probable for points inside of patches.
    """

    def __init__(self, data: Any, numbers: list[int]) -> None:
        self.data = data
        self.numbers = numbers
        self.edges = SilhouetteCurves(data, numbers, None)
        copies = [data.instance_numbers(k) for k in numbers]
        table = np.array([(c.start, len(c)) for c in copies], dtype=np.uint32)
        self.copies = upload(mi.UInt32, table) if data.instances is not None else None
        a, b = self.edges.ends()
        self.choice = Discrete(np.linalg.norm(b - a, axis=1)) if len(self.edges) else None

    def empty(self, patch: Any, u: Any, v: Any, p: Any, d: Any, n: Any, density: Any) -> Any:
        """Return a sample of a contour, not valid yet."""
        width = dr.width(p)
        return BoundarySample(
            patch, u, v, p, d, n, dr.zeros(mi.Vector3f, width), density,
            dr.zeros(mi.Float, width), dr.zeros(mi.UInt32, width),
            dr.zeros(mi.Bool, width), dr.zeros(mi.Bool, width), dr.zeros(mi.UInt32, width),
            dr.zeros(mi.UInt32, width), dr.zeros(mi.Float, width),
        )  # fmt: skip

    def sample(
        self, sample: Any, active: Any, interior: bool = True, perimeter: bool = True
    ) -> BoundarySample:
        """Map the unit cube to lines.

        Parameters
        ----------
        sample : Point3f
            The first is used for the kind, and the shape and angle or the point of an edge.
        active : Bool
        interior, perimeter : bool
            Which kinds; with both, and if there are edges, each has one half.
        """
        perimeter = perimeter and self.choice is not None
        if not perimeter:
            return self._tangent(sample, active & interior)
        if not interior:
            return self._edge(sample, active)
        is_edge = sample.x < 0.5
        x = dr.select(is_edge, 2 * sample.x, 2 * sample.x - 1)
        sample = mi.Point3f(dr.minimum(x, dr.one_minus_epsilon(mi.Float)), sample.y, sample.z)
        edge = self._edge(sample, active & is_edge)
        out = dr.select(is_edge, edge, self._tangent(sample, active & ~is_edge))
        out.pdf = 0.5 * out.pdf
        return out

    def _tangent(self, sample: Any, active: Any) -> BoundarySample:
        sampling = self._sampling()
        tables = self.data.tables
        scaled = sample.x * len(self.numbers)
        which = dr.minimum(mi.UInt32(scaled), len(self.numbers) - 1)
        first, count = self._copies(which, active)
        scaled = (scaled - mi.Float(which)) * mi.Float(count)
        copy = dr.minimum(mi.UInt32(scaled), count - 1)
        angle = dr.two_pi * (scaled - mi.Float(copy))
        copy += first
        patch, u, v, linear = sampling.sample_parameters(
            which, mi.Point2f(sample.y, sample.z), active
        )
        place = tables.place(copy, active)
        jet = tables.jet(patch, u, v, active, place)
        frame = mi.Frame3f(tables.normal(jet, patch, u, v, active, place))
        sine, cosine = dr.sincos(angle)
        d = frame.s * cosine + frame.t * sine
        n, curvature = outward(in_place(tables.second(patch, u, v, active), place), d)
        out = self.empty(patch, u, v, mi.Point3f(single(jet.point)), d, n, curvature)
        area = jet.area()
        pdf = dr.select(active & (area > 0), linear / area, 0.0) / mi.Float(count)
        out.pdf = pdf * dr.inv_two_pi / len(self.numbers)
        out.valid = active & (pdf > 0) & dr.isfinite(curvature) & (curvature > 0)
        out.instance = copy
        return out

    def _sampling(self) -> Any:
        return self.data.surface_sampling(tuple(self.numbers), instanced=True)

    def _copies(self, which: Any, active: Any) -> tuple[Any, Any]:
        """Return 1 + the first instance of shapes, or 0, and how many there are, or 1."""
        if self.copies is None:
            return mi.UInt32(0), mi.UInt32(1)
        first, count = (dr.gather(mi.UInt32, self.copies, 2 * which + k, active) for k in (0, 1))
        return first, dr.maximum(count, 1)

    def _edge(self, sample: Any, active: Any) -> BoundarySample:
        assert self.choice is not None
        d = mi.warp.square_to_uniform_sphere(mi.Point2f(sample.y, sample.z))
        index, s, pmf = self.choice.sample(sample.x, active)
        return self._edge_line(index, s, pmf, d, active)

    def _edge_line(self, index: Any, s: Any, pmf: Any, d: Any, active: Any) -> BoundarySample:
        point = self.edges.point(index, s, active)
        length = dr.norm(point.tangent)
        along = point.tangent / length
        n = self.edges.edge_normal(d, point)
        sine = dr.norm(dr.cross(d, along)) * point.weight
        out = self.empty(point.patch, point.u, point.v, point.p, d, n, sine)
        out.along, out.index, out.instance = along, index, point.instance
        out.cut, out.s = point.cut, point.s
        out.pdf = pmf / length / (4 * dr.pi)
        out.is_edge = dr.full(mi.Bool, True, dr.width(s))
        out.valid = active & point.valid & (length > 0) & (sine > 0)
        return out

    def nearest_edge(
        self, patch: Any, u: Any, v: Any, viewpoint: Any, sample: Any, active: Any
    ) -> BoundarySample:
        """Return the point of an open edge of a patch that is nearest in the parameters."""
        if self.choice is None:
            zero = mi.Point3f(0)
            width = dr.width(u)
            return self.empty(
                patch, u, v, dr.zeros(mi.Point3f, width), zero, zero, dr.zeros(mi.Float, width)
            )
        table = self._first_segments()
        first = [dr.gather(mi.UInt32, table, 3 * patch + e, active) for e in range(3)]
        count = sum(dr.select(f != _NONE, mi.UInt32(1), 0) for f in first)
        wanted = dr.minimum(mi.UInt32(sample * mi.Float(count)), count - 1)
        chosen, seen = mi.UInt32(_NONE), mi.UInt32(0)
        for f in first:
            here = (f != _NONE) & (seen == wanted)
            chosen = dr.select(here, f, chosen)
            seen += dr.select(f != _NONE, mi.UInt32(1), 0)
        valid = active & (chosen != _NONE)
        chosen = dr.select(valid, chosen, 0)
        # the edge as a whole: from the start of its first segment to the end of its last
        rows = self.edges.rows
        a = mi.Point2f(*(dr.gather(mi.Float, rows, 4 * chosen + k, valid) for k in (0, 1)))
        last = chosen + _PARTS - 1
        b = mi.Point2f(*(dr.gather(mi.Float, rows, 4 * last + k, valid) for k in (2, 3)))
        chord = b - a
        t = dr.dot(mi.Point2f(u, v) - a, chord) / dr.squared_norm(chord)
        t = dr.clip(t, 0, dr.one_minus_epsilon(mi.Float)) * _PARTS
        part = dr.minimum(mi.UInt32(t), _PARTS - 1)
        point = self.edges.point(chosen + part, t - mi.Float(part), valid)
        d = dr.normalize(point.p - viewpoint)
        return self._edge_line(chosen + part, t - mi.Float(part), mi.Float(0), d, valid)

    def _first_segments(self) -> Any:
        """Return for each edge of each patch the number of its first segment, or none."""
        segments = self.edges.segments
        table = np.full(3 * sum(len(s.patches) for s in self.data.shapes), _NONE, dtype=np.uint32)
        for k in range(0, len(segments), _PARTS):
            x, y = segments.a[k]
            # an edge begins at A, B or C
            edge = 0 if x == 1 else (1 if y == 1 else 2)
            table[3 * segments.patch[k] + edge] = k
        return upload(mi.UInt32, table)

    def invert(self, ss: Any, is_edge: Any, both: Any, active: Any) -> Any:
        """Return a point of the unit cube that `sample` maps to a `mi.SilhouetteSample3f`."""
        sampling = self._sampling()
        tables = self.data.tables
        yz = sampling.invert(mi.UInt32(0), ss.prim_index, ss.uv, active & ~is_edge)
        place = tables.place(ss.scene_index, active)
        jet = tables.jet(ss.prim_index, ss.uv.x, ss.uv.y, active, place)
        n = tables.normal(jet, ss.prim_index, ss.uv.x, ss.uv.y, active, place)
        local = mi.Frame3f(n).to_local(ss.d)
        angle = dr.atan2(local.y, local.x) * dr.inv_two_pi
        x = dr.select(angle < 0, angle + 1, angle)
        first, count = self._copies(mi.UInt32(0), active)
        x = (x + mi.Float(ss.scene_index - first)) / mi.Float(count)
        if self.choice is not None:
            edge = active & is_edge
            index = ss.projection_index
            rows = [dr.gather(mi.Float, self.edges.rows, 4 * index + k, edge) for k in range(4)]
            a, chord = (
                mi.Point2f(rows[0], rows[1]),
                mi.Point2f(rows[2] - rows[0], rows[3] - rows[1]),
            )
            s = dr.dot(ss.uv - a, chord) / dr.squared_norm(chord)
            lower = dr.gather(mi.Float, self.choice.cdf, index - 1, edge & (index > 0))
            along = lower + s * dr.gather(mi.Float, self.choice.pmf, index, edge)
            x = dr.select(is_edge, along, x)
            yz = dr.select(is_edge, mi.warp.uniform_sphere_to_square(ss.d), yz)
            x = dr.select(both, 0.5 * x + dr.select(is_edge, 0.0, 0.5), x)
        return mi.Point3f(x, yz.x, yz.y)
