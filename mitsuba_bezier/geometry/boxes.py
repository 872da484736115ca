"""Axis-aligned boxes of surfaces: quick ones of their nets, and tight ones of the surfaces.

A net is a hull of its patch if its weights have one sign. Whatever the weights, the parts of a
patch that does not reach infinity have that property after some midpoint splits. So the box of a
surface is found between two others: the box of points on it, and that of the nets of its parts, of
which only those are split further that may reach beyond what is known.
"""

from __future__ import annotations

import numpy as np

from ..errors import BezierError
from . import bernstein

__all__ = ["finite_parts", "hull_boxes", "instance_boxes", "reaches_infinity", "surface_boxes"]

#: How far boxes of surfaces may be from tight, relative to their largest side.
TIGHT = 1e-3
#: Splits after which a part whose weights still have no sign counts as one that reaches infinity.
_LEVELS = 12
#: Numbers of nets that are split at a time.
_CHUNK = 2**18
#: Rounding of nets after all splits, relative to their coordinates.
_ROUNDING = 2.0**-48


def hull_boxes(nets: np.ndarray) -> np.ndarray:
    """Return the boxes of the control points of nets ``(P, K, 4)``: ``(P, 2, 3)``.

    A control vector opens the box to infinity on its side. The box of a net whose weights change
    sign is the whole space.
    """
    w = nets[..., 3]
    if ((w > 0).all(axis=1) | (w < 0).all(axis=1)).all():
        p = nets[..., :3] / w[..., None]
        return np.stack([p.min(axis=1), p.max(axis=1)], axis=1)
    sign = np.where((w >= 0).all(axis=1), 1.0, np.where((w <= 0).all(axis=1), -1.0, 0.0))
    nets = nets * np.where(sign == 0, 1.0, sign)[:, None, None]
    w = nets[..., 3]
    finite = w > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        p = np.where(finite[..., None], nets[..., :3] / w[..., None], np.nan)
    vector = np.where(finite[..., None], 0.0, nets[..., :3])
    lo = np.where(finite[..., None], p, np.inf).min(axis=1)
    hi = np.where(finite[..., None], p, -np.inf).max(axis=1)
    lo = np.where((vector < 0).any(axis=1), -np.inf, lo)
    hi = np.where((vector > 0).any(axis=1), np.inf, hi)
    unbounded = (sign == 0) | ~finite.any(axis=1)
    lo[unbounded], hi[unbounded] = -np.inf, np.inf
    return np.stack([lo, hi], axis=1)


def _one_sign(nets: np.ndarray) -> np.ndarray:
    """Return a mask of nets with weights of one sign; zero vectors add nothing to a point."""
    w = nets[..., 3]
    one = np.asarray((w > 0).all(axis=1) | (w < 0).all(axis=1))
    if not one.all():
        none = ~nets.any(axis=-1)
        one |= ((w > 0) | none).all(axis=1) | ((w < 0) | none).all(axis=1)
    return one


def _corners(nets: np.ndarray) -> np.ndarray:
    n = bernstein.degree_of(nets.shape[1])
    return nets[:, [bernstein.row(n, i, j) for i, j in ((n, 0), (0, n), (0, 0))]]


def _reaches(nets: np.ndarray) -> np.ndarray:
    """Return a mask of nets that certainly reach infinity, seen at their corners' weights."""
    corners = _corners(nets)
    ideal = (corners[..., 3] == 0) & corners.any(axis=-1)
    return ideal.any(axis=1) | _crosses(corners)


def _crosses(corners: np.ndarray) -> np.ndarray:
    w = corners[..., 3]
    return np.asarray((w > 0).any(axis=1) & (w < 0).any(axis=1))


def _open_sides(nets: np.ndarray) -> np.ndarray:
    """Return sides ``(P, 2, 3)`` on which nets certainly reach infinity: at a corner, across."""
    corners, w = _corners(nets), nets[..., 3]
    sign = np.where((w >= 0).all(axis=1), 1.0, np.where((w <= 0).all(axis=1), -1.0, 0.0))
    vector = np.where(corners[..., 3:] == 0, corners[..., :3] * sign[:, None, None], 0.0)
    out = np.stack([(vector < 0).any(axis=1), (vector > 0).any(axis=1)], axis=1)
    out[_crosses(corners) | ~w.any(axis=1)] = True
    return out


def _split(nets: np.ndarray) -> np.ndarray:
    """Return the four parts of each net, one after the other."""
    n = bernstein.degree_of(nets.shape[1])
    return (bernstein.split_matrices(n) @ nets[:, None]).reshape(-1, *nets.shape[1:])


def _step(nets: np.ndarray) -> int:
    return max(_CHUNK // (nets.shape[1] * 4), 1)


def finite_parts(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return parts of nets ``(P, K, 4)``, all of them with weights of one sign.

    Returns
    -------
    parts : (Q, K, 4) array
        Of all patches that do not reach infinity; those whose weights have one sign are as given.
        Zero vectors may be among their control points.
    patch : (Q,) int array
        The patches they belong to; one that reaches infinity has none.
    """
    patch = np.arange(len(nets))
    parts, owners, found = [nets[:0]], [patch[:0]], np.zeros(len(nets), dtype=bool)
    for level in range(_LEVELS + 1):
        good = _one_sign(nets)
        parts.append(nets[good])
        owners.append(patch[good])
        found[patch[~good & (_reaches(nets) | (level == _LEVELS))]] = True
        on = ~good & ~found[patch]
        if not on.any():
            break
        nets, patch = _split(nets[on]), np.repeat(patch[on], 4)
    out, owner = np.concatenate(parts), np.concatenate(owners)
    keep = ~found[owner]
    return out[keep], owner[keep]


def reaches_infinity(nets: np.ndarray) -> np.ndarray:
    """Return a mask of the nets ``(P, K, 4)`` whose patches have a point at infinity."""
    out = np.zeros(len(nets), dtype=bool)
    doubtful = np.flatnonzero(~_one_sign(nets))
    out[doubtful] = True
    for first in range(0, len(doubtful), _step(nets)):
        chunk = doubtful[first : first + _step(nets)]
        out[chunk[np.unique(finite_parts(nets[chunk])[1])]] = False
    return out


def surface_boxes(nets: np.ndarray, together: bool = False) -> np.ndarray:
    """Return boxes around patches, no more than `TIGHT` of their size larger than they are.

    Parameters
    ----------
    nets : (P, K, 4) array
    together : bool
        One box around all patches.

    Returns
    -------
    (P, 2, 3) or (1, 2, 3) array
        Infinite on the sides where a patch reaches infinity.
    """
    step = _step(nets)
    if together:
        known = _known(nets, np.zeros(len(nets), dtype=int), 1)
        box = np.array([[[np.inf] * 3, [-np.inf] * 3]])
        for first in range(0, len(nets), step):
            chunk = nets[first : first + step]
            part = _refine(chunk, np.zeros(len(chunk), dtype=int), known)
            box[:, 0] = np.minimum(box[:, 0], part[:, 0])
            box[:, 1] = np.maximum(box[:, 1], part[:, 1])
        return box
    out = np.empty((len(nets), 2, 3))
    for first in range(0, len(nets), step):
        chunk = nets[first : first + step]
        owner = np.arange(len(chunk))
        out[first : first + step] = _refine(chunk, owner, _known(chunk, owner, len(chunk)))
    return out


def _known(nets: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """Return the boxes of the finite corners of nets, for each of `count` owners."""
    known = np.stack([np.full((count, 3), np.inf), np.full((count, 3), -np.inf)], axis=1)
    corners = _corners(nets)
    finite = corners[..., 3] != 0
    p, owner = corners[finite], np.repeat(owner, 3)[finite.ravel()]
    np.minimum.at(known[:, 0], owner, p[:, :3] / p[:, 3:])
    np.maximum.at(known[:, 1], owner, p[:, :3] / p[:, 3:])
    return known


def _refine(nets: np.ndarray, owner: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the boxes of owners; `known`, the boxes of points on the surface, is enlarged."""
    box = known.copy()
    size = np.zeros(len(known))
    open_ = np.zeros((len(known), 2, 3), dtype=bool)  # sides that are infinite for sure
    for level in range(_LEVELS + 1):
        with np.errstate(invalid="ignore"):
            extent = np.nan_to_num(known[:, 1] - known[:, 0], neginf=0.0).max(axis=1)
        # a surface that reaches infinity has the size of what is seen of it at first
        size = np.where(open_.any(axis=(1, 2)) & (size > 0), size, extent)
        hull = hull_boxes(nets)
        if level:
            slack = _ROUNDING * np.abs(np.where(np.isfinite(hull), hull, 0.0)).max(axis=1)
            hull += np.stack([-slack, slack], axis=1)
        np.logical_or.at(open_, owner, _open_sides(nets))
        beyond = np.empty(hull.shape, dtype=bool)
        limit = TIGHT * size[owner][:, None]
        beyond[:, 0] = hull[:, 0] < known[owner, 0] - limit
        beyond[:, 1] = hull[:, 1] > known[owner, 1] + limit
        on = (beyond & ~open_[owner]).any(axis=(1, 2))
        if level == _LEVELS:
            on[:] = False
        np.minimum.at(box[:, 0], owner[~on], hull[~on, 0])
        np.maximum.at(box[:, 1], owner[~on], hull[~on, 1])
        if not on.any():
            break
        nets, owner = _split(nets[on]), np.repeat(owner[on], 4)
        now = _known(nets, owner, len(known))
        np.minimum(known[:, 0], now[:, 0], out=known[:, 0])
        np.maximum(known[:, 1], now[:, 1], out=known[:, 1])
    box[:, 0] = np.where(open_[:, 0], -np.inf, np.minimum(box[:, 0], known[:, 0]))
    box[:, 1] = np.where(open_[:, 1], np.inf, np.maximum(box[:, 1], known[:, 1]))
    return box


def instance_boxes(nets: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return boxes ``(N, 2, 3)`` of images of nets ``(P, K, 4)`` under affine maps ``(N, 4, 4)``.

    They are those of the control points of parts whose weights have one sign.

    Raises
    ------
    BezierError
        If the patches run to infinity.
    """
    if reaches_infinity(nets).any():
        raise BezierError.expected("instances", "patches of finite size", "points at infinity")
    net = finite_parts(nets)[0].reshape(-1, 4)
    net = net[net[:, 3] != 0]  # zero vectors are no points
    points = net[:, :3] / net[:, 3:]
    # the extreme points in some directions, and the boxes of patches, would do; all are few
    out = np.empty((len(matrices), 2, 3))
    step = max(_CHUNK // len(points), 1)
    for first in range(0, len(matrices), step):
        m = matrices[first : first + step]
        moved = np.einsum("nij,kj->nki", m[:, :3, :3], points) + m[:, None, :3, 3]
        out[first : first + step, 0] = moved.min(axis=1)
        out[first : first + step, 1] = moved.max(axis=1)
    return out
