"""The perceptual difference ꟻLIP, through NVIDIA's `flip-evaluator` wheel (extra ``compare``).

P. Andersson et al., "FLIP: A Difference Evaluator for Alternating Images" (HPG 2020) and, for
HDR, "Visualizing Errors in Rendered High Dynamic Range Images" (Eurographics 2021). HDR images
are judged at a range of exposures, from the one that lifts the median luminance of the reference
to near white to the one that brings its maximum there.
"""

from __future__ import annotations

import numpy as np

from ..errors import RuntimeSetupError

__all__ = ["available", "exposure_range", "flip_map"]

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# The ACES curve (a x^2 + b x) / (c x^2 + d x + e) used by HDR-FLIP reaches 0.85 at this x.
_ACES = 0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14
_MAX_STOPS = 16.0


def available() -> bool:
    """Return whether the `flip-evaluator` wheel can be imported."""
    try:
        import flip_evaluator  # noqa: F401
    except ImportError:
        return False
    return True


def _near_white() -> float:
    a, b, c, d, e = _ACES
    return float(max(np.roots([a - 0.85 * c, b - 0.85 * d, -0.85 * e]).real))


def exposure_range(reference: np.ndarray) -> tuple[float, float]:
    """Return the least and largest exposure in stops at which HDR images are compared.

    As HDR-FLIP chooses them, but the median is taken over the pixels that are not black, at
    most 16 stops below the maximum: the wheel's own rule takes all pixels, so that a small
    object before a black background is judged at 2^24 times its brightness, and it ends the
    process for an all-black reference.
    """
    luminance = reference @ _LUMINANCE
    lit = luminance[luminance > 0]
    top = np.log2(lit.max()) if lit.size else 0.0
    middle = max(np.log2(np.median(lit)), top - _MAX_STOPS) if lit.size else 0.0
    white = np.log2(_near_white())
    return float(white - top), float(white - middle)


def flip_map(reference: np.ndarray, test: np.ndarray, encoding: str) -> np.ndarray:
    """Return the per-pixel FLIP error ``(H, W)``, 0 (alike) to 1, at 67 pixels a degree.

    Parameters
    ----------
    reference, test : (H, W, 3) array
        RGB; negative values count as black, what is not finite as black in both images.
    encoding : str
        ``"srgb"`` for display values in 0..1, ``"linear"`` for HDR.

    Raises
    ------
    RuntimeSetupError
        If the wheel is not installed.
    """
    try:
        import flip_evaluator
    except ImportError:
        raise RuntimeSetupError.expected(
            "flip",
            "the package flip-evaluator",
            "none; install it with: pip install 'mitsuba-bezier[compare]'",
        ) from None
    bad = ~(np.isfinite(reference) & np.isfinite(test)).all(axis=-1, keepdims=True)
    top = np.finfo(np.float32).max if encoding == "linear" else 1.0
    a, b = (
        np.ascontiguousarray(np.clip(np.where(bad, 0, image), 0, top), dtype=np.float32)
        for image in (reference, test)
    )
    if encoding == "srgb":
        result = flip_evaluator.evaluate(a, b, "LDR", applyMagma=False)
    else:
        start, stop = exposure_range(a.astype(np.float64))
        parameters = {
            "startExposure": start,
            "stopExposure": stop,
            "numExposures": max(2, int(np.ceil(stop - start))),
        }
        result = flip_evaluator.evaluate(a, b, "HDR", applyMagma=False, parameters=parameters)
    return np.asarray(result[0], dtype=np.float64)[..., 0]
