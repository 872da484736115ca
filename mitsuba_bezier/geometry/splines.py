"""B-spline and NURBS curves: blossoms over knots, knot insertion, to Bézier curves.

What comes after Bézier curves (de Boor, and Gordon and Riesenfeld at General Motors and Utah):
many Bézier segments, joined smoothly by themselves. A control point is a value of the segment's
blossom at ``n`` neighbouring knots, and all algorithms say so: de Boor's evaluates the blossom at
``t, ..., t``, knot insertion (Boehm) at other neighbours, and Bézier points are its values at
repeated knots. Rational ones are B-splines of homogeneous points.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError, NetError
from .curves import BezierCurve
from .projective import affine, count, number, numbers

__all__ = ["BSplineCurve", "basis_functions", "checked_knots", "uniform_knots"]


def checked_knots(
    name: str, knots: Any, degree: int, points: int, gaps: bool = False
) -> np.ndarray:
    """Return a knot vector as float64 array.

    Parameters
    ----------
    name : str
        Its name in messages.
    knots : (points + degree + 1,) array_like
    degree, points : int
    gaps : bool
        Whether the curve may come apart: at inner knots repeated more than `degree` times.

    Raises
    ------
    GeometryError
        If there are not ``points + degree + 1`` finite knots that do not fall, the domain has no
        length, or the curve comes apart and may not.
    """
    t = numbers(knots, name)
    if t.shape != (points + degree + 1,):
        raise GeometryError.expected(
            name,
            f"{points + degree + 1} knots for {points} control points of degree {degree}",
            f"shape {t.shape}",
        )
    if (np.diff(t) < 0).any():
        raise GeometryError.expected(name, "finite knots that do not fall", f"{t.tolist()}")
    if not t[degree] < t[points]:
        raise GeometryError.expected(name, "a domain of positive length", f"{t.tolist()}")
    inside = t[(t > t[degree]) & (t < t[points])]
    if not gaps and len(inside) and np.unique(inside, return_counts=True)[1].max() > degree:
        raise GeometryError.expected(
            name, f"inner knots at most {degree} times", "one repeated more often: a gap"
        )
    return t


def uniform_knots(points: int, degree: int) -> np.ndarray:
    """Return clamped uniform knots from 0 to 1: the curve begins and ends in its polygon's ends."""
    spans = points - degree
    return np.concatenate([np.zeros(degree), np.linspace(0, 1, spans + 1), np.ones(degree)])


def _span(knots: np.ndarray, degree: int, t: np.ndarray) -> np.ndarray:
    """Return `k` with ``knots[k] <= t < knots[k+1]``, the last span of the domain at its end."""
    last = np.searchsorted(knots, knots[-degree - 1], side="left") - 1
    return np.clip(np.searchsorted(knots, t, side="right") - 1, degree, last)


def basis_functions(knots: Any, degree: int, t: Any) -> np.ndarray:
    """Return the B-splines ``N_i(t)``, ``(..., points)``, by the recursion of Cox and de Boor.

    They are not negative, sum to 1 in the domain, and are 0 but for ``degree + 1`` of them.

    Raises
    ------
    GeometryError
        If the knots are not usable, or a parameter is outside of the domain.
    """
    degree = count(degree, "degree", 1)
    raw = numbers(knots, "knots")
    points = len(np.atleast_1d(raw)) - degree - 1
    u = checked_knots("knots", raw, degree, max(points, degree + 1))
    t = numbers(t, "t")
    if ((t < u[degree]) | (t > u[points])).any():
        raise GeometryError.expected("t", f"parameters from {u[degree]:g} to {u[points]:g}", t)
    span = _span(u, degree, t)
    out = np.zeros((*t.shape, len(u) - 1))
    np.put_along_axis(out, span[..., None], 1.0, axis=-1)
    for r in range(1, degree + 1):
        width = u[r:-1] - u[: -r - 1], u[r + 1 :] - u[1:-r]
        left, right = (np.where(w > 0, w, 1.0) for w in width)
        a = (t[..., None] - u[: -r - 1]) / left * out[..., :-1]
        b = (u[r + 1 :] - t[..., None]) / right * out[..., 1:]
        out = a + b
    return out


class BSplineCurve:
    """A B-spline curve, rational (NURBS) by homogeneous control points.

    Parameters
    ----------
    control_points : (m, 3 | 4) array_like
        Homogeneous control points in the plane or in space, more than `degree`.
    knots : (m + degree + 1,) array_like, optional
        Clamped and uniform on [0, 1] if not given.
    degree : int
        At least 1.

    Raises
    ------
    NetError, GeometryError
        If points or knots are not of this form.

    Examples
    --------
    >>> curve = BSplineCurve.from_points([[0, 0], [1, 2], [3, 2], [4, 0], [5, 1]], degree=3)
    >>> [piece.degree for piece in curve.to_bezier()]
    [3, 3]
    """

    def __init__(self, control_points: Any, knots: Any = None, degree: int = 3) -> None:
        try:
            net = BezierCurve(control_points).control_points  # the same checks
        except NetError as error:
            raise NetError(str(error)) from None
        n = count(degree, "degree", 1)
        if len(net) <= n:
            raise NetError.expected(
                "control_points", f"more than {n} for degree {n}", f"{len(net)} of them"
            )
        self._net, self._degree = net, n
        given = uniform_knots(len(net), n) if knots is None else knots
        self._knots = checked_knots("knots", given, n, len(net)).copy()
        self._knots.setflags(write=False)

    @classmethod
    def from_points(
        cls, points: Any, weights: Any = 1.0, knots: Any = None, degree: int = 3
    ) -> BSplineCurve:
        """Return the curve with Euclidean control points ``(m, 2 | 3)`` and weights."""
        return cls(BezierCurve.from_points(points, weights).control_points, knots, degree)

    @property
    def control_points(self) -> np.ndarray:
        """The control points ``(m, 3 | 4)``, read-only."""
        return self._net

    @property
    def knots(self) -> np.ndarray:
        """The knots, read-only."""
        return self._knots

    @property
    def degree(self) -> int:
        """The degree n."""
        return self._degree

    @property
    def domain(self) -> tuple[float, float]:
        """First and last parameter of the curve."""
        return float(self._knots[self._degree]), float(self._knots[-self._degree - 1])

    def __repr__(self) -> str:
        return f"BSplineCurve({len(self._net)} points, degree {self._degree})"

    # ------------------------------------------------------------------ evaluation

    def _inside(self, t: np.ndarray) -> np.ndarray:
        start, end = self.domain
        if ((t < start) | (t > end)).any():
            raise GeometryError.expected(
                "t", f"parameters from {start:g} to {end:g}", f"{t.min():g} .. {t.max():g}"
            )
        return t

    def de_boor(self, t: float) -> list[np.ndarray]:
        """Return de Boor's scheme at one parameter: levels of ``n + 1, n, ..., 1`` points."""
        s = float(self._inside(np.asarray(number(t, "t"))))
        k = int(_span(self._knots, self._degree, np.asarray(s)))
        return self._scheme(k, [s] * self._degree)

    def _scheme(self, span: int, arguments: list[float]) -> list[np.ndarray]:
        """Return the scheme of the blossom of one span: level r interpolates at argument r."""
        n, u = self._degree, self._knots
        level = self._net[span - n : span + 1]
        scheme = [level]
        for r, s in enumerate(arguments, 1):
            left, right = u[span - n + r : span + 1], u[span + 1 : span + n - r + 2]
            a = ((s - left) / (right - left))[:, None]
            level = (1 - a) * level[:-1] + a * level[1:]
            scheme.append(level)
        return scheme

    def blossom(self, arguments: Any, at: float) -> np.ndarray:
        """Return the value of the blossom of the segment that holds `at`, ``(3 | 4,)``.

        Raises
        ------
        GeometryError
            If there are not n arguments, or `at` is outside of the domain.
        """
        x = numbers(arguments, "arguments")
        if x.shape != (self._degree,):
            raise GeometryError.expected("arguments", f"{self._degree} of them", f"{x.shape}")
        s = self._inside(np.asarray(number(at, "at")))
        k = int(_span(self._knots, self._degree, s))
        return self._scheme(k, x.tolist())[-1][0]

    def evaluate(self, t: Any) -> np.ndarray:
        """Return homogeneous points ``(..., 3 | 4)``."""
        t = self._inside(numbers(t, "t"))
        return basis_functions(self._knots, self._degree, t) @ self._net

    def points(self, t: Any) -> np.ndarray:
        """Return Euclidean points ``(..., 2 | 3)``; errors as for `BezierCurve.points`."""
        return affine(self.evaluate(t))

    # ------------------------------------------------------------------ new curves

    def insert_knot(self, t: float, times: int = 1) -> BSplineCurve:
        """Return the same curve with a knot more (Boehm, 1980): a new control point in place.

        Raises
        ------
        GeometryError
            If the knot is outside of the domain, or there would be more than n of it.
        """
        s = float(self._inside(np.asarray(number(t, "t"))))
        curve = self
        for _ in range(count(times, "times", 1)):
            n, u, b = curve._degree, curve._knots, curve._net
            if (u == s).sum() >= n + (s in (u[n], u[-n - 1])):
                raise GeometryError.expected("t", f"a knot of multiplicity below {n}", f"{s:g}")
            k = int(_span(u, n, np.asarray(s)))
            i = np.arange(k - n + 1, k + 1)
            a = ((s - u[i]) / (u[i + n] - u[i]))[:, None]
            new = (1 - a) * b[i - 1] + a * b[i]
            net = np.concatenate([b[: k - n + 1], new, b[k:]])
            curve = BSplineCurve(net, np.insert(u, k + 1, s), n)
        return curve

    def to_bezier(self) -> list[BezierCurve]:
        """Return the Bézier curves of the segments, exactly: the same points for each span.

        Segment `k` runs over the k-th span of the domain that has a length.
        """
        n, u = self._degree, self._knots
        out = []
        for k in range(n, len(self._net)):
            a, b = float(u[k]), float(u[k + 1])
            if a < b:
                points = [self._scheme(k, [a] * (n - j) + [b] * j)[-1][0] for j in range(n + 1)]
                out.append(BezierCurve(points))
        return out

    def transform(self, m: Any) -> BSplineCurve:
        """Return the image under the collineation `m`, a regular (3, 3) or (4, 4) matrix."""
        image = BezierCurve(self._net).transform(m).control_points
        return BSplineCurve(image, self._knots, self._degree)

    def project(self, m: Any) -> BSplineCurve:
        """Return the central projection: the curve of the projected control points."""
        image = BezierCurve(self._net).project(m).control_points
        return BSplineCurve(image, self._knots, self._degree)
