"""Points on silhouettes of Bézier shapes: contours, open edges and creases."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError
from ..geometry.contours import POINTS, Segments, contour_segments, edge_segments
from ..geometry.trim_outlines import TrimSegments, trim_segments
from ..kernels.arrays import upload
from ..kernels.curvature import affine_second_partials
from ..kernels.trim import keep
from .interaction import placed
from .trim_curves import TrimCurves

__all__ = ["Discrete", "SilhouetteCurves", "SilhouettePoint", "facing", "in_place", "outward"]

#: Newton steps to the contour: from a chord over a cell three give float32.
_STEPS = 4
#: Share of the way from an edge to the centroid at which it is seen whether there is surface:
#: some times the slack of trims.
_INWARDS = 1e-5


@dataclass
class SilhouettePoint:
    """A point of a silhouette."""

    patch: Any  #: UInt, number among the patches of the structure
    u: Any
    v: Any
    p: Any  #: Point3f
    tangent: Any  #: Vector3f, by the parameter of the segment
    n: Any  #: Vector3f, unit, across the curve and the direction of view, away from the surface
    is_edge: Any  #: Bool
    valid: Any  #: Bool
    instance: Any  #: UInt, 1 + the number of the instance; 0: the patch is where it is
    inside: Any  #: Vector3f, from an edge into the surface
    weight: Any  #: Float, 1/2 where two borders are the same curve
    cut: Any  #: UInt, 1 + the row of the trimming curve, 0 elsewhere
    s: Any  #: Float, the parameter of the segment


class Discrete:
    """A discrete distribution whose kernels do not depend on its size up to a power of two."""

    def __init__(self, weights: np.ndarray) -> None:
        total = weights.sum()
        self.total = float(total)
        size = 1 << max(0, int(np.ceil(np.log2(max(len(weights), 1)))))
        probability = np.zeros(size)
        if total > 0:
            probability[: len(weights)] = weights / total
        cdf = np.minimum(np.cumsum(probability), 1.0)
        self.bits = size.bit_length() - 1
        self.cdf = upload(mi.Float, cdf)
        self.pmf = upload(mi.Float, probability)

    def sample(self, x: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return index, a number uniform again, and the probability of the index."""
        index = mi.UInt32(0)
        for bit in reversed(range(self.bits)):
            middle = index + ((1 << bit) - 1)
            index = dr.select(dr.gather(mi.Float, self.cdf, middle, active) <= x, middle + 1, index)
        lower = dr.gather(mi.Float, self.cdf, index - 1, active & (index > 0))
        pmf = dr.gather(mi.Float, self.pmf, index, active)
        again = dr.clip((x - lower) / pmf, 0.0, dr.one_minus_epsilon(mi.Float))
        return index, dr.select(pmf > 0, again, 0.0), pmf


def outward(h: list[list[Any]], d: Any) -> tuple[Any, Any]:
    """Return the normal towards the background of a silhouette, and the normal curvature.

    Along a tangent the surface bends to one side of its tangent plane; the background is seen
    on the other.

    Parameters
    ----------
    h : list
        Point and partials, as `kernels.curvature.evaluate_second` returns them.
    d : Vector3f
        Unit direction in the tangent plane.

    Returns
    -------
    n : Vector3f
        Unit normal.
    curvature : Float
        The size of the normal curvature in the direction `d`.
    """
    _p, pu, pv, puu, puv, pvv = (mi.Vector3f(*x) for x in affine_second_partials(h))
    n = dr.cross(pu, pv)
    n *= dr.rsqrt(dr.squared_norm(n))
    e, f, g = dr.dot(pu, pu), dr.dot(pu, pv), dr.dot(pv, pv)
    inverse = dr.rcp(e * g - f * f)
    x, y = dr.dot(d, pu), dr.dot(d, pv)
    a, b = (g * x - f * y) * inverse, (e * y - f * x) * inverse
    bend = puu * (a * a) + puv * (2 * a * b) + pvv * (b * b)
    curvature = dr.dot(bend, n)
    return dr.select(curvature > 0, -n, n), dr.abs(curvature)


class SilhouetteCurves:
    """The curves on which some shapes of a structure hide or show what is behind them.

    Parameters
    ----------
    data : SceneData
    numbers : list of int
        Which of its shapes.
    eye : (3,) array or None
        The point of view; without one there are only edges.

    Raises
    ------
    BezierError
        If a shape is an asphere: their outlines are not known here.
    """

    def __init__(self, data: Any, numbers: list[int], eye: np.ndarray | None) -> None:
        self.data = data
        self.view = eye
        self.eye = None if eye is None else mi.Point3f(*(dr.opaque(mi.Float, x) for x in eye))
        firsts = np.cumsum([0] + [len(s.patches) for s in data.shapes])
        parts, copies, cut_of = [], [], []
        trim_curves = TrimCurves()
        for number in numbers:
            shape = data.shapes[number]
            if shape.asphere is not None:
                raise BezierError.expected(
                    f'shape "{shape.id()}"', "no asphere where silhouettes are asked for", "one"
                )
            edges, found_cuts = data.made_once(f"borders {number}", partial(_borders, shape))
            cuts = trim_curves.add(shape, firsts[number], found_cuts)
            edges = replace(edges, patch=edges.patch + firsts[number])
            maps = data.instance_numbers(number)
            for copy in maps:
                found = [edges]
                if eye is not None:
                    # the lattices of many instances are coarser, each of which is small
                    effort = POINTS / np.sqrt(len(maps))
                    found.append(contour_segments(shape.patches, self._local(copy), effort))
                    found[1].patch = found[1].patch + firsts[number]
                parts += found
                cut_of += [np.full(sum(map(len, found)), -1), cuts.rows]
                parts.append(Segments(cuts.patch, cuts.a, cuts.b, np.ones(len(cuts.rows), bool)))
                copies += [np.full(sum(map(len, found)) + len(cuts.rows), copy)]
        #: Trimming curves, or None; the row there of each segment, 1 + it, or 0.
        self.trims = trim_curves.uploaded(data)
        self.cuts = upload(mi.UInt32, (np.concatenate([*cut_of, [-1]]) + 1).astype(np.uint32))
        self.segments = Segments.join(parts)
        #: 1 + the number of the instance of each segment, or 0.
        self.copy_of = np.concatenate(copies)
        self.shape_of = np.searchsorted(firsts, self.segments.patch, side="right") - 1
        self.firsts = firsts
        rows = np.concatenate([self.segments.a, self.segments.b], axis=1)
        self.rows = upload(mi.Float, rows if len(rows) else np.zeros((1, 4)))
        whose = self.segments.patch if len(rows) else np.zeros(1)
        flag = self.segments.is_edge if len(rows) else np.zeros(1)
        self.patch = upload(mi.UInt32, whose.astype(np.uint32))
        self.edge = upload(mi.UInt32, flag.astype(np.uint32))
        self.copies: Any = None
        if data.instances is not None:
            copy_of = self.copy_of if len(rows) else np.zeros(1)
            self.copies = upload(mi.UInt32, copy_of.astype(np.uint32))
            if eye is not None:
                eyes = [self._local(copy) for copy in range(len(data.instances.maps) + 1)]
                self.eyes = upload(mi.Float, np.array(eyes))

    def _local(self, copy: int) -> np.ndarray:
        """Return the point of view as an instance has it."""
        assert self.view is not None
        if copy == 0:
            return self.view
        matrix = self.data.instances.maps[copy - 1]
        return np.linalg.solve(matrix[:3, :3], self.view - matrix[:3, 3])

    def __len__(self) -> int:
        return len(self.segments)

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of the segments in space, ``(N, 3)`` each."""
        out = np.zeros((2, len(self), 3))
        for number in np.unique(self.shape_of):
            mine = self.shape_of == number
            patch = self.segments.patch[mine] - self.firsts[number]
            patches = self.data.shapes[number].patches
            out[0, mine] = patches.points(patch, self.segments.a[mine])
            out[1, mine] = patches.points(patch, self.segments.b[mine])
        placed = self.copy_of > 0
        if placed.any():
            maps = self.data.instances.maps[self.copy_of[placed] - 1]
            turned = np.einsum("nij,knj->kni", maps[:, :3, :3], out[:, placed])
            out[:, placed] = turned + maps[:, :3, 3]
        return out[0], out[1]

    def point(self, index: Any, s: Any, active: Any) -> SilhouettePoint:
        """Return the point at parameter `s`, from 0 to 1, of a segment."""
        tables = self.data.tables
        row = [dr.gather(mi.Float, self.rows, 4 * index + k, active) for k in range(4)]
        patch = dr.gather(mi.UInt32, self.patch, index, active)
        is_edge = dr.gather(mi.UInt32, self.edge, index, active) == 1
        copy, place = self._place(index, active)
        a, chord = mi.Point2f(row[0], row[1]), mi.Vector2f(row[2] - row[0], row[3] - row[1])
        across = mi.Vector2f(-chord.y, chord.x)
        foot = a + s * chord
        if self.eye is None:
            h = tables.second(patch, foot.x, foot.y, active)
            eye, q, dq = mi.Point3f(0.0), foot, chord
        else:
            eye = local = self.eye
            if self.copies is not None:
                local = mi.Point3f(
                    *(dr.gather(mi.Float, self.eyes, 3 * copy + k, active) for k in range(3))
                )
            near = tables.relative(local, patch, active)

            def newton(k: Any, height: Any) -> tuple[Any, ...]:
                q = foot + height * across
                h = tables.second(patch, q.x, q.y, active)
                f, fu, fv = facing(h, near)
                slope = fu * across.x + fv * across.y
                step = dr.select(is_edge | (slope == 0), 0.0, f / slope)
                return k + 1, dr.clip(height - step, -1.0, 1.0)

            _k, height = dr.while_loop(
                (mi.UInt32(0), dr.zeros(mi.Float, dr.width(s))),
                cond=lambda k, height: k < _STEPS,
                body=newton,
                label="bezier silhouette",
            )
            q = foot + height * across
            h = tables.second(patch, q.x, q.y, active)
            _f, fu, fv = facing(h, near)
            along = fu * chord.x + fv * chord.y
            slope = fu * across.x + fv * across.y
            dq = chord - dr.select(is_edge | (slope == 0), 0.0, along / slope) * across
        weight, cut, inwards = mi.Float(1.0), mi.UInt32(0), mi.Vector2f(1 / 3 - q.x, 1 / 3 - q.y)
        if self.trims is not None:
            cut = dr.gather(mi.UInt32, self.cuts, index, active)
            on_cut = active & (cut > 0)
            curve = self.trims.point(cut - 1, s, on_cut)
            q = dr.select(on_cut, curve.uv, q)
            dq = dr.select(on_cut, curve.tangent, dq)
            inwards = dr.select(on_cut, curve.side * mi.Vector2f(-dq.y, dq.x), inwards)
            weight = dr.select(on_cut, curve.weight, 1.0)
            h = tables.second(patch, q.x, q.y, active)
        p, pu, pv = tables.partials(patch, q.x, q.y, active, place)
        tangent = pu * dq.x + pv * dq.y
        d = dr.normalize(p - eye)
        n, _curvature = outward(in_place(h, place), d)
        inside = pu * inwards.x + pv * inwards.y
        n = dr.select(is_edge, _edge_normal(d, tangent, inside), n)
        if self.trims is not None:  # what is trimmed away has no outline, nor its edges
            at = q + dr.select(is_edge & (cut == 0), _INWARDS, 0.0) * inwards
            active = active & ((cut > 0) | mi.Bool(keep(self.data.trim, patch, at.x, at.y, active)))
        valid = active & dr.isfinite(dr.squared_norm(n)) & dr.isfinite(dr.squared_norm(tangent))
        return SilhouettePoint(
            patch, q.x, q.y, p, tangent, n, is_edge, valid, copy, inside, weight, cut, s
        )

    def _place(self, index: Any, active: Any) -> tuple[Any, Any]:
        """Return the numbers of the instances of segments, and where these are."""
        if self.copies is None:
            return dr.zeros(mi.UInt32, dr.width(index)), None
        copy = dr.gather(mi.UInt32, self.copies, index, active)
        return copy, self.data.tables.place(copy, active)

    def edge_normal(self, d: Any, point: SilhouettePoint) -> Any:
        """Return the unit normal of an edge and the direction `d`, away from the patch."""
        return _edge_normal(d, point.tangent, point.inside)

    def moving(self, tables: Any, point: Any, active: Any) -> Any:
        """Return points as they move with nets, instances and trimming curves.

        Parameters
        ----------
        tables : PatchTables
            With derivatives.
        point : SilhouettePoint
        active : Bool
        """
        place = tables.place(point.instance, active)
        p, pu, pv = tables.partials(point.patch, point.u, point.v, active, place)
        if self.trims is None or not self.trims.moves():
            return p
        on_cut = active & (point.cut > 0)
        uv = self.trims.point(point.cut - 1, point.s, on_cut, self.trims.attached()).uv
        du, dv = (dr.replace_grad(mi.Float(0), dr.select(on_cut, x, 0.0)) for x in (uv.x, uv.y))
        return p + dr.detach(pu) * du + dr.detach(pv) * dv


def _borders(shape: Any) -> tuple[Segments, TrimSegments | None]:
    """Return the edges of a shape and the pieces of its trimming curves, from wherever seen."""
    trims = shape.trims
    cuts = trim_segments(shape.patches, trims) if trims is not None and trims.regions else None
    return edge_segments(shape.patches), cuts


def in_place(h: list[list[Any]], place: Any) -> list[list[Any]]:
    """Return points and partials of `kernels.curvature.evaluate_second` under maps of instances."""
    return h if place is None else placed(h, mi.Matrix3f(place[0]))


def _edge_normal(d: Any, tangent: Any, inside: Any) -> Any:
    n = dr.normalize(dr.cross(d, tangent))
    return dr.select(dr.dot(n, inside) > 0, -n, n)


def facing(h: list[list[Any]], eye: Any) -> tuple[Any, Any, Any]:
    """Return ``det(X, X_u, X_v, eye)`` and its partials by the parameters.

    `eye` is relative to the origin of the patch, as `h` is.
    """
    y, yu, yv, yuu, yuv, yvv = (mi.Vector3f(*x[:3]) - x[3] * eye for x in h)
    return (
        dr.dot(y, dr.cross(yu, yv)),
        dr.dot(y, dr.cross(yuu, yv) + dr.cross(yu, yuv)),
        dr.dot(y, dr.cross(yuv, yv) + dr.cross(yu, yvv)),
    )
