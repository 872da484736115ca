"""Intersections of lines with patches: points, and how far they are from being none.

Let `c` be the patch's centre and
``M(u, v) = sum |B_k| (|X_k - w_k c| + |w_k| |o - c|)``. It bounds both polynomials, and moving
control points, origin and direction by the relative amount ``eps`` changes them by at most
about ``2 eps M``. All margins but `edge` are such relative amounts. For `graze`, let ``sigma``
be the least singular value of the Jacobian at a root, ``N`` and ``r`` its left and right
vectors. Along ``r`` the map is ``N.F = sigma s + (N.F_rr) s^2 / 2``; the root and its twin
vanish together when ``F`` moves by ``sigma^2 / (2 |N.F_rr|)``, the distance to the silhouette.
A term for the third order keeps it finite near cusps. It is a first-order estimate: near
silhouettes of the sphere it gives 0.7 to 1.0 of the true distance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..geometry import bernstein
from .bivariate import NEAR_MISS, NOISE, SIMPLE
from .ray_polynomials import Patches, Rays

__all__ = ["Intersections", "describe"]


class Intersections(NamedTuple):
    """Intersections of lines with patches, sorted by ray, then by `t`; `R` rows.

    Attributes
    ----------
    ray, patch : (R,) int arrays
    uv : (R, 2) array
        Barycentric coordinates ``(u, v)``.
    t : (R,) array
        ``x = o + t d``, with `d` as given; ``inf`` where the point is at infinity.
    kind : (R,) int array
        `bivariate.SIMPLE` (certified the only root nearby), `DOUBLE` (tangent up to
        rounding), `UNRESOLVED` (a root that nothing isolates: a ray in the surface, a
        collapsed edge, a singular point). From `candidates` also the negative `NEAR_MISS`
        (a fold point near the ray) and `UNDECIDED` (somewhere near, a root may hide).
    inside : (R,) bool array
        In the patch, or out of it by no more than rounding.
    edge : (R,) array
        The least of the barycentric coordinates; negative outside.
    edge_shift : (R,) array
        Relative change that moves the root across the patch's boundary (first order).
    graze : (R,) array
        Relative change at which the root meets another, or a near miss becomes a hit.
    cosine : (R,) array
        Of the angle between `d` and the normal ``dp_du x dp_dv``; 0 if neither exists.
    scale : (R,) array
        The length that relative changes refer to, ``M/|w|``; ``inf`` at infinity.
    horizon : (R,) array
        Relative change that sends the point to infinity: of the weights (the weight over the
        sum of its absolute terms) or of the direction (the size of what is finite, ray's
        origin and control points, over the distance of the point).
    """

    ray: np.ndarray
    patch: np.ndarray
    uv: np.ndarray
    t: np.ndarray
    kind: np.ndarray
    inside: np.ndarray
    edge: np.ndarray
    edge_shift: np.ndarray
    graze: np.ndarray
    cosine: np.ndarray
    scale: np.ndarray
    horizon: np.ndarray

    @property
    def certain(self) -> np.ndarray:
        """Mask of the certified simple roots."""
        return self.kind == SIMPLE

    def select(self, index: Any) -> Intersections:
        """Return the rows chosen by a mask or an index array."""
        return Intersections(*(column[index] for column in self))


def describe(
    patches: Patches, rays: Rays, ray: np.ndarray, patch: np.ndarray, uv: np.ndarray, kind: Any
) -> Intersections:
    """Compute everything about given roots and near misses.

    Parameters
    ----------
    patches : Patches
    rays : Rays
    ray, patch : (R,) int arrays
        Which line meets which patch.
    uv : (R, 2) array
        Where.
    kind : (R,) int array
        What it is, see `Intersections`.

    Returns
    -------
    Intersections
        In the order given.
    """
    nets = patches.nets
    o = rays.o[ray] - patches.center[patch]
    h = np.stack(nets.partials(patch, uv), axis=1)  # (R, 6, 4)
    shifted = h[..., :3] - h[..., 3:] * o[:, None]
    f = np.stack(
        [np.einsum("rkc,rc->rk", shifted, axis[ray]) for axis in (rays.a, rays.b)], axis=1
    )  # (R, 2, 6)
    w = h[:, 0, 3]
    basis = np.abs(bernstein.basis(nets.degree, uv))
    weights = np.einsum("rk,rk->r", basis, np.abs(nets.weights)[patch])
    bound = np.einsum("rk,rk->r", basis, patches.size[patch])
    distance = np.linalg.norm(o, axis=1)
    bound += weights * distance
    # against the largest weight: it is the parameters whose rounding counts
    at_infinity = np.abs(w) <= NOISE * np.abs(nets.weights).max(axis=1)[patch]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("rc,rc->r", shifted[:, 0], rays.unit[ray]) / (w * rays.length[ray])
        scale = np.where(at_infinity, np.inf, bound / np.abs(w))
    t = np.where(at_infinity, np.inf, t)

    finite = distance + patches.finite[patch]
    with np.errstate(divide="ignore", over="ignore"):
        away = np.linalg.norm(h[:, 0, :3], axis=1) / np.abs(w)
    horizon = np.where(at_infinity, 0.0, finite / np.maximum(finite + away, 1e-300))
    horizon = np.minimum(horizon, np.abs(w) / np.maximum(weights, 1e-300))

    # boundary: F changes by |e| / |J^-T grad e| when the root moves to the line e = 0
    bary = np.column_stack([uv, 1.0 - uv.sum(axis=1)])
    edge = bary.min(axis=1)
    j = f[..., 1:3]
    det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
    adjugate = np.stack(
        [np.stack([j[:, 1, 1], -j[:, 0, 1]], 1), np.stack([-j[:, 1, 0], j[:, 0, 0]], 1)], axis=1
    )
    rows = np.concatenate([adjugate, -adjugate.sum(axis=1)[:, None]], axis=1)
    shift = np.abs(bary * det[:, None]) / np.maximum(np.linalg.norm(rows, axis=2), 1e-300)
    shift /= bound[:, None]
    out = bary < 0
    shift = np.where(out.any(axis=1), np.where(out, shift, 0.0).max(axis=1), shift.min(axis=1))
    near_miss = kind == NEAR_MISS
    simple = kind == SIMPLE
    # 1e-13 in parameters or in F is the rounding of a root on a shared edge; where the Jacobian
    # is singular that in F says nothing, and parameters are good to sqrt(eps)
    inside = (edge >= np.where(simple, -1e-13, -1e-7)) | (simple & (shift <= 1e-13))

    # fold: see the description of the module; a near miss is its distance away
    u, s, vt = np.linalg.svd(j)
    hessian = np.einsum("rp,rpk->rk", u[:, :, 1], f[..., 3:])
    n1, n2 = vt[:, 1].T
    bend = np.abs(n1**2 * hessian[:, 0] + 2 * n1 * n2 * hessian[:, 1] + n2**2 * hessian[:, 2])
    # near cusps the cubic term c s^3 / 6 counts: alone it gives (8 sigma^3 / 9 c)^(1/2), and
    # 0.53 joins the two; c is estimated from the size of the second derivatives
    most = np.sqrt((f[..., 3:] ** 2).sum(axis=(1, 2)))
    cubic = 3 * most * (most / np.maximum(s[:, 0], 1e-300) + nets.degree - 2)
    bend += 0.53 * np.sqrt(np.maximum(cubic, 0.0) * s[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        fold = np.where(bend > 0, s[:, 1] ** 2 / (2 * bend), np.inf)
    graze = np.where(near_miss, np.linalg.norm(f[..., 0], axis=1), fold)
    graze = np.where(simple | near_miss, graze / bound, 0.0)

    # normal: w (X_u x X_v) + w_u (X_v x X) + w_v (X x X_u) = w^3 dp_du x dp_dv
    x, xu, xv = h[:, 0, :3], h[:, 1, :3], h[:, 2, :3]
    parts = [w[:, None] * np.cross(xu, xv), h[:, 1, 3:] * np.cross(xv, x)]
    parts.append(h[:, 2, 3:] * np.cross(x, xu))
    normal = parts[0] + parts[1] + parts[2]
    # far away t comes from the tangent plane: the parameters, so near the line w = 0, lose
    # digits, but only the square of that loss counts here
    slope = np.einsum("rc,rc->r", normal, rays.unit[ray])
    height = np.einsum("rc,rc->r", normal, o) - np.einsum("rc,rc->r", x, np.cross(xu, xv))
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = -height / (slope * rays.length[ray])
    t = np.where((horizon < 1e-3) & ~at_infinity & np.isfinite(tangent), tangent, t)
    normal *= np.where(w < 0, -1.0, 1.0)[:, None]
    length = np.linalg.norm(normal, axis=1)
    # 1e-9: as in BezierTriangles.normals, which takes the limit from the inside
    weak = length <= 1e-9 * sum(np.linalg.norm(part, axis=1) for part in parts)
    normal /= np.maximum(length, 1e-300)[:, None]
    limit = np.flatnonzero(weak & ~at_infinity)
    if len(limit):
        normal[limit] = np.nan_to_num(nets.normals(patch[limit], uv[limit]))
    cosine = np.einsum("rc,rc->r", normal, rays.unit[ray])
    cosine = np.clip(cosine, -1, 1)
    return Intersections(
        ray, patch, uv, t, kind, inside, edge, shift, graze, cosine, scale, horizon
    )
