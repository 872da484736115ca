"""Random cases and comparisons shared by the tests of projective geometry."""

from __future__ import annotations

import numpy as np


def rotation(rng: np.random.Generator, n: int) -> np.ndarray:
    q, _r = np.linalg.qr(rng.normal(size=(n, n)))
    return q


def collineation(rng: np.random.Generator, n: int) -> np.ndarray:
    """A random regular matrix of condition at most 4, so that it costs less than one digit."""
    return rotation(rng, n) @ np.diag(rng.uniform(0.5, 2.0, n)) @ rotation(rng, n)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest distance of homogeneous vectors scaled to unit length, up to sign."""
    a = np.asarray(a) / np.linalg.norm(a, axis=-1, keepdims=True)
    b = np.asarray(b) / np.linalg.norm(b, axis=-1, keepdims=True)
    sign = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -1.0, 1.0)
    return float(np.abs(a - sign * b).max())
