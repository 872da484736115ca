"""Quadrics of patches: fits, distances, and the units in which both are found."""

from __future__ import annotations

import numpy as np

from ...geometry import bernstein
from ...geometry.triangles import BezierTriangles
from ..records import QUADRIC_ENTRIES

__all__ = [
    "centre_and_size",
    "entries",
    "fit_forms",
    "in_space",
    "local_nets",
    "matrices",
    "plane_forms",
    "relative_distance",
    "with_apex",
    "with_its_apex",
]

#: A fitted quadric is a cone if its least eigenvalue is below this share of the largest; its apex
#: is a corner of a patch if so close, in the patches' size.
_SINGULAR, _AT_APEX = 1e-5, 1e-4


def centre_and_size(patches: BezierTriangles) -> tuple[np.ndarray, np.ndarray]:
    """Return a finite float32 point near each patch and its size; the box tells both."""
    box = patches.hulls()
    lo, hi = box[:, 0], box[:, 1]
    lo_finite, hi_finite = np.isfinite(lo), np.isfinite(hi)
    lo = np.where(lo_finite, lo, np.where(hi_finite, hi, 0.0))
    hi = np.where(hi_finite, hi, lo)
    size = (hi - lo).max(axis=1) / 2
    shift = ((lo + hi) / 2).astype(np.float32).astype(np.float64)
    return shift, np.where(size > 0, size, 1.0)


def in_space(
    rows: np.ndarray, forms: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Take rows and quadrics from units of `size` to those of space.

    Returns
    -------
    rows : (L, R, 4) array
    quadrics : (L, 10) array
        See `QUADRIC_ENTRIES`; a gradient of order one makes a length of their values.
    """
    units = np.ones((len(size), 4))
    units[:, :3] /= size[:, None]
    forms = forms * units[:, None] * units[:, :, None] * size[:, None, None]
    return rows * units[:, None], entries(forms)


def plane_forms(planes: np.ndarray) -> np.ndarray:
    """Return planes ``(P, 4)`` as quadrics ``(P, 4, 4)``: times the plane at infinity."""
    forms = np.zeros((len(planes), 4, 4))
    forms[:, :, 3] += planes / 2
    forms[:, 3, :] += planes / 2
    return forms


def local_nets(patches: BezierTriangles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nets about a point near each patch, in units of its size and of its largest number.

    Also that point and the size, see `centre_and_size`.
    """
    shift, size = centre_and_size(patches)
    local = patches.control_points.copy()
    local[..., :3] = (local[..., :3] - local[..., 3:] * shift[:, None]) / size[:, None, None]
    local /= np.abs(local).max(axis=(1, 2), keepdims=True)
    return local, shift, size


def relative_distance(patches: BezierTriangles, forms: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return the largest distance of points of each patch from its form on ``p - shift``."""
    lattice = bernstein.multi_indices(4)[:, :2] / 4.0
    points = bernstein.basis(patches.degree, lattice) @ patches.control_points
    points[..., :3] -= points[..., 3:] * shift[:, None]
    gradient = np.einsum("lab,lsb->lsa", forms, points)
    value = np.abs(np.einsum("lsa,lsa->ls", points, gradient))
    slope = 2 * np.linalg.norm(gradient[..., :3], axis=-1)
    _centre, size = centre_and_size(patches)
    weight = np.abs(points[..., 3])
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = value / slope
        # next to the tip of a cone, where the gradient vanishes
        bent = np.linalg.norm(forms[:, :3, :3], axis=(1, 2))[:, None]
        distance = np.fmin(distance, np.sqrt(value / bent))
        distance /= weight * size[:, None]
    # no number where a point is at infinity
    distance = np.where(np.isfinite(distance), distance, 0.0)
    return distance.max(axis=1)


def with_its_apex(form: np.ndarray, nets: np.ndarray) -> np.ndarray:
    """Return a quadric, or if it is a cone with a corner of `nets` in its apex, that cone exactly.

    Parameters
    ----------
    form : (4, 4) array
        A fit, to points in float32 perhaps.
    nets : (P, K, 4) array
        Nets on it, with weights of one sign.
    """
    values, vectors = np.linalg.eigh(form)
    least = int(np.abs(values).argmin())
    apex = vectors[:, least]
    corners = nets[:, bernstein.corner_rows(bernstein.degree_of(nets.shape[1]))].reshape(-1, 4)
    corners = corners[:, :3] / corners[:, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.linalg.norm(corners - apex[:3] / apex[3], axis=1) < _AT_APEX * np.ptp(corners)
    if abs(values[least]) > _SINGULAR * np.abs(values).max() or not near.any():
        return form
    return with_apex(form, corners[near].mean(axis=0))


def with_apex(form: np.ndarray, apex: np.ndarray) -> np.ndarray:
    """Return the cone with this apex that differs from a quadric by rounding.

    A quadric fitted to points in float32 is off by 1e-7: next to the apex of a cone it may be a
    hyperboloid, with a neck of the root of that.
    """
    out = form.copy()
    out[:3, 3] = out[3, :3] = -form[:3, :3] @ apex
    out[3, 3] = apex @ form[:3, :3] @ apex
    return out


def fit_forms(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit quadrics to homogeneous points ``(P, S, 4)``, in the sense of least squares.

    Returns
    -------
    forms : (P, 4, 4) array
        Their matrices, of unit length as ten numbers.
    singular : (P, 10) array
        Singular values: the last is the residual; the one before tells how far the next is.
    """
    length = np.linalg.norm(points, axis=2, keepdims=True)
    unit = points / np.maximum(length, 1e-300)
    columns = [(1 if i == j else 2) * unit[..., i] * unit[..., j] for i, j in QUADRIC_ENTRIES]
    _u, s, vt = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
    return matrices(vt[:, -1]), s


def entries(forms: np.ndarray) -> np.ndarray:
    """Return ten entries each ``(L, 10)`` of symmetric matrices, in the order `QUADRIC_ENTRIES`."""
    return np.stack([forms[:, i, j] for i, j in QUADRIC_ENTRIES], axis=-1)


def matrices(quadrics: np.ndarray) -> np.ndarray:
    """Return the symmetric matrices ``(L, 4, 4)`` of ten entries each, see `QUADRIC_ENTRIES`."""
    out = np.zeros((len(quadrics), 4, 4))
    for c, (i, j) in enumerate(QUADRIC_ENTRIES):
        out[:, i, j] = out[:, j, i] = quadrics[:, c]
    return out
