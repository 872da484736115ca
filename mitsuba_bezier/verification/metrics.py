"""Numbers that say how far two images are apart, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["RELATIVE_EPSILON", "Metrics", "measure"]

RELATIVE_EPSILON = 1e-2


@dataclass(frozen=True)
class Metrics:
    """Distances of one layer of two images.

    Attributes
    ----------
    rmse : float
        Root of the mean squared difference over pixels and channels.
    relative_mse : float
        Mean of ``(b - a)^2 / (a^2 + 0.01)`` (Rousselle et al. 2011): errors in dark places
        count as much as those in bright ones.
    max_abs : float
        Largest absolute difference.
    max_at : (int, int, int)
        Its column, row and channel.
    mean_difference : float
        Mean of b - a: noise averages out, a bias does not.
    nan_reference, nan_test : int
        Pixels with a NaN.
    infinite : int
        Pixels that are infinite in one image and not the same infinity in the other.
    difference : (H, W, C) array
        b - a; 0 where both are the same infinity, NaN where a pixel is not finite.
    """

    rmse: float
    relative_mse: float
    max_abs: float
    max_at: tuple[int, int, int]
    mean_difference: float
    nan_reference: int
    nan_test: int
    infinite: int
    difference: np.ndarray

    @property
    def not_finite(self) -> int:
        """Number of pixels that could not be compared; the numbers leave them out."""
        return int(np.count_nonzero(np.isnan(self.difference).any(axis=-1)))


def measure(reference: np.ndarray, test: np.ndarray) -> Metrics:
    """Compare two layers ``(H, W, C)`` of one shape.

    Pixels that are not finite are counted and left out of the numbers; if none is left, the
    numbers are NaN.
    """
    a = np.asarray(reference, dtype=np.float64)
    b = np.asarray(test, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        difference = np.where(a == b, 0.0, b - a)  # equal infinities are no difference
    nan_a, nan_b = np.isnan(a), np.isnan(b)
    infinite = np.isinf(difference) | (np.isnan(difference) & ~nan_a & ~nan_b)
    difference[infinite] = np.nan
    bad = np.isnan(difference).any(axis=-1)
    good = difference[~bad]
    if good.size:
        square = good**2
        # an infinity equal in both has difference 0, whatever the denominator
        base = np.where(np.isfinite(a[~bad]), a[~bad], 0.0)
        absolute = np.abs(difference)
        absolute[bad] = -1.0
        row, column, channel = np.unravel_index(int(np.argmax(absolute)), absolute.shape)
        rmse = float(np.sqrt(square.mean()))
        relative = float((square / (base**2 + RELATIVE_EPSILON)).mean())
        max_abs, mean = float(absolute.max()), float(good.mean())
        max_at = (int(column), int(row), int(channel))
    else:
        rmse = relative = max_abs = mean = float("nan")
        max_at = (0, 0, 0)
    return Metrics(
        rmse,
        relative,
        max_abs,
        max_at,
        mean,
        int(np.count_nonzero(nan_a.any(axis=-1))),
        int(np.count_nonzero(nan_b.any(axis=-1))),
        int(np.count_nonzero(infinite.any(axis=-1))),
        difference,
    )
