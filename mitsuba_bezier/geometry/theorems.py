"""Theorems of projective geometry as statements that can be computed: Desargues to Ceva.

Each returns what both sides of its statement say as numbers, so that one sees them vanish
together: a theorem holds for all input, not only where it is applied.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import GeometryError
from .cross_ratio import pencil_coordinates, point_from_cross_ratio
from .duality import wedge3
from .projective import TOLERANCE, elements, incidence, join, meet, norm

__all__ = [
    "Perspective",
    "SideRatios",
    "ceva",
    "ceva_points",
    "desargues",
    "harmonic_by_quadrangle",
    "harmonic_conjugate",
    "menelaus",
    "menelaus_points",
]

#: Relative distance up to which elements count as incident: input may itself be computed.
NEAR = 1e-9


def _span(items: np.ndarray) -> float:
    """Return the third singular value of three unit vectors: 0 if they are of one pencil."""
    return float(np.linalg.svd(items / norm(items)[:, None], compute_uv=False)[2])


# ---------------------------------------------------------------- Desargues


class Perspective(NamedTuple):
    """What `desargues` finds out about two triangles.

    Attributes
    ----------
    center : array or None
        The point through which the lines of corresponding corners pass, if they do.
    axis : array or None
        The line on which corresponding sides meet, if they do.
    meets : (3, ...) array or None
        Where corresponding sides meet: a with a' opposite to the first corners, and so on.
    from_center, from_axis : float
        How far the three lines are from one point, the three meets from one line, relative to unit
        vectors. Desargues: both are 0 or none is.
    """

    center: np.ndarray | None
    axis: np.ndarray | None
    meets: np.ndarray | None
    from_center: float
    from_axis: float


def desargues(first: Any, second: Any, *, dual: bool = False) -> Perspective:
    """Compare two triangles: in perspective from a point exactly if they are from a line.

    Parameters
    ----------
    first, second : (3, 3) or (3, 4) array_like
        Corners of two triangles in the plane or in space, in corresponding order.
    dual : bool
        Read the vectors as lines of the plane (two three-sides) or planes of space (two
        three-edges), and exchange point and line, point and plane in all that is said: `center`
        is then a line (a plane), and `axis` a point (a line).

    Raises
    ------
    GeometryError
        If a triangle has dependent corners, or two corresponding corners or sides coincide.

    Examples
    --------
    >>> a = np.array([[1.0, 0, 1], [0, 1, 1], [-1, -1, 1]])
    >>> found = desargues(a, a * [2, 3, 1] + [0, 0, 0])  # no common point
    >>> found.center is None, found.axis is None
    (True, True)
    """
    up, down = (meet, join) if dual else (join, meet)
    a, b = elements("first", first, (3, 4)), elements("second", second, (3, 4))
    if a.shape != b.shape or a.ndim != 2 or len(a) != 3:
        raise GeometryError.expected(
            "first, second", "two triangles (3, 3) or (3, 4)", f"shapes {a.shape}, {b.shape}"
        )
    for name, t in (("first", a), ("second", b)):
        if _span(t) <= TOLERANCE:
            raise GeometryError.expected(name, "a triangle", "dependent corners")
    plane = a.shape[1] == 3
    lines = np.stack([up(p, q) for p, q in zip(a, b)])
    sides = [[up(t[(k + 1) % 3], t[(k + 2) % 3]) for k in range(3)] for t in (a, b)]
    for s, t in zip(*sides):
        if min(norm(s / norm(s) - t / norm(t)), norm(s / norm(s) + t / norm(t))) <= TOLERANCE:
            raise GeometryError.expected("first, second", "different sides", "a common side")

    if plane:
        from_center = _span(lines)
        center = down(lines[0], lines[1])
    else:
        apart = [float(incidence(lines[k], lines[k - 1])) for k in range(3)]
        from_center, center = max(apart), None
        if from_center <= NEAR:
            center = down(lines[0], lines[1])
            line = np.roll(lines[2], 3) if dual else lines[2]
            from_center = max(
                from_center, float(norm(wedge3(line, center)) / (norm(line) * norm(center)))
            )
    skew = 0.0 if plane else max(float(incidence(s, t)) for s, t in zip(*sides))
    meets = np.stack([down(s, t) for s, t in zip(*sides)]) if skew <= NEAR else None
    from_axis = skew if meets is None else max(skew, _span(meets))
    axis = None
    if meets is not None and from_axis <= NEAR:
        gap = [norm(meets[k] / norm(meets[k]) - meets[k - 1] / norm(meets[k - 1])) for k in (0, 1)]
        axis = up(meets[-1], meets[0]) if gap[0] >= gap[1] else up(meets[0], meets[1])
    return Perspective(
        center if from_center <= NEAR else None, axis, meets, from_center, float(from_axis)
    )


# ---------------------------------------------------------------- harmonic points


def harmonic_conjugate(a: Any, b: Any, c: Any) -> np.ndarray:
    """Return the fourth harmonic element of `c` in the pencil of `a` and `b`.

    It is `d` with ``cross_ratio(a, c, d, b) == -1``; of the midpoint of a segment, the ideal point
    of its line.

    Raises
    ------
    GeometryError
        If the three are not of one pencil, or two of them coincide.
    """
    return point_from_cross_ratio(a, c, b, -1.0)


def harmonic_by_quadrangle(a: Any, b: Any, c: Any, apex: Any, factor: float = 0.5) -> np.ndarray:
    """Return the fourth harmonic point of `c` by the complete quadrangle: with lines alone.

    Join `a`, `b`, `c` to any point `apex` off the line, take a point of the line to `c`, and meet
    what it joins. The result is the same for every choice.

    Parameters
    ----------
    a, b, c : (3,) array_like
        Three points on a line of the plane.
    apex : (3,) array_like
        A point off it.
    factor : float
        The point ``c + factor * apex``, any but 0.

    Raises
    ------
    GeometryError
        If the points are not of this kind.
    """
    a, b, c, s = (elements(n, x, (3,)) for n, x in zip(("a", "b", "c", "apex"), (a, b, c, apex)))
    line = join(a, b)
    if incidence(c, line) > NEAR:
        raise GeometryError.expected("c", "a point on the line of a and b", "one off it")
    if incidence(s, line) <= TOLERANCE:
        raise GeometryError.expected("apex", "a point off the line", "one on it")
    if not np.isfinite(factor) or factor == 0:
        raise GeometryError.expected("factor", "a number other than 0", factor)
    p = c + factor * s
    on_a, on_b = meet(join(a, p), join(s, b)), meet(join(b, p), join(s, a))
    return meet(join(on_a, on_b), line)


# ---------------------------------------------------------------- Menelaus and Ceva


class SideRatios(NamedTuple):
    """Both sides of the theorems of Menelaus and Ceva.

    Attributes
    ----------
    ratios : (3,) array
        ``|ap| / |pb|``, ``|bq| / |qc|``, ``|cr| / |ra|`` with sign where all points are finite.
    product : float
        Their product, which no collineation changes: -1 (Menelaus) or 1 (Ceva).
    distance : float
        How far the three points are from a line (Menelaus), or the three lines to the opposite
        corners from a point (Ceva), relative to unit vectors.
    """

    ratios: np.ndarray
    product: float
    distance: float


def _side_ratios(triangle: Any, points: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, p = elements("triangle", triangle, (3, 4)), elements("points", points, (3, 4))
    if t.shape != p.shape or t.ndim != 2 or len(t) != 3:
        raise GeometryError.expected(
            "triangle, points",
            "three corners, and a point on each of the sides ab, bc, ca",
            f"shapes {t.shape}, {p.shape}",
        )
    if _span(t) <= TOLERANCE:
        raise GeometryError.expected("triangle", "a triangle", "dependent corners")
    # weights of corners are free: as points with weight 1 where they are finite
    finite = np.abs(t[:, -1]) > TOLERANCE * norm(t)
    t = t / np.where(finite, t[:, -1], 1.0)[:, None]
    alpha, beta = pencil_coordinates(p, t, np.roll(t, -1, axis=0), "triangle, points")
    if (np.minimum(np.abs(alpha), np.abs(beta))[:, 0] <= TOLERANCE * norm(p)).any():
        raise GeometryError.expected("points", "points other than the corners", "a corner")
    return t, p, (beta / alpha)[:, 0]


def menelaus(triangle: Any, points: Any) -> SideRatios:
    """Compare three points on the sides of a triangle: on a line exactly if the product is -1.

    Parameters
    ----------
    triangle : (3, 3 | 4) array_like
        Corners a, b, c; ideal ones are allowed (ratios then depend on their factors).
    points : (3, 3 | 4) array_like
        Points p, q, r on the sides ab, bc, ca, ideal or not.

    Raises
    ------
    GeometryError
        If a point is not on its side, or is a corner.
    """
    _t, p, ratios = _side_ratios(triangle, points)
    return SideRatios(ratios, float(np.prod(ratios)), _span(p))


def ceva(triangle: Any, points: Any) -> SideRatios:
    """Compare three points on the sides of a triangle: their lines to the opposite corners meet in
    one point exactly if the product is 1. Parameters and errors as for `menelaus`.
    """
    t, p, ratios = _side_ratios(triangle, points)
    # in coordinates of the triangle, where lines are vectors of length 3 in space as well
    corners = np.roll(np.eye(3), -2, axis=0)  # c, a, b
    inner = np.linalg.lstsq(t.T, p.T, rcond=None)[0].T
    return SideRatios(ratios, float(np.prod(ratios)), _span(np.cross(corners, inner)))


def menelaus_points(triangle: Any, line: Any) -> np.ndarray:
    """Return where a line (a plane of space) meets the sides ab, bc, ca: ``(3, 3 | 4)``.

    Raises
    ------
    GeometryError
        If it holds a side.
    """
    t = elements("triangle", triangle, (3, 4))
    return np.stack([meet(line, join(t[k], t[(k + 1) % 3])) for k in range(3)])


def ceva_points(triangle: Any, point: Any) -> np.ndarray:
    """Return where the lines from the corners through a point meet the sides ab, bc, ca.

    Raises
    ------
    GeometryError
        If the point is a corner.
    """
    t = elements("triangle", triangle, (3, 4))
    return np.stack(
        [meet(join(t[(k + 2) % 3], point), join(t[k], t[(k + 1) % 3])) for k in range(3)]
    )
