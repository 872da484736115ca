"""Nets of leaves, each of the powers that it needs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ..geometry import bernstein

__all__ = ["Nets", "Powers", "counts_of", "substituted"]

#: Nets whose variables are changed at a time: bounds the memory.
_CHUNK = 1024


class Powers(NamedTuple):
    """Which powers ``s^a t^b`` a polynomial has: ``a <= p``, ``b <= q`` and ``a + b <= n``."""

    p: int
    q: int
    n: int

    @staticmethod
    def whole(n: int) -> Powers:
        """Return those of a polynomial of degree `n`."""
        return Powers(n, n, n)

    def top(self, a: int) -> int:
        """Return the highest power of `t` beside ``s^a``."""
        return min(self.q, self.n - a)

    @property
    def size(self) -> int:
        """How many there are."""
        return len(_indices(*self))

    @property
    def indices(self) -> np.ndarray:
        """All pairs ``(a, b)``, as `bernstein.multi_indices`: `a` falling, then `b` falling."""
        return _indices(*self)


@cache
def _indices(p: int, q: int, n: int) -> np.ndarray:
    out = [(a, b) for a in range(min(p, n), -1, -1) for b in range(min(q, n - a), -1, -1)]
    return np.array(out)


class Nets:
    """Monomial nets of four components, one after the other, each with as many rows as it needs.

    Parameters
    ----------
    rows : (R, 4) array
        The coefficients of ``s^a t^b``, net by net, in the order of `Powers.indices`.
    powers : (L, 3) int array
        `Powers` of each net, at least 1.
    frame : (L, 2, 2) array, optional
        The matrices that take the parameters ``(u, v)`` of the leaves to ``(s, t)``; the identity
        if not given.
    """

    def __init__(
        self, rows: np.ndarray, powers: np.ndarray, frame: np.ndarray | None = None
    ) -> None:
        self.rows, self.powers = rows, powers
        self.frame = np.broadcast_to(np.eye(2), (len(powers), 2, 2)) if frame is None else frame
        #: Number of rows of each net, and where they begin
        self.count = counts_of(powers)
        self.first = np.cumsum(self.count) - self.count

    @staticmethod
    def of(nets: np.ndarray) -> Nets:
        """Return nets ``(L, K, 4)`` of one degree."""
        powers = np.full((len(nets), 3), bernstein.degree_of(nets.shape[1]))
        return Nets(nets.reshape(-1, 4), powers)

    @staticmethod
    def zeros(count: int) -> Nets:
        """Return nets of degree 1 that are zero."""
        return Nets.of(np.zeros((count, bernstein.size(1), 4)))

    @staticmethod
    def join(parts: Sequence[Nets]) -> Nets:
        """Concatenate."""
        rows, powers, frame = zip(*((p.rows, p.powers, p.frame) for p in parts))
        return Nets(np.concatenate(rows), np.concatenate(powers), np.concatenate(frame))

    def __len__(self) -> int:
        return len(self.powers)

    def __getitem__(self, which: Any) -> Nets:
        """Return the nets chosen by a mask or an index array."""
        which = np.arange(len(self))[which]
        return Nets(self.rows[self._places(which)], self.powers[which], self.frame[which])

    def _places(self, which: np.ndarray) -> np.ndarray:
        """Return where the rows of some nets are, net by net."""
        count = self.count[which]
        before = np.cumsum(count) - count
        return np.arange(int(count.sum())) + np.repeat(self.first[which] - before, count)

    @property
    def degree(self) -> np.ndarray:
        """The degree ``(L,)`` of each."""
        return self.powers[:, 2]

    @property
    def highest(self) -> int:
        """The highest degree, at least 1."""
        return int(self.degree.max(initial=1))

    @property
    def is_framed(self) -> np.ndarray:
        """A mask ``(L,)`` of nets whose variables are not the parameters themselves."""
        return (self.frame != np.eye(2)).any(axis=(1, 2))

    def stored(self, powers: Powers) -> np.ndarray:
        """Return all as one array ``(L, size, 4)`` of powers that none exceeds.

        ``s^a t^b`` stays ``s^a t^b``; other monomials are zero.
        """
        out = np.zeros((len(self), powers.size, 4))
        place = np.full((powers.p + 1, powers.q + 1), -1)
        place[tuple(powers.indices.T)] = np.arange(powers.size)
        for own in np.unique(self.powers, axis=0):
            those = np.flatnonzero((self.powers == own).all(axis=1))
            indices = Powers(*own.tolist()).indices
            nets = self.rows[self._places(those)].reshape(len(those), -1, 4)
            out[those[:, None], place[tuple(indices.T)]] = nets
        return out

    def padded(self, degree: int | None = None) -> np.ndarray:
        """Return all as nets ``(L, K, 4)`` in ``(u, v)`` of a degree that none exceeds.

        That is the highest, if not given. ``u^a v^b`` stays ``u^a v^b``; other monomials are zero.
        """
        out = self.stored(Powers.whole(self.highest if degree is None else degree))
        framed = np.flatnonzero(self.is_framed)
        out[framed] = substituted(out[framed], self.frame[framed])
        return out

    def are_weighted(self) -> np.ndarray:
        """Return a mask of nets whose fourth component is not zero, up to rounding of float64."""
        far = np.abs(self.rows[:, 3]) > 1e-12
        return np.logical_or.reduceat(far, self.first) if len(self) else np.zeros(0, dtype=bool)


def counts_of(powers: np.ndarray) -> np.ndarray:
    """Return `Powers.size` of each."""
    p, q, n = powers.T
    # the product less what is above a + b = n: a triangle, as neither p nor q exceeds n
    cut = p + q - n
    return (p + 1) * (q + 1) - cut * (cut + 1) // 2


def substituted(nets: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return the monomial nets ``(L, K, 4)`` in ``(u, v)`` of others in ``(s, t)``.

    Parameters
    ----------
    nets : (L, K, 4) array
    matrices : (L, 2, 2) array
        ``(s, t) = matrix (u, v)``.
    """
    n = bernstein.degree_of(nets.shape[1])
    out = np.empty_like(nets)
    for first in range(0, len(nets), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        (a, b), (c, d) = matrices[chunk].transpose(1, 2, 0)
        # s^k t^(m-k) in powers u^i v^(m-i), at [i, k], and by leaves
        forms = np.ones((1, 1, len(a)))
        for m in range(n + 1):
            if m:
                lower, forms = forms, np.zeros((m + 1, m + 1, len(a)))
                forms[1:, 1:] = a * lower
                forms[:-1, 1:] += b * lower
                forms[1:, 0] = c * lower[:, 0]
                forms[:-1, 0] += d * lower[:, 0]
            rows = [bernstein.row(n, k, m - k) for k in range(m + 1)]
            out[chunk, rows] = np.einsum("ikl,lkc->lic", forms, nets[chunk][:, rows])
    return out
