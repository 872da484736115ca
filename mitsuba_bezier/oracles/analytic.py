"""Closed-form intersections of rays with quadrics and the torus: oracles without any net.

Every function takes rays ``x = o + t d`` (`d` of any length but zero) and returns all `t` of
the whole line in rising order. Before the polynomial in `t` is formed the origin is moved
along the ray next to the surface, so that its coefficients do not cancel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import GeometryError
from ..geometry import checks

__all__ = ["AnalyticHits", "cone", "cylinder", "plane", "quadric", "sphere", "torus"]


class AnalyticHits(NamedTuple):
    """Intersections of `N` lines with one surface of degree `m`.

    Attributes
    ----------
    t : (N, m) array
        Rising; the places that are left over hold ``inf``. Where two roots coincide up to
        rounding, both or neither appear.
    normals : (N, m, 3) array
        Unit normals along the gradient; zero where `t` is ``inf`` and at singular points.
    clearance : (N,) array
        Signed distance of the line from tangency, negative where the line goes through. For
        the sphere it is exact, elsewhere it is of first order: the least ``|q| / |grad q|``
        over the local extrema of the implicit function `q` along the line (``inf`` without
        any). For the plane it is ``-|cos|`` between line and normal.
    """

    t: np.ndarray
    normals: np.ndarray
    clearance: np.ndarray

    def first(self, tmin: float = 0.0, tmax: float = np.inf) -> np.ndarray:
        """Return the least `t` in ``[tmin, tmax]`` of each line ``(N,)``, ``inf`` for none."""
        return np.where((self.t >= tmin) & (self.t <= tmax), self.t, np.inf).min(axis=1)


def _rays(origins: Any, directions: Any) -> tuple[np.ndarray, np.ndarray]:
    o = np.atleast_2d(np.asarray(origins, dtype=np.float64))
    d = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    for name, value in (("origins", o), ("directions", d)):
        if value.ndim != 2 or value.shape[1] != 3 or not np.isfinite(value).all():
            raise GeometryError.expected(
                name, "finite numbers of shape (N, 3)", f"shape {value.shape}, or NaN"
            )
    if o.shape != d.shape:
        raise GeometryError.expected("directions", f"the shape {o.shape} of origins", d.shape)
    if not d.any(axis=1).all():
        raise GeometryError.expected("directions", "vectors that are not zero", "a zero vector")
    return o, d


def _direction(parameter: str, value: Any) -> np.ndarray:
    """Return a unit vector."""
    out = checks.vector(parameter, value)
    if not out.any():
        raise GeometryError.expected(parameter, "a vector that is not zero", f"{value}")
    return out / np.linalg.norm(out)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1.0), 0.0)


def _quadratic(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the real roots ``(N, 2)`` of ``a t^2 + 2 b t + c``, rising, padded by ``inf``."""
    disc = b * b - a * c
    real = (disc >= 0) & ((a != 0) | (b != 0))
    # -b - sign(b) sqrt(disc) never cancels; the second root follows from the product c/a
    q = -(b + np.copysign(np.sqrt(np.where(real, disc, 0.0)), b))
    with np.errstate(divide="ignore", invalid="ignore"):
        one = np.where(real & (a != 0), q / a, np.inf)
        other = np.where(real, np.where(q != 0, c / q, one), np.inf)
    one, other = (np.where(np.isfinite(r), r, np.inf) for r in (one, other))
    return np.sort(np.stack([one, other], axis=1), axis=1)


def quadric(A: Any, origins: Any, directions: Any) -> AnalyticHits:
    """Intersect lines with ``x'Ax = 0``, `x` homogeneous.

    Parameters
    ----------
    A : (4, 4) array_like
        Any matrix that is not zero; its symmetric part counts.
    origins, directions : (N, 3) array_like
        Rays.

    Returns
    -------
    AnalyticHits
        ``m = 2``. A line in the surface has no isolated root: both `t` are ``inf``.

    Raises
    ------
    GeometryError
        If a shape is wrong or a number is not finite.
    """
    m = np.asarray(A, dtype=np.float64)
    if m.shape != (4, 4) or not np.isfinite(m).all() or not (m + m.T).any():
        raise GeometryError.expected("A", "a finite symmetric 4x4 matrix, not zero", f"{A}")
    m = (m + m.T) / 2
    o, d = _rays(origins, directions)
    x = np.column_stack([o, np.ones(len(o))])
    d4 = np.column_stack([d, np.zeros(len(d))])

    def form(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.einsum("ni,ij,nj->n", p, m, q)

    a = form(d4, d4)
    # start at the extremum of the form if the roots lie about it, else at that of its linear part
    b, c = form(x, d4), form(x, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(np.abs(a * c) > 0.1 * b * b, -b / a, -c / (2 * b))
    shift = np.where(np.isfinite(shift), shift, 0.0)
    x0 = x + shift[:, None] * d4
    with np.errstate(invalid="ignore"):
        t = _quadratic(a, form(x0, d4), form(x0, x0)) + shift[:, None]

    def gradient(t: np.ndarray) -> np.ndarray:
        at = x[:, None] + np.where(np.isfinite(t), t, 0.0)[..., None] * d4[:, None]
        return 2 * (at @ m)[..., :3]

    finite = np.isfinite(t)
    normals = np.where(finite[..., None], _unit(gradient(t)), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = np.where(a != 0, shift - form(x0, d4) / a, np.inf)
        at = x + np.where(np.isfinite(middle), middle, 0.0)[:, None] * d4
        slope = np.linalg.norm(gradient(middle[:, None])[:, 0], axis=1)
        clearance = np.abs(form(at, at)) / slope
    clearance = np.where(np.isfinite(middle) & (slope > 0), clearance, np.inf)
    return AnalyticHits(t, normals, np.where(finite.any(axis=1), -clearance, clearance))


def sphere(center: Any, radius: float, origins: Any, directions: Any) -> AnalyticHits:
    """Intersect lines with a sphere.

    Parameters
    ----------
    center : (3,) array_like
        Centre.
    radius : float
        Radius, positive.
    origins, directions : (N, 3) array_like
        Rays.

    Returns
    -------
    AnalyticHits
        ``m = 2``; `clearance` is the distance of the line from the centre minus the radius,
        divided by the radius.

    Raises
    ------
    GeometryError
        If a parameter is unusable.
    """
    c, r = checks.vector("center", center), checks.length("radius", radius)
    o, d = _rays(origins, directions)
    length = np.linalg.norm(d, axis=1)
    unit = d / length[:, None]
    p = o - c
    middle = -np.einsum("ni,ni->n", p, unit)
    foot = p + middle[:, None] * unit
    distance = np.linalg.norm(foot, axis=1)
    clearance = (distance - r) / r
    half = np.sqrt(np.maximum((r - distance) * (r + distance), 0.0))[:, None] * [-1.0, 1.0]
    hit = (clearance <= 0)[:, None]
    t = np.where(hit, (middle[:, None] + half) / length[:, None], np.inf)
    normals = (foot[:, None] + half[..., None] * unit[:, None]) / r
    return AnalyticHits(t, np.where(hit[..., None], normals, 0.0), clearance)


def _axial(
    point: np.ndarray, axis: np.ndarray, radial: float, axial: float, constant: float
) -> np.ndarray:
    """Return `A` of ``radial |x_perp|^2 + axial (x.axis)^2 + constant``, `x` from `point`."""
    along = np.outer(axis, axis)
    upper = radial * (np.eye(3) - along) + axial * along
    out = np.zeros((4, 4))
    out[:3, :3] = upper
    out[:3, 3] = out[3, :3] = -upper @ point
    out[3, 3] = point @ upper @ point + constant
    return out


def cylinder(point: Any, axis: Any, radius: float, origins: Any, directions: Any) -> AnalyticHits:
    """Intersect lines with an infinite circular cylinder.

    Parameters
    ----------
    point, axis : (3,) array_like
        A point of the axis and its direction.
    radius : float
        Radius, positive.
    origins, directions : (N, 3) array_like
        Rays.

    Returns
    -------
    AnalyticHits
        ``m = 2``, normals outwards, `clearance` as for `quadric`.

    Raises
    ------
    GeometryError
        If a parameter is unusable.
    """
    p, a, r = (
        checks.vector("point", point),
        _direction("axis", axis),
        checks.length("radius", radius),
    )
    o, d = _rays(origins, directions)
    return quadric(_axial(np.zeros(3), a, 1.0, 0.0, -r * r), o - p, d)


def cone(apex: Any, axis: Any, slope: float, origins: Any, directions: Any) -> AnalyticHits:
    """Intersect lines with an infinite circular double cone.

    Parameters
    ----------
    apex, axis : (3,) array_like
        Apex and direction of the axis.
    slope : float
        Radius at distance 1 from the apex: the tangent of half the opening angle.
    origins, directions : (N, 3) array_like
        Rays.

    Returns
    -------
    AnalyticHits
        ``m = 2``, normals away from the axis (zero at the apex), `clearance` as for `quadric`.

    Raises
    ------
    GeometryError
        If a parameter is unusable.
    """
    p, a, k = checks.vector("apex", apex), _direction("axis", axis), checks.length("slope", slope)
    o, d = _rays(origins, directions)
    return quadric(_axial(np.zeros(3), a, 1.0, -k * k, 0.0), o - p, d)


def plane(point: Any, normal: Any, origins: Any, directions: Any) -> AnalyticHits:
    """Intersect lines with a plane.

    Parameters
    ----------
    point, normal : (3,) array_like
        A point of the plane and a normal of any length.
    origins, directions : (N, 3) array_like
        Rays.

    Returns
    -------
    AnalyticHits
        ``m = 1``, the given normal as unit vector.

    Raises
    ------
    GeometryError
        If a parameter is unusable.
    """
    p, n = checks.vector("point", point), _direction("normal", normal)
    o, d = _rays(origins, directions)
    rate = d @ n
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (-((o - p) @ n) / rate)[:, None]
    t = np.where(np.isfinite(t), t, np.inf)
    normals = np.where(np.isfinite(t)[..., None], n, 0.0)
    return AnalyticHits(t, normals, -np.abs(rate) / np.linalg.norm(d, axis=1))


def _roots_between(coefficients: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find real roots of polynomials in ``[-limit, limit]`` and the extrema in between.

    Between neighbouring roots of its derivative a polynomial is monotone, so bisection
    cannot fail; the derivative's roots are found in the same way.

    Parameters
    ----------
    coefficients : (N, m + 1) array
        Highest power first, not zero.
    limit : (N,) array
        Half the length of the interval.

    Returns
    -------
    roots : (N, m) array
        Rising, padded by ``inf``.
    extrema : (N, m - 1) array
        Rising, padded by `limit`.
    """
    degree = coefficients.shape[1] - 1

    def value(x: np.ndarray) -> np.ndarray:
        out = np.zeros_like(x)
        for c in coefficients.T:
            out = out * x + c[:, None]
        return out

    if degree == 1:
        extrema = np.zeros((len(coefficients), 0))
    else:
        slope = coefficients[:, :-1] * np.arange(degree, 0, -1)
        extrema = np.minimum(_roots_between(slope, limit)[0], limit[:, None])
    ends = np.concatenate([-limit[:, None], extrema, limit[:, None]], axis=1)
    at = value(ends)
    lo, hi = ends[:, :-1].copy(), ends[:, 1:].copy()
    rising = at[:, 1:] > at[:, :-1]
    # half open, so that a root on an extremum is not counted on both sides; a double root that
    # rounding lifts off zero is lost as a pair
    change = (at[:, :-1] < 0) != (at[:, 1:] < 0)
    for _ in range(70):  # the double of the 53 bits covers an interval from 0 to 2**-17
        middle = (lo + hi) / 2
        up = (value(middle) < 0) == rising
        lo, hi = np.where(up, middle, lo), np.where(up, hi, middle)
    return np.sort(np.where(change, (lo + hi) / 2, np.inf), axis=1), extrema


def torus(
    center: Any, axis: Any, major: float, minor: float, origins: Any, directions: Any
) -> AnalyticHits:
    """Intersect lines with a torus.

    ``q = (|x|^2 + R^2 - r^2)^2 - 4 R^2 |x_perp|^2``, a quartic in `t`, is solved between the
    points where the line enters and leaves the ball of radius ``R + r``.

    Parameters
    ----------
    center, axis : (3,) array_like
        Centre and direction of the axis.
    major, minor : float
        `R`, the radius of the core circle, and `r`, that of the tube.
    origins, directions : (N, 3) array_like
        Rays.

    Returns
    -------
    AnalyticHits
        ``m = 4``, normals outwards. For ``r > R`` this is the whole self-intersecting surface.

    Raises
    ------
    GeometryError
        If a parameter is unusable.
    """
    c, a = checks.vector("center", center), _direction("axis", axis)
    big, small = checks.length("major", major), checks.length("minor", minor)
    o, d = _rays(origins, directions)
    length = np.linalg.norm(d, axis=1)
    unit = d / length[:, None]
    p = o - c
    middle = -np.einsum("ni,ni->n", p, unit)
    p = p + middle[:, None] * unit
    p2, px = np.einsum("ni,ni->n", p, p), p @ a
    dx = unit @ a
    # p.d = 0 at the foot point, up to rounding that is kept
    pd = np.einsum("ni,ni->n", p, unit)
    k = p2 + big**2 - small**2
    g = 4 * big**2
    coefficients = np.stack(
        [
            np.ones(len(p)),
            4 * pd,
            4 * pd**2 + 2 * k - g * (1 - dx**2),
            4 * pd * k - 2 * g * (pd - px * dx),
            k**2 - g * (p2 - px**2),
        ],
        axis=1,
    )
    outer = (big + small) ** 2
    # a little beyond the ball, so that touching it is no boundary case
    limit = np.sqrt(np.maximum(outer - p2, 0.0)) * (1 + 1e-6) + 1e-6 * (big + small)
    s, extrema = _roots_between(coefficients, limit)
    finite = np.isfinite(s)

    def function(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = p[:, None] + np.where(np.isfinite(s), s, 0.0)[..., None] * unit[:, None]
        x2 = (x**2).sum(axis=2)
        height = x @ a
        m = x2 + big**2 - small**2
        across = x - height[..., None] * a
        q = m**2 - g * (across**2).sum(axis=2)
        return q, 4 * m[..., None] * x - 2 * g * across

    normals = np.where(finite[..., None], _unit(function(s)[1]), 0.0)
    q, gradient = function(extrema)
    slope = np.linalg.norm(gradient, axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        clearance = np.where(slope > 0, np.abs(q) / slope, np.inf)
    clearance = np.where(np.abs(extrema) < limit[:, None], clearance, np.inf).min(axis=1)
    t = np.where(finite, (s + middle[:, None]) / length[:, None], np.inf)
    return AnalyticHits(t, normals, np.where(finite.any(axis=1), -clearance, clearance))
