"""Intersect rays and Bézier triangles in float64, slowly and with certificates: an oracle.

A line is the meet of two planes. Put into the net they give two polynomials whose common
roots are the intersections; `bivariate` finds all of them. Nothing is divided by a weight
before the end, so weights of any sign, control vectors and patches that run through the
plane at infinity need no care of their own.

What a comparison must leave out is told by `Margin`; see `intersections` for the measures.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..geometry.triangles import BezierTriangles
from .bivariate import NEAR_MISS, SIMPLE, UNDECIDED, Roots, common_roots
from .intersections import Intersections, describe
from .ray_polynomials import Patches, Rays, problems

__all__ = ["FirstHits", "Intersections", "Margin", "candidates", "first_hit", "intersect_all"]


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
    resolved : (N,) array
        Relative change up to which near misses were looked for: the `band` of `first_hit`,
        or less for rays that start far away.
    certain : (N,) bool array
        No tangent or unresolved root can change the answer.
    """

    edge: np.ndarray
    edge_shift: np.ndarray
    graze: np.ndarray
    range: np.ndarray
    cosine: np.ndarray
    scale: np.ndarray
    resolved: np.ndarray
    certain: np.ndarray

    def decidable(self, eps: float, edge: float = 0.0, boundary: bool = True) -> np.ndarray:
        """Return the mask of rays that a computation of limited precision must get right.

        Parameters
        ----------
        eps : float
            Relative precision, for float32 a few times 6e-8; at most the `band`.
        edge : float
            Band along patch boundaries, in parameters.
        boundary : bool
            Whether boundaries matter. They do not on a closed cover whose patches meet
            smoothly: there the neighbour catches the ray.
        """
        out = self.certain & (self.graze > eps) & (self.range > eps) & (self.resolved >= eps)
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
        hundredth of the patch's size.

    Returns
    -------
    Intersections
        Of every `kind`; `inside` tells the hits among the roots (``kind >= 0``).

    Raises
    ------
    GeometryError
        If the rays have the wrong shape, are not finite, or a direction is zero.
    """
    return _search(nets, Rays(origins, directions), extend, band)[0]


def _search(
    nets: BezierTriangles, rays: Rays, extend: float, band: float
) -> tuple[Intersections, np.ndarray]:
    """Return the candidates, sorted, and the band in which near misses were found, by ray."""
    patches = Patches(nets, extend)
    block = max(1024, 2**20 // nets.control_points.shape[1])
    resolved = np.full(len(rays.o), band)
    found = []
    for ray, patch, f, bound in problems(patches, rays, block, band):
        # a hundredth of the patch: a band as wide as the patch would tell nothing
        width = np.minimum(band * bound, 1e-2 * patches.size[patch].max(axis=1))
        np.minimum.at(resolved, ray, width / bound)
        roots: Roots = common_roots(f, bound, margin=extend, band=width)
        found.append(
            describe(patches, rays, ray[roots.problem], patch[roots.problem], roots.uv, roots.kind)
        )
    if not found:
        none = np.zeros(0, dtype=np.int64)
        found.append(describe(patches, rays, none, none, np.zeros((0, 2)), none))
    out = Intersections(*(np.concatenate(column) for column in zip(*found)))
    return out.select(np.lexsort((out.t, out.ray))), resolved


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
        a hundredth of the patch's size.

    Returns
    -------
    FirstHits

    Raises
    ------
    GeometryError
        If the rays have the wrong shape, are not finite, or a direction is zero.
    """
    rays = Rays(origins, directions)
    all_, resolved = _search(nets, rays, extend, band)
    length = rays.length
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
    # points this far away may as well come from the other side of the plane at infinity
    before |= (all_.horizon < 1e-4) & (last == np.inf)

    def least(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
        out = np.full(count, np.inf)
        np.minimum.at(out, all_.ray[mask], values[mask])
        return out

    outside = before & ~all_.inside & (all_.kind != NEAR_MISS)
    # near a fold outside the patch roots may appear inside it: near misses there count, too
    near = (all_.kind == NEAR_MISS) | ((all_.kind == UNDECIDED) & all_.inside)
    graze = least(all_.graze, is_first | (before & near))
    with np.errstate(invalid="ignore"):
        gap = np.fmin(np.abs(all_.t - tmin), np.abs(all_.t - tmax))
        gap = gap * length[all_.ray] / all_.scale
    border = least(gap, root & before & finite)
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
        resolved=resolved,
        certain=np.bincount(all_.ray[doubtful], minlength=count) == 0,
    )
    return FirstHits(t, patch, uv, margin)
