"""Adam on scaled unknowns, with the Laplacian of the net as preconditioner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu

__all__ = ["Adam", "Moments", "Smoother"]


class Smoother:
    """Turns a gradient into one that moves neighbours together: ``(I + s L)^-2 g``.

    This is descent in ``u = (I + s L) x`` (Nicolet, Jacobson and Jakob, *Large steps in inverse
    rendering of geometry*, 2021). The matrix is factored once.
    """

    def __init__(self, laplacian: Any, strength: float) -> None:
        size = laplacian.shape[0]
        self._factor = splu((identity(size, format="csc") + strength * laplacian).tocsc())

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return ``(I + s L)^-1 values`` for values ``(N, C)``."""
        out: np.ndarray = self._factor.solve(np.ascontiguousarray(values))
        return out


@dataclass(frozen=True)
class Moments:
    """What Adam remembers: means of gradients and of their squares, and of how many steps."""

    first: np.ndarray
    second: np.ndarray
    count: int = 0

    @staticmethod
    def zero(size: int) -> Moments:
        """Return those before the first step."""
        return Moments(np.zeros(size), np.zeros(size))


class Adam:
    """Kingma and Ba, *Adam: a method for stochastic optimization*, 2015.

    Entries of one block share their second moment where the block is smoothed, so that steps stay
    smooth (*AdamUniform* of Nicolet et al.).

    Parameters
    ----------
    blocks : list of (slice, Smoother or None, shape)
        The arrays that the unknowns are.
    """

    BETAS = (0.9, 0.999)

    def __init__(self, blocks: list[tuple[slice, Smoother | None, tuple[int, ...]]]) -> None:
        self.blocks = blocks

    def step(
        self, moments: Moments, gradient: np.ndarray, rate: float
    ) -> tuple[np.ndarray, Moments]:
        """Return the change of the unknowns, and the moments after it."""
        b1, b2 = self.BETAS
        count = moments.count + 1
        first, second = moments.first.copy(), moments.second.copy()
        out = np.empty_like(gradient)
        for part, smoother, shape in self.blocks:
            g = gradient[part]
            if smoother is not None:
                g = smoother(g.reshape(shape)).ravel()
            first[part] = b1 * first[part] + (1 - b1) * g
            second[part] = b2 * second[part] + (1 - b2) * g * g
            mean = first[part] / (1 - b1**count)
            square = second[part] / (1 - b2**count)
            if smoother is not None:
                square = square.max()
            change = -rate * mean / (np.sqrt(square) + 1e-30)
            out[part] = change if smoother is None else smoother(change.reshape(shape)).ravel()
        return out, Moments(first, second, count)
