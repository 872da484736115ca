"""`Joins`: how far neighbours are from having one tangent plane along their common edges."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array

from .._runtime import import_mitsuba
from ..errors import GeometryError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from .nets import Net
from .parametrization import as_patches

__all__ = ["Joins"]

#: Ends of the three edges in the parameters of a patch.
_ENDS = np.array([[[1, 0], [0, 1]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]], dtype=float)


class Joins:
    """Mean of ``1 - cos`` of the angles between neighbours along their common edges.

    Zero if and only if the surface is G1 at the points looked at, ``2 n + 1`` on an edge, of which
    corners take no part. Added to the loss of a search, it lets the surface bend but not crease.

    Parameters
    ----------
    patches : BezierTriangles or (P, K, 4) array_like
        The surface at the start: which edges are joined, and which side is the front.
    most : float
        Edges with a crease of more than this angle, in degrees, at the start stay creases.

    Raises
    ------
    GeometryError
        If no two patches meet.

    Examples
    --------
    >>> import mitsuba_bezier as mb
    >>> from mitsuba_bezier import fit
    >>> fit.Joins(mb.sphere(cover="octants")).count
    12
    """

    def __init__(self, patches: Any, most: float = 180.0) -> None:
        self.most = most
        self._prepare(as_patches(patches))
        if not self.count:
            raise GeometryError.expected("patches", "patches that meet along edges", "none")

    def _prepare(self, patches: BezierTriangles) -> None:
        self.shape = patches.control_points.shape
        n = patches.degree
        pairs = _pairs(patches)
        t = (np.arange(1, 2 * n + 2) - 0.5) / (2 * n + 1)
        patch, uv = [], []
        for side in range(2):
            for first, second, backward in pairs:
                number = first if side == 0 else second
                start, end = _ENDS[number % 3]
                s = 1 - t if side and backward else t
                uv.append(start + s[:, None] * (end - start))
                patch.append(np.full(len(t), number // 3))
        self.count = len(pairs)
        if not pairs:
            return
        patch_, uv_ = np.concatenate(patch), np.concatenate(uv)
        normals = patches.normals(patch_, uv_).reshape(2, -1, 3)
        cosine = np.einsum("ni,ni->n", *normals)
        good = np.isfinite(cosine)
        # per edge: same fronts, or opposite ones; edges that are creases stay
        table = np.where(good, cosine, 0).reshape(self.count, len(t))
        sign = np.where(table.sum(axis=1) < 0, -1.0, 1.0)
        crease = (table * sign[:, None] < np.cos(np.radians(self.most))) & good.reshape(table.shape)
        keep = good & np.repeat(~crease.any(axis=1), len(t))
        self.sign = np.repeat(sign, len(t))[keep]
        both = np.concatenate([keep, keep])
        self.maps = _derivative_maps(patches, patch_[both], uv_[both])

    def __call__(self, net: Any) -> Any:
        """Return the term for control points ``(P, K, 4)`` as a tensor of Dr.Jit."""
        import drjit as dr

        mi = import_mitsuba()
        if tuple(net.shape) != self.shape:  # refined in between
            values = np.array(net, dtype=np.float64).reshape(net.shape)
            self._prepare(BezierTriangles(values))
        rows = len(self.sign) * 2
        found = []
        for row, col, value in self.maps:
            columns = []
            for c in range(4):
                out = dr.zeros(mi.Float, rows)
                product = mi.Float(value) * dr.gather(mi.Float, net.array, mi.UInt32(4 * col + c))
                dr.scatter_reduce(dr.ReduceOp.Add, out, product, mi.UInt32(row))
                columns.append(out)
            found.append(columns)
        x, xu, xv = found
        # of X/w: w^2 times the partial derivatives, whose factor does not turn the normal
        du = mi.Vector3f(*(xu[c] * x[3] - x[c] * xu[3] for c in range(3)))
        dv = mi.Vector3f(*(xv[c] * x[3] - x[c] * xv[3] for c in range(3)))
        normal = dr.normalize(dr.cross(du, dv))
        half = dr.arange(mi.UInt32, rows // 2)
        first = dr.gather(mi.Vector3f, normal, half)
        second = dr.gather(mi.Vector3f, normal, half + rows // 2)
        return dr.mean(1 - mi.Float(self.sign) * dr.dot(first, second))


def _pairs(patches: BezierTriangles) -> list[tuple[int, int, bool]]:
    """Return pairs of edges ``3 * patch + edge`` that are one curve, and which run backward."""
    net = Net(patches)
    vertex = net.vertex.reshape(len(patches), -1)[:, bernstein.edge_rows(patches.degree)]
    known: dict[tuple[int, ...], int] = {}
    out = []
    for number, line in enumerate(vertex.reshape(-1, vertex.shape[-1])):
        if len(set(line)) == 1:  # collapsed
            continue
        forward = tuple(int(x) for x in line)
        for key, backward in ((forward, False), (forward[::-1], True)):
            if key in known:
                out.append((known.pop(key), number, backward))
                break
        else:
            known[forward] = number
    return out


def _derivative_maps(
    patches: BezierTriangles, patch: np.ndarray, uv: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return rows, columns and values of the sparse maps from nets to X, X_u and X_v."""
    n = patches.degree
    count = patches.control_points.shape[1]
    value = bernstein.basis(n, uv)
    lower = bernstein.basis(n - 1, uv)
    matrices = [value, *(lower @ d for d in bernstein.partials_matrices(n))]
    out = []
    for dense in matrices:
        sparse = coo_array(dense)
        row, col = sparse.coords
        out.append((row, col + count * patch[row], sparse.data))
    return out
