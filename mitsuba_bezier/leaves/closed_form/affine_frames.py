"""Axes in which a thin body is about as large in one direction as in another.

Closed forms, their tolerances and their roundings are those of a body of even proportions. One
that is a hundred times as long as it is wide, or a million times, is taken to such first: an affine
map, found here, takes quadrics to quadrics and patches to patches with the same parameters, and
kernels take rays along (`kernels.closed_form.quadric`), in float64. Then proportions cancel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import bernstein
from ...geometry.triangles import BezierTriangles

__all__ = ["AffineFrame", "affine_frames"]

#: Bodies whose proportions are beyond this have axes of their own. Rays pay for them, and below
#: this too few digits are lost to matter.
_THIN = 32.0
#: What is flatter than this is plane, and has no thickness to go by: nets in float32 have 6e-8.
_PLANE = 2e-7
#: Corners nearer to each other than this, as a share of all, may be those of one body.
_SAME = 1e-6


@dataclass
class AffineFrame:
    """A body, and the map to its own axes, ``axes (p - centre)``."""

    which: np.ndarray  #: (N,) numbers of its patches
    centre: np.ndarray  #: (3,)
    axes: np.ndarray  #: (3, 3)

    def apply(self, patches: BezierTriangles) -> BezierTriangles:
        """Return patches in these axes."""
        nets = patches.control_points.copy()
        nets[..., :3] = (nets[..., :3] - nets[..., 3:] * self.centre) @ self.axes.T
        return BezierTriangles(nets)


def affine_frames(patches: BezierTriangles) -> list[AffineFrame]:
    """Return the thin bodies of a set; patches are of one body if they share corners."""
    uv = bernstein.multi_indices(2)[:, :2] / 2.0
    points = bernstein.basis(patches.degree, uv) @ patches.control_points
    with np.errstate(divide="ignore", invalid="ignore"):
        points = points[..., :3] / points[..., 3:]
    points[~np.isfinite(points).all(axis=2)] = np.nan
    out = []
    for which in _bodies(points):
        cloud = points[which].reshape(-1, 3)
        cloud = cloud[np.isfinite(cloud[:, 0])]
        if len(cloud) < 4:
            continue
        centre = cloud.mean(axis=0)
        _u, size, axes = np.linalg.svd((cloud - centre) / np.sqrt(len(cloud)), full_matrices=False)
        size = np.where(size > _PLANE * size[0], size, 0.0)
        if size[1] == 0.0:
            continue
        size[2] = size[2] or size[1]
        if size[0] > _THIN * size[2]:
            out.append(AffineFrame(which, centre, axes / size[:, None]))
    return out


def _bodies(points: np.ndarray) -> list[np.ndarray]:
    """Return the numbers of patches that hang together by their corners, from `points` of each."""
    corners = points[:, bernstein.corner_rows(2)]
    finite = np.isfinite(corners).all(axis=2)
    known = np.where(finite[..., None], corners, 0.0)
    unit = _SAME * max(np.abs(known).max(initial=0.0), 1e-300)
    label = np.arange(len(points))
    joints = []
    for k in range(2):  # what is on both sides of a border in one grid is not in the other
        cells = np.round(known / unit + k / 2)
        _cells, joint = np.unique(cells.reshape(-1, 3), axis=0, return_inverse=True)
        joints.append(joint.reshape(-1, 3))
    while True:
        before = label
        for joint in joints:
            least = np.full(joint.max(initial=0) + 1, len(points))
            np.minimum.at(least, joint[finite], np.repeat(label, finite.sum(axis=1)))
            at_corners = np.where(finite, least[joint], len(points))
            label = np.minimum(label, at_corners.min(axis=1))
        label = label[label]
        if (label == before).all():
            break
    order = np.argsort(label, kind="stable")
    return [x for x in np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(x)]
