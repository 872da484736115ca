"""Curves in space that lie on a surface, as curves in its parameters.

For each of some places along the curve the nearest points of the surface are sought from several
starts, all at once, by damped Gauss-Newton steps; the way through them that goes on without jumps
is the curve. On a surface that is closed it may leave the period in which it began.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ..nurbs_surface import PatchGrid, bezier_points
from .closed_surfaces import ClosedAxes

__all__ = ["foot_points", "grid_axes", "pulled_back"]

#: Places on each piece of a curve whose feet are found.
_PLACES = 65
#: Places on a curve at which the nearest point is sought on all of the surface.
_SOUGHT = 65
#: Starts for each of them.
_STARTS = 5


def grid_axes(grid: PatchGrid) -> ClosedAxes:
    """Return along which parameters a surface is closed, and where it has poles."""
    places = np.linspace(0, 1, 14)[1:-1]
    period = np.zeros(2)
    poles: tuple[list[float], list[float]] = ([], [])
    near = 1e-7 * grid.size  # far below what programs join, far above rounding
    sides: list[list[np.ndarray]] = []
    for axis in range(2):
        low, high = grid.domain[1 - axis]
        along = low + (high - low) * places
        lines = [np.full_like(along, end) for end in grid.domain[axis]]
        pairs = [(x, along) if axis == 0 else (along, x) for x in lines]
        sides.append([grid.jet(np.stack(pair, axis=1))[0] for pair in pairs])
        if np.abs(sides[axis][0] - sides[axis][1]).max() <= near:
            period[axis] = grid.domain[axis, 1] - grid.domain[axis, 0]
    for axis in range(2):
        if period[1 - axis] and not period[axis]:
            for value, side in zip(grid.domain[axis].tolist(), sides[axis]):
                if np.ptp(side, axis=0).max() <= near:
                    poles[axis].append(value)
    return ClosedAxes(grid.domain[:, 0].copy(), period, poles)


def _wrapped(uv: np.ndarray, axes: ClosedAxes) -> np.ndarray:
    out = uv.copy()
    for axis in range(2):
        if axes.period[axis]:
            turns = np.floor((uv[:, axis] - axes.low[axis]) / axes.period[axis])
            out[:, axis] -= turns * axes.period[axis]
    return out


def foot_points(
    grid: PatchGrid, axes: ClosedAxes, points: np.ndarray, guess: np.ndarray, steps: int = 60
) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters ``(N, 2)`` of the nearest points of a surface, near guesses.

    Parameters
    ----------
    grid : PatchGrid
        The surface.
    axes : ClosedAxes
        Along a closed axis the parameters go on beyond the period.
    points, guess : (N, 3) and (N, 2) arrays
        The points, and where to start.
    steps : int
        At most so many: a start far off takes some twenty, a good one three.

    Returns
    -------
    uv, distance : (N, 2) and (N,) arrays
    """
    open_axis = axes.period == 0
    low, high = np.where(open_axis, grid.domain.T, [[-np.inf] * 2, [np.inf] * 2])
    uv = np.clip(guess, low, high)
    damping = np.full(len(uv), 1e-4 if steps > 3 else 1e-10)
    p, du, dv = grid.jet(_wrapped(uv, axes))
    r = points - p
    square = np.einsum("ni,ni->n", r, r)
    for _ in range(steps):
        j = np.stack([du, dv], axis=1)
        normal = j @ np.swapaxes(j, 1, 2)
        slope = np.einsum("nai,ni->na", j, r)
        held = ((uv <= low) & (slope < 0)) | ((uv >= high) & (slope > 0))
        slope[held] = 0
        normal[held[:, 0] | held[:, 1], 0, 1] = 0
        normal[held[:, 0] | held[:, 1], 1, 0] = 0
        a, b, c = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
        # at a pole one parameter has no effect: the damping keeps it where it is
        extra = (damping + 1e-15) * np.maximum(np.maximum(a, c), 1e-300)
        a, c = a + extra, c + extra
        det = a * c - b * b
        step = np.stack([c * slope[:, 0] - b * slope[:, 1], a * slope[:, 1] - b * slope[:, 0]], 1)
        new = np.clip(uv + step / det[:, None], low, high)
        p, du_new, dv_new = grid.jet(_wrapped(new, axes))
        r_new = points - p
        square_new = np.einsum("ni,ni->n", r_new, r_new)
        better = square_new <= square
        moved = np.abs(new - uv).max(initial=0.0)
        uv = np.where(better[:, None], new, uv)
        r, square = np.where(better[:, None], r_new, r), np.where(better, square_new, square)
        du, dv = np.where(better[:, None], du_new, du), np.where(better[:, None], dv_new, dv)
        damping = np.where(better, damping * 1e-2, np.maximum(damping, 1e-8) * 10)
        if moved <= 1e-14 * (np.abs(uv).max(initial=0.0) + 1):
            break
    return uv, np.sqrt(square)


def _starts(grid: PatchGrid, points: np.ndarray) -> np.ndarray:
    """Return the nearest of some points of every patch that no neighbour is nearer than."""
    t = np.linspace(0, 1, 7)
    u, v = (np.unique((b[:-1, None] + np.diff(b)[:, None] * t).ravel()) for b in (grid.u, grid.v))
    places = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    surface = grid.jet(places)[0]
    out = np.empty((len(points), _STARTS, 2))
    for k, point in enumerate(points):
        gap = np.linalg.norm(surface - point, axis=1).reshape(len(u), len(v))
        padded = np.pad(gap, 1, constant_values=np.inf)
        around = [
            padded[1 + i : 1 + i + len(u), 1 + j : 1 + j + len(v)]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if i or j
        ]
        lowest = np.flatnonzero((gap <= np.min(around, axis=0)).ravel())
        best = lowest[np.argsort(gap.ravel()[lowest], kind="stable")[:_STARTS]]
        out[k] = places[np.resize(best, _STARTS)]
    return out


def pulled_back(
    grid: PatchGrid, axes: ClosedAxes, curves: np.ndarray
) -> tuple[list[Callable[[np.ndarray], np.ndarray]], float]:
    """Return the maps from parameters ``(N,)`` of the pieces of a curve on a surface to ``(N, 2)``.

    Parameters
    ----------
    grid : PatchGrid
    axes : ClosedAxes
    curves : (S, n+1, 4) array
        A chain of rational Bézier curves.

    Returns
    -------
    places : list of callable
        One for each piece. They interpolate feet at 65 places and go on from there, with three
        steps: exact to rounding.
    off : float
        How far the curve is from the surface, at most.
    """
    t = np.linspace(0, 1, _PLACES)
    points = np.concatenate([bezier_points(curve, t) for curve in curves])
    # a long chain has a few places on each piece where feet are sought everywhere
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), _SOUGHT)).astype(int))
    coarse = _feet(grid, axes, points[chosen])
    every = np.arange(len(points))
    guess = np.stack([np.interp(every, chosen, coarse[:, axis]) for axis in range(2)], axis=1)
    table, gap = foot_points(grid, axes, points, guess)
    # where going on from neighbours has found another place than the nearest
    lost = gap > np.interp(every, chosen, gap[chosen]) + 1e-6 * grid.size
    if lost.any():
        sought = np.union1d(chosen, np.flatnonzero(lost))
        guess[sought] = _feet(grid, axes, points[sought])
        table, gap = foot_points(grid, axes, points, guess)
    _smooth_poles(grid, axes, table)
    parts = table.reshape(len(curves), _PLACES, 2)
    maps: list[Callable[[np.ndarray], np.ndarray]] = [
        partial(_foot, grid, axes, curve, part) for curve, part in zip(curves, parts)
    ]
    return maps, float(gap.max())


def _foot(
    grid: PatchGrid, axes: ClosedAxes, curve: np.ndarray, table: np.ndarray, s: np.ndarray
) -> np.ndarray:
    return foot_points(grid, axes, bezier_points(curve, s), _interpolated(table, s), 3)[0]


def _interpolated(table: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return values between those at 65 places, by polynomials of degree 5."""
    at = np.clip(s, 0, 1) * (_PLACES - 1)
    first = np.clip(np.floor(at).astype(int) - 2, 0, _PLACES - 6)
    x = at - first
    out = np.zeros((len(at), 2))
    for k in range(6):
        weight = np.ones(len(at))
        for j in range(6):
            if j != k:
                weight *= (x - j) / (k - j)
        out += weight[:, None] * table[first + k]
    return out


def _feet(grid: PatchGrid, axes: ClosedAxes, points: np.ndarray) -> np.ndarray:
    """Return the nearest points of a surface to places in order along a curve, without jumps."""
    count = len(points)
    starts = _starts(grid, points)
    uv, gap = foot_points(grid, axes, np.repeat(points, _STARTS, axis=0), starts.reshape(-1, 2))
    uv, gap = uv.reshape(count, _STARTS, 2), gap.reshape(count, _STARTS)
    # feet as near as the nearest are worth the same: a millionth of the surface
    good = gap <= gap.min(axis=1, keepdims=True) + 1e-6 * grid.size
    table = np.empty((count, 2))
    # from the middle outwards: at the ends there may be a seam or a pole
    middle = count // 2
    table[middle] = uv[middle, np.argmin(gap[middle])]
    size = grid.domain[:, 1] - grid.domain[:, 0]
    period = np.where(axes.period > 0, axes.period, 1.0)
    for way in (range(middle + 1, count), range(middle - 1, -1, -1)):
        last = table[middle]
        for k in way:
            choice = uv[k, good[k]]
            turns = np.where(axes.period > 0, np.round((last - choice) / period), 0.0)
            choice = choice + turns * period
            last = choice[np.argmin(np.abs((choice - last) / size).max(axis=1))]
            table[k] = last
    _smooth_poles(grid, axes, table)
    return table


def _smooth_poles(grid: PatchGrid, axes: ClosedAxes, table: np.ndarray) -> None:
    """Where a parameter has no effect, as at a pole, go on as the neighbours do."""
    _p, du, dv = grid.jet(_wrapped(table, axes))
    lengths = np.linalg.norm(np.stack([du, dv]), axis=2)
    for axis in range(2):
        dead = lengths[axis] <= 1e-9 * lengths[axis].max()
        for end, one, two in ((0, 1, 2), (-1, -2, -3)):
            if dead[end] and not dead[one]:
                table[end, axis] = 2 * table[one, axis] - table[two, axis]
