"""Isolate sign changes of polynomials in Bernstein form by subdivision."""

from __future__ import annotations

from math import comb

import numpy as np

__all__ = ["bernstein_product", "evaluate", "sign_changes", "split"]

#: Halvings after which an interval with a sign change counts as the root: 2^-52 of [0, 1].
_DEPTH = 52


def split(coefficients: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients ``(n+1, ...)`` over [0, t] and over [t, 1] (de Casteljau)."""
    level = np.asarray(coefficients, dtype=np.float64)
    left, right = [level[0]], [level[-1]]
    while len(level) > 1:
        level = (1 - t) * level[:-1] + t * level[1:]
        left.append(level[0])
        right.append(level[-1])
    return np.array(left), np.array(right[::-1])


def evaluate(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return values ``(N, d)`` of ``(n+1, d)`` coefficients at ``(N,)`` parameters."""
    n = len(coefficients) - 1
    t = np.asarray(t, dtype=np.float64)
    basis = np.stack([comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)], axis=-1)
    return basis @ coefficients


def bernstein_product(f: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Return the coefficients of a product, ``(n+m+1,)`` from ``(n+1,)`` and ``(m+1,)``."""
    n, m = len(f) - 1, len(g) - 1
    scaled_f = f * [comb(n, i) for i in range(n + 1)]
    scaled_g = g * [comb(m, i) for i in range(m + 1)]
    return np.convolve(scaled_f, scaled_g) / [comb(n + m, i) for i in range(n + m + 1)]


def sign_changes(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where polynomials change their sign in [0, 1]; zero counts as positive.

    A polynomial has at most as many roots in the interval as its Bernstein coefficients have
    changes of sign, and as many up to an even number. So an interval without a change has no
    root, one with a single change has one, and others are cut in two.

    Parameters
    ----------
    coefficients : (N, n+1) array
        Bernstein coefficients of N polynomials.

    Returns
    -------
    index : (M,) int array
        Which polynomial each change belongs to.
    t : (M,) array
        Where it is, to 2^-52.
    """
    coefficients = np.atleast_2d(np.asarray(coefficients, dtype=np.float64))
    n = coefficients.shape[1] - 1
    index = np.arange(len(coefficients))
    low, width = np.zeros(len(index)), 1.0
    found_index, found_t = [], []
    for depth in range(_DEPTH + 1):
        negative = coefficients < 0
        variations = (negative[:, 1:] != negative[:, :-1]).sum(axis=1)
        crosses = negative[:, 0] != negative[:, -1]
        # a single change needs no more care, only accuracy, which the halvings give as well
        last = crosses & (depth == _DEPTH)
        if last.any():
            found_index.append(index[last])
            found_t.append(low[last] + width / 2)
        go_on = (variations > 0) & (depth < _DEPTH)
        # below rounding, pairs of roots cannot be told from none: they change no sign
        go_on &= crosses | (depth < 30)
        if not go_on.any():
            break
        level = coefficients[go_on]
        index, low = index[go_on], low[go_on]
        left, right = [level[:, 0]], [level[:, -1]]
        for _ in range(n):
            level = (level[:, :-1] + level[:, 1:]) / 2
            left.append(level[:, 0])
            right.append(level[:, -1])
        width /= 2
        coefficients = np.concatenate([np.stack(left, axis=1), np.stack(right[::-1], axis=1)])
        low = np.concatenate([low, low + width])
        index = np.concatenate([index, index])
    if not found_index:
        return np.zeros(0, dtype=int), np.zeros(0)
    return np.concatenate(found_index), np.concatenate(found_t)
