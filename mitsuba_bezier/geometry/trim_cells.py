"""Tables for trimming in kernels: cells of the parameter triangle, and monotone pieces.

Boundary curves are cut where a coordinate turns. A piece that rises in t and rises (``sigma = 1``)
or falls (``sigma = -1``) in s is, in the coordinates

    f = t + sigma s,    g = t - sigma s,

the graph of a function ``g(f)`` with a slope between -1 and 1. So a bisection in f finds the
place beside a point without any care for horizontal or vertical tangents, and may stop as soon
as the point's g is further off than what is left of f.

A *cell* is a part of a patch's parameters, the whole patch or one leaf, with the pieces that
come near it. Pieces to its left cross no ray towards larger s; of those to its right only the
heights matter at which the number of crossings changes. A leaf without pieces is inside or
outside as a whole. Where pieces are many, as on a face with holes that is one leaf, a cell is cut
into a grid, and each of its squares has a list of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .sign_changes import bernstein_product, sign_changes, split
from .trims import Trims

__all__ = [
    "CELL",
    "HEAD",
    "LIST",
    "SLACK",
    "TrimCells",
    "UntrimmedParts",
    "monotone_pieces",
    "trim_cells",
]

#: A point this near to a trimming curve belongs to the surface, in parameters of its patch's unit
#: square: neighbours that share the curve overlap by that, so nothing leaks between them. Ten
#: roundings of float32.
SLACK = 1e-6
#: Numbers in a cell: M 6, tan(arc/4) and 2/arc for s and t, first list, squares along a side of
#: its grid, least s, squares over length of s, and the same of t.
CELL = 16
#: Numbers in a list: first piece, number of pieces, 1 if an odd number of curves passes to the
#: right of all pieces at the foot of its square.
LIST = 4
#: So many pieces are looked through one by one; of more there is a grid, of twice as many squares.
_FEW, _SIDE = 2, 24
#: Numbers of a piece before its coefficients: t0, t1, least and largest s, sigma, f and g at both
#: ends.
HEAD = 9
#: Hits lie outside of their leaf by up to 3e-3 of it at grazing angles, and by roundings.
_MARGIN = (4e-3, 1e-5)
#: Pieces are cut this far outside of the unit square: float32 is to see numbers near one.
_REACH = 1.0
#: A height above, or a place to the right of everything.
_FAR = 1e30


@dataclass
class TrimCells:
    """Tables for `kernels.trim`; the cells 0 .. P-1 are the whole patches."""

    cells: np.ndarray  #: (C, CELL)
    lists: np.ndarray  #: (K, LIST); the first one has no piece, and everything is inside
    pieces: np.ndarray  #: (N, HEAD + 3 (degree + 1)): head, then f, g, w of each coefficient
    degree: int
    arcs: bool  #: whether any cell has one


def _elevated(curve: np.ndarray, degree: int) -> np.ndarray:
    while len(curve) - 1 < degree:
        m = len(curve)
        t = (np.arange(m + 1) / m)[:, None]
        padded = np.concatenate([curve[:1], curve, curve[-1:]])
        curve = t * padded[:-1] + (1 - t) * padded[1:]
    return curve


def _turns(curves: Sequence[np.ndarray]) -> list[list[float]]:
    """Return for each curve ``(n+1, 3)`` where a coordinate turns round."""
    out: list[list[float]] = [[] for _ in curves]
    lengths = np.array([len(c) for c in curves])
    # all of one degree together: the halvings of one polynomial cost as much as those of hundreds
    for length in np.unique(lengths):
        which = np.flatnonzero(lengths == length)
        turning = []
        for k in which:
            curve = curves[int(k)]
            slope = (len(curve) - 1) * np.diff(curve, axis=0)
            for axis in range(2):
                h = bernstein_product(slope[:, axis], curve[:, 2])
                turning.append(h - bernstein_product(slope[:, 2], curve[:, axis]))
        for k, t in zip(*sign_changes(np.array(turning))):
            out[which[k // 2]].append(float(t))
    # 1e-12: a turn at an end cuts off nothing
    return [sorted({t for t in turns if 1e-12 < t < 1 - 1e-12}) for turns in out]


Piece = tuple[np.ndarray, np.ndarray]  # coefficients (n+1, 3), end points (2, 2)


def _cut(piece: Piece, places: list[float]) -> list[Piece]:
    """Cut a piece; neighbours share their end point to the last bit."""
    rest, (start, stop) = piece
    out, low = [], 0.0
    for t in places:
        left, rest = split(rest, (t - low) / (1 - low))
        middle = left[-1, :2] / left[-1, 2]
        out.append((left, np.array([start, middle])))
        start, low = middle, t
    return [*out, (rest, np.array([start, stop]))]


def monotone_pieces(curves: Sequence[np.ndarray]) -> list[Piece]:
    """Cut curves ``(n+1, 3)`` into pieces along which both coordinates are monotone.

    Returns
    -------
    list of ((n+1, 3) array, (2, 2) array)
        Coefficients and end points; t does not fall along a piece.
    """
    out = []
    for curve, turns in zip(curves, _turns(curves)):
        ends = curve[[0, -1], :2] / curve[[0, -1], 2:]
        for coefficients, points in _cut((curve, ends), turns):
            if points[0, 1] > points[1, 1]:
                coefficients, points = coefficients[::-1], points[::-1]
            if (points[0] != points[1]).any():
                out.append((coefficients, points))
    return out


def _clipped(coefficients: np.ndarray, ends: np.ndarray) -> list[Piece]:
    """Cut pieces ``(Q, n+1, 3)`` where they leave the unit square by more than `_REACH`."""
    places: list[set[float]] = [set() for _ in coefficients]
    for axis in range(2):
        low, high = ends[:, :, axis].min(axis=1), ends[:, :, axis].max(axis=1)
        for at in (-_REACH, 1 + _REACH):
            which = np.flatnonzero((low < at) & (at < high))
            h = coefficients[which, :, axis] - at * coefficients[which, :, 2]
            for k, t in zip(*sign_changes(h)) if len(which) else ():
                places[which[k]].add(float(t))
    out: list[Piece] = []
    for piece, found in zip(zip(coefficients, ends), places):
        inner = sorted(t for t in found if 1e-12 < t < 1 - 1e-12)
        out += _cut(piece, inner) if inner else [piece]
    return out


@dataclass
class _Pieces:
    """Pieces in the unit square of one patch, as arrays."""

    coefficients: np.ndarray  # (Q, n+1, 3)
    ends: np.ndarray  # (Q, 2, 2)

    @property
    def t(self) -> np.ndarray:
        return self.ends[:, :, 1]

    @property
    def low(self) -> np.ndarray:
        return self.ends[:, :, 0].min(axis=1)

    @property
    def high(self) -> np.ndarray:
        return self.ends[:, :, 0].max(axis=1)

    def select(self, mask: np.ndarray) -> _Pieces:
        return _Pieces(self.coefficients[mask], self.ends[mask])

    def around(self, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tell how pieces lie to boxes ``(L, 2, 2)`` of lower and upper corners.

        Returns
        -------
        near, inner : (L, Q) bool arrays
            Which come near a box, and which end or begin on its right, between its heights.
        base : (L,) int array
            1 if an odd number passes to the right of the foot of the box, of those not near.
        """
        (s0, t0), (s1, t1) = boxes[:, 0].T[..., None], boxes[:, 1].T[..., None]
        level = (self.t[:, 1] >= t0) & (self.t[:, 0] <= t1)
        right = level & (self.low > s1)
        near = level & ~right & (self.high >= s0)
        base = (right & (self.t[:, 0] <= t0) & (self.t[:, 1] > t0)).sum(axis=1) % 2
        return near, right & ((self.t[:, 0] > t0) | (self.t[:, 1] <= t1)), base

    def steps(self, boxes: np.ndarray, inner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return boxes, and the heights in them at which an odd number of pieces begin or end.

        `inner` is that of `around`: other pieces do not count.
        """
        of, k = np.nonzero(inner)
        heights, of = self.t[k].ravel(), np.repeat(of, 2)
        within = (heights > boxes[of, 0, 1]) & (heights <= boxes[of, 1, 1])
        return _changes(of[within], heights[within])

    def rows(self) -> np.ndarray:
        """Return the pieces as rows of the table."""
        (s0, t0), (s1, t1) = self.ends[:, 0].T, self.ends[:, 1].T
        sigma = np.where(s1 >= s0, 1.0, -1.0)
        s, t, w = np.moveaxis(self.coefficients, -1, 0)
        turned = np.stack([t + sigma[:, None] * s, t - sigma[:, None] * s, w], axis=-1)
        head = [t0, t1, self.low, self.high, sigma]
        head += [t0 + sigma * s0, t0 - sigma * s0, t1 + sigma * s1, t1 - sigma * s1]
        rest = turned.reshape(len(s), 3 * s.shape[1])
        return np.concatenate([np.stack(head, axis=1), rest], axis=1)


def _placed(region: _Pieces, place: np.ndarray) -> _Pieces:
    """Move the pieces of a region into the unit square of a patch; those far off are left out."""
    ends = (region.ends - place[0]) / place[1]
    pad = _MARGIN[1] + SLACK
    near = (ends[:, 1, 1] > -pad) & (ends[:, 0, 1] < 1 + pad) & (ends[..., 0].max(axis=1) > -pad)
    coefficients = region.coefficients[near].copy()
    coefficients[..., :2] -= coefficients[..., 2:] * place[0]
    coefficients[..., :2] /= place[1]
    ends = ends[near]
    wide = (np.abs(ends - 0.5) > 0.5 + _REACH).any(axis=(1, 2))
    if not wide.any():
        return _Pieces(coefficients, ends)
    cut = _clipped(coefficients[wide], ends[wide])
    return _Pieces(
        np.concatenate([coefficients[~wide], [c for c, _e in cut]]),
        np.concatenate([ends[~wide], [e for _c, e in cut]]),
    )


def _changes(owner: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights that an owner has an odd number of times, with their owners, in order."""
    order = np.lexsort((heights, owner))
    owner, heights = owner[order], heights[order]
    new = np.ones(len(owner), dtype=bool)
    new[1:] = (owner[1:] != owner[:-1]) | (heights[1:] != heights[:-1])
    starts = np.flatnonzero(new)
    odd = starts[np.diff(np.append(starts, len(owner))) % 2 == 1]
    return owner[odd], heights[odd]


class _Builder:
    def __init__(self, trims: Trims) -> None:
        used = np.unique(trims.region[trims.region >= 0])
        curves = [c for k in used for c in trims.regions[k]]
        self.degree = max((len(c) - 1 for c in curves), default=1)
        self.regions: dict[int, _Pieces] = {}
        for k in used.tolist():
            pieces = monotone_pieces(trims.regions[k])
            self.regions[k] = _Pieces(
                np.array([_elevated(c, self.degree) for c, _e in pieces]).reshape(
                    -1, self.degree + 1, 3
                ),
                np.array([e for _c, e in pieces]).reshape(-1, 2, 2),
            )
        self.trims = trims
        self.rows: list[np.ndarray] = []
        self.row_count = 0
        self.lists: list[np.ndarray] = [np.array([[0.0, 0.0, 1.0, 0.0]])]
        self.list_count = 1

    def add(self, pieces: _Pieces, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Enter the pieces near boxes ``(L, 2, 2)`` of lower and upper corners.

        Returns
        -------
        grids : (L, 6) array
            The last part of a cell, with the number of its first list.
        kind : (L,) int array
            -1 if nothing of a box is left, 1 if all of it is, 0 if points have to be looked at.
        """
        near, _inner, _base = pieces.around(boxes)
        number = near.sum(axis=1)
        side = (
            np.where(number > _FEW, np.ceil(1.5 * np.sqrt(number)), 1).astype(int).clip(max=_SIDE)
        )
        low, size = boxes[:, 0], boxes[:, 1] - boxes[:, 0]
        owner = np.repeat(np.arange(len(boxes)), side**2)
        ends = np.cumsum(side**2)
        place = np.arange(len(owner)) - (ends - side**2)[owner]
        step = size[owner] / side[owner, None]
        corner = low[owner] + step * np.stack([place % side[owner], place // side[owner]], axis=1)
        # a hit may be taken for one of the square beside its own, by rounding
        pad = np.where(side[owner] > 1, _MARGIN[1], 0.0)[:, None]
        squares = np.stack([corner - pad, corner + step + pad], axis=1)
        first = self.list_count
        # some million of comparisons at once, so that little memory is needed
        count = max(1, 4_000_000 // max(1, len(pieces.ends)))
        parts = range(0, len(squares), count)
        lists = [self._lists(pieces, squares[k : k + count]) for k in parts]
        last = np.concatenate([np.zeros((0, LIST)), *lists])[ends - 1]
        grids = np.zeros((len(boxes), 6))
        grids[:, 0], grids[:, 1] = first + ends - side**2, side
        grids[:, 2::2], grids[:, 3::2] = low, side[:, None] / size
        plain = (side == 1) & (last[:, 1] == 0)
        return grids, np.where(plain, np.where(last[:, 2] == 1, 1, -1), 0)

    def _lists(self, pieces: _Pieces, boxes: np.ndarray) -> np.ndarray:
        near, inner, base = pieces.around(boxes)
        owner, row = np.nonzero(near)
        steps_owner, steps = pieces.steps(boxes, inner)
        extra = np.zeros((len(steps), HEAD + 3 * (self.degree + 1)))
        extra[:, 0], extra[:, 1:4], extra[:, 4] = steps, _FAR, 1.0
        owner = np.concatenate([owner, steps_owner])
        row = np.concatenate([row, len(pieces.ends) + np.arange(len(steps))])
        order = np.argsort(owner, kind="stable")
        lists = np.zeros((len(boxes), LIST))
        lists[:, 1] = np.bincount(owner, minlength=len(boxes))
        lists[:, 0] = self.row_count + np.cumsum(lists[:, 1]) - lists[:, 1]
        lists[:, 2] = base
        self.lists.append(lists)
        self.list_count += len(lists)
        self.rows.append(np.concatenate([pieces.rows(), extra])[row[order]])
        self.row_count += len(order)
        return lists

    def head(self, patch: int) -> np.ndarray:
        """Return the part of a cell that says how ``(u, v)`` are mapped."""
        out = np.zeros(CELL)
        out[:6] = self.trims.square[patch].ravel()
        for axis, arc in enumerate(self.trims.arc[patch]):
            if arc > 0:
                out[6 + 2 * axis : 8 + 2 * axis] = np.tan(arc / 4), 2 / arc
        return out


def _boxes(trims: Trims, patch: int, corners: np.ndarray) -> np.ndarray:
    """Return boxes ``(L, 2, 2)`` around parts of a patch, in its unit square, with a margin."""
    places = trims.unit(np.full(3 * len(corners), patch), corners.reshape(-1, 2))
    places = places.reshape(-1, 3, 2)
    low, high = places.min(axis=1), places.max(axis=1)
    pad = (high - low).max(axis=1, keepdims=True) * _MARGIN[0] + _MARGIN[1] + SLACK
    return np.stack([low - pad, high + pad], axis=1)


class UntrimmedParts:
    """Tells which parts of patches are not trimmed away as a whole.

    Parameters
    ----------
    trims : Trims
    """

    def __init__(self, trims: Trims) -> None:
        self._builder = _Builder(trims)
        self._placed: dict[int, _Pieces] = {}

    def __call__(self, patch: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Return a mask of parts of which something may be left; none is missing.

        Parameters
        ----------
        patch : (L,) int array
        corners : (L, 3, 2) array
            Parameters of the corners of the parts.
        """
        trims = self._builder.trims
        out = np.ones(len(patch), dtype=bool)
        for p in np.unique(patch[trims.region[patch] >= 0]).tolist():
            if p not in self._placed:
                region = self._builder.regions[int(trims.region[p])]
                self._placed[p] = _placed(region, trims.place[p])
            mine = np.flatnonzero(patch == p)
            pieces, boxes = self._placed[p], _boxes(trims, p, corners[mine])
            near, inner, base = pieces.around(boxes)
            left = near.any(axis=1) | (base == 1)
            # beside a place where one piece ends and another begins nothing changes
            left[pieces.steps(boxes, inner)[0]] = True
            out[mine] = left
        return out


def trim_cells(
    trims: Trims, patch: np.ndarray | None = None, corners: np.ndarray | None = None
) -> tuple[TrimCells, np.ndarray, np.ndarray]:
    """Make the cells of patches and of their leaves.

    Parameters
    ----------
    trims : Trims
    patch : (L,) int array, optional
        The patches of some leaves.
    corners : (L, 3, 2) array, optional
        Parameters of the corners of the leaves.

    Returns
    -------
    cells : TrimCells
    cell : (L,) int array
        The cell of each leaf; -1 for leaves that need no test.
    keep : (L,) bool array
        False for leaves that are trimmed away as a whole.
    """
    patch = np.zeros(0, dtype=int) if patch is None else np.asarray(patch)
    corners = np.zeros((0, 3, 2)) if corners is None else corners
    count = len(trims)
    builder = _Builder(trims)
    cells = np.zeros((count, CELL))
    cells[:, 11] = 1.0  # whole patches: the first list
    more: list[np.ndarray] = []
    cell, keep = np.full(len(patch), -1), np.ones(len(patch), dtype=bool)
    order = np.argsort(patch, kind="stable")
    bounds = np.searchsorted(patch[order], np.arange(count + 1))
    pad = _MARGIN[0] + _MARGIN[1] + SLACK
    unit_square = np.array([[[-pad, -pad], [1 + pad, 1 + pad]]])
    used = count
    for p in np.flatnonzero(trims.region >= 0).tolist():
        pieces = _placed(builder.regions[int(trims.region[p])], trims.place[p])
        head = builder.head(p)
        mine = order[bounds[p] : bounds[p + 1]]
        boxes = _boxes(trims, p, corners[mine])
        whole = (boxes[:, 0] <= 0).all(axis=1) & (boxes[:, 1] >= 1).all(axis=1)
        parts = np.flatnonzero(~whole)
        grids, kind = builder.add(pieces, np.concatenate([unit_square, boxes[parts]]))
        cells[p] = head
        cells[p, 10:] = grids[0]
        # a leaf that is all of its patch has the cell of this
        cell[mine[whole]] = p if kind[0] == 0 else -1
        keep[mine[whole]] = kind[0] >= 0
        test = kind[1:] == 0
        keep[mine[parts]] = kind[1:] >= 0
        cell[mine[parts[test]]] = used + np.arange(test.sum())
        used += int(test.sum())
        rows = np.tile(head, (int(test.sum()), 1))
        rows[:, 10:] = grids[1:][test]
        more.append(rows)
    width = HEAD + 3 * (builder.degree + 1)
    tables = [r for r in builder.rows if len(r)]
    found = TrimCells(
        np.concatenate([cells, *more]),
        np.concatenate(builder.lists),
        np.concatenate(tables) if tables else np.zeros((0, width)),
        builder.degree,
        bool((trims.arc > 0).any()),
    )
    return found, cell, keep
