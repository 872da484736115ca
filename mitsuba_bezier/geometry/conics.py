"""Conics: exact arcs as rational quadratics, matrices, five points, classification.

A conic of the plane is a symmetric 3x3 matrix `A`, ``x' A x = 0``; the tangent at its point
`x` is ``A x``. Arcs are `BezierCurve`s of degree 2. Arcs of circles, ellipses, parabolas and
hyperbolas are given by vectors, so the same functions work in the plane and in space.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import GeometryError
from .curves import BezierCurve
from .projective import TOLERANCE, count, elements, meet, norm, number, numbers

__all__ = [
    "circle",
    "classify_conic",
    "conic_arc",
    "conic_arcs",
    "conic_matrix",
    "conic_through_points",
    "ellipse",
    "ellipse_arc",
    "hyperbola_arc",
    "hyperbola_branch",
    "parabola_arc",
    "unit_circle_to_conic",
]

#: Eigenvalues and entries below this fraction of the largest count as zero.
ZERO = 1e-10


# ---------------------------------------------------------------- arcs


def _vectors(**items: Any) -> list[np.ndarray]:
    """Return the named Euclidean vectors, all of length 2 or all of length 3."""
    out = {k: numbers(v, k) for k, v in items.items()}
    shapes = {v.shape for v in out.values()}
    if shapes not in ({(2,)}, {(3,)}):
        raise GeometryError.expected(
            ", ".join(out),
            "vectors of 2 or of 3 numbers",
            f"shapes {[v.shape for v in out.values()]}",
        )
    return list(out.values())


def _independent(u: np.ndarray, v: np.ndarray) -> None:
    across = v - (u @ v) / max(u @ u, 1e-300) * u
    if not (norm(u) > 0 and norm(across) > TOLERANCE * norm(v)):
        raise GeometryError.expected("u, v", "independent vectors", f"{u.tolist()}, {v.tolist()}")


def ellipse_arc(center: Any, u: Any, v: Any, start: float, end: float) -> BezierCurve:
    """Return the exact arc ``center + u cos(a) + v sin(a)`` for ``start <= a <= end``.

    Parameters
    ----------
    center, u, v : (2 | 3,) array_like
        Centre and two conjugate half-diameters; orthogonal of one length for a circle.
    start, end : float
        Angles in radians, ``0 < |end - start| < 2 pi``. The middle weight is
        ``cos((end - start)/2)``: a control vector for a half turn, negative beyond.

    Raises
    ------
    GeometryError
        If `u`, `v` are dependent or the angles are not of this kind.
    """
    c, a, b = _vectors(center=center, u=u, v=v)
    _independent(a, b)
    angles = numbers([start, end], "start, end")
    half = float(angles[1] - angles[0]) / 2
    if not 0 < abs(half) < np.pi:
        raise GeometryError.expected(
            "start, end", "angles less than a full turn apart", f"{start}, {end}"
        )
    middle = angles.mean()

    def at(angle: float, weight: float, radius: float) -> np.ndarray:
        offset = radius * (np.cos(angle) * a + np.sin(angle) * b)
        return np.append(weight * c + offset, weight)

    return BezierCurve([at(angles[0], 1, 1), at(middle, np.cos(half), 1), at(angles[1], 1, 1)])


def ellipse(center: Any, u: Any, v: Any, arcs: int = 3) -> list[BezierCurve]:
    """Return the whole ellipse as `arcs` >= 2 arcs, each ending where the next begins.

    With two arcs the middle points are control vectors; from three on all weights are
    positive. Parameters as for `ellipse_arc`.
    """
    c, a, b = _vectors(center=center, u=u, v=v)
    angles = np.linspace(0, 2 * np.pi, count(arcs, "arcs", 2) + 1)
    nets = [ellipse_arc(c, a, b, s, e).control_points for s, e in pairwise(angles)]
    nets[-1] = np.concatenate([nets[-1][:2], nets[0][:1]])  # closed to the last bit
    return [BezierCurve(net) for net in nets]


def circle(center: Any, radius: float, arcs: int = 3) -> list[BezierCurve]:
    """Return the whole circle of the plane as in `ellipse`, counterclockwise from angle 0."""
    if not number(radius, "radius") > 0:
        raise GeometryError.expected("radius", "a number > 0", radius)
    return ellipse(center, (radius, 0), (0, radius), arcs)


def parabola_arc(
    vertex: Any, tangent: Any, axis: Any, start: float, end: float = np.inf
) -> BezierCurve:
    """Return the arc ``vertex + s tangent + s^2 axis`` for `s` from `start` to `end`.

    Parameters
    ----------
    vertex, tangent, axis : (2 | 3,) array_like
        A point of the parabola, its tangent vector there, the direction of the axis.
    start, end : float
        ``start < end``; `end` may be infinite: the arc then ends in the ideal point.

    Raises
    ------
    GeometryError
        If the vectors are dependent or the limits are not of this kind.
    """
    p, u, v = _vectors(vertex=vertex, tangent=tangent, axis=axis)
    _independent(u, v)
    start = number(start, "start")
    end = np.inf if end == np.inf else number(end, "end")
    if not start < end:
        raise GeometryError.expected("start, end", "start < end", f"{start}, {end}")
    # 0 <= s <= infinity has the blossom points below; s = t / (1 - t)
    ray = BezierCurve([np.append(p, 1.0), np.append(u / 2, 0.0), np.append(v, 0.0)])
    return ray.subcurve((1.0, start), (0.0, 1.0) if np.isinf(end) else (1.0, end))


def hyperbola_arc(center: Any, u: Any, v: Any, start: float, end: float) -> BezierCurve:
    """Return the exact arc ``center + u cosh(s) + v sinh(s)`` for `s` from `start` to `end`.

    Parameters
    ----------
    center, u, v : (2 | 3,) array_like
        Centre and conjugate half-diameters; ``u ± v`` are the asymptotes.
    start, end : float
        Two different parameters. The middle weight is ``cosh((end - start)/2) > 1``.
    """
    c, a, b = _vectors(center=center, u=u, v=v)
    _independent(a, b)
    s, e = (float(x) for x in numbers([start, end], "start, end"))
    if s == e:
        raise GeometryError.expected("start, end", "two different parameters", f"{s}, {e}")
    half, middle = (e - s) / 2, (e + s) / 2

    def at(x: float, weight: float) -> np.ndarray:
        return np.append(weight * c + np.cosh(x) * a + np.sinh(x) * b, weight)

    return BezierCurve([at(s, 1), at(middle, np.cosh(half)), at(e, 1)])


def hyperbola_branch(center: Any, u: Any, v: Any) -> BezierCurve:
    """Return the whole branch through ``center + u``, from asymptote to asymptote.

    Both ends are control vectors, the middle control point is the centre.
    """
    c, a, b = _vectors(center=center, u=u, v=v)
    _independent(a, b)
    return BezierCurve(
        [np.append((a - b) / 2, 0.0), np.append(c, 1.0) / 2, np.append((a + b) / 2, 0.0)]
    )


# ---------------------------------------------------------------- matrices


def _symmetric(a: Any) -> np.ndarray:
    m = numbers(a, "A")
    if m.shape != (3, 3) or not m.any():
        raise GeometryError.expected("A", "a symmetric 3x3 matrix, not zero", f"shape {m.shape}")
    m = m / np.abs(m).max()
    if np.abs(m - m.T).max() > TOLERANCE:
        raise GeometryError.expected("A", "a symmetric 3x3 matrix", "one that is not")
    return (m + m.T) / (2 * np.linalg.norm(m))


def conic_through_points(points: Any) -> np.ndarray:
    """Return the matrix ``(3, 3)`` of the conic through five points of the plane.

    Three collinear points give a pair of lines. Read as lines, the same five vectors give
    the conic that touches them, in line coordinates: its matrix is the inverse.

    Parameters
    ----------
    points : (5, 3) array_like
        Homogeneous points.

    Raises
    ------
    GeometryError
        If two points coincide or four are collinear: many conics pass through them.
    """
    p = elements("points", points, (3,))
    if p.shape != (5, 3):
        raise GeometryError.expected("points", "five points, shape (5, 3)", f"shape {p.shape}")
    p = p / norm(p)[:, None]
    # whitening makes the answer independent of where the points lie in the plane
    _u, size, axes = np.linalg.svd(p)
    if not size[2] > TOLERANCE * size[0]:
        raise GeometryError.expected("points", "no four on one line", "five on one line")
    h = axes.T / size
    x, y, z = (p @ h).T
    rows = np.stack([x * x, 2 * x * y, 2 * x * z, y * y, 2 * y * z, z * z], axis=1)
    _u, sigma, vh = np.linalg.svd(rows / norm(rows)[:, None])
    if not sigma[4] > ZERO * sigma[0]:
        raise GeometryError.expected(
            "points", "five different points, no four on one line", "points on many conics"
        )
    q = vh[-1][[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
    a = h @ q @ h.T
    return _symmetric((a + a.T) / 2)


def conic_matrix(arc: BezierCurve) -> np.ndarray:
    """Return the matrix of the conic on which a rational quadratic of the plane lies.

    In barycentric coordinates of the control triangle the curve is ``s1^2 = 4 s0 s2``.

    Raises
    ------
    GeometryError
        If the curve is not quadratic or its control points are collinear.
    """
    if arc.degree != 2 or arc.dimension != 2:
        raise GeometryError.expected("arc", "a curve of degree 2 in the plane", f"{arc!r}")
    net = arc.control_points
    size = np.maximum(norm(net), 1e-300)
    unit = net / size[:, None]
    sigma = np.linalg.svd(unit, compute_uv=False)
    if not sigma[-1] > TOLERANCE * sigma[0]:
        raise GeometryError.expected(
            "arc", "three independent control points", "collinear control points"
        )
    inverse = np.linalg.inv(unit.T) / size[:, None]  # rows: barycentric coordinates
    a = np.outer(inverse[1], inverse[1])
    a -= 2 * (np.outer(inverse[0], inverse[2]) + np.outer(inverse[2], inverse[0]))
    return _symmetric(a)


def conic_arc(A: Any, start: Any, middle: Any, end: Any) -> BezierCurve:
    """Return the arc of a conic from `start` through `middle` (at t = 1/2) to `end`.

    Parameters
    ----------
    A : (3, 3) array_like
        Regular conic.
    start, middle, end : (3,) array_like
        Three different points on it. The middle control point is the pole of the chord.

    Raises
    ------
    GeometryError
        If a point is not on the conic, two coincide, or the conic is degenerate there.
    """
    a = _symmetric(A)
    points = []
    for name, value in (("start", start), ("middle", middle), ("end", end)):
        x = elements(name, value, (3,))
        if x.shape != (3,):
            raise GeometryError.expected(name, "one point, shape (3,)", f"shape {x.shape}")
        x = x / norm(x)
        if abs(x @ a @ x) > 1e-9:  # leaves room for points that were computed to lie on it
            raise GeometryError.expected(name, "a point on the conic", f"{x.tolist()}")
        points.append(x)
    p, r, q = points
    pole = meet(a @ p, a @ q)
    frame = np.stack([p, pole, q], axis=1)
    sigma = np.linalg.svd(frame / norm(frame.T), compute_uv=False)
    if not sigma[-1] > TOLERANCE:
        raise GeometryError.expected("A, start, end", "a regular conic", "a chord on the conic")
    factor = np.linalg.solve(frame, r)
    if min(abs(factor[0]), abs(factor[2])) <= 1e-9:
        raise GeometryError.expected("middle", "a point other than start and end", "one of them")
    net = np.array([factor[0] * p, factor[1] / 2 * pole, factor[2] * q])
    return BezierCurve(-net if net[:, 2].sum() < 0 else net)


def unit_circle_to_conic(A: Any) -> np.ndarray:
    """Return a collineation ``(3, 3)`` that takes the unit circle to the conic.

    It is balanced: for an ellipse it is affine, for a hyperbola it takes ``(1, 0)``, ``(-1, 0)`` to
    the vertices and the line ``x = 0`` to infinity, for a parabola it takes ``(1, 0)`` to the
    vertex, ``(-1, 0)`` to the ideal point, and ``(0, 1)``, ``(0, -1)`` to the ends of the chord
    through the focus.

    Raises
    ------
    GeometryError
        If the conic is degenerate or has no real points.
    """
    a = _symmetric(A)
    value = np.linalg.eigvalsh(a)
    if np.abs(value).min() <= ZERO or (value > 0).all() or (value < 0).all():
        raise GeometryError.expected("A", "a regular conic with real points", classify_conic(a))
    lam, vec = np.linalg.eigh(a[:2, :2])
    kind = classify_conic(a)
    if kind == "hyperbola":
        # the vertices are on the axis whose eigenvalue has not the sign of det(2x2) / det a
        k = int(np.argmax(lam * np.sign(np.linalg.det(a))))
    else:
        k = int(np.argmin(np.abs(lam)))
    along, across = np.append(vec[:, k], 0.0), np.append(vec[:, 1 - k], 0.0)
    ratio = 0.0 if kind == "parabola" else lam[k] / lam[1 - k]
    vertex = _vertex(a, a @ across, along, 0.0 if kind == "parabola" else float(along @ a @ along))
    # y^2 = 2 p x - ratio x^2 with x along the axis from the vertex, y across
    p = -(vertex @ a @ along) / lam[1 - k]
    # the point at the angle f, by c = cos(f/2), s = sin(f/2): x = 2 p (r s)^2, y = 2 p r s c, with
    # the weight c^2 + ratio (r s)^2
    r = 0.5 if kind == "parabola" else 1 / np.sqrt(abs(ratio))
    square = np.sign(ratio) * vertex + 2 * p * r * r * along  # ratio r^2 is 1, 0 or -1
    m = np.stack([(vertex - square) / 2, p * r * across, (vertex + square) / 2], axis=1)
    return m if np.linalg.det(m) > 0 else m * [1.0, -1.0, 1.0]


def _vertex(a: np.ndarray, axis: np.ndarray, along: np.ndarray, far: float) -> np.ndarray:
    """Return the vertex nearer to the origin, weight 1; `far` is ``along' a along``."""
    point = np.append(-axis[2] * axis[:2] / (axis[:2] @ axis[:2]), 1.0)  # the axis' nearest
    b, c = float(point @ a @ along), float(point @ a @ point)
    # far x^2 + 2 b x + c = 0, and the root of smaller size without cancellation
    q = -(b + np.copysign(np.sqrt(max(b * b - far * c, 0.0)), b))
    return point + (c / q) * along if q else point


def conic_arcs(A: Any, arcs: int = 3) -> list[BezierCurve]:
    """Return a whole regular conic as closed set of arcs, images of those of the circle.

    Those of a parabola or hyperbola run through infinity. The arcs are balanced, whatever the
    conic's proportions and place: the finite control points of three arcs are no further from its
    middle than three times its longer half axis (ellipse, hyperbola), or from the vertex than five
    times its focal length (parabola). With more arcs points of the conic itself may lie far out.
    Errors as for `unit_circle_to_conic`.
    """
    m = unit_circle_to_conic(A)
    nets = [arc.control_points @ m.T for arc in circle((0, 0), 1, arcs)]
    # what rounding leaves of a weight where the conic itself goes to infinity
    for net in nets:
        tiny = np.abs(net[:, 2]) <= 1e-15 * np.abs(m[2]).max()
        net[tiny, 2] = 0.0
    return [BezierCurve(net) for net in nets]


def classify_conic(A: Any) -> str:
    """Return the affine type of the conic with the symmetric 3x3 matrix `A`.

    Returns
    -------
    str
        ``"ellipse"``, ``"parabola"``, ``"hyperbola"``, ``"empty"``; degenerate:
        ``"two lines"``, ``"two parallel lines"``, ``"a line and the line at infinity"``,
        ``"point"``, ``"point at infinity"``, ``"double line"``, ``"double line at infinity"``.
    """
    a = _symmetric(A)
    value = np.linalg.eigvalsh(a)
    zero = ZERO * np.abs(value).max()
    plus, minus = int((value > zero).sum()), int((value < -zero).sum())
    part = a[:2, :2]
    inner = np.linalg.eigvalsh(part)
    p2, m2 = int((inner > zero).sum()), int((inner < -zero).sum())
    if plus + minus == 3:
        if 3 in (plus, minus):
            return "empty"
        return {(1, 1): "hyperbola", (2, 0): "ellipse", (0, 2): "ellipse"}.get((p2, m2), "parabola")
    if plus + minus == 2:
        if plus == 1:
            if p2 + m2 == 0:
                return "a line and the line at infinity"
            return "two lines" if (p2, m2) == (1, 1) else "two parallel lines"
        return "point" if p2 + m2 == 2 else "point at infinity"
    return "double line" if p2 + m2 else "double line at infinity"
