"""Tensor-product nets and plane polygons as nets of Bézier triangles, many at a time."""

from __future__ import annotations

import numpy as np

from ..geometry.tensor import tensor_matrices

__all__ = ["fan", "has_area", "homogeneous", "tensor_nets"]


def homogeneous(points: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Return homogeneous points ``(..., 4)`` from Euclidean ones ``(..., 3)`` and weights."""
    if weights is None:
        weights = np.ones(points.shape[:-1])
    return np.concatenate([points * weights[..., None], weights[..., None]], axis=-1)


def tensor_nets(nets: np.ndarray) -> np.ndarray:
    """Return two triangles of degree ``p + q`` for each tensor-product patch.

    Parameters
    ----------
    nets : (P, p+1, q+1, 4) array
        Homogeneous control points, the first index along u.

    Returns
    -------
    (2 P, K, 4) array
        Triangles ``2 k`` and ``2 k + 1`` are patch ``k``; their normals follow
        ``dp_du x dp_dv`` of the patch.
    """
    count, p, q = len(nets), nets.shape[1] - 1, nets.shape[2] - 1
    flat = nets.reshape(count, -1, 4)
    out = np.stack([matrix @ flat for matrix in tensor_matrices(p, q)], axis=1)
    # equal weights stay equal to the last bit: polynomial patches are stored and shown as such
    weight = nets[:, 0, 0, 3]
    same = (nets[..., 3] == weight[:, None, None]).all(axis=(1, 2))
    out[same, ..., 3] = weight[same, None, None]
    return out.reshape(2 * count, -1, 4)


def has_area(nets: np.ndarray) -> np.ndarray:
    """Return a mask ``(P,)`` of positive nets ``(P, K, 4)`` that are no line and no point.

    CAD surfaces that end on an axis have such patches.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        points = nets[..., :3] / nets[..., 3:]
    points = points - points.mean(axis=1, keepdims=True)
    good = np.isfinite(points).all(axis=(1, 2)) & (nets[..., 3] > 0).all(axis=1)
    size = np.linalg.svd(np.where(good[:, None, None], points, 0.0), compute_uv=False)
    # 3e-8 of the length: what rounding of float32 makes of a line
    return ~good | (size[:, 1] > 3e-8 * size[:, 0])


def fan(corners: np.ndarray) -> np.ndarray | None:
    """Return the nets of a convex polygon ``(m, 4)``; None if it is none. See `fans`."""
    nets, convex = fans(corners[None])
    return nets[0] if convex[0] else None


def fans(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut convex polygons into triangles from their first corners.

    A plane polygon may have corners at infinity or of negative weight: convex is then the cone
    over it, and the polygon the part of the plane that this cone covers.

    Parameters
    ----------
    corners : (F, m, 4) array
        Homogeneous corners. Finite ones need not lie in one plane.

    Returns
    -------
    nets : (F, m - 2, 3, 4) array
        Of degree 1.
    convex : (F,) bool array
        False where a polygon is not convex (if it is not plane: seen along its mean normal), or
        without area.
    """
    m = corners.shape[1]
    index = np.stack([np.zeros(m - 2, int), np.arange(1, m - 1), np.arange(2, m)], axis=1)
    local, good = _scaled(corners)
    sigma, axes = np.linalg.svd(local, full_matrices=False)[1:]
    cone = local @ axes[:, :3].swapaxes(1, 2)
    # 1e-5, here and below: coordinates are written with six digits or so
    if m > 3 and (bent := good & (sigma[:, 3] > 1e-5 * sigma[:, 0])).any():
        good &= ~bent | (corners[..., 3] > 0).all(axis=1)
        bent &= good
        points = local[bent, :, :3] / local[bent, :, 3:]
        rest = points[:, 1:] - points[:, :1]
        mean = np.cross(rest[:, :-1], rest[:, 1:]).sum(axis=1)  # Newell: twice the vector area
        basis = np.linalg.svd(mean[:, None])[2][:, 1:]
        flat = points @ basis.swapaxes(1, 2)
        cone[bent] = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=2)
    turns = np.linalg.det(cone[:, (np.arange(m)[:, None] + np.arange(3)) % m])
    signs = np.concatenate([turns, np.linalg.det(cone[:, index])], axis=1)
    slack = 1e-5 * np.abs(signs).max(axis=1)  # corners on a straight line are no dents
    good &= (slack != 0) & ((signs.min(axis=1) >= -slack) | (signs.max(axis=1) <= slack))
    return corners[:, index], good


def _scaled(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move and scale polygons, so that what is told of them does not depend on the place.

    Returns
    -------
    local : (F, m, 4) array
        Corners of length 1; zero for polygons that cannot be scaled.
    good : (F,) bool array
        Which can.
    """
    finite = corners[..., 3] != 0
    some = finite.any(axis=1)
    with np.errstate(all="ignore"):
        points = np.where(finite[..., None], corners[..., :3] / corners[..., 3:], 0.0)
        large = np.abs(points).max(axis=(1, 2))  # divided by first: then nothing below overflows
        good = np.isfinite(large)
        large = np.where(good & (large > 0), large, 1.0)[:, None, None]
        points = np.where(good[:, None, None], points / large, 0.0)
        count = np.maximum(finite.sum(axis=1), 1)[:, None]
        center = points.sum(axis=1) / count
        spread = np.where(finite[..., None], points - center[:, None], 0.0)
        size = np.abs(spread).max(axis=(1, 2))[:, None, None]
        size = np.where(size > 0, size, 1.0)
        local = corners.copy()
        moved = (corners[..., :3] / large - center[:, None] * corners[..., 3:]) / size
        local[..., :3] = np.where(some[:, None, None], moved, corners[..., :3])
        length = np.linalg.norm(local, axis=2, keepdims=True)
        good &= ((length > 0) & np.isfinite(length)).all(axis=(1, 2))
        local = np.where(good[:, None, None], local / length, 0.0)
    return local, good
