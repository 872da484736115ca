"""Types of quadrics: the affine normal form, the projective type, the paraboloid they come from."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import GeometryError
from .quadrics import quadric_matrix

__all__ = [
    "NormalForm",
    "ParaboloidMap",
    "classify_quadric",
    "collineation_to_paraboloid",
    "normal_form",
    "projective_type",
]


def _linear_z(x: float, y: float) -> np.ndarray:
    """Return the matrix of ``x X^2 + y Y^2 - Z W``."""
    q = np.diag([x, y, 0.0, 0.0])
    q[2, 3] = q[3, 2] = -0.5
    return q


#: Affine type -> (projective type, matrix of the normal quadric).
_TYPES: dict[str, tuple[str, np.ndarray]] = {
    "imaginary ellipsoid": ("empty", np.diag([1.0, 1, 1, 1])),
    "ellipsoid": ("oval", np.diag([1.0, 1, 1, -1])),
    "elliptic paraboloid": ("oval", _linear_z(1, 1)),
    "hyperboloid of two sheets": ("oval", np.diag([1.0, 1, -1, 1])),
    "hyperboloid of one sheet": ("ruled", np.diag([1.0, 1, -1, -1])),
    "hyperbolic paraboloid": ("ruled", _linear_z(1, -1)),
    "point": ("point", np.diag([1.0, 1, 1, 0])),
    "imaginary elliptic cylinder": ("point", np.diag([1.0, 1, 0, 1])),
    "cone": ("cone", np.diag([1.0, 1, -1, 0])),
    "elliptic cylinder": ("cone", np.diag([1.0, 1, 0, -1])),
    "hyperbolic cylinder": ("cone", np.diag([1.0, -1, 0, -1])),
    "parabolic cylinder": ("cone", _linear_z(1, 0)),
    "line": ("line", np.diag([1.0, 1, 0, 0])),
    "pair of imaginary parallel planes": ("line", np.diag([1.0, 0, 0, 1])),
    "pair of planes": ("pair of planes", np.diag([1.0, -1, 0, 0])),
    "pair of parallel planes": ("pair of planes", np.diag([1.0, 0, 0, -1])),
    "plane and ideal plane": ("pair of planes", _linear_z(0, 0)),
    "double plane": ("double plane", np.diag([1.0, 0, 0, 0])),
    "double ideal plane": ("double plane", np.diag([0.0, 0, 0, 1])),
}


class NormalForm(NamedTuple):
    """A quadric as the affine image of a normal one.

    ``matrix`` is an affine map with positive determinant that takes the points of ``normal`` to
    those of the quadric: ``matrix' A matrix`` is a multiple of ``normal``.
    """

    name: str
    projective: str
    matrix: np.ndarray
    normal: np.ndarray


class ParaboloidMap(NamedTuple):
    """A quadric as a collineation of a paraboloid (or, for a cone, a parabolic cylinder).

    ``matrix`` takes points of the quadric to the paraboloid, ``inverse`` the paraboloid to the
    quadric; ``paraboloid`` is the 4x4 matrix of the latter and ``equation`` says it in words.
    """

    matrix: np.ndarray
    inverse: np.ndarray
    paraboloid: np.ndarray
    equation: str


def normal_form(A: Any, tolerance: float = 1e-10) -> NormalForm:
    """Find the affine type of a quadric and its principal axes.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix.
    tolerance : float
        What counts as zero: an eigenvalue of the upper left 3x3 block against the largest one
        (ratio of two squared axes), the constant term after the move to the centre
        against the terms that made it (squared size against squared distance from the origin).
        These are ratios of like quantities, so the unit of length and the factor of `A` do
        not matter. 1e-10 tells axes up to 1 : 1e5 apart and leaves rounding (1e-16) six
        digits. Where there is no like quantity to compare with, ``1e-4 * tolerance`` times
        the largest entry of `A` counts as rounding.

    Returns
    -------
    NormalForm
        Names are "ellipsoid", "elliptic paraboloid", "hyperboloid of two sheets", "hyperboloid
        of one sheet", "hyperbolic paraboloid", "cone", "elliptic cylinder", "hyperbolic
        cylinder", "parabolic cylinder", "point", "line", "pair of planes" (that meet), "pair
        of parallel planes", "double plane", "plane and ideal plane", "double ideal plane",
        "imaginary ellipsoid", "imaginary elliptic cylinder", "pair of imaginary parallel
        planes".

    Raises
    ------
    GeometryError
        If `A` is not a finite symmetric matrix, or zero.
    """
    a = quadric_matrix(A)
    a = a / np.abs(a).max()
    floor = 1e-4 * tolerance
    lam, axes = np.linalg.eigh(a[:3, :3])
    top = np.abs(lam).max()
    lam = np.where(np.abs(lam) <= max(tolerance * top, floor), 0.0, lam)
    if (lam > 0).sum() < (lam < 0).sum():
        a, lam = -a, -lam
    order = np.argsort(-np.sign(lam), kind="stable")  # positive, negative, zero
    order = np.concatenate([order[lam[order] != 0], order[lam[order] == 0]])
    lam, axes = lam[order], axes[:, order]
    rank = int(np.count_nonzero(lam))
    linear, constant = axes.T @ a[:3, 3], a[3, 3]

    # complete the squares
    shift = linear[:rank] / lam[:rank]
    origin = -axes[:, :rank] @ shift
    squares = linear[:rank] * shift
    terms = abs(constant) + np.abs(squares).sum()
    constant = constant - squares.sum()
    if abs(constant) <= max(tolerance * terms, floor):
        constant = 0.0
    rest = axes[:, rank:] @ linear[rank:]  # the linear part that no shift removes
    slope = float(np.linalg.norm(rest))
    if slope <= max(tolerance * np.sqrt(top * terms), floor):
        slope = 0.0

    positive = int((lam > 0).sum())
    if rank == 2 and positive == 1 and slope == 0 and constant > 0:
        lam, constant = -lam[[1, 0, 2]], -constant
        axes = axes[:, [1, 0, 2]]
    name = _name(rank, positive, slope, float(np.sign(constant)))
    projective, normal = _TYPES[name]

    matrix = np.eye(4)
    scale = 1 / np.sqrt(np.abs(lam[:rank]))
    if slope > 0:
        # sum +-Y^2 + 2 slope z + constant = 0, so Z = -2 slope z - constant
        up = -rest / slope
        matrix[:3, :rank] = axes[:, :rank] * scale
        if rank == 1:
            matrix[:3, 1] = np.cross(up, axes[:, 0])
        elif rank == 0:
            matrix[:3, :2] = _complement(up)
        matrix[:3, 2] = up / (2 * slope)
        origin = origin + up * (constant / (2 * slope))
    else:
        # axes free to choose take the length of the others
        size = np.sqrt(abs(constant)) if constant else (1 / scale.max() if rank else 1.0)
        matrix[:3, :3] = axes
        matrix[:3, :rank] *= scale * size
    matrix[:3, 3] = origin
    if np.linalg.det(matrix[:3, :3]) < 0:
        matrix[:3, 0] *= -1  # every normal quadric is symmetric in x
    return NormalForm(name, projective, matrix, normal.copy())


def _complement(direction: np.ndarray) -> np.ndarray:
    """Return two unit columns ``(3, 2)`` orthogonal to a unit vector and each other."""
    return np.linalg.svd(direction[None])[2][1:].T


def _name(rank: int, positive: int, slope: float, constant: float) -> str:
    """Return the affine type; `constant` is the sign of the constant term."""
    if rank == 3:
        if positive == 3:
            return {-1.0: "ellipsoid", 0.0: "point", 1.0: "imaginary ellipsoid"}[constant]
        names = {-1.0: "hyperboloid of one sheet", 0.0: "cone", 1.0: "hyperboloid of two sheets"}
        return names[constant]
    if slope:
        return {
            (2, 2): "elliptic paraboloid",
            (2, 1): "hyperbolic paraboloid",
            (1, 1): "parabolic cylinder",
            (0, 0): "plane and ideal plane",
        }[rank, positive]
    if rank == 2 and positive == 2:
        return {-1.0: "elliptic cylinder", 0.0: "line", 1.0: "imaginary elliptic cylinder"}[
            constant
        ]
    if rank == 2:
        return "hyperbolic cylinder" if constant else "pair of planes"
    if rank == 1:
        return {
            -1.0: "pair of parallel planes",
            0.0: "double plane",
            1.0: "pair of imaginary parallel planes",
        }[constant]
    return "double ideal plane"


def classify_quadric(A: Any, tolerance: float = 1e-10) -> str:
    """Return the affine name of a quadric; see `normal_form`.

    Examples
    --------
    >>> mb.classify_quadric(np.diag([1.0, 1, -1, -1]))
    'hyperboloid of one sheet'
    """
    return normal_form(A, tolerance).name


def projective_type(A: Any, tolerance: float = 1e-10) -> str:
    """Return the projective type of a quadric, which its signature decides.

    Returns
    -------
    str
        "oval" (3, 1), "ruled" (2, 2), "cone" (2, 1), "pair of planes" (1, 1), "double plane"
        (1, 0), and without a real surface: "empty" (4, 0), "point" (3, 0), "line" (2, 0).
        Cylinders are cones, and an imaginary cylinder is its ideal point.

    Examples
    --------
    >>> mb.projective_type(np.diag([1.0, 1, -1, -1]))
    'ruled'
    """
    return normal_form(A, tolerance).projective


# Rows: the coordinates X, Y, Z, W on the paraboloid from those on the normal quadric.
_TO_PARABOLOID: dict[str, np.ndarray] = {
    # x^2 + y^2 = (w + z)(w - z)
    "ellipsoid": np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, -1, 1]]),
    "elliptic paraboloid": np.eye(4),
    # x^2 + y^2 = (z - w)(z + w)
    "hyperboloid of two sheets": np.array(
        [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -1], [0, 0, 1, 1]]
    ),
    # x^2 - z^2 = (w + y)(w - y)
    "hyperboloid of one sheet": np.array(
        [[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 1], [0, -1, 0, 1]]
    ),
    "hyperbolic paraboloid": np.eye(4),
    # x^2 = (z + y)(z - y)
    "cone": np.array([[1.0, 0, 0, 0], [0, 0, 0, 1], [0, 1, 1, 0], [0, -1, 1, 0]]),
    # x^2 = (w + y)(w - y)
    "elliptic cylinder": np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 1], [0, -1, 0, 1]]),
    # y^2 = (x + w)(x - w)
    "hyperbolic cylinder": np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 1], [1, 0, 0, -1]]),
    "parabolic cylinder": np.eye(4),
}

_PARABOLOIDS = {
    "oval": (_linear_z(1, 1), "z = x^2 + y^2"),
    "ruled": (_linear_z(1, -1), "z = x^2 - y^2"),
    "cone": (_linear_z(1, 0), "z = x^2"),
}


def collineation_to_paraboloid(A: Any, tolerance: float = 1e-10) -> ParaboloidMap:
    """Find the collineation that takes a quadric to a standard paraboloid.

    Every oval quadric is a collineation of the elliptic paraboloid ``z = x^2 + y^2``, every
    ruled one of the hyperbolic paraboloid ``z = x^2 - y^2``, every cone (cylinders are cones) of
    the parabolic cylinder ``z = x^2``, whose vertex is the ideal point of the y axis.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix.
    tolerance : float
        As for `normal_form`.

    Raises
    ------
    GeometryError
        If `A` is no quadric, or has no paraboloid: no real surface, or planes.

    Examples
    --------
    >>> found = mb.collineation_to_paraboloid(np.diag([1.0, 1, 1, -1]))
    >>> found.equation
    'z = x^2 + y^2'
    >>> image = found.matrix @ [0.6, 0, 0.8, 1]  # a point of the unit sphere
    >>> x, y, z = image[:3] / image[3]
    >>> bool(np.isclose(z, x**2 + y**2))
    True
    """
    form = normal_form(A, tolerance)
    if form.projective not in _PARABOLOIDS:
        raise GeometryError.expected(
            "A", "an oval or ruled quadric or a cone", f"{form.name} (type {form.projective})"
        )
    to_normal = _TO_PARABOLOID[form.name]
    paraboloid, equation = _PARABOLOIDS[form.projective]
    return ParaboloidMap(
        to_normal @ np.linalg.inv(form.matrix),
        form.matrix @ np.linalg.inv(to_normal),
        paraboloid.copy(),
        equation,
    )
