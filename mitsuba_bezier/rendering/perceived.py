"""How far from the perfect picture a picture will look, by what is known of its noise."""

from __future__ import annotations

import numpy as np

from ..verification.flip import flip_map
from ..verification.merge import DARK, Accumulator, luminance

__all__ = ["expected_flip"]


def expected_flip(total: Accumulator, share: float) -> float | None:
    """Return the FLIP error that a share of the pixels is expected not to exceed, if it is known.

    It is that between the picture and itself with as much noise again: a draw of normal noise, with
    the standard error of each pixel, of luminance, so of one sign for all colours. Noise of colours
    alone is not seen.

    Parameters
    ----------
    total : Accumulator
        The passes, with `squares`.
    share : float
        Of the pixels, such as 0.95.

    Raises
    ------
    RuntimeSetupError
        If ``flip-evaluator`` is not installed.
    """
    errors = total.relative_errors()
    if errors is None:
        return None
    mean = total.mean()
    light = luminance(mean)
    known = np.isfinite(errors)
    if light is None or not known.any():
        return None
    names = "RGB" if "R" in mean else "YYY"
    colour = np.stack([mean[name] for name in names], axis=-1).astype(np.float64)
    size = np.abs(light)
    floor = DARK * float(size[known].mean())
    # errors are relative to what is no darker than that, see `Accumulator.noise`
    factor = np.where(size > 0, np.maximum(size, floor) / np.where(size > 0, size, 1.0), 1.0)
    # a fixed seed: shares of all pixels of a picture hardly depend on it
    draw = np.random.default_rng(0).standard_normal(size.shape)
    noisy = colour * (1.0 + draw * np.where(known, errors, 0.0) * factor)[..., None]
    return float(np.quantile(flip_map(colour, noisy, "linear")[known], share))
