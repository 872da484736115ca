"""Fill plane regions that Bézier curves bound: exactly, by Bézier triangles of their degree.

The corners of the outline, a polygon with holes, are triangulated by cutting ears. Edges on the
outline then take their curves in place of their chords, so that a triangle has at most one curved
side. Where it would fold (its Jacobian is not positive) the curve is cut in two and all is done
again. Triangles with positive Jacobians whose areas sum up to that of the outline cover it once.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import GeometryError
from . import bernstein
from .triangles import BezierTriangles

__all__ = ["fill_region", "outline_area"]

#: Rounds of cutting curves. Each halves their distance from the chord twice.
ROUNDS = 8


def _contours(contours: Sequence[Any]) -> list[list[np.ndarray]]:
    out = []
    for number, contour in enumerate(contours):
        curves = []
        for curve in contour:
            b = np.asarray(curve, dtype=np.float64)
            if (
                b.ndim != 2
                or b.shape[1] != 2
                or len(b) not in (2, 3, 4)
                or not np.isfinite(b).all()
            ):
                raise GeometryError.expected(
                    f"contour {number}", "curves of degree 1 to 3 in the plane", f"shape {b.shape}"
                )
            if np.ptp(b, axis=0).max() > 0:
                curves.append(b)
        ends = (
            [np.array_equal(a[-1], b[0]) for a, b in pairwise([*curves, curves[0]])]
            if curves
            else []
        )
        if len(curves) < 2 or not all(ends):
            raise GeometryError.expected(
                f"contour {number}", "a closed outline of two curves at least", "one that is not"
            )
        out.append(curves)
    if not out:
        raise GeometryError.expected("contours", "at least one", "none")
    return out


def outline_area(contours: Sequence[Any]) -> np.ndarray:
    """Return the signed areas of closed outlines, positive if they run counter-clockwise."""
    return np.array([_area(contour) for contour in _contours(contours)])


def _area(contour: list[np.ndarray]) -> float:
    """Return the integral of (x dy - y dx) / 2 over closed curves, exactly."""
    total = 0.0
    t, w = np.polynomial.legendre.leggauss(3)  # exact to degree 5, for cubics
    s = (t + 1) / 2
    for b in contour:
        n = len(b) - 1
        x = bernstein.univariate(n, s) @ b
        d = bernstein.univariate(n - 1, s) @ (n * np.diff(b, axis=0))
        total += float(w @ (x[:, 0] * d[:, 1] - x[:, 1] * d[:, 0])) / 4
    return total


def _halves(b: np.ndarray) -> list[np.ndarray]:
    left, right, level = [b[0]], [b[-1]], b
    while len(level) > 1:
        level = (level[:-1] + level[1:]) / 2
        left.append(level[0])
        right.append(level[-1])
    return [np.array(left), np.array(right[::-1])]


def _bends(b: np.ndarray) -> bool:
    """Return whether a curve is too far from its chord to begin with."""
    chord = b[-1] - b[0]
    size = np.hypot(*chord)
    away = np.abs((b[1:-1] - b[0]) @ np.array([-chord[1], chord[0]]))
    return bool(len(b) > 2 and (size == 0 or away.max() > 0.45 * size * size))


def fill_region(contours: Sequence[Any]) -> BezierTriangles:
    """Return Bézier triangles in the plane z = 0 that cover a region exactly.

    Parameters
    ----------
    contours : sequence of sequences of (n+1, 2) array_like
        Closed outlines, each a list of polynomial curves of degree 1, 2 or 3 that begin where the
        one before ends, to the last bit. They do not cross; what is inside of an odd number of them
        is filled, whichever way they run.

    Returns
    -------
    BezierTriangles
        Of the highest degree among the curves; normals along +z.

    Raises
    ------
    GeometryError
        If an outline is not closed, or outlines cross.
    """
    parts = _contours(contours)
    n = max(len(b) - 1 for contour in parts for b in contour)
    for k, contour in enumerate(parts):
        while any(_bends(b) for b in contour):
            contour = [h for b in contour for h in (_halves(b) if _bends(b) else [b])]
        parts[k] = contour
    parts = [c if len(c) > 2 else [h for b in c for h in _halves(b)] for c in parts]
    areas = [_area(c) for c in parts]
    depth = _depths(parts)
    for _ in range(ROUNDS):
        patches: list[np.ndarray] = []
        bad = _crossing(parts)
        for group in _groups(parts, depth) if not bad else ():
            own, folded = _fill_group([parts[k] for k in group], areas, group, n)
            patches += own
            bad |= folded
        if not bad:
            break
        parts = [
            [h for i, b in enumerate(c) for h in (_halves(b) if (k, i) in bad else [b])]
            for k, c in enumerate(parts)
        ]
    else:
        raise GeometryError.expected("contours", "outlines that do not cross or touch", "such ones")
    net = np.array(patches)
    whole = sum(abs(a) * (1 if d % 2 == 0 else -1) for a, d in zip(areas, depth))
    covered = _covered(net, n).sum()
    # rounding of sums of some hundred areas
    if abs(covered - whole) > 1e-9 * sum(map(abs, areas)):
        raise GeometryError.expected("contours", "outlines that do not cross", "some that do")
    out = np.concatenate([net, np.zeros((*net.shape[:2], 1)), np.ones((*net.shape[:2], 1))], axis=2)
    return BezierTriangles(out)


def _crossing(parts: list[list[np.ndarray]]) -> set[tuple[int, int]]:
    """Return the curves whose chords cross others: they bulge over them, and have to be cut.

    Raises
    ------
    GeometryError
        If two straight sides cross.
    """
    names = [(k, i) for k, c in enumerate(parts) for i in range(len(c))]
    every = [parts[k][i] for k, i in names]
    a, b = np.array([x[0] for x in every]), np.array([x[-1] for x in every])
    bent = np.array([len(x) > 2 for x in every])
    out: set[tuple[int, int]] = set()
    for m in range(len(every)):
        apart = _cross(a[m], b[m], a) * _cross(a[m], b[m], b) < 0
        apart &= _cross(a, b, a[m]) * _cross(a, b, b[m]) < 0
        if not bent[m] and (apart & ~bent).any():
            raise GeometryError.expected("contours", "outlines that do not cross", "some that do")
        if apart.any():
            out |= {names[q] for q in [m, *np.flatnonzero(apart)] if bent[q]}
    return out


# ---------------------------------------------------------------- outlines within outlines


def _polygon(contour: list[np.ndarray]) -> np.ndarray:
    return np.array([b[0] for b in contour])


def _inside(x: np.ndarray, polygon: np.ndarray) -> bool:
    a, b = polygon, np.roll(polygon, -1, axis=0)
    crosses = (a[:, 1] > x[1]) != (b[:, 1] > x[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (x[1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool((crosses & (x[0] < at)).sum() % 2)


def _fine(contour: list[np.ndarray]) -> np.ndarray:
    t = np.linspace(0, 1, 8, endpoint=False)
    return np.concatenate([bernstein.univariate(len(b) - 1, t) @ b for b in contour])


def _depths(parts: list[list[np.ndarray]]) -> list[int]:
    fine = [_fine(c) for c in parts]
    return [
        sum(_inside(c[0][0], fine[j]) for j in range(len(parts)) if j != k)
        for k, c in enumerate(parts)
    ]


def _groups(parts: list[list[np.ndarray]], depth: list[int]) -> list[list[int]]:
    """Return outlines with their holes, as numbers."""
    fine = [_fine(c) for c in parts]
    outer = [k for k, d in enumerate(depth) if d % 2 == 0]
    groups = {k: [k] for k in outer}
    for k, d in enumerate(depth):
        if d % 2:
            around = [j for j in outer if depth[j] == d - 1 and _inside(parts[k][0][0], fine[j])]
            groups[around[0]].append(k)
    return list(groups.values())


# ---------------------------------------------------------------- triangles

#: A corner of the polygon: its place, and the edge to the next one as (outline, curve, backwards),
#: or None for a bridge or a diagonal.
_Corner = tuple[np.ndarray, "tuple[int, int, bool] | None"]


def _ring(contour: list[np.ndarray], number: int, turn: bool) -> list[_Corner]:
    if not turn:
        return [(b[0], (number, k, False)) for k, b in enumerate(contour)]
    return [(b[-1], (number, k, True)) for k, b in reversed(list(enumerate(contour)))]


def _fill_group(
    contours: list[list[np.ndarray]], areas: list[float], numbers: list[int], n: int
) -> tuple[list[np.ndarray], set[tuple[int, int]]]:
    """Return the nets over one outline with holes, and the curves that must be cut."""
    curves = dict(zip(numbers, contours))
    ring = _ring(contours[0], numbers[0], areas[numbers[0]] < 0)
    holes = [_ring(c, k, areas[k] > 0) for c, k in zip(contours[1:], numbers[1:])]
    for hole in sorted(holes, key=lambda h: -max(float(x[0]) for x, _e in h)):
        joined = _bridged(ring, hole, holes)
        if joined is None:
            return [], {(k, i) for k in numbers for i in range(len(curves[k]))}
        ring = joined
    nets: list[np.ndarray] = []
    folded: set[tuple[int, int]] = set()
    for corners, edges in _ears(ring, curves, n):
        pieces = _pieces(corners, edges, curves, n)
        nets += pieces
        if not pieces:
            folded |= {e[:2] for e in edges if e is not None}
    return [p for p in nets if abs(_covered(p[None], n)[0]) > 0], folded


def _pieces(
    corners: list[np.ndarray], edges: list[Any], curves: dict[int, list[np.ndarray]], n: int
) -> list[np.ndarray]:
    """Return the nets of a triangle, one or three; none if it folds."""
    if len(edges) != 3:
        return []
    net = _net(corners, edges, curves, n)
    if all(e is None or len(curves[e[0]][e[1]]) == 2 for e in edges):
        return [net]  # perhaps a sliver between bridges, of no area
    if _jacobian(net, n).min() > 0:
        return [net]
    # where sides join smoothly the corner is flat: cut the triangle in three, by its middle
    middle = bernstein.basis(n, np.full((1, 2), 1 / 3))[0] @ net
    pieces = [
        _net([corners[k], corners[(k + 1) % 3], middle], [edges[k], None, None], curves, n)
        for k in range(3)
    ]
    return pieces if all(_jacobian(p, n).min() > 0 for p in pieces) else []


def _net(
    corners: Sequence[np.ndarray], edges: Sequence[Any], curves: dict[int, list[np.ndarray]], n: int
) -> np.ndarray:
    """Return the net of a triangle whose sides are curves of the outline or straight."""
    net = np.zeros((bernstein.size(n), 2))
    sides = []
    for k in range(3):
        a, b, e = corners[k], corners[(k + 1) % 3], edges[k]
        own = np.stack([a, b]) if e is None else curves[e[0]][e[1]][:: -1 if e[2] else 1]
        while len(own) <= n:
            m = len(own)
            s = np.arange(1, m)[:, None] / m
            own = np.concatenate([own[:1], s * own[:-1] + (1 - s) * own[1:], own[-1:]])
        sides.append(own)
    for j in range(n + 1):
        net[bernstein.row(n, n - j, j)] = sides[0][j]
        net[bernstein.row(n, 0, n - j)] = sides[1][j]
        net[bernstein.row(n, j, 0)] = sides[2][j]
    if n == 3:  # exact for quadratics
        border = sum(s[1] + s[2] for s in sides)
        net[bernstein.row(3, 1, 1)] = border / 4 - sum(s[0] for s in sides) / 6
    return net


def _partials(nets: np.ndarray, n: int, uv: np.ndarray) -> np.ndarray:
    du, dv = bernstein.partials_matrices(n)
    b = bernstein.basis(n - 1, uv) if n > 1 else np.ones((len(uv), 1))
    u, v = b @ (du @ nets), b @ (dv @ nets)
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def _jacobian(net: np.ndarray, n: int) -> np.ndarray:
    """Return the Bernstein coefficients of the Jacobian, of degree 2n - 2: bounds of it."""
    m = 2 * n - 2
    if m == 0:
        return _partials(net, n, np.full((1, 2), 1 / 3))
    nodes = bernstein.multi_indices(m)[:, :2] / m
    return np.linalg.solve(bernstein.basis(m, nodes), _partials(net, n, nodes))


def _covered(nets: np.ndarray, n: int) -> np.ndarray:
    """Return the signed areas: the mean of the Bernstein coefficients of the Jacobian, halved."""
    return np.array([_jacobian(net, n).mean() / 2 for net in nets])


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Any:
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )


def _bridged(
    ring: list[_Corner], hole: list[_Corner], holes: list[list[_Corner]]
) -> list[_Corner] | None:
    """Return one ring: the outer one, with a hole joined by the shortest bridge that is free."""
    x, y = (np.array([c[0] for c in r]) for r in (ring, hole))
    every = [ring, *holes]
    starts = np.concatenate([[c[0] for c in r] for r in every])
    ends = np.concatenate([np.roll([c[0] for c in r], -1, axis=0) for r in every])
    distance = np.linalg.norm(x[:, None] - y[None], axis=2)
    for flat in np.argsort(distance, axis=None):
        i, j = (int(m) for m in np.unravel_index(flat, distance.shape))
        p, q = x[i], y[j]
        s, t = _cross(p, q, starts), _cross(p, q, ends)
        u, v = _cross(starts, ends, p), _cross(starts, ends, q)
        touching = (
            (starts == p).all(axis=1) | (ends == p).all(axis=1)
            | (starts == q).all(axis=1) | (ends == q).all(axis=1)
        )  # fmt: skip
        if ((s * t <= 0) & (u * v <= 0) & ~touching).any():
            continue
        # into the ring's inside at p, where bridges before may have left two corners
        before, after = ring[i - 1][0], ring[(i + 1) % len(ring)][0]
        if not _within(before, p, after, q):
            continue
        own = [*hole[j:], *hole[:j]]
        return [
            *ring[:i], (p, None), *own, (own[0][0], None), (p, ring[i][1]), *ring[i + 1 :],
        ]  # fmt: skip
    return None


def _within(before: np.ndarray, at: np.ndarray, after: np.ndarray, x: np.ndarray) -> bool:
    """Return whether a direction is inside of a corner of a counter-clockwise polygon."""
    left, right = _cross(at, after, x) > 0, _cross(before, at, x) > 0
    return bool(left and right if _cross(before, at, after) > 0 else left or right)


def _direction(corner: _Corner, curves: dict[int, list[np.ndarray]], end: bool) -> Any:
    """Return the tangent with which an edge of the outline begins or ends; None for a diagonal."""
    edge = corner[1]
    if edge is None:
        return None
    b = curves[edge[0]][edge[1]][:: -1 if edge[2] else 1]
    return b[-1] - b[-2] if end else b[1] - b[0]


def _opens(todo: list[_Corner], k: int, curves: dict[int, list[np.ndarray]]) -> bool:
    """Return whether the diagonal of an ear leaves an angle to the curves that meet it."""
    before, after = todo[k - 1][0], todo[(k + 1) % len(todo)][0]
    way = after - before
    size = float(way @ way)
    for corner, other, sign, end in (
        (todo[k - 2], todo[k - 2][0] - before, 1.0, True),
        (todo[(k + 1) % len(todo)], todo[(k + 2) % len(todo)][0] - after, -1.0, False),
    ):
        tangent = _direction(corner, curves, end)
        if tangent is None:
            continue
        tangent = -tangent if end else tangent
        d = sign * way
        turned = sign * (d[0] * other[1] - d[1] * other[0])
        own = sign * (d[0] * tangent[1] - d[1] * tangent[0])
        if turned > 0 and not own > 1e-6 * size:
            return False
    return True


def _ears(
    ring: list[_Corner], curves: dict[int, list[np.ndarray]], n: int
) -> list[tuple[list[np.ndarray], list[Any]]]:
    """Return triangles ``(corners, edges)`` of a polygon by cutting ears, round ones first.

    Ears that would fold, or leave a curve that its diagonal touches, are taken last. Where there is
    none at all the rest is one triangle with all its edges, to be cut.
    """
    todo = list(ring)
    out: list[tuple[list[np.ndarray], list[Any]]] = []
    while len(todo) > 3:
        x = np.array([c[0] for c in todo])
        a, b, c = np.roll(x, 1, axis=0), x, np.roll(x, -1, axis=0)
        turn = _cross(a, b, c)
        reflex = x[turn <= 0]
        found = []
        for k in np.flatnonzero(turn > 0).tolist():
            p = (a[k], b[k], c[k])
            inside = np.ones(len(reflex), dtype=bool)
            for m in range(3):
                inside &= _cross(p[m], p[(m + 1) % 3], reflex) >= 0
                inside &= ~(reflex == p[m]).all(axis=1)
            if not inside.any():
                sides = sum(float(np.sum((p[m] - p[m - 1]) ** 2)) for m in range(3))
                found.append((float(turn[k]) / sides, k))
        if not found:
            rest = [corner[1] for corner in todo if corner[1] is not None]
            return [*out, ([x[0], x[1], x[2]], rest)]
        found.sort(reverse=True)
        chosen = found[0][1]
        for _quality, k in found:
            after = todo[(k + 1) % len(todo)]
            corners, edges = [todo[k - 1][0], x[k], after[0]], [todo[k - 1][1], todo[k][1], None]
            if _opens(todo, k, curves) and _pieces(corners, edges, curves, n):
                chosen = k
                break
        k = chosen
        before, own, after = todo[k - 1], todo[k], todo[(k + 1) % len(todo)]
        out.append(([before[0], own[0], after[0]], [before[1], own[1], None]))
        todo[k - 1] = (before[0], None)
        del todo[k]
    out.append(([c[0] for c in todo], [c[1] for c in todo]))
    return out
