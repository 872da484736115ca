"""Surfaces that move as a whole: `Pose`, `Collineation`, `Sphere`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError, GeometryError
from ..geometry.checks import finite_array, length, vector
from ..geometry.collineations import matrix
from ..geometry.covers import sphere
from ..geometry.triangles import BezierTriangles
from .parametrization import Parametrization, as_patches, assembled, spread

__all__ = ["Collineation", "Pose", "Sphere"]


class Collineation(Parametrization):
    """Images of given patches under a collineation, by the numbers of its matrix.

    Every ellipsoid is the affine image of a sphere, every oval quadric a projective one: the cover
    of a sphere gives all of them.

    Parameters
    ----------
    patches : BezierTriangles or (P, K, 4) array_like
        What is mapped.
    start : (4, 4) array_like
        The matrix at which the search begins; the identity by default.
    affine : bool
        Keep the last row ``(0, 0, 0, 1)``.

    Raises
    ------
    GeometryError
        If the matrix is singular, or not affine where it shall be.

    Examples
    --------
    >>> import mitsuba_bezier as mb
    >>> from mitsuba_bezier import fit
    >>> fit.Collineation(mb.sphere()).start()["matrix"].shape
    (3, 4)
    """

    def __init__(self, patches: Any, start: Any = None, affine: bool = True) -> None:
        self.patches = as_patches(patches)
        self.matrix = np.eye(4) if start is None else matrix("start", start, ((4, 4),))
        self.affine = affine
        if affine and not np.array_equal(self.matrix[3], [0, 0, 0, 1]):
            raise GeometryError.expected(
                "start", "a last row (0, 0, 0, 1), or affine=False", self.matrix[3].tolist()
            )

    def start(self) -> dict[str, np.ndarray]:
        return {"matrix": self.matrix[:3].copy() if self.affine else self.matrix.copy()}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        import drjit as dr

        columns = _columns(self.patches)
        count = dr.width(columns[0])
        out = []
        for r in range(4):
            if r == 3 and self.affine:
                out.append(columns[3])
                continue
            numbers = [spread(unknowns["matrix"], 4 * r + c, count) for c in range(4)]
            out.append(sum(a * x for a, x in zip(numbers, columns)))
        return assembled(out, self.patches.control_points.shape)


class Sphere(Parametrization):
    """A sphere, by its centre and the logarithm of its radius.

    Parameters
    ----------
    center : (3,) array_like
        Where the search begins.
    radius : float
        As well, positive.
    cover : {"octants", "tetrahedral", "lunes"}
        The patches, as in `mitsuba_bezier.sphere`.

    Examples
    --------
    >>> from mitsuba_bezier import fit
    >>> fit.Sphere(center=(0, 0, 1), radius=2).start()["logarithm"].round(3).tolist()
    [0.693]
    """

    def __init__(self, center: Any = (0, 0, 0), radius: float = 1, cover: str = "octants") -> None:
        self.center = vector("center", center)
        self.radius = length("radius", radius)
        self.patches = sphere(cover=cover)

    def start(self) -> dict[str, np.ndarray]:
        return {"center": self.center.copy(), "logarithm": np.log([self.radius])}

    def scales(self) -> dict[str, float]:
        return {"center": self.radius, "logarithm": 1.0}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        import drjit as dr

        *xyz, w = _columns(self.patches)
        count = dr.width(w)
        radius = dr.exp(spread(unknowns["logarithm"], 0, count))
        moved = [radius * x + spread(unknowns["center"], c, count) * w for c, x in enumerate(xyz)]
        return assembled([*moved, w], self.patches.control_points.shape)


class Pose(Parametrization):
    """A rigid motion, of patches or as a `to_world`, by a rotation vector and a translation.

    The rotation is by the vector's length around it (Rodrigues' formula), and is about the middle
    of the patches' control points.

    Parameters
    ----------
    patches : BezierTriangles or (P, K, 4) array_like, optional
        What moves. Without it the value is the transform itself, for a parameter `to_world`.
    start : (4, 4) array_like
        Without patches: the transform at which the search begins, which the motion follows.
    scale : bool
        A change of size, by its logarithm, as well.

    Examples
    --------
    >>> import mitsuba_bezier as mb
    >>> from mitsuba_bezier import fit
    >>> sorted(fit.Pose(mb.torus()).start())
    ['rotation', 'translation']
    """

    def __init__(self, patches: Any = None, start: Any = None, scale: bool = False) -> None:
        if patches is not None and start is not None:
            raise BezierError.expected("start", "none where patches are given", "both")
        self.patches = None if patches is None else as_patches(patches)
        self.matrix = (
            np.eye(4) if start is None else finite_array("start", start, (4, 4), GeometryError)
        )
        self.with_scale = scale
        self.size = 1.0
        self.middle = self.matrix[:3, 3].copy()
        if self.patches is not None:
            rows = self.patches.control_points.reshape(-1, 4)
            finite = rows[rows[:, 3] != 0]
            if len(finite):
                points = finite[:, :3] / finite[:, 3:]
                self.middle = (points.min(axis=0) + points.max(axis=0)) / 2
                self.size = float(np.ptp(points, axis=0).max()) or 1.0

    def start(self) -> dict[str, np.ndarray]:
        out = {"rotation": np.zeros(3), "translation": np.zeros(3)}
        if self.with_scale:
            out["logarithm"] = np.zeros(1)
        return out

    def scales(self) -> dict[str, float]:
        return {"translation": self.size}

    def value(self, unknowns: Mapping[str, Any]) -> Any:
        import drjit as dr

        mi = import_mitsuba()

        columns = [] if self.patches is None else _columns(self.patches)
        width = dr.width(columns[0]) if columns else 1

        def entries(name: str, count: int) -> list[Any]:
            return [spread(unknowns[name], c, width) for c in range(count)]

        r, shift = entries("rotation", 3), entries("translation", 3)
        factor = dr.exp(entries("logarithm", 1)[0]) if self.with_scale else mi.Float(1)
        # sin(a) / a and (1 - cos(a)) / a^2 by series near zero, where their quotients have none
        square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        small = square < 1e-4
        angle = dr.sqrt(dr.select(small, 1, square))
        s = dr.select(small, 1 - square / 6 + square * square / 120, dr.sin(angle) / angle)
        c = dr.select(
            small, 0.5 - square / 24 + square * square / 720, (1 - dr.cos(angle)) / (angle * angle)
        )
        x, y, z = r
        turn = [
            [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)],
        ]
        rows = []
        for i in range(3):
            row = [factor * t for t in turn[i]]
            turned = sum(a * float(m) for a, m in zip(row, self.middle))
            rows.append([*row, float(self.middle[i]) + shift[i] - turned])
        if self.patches is not None:
            moved = [sum(a * v for a, v in zip(row, columns)) for row in rows]
            return assembled([*moved, columns[3]], self.patches.control_points.shape)
        out = [
            [sum(row[k] * float(self.matrix[k, j]) for k in range(4)) for j in range(4)]
            for row in [*rows, [mi.Float(0), mi.Float(0), mi.Float(0), mi.Float(1)]]
        ]
        return mi.Transform4f(mi.Matrix4f(*(x for row in out for x in row)))


def _columns(patches: BezierTriangles) -> list[Any]:
    """Return the coordinates of all control points as arrays of Dr.Jit."""
    mi = import_mitsuba()
    rows = patches.control_points.reshape(-1, 4)
    return [mi.Float(rows[:, c]) for c in range(4)]
