"""Patches on quadrics: which share one, where its origin is, and how well they lie on it."""

from __future__ import annotations

import numpy as np

from . import bernstein
from .leaves import DEVIATION, FORM, FORM_ENTRIES, SECTION, Leaves
from .triangles import BezierTriangles

__all__ = [
    "centre_and_size",
    "fit_forms",
    "grouped",
    "in_space",
    "local_nets",
    "plane_forms",
    "quadric_leaves",
    "relative_distance",
    "with_its_apex",
]


def quadric_leaves(
    patches: BezierTriangles,
    which: np.ndarray,
    shift: np.ndarray,
    rows: np.ndarray,
    form: np.ndarray,
) -> Leaves:
    """Return the records of whole patches that are met through a quadric, grouped.

    Parameters
    ----------
    patches : BezierTriangles
        All patches.
    which : (L,) int array
        Those meant.
    shift : (L, 3) array
        Origin of the records.
    rows : (L, 3, 4) or (L, 4, 4) array
        Take ``(p - shift, 1)`` to the barycentrics of the leaf, or what else finds these.
    form : (L, FORM) array
        The quadric and more, see `leaves`.
    """
    k = patches.control_points.shape[1]
    frame = np.zeros((len(which), 4, 4))
    frame[:, : rows.shape[1]] = rows
    leaves = Leaves(
        patch=which,
        domain=np.broadcast_to(np.eye(3), (len(which), 3, 3)).copy(),
        exact=np.ones(len(which), dtype=bool),
        shift=shift,
        frame=frame,
        form=form,
        net=np.zeros((len(which), k, 4)),
        box=_tight_boxes(patches[which]),
        certified=np.ones(len(which), dtype=bool),
        group=np.arange(len(which)),
    )
    return grouped(leaves, patches[which])


def _tight_boxes(patches: BezierTriangles, levels: int = 3) -> np.ndarray:
    """Return boxes of control points after a few midpoint splits, ``(P, 2, 3)``."""
    fine = patches
    for _ in range(levels):
        fine = fine.split()
    box = fine.bounds().reshape(len(patches), 4**levels, 2, 3)
    return np.stack([box[:, :, 0].min(axis=1), box[:, :, 1].max(axis=1)], axis=1)


def centre_and_size(patches: BezierTriangles) -> tuple[np.ndarray, np.ndarray]:
    """Return a finite float32 point near each patch and its size; the box tells both."""
    box = patches.bounds()
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
    form : (L, FORM) array
        With the quadric, of which a gradient of order one makes a length; the rest is zero.
    """
    units = np.ones((len(size), 4))
    units[:, :3] /= size[:, None]
    forms = forms * units[:, None] * units[:, :, None] * size[:, None, None]
    form = np.zeros((len(size), FORM))
    form[:, :10] = np.stack([forms[:, i, j] for i, j in FORM_ENTRIES], axis=-1)
    return rows * units[:, None], form


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


#: Inverted patches whose quadrics are alike up to the first, as those of parts of a quadric in
#: float32 are, share one if all are within the second of it, in their sizes.
_ALIKE, _SAME = 1e-3, 5e-7

#: A fitted quadric is a cone if its least eigenvalue is below this share of the largest; its apex
#: is a corner of a patch if so close, in the patches' size.
_SINGULAR, _AT_APEX = 1e-5, 1e-4

#: Most patches in a group: its members are tried one after the other. More if all are inverted, for
#: which there is a table of those that may have a point.
_GROUP, _LARGEST_GROUP = 12, 16


def grouped(leaves: Leaves, patches: BezierTriangles) -> Leaves:
    """Number the leaves by quadric, and give each group one quadric and one origin.

    A ray then meets the quadric of a whole group once. Groups of more patches than `_GROUP` says
    are cut in space.
    """
    centre, size = centre_and_size(patches)
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
    # the first of the largest entries is positive: for spheres there are several
    size = np.abs(flat)
    first = (size > 0.999 * size.max(axis=1, keepdims=True)).argmax(axis=1)
    leading = np.take_along_axis(flat, first[:, None], axis=1)
    flat = flat * np.sign(leading)
    label = _labels(flat, 1e-5)
    count = label.max() + 1
    mean = np.zeros((count, 16))
    np.add.at(mean, label, flat)
    mean /= np.bincount(label)[:, None]
    # a member that differs by more than float32 sees stays alone
    alone = np.abs(flat - mean[label]).max(axis=1) > 3e-7
    label = np.where(alone, count + np.arange(len(label)), label)
    inverted = np.flatnonzero(leaves.are_inverted)
    alike = [_by_label(_labels(flat[inverted] + k * _ALIKE / 2, _ALIKE)) for k in range(2)]
    for part in alike[0] + alike[1] if len(inverted) else []:
        members = inverted[part]
        if len(np.unique(label[members])) > 1:
            form = _fit_together(patches, members, middle, scale)
            if form is not None and _distances(patches[members], form, middle, scale) < _SAME:
                label[members] = label[members[0]]
    group = np.full(len(label), -1)
    used = 0
    for members in _by_label(label):
        most = _LARGEST_GROUP if leaves.are_inverted[members].all() else _GROUP
        for part in _spatial_parts(members, centre, most):
            group[part] = used
            used += 1
            if len(part) > 1:
                _share(leaves, patches, part, flat, middle, scale)
    leaves.group = group
    leaves.form[:, DEVIATION] = _deviation(leaves, patches)
    return leaves.select(np.argsort(group, kind="stable"))


def _deviation(leaves: Leaves, patches: BezierTriangles) -> np.ndarray:
    """Return the largest distance ``(L,)`` of points of each patch from its group's quadric.

    In sizes of the patch, to first order: ``|f| / |grad f|``. It is rounding: that of float64,
    or of float32 where the net came through it.
    """
    distance = relative_distance(patches, _matrices(leaves.form), leaves.shift)
    # 2: between the samples, and what the neighbour's quadric is off
    return np.minimum(2 * distance + 1e-12, 1e-6)


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


def _labels(flat: np.ndarray, unit: float) -> np.ndarray:
    """Number rows of numbers: equal ones, up to a unit, are mostly alike."""
    _values, label = np.unique(np.round(flat / unit), axis=0, return_inverse=True)
    return label.reshape(-1)


def _distances(
    patches: BezierTriangles, form: np.ndarray, middle: np.ndarray, scale: float
) -> float:
    """Return the largest distance of patches from a quadric on ``(p - middle) / scale``, in sizes.

    See `_deviation`.
    """
    move = np.eye(4)
    move[:3, :3] /= scale
    move[:3, 3] = -middle / scale
    forms = np.broadcast_to(move.T @ form @ move, (len(patches), 4, 4))
    return float(relative_distance(patches, forms, np.zeros((len(patches), 3))).max())


def _by_label(label: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _spatial_parts(members: np.ndarray, centre: np.ndarray, most: int) -> list[np.ndarray]:
    if len(members) <= most:
        return [members]
    points = centre[members]
    axis = int(np.ptp(points, axis=0).argmax())
    members = members[np.argsort(points[:, axis], kind="stable")]
    half = len(members) // 2
    return [
        part
        for side in (members[:half], members[half:])
        for part in _spatial_parts(side, centre, most)
    ]


def _share(
    leaves: Leaves,
    patches: BezierTriangles,
    part: np.ndarray,
    flat: np.ndarray,
    middle: np.ndarray,
    scale: float,
) -> None:
    """Write one origin and one quadric to all leaves of a group."""
    with np.errstate(invalid="ignore"):  # -inf + inf of patches that run to the horizon
        shift = (leaves.box[part, 0].min(axis=0) + leaves.box[part, 1].max(axis=0)) / 2
    shift = np.where(np.isfinite(shift), shift, leaves.shift[part].mean(axis=0))
    shift = shift.astype(np.float32).astype(np.float64)
    move = np.eye(4)
    move[:3, :3] /= scale
    move[:3, 3] = (shift - middle) / scale
    form = _fit_together(patches, part, middle, scale)
    if form is None:
        form = flat[part].mean(axis=0).reshape(4, 4)
    form = move.T @ form @ move
    cones = part[leaves.are_cones[part]]
    if len(cones):
        corner = (-1 - leaves.form[cones, SECTION]).astype(int)
        rows = np.array(bernstein.corner_rows(patches.degree))[corner]
        apex = patches.control_points[cones, rows]
        form = _with_apex(form, (apex[:, :3] / apex[:, 3:]).mean(axis=0) - shift)
    inverted = part[leaves.are_inverted[part]]
    if len(inverted):
        moved = patches.control_points[inverted].copy()
        moved[..., :3] -= moved[..., 3:] * shift
        form = with_its_apex(form, moved)
    form /= np.abs(form).max()
    leaves.form[part, :10] = [form[i, j] for i, j in FORM_ENTRIES]
    leaves.frame[part, :, 3] += np.einsum(
        "lrc,lc->lr", leaves.frame[part, :, :3], shift - leaves.shift[part]
    )
    leaves.shift[part] = shift


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
    return _with_apex(form, corners[near].mean(axis=0))


def _with_apex(form: np.ndarray, apex: np.ndarray) -> np.ndarray:
    """Return the cone with this apex that differs from a quadric by rounding.

    A quadric fitted to points in float32 is off by 1e-7: next to the apex of a cone it may be a
    hyperboloid, with a neck of the root of that.
    """
    out = form.copy()
    out[:3, 3] = out[3, :3] = -form[:3, :3] @ apex
    out[3, 3] = apex @ form[:3, :3] @ apex
    return out


def _fit_together(
    patches: BezierTriangles, part: np.ndarray, middle: np.ndarray, scale: float
) -> np.ndarray | None:
    """Fit the quadric of a group to points of all its patches, on ``(p - middle) / scale``.

    A whole quadric is better determined than the mean of what each of its patches tells: for
    octants in float32 by a factor of three. None where the points leave it open (planes).
    """
    n = patches.degree
    lattice = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    points = (bernstein.basis(n, lattice) @ patches.control_points[part]).reshape(-1, 4)
    points[:, :3] = (points[:, :3] - points[:, 3:] * middle) / scale
    form, s = fit_forms(points[None])
    return form[0] if s[0, -2] > 1e-3 * s[0, 0] else None


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
    columns = [(1 if i == j else 2) * unit[..., i] * unit[..., j] for i, j in FORM_ENTRIES]
    _u, s, vt = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
    return _matrices(vt[:, -1]), s


def _matrices(form: np.ndarray) -> np.ndarray:
    out = np.zeros((len(form), 4, 4))
    for c, (i, j) in enumerate(FORM_ENTRIES):
        out[:, i, j] = out[:, j, i] = form[:, c]
    return out
