"""Nets of leaves of tensor-product patches, in powers of that patch's own parameters.

A patch of degree ``(p, q)`` becomes two triangles of degree ``p + q``, in whose parameters it has
only the powers ``u^a v^b`` with ``a <= p`` and ``b <= q``: 16 for a bicubic, where a polynomial of
degree 6 has 28. So does each leaf, in variables ``(s, t)`` that are zero at its last corner and
grow along `u` and `v` of the patch, if its own parameters are affine in these. They are where all
weights are equal. Leaves of others have parameters in which their corners have weight one; without
that a torus has 18 % more leaves, which takes as much time as shorter nets save.
"""

from __future__ import annotations

import numpy as np

from ...geometry import bernstein
from ..nets import Nets, Powers, counts_of, substituted
from ..records import SIZES

__all__ = ["in_patch_variables", "patch_powers", "rounding_of_build"]

#: Powers count as absent where differences of control points are below this, times the powers of
#: two that differences have: rounding of float64. Nets that went through float32 keep all powers:
#: what it left of the others is more than leaves that meet at an edge may be off.
_ABSENT = 2.0**-44
#: Coordinates of a leaf in space are good to some roundings of float64.
_ROUNDING = 2.0**-42
#: Nets in these variables must have so few rows, as a share of those of their degree.
_WORTH = 0.8
#: Coefficients may add up to this much more than those in the leaf's parameters, or than one: so
#: float32 has nothing to cancel that it had not.
_GROWTH = 1.5


def patch_powers(nets: np.ndarray) -> np.ndarray:
    """Return the `Powers` ``(P, 3)`` that nets have in their parameters.

    Those are all of their degree, if it would be of no use to leave out what they do not have, and
    where weights are not equal.
    """
    n = bernstein.degree_of(nets.shape[1])
    scale = np.abs(nets).max(axis=1) * _ABSENT
    highest = np.stack([_highest(nets, scale, axis) for axis in (0, 1)], axis=1)
    powers = np.column_stack([highest, np.minimum(highest.sum(axis=1), n)])
    useless = counts_of(powers) > _WORTH * bernstein.size(n)
    w = nets[..., 3]
    useless |= np.ptp(w, axis=1) > 1e-12 * np.abs(w).max(axis=1)
    powers[useless] = n
    return powers


def _highest(nets: np.ndarray, scale: np.ndarray, axis: int) -> np.ndarray:
    """Return the highest power ``(P,)`` of `u` or `v`, at least one."""
    n = bernstein.degree_of(nets.shape[1])
    found = np.ones(len(nets), dtype=int)
    for k in range(1, n + 1):
        m = n + 1 - k
        nets = (bernstein.partials_matrices(m)[axis] / m) @ nets
        found[(np.abs(nets).max(axis=1) > scale * 2.0**k).any(axis=1)] = k
    return found


def rounding_of_build(nets: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return how large terms of leaves may be that are nothing but rounding of float64.

    Leaves near singular points are so small that this is more than what may be left out of others.

    Parameters
    ----------
    nets : (L, K, 4) array
        In space.
    frame : (L, 4, 4) array
        Their charts.
    """
    n = bernstein.degree_of(nets.shape[1])
    terms = np.abs(bernstein.monomial_matrix(n)).sum(axis=1).max()
    extent = np.abs(nets[..., :3]).max(axis=(1, 2)) * np.abs(frame[:, :3, :3]).max(axis=(1, 2))
    return np.asarray(_ROUNDING * terms * np.maximum(extent, 1.0))


def in_patch_variables(
    nets: np.ndarray, domain: np.ndarray, powers: Powers, size: np.ndarray, allowed: np.ndarray
) -> tuple[Nets, np.ndarray]:
    """Return nets in the variables of their patches, and a mask of those for which that will do.

    Parameters
    ----------
    nets : (L, K, 4) array
        Monomial, in the parameters of the leaves; the fourth component, weights less one, is zero
        but for rounding.
    domain : (L, 3, 3) array
        From the leaves' barycentrics to those of the patches, affine.
    powers : Powers
        Of the patches.
    size : (L,) int array
        The triangles, of `SIZES`, on which values may be off by what is next.
    allowed : (L,) array
    """
    n = bernstein.degree_of(nets.shape[1])
    i, j = bernstein.multi_indices(n)[:, :2].T
    kept = (i <= powers.p) & (j <= powers.q) & (i + j <= powers.n)
    every = np.tile(np.array(powers), (len(nets), 1))
    corners = (domain / domain.sum(axis=1, keepdims=True))[:, :2]
    frame = corners[..., :2] - corners[..., 2:]
    with np.errstate(all="ignore"):
        frame = frame / np.abs(frame).max(axis=2, keepdims=True)
        (a, b), (c, d) = frame.transpose(1, 2, 0)
        inverse = np.array([[d, -b], [-c, a]]).transpose(2, 0, 1) / (a * d - b * c)[:, None, None]
    usable = np.isfinite(inverse).all(axis=(1, 2))
    # planar triangles that stand for small leaves need no others
    usable &= (np.abs(nets[:, i + j > 1]).sum(axis=1) > allowed[:, None]).any(axis=1)
    frame[~usable] = inverse[~usable] = np.eye(2)
    moved = substituted(nets, inverse)
    # on T, at whose corners s and t are largest
    s = np.array(SIZES)[size]
    at = np.stack([[1 + 2 * s, -s], [-s, 1 + 2 * s], [-s, -s]]).transpose(2, 1, 0)
    most = np.abs(frame @ at).max(axis=2)
    left = np.abs(moved) * (most[:, :1] ** i * most[:, 1:] ** j)[..., None]
    usable = (left[:, ~kept].sum(axis=1) <= allowed[:, None]).all(axis=1)
    usable &= left[..., 3].sum(axis=1) <= allowed
    moved[..., 3] = 0.0
    total = np.maximum(np.abs(nets).sum(axis=1), 1.0)
    usable &= (np.abs(moved).sum(axis=1) <= _GROWTH * total).all(axis=1)
    return Nets(moved[:, kept].reshape(-1, 4), every, frame), usable
