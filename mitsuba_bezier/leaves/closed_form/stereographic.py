"""Find patches whose inverse is linear: stereographic projections and planar triangles."""

from __future__ import annotations

import numpy as np

from ...geometry import bernstein
from ...geometry.linear import inverses
from ...geometry.triangles import BezierTriangles
from ..records import ClosedFormLeaves, LeafKind
from .fits import in_space, local_nets, plane_forms
from .groups import quadric_leaves

__all__ = ["linear_leaves"]


def linear_leaves(patches: BezierTriangles) -> tuple[np.ndarray, ClosedFormLeaves]:
    """Find patches with a linear inverse and return ``(mask, leaves)``.

    For a quadratic patch ``b(u)`` we look for rows ``m_0, m_1, m_2`` and a linear form ``l``
    with ``m_j . b(u) = l(u) u_j``: a linear system, solved by its null vector. The common
    zero S of the rows is the centre of a stereographic projection. With a fourth row ``s``,
    ``s(u) := m_3 . b(u)`` satisfies ``l(U) s = l(u)^2 s(u) = l(u) s(u) . l(u)``, so the patch
    lies on ``2 l(U) s - 2 s(U) = 0``, a quadratic form in ``x``: the matrix A.

    A planar triangle of degree one has the inverse of its corner matrix; its form is the
    plane times the plane at infinity.
    """
    n, nets = patches.degree, patches.control_points
    none = np.zeros(len(nets), dtype=bool)
    if n > 2:
        return none, ClosedFormLeaves.zeros()
    local, shift, size = local_nets(patches)
    rows, forms, found = (_planar_inverse if n == 1 else _stereographic_inverse)(local)
    keep = np.flatnonzero(found)
    if not len(keep):
        return none, ClosedFormLeaves.zeros()
    rows, quadric = in_space(rows[keep], forms[keep], size[keep])
    least = _least_sum(rows, shift[keep], nets[keep], n)
    return found, quadric_leaves(
        patches, keep, shift[keep], rows, quadric, LeafKind.LINEAR, least_sum=least
    )


def _stereographic_inverse(local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve ``m_j . b(u) = l(u) u_j`` for quadratic nets ``(P, 6, 4)``."""
    count = len(local)
    system = np.zeros((count, 18, 15))
    for j in range(3):
        system[:, 6 * j : 6 * j + 6, 4 * j : 4 * j + 4] = local
        for c, ijk in enumerate(bernstein.multi_indices(1)):
            up = ijk.copy()
            up[j] += 1
            # u_j B_ijk of degree 1 = (i_j + 1)/2 times a Bernstein polynomial of degree 2
            system[:, 6 * j + bernstein.row(2, up[0], up[1]), 12 + c] = -up[j] / 2
    _u, s, vt = np.linalg.svd(system)
    # One null vector, and a second far from it. 3e-7: nets come through Mitsuba's float32
    # tensors, whose rounding (6e-8) is what a render can know of a surface anyway; below 1e-3
    # the inverse would lose too many of float32's digits.
    found = (s[:, -1] <= 3e-7 * s[:, 0]) & (s[:, -2] > 1e-3 * s[:, 0])
    rows, ell = vt[:, -1, :12].reshape(count, 3, 4), vt[:, -1, 12:]
    norm = np.linalg.norm(rows, axis=(1, 2))
    norm = np.where(norm > 0, norm, 1.0)
    rows, ell = rows / norm[:, None, None], ell / norm[:, None]
    _u, s3, vt3 = np.linalg.svd(rows)
    found &= s3[:, 2] > 1e-3 * s3[:, 0]
    fourth = vt3[:, 3]
    sigma = np.einsum("pc,pkc->pk", fourth, local)
    quadratic = np.zeros((count, 3, 3))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for r, (a, b) in enumerate(pairs):  # the net order of degree 2
        quadratic[:, a, b] = quadratic[:, b, a] = sigma[:, r]
    matrix = np.concatenate([rows, fourth[:, None]], axis=1)
    inner = np.zeros((count, 4, 4))
    inner[:, :3, :3] = -2 * quadratic
    inner[:, :3, 3] = inner[:, 3, :3] = ell
    forms = np.einsum("pai,pab,pbj->pij", matrix, inner, matrix)
    forms /= np.maximum(np.abs(forms).max(axis=(1, 2), keepdims=True), 1e-300)
    return rows, forms, found


def _planar_inverse(local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Invert planar triangles ``(P, 3, 4)``."""
    _u, s, vt = np.linalg.svd(local)
    found = s[:, 2] > 1e-6 * s[:, 0]
    plane = vt[:, 3]
    found &= np.linalg.norm(plane[:, :3], axis=1) > 1e-12  # not the plane at infinity
    inverse, regular = inverses(np.concatenate([local, plane[:, None]], axis=1).transpose(0, 2, 1))
    return inverse[:, :3], plane_forms(plane), found & regular


def _least_sum(rows: np.ndarray, shift: np.ndarray, nets: np.ndarray, n: int) -> np.ndarray:
    """Return half a lower bound of ``|sum of rows . (p - shift, 1)|`` over each patch.

    The sum is ``l(u) / w(u)``: `l` is linear, so least at a corner, and `w` within its
    coefficients.
    """
    corners = nets[:, bernstein.corner_rows(n)].copy()
    corners[..., :3] -= corners[..., 3:] * shift[:, None]
    ell = np.einsum("lrc,lkc->lk", rows, corners)
    one_sign = (ell > 0).all(axis=1) | (ell < 0).all(axis=1)
    weight = np.abs(nets[..., 3]).max(axis=1)
    return np.where(one_sign, 0.5 * np.abs(ell).min(axis=1) / weight, 0.0)
