"""Trimmed patches: the part of a patch's parameter triangle that belongs to the surface.

A *region* is a part of the plane of a surface's own parameters ``(s, t)``, given by its boundary:
closed loops of rational Bézier curves, inside by the even-odd rule. Many patches of a surface
can refer to one region. A patch's barycentrics ``(u, v)`` are taken to ``(s, t)`` in three steps,
each of them exact:

1. affine: ``x = M (u, v, 1)``, which puts the triangle into the unit square of the tensor-product
   patch that it is a part of;
2. where a parameter is the angle of a circle of opening ``arc`` (CAD systems have such cylinders,
   cones, spheres, tori), the rational arc is not run through at constant speed:
   ``x <- 1/2 + (2/arc) atan(tan(arc/4) (2 x - 1))``;
3. affine: ``(s, t) = origin + size x``.

Nothing of this touches the surface: `transform` and `elevate` of the patches leave the trims as
they are.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from ..errors import GeometryError
from .sign_changes import evaluate, sign_changes

__all__ = ["Trims", "closed_region", "square_map"]


def square_map(second: bool = False, turned: bool = False) -> np.ndarray:
    """Return ``M`` ``(2, 3)`` of a triangle of a tensor-product patch.

    Parameters
    ----------
    second : bool
        Whether it is the second of the two triangles of `tensor_to_triangles`.
    turned : bool
        Whether the corners B and C of the triangle have been exchanged.
    """
    out = np.array([[1.0, 0, 0], [0, 1, 0]])
    if turned:  # the old v is the new w
        out = out @ [[1, 0, 0], [-1, -1, 1], [0, 0, 1]]
    if second:
        out = -out
        out[:, 2] += 1
    return out


def closed_region(curves: Sequence[Any], tolerance: float) -> list[np.ndarray]:
    """Return boundary curves whose ends meet to the last bit.

    End weights become 1, by a change of parameter that moves no point, and ends that are close to
    each other are moved to one of them.

    Parameters
    ----------
    curves : sequence of (n+1, 3) array_like
        Homogeneous Bézier curves of positive weights, in any order.
    tolerance : float
        Largest gap between ends.
    """
    out = []
    places: list[np.ndarray] = []
    for curve in curves:
        curve = np.array(curve, dtype=np.float64)
        n = len(curve) - 1
        curve *= (curve[0, 2] / curve[-1, 2]) ** (np.arange(n + 1) / n)[:, None] / curve[0, 2]
        for end in (0, -1):
            place = curve[end, :2] / curve[end, 2]
            gaps = [np.abs(place - other).max() for other in places]
            if gaps and min(gaps) <= tolerance:
                place = places[int(np.argmin(gaps))]
            else:
                places.append(place)
            curve[end] = [*place, 1.0]
        out.append(curve)
    return out


class Trims:
    """The trims of `P` patches.

    Parameters
    ----------
    regions : sequence of sequences of (n+1, 3) array_like
        For each region its boundary curves ``(w s, w t, w)`` in any order, of positive weights.
    region : (P,) int array_like
        The region of each patch; -1: the whole patch is there.
    square : (P, 2, 3) array_like
        The maps M; see `square_map`.
    place : (P, 2, 2) array_like
        ``[[s0, t0], [size_s, size_t]]``.
    arc : (P, 2) array_like, optional
        Openings of arcs along the two directions, in radians, below pi; 0: none.

    Raises
    ------
    GeometryError
        If a shape is wrong, a number is not finite, a weight is not positive, or a boundary is
        not closed: each point where curves end must be, to the last bit, the end of an even
        number of them, else a ray through the gap would tear a strip out of the surface.
    """

    def __init__(
        self, regions: Sequence[Any], region: Any, square: Any, place: Any, arc: Any = None
    ) -> None:
        self.region = np.asarray(region, dtype=np.int64)
        count = len(self.region)
        arc = np.zeros((count, 2)) if arc is None else arc
        self.square = _numbers("square", square, (count, 2, 3))
        self.place = _numbers("place", place, (count, 2, 2))
        self.arc = _numbers("arc", arc, (count, 2))
        if self.region.ndim != 1 or count == 0:
            raise GeometryError.expected("region", "one number a patch", self.region.shape)
        if self.region.min() < -1 or self.region.max() >= len(regions):
            raise GeometryError.expected(
                "region", f"numbers from -1 to {len(regions) - 1}", np.unique(self.region).tolist()
            )
        if ((self.arc < 0) | (self.arc >= np.pi)).any():
            raise GeometryError.expected("arc", "openings from 0 to below pi", self.arc.max())
        if not (self.place[:, 1] > 0).all():
            raise GeometryError.expected("place", "positive sizes", self.place[:, 1].min())
        self.regions = [_checked_region(k, curves) for k, curves in enumerate(regions)]

    def __len__(self) -> int:
        return len(self.region)

    def __getitem__(self, index: Any) -> Trims:
        """Return the trims of the patches chosen by a slice, mask or index array."""
        out = object.__new__(Trims)
        out.regions = self.regions
        for name in ("region", "square", "place", "arc"):
            setattr(out, name, getattr(self, name)[index])
        return out

    def __eq__(self, other: object) -> bool:
        """Return whether all patches have the same trims, however their regions are numbered."""
        if not isinstance(other, Trims) or len(self) != len(other):
            return False
        names = ("square", "place", "arc")
        if not all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names):
            return False
        pairs = np.unique(np.stack([self.region, other.region], axis=1), axis=0).tolist()
        return all(
            a == b == -1 or (min(a, b) >= 0 and _same_curves(self.regions[a], other.regions[b]))
            for a, b in pairs
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        curves = sum(map(len, self.regions))
        trimmed = int((self.region >= 0).sum())
        return f"Trims({trimmed} of {len(self)} patches, {curves} curves)"

    @staticmethod
    def none(count: int) -> Trims:
        """Return the trims of `count` whole patches."""
        square = np.broadcast_to(square_map(), (count, 2, 3))
        place = np.broadcast_to([[0.0, 0], [1, 1]], (count, 2, 2))
        return Trims([], np.full(count, -1), square, place)

    @staticmethod
    def join(parts: Sequence[Trims]) -> Trims:
        """Return the trims of all patches, in order."""
        first = np.cumsum([0] + [len(p.regions) for p in parts])
        out = object.__new__(Trims)
        out.regions = [r for p in parts for r in p.regions]
        out.region = np.concatenate(
            [np.where(p.region >= 0, p.region + k, -1) for p, k in zip(parts, first)]
        )
        for name in ("square", "place", "arc"):
            setattr(out, name, np.concatenate([getattr(p, name) for p in parts]))
        return out

    def made_once(self, name: str, make: Callable[[], Any], key: Hashable = None) -> Any:
        """Return what was made of these trims and a key, made now if the last key was another.

        Nothing of the trims may be changed after that.
        """
        kept: dict[str, tuple[Hashable, Any]] = self.__dict__.setdefault("_made", {})
        if name not in kept or kept[name][0] != key:
            kept[name] = key, make()
        return kept[name][1]

    def unit(self, patch: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Return the coordinates in the unit square, after the arcs, ``(N, 2)``."""
        x = np.einsum("nij,nj->ni", self.square[patch, :, :2], uv) + self.square[patch, :, 2]
        arc = self.arc[patch]
        safe = np.where(arc > 0, arc, 1.0)
        return np.where(arc > 0, 0.5 + 2 / safe * np.arctan(np.tan(safe / 4) * (2 * x - 1)), x)

    def parameters(self, patch: Any, uv: Any) -> np.ndarray:
        """Return the parameters ``(s, t)`` of the surface, ``(N, 2)``."""
        uv = np.atleast_2d(np.asarray(uv, dtype=np.float64))
        patch = np.broadcast_to(np.asarray(patch), uv.shape[:1])
        return self.place[patch, 0] + self.place[patch, 1] * self.unit(patch, uv)

    def inside(self, patch: Any, uv: Any) -> np.ndarray:
        """Return a mask of the points on the surface: the slow, sure answer.

        A ray in the plane of parameters from ``(s, t)`` towards larger s crosses a curve where
        its second coordinate takes the value t; these parameters are isolated in Bernstein form.
        Parameters ``(u, v)`` need not lie in the triangle.

        Parameters
        ----------
        patch : int or (N,) int array
        uv : (N, 2) array

        Returns
        -------
        (N,) bool array
        """
        st = self.parameters(patch, uv)
        patch = np.broadcast_to(np.asarray(patch), st.shape[:1])
        region = self.region[patch]
        out = region < 0
        for number in np.unique(region[region >= 0]):
            mine = np.flatnonzero(region == number)
            out[mine] = _odd(self.regions[number], st[mine])
        return out


def _same_curves(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b))


def _odd(curves: list[np.ndarray], st: np.ndarray) -> np.ndarray:
    odd = np.zeros(len(st), dtype=bool)
    for curve in curves:
        index, t = sign_changes(curve[:, 1] - st[:, 1:] * curve[:, 2])
        h = evaluate(curve, t)
        beyond = h[:, 0] > st[index, 0] * h[:, 2]
        odd ^= np.bincount(index[beyond], minlength=len(st)) % 2 == 1
    return odd


def _numbers(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    out = np.array(value, dtype=np.float64)
    if out.shape != shape or not np.isfinite(out).all():
        raise GeometryError.expected(name, f"finite numbers of shape {shape}", f"{out.shape}")
    return out


def _checked_region(number: int, curves: Any) -> list[np.ndarray]:
    out = []
    name = f"region {number}"
    ends: dict[tuple[float, ...], int] = {}
    for curve in curves:
        curve = np.array(curve, dtype=np.float64)
        if curve.ndim != 2 or curve.shape[1] != 3 or len(curve) < 2:
            raise GeometryError.expected(name, "curves of shape (n+1, 3)", f"{curve.shape}")
        if not np.isfinite(curve).all() or not (curve[:, 2] > 0).all():
            raise GeometryError.expected(name, "finite control points of positive weight", "others")
        out.append(curve)
        for end in (curve[0], curve[-1]):
            point = tuple((end[:2] / end[2] + 0.0).tolist())
            ends[point] = ends.get(point, 0) + 1
    open_ends = [point for point, count in ends.items() if count % 2]
    if open_ends:
        raise GeometryError.expected(
            name, "closed loops", f"{len(open_ends)} loose ends, one at {open_ends[0]}"
        )
    return out
