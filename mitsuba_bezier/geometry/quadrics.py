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

__all__ = ["fit_quadric", "fit_quadrics", "quadric_matrix", "quadric_patch"]

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
    try:
        a = np.asarray(A, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise GeometryError.expected("A", "a 4x4 matrix of numbers", f"{error}") from None
    if a.shape != (4, 4) or not np.isfinite(a).all():
        got = f"shape {a.shape}" if a.shape != (4, 4) else "NaN or infinite entries"
        raise GeometryError.expected("A", "a finite 4x4 matrix", got)
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
    """
    a = quadric_matrix(A)
    try:
        s = np.asarray(center, dtype=np.float64)
        p = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise GeometryError.expected("center, points", "numbers", f"{error}") from None
    if s.shape != (4,) or not np.isfinite(s).all():
        raise GeometryError.expected("center", "a finite homogeneous point (4,)", f"{s.tolist()}")
    if p.shape != (3, 4) or not np.isfinite(p).all():
        raise GeometryError.expected(
            "points", "three finite homogeneous points (3, 4)", f"{p.tolist()}"
        )
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
    polar = p @ a @ s
    gram = p @ a @ p.T
    net = np.array(
        [
            polar[i] * p[j] + polar[j] * p[i] - gram[i, j] * s
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        ]
    )
    return -net if net[:, 3].sum() < 0 else net


#: Places of the ten entries of a symmetric 4x4 matrix.
_ROWS, _COLUMNS = np.triu_indices(4)


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
    # b_a'A b_b, symmetrised; entries off the diagonal stand for two and carry sqrt(2), so that
    # the norm of the unknown is the Frobenius norm of A
    pairs = (x[..., _ROWS] * y[..., _COLUMNS] + x[..., _COLUMNS] * y[..., _ROWS]) * np.where(
        _ROWS == _COLUMNS, 0.5, np.sqrt(0.5)
    )
    return product @ pairs


def fit_quadrics(nets: Any, tolerance: float = 1e-9) -> tuple[np.ndarray, np.ndarray]:
    """Find the quadric on which each net lies, if it lies on exactly one.

    ``b'Ab`` is a polynomial of degree ``2n``; its Bernstein coefficients are ``K_2n`` linear
    equations in the ten entries of `A`. Each net is first mapped by the collineation that
    makes its 4 columns orthonormal, so that place, size, flatness and weights do not
    count; then the net lies on a quadric when the smallest singular value is at most
    `tolerance` times the second smallest.

    Parameters
    ----------
    nets : (P, K, 4) array_like
        Nets of any degree ``n >= 1``.
    tolerance : float
        Bound of the ratio of the two smallest singular values, which is about the relative
        distance from the quadric, measured against the bulge of the patch. Input computed in
        float64 has ratios of about ``1e-16`` times the ratio of length to bulge (1 for an
        octant of a sphere, 1e4 for a patch of 1/100 of the radius); 1e-9 leaves room for
        four digits lost in earlier work and stays far below any modelled deviation. Nets
        rounded to float32 need about 1e-5.

    Returns
    -------
    A : (P, 4, 4) array
        Symmetric, largest entry 1 in absolute value, more positive eigenvalues than negative
        ones where they differ; zero where ``ok`` is false.
    ok : (P,) bool array
        False also for nets in a plane, on a curve or in a point: many quadrics hold these.
    """
    nets = np.asarray(nets, dtype=np.float64)
    if nets.ndim != 3 or nets.shape[-1] != 4:
        raise NetError.expected("nets", "shape (P, K, 4)", f"shape {nets.shape}")
    if not np.isfinite(nets).all():
        raise NetError.expected("nets", "finite numbers", "NaN or infinity")
    n = bernstein.degree_of(nets.shape[1], "nets")
    count = len(nets)
    out = np.zeros((count, 4, 4))
    ok = np.zeros(count, dtype=bool)
    chunk = max(1, 4_000_000 // (nets.shape[1] ** 2 * 10))  # some 30 MB of temporaries
    for start in range(0, count, chunk):
        part = slice(start, start + chunk)
        out[part], ok[part] = _fit(nets[part], n, tolerance)
    return out, ok


def _fit(nets: np.ndarray, n: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    # equal rows first: a factor of the whole net, or a scale of space, is then harmless
    size = np.abs(nets).max(axis=(1, 2), keepdims=True)
    u, sigma, vt = np.linalg.svd(nets / np.where(size > 0, size, 1.0), full_matrices=False)
    # a net in a plane has rank 3; below 1e-13 the bulge is rounding
    spatial = sigma[:, -1] > 1e-13 * sigma[:, 0]
    if u.shape[-1] < 4:  # degree 1: three points, always a plane
        return np.zeros((len(nets), 4, 4)), np.zeros(len(nets), dtype=bool)
    values, q = np.linalg.svd(_equations(u, n))[1:]
    ok = spatial & (values[:, -1] <= tolerance * values[:, -2])
    # more than one null vector: no single quadric. Values of a proper patch are 1e-3 and up.
    ok &= values[:, -2] > 1e-7 * values[:, 0]
    entries = q[:, -1] * np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(0.5))
    a = np.zeros((len(nets), 4, 4))
    a[:, _ROWS, _COLUMNS] = entries
    a[:, _COLUMNS, _ROWS] = entries
    # u = b V / sigma, hence A in the old coordinates is V / sigma A sigma^-1 V'
    back = np.swapaxes(vt, 1, 2) / np.where(spatial[:, None], sigma, 1.0)[:, None, :]
    a = back @ a @ np.swapaxes(back, 1, 2)
    a = (a + np.swapaxes(a, 1, 2)) / 2
    a[~ok] = 0.0
    return normalize_quadric(a), ok


def normalize_quadric(a: np.ndarray) -> np.ndarray:
    """Scale matrices ``(..., 4, 4)`` to largest entry 1, mostly positive eigenvalues."""
    size = np.abs(a).max(axis=(-2, -1), keepdims=True)
    a = a / np.where(size > 0, size, 1.0)
    eigen = np.linalg.eigvalsh(a)
    bound = ZERO * np.abs(eigen).max(axis=-1, keepdims=True)
    excess = (eigen > bound).sum(axis=-1) - (eigen < -bound).sum(axis=-1)
    trace = np.trace(a[..., :3, :3], axis1=-2, axis2=-1)
    sign = np.where(excess != 0, np.sign(excess), np.where(trace < 0, -1.0, 1.0))
    return a * sign[..., None, None]


def fit_quadric(net: Any, tolerance: float = 1e-9) -> np.ndarray | None:
    """Return the quadric on which one net lies, or None; see `fit_quadrics`.

    Parameters
    ----------
    net : (K, 4) array_like
        A net of any degree.
    tolerance : float
        As for `fit_quadrics`.

    Returns
    -------
    (4, 4) array or None
        None if the net lies on no quadric, or, like a plane net, on many.
    """
    net = np.asarray(net, dtype=np.float64)
    if net.ndim != 2 or net.shape[1] != 4:
        raise NetError.expected("net", "shape (K, 4)", f"shape {net.shape}")
    a, ok = fit_quadrics(net[None], tolerance)
    return a[0] if ok[0] else None
