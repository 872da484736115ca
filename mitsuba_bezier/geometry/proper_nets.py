"""Remove common factors from nets, and find the nets that are surfaces at all.

A factor of a net means nothing, but far from one its products leave the range of numbers. And nets
may be points, lines or curves, or have no finite point: these are met by no ray.
"""

from __future__ import annotations

import numpy as np

from . import bernstein

__all__ = ["free_of_factor", "spans_area"]

#: Weights count for the size of a net if they are not this much smaller than its coordinates.
_SMALL = 2.0**-40
#: Sines up to this are those of a curve: nets in float64 have digits for more, rays in float32 have
#: not by far.
_THIN = 1e-12
#: Roundings of coordinates far from the origin, of which a net that is a point or a line has some.
_ROUNDING = 8 * np.finfo(float).eps
#: Patches that are further away, and such that are smaller, cannot be told in float32.
_FAR, _TINY = 1e37, 1e-30
#: Patches looked at together: bounds the memory.
_CHUNK = 4096


def free_of_factor(nets: np.ndarray, beyond: int = 0) -> np.ndarray:
    """Return nets ``(P, K, 4)``, times powers of two, with a largest weight from 1 to 2.

    No digit changes. Where coordinates are much larger than weights they are so instead.

    Parameters
    ----------
    nets : (P, K, 4) array
    beyond : int
        Exponents of powers of two, either way, of which nets are not freed. If there are no others
        the array itself is returned.
    """
    top = np.abs(nets).max(axis=(1, 2))
    weight = np.abs(nets[..., 3]).max(axis=1)
    exponent = np.frexp(np.where(weight > _SMALL * top, weight, top))[1] - 1
    exponent[np.abs(exponent) <= beyond] = 0
    if not exponent.any():
        return nets
    return np.ldexp(nets, -exponent[:, None, None])


def spans_area(nets: np.ndarray) -> np.ndarray:
    """Return a mask of the nets ``(P, K, 4)`` that are surfaces and reach finite space.

    With ``X`` the point and its partials, ``X, X_u, X_v`` are independent somewhere: tried at a
    lattice, in coordinates of the patch. What rounding makes of a curve is one.
    """
    out = np.empty(len(nets), dtype=bool)
    for first in range(0, len(nets), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        out[chunk] = _spans_area(free_of_factor(nets[chunk]))
    return out


def _spans_area(nets: np.ndarray) -> np.ndarray:
    n = bernstein.degree_of(nets.shape[1])
    w = nets[..., 3:]
    weight = np.abs(w).max(axis=1)[:, 0]
    finite = weight * _FAR > np.abs(nets).max(axis=(1, 2))
    # the origin in the middle, the size one
    total = np.abs(w).sum(axis=1)
    middle = (nets[..., :3] * np.sign(w)).sum(axis=1) / np.where(finite[:, None], total, 1.0)
    local = nets.copy()
    with np.errstate(all="ignore"):  # of those that are not finite
        local[..., :3] -= w * middle[:, None]
        size = np.abs(local[..., :3]).max(axis=(1, 2))
        local[..., :3] /= np.where(size > 0, size, 1.0)[:, None, None]
        local[..., 3] /= np.where(weight > 0, weight, 1.0)[:, None]
        noise = _ROUNDING * np.abs(middle).max(axis=1) * weight / np.where(size > 0, size, 1.0)
    finite &= (size > _TINY * weight) & np.isfinite(local).all(axis=(1, 2))
    local[~finite] = 0.0
    uv = bernstein.multi_indices(4)[:, :2] / 4.0
    lower = bernstein.basis(n - 1, uv)
    x, xu, xv = (m @ local for m in (bernstein.basis(n, uv), *_partials(n, lower)))
    volume = _volumes(x, xu, xv).max(axis=1)
    return finite & (volume > n * (_THIN + noise))


def _partials(n: int, lower: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(lower @ m / n for m in bernstein.partials_matrices(n))


def _volumes(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the largest of the four minors of ``a, b, c`` ``(..., 4)``, without cancellation."""
    minors = []
    for k in range(4):
        i = [j for j in range(4) if j != k]
        minors.append((a[..., i] * np.cross(b[..., i], c[..., i])).sum(axis=-1))
    return np.abs(minors).max(axis=0)
