"""Plane regions bounded by rational curves, as exact Bézier triangles.

The end points of the curve pieces make a polygon, which is triangulated; a triangle with a
curved side gets that curve as its boundary, whatever its degree, and inside the side's
deviation from its chord fades out. A triangle is accepted when its Jacobian is positive
throughout; otherwise the curves around are cut in two, or a point is put inside.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from ...geometry import bernstein
from .curved_triangles import curved_triangle, jacobian_ratio
from .polygons import crossing, signed_area, triangulate

__all__ = ["chain", "join_ends", "region_to_triangles", "standard"]

_MAX_ROUNDS = 12
_MAX_PIECES = 2000
_HOPELESS = -1  # in place of the id of a curve: no cut can help


def _split(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the two halves of a Bézier curve, each scaled to end weights 1."""
    level, left, right = curve, [curve[0]], [curve[-1]]
    while len(level) > 1:
        level = (level[:-1] + level[1:]) / 2
        left.append(level[0])
        right.append(level[-1])
    return standard(np.array(left)), standard(np.array(right[::-1]))


def standard(curve: np.ndarray) -> np.ndarray:
    """Return the same curve ``(n+1, 3)`` with end weights 1, by a linear rational change.

    Weights must be positive.
    """
    n = len(curve) - 1
    ratio = (curve[0, 2] / curve[-1, 2]) ** (1 / n)
    out = curve * (ratio ** np.arange(n + 1))[:, None] / curve[0, 2]
    out[0, 2] = out[-1, 2] = 1.0
    return out


def is_straight(curve: np.ndarray) -> bool:
    """Tell whether a curve is its chord, run through at constant speed or not."""
    points = curve[:, :2] / curve[:, 2:]
    d = points[-1] - points[0]
    off = points - points[0]
    # 1e-12 of the length: rounding
    return bool(np.abs(off[:, 0] * d[1] - off[:, 1] * d[0]).max() <= 1e-12 * (d @ d))


def chain(curves: list[np.ndarray], tolerance: float) -> list[list[np.ndarray]] | None:
    """Order curves into closed loops, turning some round; None if one stays open.

    Parameters
    ----------
    curves : list of (n+1, 3) arrays
        Homogeneous Bézier curves.
    tolerance : float
        Largest gap between the end of a curve and the start of the next.
    """
    if not curves:
        return []
    starts = np.array([c[0, :2] / c[0, 2] for c in curves])
    ends = np.array([c[-1, :2] / c[-1, 2] for c in curves])
    places = np.concatenate([starts, ends])
    count = len(curves)
    left = np.ones(2 * count, dtype=bool)
    loops = []
    for number in range(count):
        if not left[number]:
            continue
        left[[number, number + count]] = False
        loop, first, end = [curves[number]], starts[number], ends[number]
        while True:
            gaps = np.where(left, np.linalg.norm(places - end, axis=1), np.inf)
            best = int(np.argmin(gaps))
            home = np.linalg.norm(first - end)
            if min(gaps[best], home) > tolerance:
                return None
            # closing comes last: prefer to go on where a loop passes through its start again
            if home < gaps[best]:
                break
            k = best % count
            left[[k, k + count]] = False
            loop.append(curves[k] if best < count else curves[k][::-1])
            end = ends[k] if best < count else starts[k]
        loops.append(loop)
    return loops


def region_to_triangles(
    loops: list[list[np.ndarray]], quality: float = 0.05
) -> list[np.ndarray] | str:
    """Return Bézier triangles that fill a plane region exactly.

    Parameters
    ----------
    loops : list of list of (n+1, 3) arrays
        Closed loops of homogeneous Bézier curves of positive weights, in any order and
        direction; the region is what an odd number of loops enclose.
    quality : float
        Smallest Jacobian accepted, relative to the flat triangle.

    Returns
    -------
    list of (K, 3) arrays, or str
        Plane homogeneous nets, counterclockwise, of several degrees; or the reason why not.
    """
    pieces = [[standard(c) for c in loop] for loop in loops]
    pieces = [[c for c in loop if _length(c) > 0] for loop in pieces]
    corners = np.concatenate([c[:1, :2] for loop in pieces for c in loop] or [np.zeros((1, 2))])
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    size = float(np.ptp(corners, axis=0).max()) or 1.0

    def local(c: np.ndarray) -> np.ndarray:
        out = c.copy()
        out[:, :2] = (c[:, :2] - center * c[:, 2:]) / size
        return out

    pieces = [join_ends([local(c) for c in loop], 1e-6) for loop in pieces if loop]
    pieces = [[h for c in loop for h in _tame(c)] for loop in pieces]
    for k, loop in enumerate(pieces):
        while len(loop) < 3:  # the end points are to be a polygon
            loop = [half for c in loop for half in _split(c)]
        pieces[k] = loop
    outlines = [_outline(loop) for loop in pieces]
    areas = np.array([signed_area(outline) for outline in outlines])
    keep = np.flatnonzero(np.abs(areas) > 1e-14)
    if not len(keep):
        return "its boundary encloses no area"
    back = np.array([[size, 0, 0], [0, size, 0], [center[0], center[1], 1]])
    nets: list[np.ndarray] = []
    for group in _nested([outlines[k] for k in keep], np.abs(areas[keep])):
        chosen = [keep[k] for k in group]
        part = [
            _turn(pieces[k]) if (areas[k] < 0) == (k == chosen[0]) else pieces[k] for k in chosen
        ]
        found = _fill_region(part, quality)
        if found is None:
            return "its boundary could not be cut into triangles (it may cross itself)"
        nets += [net @ back for net in found]
    return nets


def _nested(outlines: list[np.ndarray], areas: np.ndarray) -> list[list[int]]:
    """Return groups of loops: an outer one and the holes just inside of it."""
    order = np.argsort(-areas)
    around: dict[int, list[int]] = {}
    for at, k in enumerate(order):
        around[k] = [j for j in order[:at] if _contains(outlines[j], outlines[k][0])]
    groups = {k: [k] for k in order if len(around[k]) % 2 == 0}
    for k in order:
        if len(around[k]) % 2 == 1:
            # the smallest loop around a hole is the outer one it belongs to
            groups[max(around[k], key=lambda j: len(around[j]))].append(k)
    return [[int(k) for k in group] for group in groups.values()]


def _contains(outline: np.ndarray, point: np.ndarray) -> bool:
    a, b = outline, np.roll(outline, -1, axis=0)
    upward = (a[:, 1] <= point[1]) != (b[:, 1] <= point[1])
    a, b = a[upward], b[upward]
    x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool((x > point[0]).sum() % 2)


def _fill_region(pieces: list[list[np.ndarray]], quality: float) -> list[np.ndarray] | None:
    """Fill an outer loop, counterclockwise, with holes, clockwise; None if it cannot be done."""
    for _ in range(_MAX_ROUNDS):
        if sum(map(len, pieces)) > _MAX_PIECES:
            return None
        pieces = [_balance(loop) for loop in pieces]
        nets, bad = _attempt(pieces, quality)
        if not bad:
            wanted = sum(_curve_area(c) for loop in pieces for c in loop)
            filled = sum(_curve_area(side) for net in nets for side in _sides(net))
            # both are sums over the same boundary curves, so only rounding is left
            return nets if abs(filled - wanted) <= 1e-9 * abs(wanted) else None
        if bad == {_HOPELESS}:
            return None
        pieces = [
            [h for c in loop for h in (_split(c) if id(c) in bad else (c,))] for loop in pieces
        ]
    return None


@cache
def _gauss_rule(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Bernstein polynomials of degree n and n - 1 at ten Gauss points, and weights."""
    t, weight = np.polynomial.legendre.leggauss(10)
    t, weight = (t + 1) / 2, weight / 2
    value, slope = (
        np.stack([comb(m, i) * t**i * (1 - t) ** (m - i) for i in range(m + 1)], axis=1)
        for m in (n, n - 1)
    )
    return value, slope, weight


def _curve_area(curve: np.ndarray) -> float:
    """Return the integral of ``(x dy - y dx) / 2`` along a curve, by a Gauss rule."""
    n = len(curve) - 1
    if n == 1:
        a, b = curve[:, :2] / curve[:, 2:]
        return float(a[0] * b[1] - a[1] * b[0]) / 2
    value, slope, weight = _gauss_rule(n)
    h, d = value @ curve, slope @ (n * np.diff(curve, axis=0))
    # (x dy - y dx) of x = X/W, y = Y/W is (X dY - Y dX) / W^2
    return float(weight @ ((h[:, 0] * d[:, 1] - h[:, 1] * d[:, 0]) / h[:, 2] ** 2) / 2)


def _sides(net: np.ndarray) -> list[np.ndarray]:
    return [net[rows] for rows in bernstein.edge_rows(bernstein.degree_of(len(net)))]


def _length(curve: np.ndarray) -> float:
    points = curve[:, :2] / curve[:, 2:]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _outline(loop: list[np.ndarray]) -> np.ndarray:
    """Return points along a loop, close enough to tell its direction."""
    t = np.arange(8) / 8
    out = []
    for c in loop:
        n = len(c) - 1
        basis = np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=1)
        h = basis @ c
        out.append(h[:, :2] / h[:, 2:])
    return np.concatenate(out)


def _turn(loop: list[np.ndarray]) -> list[np.ndarray]:
    return [c[::-1] for c in loop[::-1]]


def join_ends(loop: list[np.ndarray], tolerance: float) -> list[np.ndarray]:
    """Make the end of each curve the start of the next.

    Larger gaps are closed by a straight piece, or by shortening a straight neighbour that goes
    too far.

    Parameters
    ----------
    loop : list of (n+1, 3) arrays
        Homogeneous Bézier curves with end weights 1, in order.
    tolerance : float
        Ends closer than that are moved to their middle.
    """
    out: list[np.ndarray] = []
    curves = [c.copy() for c in loop]
    for a, b in zip(curves, [*curves[1:], curves[0]]):
        out.append(a)
        gap = np.abs(a[-1] - b[0]).max()
        if gap <= tolerance:
            a[-1] = b[0] = (a[-1] + b[0]) / 2
        elif _goes_past(a, b[0]):
            a[-1] = b[0]
        elif _goes_past(b[::-1], a[-1]):
            b[0] = a[-1]
        else:
            out.append(np.stack([a[-1], b[0]]))
    return out


def _goes_past(side: np.ndarray, point: np.ndarray) -> bool:
    """Tell whether a straight side passes a point (within 6 degrees) before it ends."""
    if len(side) != 2:
        return False
    along, gap = side[1] - side[0], point - side[1]
    length = np.linalg.norm(along)
    back = -(gap @ along) / length if length else 0.0
    return bool(back > 0.995 * np.linalg.norm(gap) and 2 * back < length)


def _tame(curve: np.ndarray) -> list[np.ndarray]:
    """Cut a curve until its control polygon turns by less than 60 degrees."""
    if is_straight(curve):
        return [curve[[0, -1]]]
    points = curve[:, :2] / curve[:, 2:]
    steps = np.diff(points, axis=0)
    steps = steps[np.linalg.norm(steps, axis=1) > 1e-14]
    if len(steps) < 2:
        return [curve]
    angles = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.abs((np.diff(angles) + np.pi) % (2 * np.pi) - np.pi).sum()
    if turn <= np.pi / 3 or np.ptp(points, axis=0).max() < 1e-6:
        return [curve]
    return [piece for half in _split(curve) for piece in _tame(half)]


def _balance(loop: list[np.ndarray]) -> list[np.ndarray]:
    """Cut the longer of two sides that leave a corner at a narrow angle.

    Otherwise no triangle at the corner has both of them, and a side that is nearly parallel to
    them would have to pass between them.
    """
    out = list(loop)
    k = 0
    while k < len(out) and len(out) < _MAX_PIECES:
        before, after = out[k - 1], out[k]
        back = before[-2, :2] / before[-2, 2] - before[-1, :2]
        ahead = after[1, :2] / after[1, 2] - after[0, :2]
        narrow = back @ ahead > 0.9 * np.linalg.norm(back) * np.linalg.norm(ahead)
        long_before = np.linalg.norm(before[-1] - before[0])
        long_after = np.linalg.norm(after[-1] - after[0])
        if narrow and long_after > 1.5 * long_before:
            out[k : k + 1] = _split_at(after, long_before / long_after)
        elif narrow and long_before > 1.5 * long_after:
            at = (k - 1) % len(out)
            out[at : at + 1] = _split_at(before, 1 - long_after / long_before)
            k += at < k  # the corner has moved up by one
        k += 1
    return out


def _split_at(curve: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Cut a straight side at t, any other in the middle."""
    if len(curve) > 2:
        return _split(curve)
    middle = (1 - t) * curve[0] + t * curve[1]
    return np.stack([curve[0], middle]), np.stack([middle, curve[1]])


def _attempt(pieces: list[list[np.ndarray]], quality: float) -> tuple[list[np.ndarray], set[int]]:
    """Triangulate; return nets, and the ids of curves to cut in two if some were not good."""
    curves = [c for loop in pieces for c in loop]
    points = np.array([c[0, :2] for c in curves])
    loops, start = [], 0
    for loop in pieces:
        loops.append(list(range(start, start + len(loop))))
        start += len(loop)
    edges = np.array([(a, b) for loop in loops for a, b in zip(loop, [*loop[1:], loop[0]])])
    curved = {id(c) for c in curves if len(c) > 2}
    crossed = crossing(points, edges)
    if crossed:
        return [], {id(curves[e]) for e in crossed} & curved or {_HOPELESS}
    faces = triangulate(points, loops)
    if faces is None:
        return [], curved or {_HOPELESS}
    by_edge = {(int(a), int(b)): curves[e] for e, (a, b) in enumerate(edges)}
    nets: list[np.ndarray] = []
    bad: set[int] = set()
    for face in faces.tolist():
        sides = [by_edge.get((face[k], face[(k + 1) % 3])) for k in range(3)]
        bent = [s if s is not None and len(s) > 2 else None for s in sides]
        found = _fill(points[face], bent, [s is not None for s in sides], quality)
        if found is None:
            bad |= {id(s) for s in bent if s is not None}
            if all(s is None for s in bent):
                bad |= {_HOPELESS}
        else:
            nets += found
    return nets, bad


def _fill(
    corners: np.ndarray, sides: list[np.ndarray | None], boundary: list[bool], quality: float
) -> list[np.ndarray] | None:
    """Return the nets of one triangle, cut at its middle if that makes them good."""
    net = curved_triangle(corners, sides)
    if all(s is None for s in sides):
        return [net]
    ratio = jacobian_ratio(net)
    # two sides of the boundary may go on straight into each other: no angle is left between them
    if ratio >= (quality if sum(boundary) < 2 else max(quality, 0.3)):
        return [net]
    # or they may touch: in a corner of angle zero the Jacobian vanishes, and rounding in the
    # file can make it negative within that distance of the corner
    if ratio >= -1e-3 and _has_cusp(corners, sides, boundary):
        return [net]
    middle = corners.mean(axis=0)
    out = []
    for k in range(3):
        part = np.stack([corners[k], corners[(k + 1) % 3], middle])
        net = curved_triangle(part, [sides[k], None, None])
        if sides[k] is not None and jacobian_ratio(net) < quality:
            return None
        out.append(net)
    return out


def _has_cusp(corners: np.ndarray, sides: list[np.ndarray | None], boundary: list[bool]) -> bool:
    """Tell whether two boundary sides leave a corner within 3 degrees of each other."""
    for k in range(3):
        if not (boundary[k] and boundary[k - 1]):
            continue
        after, before = sides[k], sides[k - 1]
        one = corners[(k + 1) % 3] if after is None else after[1, :2] / after[1, 2]
        two = corners[k - 1] if before is None else before[-2, :2] / before[-2, 2]
        a, b = one - corners[k], two - corners[k]
        if a @ b > 0.9986 * np.linalg.norm(a) * np.linalg.norm(b):
            return True
    return False
