"""Dual Bézier curves: envelopes of lines in the plane, of planes in space; point form and back.

A dual curve ``u(t) = sum B_i(t) U_i`` has control *lines* (plane) or control *planes* (space).
De Casteljau's algorithm is the same; meets take the place of joins:

* plane: the point of contact is the meet of the last two lines, ``u ∧ u'``. A curve of n + 1
  control lines has degree ``2n - 2`` as point curve, and n + 1 control points give ``2n - 2``
  as line curve.
* space: the meet of the last two planes is a ruling of the enveloped developable, degree
  ``2n - 2`` in Plücker coordinates; that of the last three a point of its regression curve,
  ``u ∧ u' ∧ u''``, degree ``3n - 6``. The osculating planes of a space curve go the other way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError, NetError
from .collineations import matrix
from .curves import BezierCurve, bernstein_product
from .projective import TOLERANCE, meet, norm

__all__ = ["DualBezierCurve", "dual_form", "wedge2", "wedge3"]


def wedge2(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the join of points (or unswapped meet) without checks: ``a ∧ b``.

    Vectors of length 3 give their cross product, of length 4 the Plücker vector of the join.
    """
    if a.shape[-1] == 3:
        return np.cross(a, b)
    d = a[..., 3:] * b[..., :3] - b[..., 3:] * a[..., :3]
    return np.concatenate([d, np.cross(a[..., :3], b[..., :3])], axis=-1)


def wedge3(line: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the 4D cross product ``a x b x c`` for ``line = wedge2(a, b)``, unchecked."""
    d, m = line[..., :3], line[..., 3:]
    normal = c[..., 3:] * m - np.cross(c[..., :3], d)
    return np.concatenate([normal, -np.sum(c[..., :3] * m, axis=-1, keepdims=True)], axis=-1)


def _contacts(net: np.ndarray, all_in: str) -> np.ndarray:
    """Return the Bernstein coefficients of the dual form, degree 2n-2 or 3n-6.

    With ``a = u_0^{n-1}``, ``b = u_1^{n-1}`` as curves of degree ``n - 1`` in t (the control
    points without the last, without the first), ``u ∧ u' = n a ∧ b``; likewise with the last
    three curves of degree ``n - 2``.
    """
    length = norm(net)
    sigma = np.linalg.svd(net[length > 0] / length[length > 0, None], compute_uv=False)
    c = net.shape[1]
    if len(sigma) < c or not sigma[c - 1] > TOLERANCE * sigma[0]:
        raise GeometryError.expected(
            "curve", f"{c} independent control elements among them", f"all in {all_in}"
        )
    if c == 3:
        return bernstein_product(net[:-1], net[1:], wedge2)
    return bernstein_product(bernstein_product(net[:-2], net[1:-1], wedge2), net[2:], wedge3)


class DualBezierCurve:
    """A Bézier curve of lines of the plane or planes of space.

    Parameters
    ----------
    control_elements : (n+1, 3) or (n+1, 4) array_like
        Control lines ``(a, b, c)`` or control planes ``(a, b, c, e)``; as for points, their
        lengths are weights.

    Raises
    ------
    NetError
        If the shape is not of this form, or the numbers are unusable (as `BezierCurve`).

    Examples
    --------
    >>> dual = mb.DualBezierCurve([[0, 1, 0], [0.5, 0, -0.5], [0, 1, -1]])
    >>> dual.degree, dual.evaluate(0.5).tolist()
    (2, [0.25, 0.5, -0.5])
    """

    def __init__(self, control_elements: Any) -> None:
        try:
            self._form = BezierCurve(control_elements)
        except NetError as error:
            raise NetError(str(error).replace("control_points", "control_elements")) from None

    @property
    def control_elements(self) -> np.ndarray:
        """The control lines or planes, ``(n+1, 3 | 4)``, read-only."""
        return self._form.control_points

    @property
    def degree(self) -> int:
        """The degree n (the class of the envelope)."""
        return self._form.degree

    @property
    def dimension(self) -> int:
        """2 for lines of the plane, 3 for planes of space."""
        return self._form.dimension

    def __repr__(self) -> str:
        return f"DualBezierCurve(degree {self.degree}, dimension {self.dimension})"

    def evaluate(self, t: Any) -> np.ndarray:
        """Return the lines or planes ``(..., 3 | 4)`` at parameters ``(...)``."""
        return self._form.evaluate(t)

    def de_casteljau(self, t: Any) -> list[np.ndarray]:
        """Return the scheme of lines or planes, as `BezierCurve.de_casteljau`."""
        return self._form.de_casteljau(t)

    def contact(self, t: Any) -> np.ndarray:
        """Return points of the enveloped curve: of contact (plane), of regression (space).

        Raises
        ------
        GeometryError
            Where the last two lines (three planes) are dependent, or the degree is too low.
        """
        self._check_degree(self.dimension - 1)
        last = self._form.de_casteljau(t)[-self.dimension]
        return meet(*last)

    def ruling(self, t: Any) -> np.ndarray:
        """Return the lines ``(..., 6)`` of contact of a curve of planes."""
        if self.dimension != 3:
            raise GeometryError.expected("curve", "a curve of planes", f"{self!r}")
        last = self._form.de_casteljau(t)[-2]
        return meet(last[0], last[1])

    def elevate(self, times: int = 1) -> DualBezierCurve:
        """Return the same envelope as curve of degree ``n + times``."""
        return DualBezierCurve(self._form.elevate(times).control_points)

    def split(self, t: float = 0.5) -> tuple[DualBezierCurve, DualBezierCurve]:
        """Return the pieces before and after `t`."""
        left, right = self._form.split(t)
        return DualBezierCurve(left.control_points), DualBezierCurve(right.control_points)

    def transform(self, m: Any) -> DualBezierCurve:
        """Return the image under the collineation `m` of points: elements go by ``M^-T``."""
        c = self.dimension + 1
        m = matrix("m", m, ((c, c),))
        return DualBezierCurve(self.control_elements @ np.linalg.inv(m))

    def point_form(self) -> BezierCurve:
        """Return the enveloped curve: degree ``2n - 2`` (plane), ``3n - 6`` (space, regression).

        Raises
        ------
        GeometryError
            If the degree is too low for a curve (n = 1 in the plane, n <= 2 in space: all
            lines or planes then pass through one point), or all elements pass through one
            point.
        """
        self._check_degree(self.dimension)
        net = _contacts(self.control_elements, "one pencil or bundle (through one point)")
        return BezierCurve(net if self.dimension == 2 else -net)  # the signs of `meet`

    def _check_degree(self, least: int) -> None:
        if self.degree < least:
            raise GeometryError.expected(
                "control_elements",
                f"a degree of at least {least}, {least + 1} lines or planes",
                f"degree {self.degree}: they all pass through one point or line",
            )


def dual_form(curve: BezierCurve) -> DualBezierCurve:
    """Return the tangents of a plane curve, or the osculating planes of a space curve.

    Degree ``2n - 2`` in the plane (n >= 2), ``3n - 6`` in space (n >= 3). The point form of
    the result is the curve itself times a scalar polynomial (1 for conics and for space
    cubics), whose zeros are the inflections and cusps, or points of zero torsion: there the
    tangent or plane stands still.

    Raises
    ------
    GeometryError
        If the degree is too low, or the curve lies on a line (in a plane).
    """
    if curve.degree < curve.dimension:
        raise GeometryError.expected(
            "curve", f"a degree of at least {curve.dimension}", f"{curve!r}"
        )
    space = "a line" if curve.dimension == 2 else "a plane"
    return DualBezierCurve(_contacts(curve.control_points, space))
