"""The slow but sure intersector of rays and Bézier triangles, in float64: an oracle.

A line is the meet of two planes. Put into the net they give two polynomials whose common
roots are the intersections; `bivariate` finds all of them. Nothing is divided by a weight
before the end, so weights of any sign, control vectors and patches that run through the
plane at infinity need no care of their own.

What a comparison must leave out. Let `c` be the patch's centre and
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

from . import bernstein
from .bivariate import NEAR_MISS, NOISE, SIMPLE, UNDECIDED, Roots, common_roots
from .ray_polynomials import Patches, Rays, problems
from .triangles import BezierTriangles

__all__ = ["FirstHits", "Intersections", "Margin", "candidates", "first_hit", "intersect_all"]


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
        Relative change of the weights that sends the point to infinity: the weight over the
        sum of its absolute terms.
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


class Margin(NamedTuple):
    """How far each ray's first hit is from a different answer; ``inf``: nothing near.

    Attributes
    ----------
    edge : (N,) array
        Distance in barycentric coordinates from the boundary of a patch: of the hit, and of
        roots in front of it that lie just outside (up to the `extend` of `first_hit`).
    edge_shift : (N,) array
        The same as a relative change.
    graze : (N,) array
        Relative change at which the hit meets its twin at a fold, or a near miss in front
        becomes a hit.
    range : (N,) array
        Relative distance in `t` from `tmin` or `tmax`; where `tmax` is ``inf``, that of the
        hit (of any root, if the ray misses) from the plane at infinity.
    cosine : (N,) array
        ``|cos|`` of the angle between ray and normal at the hit; ``inf`` for a miss.
    scale : (N,) array
        Length that relative changes refer to, at the hit; ``inf`` for a miss.
    certain : (N,) bool array
        No tangent or unresolved root can change the answer.
    """

    edge: np.ndarray
    edge_shift: np.ndarray
    graze: np.ndarray
    range: np.ndarray
    cosine: np.ndarray
    scale: np.ndarray
    certain: np.ndarray

    def decidable(self, eps: float, edge: float = 0.0, boundary: bool = True) -> np.ndarray:
        """Return the mask of rays that a computation of limited precision must get right.

        Parameters
        ----------
        eps : float
            Relative precision, for float32 a few times 6e-8.
        edge : float
            Band along patch boundaries, in parameters.
        boundary : bool
            Whether boundaries matter. They do not on a closed cover whose patches meet
            smoothly: there the neighbour catches the ray.
        """
        out = self.certain & (self.graze > eps) & (self.range > eps)
        return out & (self.edge_shift > eps) & (self.edge >= edge) if boundary else out


class FirstHits(NamedTuple):
    """First hits; a miss has ``t = inf``, ``patch = -1``, ``uv = 0``.

    Attributes
    ----------
    t : (N,) array
    patch : (N,) int array
    uv : (N, 2) array
    margin : Margin
    """

    t: np.ndarray
    patch: np.ndarray
    uv: np.ndarray
    margin: Margin


def _describe(
    patches: Patches, rays: Rays, ray: np.ndarray, patch: np.ndarray, uv: np.ndarray, kind: Any
) -> Intersections:
    """Compute everything about given roots and near misses."""
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
    bound += weights * np.linalg.norm(o, axis=1)
    at_infinity = np.abs(w) <= NOISE * weights
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("rc,rc->r", shifted[:, 0], rays.unit[ray]) / (w * rays.length[ray])
        scale = np.where(at_infinity, np.inf, bound / np.abs(w))
    t = np.where(at_infinity, np.inf, t)

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
    normal = (parts[0] + parts[1] + parts[2]) * np.where(w < 0, -1.0, 1.0)[:, None]
    length = np.linalg.norm(normal, axis=1)
    # 1e-9: as in BezierTriangles.normals, which takes the limit from the inside
    weak = length <= 1e-9 * sum(np.linalg.norm(part, axis=1) for part in parts)
    normal /= np.maximum(length, 1e-300)[:, None]
    limit = np.flatnonzero(weak & ~at_infinity)
    if len(limit):
        normal[limit] = np.nan_to_num(nets.normals(patch[limit], uv[limit]))
    cosine = np.einsum("rc,rc->r", normal, rays.unit[ray])
    cosine = np.clip(cosine, -1, 1)
    horizon = np.abs(w) / np.maximum(weights, 1e-300)
    return Intersections(
        ray, patch, uv, t, kind, inside, edge, shift, graze, cosine, scale, horizon
    )


def candidates(
    nets: BezierTriangles,
    origins: Any,
    directions: Any,
    *,
    extend: float = 1e-2,
    band: float = 1e-5,
) -> Intersections:
    """Find all intersections of lines with patches, and all that is nearly one.

    Parameters
    ----------
    nets : BezierTriangles
        Patches, any weights.
    origins, directions : (N, 3) array_like
        Rays; directions need not be of length 1.
    extend : float
        How far outside the patches, in barycentric coordinates, roots are looked for. Some
        of these are returned twice.
    band : float
        How far away, relative to ``M``, near misses are looked for; never more than a
        thousandth of the patch's size.

    Returns
    -------
    Intersections
        Of every `kind`; `inside` tells the hits among the roots (``kind >= 0``).

    Raises
    ------
    GeometryError
        If the rays have the wrong shape, are not finite, or a direction is zero.
    """
    rays = Rays(origins, directions)
    patches = Patches(nets, extend)
    block = max(1024, 2**20 // nets.control_points.shape[1])
    found = []
    for ray, patch, f, bound in problems(patches, rays, block, band):
        # a thousandth of the patch: from far away a band wider than the patch tells nothing
        width = np.minimum(band * bound, 1e-3 * patches.size[patch].max(axis=1))
        roots: Roots = common_roots(f, bound, margin=extend, band=width)
        found.append(
            _describe(patches, rays, ray[roots.problem], patch[roots.problem], roots.uv, roots.kind)
        )
    if not found:
        none = np.zeros(0, dtype=np.int64)
        found.append(_describe(patches, rays, none, none, np.zeros((0, 2)), none))
    out = Intersections(*(np.concatenate(column) for column in zip(*found)))
    return out.select(np.lexsort((out.t, out.ray)))


def intersect_all(
    nets: BezierTriangles,
    origins: Any,
    directions: Any,
    tmin: float = -np.inf,
    tmax: float = np.inf,
) -> Intersections:
    """Find all intersections of lines with patches.

    Parameters
    ----------
    nets : BezierTriangles
        Patches, any weights.
    origins, directions : (N, 3) array_like
        Rays; directions need not be of length 1.
    tmin, tmax : float
        Range of `t`, both ends included. By default the whole line and its point at infinity.

    Returns
    -------
    Intersections
        A root on an edge shared by two patches is reported for both. A ray that lies in a
        patch meets it along a curve, of which some points are returned, `UNRESOLVED`. Within
        some 1e-10 of such a position roots can be lost; `candidates` then has `UNDECIDED`
        rows, and `first_hit` says so in `Margin.certain`.

    Raises
    ------
    GeometryError
        If the rays have the wrong shape, are not finite, or a direction is zero.
    """
    out = candidates(nets, origins, directions, extend=0.0, band=0.0)
    return out.select(out.inside & (out.kind >= 0) & (out.t >= tmin) & (out.t <= tmax))


def first_hit(
    nets: BezierTriangles,
    origins: Any,
    directions: Any,
    tmin: float = 0.0,
    tmax: float = np.inf,
    *,
    extend: float = 1e-2,
    band: float = 1e-5,
) -> FirstHits:
    """Find the first hit of each ray, and how firmly it is decided.

    Parameters
    ----------
    nets : BezierTriangles
        Patches, any weights.
    origins, directions : (N, 3) array_like
        Rays; directions need not be of length 1.
    tmin, tmax : float
        Range of `t`, both ends included; points at infinity are no hits.
    extend : float
        How far outside the patches, in barycentric coordinates, roots count for
        `Margin.edge`.
    band : float
        How far away, relative to ``M``, near misses count for `Margin.graze`; never more than
        a thousandth of the patch's size.

    Returns
    -------
    FirstHits

    Raises
    ------
    GeometryError
        If the rays have the wrong shape, are not finite, or a direction is zero.
    """
    all_ = candidates(nets, origins, directions, extend=extend, band=band)
    length = Rays(origins, directions).length
    count = len(length)
    finite = np.isfinite(all_.t)
    root = all_.inside & (all_.kind >= 0)
    hits = np.flatnonzero(root & finite & (all_.t >= tmin) & (all_.t <= tmax))
    hit_ray, first = np.unique(all_.ray[hits], return_index=True)
    chosen = hits[first]
    t = np.full(count, np.inf)
    patch = np.full(count, -1)
    uv = np.zeros((count, 2))
    t[hit_ray], patch[hit_ray], uv[hit_ray] = all_.t[chosen], all_.patch[chosen], all_.uv[chosen]
    cosine, scale = np.full(count, np.inf), np.full(count, np.inf)
    cosine[hit_ray], scale[hit_ray] = np.abs(all_.cosine[chosen]), all_.scale[chosen]

    is_first = np.zeros(len(all_.t), dtype=bool)
    is_first[chosen] = True
    # what lies behind the first hit cannot change it; 1e-5 of the scale covers twins at folds
    slack = np.where(finite, 1e-5 * all_.scale, 0.0) / length[all_.ray]
    last = np.minimum(t[all_.ray], tmax) + slack
    before = finite & (all_.t >= tmin - slack) & (all_.t <= last)

    def least(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
        out = np.full(count, np.inf)
        np.minimum.at(out, all_.ray[mask], values[mask])
        return out

    outside = before & ~all_.inside & (all_.kind != NEAR_MISS)
    # near a fold outside the patch roots may appear inside it: near misses there count, too
    near = (all_.kind == NEAR_MISS) | ((all_.kind == UNDECIDED) & all_.inside)
    graze = least(all_.graze, is_first | (before & near))
    with np.errstate(invalid="ignore"):
        gap = np.minimum(np.abs(all_.t - tmin), np.abs(all_.t - tmax))
        gap = gap * length[all_.ray] / all_.scale
    border = least(gap, root & before)
    if tmax == np.inf:
        border = np.minimum(border, least(all_.horizon, is_first | (root & (last == np.inf))))
    doubtful = before & all_.inside & (all_.kind != SIMPLE) & (all_.kind != NEAR_MISS)
    margin = Margin(
        edge=least(np.abs(all_.edge), is_first | outside),
        edge_shift=least(all_.edge_shift, is_first | outside),
        graze=graze,
        range=border,
        cosine=cosine,
        scale=scale,
        certain=np.bincount(all_.ray[doubtful], minlength=count) == 0,
    )
    return FirstHits(t, patch, uv, margin)
