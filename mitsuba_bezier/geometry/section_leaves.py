"""Patches of any degree on an ellipsoid whose edges are plane sections (see `leaves`).

Octants of the sphere are the example. The ray meets the quadric in closed form, and the planes
of the edges tell whether the point is on the patch; only its parameters, of the one hit that
counts, are found by Newton's method in the plane.
"""

from __future__ import annotations

import numpy as np

from . import bernstein
from .leaves import FORM, FORM_ENTRIES, SECTION, Leaves
from .quadric_groups import centre_and_size, fit_forms, quadric_leaves
from .triangles import BezierTriangles

__all__ = ["section_leaves"]

#: Residuals up to this are rounding: nets come through Mitsuba's float32 tensors (6e-8).
_ROUNDING = 3e-7
#: Singular values below this share of the largest leave a quadric or a plane undetermined.
_DETERMINED = 1e-4


def section_leaves(patches: BezierTriangles) -> tuple[np.ndarray, Leaves]:
    """Find such patches and return ``(mask, leaves)``.

    The three planes and the quadric bound the patch alone: if the planes meet inside of the
    ellipsoid, they cut it into eight regions, each on its own combination of sides.
    """
    n, nets = patches.degree, patches.control_points
    found = np.zeros(len(nets), dtype=bool)
    nothing = found, Leaves.empty(bernstein.size(n))
    if n < 3:
        return nothing
    w = nets[..., 3]
    sign = np.where((w > 0).all(axis=1), 1.0, np.where((w < 0).all(axis=1), -1.0, 0.0))
    which = np.flatnonzero(sign)
    if not len(which):
        return nothing
    shift, size = centre_and_size(patches[which])
    local = nets[which] * sign[which, None, None]
    local[..., :3] = (local[..., :3] - local[..., 3:] * shift[:, None]) / size[:, None, None]
    local /= np.abs(local).max(axis=(1, 2), keepdims=True)
    keep = _plane_edges(local, n)
    which, shift, size, local = which[keep], shift[keep], size[keep], local[keep]
    if not len(which):
        return nothing
    planes, on_planes = _edge_planes(local, n)
    forms, on_quadric = _fit(local, n)
    keep = on_planes & on_quadric & _meet_inside(planes, forms) & _regular(local, planes, n)
    if not keep.any():
        return nothing
    which, shift, size, local = which[keep], shift[keep], size[keep], local[keep]
    units = np.ones((len(which), 4))
    units[:, :3] /= size[:, None]
    rows = planes[keep] * units[:, None]
    forms = forms[keep] * units[:, None] * units[:, :, None] * size[:, None, None]
    form = np.zeros((len(which), FORM))
    form[:, :10] = np.stack([forms[:, i, j] for i, j in FORM_ENTRIES], axis=-1)
    form[:, SECTION] = 1.0
    leaves = quadric_leaves(patches, which, shift, rows, form)
    moved = nets[leaves.patch] * sign[leaves.patch, None, None]
    moved[..., :3] -= moved[..., 3:] * leaves.shift[:, None]
    leaves.net[..., :3] = np.einsum("lrc,lkc->lkr", leaves.frame[:, :3], moved)
    leaves.net /= np.abs(leaves.net).max(axis=(1, 2), keepdims=True)
    leaves.net = bernstein.monomial_matrix(n) @ leaves.net
    found[which] = True
    return found, leaves


def _edge(n: int, corner: int) -> np.ndarray:
    """Return the rows of the control points of the edge opposite a corner."""
    return np.flatnonzero(bernstein.multi_indices(n)[:, corner] == 0)


def _plane_edges(local: np.ndarray, n: int) -> np.ndarray:
    """Tell, quickly, which nets may have three plane edges: four points of each are in a plane."""
    out = np.ones(len(local), dtype=bool)
    for corner in range(3):
        edge = _edge(n, corner)
        four = local[:, edge[[0, n // 3, n - n // 3, n]]]
        four = four / np.linalg.norm(four, axis=2, keepdims=True)
        out &= np.abs(np.linalg.det(four)) < 1e-5
    return out


def _edge_planes(local: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return planes ``(P, 3, 4)`` that are 0 on an edge and 1 in the opposite corner."""
    planes = np.zeros((len(local), 3, 4))
    found = np.ones(len(local), dtype=bool)
    for corner, row in enumerate(bernstein.corner_rows(n)):
        _u, s, vt = np.linalg.svd(local[:, _edge(n, corner)])
        found &= (s[:, 3] <= _ROUNDING * s[:, 0]) & (s[:, 2] > _DETERMINED * s[:, 0])
        plane = vt[:, 3]
        tip = local[:, row]
        value = np.einsum("pc,pc->p", plane, tip) / tip[:, 3]
        found &= np.abs(value) > _DETERMINED
        planes[:, corner] = plane / np.where(value == 0, 1.0, value)[:, None]
    return planes, found


def _fit(local: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Fit an ellipsoid; return matrices ``(P, 4, 4)``, negative inside, and where it fits."""
    lattice = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    forms, s = fit_forms(bernstein.basis(n, lattice) @ local)
    found = (s[:, -1] <= _ROUNDING * s[:, 0]) & (s[:, -2] > _DETERMINED * s[:, 0])
    forms *= np.sign(np.trace(forms[:, :3, :3], axis1=1, axis2=2))[:, None, None]
    axes = np.linalg.eigvalsh(forms[:, :3, :3])
    found &= axes[:, 0] > _DETERMINED * axes[:, 2]
    return forms, found


def _meet_inside(planes: np.ndarray, forms: np.ndarray) -> np.ndarray:
    _u, s, vt = np.linalg.svd(planes)
    point = vt[:, 3]
    inside = np.einsum("pi,pij,pj->p", point, forms, point) < 0
    return inside & (np.abs(point[:, 3]) > 0) & (s[:, 2] > _DETERMINED * s[:, 0])


def _regular(local: np.ndarray, planes: np.ndarray, n: int) -> np.ndarray:
    """Tell where the planes' values are one-to-one in the parameters, by samples.

    They are positive inside, so the patch does not leave its region, and the map from the
    parameters to their ratios does not fold, so it is covered once.
    """
    lattice = bernstein.multi_indices(3 * n)
    inner = (lattice > 0).all(axis=1)
    uv = lattice[:, :2] / (3 * n)
    net = np.einsum("prc,pkc->pkr", planes, local)
    value = bernstein.basis(n, uv) @ net
    du, dv = (bernstein.basis(n - 1, uv) @ (m @ net) for m in bernstein.partials_matrices(n))
    # det (A, A_u, A_v): the Jacobian of the ratios times the cube of their sum
    det = np.linalg.det(np.stack([value, du, dv], axis=-1))
    return (value[:, inner] > 0).all(axis=(1, 2)) & (det > 0).all(axis=1)
