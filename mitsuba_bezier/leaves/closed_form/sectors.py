"""Find sectors of cones.

They are quadratic patches with two straight edges, between a corner ``A`` and those of an arc
``P, Q, R``, and no linear form gives their parameters.

If all control points but those of the arc lie in the apex, the patch is
``u^2 P + 2 u v Q + v^2 R + (1 - (u + v)^2) A``, homogeneously. With coordinates
``(b_0, b_1, b_2, a)`` for ``P, Q, R, A`` it lies on the cone ``b_1^2 = 4 b_0 b_2``, within the
planes ``b_1 >= 0``, ``b_0 + b_2 >= 0`` and ``a >= 0``; and with ``l = b_0 + b_1 + b_2 + a`` the
parameters are ``u^2 = b_0 / l`` and ``v / u = b_1 / (2 b_0)``.

Inverted leaves meet the same patches, exactly up to the apex, too. These stay because they are
cheaper (by up to a sixth of the processor time for coherent rays at a cone, a tenth for random
ones), and keep hits on the silhouette that inverted leaves leave to rounding.
"""

from __future__ import annotations

import numpy as np

from ...geometry import bernstein
from ...geometry.linear import inverses
from ...geometry.triangles import BezierTriangles
from ..records import ClosedFormLeaves, LeafKind, weight_signs
from .fits import in_space, local_nets
from .groups import quadric_leaves

__all__ = ["cone_planes", "sector_leaves"]

#: Control points are where they should be up to this: nets come through Mitsuba's float32 tensors
#: (6e-8).
_ROUNDING = 3e-7
#: Singular values below this share of the largest leave the coordinates undetermined.
_DETERMINED = 1e-3


def sector_leaves(patches: BezierTriangles) -> tuple[np.ndarray, ClosedFormLeaves]:
    """Find such patches, with ``A`` in any corner, and return ``(mask, leaves)``."""
    n, nets = patches.degree, patches.control_points
    found = np.zeros(len(nets), dtype=bool)
    sign = weight_signs(nets)
    if n != 2 or not sign.any():
        return found, ClosedFormLeaves.zeros()
    local, shift, size = local_nets(patches)
    local *= sign[:, None, None]
    rows, forms = np.zeros((2, len(nets), 4, 4))
    apex = np.zeros(len(nets), dtype=int)
    for corner in range(3):
        which = np.flatnonzero((sign != 0) & ~found)
        i, j = (corner + 1) % 3, (corner + 2) % 3
        pairs = ((corner, corner), (i, i), (i, j), (j, j), (i, corner), (j, corner))
        good, *found_there = _cones(*(local[which, _row(*pair)] for pair in pairs))
        which = which[good]
        rows[which], forms[which] = (x[good] for x in found_there)
        apex[which] = corner
        found[which] = True
    which = np.flatnonzero(found)
    if not len(which):
        return found, ClosedFormLeaves.zeros()
    forms = forms[which] / np.abs(forms[which]).max(axis=(1, 2), keepdims=True)
    found_rows, quadric = in_space(rows[which], forms, size[which])
    return found, quadric_leaves(
        patches, which, shift[which], found_rows, quadric, LeafKind.CONE, corner=apex[which]
    )


def cone_planes(leaves: ClosedFormLeaves) -> np.ndarray:
    """Return the planes that bound sectors of cones, rows ``(L, 3, 4)`` on ``(p - shift, 1)``."""
    b0, b1, b2, total = leaves.rows.transpose(1, 0, 2)
    return np.stack([b1, b0 + b2, total - b0 - b1 - b2], axis=1)


def _row(i: int, j: int) -> int:
    """Return the row of the control point between corners `i` and `j` of a quadratic net."""
    ijk = [0, 0, 0]
    ijk[i] += 1
    ijk[j] += 1
    return bernstein.row(2, ijk[0], ijk[1])


def _near(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.abs(points - others).max(axis=1) <= _ROUNDING


def _coordinates(basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the four points of bases ``(P, 4, 4)`` are one, and the rows of coordinates."""
    s = np.linalg.svd(basis, compute_uv=False)
    good = s[:, 3] > _DETERMINED * s[:, 0]
    rows, regular = inverses(basis.transpose(0, 2, 1))
    return good & regular, rows


def _product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the quadratic forms ``2 x(p) y(p)`` of linear forms ``(P, 4)``."""
    mixed = x[:, :, None] * y[:, None]
    return mixed + mixed.transpose(0, 2, 1)


def _cones(
    a: np.ndarray, p: np.ndarray, q: np.ndarray, r: np.ndarray, ap: np.ndarray, ar: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a mask of such sectors, and rows and forms in units of the nets."""
    apex = (a + ap + ar) / 3
    good, rows = _coordinates(np.stack([p, q, r, apex], axis=1))
    good &= _near(a, apex) & _near(ap, apex) & _near(ar, apex)
    form = _product(rows[:, 1], rows[:, 1]) / 2 - 2 * _product(rows[:, 0], rows[:, 2])
    rows[:, 3] = rows.sum(axis=1)
    return good, rows, form
