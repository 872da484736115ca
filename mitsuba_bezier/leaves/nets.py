"""Nets of leaves, each of its own degree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..geometry import bernstein

__all__ = ["Nets"]


class Nets:
    """Monomial nets of four components, one after the other, each with as many rows as it needs.

    Parameters
    ----------
    rows : (R, 4) array
        The coefficients of ``u^a v^b``, net by net, in net order (`bernstein.multi_indices`).
    degree : (L,) int array
        Of each net, at least 1.
    """

    def __init__(self, rows: np.ndarray, degree: np.ndarray) -> None:
        self.rows, self.degree = rows, degree
        #: Number of rows of each net, and where they begin
        self.count = (degree + 1) * (degree + 2) // 2
        self.first = np.cumsum(self.count) - self.count

    @staticmethod
    def of(nets: np.ndarray) -> Nets:
        """Return nets ``(L, K, 4)`` of one degree."""
        degree = np.full(len(nets), bernstein.degree_of(nets.shape[1]))
        return Nets(nets.reshape(-1, 4), degree)

    @staticmethod
    def zeros(count: int) -> Nets:
        """Return nets of degree 1 that are zero."""
        return Nets.of(np.zeros((count, bernstein.size(1), 4)))

    @staticmethod
    def join(parts: Sequence[Nets]) -> Nets:
        """Concatenate."""
        return Nets(
            np.concatenate([p.rows for p in parts]), np.concatenate([p.degree for p in parts])
        )

    def __len__(self) -> int:
        return len(self.degree)

    def __getitem__(self, which: Any) -> Nets:
        """Return the nets chosen by a mask or an index array."""
        which = np.arange(len(self))[which]
        return Nets(self.rows[self._places(which)], self.degree[which])

    def _places(self, which: np.ndarray) -> np.ndarray:
        """Return where the rows of some nets are, net by net."""
        count = self.count[which]
        before = np.cumsum(count) - count
        return np.arange(int(count.sum())) + np.repeat(self.first[which] - before, count)

    @property
    def highest(self) -> int:
        """The highest degree, at least 1."""
        return int(self.degree.max(initial=1))

    def padded(self, degree: int | None = None) -> np.ndarray:
        """Return all as one array ``(L, K, 4)`` of a degree that none exceeds, or the highest.

        ``u^a v^b`` stays ``u^a v^b``; other monomials are zero.
        """
        top = self.highest if degree is None else degree
        out = np.zeros((len(self), bernstein.size(top), 4))
        for n in np.unique(self.degree).tolist():
            of_it = np.flatnonzero(self.degree == n)
            nets = self.rows[self._places(of_it)].reshape(len(of_it), bernstein.size(n), 4)
            powers = bernstein.multi_indices(n)[:, :2].tolist()
            places = np.array([bernstein.row(top, a, b) for a, b in powers])
            out[of_it[:, None], places] = nets
        return out

    def are_weighted(self) -> np.ndarray:
        """Return a mask of nets whose fourth component is not zero, up to rounding of float64."""
        far = np.abs(self.rows[:, 3]) > 1e-12
        return np.logical_or.reduceat(far, self.first) if len(self) else np.zeros(0, dtype=bool)
