"""Trimming loops along parameter lines: which patches of a surface they leave.

A loop whose edges all run along parameter lines cuts the domain into rectangles. The surface is
cut at every parameter that occurs in a loop, and each rectangle is then inside or outside as a
whole, so the trimmed face is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .nurbs import check_knots, surface_to_bezier

__all__ = ["MAX_CELLS", "parameter_line", "rectangles", "rectilinear", "trimmed"]

#: A loop of n edges cuts into up to n^2 / 4 patches: a small file must not fill the memory.
MAX_CELLS = 100_000

#: Each edge is compared with each patch: some four seconds.
_MAX_TESTS = 10**9


def parameter_line(points: np.ndarray, tolerance: np.ndarray) -> np.ndarray | None:
    """Return the end points of a curve along a parameter line, None for other curves.

    Parameters
    ----------
    points : (m, 2) array
        Control points in (u, v), Euclidean: a curve lies in their convex hull.
    tolerance : (2,) array
        How far a control point may be off, in u and in v.

    Returns
    -------
    (2, 2) array or None
        First and last point, with the constant coordinate made equal.
    """
    spread = np.ptp(points, axis=0)
    fixed = spread <= tolerance
    if not fixed.any():
        return None
    ends = points[[0, -1]].copy()
    for axis in range(2):
        if fixed[axis]:
            ends[:, axis] = points[:, axis].mean()
    return ends


def rectilinear(loops: list[list[np.ndarray]], tolerance: np.ndarray) -> list[np.ndarray] | None:
    """Return loops as axis-parallel polygons ``(m, 2, 2)`` of edges, None if one is curved.

    Parameters
    ----------
    loops : list of list of (m, 2) arrays
        For each loop, the control points of its curves in order.
    tolerance : (2,) array
        As for `parameter_line`.
    """
    out = []
    for loop in loops:
        edges = []
        for points in loop:
            ends = parameter_line(points, tolerance)
            if ends is None:
                return None
            edges.append(ends)
        out.append(np.array(edges).reshape(-1, 2, 2))
    return out


def _cuts(edges: list[np.ndarray], knots: np.ndarray, tolerance: float, axis: int) -> np.ndarray:
    """Return the distinct coordinates of the edges; those near a knot are replaced by it."""
    values = np.unique(np.concatenate([e[..., axis].ravel() for e in edges]))
    if len(knots):
        after = np.clip(np.searchsorted(knots, values), 1, len(knots) - 1)
        near = knots[after - (values - knots[after - 1] <= knots[after] - values)]
        values = np.unique(np.where(np.abs(values - near) <= tolerance, near, values))
    # values closer to each other than the tolerance are one cut
    return values[np.concatenate([[True], np.diff(values) > tolerance])]


def _inside(points: np.ndarray, edges: list[np.ndarray]) -> np.ndarray:
    """Return a mask of the points ``(N, 2)`` inside axis-parallel loops, by the even-odd rule."""
    crossings = np.zeros(len(points), int)
    for u0, v0, u1, v1 in np.concatenate(edges).reshape(-1, 4):
        if u0 == u1:
            low, high = min(v0, v1), max(v0, v1)
            crossings += (u0 > points[:, 0]) & (low <= points[:, 1]) & (points[:, 1] < high)
    return crossings % 2 == 1


def rectangles(edges: list[np.ndarray], tolerance: np.ndarray) -> np.ndarray | str:
    """Cut the inside of axis-parallel loops into rectangles.

    Parameters
    ----------
    edges : list of (k, 2, 2) arrays
        The loops, as `rectilinear` returns them.
    tolerance : (2,) array
        Cuts closer than that, in u and in v, are one.

    Returns
    -------
    (R, 2, 2) array, or str
        ``[[u0, u1], [v0, v1]]`` of each; or the reason why there are none. A row of rectangles
        that share whole sides along u is one rectangle.
    """
    nothing = np.zeros(0)
    cut_u, cut_v = (_cuts(edges, nothing, tolerance[axis], axis) for axis in range(2))
    if len(cut_u) * len(cut_v) > MAX_CELLS:
        return f"its trims cut it into more than {MAX_CELLS} patches"
    u, v = (cut_u[:-1] + cut_u[1:]) / 2, (cut_v[:-1] + cut_v[1:]) / 2
    centers = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    left = _inside(centers, edges).reshape(len(u), len(v))
    out = []
    start = 0
    for i in range(len(u)):
        if i + 1 < len(u) and np.array_equal(left[i], left[i + 1]):
            continue  # the cut between the two is none for this row
        column = np.concatenate([[False], left[i], [False]])
        changes = np.flatnonzero(column[1:] != column[:-1])
        for low, high in zip(changes[::2], changes[1::2]):
            out.append([[cut_u[start], cut_u[i + 1]], [cut_v[low], cut_v[high]]])
        start = i + 1
    return np.array(out) if out else "nothing is left inside of its trims"


def trimmed(
    net: np.ndarray,
    knots: tuple[Any, Any],
    degrees: tuple[int, int],
    edges: list[np.ndarray],
    tolerance: np.ndarray,
    expect: Callable[[int], None] | None = None,
) -> np.ndarray | str:
    """Return the Bézier patches of a NURBS surface inside of loops along parameter lines.

    Parameters
    ----------
    net : (m, n, 4) array
        Homogeneous control points.
    knots : pair of array_like
        The knots along u and along v.
    degrees : (int, int)
        The degrees along u and along v.
    edges : list of (k, 2, 2) arrays
        The loops, as `rectilinear` returns them.
    tolerance : (2,) array
        Cuts closer than that, in u and in v, are one.
    expect : callable, optional
        Told the number of patches before they are made.

    Returns
    -------
    (S, p+1, q+1, 4) array, or str
        The patches, or the reason why there are none.

    Raises
    ------
    GeometryError
        If the knots do not fit.
    """
    knots_u = check_knots(knots[0], degrees[0], net.shape[0], "knots_u")
    knots_v = check_knots(knots[1], degrees[1], net.shape[1], "knots_v")
    cut_u = _cuts(edges, np.unique(knots_u), tolerance[0], 0)
    cut_v = _cuts(edges, np.unique(knots_v), tolerance[1], 1)
    if (len(cut_u) + net.shape[0]) * (len(cut_v) + net.shape[1]) > MAX_CELLS + net[..., 0].size:
        return f"its trims cut it into more than {MAX_CELLS} patches"
    cells = _cells(knots_u, degrees[0], cut_u) * _cells(knots_v, degrees[1], cut_v)
    if expect is not None:
        expect(cells)
    if cells * sum(map(len, edges)) > _MAX_TESTS:
        return f"its trims have too many edges for its {cells} patches"
    patches, domains = surface_to_bezier(net, knots_u, knots_v, degrees, (cut_u, cut_v))
    left = _inside(domains.mean(axis=2), edges)
    return patches[left] if left.any() else "nothing is left inside of its range and trims"


def _cells(knots: np.ndarray, degree: int, cuts: np.ndarray) -> int:
    """Return the number of intervals along an axis."""
    domain = knots[degree : len(knots) - degree]
    return len(np.unique(np.concatenate([domain, np.clip(cuts, domain[0], domain[-1])]))) - 1
