"""`Quadric`: quadratic patches that stay on one quadric, by its ten numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import GeometryError, NetError
from ..geometry.checks import finite_array
from ..geometry.quadric_patches import characterize
from ..geometry.quadrics import normalize_quadric
from ..geometry.triangles import BezierTriangles
from .parametrization import Parametrization, as_patches, assembled, spread

__all__ = ["Quadric"]

#: The six entries of a symmetric matrix above its diagonal, and the four on it.
_UPPER = np.triu_indices(4)

#: Rows of a quadratic net: corners, and the middle between each two of them.
_CORNERS = (0, 3, 5)
_MIDDLES = {1: (0, 1), 2: (0, 2), 4: (1, 2)}


class Quadric(Parametrization):
    """Quadratic patches on one quadric ``x'Ax = 0``, by the ten numbers of A.

    A patch is the stereographic projection of a triangle from its centre S:
    ``b_ij = (S'A P_i) P_j + (S'A P_j) P_i - (P_i'A P_j) S`` (`quadric_patch`). Corners and centre
    move on fixed lines through one point, the anchor, to where these meet the quadric: so every A
    whose quadric meets the lines gives patches that lie on it exactly.

    Parameters
    ----------
    patches : BezierTriangles or (P, 6, 4) array_like
        Patches on one quadric; none may have a centre on its own edge (the lunes of a
        tetrahedral cover do; `Collineation` moves whole covers).
    anchor : (3,) array_like, optional
        A point off the quadric; by default the pole of the plane at infinity (the centre), or
        where it has none, a point beside the patches.

    Raises
    ------
    NetError, GeometryError
        If the patches are not quadratic, not on one quadric, or the anchor is on it.

    Examples
    --------
    >>> import numpy as np, mitsuba_bezier as mb
    >>> from mitsuba_bezier import fit
    >>> one = mb.sphere(cover="tetrahedral")[:1]
    >>> np.round(fit.Quadric(one).start()["numbers"], 6).tolist()
    [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, -1.0]
    """

    def __init__(self, patches: Any, anchor: Any = None) -> None:
        patches = as_patches(patches)
        if patches.degree != 2:
            raise NetError.expected("patches", "patches of degree 2", f"degree {patches.degree}")
        self.patches = patches
        nets = patches.control_points
        self.matrix, centers = _common_quadric(nets)
        self.anchor = self._anchor(anchor)
        self.points = np.empty((len(nets), 4, 4))  # of each patch: the corners, the centre
        for patch, (net, center) in enumerate(zip(nets, centers)):
            self.points[patch] = _points_of(self.matrix, net, center, patch)
        rebuilt = self.net(self.start())
        off = np.abs(rebuilt.control_points - nets).max() / np.abs(nets).max()
        if off > 1e-6:  # nets may be float32
            raise GeometryError.expected(
                "patches", "patches that their quadric and corners determine", f"off by {off:.1e}"
            )

    def start(self) -> dict[str, np.ndarray]:
        return {"numbers": self.matrix[_UPPER]}

    def scales(self) -> dict[str, float]:
        return {"numbers": float(np.abs(self.matrix).max())}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        import drjit as dr

        numbers, count = unknowns["numbers"], len(self.points)
        a = [[spread(numbers, _position(i, j), count) for j in range(4)] for i in range(4)]
        return assembled(
            self._rows(
                a, [[_floats(x) for x in point.T] for point in self.points.transpose(1, 0, 2)], dr
            ),
            self.patches.control_points.shape,
        )

    def net(self, unknowns: Mapping[str, np.ndarray]) -> BezierTriangles:
        """Return the patches for given numbers, in float64."""
        a = [[unknowns["numbers"][_position(i, j)] for j in range(4)] for i in range(4)]
        points = [list(point.T) for point in self.points.transpose(1, 0, 2)]
        columns = self._rows(a, points, np)
        return BezierTriangles(
            np.stack(columns, axis=-1).reshape(self.patches.control_points.shape)
        )

    def _rows(self, a: Any, points: Any, xp: Any) -> list[Any]:
        """Return the four coordinates of all control points, patch by patch."""
        anchor = [float(x) for x in self.anchor]

        def plane(x: Any) -> list[Any]:
            return [sum(a[i][j] * x[j] for j in range(4)) for i in range(4)]

        def dot(x: Any, y: Any) -> Any:
            return sum(p * q for p, q in zip(x, y))

        of_anchor = plane(anchor)
        c = dot(of_anchor, anchor)
        moved, polars = [], []
        for p in points:
            # on the line of p and the anchor o: (p + s o)'A(p + s o) = 0, the root near zero
            polar = plane(p)
            b, square = dot(of_anchor, p), dot(polar, p)
            root = xp.sqrt(b * b - square * c)
            sign = xp.where(b < 0, -1.0, 1.0) if xp is np else xp.select(b < 0, -1.0, 1.0)
            s = -square / (b + sign * root)
            moved.append([x + s * o for x, o in zip(p, anchor)])
            polars.append([x + s * o for x, o in zip(polar, of_anchor)])
        *corners, center = moved
        gaps = [dot(polars[3], p) for p in corners]
        nets: list[Any] = [None] * 6
        for row, p, gap in zip(_CORNERS, corners, gaps):
            nets[row] = [2 * gap * x for x in p]
        for row, (i, j) in _MIDDLES.items():
            p, q = corners[i], corners[j]
            across = dot(polars[i], q)
            nets[row] = [gaps[i] * y + gaps[j] * x - across * z for x, y, z in zip(p, q, center)]
        return [_interleaved([net[k] for net in nets], len(self.points), xp) for k in range(4)]

    def _anchor(self, given: Any) -> np.ndarray:
        a = self.matrix
        if given is not None:
            o = np.append(finite_array("anchor", given, (3,), GeometryError), 1.0)
        else:
            rows = self.patches.control_points.reshape(-1, 4)
            finite = rows[rows[:, 3] != 0]
            points = finite[:, :3] / finite[:, 3:]
            middle = points.mean(axis=0) if len(points) else np.zeros(3)
            o = np.append(middle, 1.0)
            block = a[:3, :3]
            if abs(np.linalg.det(block)) > 1e-6 * np.abs(block).max() ** 3:
                o = np.append(np.linalg.solve(block, -a[:3, 3]), 1.0)
        if abs(o @ a @ o) <= 1e-9 * np.abs(a).max() * (o @ o):
            raise GeometryError.expected("anchor", "a point off the quadric", o[:3].tolist())
        return o


def _position(i: int, j: int) -> int:
    """Return where the entry (i, j) of a symmetric matrix stands among its ten numbers."""
    i, j = min(i, j), max(i, j)
    return int(np.flatnonzero((_UPPER[0] == i) & (_UPPER[1] == j))[0])


def _common_quadric(nets: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the quadric of all patches, and the centre of each."""
    centers = []
    quadric = None
    for patch, net in enumerate(nets):
        found = characterize(net, tolerance=1e-6)  # nets may be float32
        if found.A is None or found.center is None:
            raise GeometryError.expected(
                "patches", "patches that lie on a quadric", f"patch {patch}, which lies on none"
            )
        a = normalize_quadric(found.A)
        if quadric is None:
            quadric = a
        elif min(np.abs(a - quadric).max(), np.abs(a + quadric).max()) > 1e-5:
            raise GeometryError.expected(
                "patches", "patches on one quadric", f"patch {patch} on another than patch 0"
            )
        centers.append(found.center)
    assert quadric is not None
    return quadric, centers


def _points_of(a: np.ndarray, net: np.ndarray, center: np.ndarray, patch: int) -> np.ndarray:
    """Return corners and centre, scaled such that the formula gives the net itself."""
    corners = net[list(_CORNERS)]
    gaps = corners @ a @ center
    if np.abs(gaps).min() <= 1e-9 * np.abs(gaps).max():
        raise GeometryError.expected(
            "patches", "patches whose centre is on none of their edges", f"patch {patch}"
        )
    # corners l_i c_i with 2 l_i^2 (S'A c_i) = +-1: one sign for all, as the middles decide
    if (gaps < 0).all():
        center, gaps = -center, -gaps
    scale = 1 / np.sqrt(2 * np.abs(gaps))
    best = None
    for signs in ((1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)):
        p = corners * (scale * signs)[:, None]
        error = 0.0
        for row, (i, j) in _MIDDLES.items():
            middle = (
                (center @ a @ p[i]) * p[j] + (center @ a @ p[j]) * p[i] - (p[i] @ a @ p[j]) * center
            )
            error = max(error, float(np.abs(middle - net[row]).max()))
        if best is None or error < best[0]:
            best = (error, p)
    assert best is not None
    return np.vstack([best[1], center])


def _floats(values: np.ndarray) -> Any:
    from .._runtime import import_mitsuba

    return import_mitsuba().Float(values)


def _interleaved(columns: list[Any], count: int, xp: Any) -> Any:
    """Return one array in which the six values of a patch follow each other."""
    if xp is np:
        return np.stack([np.broadcast_to(x, count) for x in columns], axis=-1).ravel()
    from .._runtime import import_mitsuba

    mi = import_mitsuba()
    out = xp.zeros(mi.Float, 6 * count)
    for k, x in enumerate(columns):
        xp.scatter(out, mi.Float(x), 6 * xp.arange(mi.UInt32, count) + k)
    return out
