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
    both = np.concatenate(tensor_matrices(p, q))
    out = both @ nets.reshape(count, -1, 4)
    # equal weights stay equal to the last bit: polynomial patches are stored and shown as such
    weight = nets[:, 0, 0, 3]
    same = (nets[..., 3] == weight[:, None, None]).all(axis=(1, 2))
    out[same, :, 3] = weight[same, None]
    return out.reshape(2 * count, -1, 4)


def has_area(nets: np.ndarray) -> np.ndarray:
    """Tell which nets ``(P, K, 4)`` of positive weights are more than a line or a point, ``(P,)``.

    CAD surfaces that end on an axis have such patches.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        points = nets[..., :3] / nets[..., 3:]
    points = points - points.mean(axis=1, keepdims=True)
    gram = np.einsum("pki,pkj->pij", points, points)
    good = np.isfinite(gram).all(axis=(1, 2)) & (nets[..., 3] > 0).all(axis=1)
    values = np.linalg.eigvalsh(np.where(good[:, None, None], gram, np.eye(3)))
    # squares: 3e-8 of the length, what rounding makes of a line
    return ~good | (values[:, 1] > 1e-15 * values[:, 2])


def fan(corners: np.ndarray) -> np.ndarray | None:
    """Return the nets of a convex polygon cut into triangles from its first corner.

    A plane polygon may have corners at infinity or of negative weight: convex is then the cone
    over it, and the polygon the part of the plane that this cone covers.

    Parameters
    ----------
    corners : (m, 4) array
        Homogeneous corners. Finite ones need not lie in one plane.

    Returns
    -------
    (m - 2, 3, 4) array, or None
        Nets of degree 1; None if the polygon is not convex (if it is not plane: seen along its
        mean normal), or without area.
    """
    m = len(corners)
    index = np.stack([np.zeros(m - 2, int), np.arange(1, m - 1), np.arange(2, m)], axis=1)
    finite = corners[corners[:, 3] != 0]
    if len(finite):  # move and scale, so that the rank below does not depend on the place
        with np.errstate(over="ignore"):
            points = finite[:, :3] / finite[:, 3:]
        large = np.abs(points).max() or 1.0  # divided by first: then nothing below overflows
        if not np.isfinite(large):
            return None
        points = points / large
        center = points.mean(axis=0)
        size = np.abs(points - center).max() or 1.0
        local = corners.copy()
        local[:, :3] = (corners[:, :3] / large - center * corners[:, 3:]) / size
    else:
        local = corners
    length = np.linalg.norm(local, axis=1, keepdims=True)
    if not length.all():
        return None
    local = local / length
    _u, sigma, axes = np.linalg.svd(local, full_matrices=True)
    # 1e-5, here and below: coordinates are written with six digits or so
    if m == 3 or sigma[3] <= 1e-5 * sigma[0]:
        cone = local @ axes[:3].T
    elif (corners[:, 3] > 0).all():
        points = local[:, :3] / local[:, 3:]
        rest = points[1:] - points[0]
        mean = np.cross(rest[:-1], rest[1:]).sum(axis=0)  # Newell: twice the vector area
        basis = np.linalg.svd(mean[None])[2][1:]
        cone = np.concatenate([points @ basis.T, np.ones((m, 1))], axis=1)
    else:
        return None
    turns = np.linalg.det(cone[(np.arange(m)[:, None] + np.arange(3)) % m])
    signs = np.concatenate([turns, np.linalg.det(cone[index])])
    slack = 1e-5 * np.abs(signs).max()  # corners on a straight line are no dents
    if slack == 0 or not (signs.min() >= -slack or signs.max() <= slack):
        return None
    return corners[index]
