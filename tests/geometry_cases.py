"""Random cases and comparisons shared by the tests of projective geometry."""

from __future__ import annotations

import numpy as np


def rotation(rng: np.random.Generator, n: int) -> np.ndarray:
    """A random orthogonal matrix, the same on every machine.

    Rows of integers, made orthogonal by elementary operations: LAPACK would round them in as many
    ways as there are kernels, and in a seeded test each were another case.
    """
    rows: list[np.ndarray] = []
    while len(rows) < n:
        v = rng.integers(-9, 10, n).astype(float)
        for _ in range(2):  # again, for what rounding left
            for r in rows:
                v = v - sum(v * r) * r
        length = sum(v * v) ** 0.5
        if length > 1:  # or nearly dependent of the rows before
            rows.append(v / length)
    return np.array(rows)


def collineation(rng: np.random.Generator, n: int) -> np.ndarray:
    """A random regular matrix of condition at most 4, so that it costs less than one digit."""
    return rotation(rng, n) @ np.diag(rng.uniform(0.5, 2.0, n)) @ rotation(rng, n)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest distance of homogeneous vectors scaled to unit length, up to sign."""
    a = np.asarray(a) / np.linalg.norm(a, axis=-1, keepdims=True)
    b = np.asarray(b) / np.linalg.norm(b, axis=-1, keepdims=True)
    sign = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return float(np.abs(a - sign * b).max())
