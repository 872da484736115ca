"""Patches whose intersections have a closed form (see `leaves`), grouped by quadric."""

from __future__ import annotations

import numpy as np

from . import bernstein
from .leaves import DEVIATION, FORM, FORM_ENTRIES, LEAST, Leaves
from .triangles import BezierTriangles

__all__ = ["exact_leaves"]


def exact_leaves(patches: BezierTriangles) -> tuple[np.ndarray, Leaves]:
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
    k = bernstein.size(n)
    none = np.zeros(len(nets), dtype=bool)
    if n > 2:
        return none, Leaves.empty(k)
    shift, size = _centre_and_size(patches)
    local = nets.copy()
    local[..., :3] = (local[..., :3] - local[..., 3:] * shift[:, None]) / size[:, None, None]
    local /= np.abs(local).max(axis=(1, 2), keepdims=True)
    rows, forms, found = (_planar_inverse if n == 1 else _stereographic_inverse)(local)
    keep = np.flatnonzero(found)
    if not len(keep):
        return none, Leaves.empty(k)
    # back from units of `size` to those of space
    units = np.ones((len(keep), 4))
    units[:, :3] /= size[keep, None]
    rows, forms = rows[keep] * units[:, None], forms[keep] * units[:, None] * units[:, :, None]
    frame = np.zeros((len(keep), 4, 4))
    frame[:, :3] = rows
    forms *= size[keep, None, None]  # gradient of order one: f is a length
    form = np.zeros((len(keep), FORM))
    form[:, :10] = np.stack([forms[:, i, j] for i, j in FORM_ENTRIES], axis=-1)
    form[:, LEAST] = _least_sum(rows, shift[keep], nets[keep], n)
    leaves = Leaves(
        patch=keep,
        domain=np.broadcast_to(np.eye(3), (len(keep), 3, 3)).copy(),
        exact=np.ones(len(keep), dtype=bool),
        shift=shift[keep],
        frame=frame,
        form=form,
        net=np.zeros((len(keep), k, 4)),
        box=_tight_boxes(patches[keep]),
        certified=np.ones(len(keep), dtype=bool),
        group=np.arange(len(keep)),
    )
    return found, _group(leaves, patches[keep])


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
    matrix = np.concatenate([local, plane[:, None]], axis=1).transpose(0, 2, 1)
    matrix = np.where(found[:, None, None], matrix, np.eye(4))
    rows = np.linalg.inv(matrix)[:, :3]
    forms = np.zeros((len(local), 4, 4))
    forms[:, :, 3] += plane / 2
    forms[:, 3, :] += plane / 2
    return rows, forms, found


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


def _tight_boxes(patches: BezierTriangles, levels: int = 3) -> np.ndarray:
    """Return boxes of control points after a few midpoint splits, ``(P, 2, 3)``."""
    fine = patches
    for _ in range(levels):
        fine = fine.split()
    box = fine.bounds().reshape(len(patches), 4**levels, 2, 3)
    return np.stack([box[:, :, 0].min(axis=1), box[:, :, 1].max(axis=1)], axis=1)


def _centre_and_size(patches: BezierTriangles) -> tuple[np.ndarray, np.ndarray]:
    """Return a finite float32 point near each patch and its size; the box tells both."""
    box = patches.bounds()
    lo, hi = box[:, 0], box[:, 1]
    lo_finite, hi_finite = np.isfinite(lo), np.isfinite(hi)
    lo = np.where(lo_finite, lo, np.where(hi_finite, hi, 0.0))
    hi = np.where(hi_finite, hi, lo)
    size = (hi - lo).max(axis=1) / 2
    shift = ((lo + hi) / 2).astype(np.float32).astype(np.float64)
    return shift, np.where(size > 0, size, 1.0)


#: Most patches in a group: its members are tried one after the other.
_GROUP = 12


def _group(leaves: Leaves, patches: BezierTriangles) -> Leaves:
    """Number the leaves by quadric, and give each group one quadric and one origin.

    A ray then meets the quadric of a whole group once. Groups of more than `_GROUP` patches
    are cut in space.
    """
    centre, size = _centre_and_size(patches)
    middle = (centre.min(axis=0) + centre.max(axis=0)) / 2
    middle = middle.astype(np.float32).astype(np.float64)
    scale = float((np.abs(centre - middle).max(axis=1) + size).max())
    forms = _matrices(leaves.form)
    # f(p - shift) as a form on (p - middle) / scale
    move = np.broadcast_to(np.eye(4), forms.shape).copy()
    move[:, :3, :3] *= scale
    move[:, :3, 3] = middle - leaves.shift
    common = np.einsum("lai,lab,lbj->lij", move, forms, move)
    flat = common.reshape(-1, 16)
    flat = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    leading = np.take_along_axis(flat, np.abs(flat).argmax(axis=1)[:, None], axis=1)
    flat = flat * np.sign(leading)
    _values, label = np.unique(np.round(flat * 1e5), axis=0, return_inverse=True)
    label = label.reshape(-1)
    count = label.max() + 1
    mean = np.zeros((count, 16))
    np.add.at(mean, label, flat)
    mean /= np.bincount(label)[:, None]
    # a member that differs by more than float32 sees stays alone
    alone = np.abs(flat - mean[label]).max(axis=1) > 3e-7
    label = np.where(alone, count + np.arange(len(label)), label)
    group = np.full(len(label), -1)
    used = 0
    for members in _by_label(label):
        for part in _spatial_parts(members, centre):
            group[part] = used
            used += 1
            if len(part) > 1:
                _share(leaves, part, flat, middle, scale)
    leaves.group = group
    leaves.form[:, DEVIATION] = _deviation(leaves, patches)
    return leaves.select(np.argsort(group, kind="stable"))


def _deviation(leaves: Leaves, patches: BezierTriangles) -> np.ndarray:
    """Return the largest distance ``(L,)`` of points of each patch from its group's quadric.

    In sizes of the patch, to first order: ``|f| / |grad f|``. It is rounding: that of float64,
    or of float32 where the net came through it.
    """
    lattice = bernstein.multi_indices(4)[:, :2] / 4.0
    points = bernstein.basis(patches.degree, lattice) @ patches.control_points
    points[..., :3] -= points[..., 3:] * leaves.shift[:, None]
    forms = _matrices(leaves.form)
    gradient = np.einsum("lab,lsb->lsa", forms, points)
    value = np.abs(np.einsum("lsa,lsa->ls", points, gradient))
    slope = 2 * np.linalg.norm(gradient[..., :3], axis=-1)
    _centre, size = _centre_and_size(patches)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = value / (slope * np.abs(points[..., 3]) * size[:, None])
    # no number where a point is at infinity or the gradient vanishes, as at the tip of a cone
    distance = np.where(np.isfinite(distance), distance, 0.0)
    # 2: between the samples, and what the neighbour's quadric is off
    return np.minimum(2 * distance.max(axis=1) + 1e-12, 1e-6)


def _by_label(label: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _spatial_parts(members: np.ndarray, centre: np.ndarray) -> list[np.ndarray]:
    if len(members) <= _GROUP:
        return [members]
    points = centre[members]
    axis = int(np.ptp(points, axis=0).argmax())
    members = members[np.argsort(points[:, axis], kind="stable")]
    half = len(members) // 2
    return _spatial_parts(members[:half], centre) + _spatial_parts(members[half:], centre)


def _share(
    leaves: Leaves, part: np.ndarray, flat: np.ndarray, middle: np.ndarray, scale: float
) -> None:
    """Write one origin and one quadric to all leaves of a group."""
    with np.errstate(invalid="ignore"):  # -inf + inf of patches that run to the horizon
        shift = (leaves.box[part, 0].min(axis=0) + leaves.box[part, 1].max(axis=0)) / 2
    shift = np.where(np.isfinite(shift), shift, leaves.shift[part].mean(axis=0))
    shift = shift.astype(np.float32).astype(np.float64)
    move = np.eye(4)
    move[:3, :3] /= scale
    move[:3, 3] = (shift - middle) / scale
    form = move.T @ flat[part].mean(axis=0).reshape(4, 4) @ move
    form /= np.abs(form).max()
    leaves.form[part, :10] = [form[i, j] for i, j in FORM_ENTRIES]
    leaves.frame[part, :, 3] += np.einsum(
        "lrc,lc->lr", leaves.frame[part, :, :3], shift - leaves.shift[part]
    )
    leaves.shift[part] = shift


def _matrices(form: np.ndarray) -> np.ndarray:
    out = np.zeros((len(form), 4, 4))
    for c, (i, j) in enumerate(FORM_ENTRIES):
        out[:, i, j] = out[:, j, i] = form[:, c]
    return out
