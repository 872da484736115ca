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


#: Most parabolas for one piece of a curve, and how often a piece is halved.
_MAX_PARABOLAS = 512
_HALVINGS = 12


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
        Homogeneous Bézier points; None if more than `_MAX_PARABOLAS` would be needed.
    """
    bounds = np.arange(start + 1) / start
    todo = np.stack([bounds[:-1], bounds[1:]], axis=1)
    done: list[np.ndarray] = []
    parabolas: list[np.ndarray] = []
    # all pieces of a round together: many places of a curve cost little more than one
    for depth in range(_HALVINGS + 1):
        fitted, good = _parabolas(evaluate, todo, scale, tolerance)
        good |= depth == _HALVINGS
        done.append(todo[good])
        parabolas.append(fitted[good])
        rest = todo[~good]
        if sum(map(len, done)) + 2 * len(rest) > _MAX_PARABOLAS:
            return None
        if not len(rest):
            break
        middle = rest.mean(axis=1)
        todo = np.concatenate(
            [np.stack([rest[:, 0], middle], axis=1), np.stack([middle, rest[:, 1]], axis=1)]
        )
    order = np.argsort(np.concatenate(done)[:, 0])
    found = np.concatenate(parabolas)[order]
    return list(np.concatenate([found, np.ones((len(found), 3, 1))], axis=2))


def _parabolas(
    evaluate: Callable[[np.ndarray], np.ndarray],
    pieces: np.ndarray,
    scale: np.ndarray,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return a parabola ``(N, 3, 2)`` for each of the pieces ``(N, 2)``, and which are close."""
    a, size = pieces[:, :1], pieces[:, 1:] - pieces[:, :1]
    # h: differences of second order have the error h^2, and rounding 1e-16 / h
    h = 1e-5
    t = a + size * np.array([0, 0.25, 0.5, 0.75, 1, h, 2 * h, 1 - h, 1 - 2 * h])
    x = evaluate(t.ravel()).reshape(*t.shape, 2)
    middle = 2 * x[:, 2] - (x[:, 0] + x[:, 4]) / 2
    met, usable = _tangents_meet(x[:, [0, 5, 6]], x[:, [4, 7, 8]], scale)
    middle[usable] = met[usable]
    s = np.array([[0.25], [0.5], [0.75]])
    first, last = x[:, :1], x[:, 4:5]
    fitted = (1 - s) ** 2 * first + 2 * s * (1 - s) * middle[:, None] + s**2 * last
    off = (x[:, 1:4] - fitted) * scale
    tangent = (x[:, 2:5] - x[:, :3]) * scale
    length = np.linalg.norm(tangent, axis=2, keepdims=True)
    tangent = tangent / np.maximum(length, 1e-300)
    across = off[..., 0] * tangent[..., 1] - off[..., 1] * tangent[..., 0]
    # along the curve the error may be larger, but must stay small against the piece
    along = np.linalg.norm(off, axis=2).max(axis=1)
    good = np.abs(across).max(axis=1) <= tolerance
    good &= along <= 0.05 * length.min(axis=(1, 2)) + tolerance
    return np.stack([x[:, 0], middle, x[:, 4]], axis=1), good


def _tangents_meet(
    start: np.ndarray, stop: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the tangents at the ends of pieces meet, and for which well between them.

    With it as control point the pieces join smoothly, and two curves that touch still do.

    Parameters
    ----------
    start, stop : (N, 3, 2) arrays
        The end, and two points at equal distances from it.
    """
    weights = np.array([[-3.0], [4.0], [-1.0]])
    out, back = ((weights * x).sum(axis=1) * scale for x in (start, stop))
    chord = (stop[:, 0] - start[:, 0]) * scale

    def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    det = cross(back, out)
    lengths = np.linalg.norm(out, axis=1), np.linalg.norm(back, axis=1)
    # tangents within 1e-4 of parallel do not say where they meet
    usable = np.abs(det) > 1e-4 * lengths[0] * lengths[1]
    det = np.where(usable, det, 1.0)
    along, other = cross(back, chord) / det, cross(out, chord) / det
    length = np.linalg.norm(chord, axis=1)
    reach = np.stack([along * lengths[0], other * lengths[1]])
    usable &= (reach.min(axis=0) > 0.05 * length) & (reach.max(axis=0) < length)
    return start[:, 0] + along[:, None] * out / scale, usable


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
