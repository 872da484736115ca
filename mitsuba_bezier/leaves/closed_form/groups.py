"""Patches on quadrics: which share one, where its origin is, and how well they lie on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...geometry import bernstein
from ...geometry.triangles import BezierTriangles
from ..records import INVERTED_KINDS, NO_APEX, ClosedFormLeaves, LeafKind
from .affine_frames import AffineFrame
from .fits import (
    centre_and_size,
    entries,
    fit_forms,
    matrices,
    relative_distance,
    with_apex,
    with_its_apex,
)

__all__ = ["grouped", "in_space_of", "quadric_leaves"]

#: Patches looked at together: bounds the memory.
_CHUNK = 512


def quadric_leaves(
    patches: BezierTriangles,
    which: np.ndarray,
    shift: np.ndarray,
    rows: np.ndarray,
    quadric: np.ndarray,
    kind: np.ndarray | LeafKind,
    **known: np.ndarray,
) -> ClosedFormLeaves:
    """Return the leaves of patches that are met through a quadric, grouped.

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
    quadric : (L, 10) array
    kind : LeafKind, or (L,) array
    known : arrays
        What leaves of this kind have beside: other fields of `ClosedFormLeaves`.
    """
    count = len(which)
    four = np.zeros((count, 4, 4))
    four[:, : rows.shape[1]] = rows
    eye = np.broadcast_to(np.eye(3), (count, 3, 3))
    leaves = ClosedFormLeaves.zeros(
        count,
        patch=which,
        kind=np.broadcast_to(kind, count).astype(int),
        shift=shift,
        axes=eye.copy(),
        quadric=quadric,
        rows=four,
        box=_tight_boxes(patches[which]),
        **{"domain": eye.copy(), "corner": np.full(count, NO_APEX), **known},
    )
    return grouped(leaves, patches[which])


def in_space_of(
    frame: AffineFrame, leaves: ClosedFormLeaves, patches: BezierTriangles
) -> ClosedFormLeaves:
    """Return leaves that were built from patches in axes of their own, for rays in space.

    Parameters
    ----------
    frame : AffineFrame
    leaves : ClosedFormLeaves
    patches : BezierTriangles
        Those of the frame, in space.
    """
    count = len(leaves)
    return replace(
        leaves,
        patch=frame.which[leaves.patch],
        shift=frame.centre + leaves.shift @ np.linalg.inv(frame.axes).T,
        axes=np.broadcast_to(frame.axes, (count, 3, 3)).copy(),
        box=_tight_boxes(patches[leaves.patch]),
    )


def _tight_boxes(patches: BezierTriangles) -> np.ndarray:
    """Return boxes of control points after a few midpoint splits, ``(P, 2, 3)``."""
    nets = patches.control_points
    split = bernstein.split_matrices(patches.degree, 3)
    split = split.reshape(-1, split.shape[2])
    box = np.empty((len(nets), 2, 3))
    for first in range(0, len(nets), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        fine = BezierTriangles((split @ nets[chunk]).reshape(-1, *nets.shape[1:]))
        parts = fine.hulls().reshape(len(nets[chunk]), -1, 2, 3)
        box[chunk, 0], box[chunk, 1] = parts[:, :, 0].min(axis=1), parts[:, :, 1].max(axis=1)
    return box


#: Inverted patches whose quadrics are alike up to the first, as those of parts of a quadric in
#: float32 are, share one if all are within the second of it, in their sizes.
_ALIKE, _SAME = 1e-3, 5e-7

#: Patches further than this from the quadric of their group, in their sizes, have another: what
#: `deviation` is at most, and three times what they may be from their own.
_WRONG = 1e-6

#: No simple fraction.
_ASIDE = 0.1234567

#: Most patches in a group: its members are tried one after the other. More if all are inverted, for
#: which there is a table of those that may have a point.
_GROUP, _LARGEST_GROUP = 12, 16


def grouped(leaves: ClosedFormLeaves, patches: BezierTriangles) -> ClosedFormLeaves:
    """Number the leaves by quadric, and give each group one quadric and one origin.

    A ray then meets the quadric of a whole group once. Groups of more patches than `_GROUP` says
    are cut in space.
    """
    forms, shift = matrices(leaves.quadric), leaves.shift.copy()
    group, distance = np.full(len(leaves), -1), np.zeros(len(leaves))
    used = 0
    classes = [np.arange(len(leaves))]
    while classes:
        tried = []
        for members in classes:
            parts = _on_one_quadric(leaves, patches, members)
            if used and len(parts) == 1:  # looked at again, and not told apart
                parts = [members[k : k + 1] for k in range(len(members))]
            tried += parts
        for part in tried:
            group[part] = used
            used += 1
            forms[part], shift[part] = _common_quadric(leaves, patches, part)
        every = np.concatenate(tried)
        distance[every] = relative_distance(patches[every], forms[every], shift[every])
        classes = [part for part in tried if len(part) > 1 and distance[part].max() > _WRONG]
    leaves.group = group
    leaves.quadric = entries(forms)
    leaves.rows[:, :, 3] += np.einsum("lrc,lc->lr", leaves.rows[:, :, :3], shift - leaves.shift)
    leaves.shift = shift
    leaves.span = leaves.box - shift[:, None]
    # 2: between the samples, and what the neighbour's quadric is off
    leaves.deviation = np.minimum(2 * distance + 1e-12, _WRONG)
    return leaves.select(np.argsort(group, kind="stable"))


def _on_one_quadric(
    leaves: ClosedFormLeaves, patches: BezierTriangles, members: np.ndarray
) -> list[np.ndarray]:
    """Return parts of `members` that are on one quadric each, as far as their common size tells.

    Quadrics that differ by little in that size, as concentric spheres that are small, are taken
    for one: these are not on what they would share, and in their own size they differ.
    """
    patches = patches[members]
    centre, size = centre_and_size(patches)
    middle, scale = _middle_and_scale(centre, size)
    flat = _flat_forms(leaves, members, middle, scale)
    label = _labels(flat, 1e-5)
    count = label.max() + 1
    mean = np.zeros((count, 16))
    np.add.at(mean, label, flat)
    mean /= np.bincount(label)[:, None]
    # a member that differs by more than float32 sees stays alone
    alone = np.abs(flat - mean[label]).max(axis=1) > 3e-7
    label = np.where(alone, count + np.arange(len(label)), label)
    is_inverted = leaves.is_one_of(INVERTED_KINDS)[members]
    inverted = np.flatnonzero(is_inverted)
    alike = [_by_label(_labels(flat[inverted] + k * _ALIKE / 2, _ALIKE)) for k in range(2)]
    for part in alike[0] + alike[1] if len(inverted) else []:
        chosen = inverted[part]
        if len(np.unique(label[chosen])) > 1:
            form = _fit_together(patches[chosen], middle, scale)
            if form is not None and _distances(patches[chosen], form, middle, scale) < _SAME:
                label[chosen] = label[chosen[0]]
    return [
        members[part]
        for same in _by_label(label)
        for part in _spatial_parts(
            same, centre, _LARGEST_GROUP if is_inverted[same].all() else _GROUP
        )
    ]


def _flat_forms(
    leaves: ClosedFormLeaves, members: np.ndarray, middle: np.ndarray, scale: float
) -> np.ndarray:
    """Return the quadrics as 16 numbers, of unit length, on ``(p - middle) / scale``."""
    forms = matrices(leaves.quadric[members])
    # f(p - shift) as a form on (p - middle) / scale
    move = np.broadcast_to(np.eye(4), forms.shape).copy()
    move[:, :3, :3] *= scale
    move[:, :3, 3] = middle - leaves.shift[members]
    flat = np.einsum("lai,lab,lbj->lij", move, forms, move).reshape(-1, 16)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    # the first of the largest entries is positive: for spheres there are several
    size = np.abs(flat)
    first = (size > 0.999 * size.max(axis=1, keepdims=True)).argmax(axis=1)
    return flat * np.sign(np.take_along_axis(flat, first[:, None], axis=1))


def _middle_and_scale(centre: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the middle of patches, and how far they reach from there."""
    middle = (centre.min(axis=0) + centre.max(axis=0)) / 2
    middle = middle.astype(np.float32).astype(np.float64)
    return middle, float((np.abs(centre - middle).max(axis=1) + size).max())


def _labels(flat: np.ndarray, unit: float) -> np.ndarray:
    """Number rows of numbers: equal ones, up to a unit, are mostly alike."""
    # moved, as fractions such as 1/64 would lie halfway: a rounding would decide
    _values, label = np.unique(np.round(flat / unit + _ASIDE), axis=0, return_inverse=True)
    return label.reshape(-1)


def _distances(
    patches: BezierTriangles, form: np.ndarray, middle: np.ndarray, scale: float
) -> float:
    """Return the largest distance of patches from a quadric on ``(p - middle) / scale``, in sizes.

    See `relative_distance`.
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


def _common_quadric(
    leaves: ClosedFormLeaves, patches: BezierTriangles, part: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the quadric, a matrix on ``(p - shift, 1)``, and the shift of a group's leaves."""
    if len(part) == 1:
        return matrices(leaves.quadric[part])[0], leaves.shift[part[0]]
    with np.errstate(invalid="ignore"):  # -inf + inf of patches that run to the horizon
        shift = (leaves.box[part, 0].min(axis=0) + leaves.box[part, 1].max(axis=0)) / 2
    shift = np.where(np.isfinite(shift), shift, leaves.shift[part].mean(axis=0))
    shift = shift.astype(np.float32).astype(np.float64)
    middle, scale = _middle_and_scale(*centre_and_size(patches[part]))
    move = np.eye(4)
    move[:3, :3] /= scale
    move[:3, 3] = (shift - middle) / scale
    form = _fit_together(patches[part], middle, scale)
    if form is None:
        form = _flat_forms(leaves, part, middle, scale).mean(axis=0).reshape(4, 4)
    form = move.T @ form @ move
    cones = part[leaves.kind[part] == LeafKind.CONE]
    if len(cones):
        rows = np.array(bernstein.corner_rows(patches.degree))[leaves.corner[cones]]
        apex = patches.control_points[cones, rows]
        form = with_apex(form, (apex[:, :3] / apex[:, 3:]).mean(axis=0) - shift)
    inverted = part[leaves.is_one_of(INVERTED_KINDS)[part]]
    if len(inverted):
        moved = patches.control_points[inverted].copy()
        moved[..., :3] -= moved[..., 3:] * shift
        form = with_its_apex(form, moved)
    return form / np.abs(form).max(), shift


def _fit_together(patches: BezierTriangles, middle: np.ndarray, scale: float) -> np.ndarray | None:
    """Fit the quadric of a group to points of all its patches, on ``(p - middle) / scale``.

    A whole quadric is better determined than the mean of what each of its patches tells: for
    octants in float32 by a factor of three. None where the points leave it open (planes).
    """
    n = patches.degree
    lattice = bernstein.multi_indices(2 * n)[:, :2] / (2 * n)
    points = (bernstein.basis(n, lattice) @ patches.control_points).reshape(-1, 4)
    points[:, :3] = (points[:, :3] - points[:, 3:] * middle) / scale
    form, s = fit_forms(points[None])
    return form[0] if s[0, -2] > 1e-3 * s[0, 0] else None
