"""Find the trimming curves on which a surface ends, as segments on its patches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .contours import edge_segments, open_edges
from .sign_changes import evaluate
from .triangles import BezierTriangles
from .trims import Trims

__all__ = ["TrimSegments", "trim_points", "trim_segments"]

#: Into how many segments a curve is cut.
_PARTS = 32
#: A curve this near to an edge of its patch runs along it, in barycentrics.
_ALONG = 1e-6
#: How far to both sides of a curve the surface is looked for, in parameters of the patch.
_ASIDE = 1e-5
#: Distance, relative to the extent of a surface, within which two borders are one.
_TOGETHER = 2e-5


@dataclass
class TrimSegments:
    """Pieces of trimming curves on patches, on one side of which there is surface."""

    patch: np.ndarray  #: (N,) int
    curve: np.ndarray  #: (N,) int, number among the curves of all regions
    t: np.ndarray  #: (N, 2), from where to where on the curve
    a: np.ndarray  #: (N, 2), the ends in parameters of the patch
    b: np.ndarray
    side: np.ndarray  #: (N,), 1 if the surface is to the left of the curve in the patch, or -1
    weight: np.ndarray  #: (N,), 1; 1/2 where another one is the same curve, 0 where an edge is

    def __len__(self) -> int:
        return len(self.patch)


def trim_points(trims: Trims) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the control points of all trimming curves, ends that curves share once.

    Returns
    -------
    points : (N, 3) array
        Homogeneous, ``(w s, w t, w)``; ends have weight 1 by a change of parameter.
    index : list of int arrays
        For each curve of each region the rows of its points.
    """
    rows: list[np.ndarray] = []
    index = []
    for region in trims.regions:
        ends: dict[tuple[float, ...], int] = {}
        for curve in region:
            n = len(curve) - 1
            if curve[0, 2] != 1 or curve[-1, 2] != 1:
                ratio = (curve[0, 2] / curve[-1, 2]) ** (np.arange(n + 1) / n)
                curve = curve * ratio[:, None] / curve[0, 2]
                curve[[0, -1], :2] = curve[[0, -1], :2] / curve[[0, -1], 2:]
                curve[[0, -1], 2] = 1.0
            mine = []
            for k, point in enumerate(curve):
                key = tuple((point + 0.0).tolist())
                if k in (0, n) and key in ends:
                    mine.append(ends[key])
                    continue
                if k in (0, n):
                    ends[key] = len(rows)
                mine.append(len(rows))
                rows.append(point)
            index.append(np.array(mine))
    return np.array(rows).reshape(-1, 3), index


def _on_patch(trims: Trims, patch: np.ndarray, st: np.ndarray) -> np.ndarray:
    """Return the parameters of patches at which the surface's own are `st`."""
    x = (st - trims.place[patch, 0]) / trims.place[patch, 1]
    arc = trims.arc[patch]
    safe = np.where(arc > 0, arc, 1.0)
    turned = 0.5 + np.tan((x - 0.5) * safe / 2) / (2 * np.tan(safe / 4))
    x = np.where(arc > 0, turned, x) - trims.square[patch, :, 2]
    return np.linalg.solve(trims.square[patch, :, :2], x[..., None])[..., 0]


def _curve_points(curves: list[np.ndarray], curve: np.ndarray, t: np.ndarray) -> np.ndarray:
    out = np.zeros((len(curve), 2))
    for k in np.unique(curve):
        mine = curve == k
        h = evaluate(curves[k], t[mine])
        out[mine] = h[:, :2] / h[:, 2:]
    return out


def _least(uv: np.ndarray) -> np.ndarray:
    return np.minimum(np.minimum(uv[:, 0], uv[:, 1]), 1 - uv.sum(axis=1))


@dataclass
class _Pieces:
    """Pieces of all trimming curves with surface on one side: what does not depend on the nets."""

    patch: np.ndarray
    curve: np.ndarray
    t: np.ndarray  #: (N, 2)
    a: np.ndarray  #: (N, 2), start, middle and end
    middle: np.ndarray
    b: np.ndarray
    left: np.ndarray  #: (N, 2), across the chord
    side: np.ndarray


def trim_segments(patches: BezierTriangles, trims: Trims) -> TrimSegments:
    """Return the pieces of trimming curves that are borders of the surface.

    A curve that runs along an edge of a patch is left to that edge, if it is an open one. What
    the trims alone decide is kept with them, since nets change where trims stay.
    """
    pieces: _Pieces = trims.made_once("pieces", lambda: _pieces(trims))
    middle, side = pieces.middle, pieces.side
    # along an edge: that of the patch on whose side the surface is, if the edge is not open
    bary = np.stack([1 - middle.sum(axis=1), middle[:, 0], middle[:, 1]], axis=1)
    edge = np.abs(bary).argmin(axis=1)
    along = np.abs(bary[np.arange(len(bary)), edge]) < _ALONG
    inwards = ((1 / 3 - middle) * pieces.left).sum(axis=1) * side > 0
    is_open = np.isin(3 * pieces.patch + edge, open_edges(patches))
    good = ~along | (inwards & ~is_open)
    found = TrimSegments(
        pieces.patch[good], pieces.curve[good], pieces.t[good], pieces.a[good], pieces.b[good],
        side[good], np.ones(int(good.sum())),
    )  # fmt: skip
    arcs = _arcs(patches, found.patch, found.a, middle[good], found.b)
    # a patch that ends there has an edge, which counts
    edges = edge_segments(patches)
    middle = (edges.a + edges.b) / 2
    there = trims.made_once(
        "edges",
        lambda: trims.inside(edges.patch, middle + _ASIDE * (1 / 3 - middle)),
        (edges.patch.tobytes(), middle.tobytes()),
    )
    of_edges = _arcs(patches, *(x[there] for x in (edges.patch, edges.a, middle, edges.b)))
    found.weight[_run_along(arcs, arcs, same=True)] = 0.5
    found.weight[_run_along(arcs, of_edges)] = 0.0
    return found


def _pieces(trims: Trims) -> _Pieces:
    """Cut trimming curves where they leave their patches, and see on which side surface is."""
    curves = [c for region in trims.regions for c in region]
    firsts = np.cumsum([0] + [len(region) for region in trims.regions])
    pairs = [
        (p, k)
        for p in np.flatnonzero(trims.region >= 0).tolist()
        for k in range(firsts[trims.region[p]], firsts[trims.region[p] + 1])
    ]
    pair = np.repeat(np.array(pairs, dtype=int).reshape(-1, 2), _PARTS, axis=0)
    patch, curve = pair[:, 0], pair[:, 1]
    steps = np.linspace(0, 1, _PARTS + 1)
    t = np.tile(np.stack([steps[:-1], steps[1:]], axis=1), (len(pairs), 1))

    def place(rows: Any, t: np.ndarray) -> np.ndarray:
        return _on_patch(trims, patch[rows], _curve_points(curves, curve[rows], t))

    def is_in(rows: Any, t: np.ndarray) -> np.ndarray:
        return _least(place(rows, t)) > -_ALONG

    # cut where a curve leaves its patch
    every = slice(None)
    start, stop = is_in(every, t[:, 0]), is_in(every, t[:, 1])
    cut = np.flatnonzero(start != stop)
    low, high = t[cut].T
    for _ in range(40):
        middle = (low + high) / 2
        same = is_in(cut, middle) == start[cut]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    t[cut, 0] = np.where(start[cut], t[cut, 0], high)
    t[cut, 1] = np.where(start[cut], low, t[cut, 1])
    good = start | stop
    patch, curve, t = patch[good], curve[good], t[good]
    a, b, middle = (place(every, x) for x in (t[:, 0], t[:, 1], t.mean(axis=1)))
    chord = b - a
    left = np.stack([-chord[:, 1], chord[:, 0]], axis=1)
    length = np.linalg.norm(left, axis=1, keepdims=True)
    left /= np.where(length > 0, length, 1.0)
    sides = [trims.inside(patch, middle + _ASIDE * s * left) for s in (1, -1)]
    side = np.where(sides[0], 1.0, -1.0)
    # shorter ones touch the patch from outside
    good = (sides[0] != sides[1]) & (length[:, 0] > 10 * _ALONG)
    rows = patch, curve, t, a, middle, b, left, side
    return _Pieces(*(x[good] for x in rows))


def _arcs(patches: BezierTriangles, patch: np.ndarray, *places: np.ndarray) -> np.ndarray:
    """Return three points of arcs, ``(3, N, 3)``: start, middle, end."""
    return np.stack([patches.points(patch, x) for x in places])


def _run_along(arcs: np.ndarray, others: np.ndarray, same: bool = False) -> np.ndarray:
    """Return which arcs run where another one does, as in a seam."""
    a, middle, b = others
    out = np.zeros(arcs.shape[1], dtype=bool)
    if not arcs.size or not others.size:
        return out
    extent = np.ptp(arcs.reshape(-1, 3), axis=0).max() or 1.0
    reach = np.linalg.norm(b - a, axis=1)
    order = np.argsort(middle[:, 0])
    x, longest = middle[order, 0], float(reach.max())
    for i, point in enumerate(arcs[1]):
        first, last = np.searchsorted(x, [point[0] - longest, point[0] + longest])
        k = order[first:last]
        k = k[(np.linalg.norm(middle[k] - point, axis=1) < 0.75 * reach[k]) & ~(same & (k == i))]
        if not len(k):
            continue
        # the parabola through the three points, at the foot on its chord
        chord = b[k] - a[k]
        square = (chord**2).sum(axis=1, keepdims=True)
        s = ((point - a[k]) * chord).sum(axis=1, keepdims=True) / square
        gap = a[k] + 4 * s * (1 - s) * (middle[k] - (a[k] + b[k]) / 2) - point
        gap -= (gap * chord).sum(axis=1, keepdims=True) / square * chord
        off = np.linalg.norm(gap, axis=1)
        within = (s[:, 0] > -0.01) & (s[:, 0] < 1.01)
        # a thousandth of an arc: what a parabola is off
        out[i] = bool((within & (off < _TOGETHER * extent + 1e-3 * reach[k])).any())
    return out
