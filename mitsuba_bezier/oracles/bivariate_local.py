"""Local numerics for `bivariate`: Newton's method, least squares, the fold criterion.

Everything works on `M` pairs of polynomials of one degree at once. A piece ``(c, h)`` of the
domain is the triangle with the corners ``c + h (1, 0)``, ``c + h (0, 1)`` and ``c``.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from ..geometry import bernstein

__all__ = [
    "NOISE",
    "adjugate",
    "evaluate",
    "fold_points",
    "hull_distance",
    "is_fold",
    "least_squares",
    "local",
    "matrices",
    "newton",
]

#: Rounding of a coefficient relative to the problem's scale: some 25 splits of 2 eps each,
#: doubled.
NOISE = 128 * np.finfo(float).eps


class Matrices(NamedTuple):
    split: np.ndarray  # (4K, K)
    center: np.ndarray  # (2, K): d/ds, d/dt at the centroid
    first: np.ndarray  # (2 K_{n-1}, K): nets of d/ds, d/dt on E
    second: np.ndarray  # (3 K_{n-2}, K): nets of the second partials on E


@cache
def matrices(n: int) -> Matrices:
    enlarged = 2.0 * np.eye(3) - 1 / 3  # corners of E in barycentrics of T
    du, dv = bernstein.partials_matrices(n)
    on_e = bernstein.subdivision_matrix(n - 1, enlarged)
    centroid = bernstein.basis(n - 1, np.full(2, 1 / 3))
    second = np.zeros((0, bernstein.size(n)))
    if n >= 2:
        du1, dv1 = bernstein.partials_matrices(n - 1)
        e2 = bernstein.subdivision_matrix(n - 2, enlarged)
        second = np.concatenate([e2 @ du1 @ du, e2 @ du1 @ dv, e2 @ dv1 @ dv])
    return Matrices(
        bernstein.split_matrices(n).reshape(-1, bernstein.size(n)),
        np.stack([centroid @ du, centroid @ dv]),
        np.concatenate([on_e @ du, on_e @ dv]),
        second,
    )


def evaluate(f: np.ndarray, uv: np.ndarray, order: int) -> np.ndarray:
    """Return ``(M, 2, R)``: value, u, v and for ``order = 2`` uu, uv, vv of each polynomial."""
    n = bernstein.degree_of(f.shape[-1], "f")
    du, dv = bernstein.partials_matrices(n)
    b1 = bernstein.basis(n - 1, uv)
    rows = [bernstein.basis(n, uv), b1 @ du, b1 @ dv]
    if order == 2:
        if n >= 2:
            du1, dv1 = bernstein.partials_matrices(n - 1)
            b2 = bernstein.basis(n - 2, uv)
            rows += [b2 @ (du1 @ du), b2 @ (du1 @ dv), b2 @ (dv1 @ dv)]
        else:
            rows += [np.zeros_like(rows[0])] * 3
    return f @ np.stack(rows, axis=2)


def local(x: np.ndarray, c: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return the least barycentric coordinate of `x` in the pieces ``(c, h)``."""
    s = (x - c) / h[:, None]
    return np.minimum(s.min(axis=1), 1.0 - s.sum(axis=1))


def _solve2(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve 2x2 systems; where the determinant is zero the result is huge, never NaN."""
    det = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0]
    det = np.where(np.abs(det) < 1e-140, 1e-140, det)
    x = a[:, 1, 1] * b[:, 0] - a[:, 0, 1] * b[:, 1]
    y = a[:, 0, 0] * b[:, 1] - a[:, 1, 0] * b[:, 0]
    return np.stack([x, y], axis=1) / det[:, None]


def adjugate(a: np.ndarray) -> np.ndarray:
    """Return the adjugates of 2x2 matrices ``(..., 2, 2)``."""
    out = np.empty_like(a)
    out[..., 0, 0], out[..., 0, 1] = a[..., 1, 1], -a[..., 0, 1]
    out[..., 1, 0], out[..., 1, 1] = -a[..., 1, 0], a[..., 0, 0]
    return out


def hull_distance(f: np.ndarray) -> np.ndarray:
    """Bound the distance of the origin from the convex hulls of points, from below.

    The sign test for all linear combinations at once: if the points, seen from the origin,
    fill an angle below a half turn, those with the extreme directions are as far as all
    others or further on the near side of the angle's bisector.

    Parameters
    ----------
    f : (M, 2, K) array
        `K` points in the plane each.

    Returns
    -------
    (M,) array
        Not positive if the origin may lie in the hull; else at least half the distance for
        points on one line, less for hulls that come closer between the extreme directions.
    """
    mean = f.mean(axis=2)
    x = f[:, 0] * mean[:, :1] + f[:, 1] * mean[:, 1:]
    y = f[:, 1] * mean[:, :1] - f[:, 0] * mean[:, 1:]
    # a rational function that grows with the angle from the mean, from -2 to 2
    angle = y / np.maximum(np.abs(x) + np.abs(y), 1e-300)
    angle = np.where(x < 0, np.copysign(2.0, y) - angle, angle)
    row = np.arange(len(f))
    bisector = np.zeros_like(mean)
    for k in (angle.argmin(axis=1), angle.argmax(axis=1)):
        extreme = f[row, :, k]
        bisector += extreme / np.maximum(np.linalg.norm(extreme, axis=1), 1e-300)[:, None]
    bisector /= np.maximum(np.linalg.norm(bisector, axis=1), 1e-300)[:, None]
    return (f[:, 0] * bisector[:, :1] + f[:, 1] * bisector[:, 1:]).min(axis=1)


def _clip(step: np.ndarray, longest: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(step, axis=1)
    return step * np.minimum(1.0, longest / np.maximum(length, 1e-300))[:, None]


def newton(f: np.ndarray, x: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton's method; returns the points and whether each has converged.

    Converged means a last step below ``1e-3 size`` with a residual at rounding level.
    """
    x = x.copy()
    last = np.full(len(x), np.inf)
    residual = np.full(len(x), np.inf)
    todo = np.arange(len(x))
    for _ in range(16):
        e = evaluate(f[todo], x[todo], 1)
        # twice the size: the step from a centroid to anywhere in E is shorter
        step = _clip(_solve2(e[..., 1:], -e[..., 0]), 2.0 * size[todo])
        x[todo] += step
        last[todo] = np.linalg.norm(step, axis=1)
        residual[todo] = np.abs(e[..., 0]).max(axis=1)
        # 4 eps: the spacing of coordinates of order one
        todo = todo[last[todo] > 4 * np.finfo(float).eps]
        if not len(todo):
            break
    # the residual is that before the last step, and |x| may reach 2 outside the triangle
    return x, (last <= 1e-3 * size) & (residual <= np.maximum(1e3 * NOISE, last))


def least_squares(f: np.ndarray, c: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimise ``|F|`` from the centroid, inside `E`; returns points and ``|F|`` there."""
    x = c + h[:, None] / 3
    damping = np.full(len(x), 1e-3)
    e = evaluate(f, x, 1)
    value = np.linalg.norm(e[..., 0], axis=1)
    todo = np.arange(len(x))
    for _ in range(60):
        # by singular values: in a narrow valley the normal equations lose what matters
        u, sigma, vt = np.linalg.svd(e[todo, :, 1:])
        along = np.einsum("mpi,mp->mi", u, e[todo, :, 0])
        along *= sigma / (sigma**2 + (damping[todo] * sigma[:, 0] ** 2 + 1e-300)[:, None])
        step = _clip(-np.einsum("mi,mid->md", along, vt), np.abs(h[todo]))
        trial = x[todo] + step
        there = evaluate(f[todo], trial, 1)
        new = np.linalg.norm(there[..., 0], axis=1)
        better = (new < value[todo]) & (local(trial, c[todo], h[todo]) >= -1 / 3)
        at = todo[better]
        x[at], e[at], value[at] = trial[better], there[better], new[better]
        damping[todo] = np.where(better, damping[todo] * 0.1, damping[todo] * 8.0)
        # a root, or no step that is worth taking
        moving = np.linalg.norm(step, axis=1) > 1e-12 * np.abs(h[todo])
        todo = todo[(new > NOISE) & moving & (damping[todo] < 1e8)]
        if not len(todo):
            break
    return x, value


def is_fold(f: np.ndarray, jacobian: np.ndarray, d1: np.ndarray) -> np.ndarray:
    """Return a mask of the pieces that pass the fold criterion of the module's description.

    Parameters
    ----------
    f : (M, 2, K) array
        Coefficients on the pieces.
    jacobian : (M, 2, 2) array
        Jacobians at the centroids, rows the polynomials.
    d1 : (M, 2, 2, K_{n-1}) array
        Nets of the first partials on `E`.
    """
    out = np.zeros(len(f), dtype=bool)
    u, _s, vt = np.linalg.svd(jacobian)
    turned = np.einsum("mpi,mpdk,med->miek", u, d1, vt)
    least = turned[:, 0, 0].min(axis=1)
    most = np.abs(turned[:, 0, 1]).max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = most / least
    # 1/8: a graph of this slope between a point of T and one of T enlarged 1.5 times (where
    # the fold point is looked for) stays in E, so the part of the curve that counts is one
    go = np.flatnonzero((least > 0) & (slope <= 1 / 8))
    if not len(go):
        return out
    n = bernstein.degree_of(f.shape[-1], "f")
    u, vt, turned, slope, least = u[go], vt[go], turned[go], slope[go], least[go]
    d2 = (f[go] @ matrices(n).second.T).reshape(len(go), 2, 3, -1)
    d2 = np.einsum("mpi,mpdk->midk", u, d2)
    (a, b), (c, d) = vt[:, 0].T, vt[:, 1].T
    forms = np.stack(
        [
            np.stack([a * a, 2 * a * b, b * b], axis=1),
            np.stack([a * c, a * d + b * c, b * d], axis=1),
            np.stack([c * c, 2 * c * d, d * d], axis=1),
        ],
        axis=1,
    )
    d2 = np.einsum("mhd,mpdk->mphk", forms, d2)
    size = np.abs(d2).max(axis=3)  # (M, 2, 3): 11, 12, 22 of f and of g
    g22 = d2[:, 1, 2]
    bend = np.where(g22.min(axis=1) > 0, g22.min(axis=1), -g22.max(axis=1))
    g1 = np.abs(turned[:, 1, 0]).max(axis=1)

    # along the curve: g22 + 2 m g12 + m^2 g11 + g1 c'', m the slope, with
    # c'' = -(f22 + 2 m f12 + m^2 f11) / f1
    def along(p: int) -> np.ndarray:
        return 2 * slope * size[:, p, 1] + slope**2 * size[:, p, 0]

    rest = along(1) + g1 / least * (size[:, 0, 2] + along(0))
    # 16 n^2 eps: the rounding of a second derivative
    out[go] = bend > rest + 16 * n**2 * np.finfo(float).eps
    return out


def fold_points(
    f: np.ndarray, c: np.ndarray, h: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the points of the curves ``f_1 = 0`` where the Jacobian is singular.

    Returns
    -------
    x : (M, 2) array
        The fold points, by Newton on ``(u.F, det DF) = 0``, `u` the left singular vector of
        the Jacobian at the centroid.
    near : (M,) bool array
        Converged, in the piece enlarged 1.5 times.
    offset, bend : (M,) arrays
        ``N.F`` and its second derivative along `null`, with `N` the left null vector: from
        the fold point the image goes as ``offset + bend s^2 / 2``.
    null : (M, 2) array
        The right null vectors.
    """
    size = np.abs(h)
    x = c + h[:, None] / 3
    u0 = np.linalg.svd(evaluate(f, x, 1)[..., 1:])[0][:, :, 0]
    step = np.zeros_like(x)
    for _ in range(12):
        e = evaluate(f, x, 2)
        fu, fv = e[..., 1], e[..., 2]
        det = fu[:, 0] * fv[:, 1] - fv[:, 0] * fu[:, 1]
        grad = (
            e[:, 0, 3:5] * fv[:, 1:]
            + fu[:, :1] * e[:, 1, 4:6]
            - e[:, 0, 4:6] * fu[:, 1:]
            - fv[:, :1] * e[:, 1, 3:5]
        )
        line = np.einsum("mp,mpr->mr", u0, e[..., :3])
        a = np.stack([line[:, 1:], grad], axis=1)
        step = _clip(_solve2(a, -np.stack([line[:, 0], det], axis=1)), size)
        x = x + step
    near = (np.linalg.norm(step, axis=1) <= 1e-6 * size) & (local(x, c, h) >= -1 / 6)
    e = evaluate(f, x, 2)
    u, _s, vt = np.linalg.svd(e[..., 1:3])
    left, null = u[:, :, 1], vt[:, 1]
    offset = np.einsum("mp,mp->m", left, e[..., 0])
    hessian = np.einsum("mp,mpr->mr", left, e[..., 3:])
    form = np.stack([null[:, 0] ** 2, 2 * null[:, 0] * null[:, 1], null[:, 1] ** 2], axis=1)
    return x, near, offset, (hessian * form).sum(axis=1), null
