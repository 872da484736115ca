"""What a conic has: centre, foci, directrices, axes, vertices, through all types.

Kepler (1604) let the types go over into each other: as an ellipse becomes a parabola, one of its
foci, which he called *blind*, goes to infinity along the axis and comes back from the other side
in the hyperbola. In homogeneous coordinates nothing is singular there: the blind focus and the
centre of a parabola are the ideal point of its axis, and its second directrix, its second axis and
its second vertex are ideal as well.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import GeometryError
from .conics import classify_conic
from .polarity import _binary_roots, line_intersections
from .projective import IDEAL_LINE, norm, numbers

__all__ = ["ConicElements", "conic_by_focus", "conic_elements"]


class ConicElements(NamedTuple):
    """What `conic_elements` returns: points and lines homogeneous, of unit length.

    Attributes
    ----------
    kind : str
        "ellipse", "parabola" or "hyperbola".
    center : (3,) array
        The pole of the ideal line; ideal for a parabola.
    foci : (2, 3) array
        Both the centre for a circle. The second is the blind focus of a parabola, ideal.
    directrices : (2, 3) array
        The polars of the foci. The ideal line for a circle, and for a parabola's blind focus.
    axes : (2, 3) array
        The line through the foci first. The second is the ideal line for a parabola.
    vertices : (2, 3) array
        On the first axis; the second is ideal for a parabola.
    co_vertices : (2, 3) array or None
        On the second axis of an ellipse.
    asymptotes : (2, 3) array or None
        Of a hyperbola: its tangents in its ideal points.
    eccentricity : float
        0 for a circle, 1 for a parabola.
    parameter : float
        Half of the chord through a focus across the axis (semi-latus rectum).
    """

    kind: str
    center: np.ndarray
    foci: np.ndarray
    directrices: np.ndarray
    axes: np.ndarray
    vertices: np.ndarray
    co_vertices: np.ndarray | None
    asymptotes: np.ndarray | None
    eccentricity: float
    parameter: float


def _checked(A: Any) -> tuple[np.ndarray, str]:
    kind = classify_conic(A)  # checks shape and symmetry
    if kind not in ("ellipse", "parabola", "hyperbola"):
        raise GeometryError.expected("A", "a regular conic with real points", kind)
    a = numbers(A, "A")
    a = a / np.abs(a).max()
    return (a + a.T) / 2, kind


def _foci(a: np.ndarray, kind: str) -> np.ndarray:
    """Return both foci, homogeneous, in a form that does not care about the type.

    The tangents through a focus are isotropic (Plücker), so that with the conic of lines ``C``
    (the cofactors of `a`) it solves ``f z^2 - 2 D z + E = 0`` for ``z = x + i y``, where
    ``D = C02 + i C12``, ``E = C00 - C11 + 2 i C01``, ``f = C22``. As f passes through 0 one root
    passes through infinity in the direction of D.
    """
    c = np.array([np.cross(a[1], a[2]), np.cross(a[2], a[0]), np.cross(a[0], a[1])])
    f = 0.0 if kind == "parabola" else c[2, 2]
    d, e = complex(c[0, 2], c[1, 2]), complex(c[0, 0] - c[1, 1], 2 * c[0, 1])
    square = d * d - f * e
    # the difference of what rounding leaves of a circle: sixteen roundings of its terms
    if abs(square) <= 4e-15 * (abs(d) ** 2 + abs(f * e)) and f:
        square = 0j
    root = np.sqrt(square)
    if (d.conjugate() * root).real < 0:
        root = -root
    far = d + root
    second = np.array([far.real, far.imag, f])
    if abs(far) > 0 and root != 0:
        z = e * far.conjugate() / abs(far)
        first = np.array([z.real, z.imag, abs(far)])
    else:
        first = second = np.array([d.real, d.imag, f])
    return np.stack([first / norm(first), second / norm(second)])


def conic_elements(A: Any) -> ConicElements:
    """Return centre, foci, directrices, axes, vertices, ... of a regular conic.

    Parameters
    ----------
    A : (3, 3) array_like
        Symmetric.

    Raises
    ------
    GeometryError
        If the conic has no real points, or is a pair of lines: the message says what it is.

    Notes
    -----
    A parabola is what `classify_conic` calls one: the ratio of the eigenvalues of the quadratic
    part is below 1e-10. Everything depends continuously on `A` through the types.

    Examples
    --------
    >>> conic_elements([[0, 0, -1], [0, 1, 0], [-1, 0, 0]]).foci  # y^2 = 2x
    array([[0.4472136 , 0.        , 0.89442719],
           [1.        , 0.        , 0.        ]])
    """
    a, kind = _checked(A)
    lam, vec = np.linalg.eigh(a[:2, :2])
    small = int(np.argmin(np.abs(lam)))
    if kind == "hyperbola":
        # its vertices lie where the eigenvalue has the sign that det a / det(2x2) has not
        small = int(np.argmax(lam * np.sign(np.linalg.det(a))))
    k, big = lam[small], lam[1 - small]
    if kind == "parabola":
        k = 0.0
    u, n = vec[:, small], vec[:, 1 - small]
    cofactors = np.cross(a[0], a[1])
    center = np.array([*cofactors[:2], 0.0 if kind == "parabola" else cofactors[2]])
    center = center / norm(center)
    if kind == "parabola":
        center = np.array([*u, 0.0]) * (1 if u @ center[:2] >= 0 else -1)
    foci = _foci(a, kind)
    if kind == "parabola":
        foci[1] = center
    first = foci[0] if foci[0, 2] > 0 else -foci[0]
    along, across = np.array([*u, 0.0]), np.array([*n, 0.0])
    main = np.cross(first, along)
    second = IDEAL_LINE if kind == "parabola" else np.cross(center, across)
    q = 0.0 if kind == "parabola" else along @ a @ along
    roots = _binary_roots(first @ a @ first, first @ a @ along, q)
    vertices = np.array([s * first + t * along for s, t in roots])
    order = np.argsort([1 if abs(v[2]) <= 1e-12 * norm(v) else 0 for v in vertices], kind="stable")
    co_vertices = line_intersections(a, second) if kind == "ellipse" else None
    asymptotes = None
    if kind == "hyperbola":
        asymptotes = _unit(line_intersections(a, IDEAL_LINE) @ a)
    focus = first / first[2]
    directrices = foci @ a
    if kind == "parabola":
        directrices[1] = IDEAL_LINE
    return ConicElements(
        kind,
        center,
        foci,
        _unit(directrices),
        _unit(np.stack([main, second])),
        _unit(vertices[order]),
        None if co_vertices is None else _unit(co_vertices),
        asymptotes,
        float(np.sqrt(max(1 - k / big, 0.0))),
        float(np.sqrt(-(focus @ a @ focus) / big)),
    )


def _unit(x: np.ndarray) -> np.ndarray:
    return x / norm(x)[..., None]


def conic_by_focus(focus: Any, direction: Any, parameter: float, eccentricity: float) -> np.ndarray:
    """Return the conic (3, 3) of a focus: the family in which Kepler passed through the types.

    ``r = p - e x`` in coordinates with the focus as origin and the x axis along `direction`: a
    circle for ``e = 0``, then ellipses, a parabola for ``e = 1``, hyperbolas beyond.

    Parameters
    ----------
    focus : (2,) array_like
        The focus that stays.
    direction : (2,) array_like
        From it to the vertex beside it.
    parameter : float
        Semi-latus rectum, positive.
    eccentricity : float
        Not negative.

    Raises
    ------
    GeometryError
        If a parameter is not of this kind.
    """
    f, d = numbers(focus, "focus"), numbers(direction, "direction")
    if f.shape != (2,) or d.shape != (2,) or not d.any():
        raise GeometryError.expected(
            "focus, direction", "two numbers each, a direction other than 0", f"{f}, {d}"
        )
    p, e = (float(numbers(v, s)) for v, s in ((parameter, "parameter"), (eccentricity, "e")))
    if not (p > 0 and e >= 0):
        raise GeometryError.expected(
            "parameter, eccentricity", "p > 0 and e >= 0", f"{parameter}, {eccentricity}"
        )
    c, s = d / norm(d)
    # x^2 + y^2 = (p - e x)^2
    a = np.array([[1 - e * e, 0, e * p], [0, 1, 0], [e * p, 0, -p * p]])
    back = np.array([[c, s, -c * f[0] - s * f[1]], [-s, c, s * f[0] - c * f[1]], [0, 0, 1]])
    return back.T @ a @ back
