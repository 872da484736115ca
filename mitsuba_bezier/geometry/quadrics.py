"""Quadrics and the Bézier nets that lie on them: building a patch, and finding the quadric.

A quadric is a symmetric 4x4 matrix `A` up to a factor, the points ``x'Ax = 0`` in homogeneous
coordinates ``x = (w x, w y, w z, w)``.
"""

from __future__ import annotations

from functools import cache
from math import comb
from typing import Any

import numpy as np

from ..errors import GeometryError, NetError
from . import bernstein
from .checks import finite_array

__all__ = [
    "fit_quadric",
    "fit_quadrics",
    "normalize_quadric",
    "project_triangles",
    "quadric_matrix",
    "quadric_patch",
    "whiten",
]

#: Relative size below which a quantity that ought to vanish is taken as zero: far above the
#: rounding (about 1e-15) of input computed in float64, far below anything drawn by intent.
ZERO = 1e-9


def quadric_matrix(A: Any) -> np.ndarray:
    """Return `A` as a checked float64 matrix, exactly symmetric.

    Raises
    ------
    GeometryError
        If `A` is not a finite symmetric 4x4 matrix, or zero.
    """
    a = finite_array("A", A, (4, 4), GeometryError)
    scale = np.abs(a).max()
    if scale == 0:
        raise GeometryError.expected("A", "a quadric", "the zero matrix")
    skew = np.abs(a - a.T).max()
    if skew > ZERO * scale:
        raise GeometryError.expected(
            "A", "a symmetric matrix", f"entries that differ from their mirror images by {skew:.3g}"
        )
    return (a + a.T) / 2


def quadric_patch(A: Any, center: Any, points: Any) -> np.ndarray:
    """Build the quadratic patch that a projection from a point of the quadric puts on it.

    The triangle of `points` is projected onto the quadric from `center` ``S``:
    ``b_ij = (S'A P_i) P_j + (S'A P_j) P_i - (P_i'A P_j) S``. Its three boundary conics,
    extended, meet in ``S``.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix of the quadric.
    center : (4,) array_like
        Centre of projection, homogeneous, on the quadric.
    points : (3, 4) array_like
        Homogeneous points, on the quadric or off it, ideal or not. A point on the quadric is
        a corner of the patch; an ideal point in the tangent plane of the centre gives a
        corner in the centre itself. Factors of the points change the parameters only.

    Returns
    -------
    (6, 4) array
        The net; its sign is chosen so that the sum of the weights is not negative.

    Raises
    ------
    GeometryError
        If `A` is no quadric, the centre is not on it or is its singular point, a vector is
        zero, or centre and points are dependent.

    Examples
    --------
    >>> sphere, pole = np.diag([1.0, 1, 1, -1]), [0, 0, 1, 1]
    >>> net = mb.quadric_patch(sphere, pole, [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, -1, 1]])
    >>> np.allclose(np.einsum("ki,ij,kj->k", net[[0, 3, 5]], sphere, net[[0, 3, 5]]), 0)
    True
    """
    a = quadric_matrix(A)
    s = finite_array("center", center, (4,), GeometryError)
    p = finite_array("points", points, (3, 4), GeometryError)
    if not s.any():
        raise GeometryError.expected("center", "a point", "the zero vector")
    if not p.any(axis=1).all():
        raise GeometryError.expected("points", "three points", "the zero vector")
    sigma = np.linalg.eigvalsh(a)
    if sigma[0] * sigma[-1] > 0 and np.abs(sigma).min() > ZERO * np.abs(sigma).max():
        raise GeometryError.expected("A", "a quadric with real points", "a definite matrix (empty)")
    value = s @ a @ s
    terms = np.abs(s) @ np.abs(a) @ np.abs(s)
    if abs(value) > ZERO * terms:
        raise GeometryError.expected(
            "center", "a point on the quadric", f"S'AS = {value:.3g} in terms of {terms:.3g}"
        )
    if np.abs(a @ s).max() <= ZERO * np.abs(a).max() * np.abs(s).max():
        raise GeometryError.expected("center", "a regular point of the quadric", "its vertex")
    unit = np.vstack([p, s])
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    volume = np.linalg.svd(unit, compute_uv=False)[-1]
    if not volume > 1e-12:  # rounding of the SVD is 1e-16; smaller means no digits are left
        raise GeometryError.expected(
            "points", "three points independent of each other and of the center", "dependent points"
        )
    return project_triangles(a, s, p)


#: Corners of the control points of a quadratic net, in net order.
_FIRST, _SECOND = np.array([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]).T


def project_triangles(a: np.ndarray, centers: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Build the nets of `quadric_patch` for many centres and triangles, unchecked.

    Parameters
    ----------
    a : (4, 4) array
        Quadric.
    centers : (..., 4) array
        Centres on it.
    points : (..., 3, 4) array
        Triangles.

    Returns
    -------
    (..., 6, 4) array
    """
    polar = points @ a @ centers[..., None]
    gram = points @ a @ np.swapaxes(points, -1, -2)
    nets = (
        polar[..., _FIRST, :] * points[..., _SECOND, :]
        + polar[..., _SECOND, :] * points[..., _FIRST, :]
        - gram[..., _FIRST, _SECOND, None] * centers[..., None, :]
    )
    return np.where(nets[..., 3].sum(axis=-1)[..., None, None] < 0, -nets, nets)


#: Places of the ten entries of a symmetric 4x4 matrix.
_ROWS, _COLUMNS = np.triu_indices(4)
#: Entries of `A` over entries of the unknown vector, which has the Frobenius norm of `A`.
_FROBENIUS = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(0.5))


def _multinomials(n: int) -> np.ndarray:
    rows = bernstein.multi_indices(n).tolist()
    return np.array([comb(n, i) * comb(n - i, j) for i, j, _k in rows], dtype=np.float64)


@cache
def _product_matrix(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows ``a <= b`` of all pairs of a net and the matrix ``(K_2n, pairs)`` of products.

    ``B_a B_b = (multinomial(a) multinomial(b) / multinomial(a + b)) B_{a+b}``.
    """
    ijk = bernstein.multi_indices(n)
    first, second = np.triu_indices(len(ijk))
    m1, m2 = _multinomials(n), _multinomials(2 * n)
    total = ijk[first] + ijk[second]
    rows = np.array([bernstein.row(2 * n, int(i), int(j)) for i, j, _k in total])
    out = np.zeros((bernstein.size(2 * n), len(first)))
    factor = np.where(first == second, 1.0, 2.0)
    out[rows, np.arange(len(first))] = factor * m1[first] * m1[second] / m2[rows]
    return first, second, out


def _equations(nets: np.ndarray, n: int) -> np.ndarray:
    """Return the systems ``(P, K_2n, 10)`` for the entries of A on and above the diagonal."""
    first, second, product = _product_matrix(n)
    x, y = nets[:, first], nets[:, second]
    pairs = x[..., _ROWS] * y[..., _COLUMNS] + x[..., _COLUMNS] * y[..., _ROWS]
    return product @ (pairs / _FROBENIUS)


def whiten(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Map each net by a collineation that makes its four columns orthonormal.

    Afterwards place, size, proportions, flatness and weights no longer count: nets that differ
    by a collineation differ by a rotation of the four coordinates only.

    Parameters
    ----------
    nets : (P, K, 4) array
        Nets of any degree, finite.

    Returns
    -------
    white : (P, K, 4) array
        The nets ``b @ back``; their fourth column is noise where `thickness` is zero.
    back : (P, 4, 4) array
        A quadric `A` of the white net is ``back A back'`` for the old one; a plane likewise.
    thickness : (P,) array
        Smallest over largest singular value of the net, moved and scaled to unit size; 0 for
        a net in a plane.
    """
    top = np.abs(nets).max(axis=(1, 2), keepdims=True)
    scale = np.where(top > 0, top, 1.0)
    xyz, w = nets[..., :3] / scale, nets[..., 3:] / scale
    # origin into the net (least squares: ideal points have no say), then unit size; this is
    # where the digits of a small patch far from the origin would get lost in the SVD
    weight = (w * w).sum(axis=1)
    finite = weight > 0
    origin = np.where(finite, (xyz * w).sum(axis=1) / np.where(finite, weight, 1.0), 0.0)
    local = xyz - w * origin[:, None]
    sizes = np.sqrt((local**2).sum(axis=(1, 2))), np.sqrt(weight[:, 0])
    a, b = (np.where(s > 0, s, 1.0) for s in sizes)
    move = np.zeros((len(nets), 4, 4))
    move[:, [0, 1, 2], [0, 1, 2]] = 1 / a[:, None]
    move[:, 3, 3] = 1 / b
    move[:, 3, :3] = -origin / a[:, None]
    local = np.concatenate([local / a[:, None, None], w / b[:, None, None]], axis=-1)
    if nets.shape[1] < 4:  # degree 1: three points, always in a plane
        return local, move / scale, np.zeros(len(nets))
    u, sigma, vt = np.linalg.svd(local, full_matrices=False)
    first = np.where(sigma[:, :1] > 0, sigma[:, :1], 1.0)
    thickness = sigma[:, -1] / first[:, 0]
    # the clamp keeps numbers finite; a net that needs it is in a plane
    back = np.swapaxes(vt, 1, 2) / np.maximum(sigma, 1e-16 * first)[:, None, :]
    return u, move @ back / scale, thickness


def fit_quadrics(
    nets: Any, tolerance: float = 1e-9, flat: float = 1e-13
) -> tuple[np.ndarray, np.ndarray]:
    """Find the quadric on which each net lies, if it lies on exactly one.

    ``b'Ab`` is a polynomial of degree ``2n``; its Bernstein coefficients are ``K_2n`` linear
    equations in the ten entries of `A`, exact for every degree. They are solved after `whiten`
    by a singular value decomposition: the net lies on a quadric when the smallest singular
    value is at most `tolerance` times the second smallest.

    Parameters
    ----------
    nets : (P, K, 4) array_like
        Nets of any degree ``n >= 1``.
    tolerance : float
        Bound of the ratio of the two smallest singular values. The ratio is about the distance
        from the quadric, measured against the bulge of the patch (the part of its shape that
        is not plane). Nets computed in float64 have about 1e-16 times length over bulge: 1e-15
        for an octant of a sphere, 1e-12 for a patch of 1/100 of the radius. So 1e-9 leaves
        three digits to earlier steps, and stays far below deviations that anyone draws or a
        render can show. Nets rounded to float32 have 1e-7 times length over bulge instead;
        1e-5 is right for patches not smaller than a fifth of the radius.
    flat : float
        A net with less `whiten` thickness than this counts as plane: rounding leaves some
        1e-16 in float64. Nets rounded to float32 need about 1e-6.

    Returns
    -------
    A : (P, 4, 4) array
        Symmetric, scaled as by `normalize_quadric`; zero where ``ok`` is false.
    ok : (P,) bool array
        False also for nets in a plane, on a curve or in a point: many quadrics hold these.

    Raises
    ------
    NetError
        If the array is not of this form or not finite.

    Examples
    --------
    >>> nets = np.concatenate([mb.sphere().control_points, mb.sphere(radius=2).control_points])
    >>> A, ok = mb.fit_quadrics(nets)
    >>> int(ok.sum()), np.allclose(A[8], np.diag([1, 1, 1, -4]) / 4)
    (16, True)
    """
    nets = finite_array("nets", nets, (None, None, 4), NetError)
    n = bernstein.degree_of(nets.shape[1], "nets")
    out = np.zeros((len(nets), 4, 4))
    ok = np.zeros(len(nets), dtype=bool)
    if n == 1:
        return out, ok
    chunk = max(1, 4_000_000 // (nets.shape[1] ** 2 * 10))  # some 30 MB of temporaries
    for start in range(0, len(nets), chunk):
        part = slice(start, start + chunk)
        white, back, thickness = whiten(nets[part])
        values, q = np.linalg.svd(_equations(white, n), full_matrices=False)[1:]
        good = (thickness > flat) & (values[:, -1] <= tolerance * values[:, -2])
        # a second null vector: no single quadric. Proper patches have 1e-3 and up here, and at
        # 1e-7 the first null vector could not be told from the second to nine digits.
        good &= values[:, -2] > 1e-7 * values[:, 0]
        a = np.zeros((len(white), 4, 4))
        a[:, _ROWS, _COLUMNS] = a[:, _COLUMNS, _ROWS] = q[:, -1] * _FROBENIUS
        a = back @ a @ np.swapaxes(back, 1, 2)
        a = np.where(good[:, None, None], (a + np.swapaxes(a, 1, 2)) / 2, 0.0)
        out[part], ok[part] = normalize_quadric(a), good
    return out, ok


def fit_quadric(net: Any, tolerance: float = 1e-9, flat: float = 1e-13) -> np.ndarray | None:
    """Return the quadric on which one net lies, or None.

    Parameters
    ----------
    net : (K, 4) array_like
        A net of any degree.
    tolerance, flat : float
        As for `fit_quadrics`.

    Returns
    -------
    (4, 4) array or None
        None if the net lies on no quadric, or, like a plane net, on many.

    Raises
    ------
    NetError
        If the net is not of this form or not finite.

    Examples
    --------
    >>> A = mb.fit_quadric(mb.sphere().control_points[0])
    >>> np.allclose(A, np.diag([1, 1, 1, -1]))
    True
    """
    net = finite_array("net", net, (None, 4), NetError)
    a, ok = fit_quadrics(net[None], tolerance, flat)
    return a[0] if ok[0] else None


def normalize_quadric(a: np.ndarray) -> np.ndarray:
    """Scale matrices ``(..., 4, 4)``: largest entry 1 in absolute value, sign fixed.

    More eigenvalues are positive than negative; where they are equally many, the trace of the
    upper left 3x3 block is not negative. So ``x'Ax < 0`` inside of an ellipsoid.
    """
    size = np.abs(a).max(axis=(-2, -1), keepdims=True)
    a = a / np.where(size > 0, size, 1.0)
    eigen = np.linalg.eigvalsh(a)
    bound = 1e-14 * np.abs(eigen).max(axis=-1, keepdims=True)  # rounding of eigvalsh: 1e-16
    excess = (eigen > bound).sum(axis=-1) - (eigen < -bound).sum(axis=-1)
    trace = np.trace(a[..., :3, :3], axis1=-2, axis2=-1)
    sign = np.where(excess != 0, np.sign(excess), np.where(trace < 0, -1.0, 1.0))
    return a * sign[..., None, None]
