"""Projective plane and space: points, lines, planes, ideal elements; join and meet.

Elements are homogeneous float64 vectors, told apart by the length of the last axis:

====  ==============================================================================
 3    point ``(wx, wy, w)`` or line ``(a, b, c)``, ``ax + by + cw = 0``, of the plane
 4    point ``(wx, wy, wz, w)`` or plane ``(a, b, c, e)`` of space
 6    line of space as Plücker vector ``(d, m)``: direction `d`, moment ``m = x × d``
      for every point `x` on it
====  ==============================================================================

`join` reads vectors of length 3 or 4 as points, `meet` reads them as lines of the plane or
planes of space. All functions broadcast over leading axes. An element is ideal (at infinity)
when ``w = 0``, or when it is the line or plane at infinity, or a line in that plane; `is_ideal`
tells, and has to be told which of points and their duals it is asked about.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError

__all__ = [
    "IDEAL_LINE",
    "IDEAL_PLANE",
    "TOLERANCE",
    "affine",
    "ideal",
    "incidence",
    "is_ideal",
    "join",
    "line_points",
    "meet",
    "plucker_matrix",
    "point",
]

#: Elements closer to dependent than this (relative to their lengths) count as dependent: some
#: thousand roundings, so that computed elements which should coincide are recognised.
TOLERANCE = 1e-12

#: The line at infinity of the plane and the plane at infinity of space.
IDEAL_LINE = np.array([0.0, 0.0, 1.0])
IDEAL_PLANE = np.array([0.0, 0.0, 0.0, 1.0])
IDEAL_LINE.setflags(write=False)
IDEAL_PLANE.setflags(write=False)


def numbers(value: Any, name: str) -> np.ndarray:
    """Return `value` as a float64 array of finite numbers.

    Raises
    ------
    GeometryError
        If it is not one.
    """
    try:
        raw = np.asarray(value)
        out = raw.real.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise GeometryError.expected(name, "numbers", error) from None
    if raw.dtype.kind == "c":  # a cast would drop the imaginary part
        raise GeometryError.expected(name, "real numbers", "complex ones")
    if not np.isfinite(out).all():
        raise GeometryError.expected(name, "finite numbers", out[~np.isfinite(out)][0])
    return out


def number(value: Any, name: str) -> float:
    """Return `value` as one finite number; errors as for `numbers`."""
    out = numbers(value, name)
    if out.shape != ():
        raise GeometryError.expected(name, "one number", f"shape {out.shape}")
    return float(out)


def count(value: Any, name: str, least: int) -> int:
    """Return `value` as an integer of at least `least`; errors as for `numbers`."""
    out = number(value, name)
    if out != int(out) or out < least:
        raise GeometryError.expected(name, f"an integer >= {least}", value)
    return int(out)


def elements(name: str, value: Any, sizes: tuple[int, ...]) -> np.ndarray:
    """Return `value` as float64 elements, or say what is wrong with it.

    Elements of extreme size are multiplied by a power of two, so that products neither
    overflow nor vanish.

    Raises
    ------
    GeometryError
        If the last axis has none of the lengths `sizes`, a number is not finite, or an
        element is the zero vector (which is no element of projective space).
    """
    kinds = " or ".join(str(s) for s in sizes)
    out = numbers(value, name)
    if out.ndim == 0 or out.shape[-1] not in sizes:
        raise GeometryError.expected(
            name, f"homogeneous vectors of {kinds} numbers", f"shape {out.shape}"
        )
    if not out.any(axis=-1).all():
        raise GeometryError.expected(name, "no zero vector", "the zero vector")
    exponent = np.frexp(np.abs(out).max(axis=-1, keepdims=True))[1]
    extreme = np.abs(exponent) > 160  # beyond 1e48: sixth powers are out of range
    return np.ldexp(out, np.where(extreme, -exponent, 0)) if extreme.any() else out


def same_shape(name: str, *operands: np.ndarray) -> None:
    """Refuse operands whose leading axes do not broadcast."""
    try:
        np.broadcast_shapes(*(a.shape[:-1] for a in operands))
    except ValueError:
        raise GeometryError.expected(
            name, "leading axes that broadcast", f"shapes {[a.shape for a in operands]}"
        ) from None


def norm(x: np.ndarray) -> np.ndarray:
    """Return the Euclidean length along the last axis."""
    return np.sqrt(np.einsum("...i,...i->...", x, x))


def _regular(result: np.ndarray, scale: np.ndarray, what: str, got: str) -> np.ndarray:
    """Return `result` unless it vanishes compared with `scale`, the size its input allows."""
    if not (norm(result) > TOLERANCE * scale).all():
        raise GeometryError.expected(what, "independent elements", got)
    return result


# ---------------------------------------------------------------- points


def point(coordinates: Any, weight: Any = 1.0) -> np.ndarray:
    """Return homogeneous points ``(w x, w)``.

    Parameters
    ----------
    coordinates : (..., 2 | 3) array_like
        Euclidean coordinates.
    weight : (...) array_like
        Non-zero weights.

    Raises
    ------
    GeometryError
        If a weight is zero (use `ideal`) or a number is not finite.
    """
    x, w = numbers(coordinates, "coordinates"), numbers(weight, "weight")
    if x.ndim == 0 or x.shape[-1] not in (2, 3):
        raise GeometryError.expected("coordinates", "2 or 3 a point", f"shape {x.shape}")
    if not w.all():
        raise GeometryError.expected("weight", "weights other than 0", "0")
    try:
        w = np.broadcast_to(w, x.shape[:-1])[..., None]
    except ValueError:
        raise GeometryError.expected(
            "weight", f"weights of shape {x.shape[:-1]}", f"shape {w.shape}"
        ) from None
    return np.concatenate([x * w, w], axis=-1)


def ideal(direction: Any) -> np.ndarray:
    """Return the ideal points ``(direction, 0)`` of directions ``(..., 2 | 3)``."""
    d = elements("direction", direction, (2, 3))
    return np.concatenate([d, np.zeros((*d.shape[:-1], 1))], axis=-1)


def is_ideal(items: Any, tolerance: float = TOLERANCE, *, dual: bool = False) -> np.ndarray:
    """Return a mask of the elements at infinity.

    Parameters
    ----------
    items : (..., 3 | 4 | 6) array_like
        Points, or lines of space: those in the plane at infinity are ideal.
    tolerance : float
        What a point's weight, or the normal of a line or plane, or the direction of a line of
        space may have, relative to the length of the other numbers.
    dual : bool
        Read vectors of length 3 as lines of the plane and those of length 4 as planes, as `meet`
        does: the line and the plane at infinity are ideal. For points these are the origin.
    """
    x = elements("items", items, (3, 4, 6))
    split = 3 if x.shape[-1] == 6 else x.shape[-1] - 1
    first, last = norm(x[..., :split]), norm(x[..., split:])
    if x.shape[-1] == 6 or dual:
        return first <= tolerance * last
    return last <= tolerance * first


def affine(points: Any) -> np.ndarray:
    """Return Euclidean coordinates ``(..., 2 | 3)`` of homogeneous points.

    Raises
    ------
    GeometryError
        If a point is ideal in the sense of `is_ideal`: further than 1e12 from the origin.
    """
    p = elements("points", points, (3, 4))
    if is_ideal(p).any():
        raise GeometryError.expected("points", "points that are not at infinity", "an ideal point")
    return p[..., :-1] / p[..., -1:]


# ---------------------------------------------------------------- lines of space


def _line(name: str, value: Any) -> np.ndarray:
    line = elements(name, value, (6,))
    d, m = line[..., :3], line[..., 3:]
    # |d.m| <= |line|^2 / 2; 1e-9 leaves room for lines that went through several steps
    if (np.abs(np.einsum("...i,...i->...", d, m)) > 1e-9 * norm(line) ** 2).any():
        raise GeometryError.expected(name, "a Plücker vector with d.m = 0", f"{line.tolist()}")
    return line


def plucker_matrix(line: Any) -> np.ndarray:
    """Return the antisymmetric ``(..., 4, 4)`` matrices ``p q' - q p'`` of lines ``(..., 6)``.

    `p`, `q` are points with ``join(p, q) = line``. The matrix `L` applied to a plane gives
    the meet of line and plane; it becomes ``M L M'`` under the collineation `M`.
    """
    line = _line("line", line)
    d, m = line[..., :3], line[..., 3:]
    out = np.zeros((*line.shape[:-1], 4, 4))
    out[..., :3, 3] = -d
    out[..., 3, :3] = d
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j] = m[..., k]
        out[..., j, i] = -m[..., k]
    return out


def line_points(line: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return two points ``p, q`` of each line ``(..., 6)`` with ``join(p, q)`` parallel to it.

    For a line that is not ideal these are its point nearest to the origin and its ideal
    point. Those of an ideal line are two ideal points in orthogonal directions.
    """
    line = _line("line", line)
    d, m = line[..., :3], line[..., 3:]
    size = norm(line)
    zero = np.zeros((*line.shape[:-1], 1))
    far = (norm(d) <= TOLERANCE * size)[..., None]
    foot = np.concatenate([np.cross(d, m), (norm(d) ** 2)[..., None]], axis=-1)
    direction = np.concatenate([d, zero], axis=-1)
    # an ideal line: directions orthogonal to m; the axis least along m gives the first
    axis = np.eye(3)[np.argmin(np.abs(m), axis=-1)]
    first = np.cross(m, axis)
    a = np.concatenate([first, zero], axis=-1)
    b = np.concatenate([np.cross(m, first), zero], axis=-1)
    return np.where(far, a, foot), np.where(far, b, direction)


# ---------------------------------------------------------------- join and meet


def _points_to_line(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    d = p[..., 3:] * q[..., :3] - q[..., 3:] * p[..., :3]
    return np.concatenate([d, np.cross(p[..., :3], q[..., :3])], axis=-1)


def _point_line_to_plane(p: np.ndarray, line: np.ndarray) -> np.ndarray:
    d, m = line[..., :3], line[..., 3:]
    normal = p[..., 3:] * m - np.cross(p[..., :3], d)
    return np.concatenate([normal, -np.sum(p[..., :3] * m, axis=-1, keepdims=True)], axis=-1)


def _swap(line: np.ndarray) -> np.ndarray:
    """Exchange direction and moment: the same line in the dual space."""
    return np.concatenate([line[..., 3:], line[..., :3]], axis=-1)


def _lines_to_plane(a: np.ndarray, b: np.ndarray, what: str) -> np.ndarray:
    """Join two meeting lines: `a` with the points of `b` on the coordinate planes."""
    apart = np.abs(np.sum(a * _swap(b), axis=-1))
    if (apart > 1e-9 * norm(a) * norm(b)).any():  # as in `_line`
        raise GeometryError.expected(what, "lines in one plane", "skew lines")
    rows = plucker_matrix(b)
    planes = _point_line_to_plane(rows, a[..., None, :])
    best = np.argmax(norm(planes), axis=-1)
    plane = np.take_along_axis(planes, best[..., None, None], axis=-2)[..., 0, :]
    return _regular(plane, norm(a) * norm(b), what, "the same line twice")


def _combine(name: str, items: tuple[Any, ...]) -> np.ndarray:
    """Join points and lines; in dual coordinates this is also the meet."""
    dual = name == "meet"
    operands = []
    for k, item in enumerate(items):
        a = elements(f"{name}, element {k}", item, (3, 4, 6))
        if a.shape[-1] == 6:
            a = _line(f"{name}, element {k}", a)
            a = _swap(a) if dual else a
        operands.append(a)
    same_shape(name, *operands)
    sizes = tuple(a.shape[-1] for a in operands)
    twice = "the same element twice"
    if sizes == (3, 3):
        a, b = operands
        return _regular(np.cross(a, b), norm(a) * norm(b), name, twice)
    if sizes == (6, 6):
        a, b = np.broadcast_arrays(*operands)
        return _lines_to_plane(a, b, name)
    if sizes in ((4, 4), (4, 4, 4)):
        a, b = operands[:2]
        line = _regular(_points_to_line(a, b), norm(a) * norm(b), name, twice)
        if len(sizes) == 2:
            return _swap(line) if dual else line
        operands = [operands[2], line]
    elif sizes == (6, 4):
        operands = operands[::-1]
    elif sizes != (4, 6):
        raise GeometryError.expected(
            name,
            "2 elements of length 3, 2 or 3 of length 4, or a line with one of length 4 or 6",
            f"elements of lengths {sizes}",
        )
    a, line = operands
    got = "a line and a " + ("plane through it" if dual else "point on it")
    result = _regular(_point_line_to_plane(a, line), norm(a) * norm(line), name, got)
    return -result if dual else result  # the weight of meet(e, f, g) is then det(n1, n2, n3)


def join(*items: Any) -> np.ndarray:
    """Return the smallest element that contains all `items`.

    Parameters
    ----------
    *items : (..., 3 | 4 | 6) array_like
        Two points of the plane: their line ``(..., 3)``. Two points of space: their line
        ``(..., 6)``, directed from the first to the second if their weights are positive.
        Three points, a point and a line, or two meeting lines of space: the plane
        ``(..., 4)``; that of three points of positive weight has the normal
        ``(q - p) × (r - p)``.

    Raises
    ------
    GeometryError
        If the elements are dependent (relative size below `TOLERANCE`), or two lines skew.
    """
    return _combine("join", items)


def meet(*items: Any) -> np.ndarray:
    """Return the greatest element contained in all `items`, the dual of `join`.

    Parameters
    ----------
    *items : (..., 3 | 4 | 6) array_like
        Two lines of the plane: their point ``(..., 3)``. Two planes: their line ``(..., 6)``
        with direction ``n1 × n2``. Three planes, a plane and a line, or two meeting lines of
        space: the point ``(..., 4)``; that of three planes has the weight ``det(n1, n2, n3)``.

    Raises
    ------
    GeometryError
        If the elements are dependent (relative size below `TOLERANCE`), or two lines skew.
    """
    return _combine("meet", items)


def incidence(a: Any, b: Any) -> np.ndarray:
    """Return how far two elements are from being incident, between 0 and about 1.

    Parameters
    ----------
    a, b : (..., 3 | 4 | 6) array_like
        A point and a line of the plane, a point and a plane, or two lines of space; all
        relative to the lengths of the vectors. For two lines 0 means that they meet.
    """
    a, b = elements("a", a, (3, 4, 6)), elements("b", b, (3, 4, 6))
    if a.shape[-1] != b.shape[-1]:
        raise GeometryError.expected(
            "b", f"an element of length {a.shape[-1]}, as a", f"length {b.shape[-1]}"
        )
    same_shape("a, b", a, b)
    if a.shape[-1] == 6:
        b = _swap(b)
    return np.abs(np.sum(a * b, axis=-1)) / (norm(a) * norm(b))
