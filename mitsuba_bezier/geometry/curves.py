"""`BezierCurve`: rational Bézier curves of any degree in the projective plane and space.

A control point is homogeneous and weighted, ``(w x, w y, w)`` or ``(w x, w y, w z, w)``;
weights may be negative. ``(x, y, 0)`` and ``(x, y, z, 0)`` are control vectors, points at
infinity; a row of zeros takes no part. The curve is ``b(t) = sum B_i(t) b_i`` with
``B_i = C(n, i) (1-t)^(n-i) t^i``.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Any

import numpy as np

from ..errors import GeometryError, NetError
from .collineations import matrix
from .projective import affine, count, join, number, numbers

__all__ = ["BezierCurve", "bernstein_product"]


def bernstein_product(
    a: np.ndarray, b: np.ndarray, product: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return the Bernstein coefficients of ``product(a(t), b(t))`` for a bilinear `product`.

    Parameters
    ----------
    a, b : (p+1, ...), (q+1, ...) array
        Bernstein coefficients of degrees `p` and `q`, vectors along the last axis.
    product : callable
        Bilinear, broadcasting over leading axes, such as `numpy.cross`.

    Returns
    -------
    (p+q+1, ...) array
        ``c_k = sum C(p,i) C(q,j) / C(p+q,k) product(a_i, b_j)`` over ``i + j = k``.
    """
    p, q = len(a) - 1, len(b) - 1
    pairs = product(a[:, None], b[None, :])
    out = np.zeros((p + q + 1, *pairs.shape[2:]))
    for i in range(p + 1):
        for j in range(q + 1):
            out[i + j] += comb(p, i) * comb(q, j) / comb(p + q, i + j) * pairs[i, j]
    return out


def _pair(t: Any, name: str) -> np.ndarray:
    """Return the barycentric pair of a parameter: ``(1 - t, t)``, or the pair itself."""
    value = numbers(t, name)
    if value.shape == ():
        return np.array([1 - value, value])
    if value.shape != (2,) or not value.any():
        raise GeometryError.expected(name, "a parameter or a pair (1-t, t), not (0, 0)", t)
    return value


class BezierCurve:
    """A rational Bézier curve.

    Parameters
    ----------
    control_points : (n+1, 3) or (n+1, 4) array_like
        Homogeneous control points in the plane or in space, degree ``n >= 1``.

    Raises
    ------
    NetError
        If the shape is not of this form, a number is NaN or infinite, or all control points
        are the zero vector.

    Examples
    --------
    >>> arc = mb.BezierCurve([[1, 0, 1], [1, 1, 1], [0, 2, 2]])  # a quarter of a circle
    >>> arc.degree, arc.weights.tolist()
    (2, [1.0, 1.0, 2.0])
    >>> np.hypot(*arc.points(0.3)).round(12).item()
    1.0
    """

    def __init__(self, control_points: Any) -> None:
        try:
            net = np.array(control_points, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise NetError.expected(
                "control_points", "an array of numbers of shape (n+1, 3) or (n+1, 4)", error
            ) from None
        if net.ndim != 2 or net.shape[0] < 2 or net.shape[1] not in (3, 4):
            raise NetError.expected(
                "control_points",
                "shape (n+1, 3) or (n+1, 4) with n >= 1: homogeneous points (w x, w y, [w z,] w)",
                f"shape {net.shape}",
            )
        if not np.isfinite(net).all():
            k, c = np.argwhere(~np.isfinite(net))[0]
            raise NetError.expected("control_points", "finite numbers", f"{net[k, c]} at row {k}")
        if not net.any():
            raise NetError.expected(
                "control_points", "a point that is not the zero vector", "only zero vectors"
            )
        net.setflags(write=False)
        self._net = net

    @classmethod
    def from_points(cls, points: Any, weights: Any = 1.0) -> BezierCurve:
        """Return the curve with Euclidean control points ``(n+1, 2 | 3)`` and weights.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[1, 0], [1, 1], [0, 1]], [1, 1, 2]).control_points.tolist()
        [[1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 2.0, 2.0]]
        """
        x, w = numbers(points, "points"), numbers(weights, "weights")
        if x.ndim != 2 or x.shape[1] not in (2, 3):
            raise NetError.expected("points", "shape (n+1, 2) or (n+1, 3)", f"shape {x.shape}")
        if w.shape not in ((), (len(x),)):
            raise NetError.expected("weights", f"{len(x)} weights", f"shape {w.shape}")
        w = np.broadcast_to(w, (len(x),))[:, None]
        return cls(np.concatenate([x * w, w], axis=1))

    # ------------------------------------------------------------------ basic facts

    @property
    def control_points(self) -> np.ndarray:
        """The control points, ``(n+1, 3 | 4)`` float64, read-only."""
        return self._net

    @property
    def degree(self) -> int:
        """The degree n."""
        return len(self._net) - 1

    @property
    def dimension(self) -> int:
        """2 for a curve of the plane, 3 for one of space."""
        return self._net.shape[1] - 1

    @property
    def weights(self) -> np.ndarray:
        """The weights, ``(n+1,)``."""
        return self._net[:, -1]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BezierCurve) and np.array_equal(self._net, other._net)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"BezierCurve(degree {self.degree}, dimension {self.dimension})"

    # ------------------------------------------------------------------ evaluation

    def de_casteljau(self, t: Any) -> list[np.ndarray]:
        """Return the scheme: level `r` holds the points ``b_i^r``, shape ``(n+1-r, ..., c)``.

        Parameters
        ----------
        t : (...) array_like
            Parameters, not required to lie in [0, 1].

        Examples
        --------
        >>> curve = mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]])
        >>> [level.tolist() for level in curve.de_casteljau(0.5)][1:]
        [[[0.5, 1.0, 1.0], [1.5, 1.0, 1.0]], [[1.0, 1.0, 1.0]]]
        """
        t = numbers(t, "t")[..., None]
        c = self._net.shape[1]
        level = np.broadcast_to(
            self._net.reshape(len(self._net), *(1,) * (t.ndim - 1), c),
            (len(self._net), *t.shape[:-1], c),
        )
        scheme = [level]
        for _ in range(self.degree):
            level = (1 - t) * level[:-1] + t * level[1:]
            scheme.append(level)
        return scheme

    def evaluate(self, t: Any) -> np.ndarray:
        """Return homogeneous curve points ``(..., 3 | 4)`` by de Casteljau's algorithm.

        Examples
        --------
        >>> mb.BezierCurve([[1, 0, 1], [1, 1, 1], [0, 2, 2]]).evaluate(0.5).tolist()
        [0.75, 1.0, 1.25]
        """
        return self.de_casteljau(t)[-1][0]

    def points(self, t: Any) -> np.ndarray:
        """Return Euclidean curve points ``(..., 2 | 3)``.

        Raises
        ------
        GeometryError
            If one lies at infinity.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).points([0, 0.5]).tolist()
        [[0.0, 0.0], [1.0, 1.0]]
        """
        return affine(self.evaluate(t))

    def derivatives(self, t: Any, order: int = 1) -> np.ndarray:
        """Return homogeneous derivatives ``(order+1, ..., 3 | 4)``, from order 0 up.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).derivatives(0.5).tolist()
        [[1.0, 1.0, 1.0], [2.0, 0.0, 0.0]]
        """
        t = numbers(t, "t")
        order = count(order, "order", 0)
        out = np.zeros((order + 1, *t.shape, self._net.shape[1]))
        net, factor = self._net, 1.0
        for k in range(min(order, self.degree) + 1):
            out[k] = factor * (BezierCurve._value(net, t))
            factor *= self.degree - k
            net = np.diff(net, axis=0)
        return out

    @staticmethod
    def _value(net: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Evaluate a net that may have one point only or vanish."""
        n = len(net) - 1
        s = t[..., None]
        basis = np.concatenate(
            [comb(n, i) * (1 - s) ** (n - i) * s**i for i in range(n + 1)], axis=-1
        )
        return basis @ net

    def affine_derivatives(self, t: Any, order: int = 1) -> np.ndarray:
        """Return the derivatives ``(order+1, ..., 2 | 3)`` of the Euclidean point.

        Leibniz' rule for ``w x = (w x)``:
        ``x^(k) = ((wx)^(k) - sum_{i=1..k} C(k,i) w^(i) x^(k-i)) / w``.

        Raises
        ------
        GeometryError
            If a point lies at infinity.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).affine_derivatives(0.5)[1].tolist()
        [2.0, 0.0]
        """
        d = self.derivatives(t, order)
        out = np.zeros((*d.shape[:-1], d.shape[-1] - 1))
        out[0] = affine(d[0])
        w = d[0][..., -1:]
        for k in range(1, order + 1):
            rest = d[k][..., :-1].copy()
            for i in range(1, k + 1):
                rest -= comb(k, i) * d[i][..., -1:] * out[k - i]
            out[k] = rest / w
        return out

    def tangent(self, t: Any) -> np.ndarray:
        """Return tangent lines, ``(..., 3)`` in the plane or Plücker ``(..., 6)`` in space.

        They join the last two points ``b_0^{n-1}``, ``b_1^{n-1}`` of de Casteljau's scheme.

        Raises
        ------
        GeometryError
            Where these coincide (the curve stands still).

        Examples
        --------
        >>> a, b, c = mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).tangent(0.5)
        >>> (a / b).item(), (c / b).item()  # the line y = 1
        (0.0, -1.0)
        """
        last = self.de_casteljau(t)[-2]
        return join(last[0], last[1])

    def osculating_plane(self, t: Any) -> np.ndarray:
        """Return osculating planes ``(..., 4)`` of a space curve of degree 2 or more.

        Raises
        ------
        GeometryError
            If the curve is not of this kind, or where the plane is not determined.

        Examples
        --------
        >>> cubic = mb.BezierCurve.from_points([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]])
        >>> plane = cubic.osculating_plane(0)
        >>> (plane / plane[2]).tolist()  # z = 0
        [0.0, 0.0, 1.0, -0.0]
        """
        if self.dimension != 3 or self.degree < 2:
            raise GeometryError.expected("curve", "a space curve of degree 2 or more", f"{self!r}")
        last = self.de_casteljau(t)[-3]
        return join(last[0], last[1], last[2])

    def blossom(self, *arguments: Any) -> np.ndarray:
        """Return the blossom value ``b[t1, ..., tn]``, ``(3 | 4,)``.

        Parameters
        ----------
        *arguments : float or (2,) array_like
            Exactly n parameters; a pair ``(1-t, t)`` may have any sum, ``(-1, 1)`` is the
            parameter at infinity.

        Examples
        --------
        >>> curve = mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]])
        >>> curve.blossom(0, 1).tolist()  # the control point in the middle
        [1.0, 2.0, 1.0]
        """
        if len(arguments) != self.degree:
            raise GeometryError.expected("arguments", f"{self.degree} of them", len(arguments))
        level = self._net
        for t in arguments:
            pair = _pair(t, "arguments")
            level = pair[0] * level[:-1] + pair[1] * level[1:]
        return level[0]

    # ------------------------------------------------------------------ new curves

    def subcurve(self, start: Any, end: Any) -> BezierCurve:
        """Return the piece from `start` to `end` by blossoming, ``c_k = b[start.., end..]``.

        Parameters
        ----------
        start, end : float or (2,) array_like
            Different parameters; pairs as in `blossom`.

        Examples
        --------
        >>> curve = mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]])
        >>> curve.subcurve(0, 0.5).control_points[:, :2].tolist()
        [[0.0, 0.0], [0.5, 1.0], [1.0, 1.0]]
        """
        a, b = _pair(start, "start"), _pair(end, "end")
        if a[0] * b[1] == a[1] * b[0]:
            raise GeometryError.expected("start, end", "two different parameters", (start, end))
        n = self.degree
        return BezierCurve([self.blossom(*[a] * (n - k), *[b] * k) for k in range(n + 1)])

    def split(self, t: float = 0.5) -> tuple[BezierCurve, BezierCurve]:
        """Return the pieces before and after `t`, read off de Casteljau's scheme.

        Examples
        --------
        >>> first, second = mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).split()
        >>> second.points(0).tolist()
        [1.0, 1.0]
        """
        scheme = self.de_casteljau(number(t, "t"))
        left = np.stack([level[0] for level in scheme])
        right = np.stack([level[-1] for level in scheme[::-1]])
        return BezierCurve(left), BezierCurve(right)

    def elevate(self, times: int = 1) -> BezierCurve:
        """Return the same curve as one of degree ``n + times``.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [2, 2]]).elevate().control_points[:, :2].tolist()
        [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]
        """
        net = self._net
        for _ in range(count(times, "times", 0)):
            m = len(net)
            k = np.arange(1, m)[:, None] / m
            net = np.concatenate([net[:1], k * net[:-1] + (1 - k) * net[1:], net[-1:]])
        return BezierCurve(net)

    def reverse(self) -> BezierCurve:
        """Return the curve run through backwards.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).reverse().points(0).tolist()
        [2.0, 0.0]
        """
        return BezierCurve(self._net[::-1])

    def reparametrize(self, factor: float) -> BezierCurve:
        """Return the same curve with ``b_i`` multiplied by ``factor^i``.

        The point at `t` moves to `s` with ``s / (1-s) = t / (1-t) / factor``; a negative factor
        gives the complementary segment.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]]).reparametrize(2).weights.tolist()
        [1.0, 2.0, 4.0]
        """
        if number(factor, "factor") == 0:
            raise GeometryError.expected("factor", "a number other than 0", factor)
        return BezierCurve(self._net * float(factor) ** np.arange(len(self._net))[:, None])

    def transform(self, m: Any) -> BezierCurve:
        """Return the image under the collineation `m`, a regular (3, 3) or (4, 4) matrix.

        Examples
        --------
        >>> curve = mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]])
        >>> curve.transform(np.diag([1.0, 3, 1])).points(0.5).tolist()
        [1.0, 3.0]
        """
        c = self._net.shape[1]
        return BezierCurve(self._net @ matrix("m", m, ((c, c),)).T)

    def project(self, m: Any) -> BezierCurve:
        """Return the central projection: the curve of the projected control points.

        Parameters
        ----------
        m : (3 | 4, c) array_like
            A camera's 3x4 image matrix, a singular 4x4 (3x3) matrix of
            `central_projection`, or any other matrix; points are columns.

        Raises
        ------
        GeometryError
            If the matrix is not of this form, or the curve collapses to the centre.

        Examples
        --------
        >>> from mitsuba_bezier.geometry.collineations import central_projection
        >>> curve = mb.BezierCurve.from_points([[0, 0, 1], [1, 2, 1], [2, 0, 1]])
        >>> shadow = curve.project(central_projection([0, 0, 2, 1], [0, 0, 1, 0]))
        >>> shadow.points(0.5).tolist()  # from the point (0, 0, 2) to the plane z = 0
        [2.0, 2.0, 0.0]
        """
        a = numbers(m, "m")
        c = self._net.shape[1]
        if a.ndim != 2 or a.shape[0] not in (3, 4) or a.shape[1] != c:
            raise GeometryError.expected(
                "m", f"a matrix of shape (3 or 4, {c})", f"shape {a.shape}"
            )
        net = self._net @ a.T
        # 1e-14: rounding of a point that the matrix sends to zero
        if np.abs(net).max() <= 1e-14 * np.abs(a).max() * np.abs(self._net).max():
            raise GeometryError.expected(
                "m", "a projection whose centre is not the whole curve", "zero image points"
            )
        return BezierCurve(net)

    def farin_points(self) -> np.ndarray:
        """Return the Farin points (weight points) ``b_i + b_{i+1}``, ``(n, 3 | 4)``.

        Examples
        --------
        >>> mb.BezierCurve.from_points([[0, 0], [1, 2], [2, 0]], [1, 3, 1]).farin_points().tolist()
        [[3.0, 6.0, 4.0], [5.0, 6.0, 4.0]]
        """
        return self._net[:-1] + self._net[1:]
