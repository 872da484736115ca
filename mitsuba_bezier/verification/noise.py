"""What noise alone does to two pictures of one scene, and whether a picture shows anything.

A limit below what noise gives fails for ever; a picture without contrast, or a limit above the
contrast, passes for ever. Both are told beside the verdict.
"""

from __future__ import annotations

import numpy as np

from . import flip
from .metrics import RELATIVE_EPSILON

__all__ = ["blank", "expected_values", "shows_nothing"]


def expected_values(
    reference: np.ndarray, variance: np.ndarray, flip_encoding: str | None = None
) -> dict[str, float]:
    """Return what each measure gives for two renders that differ by noise alone.

    Parameters
    ----------
    reference : (H, W, C) array
        The picture.
    variance : (H, W, C) array
        That of the difference of the two renders.
    flip_encoding : str, optional
        Also find the FLIP error, of one draw of normal noise, for images of this encoding.

    Returns
    -------
    dict
        By name of the check. "max" is the median of the largest difference of normal noise.
    """
    good = np.isfinite(reference) & np.isfinite(variance)
    if not good.any():
        return {}
    v, a = variance[good], reference[good]
    found = {
        "RMSE": float(np.sqrt(v.mean())),
        "relative MSE": float((v / (a**2 + RELATIVE_EPSILON)).mean()),
        "max": _median_of_largest(np.sqrt(v)),
    }
    if flip_encoding is not None and flip.available():
        # a fixed seed: the mean over all pixels of a picture hardly depends on it
        draw = np.random.default_rng(0).standard_normal(reference.shape)
        noisy = np.where(good, reference + draw * np.sqrt(np.where(good, variance, 0)), reference)
        found["FLIP"] = float(flip.flip_map(reference, noisy, flip_encoding).mean())
    return found


def _median_of_largest(deviations: np.ndarray) -> float:
    """Return the median of the largest ``|N(0, s)|`` over independent pixels, by bisection."""
    low, high = 0.0, 10 * float(deviations.max())
    if high == 0:
        return 0.0
    # pixels with the same deviation to a thousandth count together: a histogram is enough
    counts, edges = np.histogram(deviations[deviations > 0], 1000, (0, high / 10))
    middle = (edges[1:] + edges[:-1])[counts > 0] / 2
    counts = counts[counts > 0]
    for _ in range(40):
        m = (low + high) / 2
        tail = np.clip(_two_sided(m / middle), 0, 1 - 1e-15)
        if np.sum(counts * np.log1p(-tail)) < -np.log(2):
            low = m
        else:
            high = m
    return high


def _two_sided(z: np.ndarray) -> np.ndarray:
    """Return P(|N(0, 1)| > z), to 1e-7 (Abramowitz and Stegun 7.1.26)."""
    x = z / np.sqrt(2)
    t = 1 / (1 + 0.3275911 * x)
    series = 0.254829592 + t * (
        -0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))
    )
    return t * series * np.exp(-x * x)


def blank(reference: np.ndarray) -> np.ndarray:
    """Return a picture of the same size whose every pixel is the mean of the finite ones."""
    finite = np.isfinite(reference)
    count = np.maximum(finite.sum(axis=(0, 1)), 1)
    with np.errstate(over="ignore"):
        mean = np.where(finite, reference, 0).sum(axis=(0, 1)) / count
    return np.broadcast_to(mean, reference.shape).astype(np.float64)


def shows_nothing(reference: np.ndarray, variance: np.ndarray | None) -> bool:
    """Tell whether a picture has one value all over, or no contrast beyond its own noise.

    Parameters
    ----------
    reference : (H, W, C) array
        The picture.
    variance : (H, W, C) array, optional
        Of its pixels, as an estimate.
    """
    finite = np.isfinite(reference)
    if not finite.any():
        return True
    spread = np.where(finite, reference - blank(reference), 0.0)
    if variance is None or not np.isfinite(variance).all():
        # a thousandth of a step of float32: means of equal numbers may round
        return bool(np.abs(spread).max() <= 1e-10 * np.abs(reference[finite]).max())
    scale = np.abs(reference[finite]).max()
    if np.abs(spread).max() <= 1e-6 * scale:  # one rounding of float32
        return True
    # pure noise gives 1; the estimate of the variance, from some 30 passes, is not off by a half
    return float((spread**2).sum()) <= 1.5 * float(np.maximum(variance, 0).sum())
