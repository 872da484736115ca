"""Boundaries of faces on closed surfaces, laid out in one period of the parameter plane.

On a cylinder, sphere, torus or any surface that meets itself, only edges that bound the face in
space say where the face is. In the parameter plane they may begin in one period and end in
another, wrap around, or bulge to the wrong side of the seam, and where the files have the seam
itself as an edge, its place is a matter of taste of the program that wrote it. So here the seam
is left out, all other edges are cut at the sides of one period and moved into it, and the
sides are closed anew: along them, inside and outside change at each point where an edge ends.
That leaves two answers, the face or all of the surface but the face. It is decided by a side on
which no surface is, or else by the seams of the file, which lie in the face, or else by the
direction of the edges, which have the face to their left.

The side of a parameter rectangle that is one point in space, a pole, is treated in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ...geometry.sign_changes import evaluate, sign_changes, split
from .plane_regions import standard

__all__ = ["BoundaryEdge", "ClosedAxes", "leaves_period", "unrolled"]

#: Points closer to a side, in units of its length, lie on it: CAD programs place edges no better.
_ON_SIDE = 1e-6
#: Gaps between edges that are closed, the small ones first; in the same units.
_GAPS = (1e-6, 1e-3, 1e-2, 0.05)


@dataclass
class BoundaryEdge:
    """An edge of a face as rational Bézier curves ``(S, n+1, 3)`` in (u, v), positive weights.

    The face lies to the left.
    """

    curves: np.ndarray
    seam: bool = False  #: the face has it twice, once for each side


@dataclass
class ClosedAxes:
    """Along which axes a surface is closed, from where on, and where its poles are."""

    low: np.ndarray  #: (2,), where a period begins
    period: np.ndarray  #: (2,), 0 for an axis that is not closed
    #: for each axis the values at which the surface is one point
    poles: tuple[list[float], list[float]] = field(default_factory=lambda: ([], []))


def _points(curves: np.ndarray) -> np.ndarray:
    """Return points along curves ``(S, n+1, 3)``, and their ends."""
    t = np.linspace(0, 1, 9)
    h = np.concatenate([evaluate(curve, t) for curve in curves])
    return h[:, :2] / h[:, 2:]


def leaves_period(edges: Sequence[BoundaryEdge], axes: ClosedAxes) -> bool:
    """Tell whether a boundary has a seam, or is wider than a period."""
    if not axes.period.any():
        return False
    if any(edge.seam for edge in edges):
        return True
    flat = np.concatenate([_points(edge.curves) for edge in edges])
    extent = np.ptp(flat, axis=0)
    return bool(((axes.period > 0) & (extent > axes.period * (1 + _ON_SIDE))).any())


@dataclass
class _Frame:
    """The rectangle into which a boundary is moved, and what its sides are."""

    low: np.ndarray
    size: np.ndarray
    closed: tuple[bool, bool]
    #: for each axis, whether there is surface at the side of 0 and of 1
    surface: list[list[bool]]

    def local(self, curves: np.ndarray) -> list[np.ndarray]:
        out = []
        for curve in curves:
            c = standard(curve)
            c[:, :2] = (c[:, :2] - self.low * c[:, 2:]) / self.size
            out.append(c)
        return out

    def world(self, curve: np.ndarray) -> np.ndarray:
        out = curve.copy()
        out[:, :2] = out[:, :2] * self.size + self.low * out[:, 2:]
        return out


def _frame(edges: Sequence[BoundaryEdge], axes: ClosedAxes) -> _Frame:
    flat = np.concatenate([_points(edge.curves) for edge in edges])
    low, high = flat.min(axis=0), flat.max(axis=0)
    sides = []
    for axis in range(2):
        if axes.period[axis] > 0:
            low[axis], high[axis] = axes.low[axis], axes.low[axis] + axes.period[axis]
            sides.append([True, True])
            continue
        extent = high[axis] - low[axis]
        near = _ON_SIDE * extent
        below = [p for p in axes.poles[axis] if p <= low[axis] + near]
        above = [p for p in axes.poles[axis] if p >= high[axis] - near]
        pad = extent / 8 or 1.0  # no matter how much: there is nothing
        low[axis] = max(below) if below else low[axis] - pad
        high[axis] = min(above) if above else high[axis] + pad
        sides.append([bool(below), bool(above)])
    closed = bool(axes.period[0] > 0), bool(axes.period[1] > 0)
    return _Frame(low, high - low, closed, sides)


# ---------------------------------------------------------------------------- gaps


def _joined(chains: list[list[np.ndarray]], frame: _Frame) -> list[list[np.ndarray]] | None:
    """Close the gaps between the ends of chains, where they are not at a pole."""
    chains = [[c.copy() for c in chain] for chain in chains]
    loose = [(k, end) for k in range(len(chains)) for end in (0, -1)]
    period = np.array(frame.closed, dtype=float)

    def place(item: tuple[int, int]) -> np.ndarray:
        k, end = item
        return chains[k][end][end, :2]

    def at_pole(item: tuple[int, int], gap: float) -> bool:
        x = place(item)
        for axis in range(2):
            if frame.closed[axis]:
                continue
            for side in (0, 1):
                if frame.surface[axis][side] and abs(x[axis] - side) <= gap:
                    chains[item[0]][item[1]][item[1], axis] = side
                    return True
        return False

    for gap in _GAPS:
        at = np.array([place(item) for item in loose]).reshape(-1, 2)
        way = at[:, None] - at[None]
        turns = np.round(way) * period
        length = np.abs(way - turns).max(axis=2)
        np.fill_diagonal(length, np.inf)
        left = np.ones(len(loose), dtype=bool)
        while left.sum() > 1:
            i, j = np.unravel_index(int(np.argmin(length)), length.shape)
            if length[i, j] > gap:
                break
            a, b, turn = loose[i], loose[j], turns[i, j]
            if length[i, j] <= _GAPS[0]:
                middle = (at[i] + at[j] + turn) / 2
                chains[a[0]][a[1]][a[1], :2] = middle
                chains[b[0]][b[1]][b[1], :2] = middle - turn
            else:
                ends = np.stack([at[i], at[j] + turn])
                chains.append([np.column_stack([ends, np.ones(2)])])
            left[[i, j]] = False
            length[[i, j]] = np.inf
            length[:, [i, j]] = np.inf
        loose = [item for item, free in zip(loose, left) if free]
        loose = [item for item in loose if not at_pole(item, gap)]
    return None if loose else chains


# ---------------------------------------------------------------------------- folding


def _folded(chain: list[np.ndarray], axis: int) -> list[list[np.ndarray]]:
    """Cut a chain at whole numbers along an axis, and move all parts to [0, 1]."""
    out: list[list[np.ndarray]] = []
    last: int | None = None
    for curve in chain:
        for piece in _cut_at_whole(curve, axis):
            x = piece[:, axis] / piece[:, 2]
            if np.abs(x - np.round(x[0])).max() <= _ON_SIDE:
                last = None  # along a side: put back where it is needed
                continue
            middle = evaluate(piece, np.array([0.25, 0.5, 0.75]))
            turn = int(np.floor((middle[:, axis] / middle[:, 2]).mean()))
            piece = piece.copy()
            piece[:, axis] -= turn * piece[:, 2]
            for end in (0, -1):
                for side in (0.0, 1.0):
                    if abs(piece[end, axis] / piece[end, 2] - side) <= _ON_SIDE:
                        piece[end, axis] = side * piece[end, 2]
            if last != turn:
                out.append([])
            out[-1].append(piece)
            last = turn
    return out


def _cut_at_whole(curve: np.ndarray, axis: int) -> list[np.ndarray]:
    x = curve[:, axis] / curve[:, 2]  # the curve lies between
    places: list[float] = []
    for value in range(int(np.floor(x.min())), int(np.ceil(x.max())) + 1):
        h = curve[:, axis] - value * curve[:, 2]
        places += sign_changes(h[None])[1].tolist()
    out, rest, low = [], curve, 0.0
    for t in sorted(places):
        if not 1e-9 < (t - low) / (1 - low) < 1 - 1e-9:
            continue  # a cut at an end cuts off nothing
        left, rest = split(rest, (t - low) / (1 - low))
        value = np.round(left[-1, axis] / left[-1, 2])
        left[-1, axis], rest[0, axis] = value * left[-1, 2], value * rest[0, 2]
        out.append(standard(left))
        low = t
    return [*out, standard(rest)]


def _off_poles(chain: list[np.ndarray], axis: int, frame: _Frame) -> list[list[np.ndarray]]:
    """Leave out what lies along a pole."""
    out: list[list[np.ndarray]] = [[]]
    for curve in chain:
        x = curve[:, axis] / curve[:, 2]
        for side in (0.0, 1.0):
            if not frame.surface[axis][int(side)]:
                continue
            if np.abs(x - side).max() <= _ON_SIDE:
                out.append([])
                break
            for end in (0, -1):
                if abs(x[end] - side) <= _ON_SIDE:
                    curve[end, axis] = side * curve[end, 2]
        else:
            out[-1].append(curve)
    return [part for part in out if part]


# ---------------------------------------------------------------------------- sides


def _around(points: np.ndarray) -> np.ndarray:
    """Return where points on the sides of the unit square are, counterclockwise from (0, 0)."""
    x, y = points.T
    return np.select([y == 0, x == 1, y == 1, x == 0], [x, 1 + y, 3 - x, (4 - y) % 4], np.nan)


def _corner_at(s: float) -> np.ndarray:
    s %= 4.0
    side, along = int(s), s - int(s)
    x, y = ((along, 0.0), (1.0, along), (1 - along, 1.0), (0.0, 1 - along))[side]
    return np.array([x, y])


def _segments(spans: list[tuple[float, float]]) -> list[np.ndarray]:
    """Return straight curves along the sides."""
    out = []
    for start, stop in spans:
        corners = [k for k in range(9) if start < k < stop]
        stops = [start, *map(float, corners), stop]
        for a, b in pairwise(stops):
            # 1e-9: ends of two edges that meet on the side
            if b - a > 1e-9:
                out.append(np.column_stack([[_corner_at(a), _corner_at(b)], np.ones(2)]))
    return out


def _inside(curves: list[np.ndarray], points: np.ndarray) -> np.ndarray:
    """Tell which points are inside by the even-odd rule."""
    odd = np.zeros(len(points), dtype=bool)
    for curve in curves:
        index, t = sign_changes(curve[:, 1] - points[:, 1:] * curve[:, 2])
        h = evaluate(curve, t)
        beyond = h[:, 0] > points[index, 0] * h[:, 2]
        odd ^= np.bincount(index[beyond], minlength=len(points)) % 2 == 1
    return odd


def _beside(curves: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points to the left and to the right of curves, and the lengths they stand for."""
    left, right, length = [], [], []
    for curve in curves:
        # no simple fractions: the ray from such a point should meet no other end of a curve
        h = evaluate(curve, np.array([0.2137, 0.4871, 0.7613]))
        ahead = evaluate(curve, np.array([0.2138, 0.4872, 0.7614]))
        x, way = h[:, :2] / h[:, 2:], ahead[:, :2] / ahead[:, 2:] - h[:, :2] / h[:, 2:]
        norm = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
        # twenty times what is on a side
        off = 20 * _ON_SIDE * np.stack([-way[:, 1], way[:, 0]], axis=1) / norm
        left.append(x + off)
        right.append(x - off)
        ends = curve[[0, -1], :2] / curve[[0, -1], 2:]
        # the middle too: a loop may be one curve
        parts = np.linalg.norm(np.diff([ends[0], *x, ends[1]], axis=0), axis=1).sum()
        length.append(np.full(3, parts / 3))
    return np.concatenate(left), np.concatenate(right), np.concatenate(length)


def _evidence(
    closed: list[np.ndarray], seams: list[np.ndarray], edges: list[np.ndarray], frame: _Frame
) -> float:
    """Return a positive number if `closed` is the face, a negative one if it is the rest."""

    def inside(points: np.ndarray) -> np.ndarray:
        turned = np.array(frame.closed)
        return _inside(closed, np.where(turned, points - np.floor(points), points))

    if seams:
        left, right, length = _beside(seams)
        found = float(length @ (inside(left) * 1.0 + inside(right) - 1.0))
        if found:
            return found
    if edges:
        left, right, length = _beside(edges)
        return float(length @ (inside(left) * 1.0 - inside(right)))
    return 0.0


def unrolled(edges: Sequence[BoundaryEdge], axes: ClosedAxes) -> list[np.ndarray] | str:
    """Return the boundary of a face on a closed surface within one period.

    Parameters
    ----------
    edges : sequence of BoundaryEdge
        In any order, periods mixed.
    axes : ClosedAxes

    Returns
    -------
    list of (S, n+1, 3) arrays, or str
        Closed loops for the even-odd rule, as chains of curves; the reason if there are none.
    """
    seams = [edge for edge in edges if edge.seam]
    for axis in range(2):  # the period of the file, if its seam is a parameter line
        values = [_points(edge.curves)[:, axis] for edge in seams]
        lines = [x[0] for x in values if np.ptp(x) <= _ON_SIDE * axes.period[axis]]
        if lines:
            low = axes.low.copy()
            turns = (min(lines) - low[axis]) / axes.period[axis]
            low[axis] += (turns - np.floor(turns + _ON_SIDE)) * axes.period[axis]
            axes = ClosedAxes(low, axes.period, axes.poles)
    frame = _frame(edges, axes)
    chains = [frame.local(edge.curves) for edge in edges if not edge.seam]
    known_pole = any(s for axis in range(2) if not frame.closed[axis] for s in frame.surface[axis])
    if known_pole:
        kept = []
        for chain in chains:
            parts = [chain]
            for axis in range(2):
                if not frame.closed[axis]:
                    parts = [p for part in parts for p in _off_poles(part, axis, frame)]
            kept += parts
        chains = kept
    joined = _joined(chains, frame)
    if joined is None:
        return "its boundary is not closed"
    for axis in range(2):
        if frame.closed[axis]:
            joined = [part for chain in joined for part in _folded(chain, axis)]
    curves = [c for chain in joined for c in chain]
    ends = np.array([c[e, :2] / c[e, 2] for c in curves for e in (0, -1)]).reshape(-1, 2)
    around = np.sort(_around(ends))
    around = around[np.isfinite(around)]
    if len(around) % 2:
        return "its boundary is not closed"
    if len(around):
        spans = list(zip(around[::2].tolist(), around[1::2].tolist()))
        rest = [*around[1:].tolist(), float(around[0]) + 4]
        others = list(zip(rest[::2], rest[1::2]))
    else:
        spans, others = [], [(0.0, 4.0)]
    # the middles of sides beyond which no surface is: nothing may be closed there
    empty = [
        (3.5, 1.5)[side] if axis == 0 else (0.5, 2.5)[side]
        for axis in range(2)
        for side in (0, 1)
        if not frame.surface[axis][side]
    ]
    if empty:

        def reaches(spans: list[tuple[float, float]]) -> bool:
            return any(a < s < b or a < s + 4 < b for s in empty for a, b in spans)

        spans = others if reaches(spans) else spans
        if reaches(spans):
            return "its boundary is not closed"
    else:
        closed = curves + _segments(spans)
        crossing = [c for edge in seams for c in frame.local(edge.curves)]
        if _evidence(closed, crossing, curves, frame) < 0 or not closed:
            spans = others
    chained = [np.stack([frame.world(c) for c in chain]) for chain in joined]
    chained += [frame.world(c)[None] for c in _segments(spans)]
    return chained or "nothing is left inside of its trims"
