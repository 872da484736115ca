"""B-spline and NURBS surfaces: tensor products of `splines`, and their Bézier triangles."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError, NetError
from .checks import finite_array
from .projective import affine, count, numbers
from .splines import BSplineCurve, basis_functions, checked_knots, uniform_knots
from .tensor import tensor_to_triangles
from .triangles import BezierTriangles

__all__ = ["BSplineSurface"]


class BSplineSurface:
    """A tensor-product B-spline surface, rational (NURBS) by homogeneous control points.

    Parameters
    ----------
    control_points : (m, k, 4) array_like
        Homogeneous control points ``(w x, w y, w z, w)``, rows along the first parameter.
    knots : pair of array_like, optional
        Knot vectors of both parameters; clamped and uniform on [0, 1] if not given.
    degrees : pair of int
        Both at least 1.

    Raises
    ------
    NetError, GeometryError
        If points or knots are not of this form.

    Examples
    --------
    >>> i, j = np.meshgrid(range(5), range(4), indexing="ij")
    >>> net = np.stack([i, j, i * j / 4, np.ones((5, 4))], axis=-1)
    >>> surface = mb.BSplineSurface(net)
    >>> surface.degrees, len(surface.to_triangles())
    ((3, 3), 4)
    """

    def __init__(self, control_points: Any, knots: Any = None, degrees: Any = (3, 3)) -> None:
        net = finite_array("control_points", control_points, (None, None, 4), NetError)
        if np.shape(degrees) != (2,):
            raise GeometryError.expected("degrees", "a pair of degrees", degrees)
        p, q = (count(d, "degrees", 1) for d in degrees)
        if net.shape[0] <= p or net.shape[1] <= q:
            raise NetError.expected(
                "control_points", f"more than {p} x {q} for these degrees", f"{net.shape[:2]}"
            )
        if knots is None:
            knots = uniform_knots(net.shape[0], p), uniform_knots(net.shape[1], q)
        if len(knots) != 2:
            raise GeometryError.expected("knots", "a pair of knot vectors", f"{len(knots)}")
        self._net, self._degrees = net.copy(), (p, q)
        self._knots = (
            checked_knots("knots[0]", knots[0], p, net.shape[0]).copy(),
            checked_knots("knots[1]", knots[1], q, net.shape[1]).copy(),
        )
        for a in (self._net, *self._knots):
            a.setflags(write=False)

    @classmethod
    def from_points(
        cls, points: Any, weights: Any = 1.0, knots: Any = None, degrees: Any = (3, 3)
    ) -> BSplineSurface:
        """Return the surface with Euclidean control points ``(m, k, 3)`` and weights."""
        x = finite_array("points", points, (None, None, 3), NetError)
        w = np.broadcast_to(numbers(weights, "weights"), x.shape[:2])[..., None]
        return cls(np.concatenate([w * x, w], axis=-1), knots, degrees)

    @property
    def control_points(self) -> np.ndarray:
        """The control points ``(m, k, 4)``, read-only."""
        return self._net

    @property
    def knots(self) -> tuple[np.ndarray, np.ndarray]:
        """Both knot vectors, read-only."""
        return self._knots

    @property
    def degrees(self) -> tuple[int, int]:
        """Both degrees."""
        return self._degrees

    @property
    def domain(self) -> np.ndarray:
        """First and last value of both parameters, ``(2, 2)``."""
        return np.array([[u[d], u[-d - 1]] for u, d in zip(self._knots, self._degrees)])

    def __repr__(self) -> str:
        m, k = self._net.shape[:2]
        return f"BSplineSurface({m} x {k} points, degrees {self._degrees})"

    def evaluate(self, st: Any) -> np.ndarray:
        """Return homogeneous points ``(..., 4)`` at parameters ``(..., 2)``.

        Raises
        ------
        GeometryError
            If a parameter is outside of the domain.
        """
        x = numbers(st, "st")
        if x.ndim == 0 or x.shape[-1] != 2:
            raise GeometryError.expected("st", "pairs of parameters", f"shape {x.shape}")
        a, b = (
            basis_functions(u, d, x[..., k])
            for k, (u, d) in enumerate(zip(self._knots, self._degrees))
        )
        return np.einsum("...i,...j,ijc->...c", a, b, self._net)

    def points(self, st: Any) -> np.ndarray:
        """Return Euclidean points ``(..., 3)``."""
        return affine(self.evaluate(st))

    def _along(self, axis: int, change: Any) -> tuple[np.ndarray, np.ndarray]:
        """Apply `change` to the curves along one parameter; return new net and knots."""
        if axis not in (0, 1):
            raise GeometryError.expected("axis", "0 or 1", axis)
        rows = np.moveaxis(self._net, axis, 1)
        curves = [change(BSplineCurve(r, self._knots[axis], self._degrees[axis])) for r in rows]
        net = np.stack([c.control_points for c in curves])
        return np.moveaxis(net, 1, axis), curves[0].knots

    def insert_knot(self, t: float, axis: int, times: int = 1) -> BSplineSurface:
        """Return the same surface with a knot more along one parameter; see `BSplineCurve`."""
        net, knots = self._along(axis, lambda curve: curve.insert_knot(t, times))
        pair = (knots, self._knots[1]) if axis == 0 else (self._knots[0], knots)
        return BSplineSurface(net, pair, self._degrees)

    def to_bezier(self) -> np.ndarray:
        """Return the nets of the tensor-product Bézier patches, ``(a, b, p+1, q+1, 4)``.

        Patch ``[i, j]`` lies over the i-th and j-th spans that have a length.
        """
        parts = []
        for d, u, size in zip(self._degrees, self._knots, self._net.shape):
            # the map from control points to Bézier points, from curves of unit coefficients
            unit = np.concatenate([np.eye(size), np.ones((size, 1))], axis=1)
            parts.append(_extraction(unit, u, d))
        return np.einsum("iap,jbq,pqc->ijabc", *parts, self._net)

    def to_triangles(self) -> BezierTriangles:
        """Return the surface as Bézier triangles of degree ``p + q``, two a patch."""
        nets = self.to_bezier()
        return tensor_to_triangles(nets.reshape(-1, *nets.shape[2:]))


def _extraction(unit: np.ndarray, knots: np.ndarray, degree: int) -> np.ndarray:
    """Return the matrices ``(spans, n+1, m)`` from control points to those of the segments."""
    size = len(unit)
    columns = []
    for k in range(size):  # a scalar coefficient beside a weight of 1, which stays 1
        net = np.stack([unit[:, k], np.zeros(size), np.ones(size)], axis=1)
        pieces = BSplineCurve(net, knots, degree).to_bezier()
        columns.append([piece.control_points[:, 0] for piece in pieces])
    return np.moveaxis(np.array(columns), 0, -1)
