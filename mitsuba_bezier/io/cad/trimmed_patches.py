"""Surfaces trimmed by curves: patches with trims, or exact restriction to curved triangles.

With trims (`trimmed_grid`), the patches stay as they are and every hit is tested against the
trimming curves: both are exact, and the degree stays low. What cannot test a hit needs nets that
are the face itself (`trimmed_patches`):
The trimmed region is cut along the knots, each part is filled with curved plane triangles
(`plane_regions`), and a patch ``S`` of bidegree (p, q) after a plane triangle ``T`` of degree n
is again a rational Bézier triangle, of degree ``n (p + q)``. So the surface is exact, and its
boundary follows the trimming curves as they are given here.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb

import numpy as np

from ...geometry import bernstein
from ...geometry.trim_cells import trim_cells
from ...geometry.trims import Trims, square_map
from ..nurbs import bezier_matrices
from ..nurbs_surface import PatchGrid
from ..tensor_nets import tensor_nets
from ..trims import rectangles, rectilinear
from .composition import compose
from .plane_regions import chain, join_ends, region_to_triangles, standard

__all__ = [
    "closed_boundary",
    "cut",
    "fit_parabolas",
    "trimmed_grid",
    "trimmed_patches",
]


def _evaluate(curve: np.ndarray, t: np.ndarray) -> np.ndarray:
    n = len(curve) - 1
    basis = np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=-1)
    h = basis @ curve
    return h[..., :2] / h[..., 2:]


def _pieces(curve: np.ndarray, cuts: list[float]) -> list[np.ndarray]:
    n = len(curve) - 1
    knots = np.array([0.0] * (n + 1) + [1.0] * (n + 1))
    matrices, _first, _intervals = bezier_matrices(knots, n, cuts)
    return list(matrices @ curve)


def _roots(curve: np.ndarray, axis: int, value: float) -> list[float]:
    """Return the parameters in (0, 1) at which a coordinate takes a value."""
    h = curve[:, axis] - value * curve[:, 2]
    if (h > 0).all() or (h < 0).all():
        return []
    n = len(h) - 1
    power = np.zeros(n + 1)  # to powers of t, highest first, for numpy
    for i in range(n + 1):
        for k in range(n - i + 1):
            power[n - i - k] += h[i] * comb(n, i) * comb(n - i, k) * (-1) ** k
    scale = np.abs(power).max()
    if scale == 0:
        return []
    lead = np.flatnonzero(np.abs(power) > 1e-14 * scale)
    roots = np.roots(power[lead[0] :])
    real = roots.real[np.abs(roots.imag) < 1e-7]
    # 1e-9: a root at an end of the curve cuts off nothing
    return sorted(float(t) for t in real if 1e-9 < t < 1 - 1e-9)


def cut(
    curves: list[np.ndarray], axis: int, value: float, tolerance: float
) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
    """Cut a region at a parameter line.

    Parameters
    ----------
    curves : list of (n+1, 3) arrays
        The boundary, in any order.
    axis : int
        0 to cut at u = value, 1 at v = value.
    value : float
        Where to cut.
    tolerance : float
        Points closer to the line than that lie on it.

    Returns
    -------
    pair of list of (n+1, 3) arrays, or None
        The boundaries of the parts below and above; None if the boundary is not closed.
    """
    sides: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for curve in curves:
        for piece in _pieces(curve, _roots(curve, axis, value)):
            points = piece[:, axis] / piece[:, 2] - value
            if np.abs(points).max() <= tolerance:
                continue  # along the line: put back below where it is needed
            middle = _evaluate(piece, np.array([0.25, 0.5, 0.75]))[:, axis] - value
            piece = piece.copy()
            for end in (0, -1):
                if abs(points[end]) <= tolerance:
                    piece[end, axis] = value * piece[end, 2]
            sides[int(middle.sum() > 0)].append(piece)
    for side in sides:
        # where the part meets the line: just inside of it, the region begins and ends in turn
        ends = [c[e] / c[e, 2] for c in side for e in (0, -1)]
        at = sorted(float(x[1 - axis]) for x in ends if abs(x[axis] - value) <= tolerance)
        if len(at) % 2:
            return None
        for low, high in zip(at[::2], at[1::2]):
            if high - low > tolerance:
                segment = np.ones((2, 3))
                segment[:, axis] = value
                segment[:, 1 - axis] = low, high
                side.append(segment)
    return sides


def _cells(
    curves: list[np.ndarray], lines: tuple[np.ndarray, np.ndarray], tolerance: np.ndarray
) -> list[tuple[int, int, list[np.ndarray]]] | None:
    """Cut a region at all lines; return the cells that have a part of it."""
    columns = []
    rest = curves
    for i, u in enumerate(lines[0]):
        parts = cut(rest, 0, float(u), float(tolerance[0]))
        if parts is None:
            return None
        columns.append((i, parts[0]))
        rest = parts[1]
    columns.append((len(lines[0]), rest))
    out = []
    for i, column in columns:
        rest = column
        for j, v in enumerate(lines[1]):
            if not rest:
                break
            parts = cut(rest, 1, float(v), float(tolerance[1]))
            if parts is None:
                return None
            if parts[0]:
                out.append((i, j, parts[0]))
            rest = parts[1]
        else:
            if rest:
                out.append((i, len(lines[1]), rest))
    return out


# ---------------------------------------------------------------------------- patches


def fit_parabolas(
    evaluate: Callable[[np.ndarray], np.ndarray],
    scale: np.ndarray,
    tolerance: float,
    start: int = 2,
) -> list[np.ndarray] | None:
    """Return parabolas close to a plane curve.

    Parameters
    ----------
    evaluate : callable
        From parameters ``(N,)`` in [0, 1] to points ``(N, 2)``.
    scale : (2,) array
        Lengths on the surface of a unit along u and along v.
    tolerance : float
        Largest distance on the surface, measured across the curve at three places of each
        parabola.
    start : int
        How many pieces to start with, so that no wave of the curve falls between the places
        where the distance is measured.

    Returns
    -------
    list of (3, 3) arrays, or None
        Homogeneous Bézier points; None if more than 512 would be needed.
    """
    out: list[np.ndarray] = []
    todo = [(k / start, (k + 1) / start, 0) for k in range(start - 1, -1, -1)]
    while todo:
        a, b, depth = todo.pop()
        t = a + (b - a) * np.array([0, 0.25, 0.5, 0.75, 1])
        x = evaluate(t)
        middle = _tangents_meet(evaluate, a, b, x[0], x[4], scale)
        if middle is None:
            middle = 2 * x[2] - (x[0] + x[4]) / 2
        s = np.array([[0.25], [0.5], [0.75]])
        fitted = (1 - s) ** 2 * x[0] + 2 * s * (1 - s) * middle + s**2 * x[4]
        off = (x[1:4] - fitted) * scale
        tangent = np.array([x[2] - x[0], x[3] - x[1], x[4] - x[2]]) * scale
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        tangent = tangent / np.maximum(length, 1e-300)
        across = off[:, 0] * tangent[:, 1] - off[:, 1] * tangent[:, 0]
        # along the curve the error may be larger, but must stay small against the piece
        if len(out) + len(todo) > 512:
            return None
        if depth < 12 and (
            np.abs(across).max() > tolerance
            or np.linalg.norm(off, axis=1).max() > 0.05 * length.min() + tolerance
        ):
            todo += [((a + b) / 2, b, depth + 1), (a, (a + b) / 2, depth + 1)]
            continue
        out.append(np.column_stack([np.stack([x[0], middle, x[4]]), np.ones(3)]))
    return out


def _tangents_meet(
    evaluate: Callable[[np.ndarray], np.ndarray],
    a: float,
    b: float,
    start: np.ndarray,
    stop: np.ndarray,
    scale: np.ndarray,
) -> np.ndarray | None:
    """Return where the tangents at the ends of a piece meet, None if not well between them.

    With it as control point the pieces join smoothly, and two curves that touch still do.
    """
    h = 1e-5 * (b - a)  # differences of second order: error h^2, rounding 1e-16 / h
    x = evaluate(np.array([a + h, a + 2 * h, b - h, b - 2 * h]))
    out = (-3 * start + 4 * x[0] - x[1]) * scale
    back = (-3 * stop + 4 * x[2] - x[3]) * scale
    chord = (stop - start) * scale
    det = back[0] * out[1] - back[1] * out[0]
    # tangents within 1e-4 of parallel do not say where they meet
    if abs(det) <= 1e-4 * np.linalg.norm(out) * np.linalg.norm(back):
        return None
    along = (back[0] * chord[1] - back[1] * chord[0]) / det
    other = (out[0] * chord[1] - out[1] * chord[0]) / det
    length = np.linalg.norm(chord)
    reach = along * np.linalg.norm(out), other * np.linalg.norm(back)
    if min(reach) <= 0.05 * length or max(reach) >= length:
        return None
    return start + along * out / scale


def trimmed_patches(grid: PatchGrid, curves: list[np.ndarray]) -> list[np.ndarray] | str:
    """Return the Bézier triangles of a surface inside of trimming curves.

    Parameters
    ----------
    grid : PatchGrid
        The surface.
    curves : list of (k+1, 3) arrays
        The boundary as homogeneous Bézier curves in (u, v) of positive weights, in any order.

    Returns
    -------
    list of (P, K, 4) arrays, or str
        Nets of several degrees, or the reason why there are none.
    """
    u, v = grid.u, grid.v
    ends = np.concatenate([c[:, :2] / c[:, 2:] for c in curves])
    extent = np.maximum(np.ptp(ends, axis=0), 1e-12)
    # 1e-6: CAD programs place edges on knots no better than that; far below a pixel
    tolerance = 1e-6 * extent
    cells = _cells(curves, (u[1:-1], v[1:-1]), tolerance)
    if cells is None:
        return "its boundary is not closed"
    out: list[np.ndarray] = []
    for i, j, boundary in cells:
        domain = np.array([u[i : i + 2], v[j : j + 2]])
        edges = rectilinear([[c[:, :2] / c[:, 2:] for c in boundary]], tolerance)
        if edges is not None:
            boxes = rectangles(edges, tolerance)
            if not isinstance(boxes, str):
                cell = PatchGrid(grid.patches[i : i + 1, j : j + 1], *domain)
                # a strip beside the cell, thinner than the tolerance, is none
                low, high = (
                    np.maximum(boxes[:, :, 0], domain[:, 0]),
                    np.minimum(boxes[:, :, 1], domain[:, 1]),
                )
                boxes = boxes[(high - low > tolerance).all(axis=1)]
                out += [tensor_nets(cell.rectangle(box)) for box in boxes]
            continue
        found = _cell_triangles(boundary, domain)
        if isinstance(found, str):
            return found
        out += [compose(grid.patches[i, j], domain, triangle)[None] for triangle in found]
    return out or "nothing is left inside of its trims"


def closed_boundary(curves: list[np.ndarray], box: np.ndarray) -> list[np.ndarray] | str:
    """Return boundary curves that are closed to the last bit, or the reason why they are not.

    Parameters
    ----------
    curves : list of (k+1, 3) arrays
        Homogeneous Bézier curves of positive weights, in any order.
    box : (2, 2) array
        ``[[u0, u1], [v0, v1]]`` around them: gaps are measured against it.
    """
    low, size = box[:, 0], np.maximum(box[:, 1] - box[:, 0], 1e-300)
    local = []
    for curve in curves:
        c = standard(curve)
        c[:, :2] = (c[:, :2] - low * c[:, 2:]) / size
        if np.ptp(c[:, :2] / c[:, 2:], axis=0).any():
            local.append(c)
    # files leave gaps of 1e-3 and, where a face is very thin, more; a straight piece closes them
    loops = chain(local, 1e-3) or chain(local, 1e-2) or chain(local, 0.05)
    if loops is None:
        return "its boundary is not closed"
    out = [c for loop in loops for c in join_ends(loop, 1e-6)]
    for c in out:
        c[:, :2] = c[:, :2] * size + low * c[:, 2:]
    return out


def trimmed_grid(
    grid: PatchGrid,
    curves: list[np.ndarray],
    angular: tuple[bool, bool] = (False, False),
    turned: bool = False,
) -> tuple[np.ndarray, Trims] | str:
    """Return the patches of a surface that trimming curves leave, with their trims.

    Parameters
    ----------
    grid : PatchGrid
        The surface.
    curves : list of (k+1, 3) arrays
        The boundary in the parameters of the surface, closed to the last bit.
    angular : (bool, bool)
        Whether u and v are the angles of the grid's arcs.
    turned : bool
        Whether to turn the surface round.

    Returns
    -------
    pair of (P, K, 4) array and Trims, or str
        Nets of degree p + q; or the reason why there are none.
    """
    width, height = len(grid.u) - 1, len(grid.v) - 1
    nets = tensor_nets(grid.patches.reshape(-1, *grid.patches.shape[2:]))
    i, j = (x.repeat(2) for x in np.divmod(np.arange(width * height), height))
    low = np.stack([grid.u[i], grid.v[j]], axis=1)
    size = np.stack([grid.u[i + 1], grid.v[j + 1]], axis=1) - low
    maps = [square_map(False, turned), square_map(True, turned)]
    trims = Trims(
        [curves],
        np.zeros(len(nets), dtype=int),
        np.tile(maps, (len(nets) // 2, 1, 1)),
        np.stack([low, size], axis=1),
        np.where(angular, size, 0.0),
    )
    corners = np.tile([[[1.0, 0], [0, 1], [0, 0]]], (len(nets), 1, 1))
    _cells, cell, keep = trim_cells(trims, np.arange(len(nets)), corners)
    if not keep.any():
        return "nothing is left inside of its trims"
    trims.region[cell < 0] = -1
    if turned:
        n = bernstein.degree_of(nets.shape[1])
        nets = nets[:, bernstein.permutation(n, (0, 2, 1))]
    return nets[keep], trims[keep]


def _cell_triangles(boundary: list[np.ndarray], domain: np.ndarray) -> list[np.ndarray] | str:
    """Fill the part of a region in one cell, in coordinates that make the cell a square."""
    low, size = domain[:, 0], domain[:, 1] - domain[:, 0]
    local = []
    for curve in boundary:
        c = curve.copy()
        c[:, :2] = (c[:, :2] - low * c[:, 2:]) / size
        local.append(c)
    loops = chain(local, 1e-4)
    if loops is None:
        return "its boundary is not closed"
    found = region_to_triangles(loops)
    if isinstance(found, str):
        return [] if "no area" in found else found
    for triangle in found:
        triangle[:, :2] = triangle[:, :2] * size + low * triangle[:, 2:]
    return found
