"""Decide which rational quadratic triangles lie on a quadric, by one point and its tangents."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import NetError
from .checks import finite_array
from .quadric_types import classify_quadric
from .quadrics import fit_quadric, whiten

__all__ = ["QuadricTriangle", "characterize", "paraboloid_of"]

#: Rows of the control points of the boundary conics.
_EDGES = ((0, 1, 3), (3, 4, 5), (5, 2, 0))
_SQUARES = np.array([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)])

#: Relative size of a singular value that counts as zero in the configuration of a net. White
#: nets have rounding of 1e-16; what geometry means (a straight or collapsed edge) is 1e-3 and up.
_ZERO = 1e-9


class QuadricTriangle(NamedTuple):
    """What `characterize` finds out about a rational quadratic triangle.

    Attributes
    ----------
    A : (4, 4) array or None
        The quadric that holds the patch.
    name : str or None
        Its affine type, as from `classify_quadric`.
    center : (4,) array or None
        The point S in which the extended boundary conics meet, homogeneous, of unit length;
        None if they determine none. Where the conics do not meet, the point of their planes.
    meeting : float or None
        How far the worst boundary conic passes S by: 0 if all three meet there. Measured in
        the coordinates of `whiten`, hence the same for all collineations of the net.
    coplanarity : float or None
        How far the tangents of the three conics in S are from lying in one plane: the smallest
        singular value of their three unit directions around S (in the same coordinates), 0 if
        they lie in one plane, 1 if they are orthogonal. With fewer than three proper conics
        (a lune has two) it is 0, for two lines through a point always lie in a plane.
    arcs_through : int or None
        How many of the three boundary arcs themselves (not their extensions) contain S.
    polynomial : bool
        All weights are equal: the patch is a polynomial one.
    """

    A: np.ndarray | None
    name: str | None
    center: np.ndarray | None
    meeting: float | None
    coplanarity: float | None
    arcs_through: int | None
    polynomial: bool

    @property
    def paraboloid(self) -> str | None:
        """The type of the paraboloid (or parabolic cylinder) that holds a polynomial patch."""
        known = ("elliptic paraboloid", "hyperbolic paraboloid", "parabolic cylinder")
        return self.name if self.polynomial and self.name in known else None


def characterize(net: Any, tolerance: float = 1e-9) -> QuadricTriangle:
    """Decide whether a rational quadratic triangle lies on a quadric, and measure why.

    The criterion (Boehm and Hansford, "Bézier patches on quadrics", 1991): a quadratic patch
    lies on a regular quadric exactly when the three boundary conics, extended, meet in one
    point S and their tangents in S lie in one plane. S is the centre of the projection that
    makes the patch, see `quadric_patch`. The conics then lie on a quadric in any case; the
    patch does if, besides, an even number of its three arcs contain S (none, if no weight is
    negative). Otherwise it is bounded by one arc that is the complement of the right one, its
    middle control point having the wrong sign.

    Parameters
    ----------
    net : (6, 4) array_like
        A net of degree 2.
    tolerance : float
        As for `fit_quadrics`, which decides about the quadric; S and the tangents are found
        from the conics alone.

    Returns
    -------
    QuadricTriangle
        For a net in a plane, `A` and all that concerns S is None.

    Raises
    ------
    NetError
        If the net is not of this form or not finite.

    Examples
    --------
    >>> sphere, pole = np.diag([1.0, 1, 1, -1]), [0, 0, 1, 1]
    >>> net = mb.quadric_patch(sphere, pole, [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, -1, 1]])
    >>> found = mb.characterize(net)
    >>> found.name, (found.center / found.center[3]).round(9).tolist()
    ('ellipsoid', [-0.0, -0.0, 1.0, 1.0])
    """
    b = finite_array("net", net, (6, 4), NetError)
    a = fit_quadric(b, tolerance)
    # 1e-12: equal up to rounding of a few operations
    polynomial = bool(b[:, 3].any() and np.ptp(b[:, 3]) <= 1e-12 * np.abs(b[:, 3]).max())
    name = None if a is None else classify_quadric(a)
    white, back, thickness = (x[0] for x in whiten(b[None]))
    center = _contracted_line(white) if thickness > 1e-13 else None
    if center is None and thickness > 1e-13:
        center = _common_point(white)
    if center is None:
        return QuadricTriangle(a, name, None, None, None, None, polynomial)
    measures = _measure(white, center)
    # points transform as rows: white = b @ back
    s = np.linalg.solve(back.T, center)
    s /= np.linalg.norm(s)
    # the weight positive, or for an ideal point (up to rounding) the largest coordinate
    lead = 3 if abs(s[3]) > 1e-12 else int(np.argmax(np.abs(s)))
    return QuadricTriangle(a, name, s * np.sign(s[lead]), *measures, polynomial)


def paraboloid_of(net: Any, tolerance: float = 1e-9) -> np.ndarray | None:
    """Return the paraboloid on which a polynomial quadratic triangle lies, or None.

    Parameters
    ----------
    net : (6, 4) array_like
        A net of degree 2.
    tolerance : float
        As for `fit_quadrics`.

    Returns
    -------
    (4, 4) array or None
        An elliptic or hyperbolic paraboloid or a parabolic cylinder, scaled as by
        `fit_quadric`; None if the weights differ or the patch lies on no quadric.
    """
    found = characterize(net, tolerance)
    return found.A if found.paraboloid else None


def _contracted_line(white: np.ndarray) -> np.ndarray | None:
    """Return S as the image of the domain line that a projected patch contracts to it.

    With ``b_ij = l_i P_j + l_j P_i - g_ij S`` the line ``l'U = 0`` is mapped to S. Symmetric
    matrices C with ``sum C_ij b_ij = 0`` then satisfy ``C l = 0``: they vanish on the base
    points of the map, which lie on the line. This also works for lunes, where a boundary
    conic collapses into S.
    """
    multiplicity = np.where(_SQUARES[:, 0] == _SQUARES[:, 1], 1.0, 2.0)
    kernel = np.linalg.svd((multiplicity[:, None] * white).T)[2][4:]
    c = np.zeros((2, 3, 3))
    c[:, _SQUARES[:, 0], _SQUARES[:, 1]] = c[:, _SQUARES[:, 1], _SQUARES[:, 0]] = kernel
    sigma, vt = np.linalg.svd(c.reshape(6, 3))[1:]
    if sigma[2] > _ZERO * sigma[0] or sigma[1] <= _ZERO * sigma[0]:
        return None
    d, e = vt[0], vt[1]  # two points on the line l = vt[2]
    images = [_value(white, u) for u in (d, e, d + e, d - e)]
    sigma, vt = np.linalg.svd(np.array(images))[1:]
    return vt[0] if sigma[1] <= _ZERO * sigma[0] else None


def _value(net: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the point of a quadratic net at homogeneous barycentric coordinates."""
    multiplicity = np.where(_SQUARES[:, 0] == _SQUARES[:, 1], 1.0, 2.0)
    return (multiplicity * u[_SQUARES[:, 0]] * u[_SQUARES[:, 1]]) @ net


def _common_point(white: np.ndarray) -> np.ndarray | None:
    """Return the point in which the planes of the three boundary conics meet, if it is one."""
    planes = []
    for rows in _EDGES:
        sigma, vt = np.linalg.svd(white[list(rows)])[1:]
        if sigma[2] <= _ZERO * sigma[0]:
            return None  # a straight or collapsed edge has no plane of its own
        planes.append(vt[3])
    sigma, vt = np.linalg.svd(np.array(planes))[1:]
    return vt[3] if sigma[2] > _ZERO else None


def _measure(white: np.ndarray, center: np.ndarray) -> tuple[float, float, int]:
    """Return `meeting`, `coplanarity` and `arcs_through` of a `QuadricTriangle`."""
    meeting, inside, tangents = 0.0, 0, []
    for rows in _EDGES:
        points = white[list(rows)]
        sigma, vt = np.linalg.svd(points)[1:]
        if sigma[2] <= _ZERO * sigma[0]:
            continue
        # center = alpha b_0 + beta b_1 + gamma b_2 is on the conic s^2, 2 s t, t^2 exactly
        # when beta^2 = 4 alpha gamma
        alpha, beta, gamma = np.linalg.lstsq(points.T, center, rcond=None)[0]
        off_conic = abs(beta**2 - 4 * alpha * gamma) / (alpha**2 + beta**2 + gamma**2)
        meeting = max(meeting, float(off_conic), abs(float(vt[3] @ center)))
        s, t = (2 * alpha, beta) if abs(alpha) >= abs(gamma) else (beta, 2 * gamma)
        inside += int(s * t > 0)
        # derivative in the direction (-t, s), which is not along the point itself
        tangent = np.array([-2 * s * t, 2 * (s * s - t * t), 2 * s * t]) @ points
        tangent = tangent - (tangent @ center) * center
        tangents.append(tangent / np.linalg.norm(tangent))
    if len(tangents) < 3:
        return meeting, 0.0, inside
    return meeting, float(np.linalg.svd(np.array(tangents), compute_uv=False)[2]), inside
