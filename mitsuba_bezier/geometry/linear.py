"""Invert many matrices at once, some of which may be singular.

One exactly singular matrix makes ``np.linalg.inv`` raise for all of them, and whether a pivot is
exactly zero is a matter of rounding: it differs from one BLAS kernel to the next. So the matrices
that are singular, or not to be told from such, are found first, by a bound that rounding cannot
cross, and the others alone are inverted.
"""

from __future__ import annotations

import numpy as np

__all__ = ["SINGULAR", "hadamard_ratio", "inverses"]

#: Matrices whose `hadamard_ratio` is not above this count as singular. With unit columns the
#: condition of 4 x 4 matrices is at most some 16 over it, so that rounding (1e-16) leaves three
#: digits of the others, and none of their pivots can be zero.
SINGULAR = 1e-12


def hadamard_ratio(matrices: np.ndarray) -> np.ndarray:
    """Return ``|det|`` over the product of the columns' lengths, from 0 to 1.

    One for orthogonal columns, whatever their lengths are; zero for dependent ones, and for
    matrices with numbers that are not finite.

    Parameters
    ----------
    matrices : (P, n, n) array
    """
    with np.errstate(all="ignore"):
        # by the largest number first: squares could overflow
        unit = matrices / np.abs(matrices).max(axis=1, keepdims=True)
        unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    finite = np.isfinite(unit).all(axis=(1, 2))
    return np.abs(np.linalg.det(np.where(finite[:, None, None], unit, 0.0)))


def inverses(matrices: np.ndarray, like: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverses ``(P, n, n)`` of regular matrices, and which are; else the identity.

    Parameters
    ----------
    matrices : (P, n, n) array
    like : (P, n, n) array, optional
        The same with rows in units that suit their sizes, where those of `matrices` do not: these
        tell whether they are regular.
    """
    regular = hadamard_ratio(matrices if like is None else like) > SINGULAR
    safe = np.where(regular[:, None, None], matrices, np.eye(matrices.shape[-1]))
    return np.linalg.inv(safe), regular
