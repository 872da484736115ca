"""Per-pixel Z-test of two renders with known variance, as Mitsuba's own render tests do it.

Two renders of one scene differ by noise alone if, for nearly all pixels, their difference is
within the noise. With the variance v of one sample and n samples a pixel in each image,

    z = (b - a) / sqrt(v_a / n_a + v_b / n_b),

with v at least 1e-4. A pixel passes if its two-sided p-value lies above
``1 - (1 - alpha)^(1/pixels)``, alpha = 0.01 (Šidák); the images agree if 99.75 % of the pixels
do, averaged over channels (Mitsuba 3, ``src/render/tests/test_renders.py``, which takes the
reference as exact and its variance for the test image).

Where the variance is found, for a channel ``R``:

* ``variance.R``: variance of one sample (not of the mean), an unbiased estimate;
* Mitsuba's ``moment`` integrator: ``<name>.X`` and ``m2_<name>.X``, mean and second moment in
  XYZ; the test is then done in XYZ.

The number of samples is the header attribute ``spp``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..errors import FileFormatError
from .images import Image, group_layers

__all__ = [
    "PASSING_SHARE",
    "SIGNIFICANCE",
    "VARIANCE_FLOOR",
    "ZTest",
    "comparable_layers",
    "critical_z",
    "noise_variance",
    "samples_per_pixel",
    "z_scores",
    "z_test",
]

VARIANCE_FLOOR = 1e-4
SIGNIFICANCE = 0.01
PASSING_SHARE = 0.9975

_STATISTIC = re.compile(r"(variance|sum\d+)\.|m2_")
# linear sRGB (Rec. 709, D65) to XYZ
_TO_XYZ = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
)


@dataclass(frozen=True)
class ZTest:
    """Outcome of the test on one layer.

    Attributes
    ----------
    z : (H, W, C) array
        Signed scores; NaN where a pixel is not finite.
    share : float
        Pixels that pass, averaged over channels, 0..1.
    critical : float
        The score that no single pixel may exceed.
    note : str
        Whose variance and how many samples were used.
    """

    z: np.ndarray
    share: float
    critical: float
    note: str


def _moments(image: Image) -> list[str]:
    """Return the names of the layers that have a second moment beside them."""
    return sorted({n[3:].rpartition(".")[0] for n in image.channels if n.startswith("m2_")})


def comparable_layers(image: Image) -> dict[str, list[str]]:
    """Return the channels to be compared, by layer: all but statistics of others."""
    moments = tuple(f"{name}." for name in _moments(image))
    return group_layers(
        name
        for name in image.channels
        if not _STATISTIC.match(name) and not (moments and name.startswith(moments))
    )


def samples_per_pixel(image: Image, stated: int | None = None) -> float | None:
    """Return the header's ``spp``, else `stated`.

    Raises
    ------
    FileFormatError
        If the attribute is no positive number.
    """
    value = image.attributes.get("spp", stated)
    if value is None:
        return None
    try:
        spp = float(value)
    except (TypeError, ValueError):
        spp = -1.0
    if not 0 < spp < np.inf:
        raise FileFormatError.expected(
            f"{image.path}: spp", "a positive number of samples", f"{value!r}"
        )
    return spp


def critical_z(pixels: int, significance: float = SIGNIFICANCE) -> float:
    """Return the two-sided critical score of one pixel, Šidák-corrected for `pixels` tests."""
    alpha = -np.expm1(np.log1p(-significance) / pixels)
    return -NormalDist().inv_cdf(alpha / 2)


def z_scores(
    reference: np.ndarray,
    test: np.ndarray,
    reference_error: np.ndarray | float,
    test_error: np.ndarray | float,
) -> np.ndarray:
    """Return ``(test - reference) / sqrt(reference_error + test_error)``.

    The errors are variances of the means: per-sample variance over number of samples.
    """
    return (test - reference) / np.sqrt(reference_error + test_error)


def noise_variance(
    reference: Image, test: Image, names: list[str], spp: int | None = None
) -> np.ndarray | None:
    """Return the variance ``(H, W, C)`` that noise gives the difference of two images.

    None where it is not known: no variance channels, or no number of samples.
    """
    if not any(_space(image, names) == "own" for image in (reference, test)):
        return None
    counts = samples_per_pixel(reference), samples_per_pixel(test, spp)
    if counts == (None, None):
        return None
    own = [
        image.stack(f"variance.{name}" for name in names) if _space(image, names) == "own" else None
        for image in (reference, test)
    ]
    shared = next(v for v in own if v is not None)
    total = np.zeros_like(shared)
    for count, variance in zip(counts, own):
        if count is not None:
            total += np.maximum(shared if variance is None else variance, 0) / count
    return total


def _variance(image: Image, names: list[str], space: str) -> np.ndarray | None:
    """Return the per-sample variance of the channels, floored, or None if it is not there."""
    if space == "XYZ":
        (moment,) = _moments(image)
        mean = image.stack(f"{moment}.{c}" for c in "XYZ")
        variance = image.stack(f"m2_{moment}.{c}" for c in "XYZ") - mean**2
    elif all(f"variance.{name}" in image.channels for name in names):
        variance = image.stack(f"variance.{name}" for name in names)
    else:
        return None
    return np.maximum(variance, VARIANCE_FLOOR)


def _space(image: Image, names: list[str]) -> str | None:
    """Return in which colours the variance of these channels is known: own, XYZ, or None."""
    if all(f"variance.{name}" in image.channels for name in names):
        return "own"
    if names == ["R", "G", "B"] and len(_moments(image)) == 1:
        (moment,) = _moments(image)
        if all(f"{p}{moment}.{c}" in image.channels for p in ("", "m2_") for c in "XYZ"):
            return "XYZ"
    return None


def z_test(reference: Image, test: Image, names: list[str], spp: int | None = None) -> ZTest | str:
    """Test the channels `names` of two images.

    Both need not carry a variance: that of one stands for both. A side of unknown sample
    count is taken as exact, as long as the other's is known.

    Parameters
    ----------
    reference, test : Image
        Of one size, with the channels `names`.
    names : list of str
        Channels of one layer.
    spp : int, optional
        Samples of the test image, used if its header tells none.

    Returns
    -------
    ZTest or str
        The outcome, or why there is none.
    """
    space = _space(reference, names) or _space(test, names)
    if space is None:
        return "no variance channels"
    counts = samples_per_pixel(reference), samples_per_pixel(test, spp)
    if counts == (None, None):
        return "no number of samples (header attribute spp)"
    variances = [
        _variance(image, names, space) if _space(image, names) == space else None
        for image in (reference, test)
    ]
    shared = next(v for v in variances if v is not None)
    errors = [
        0.0 if count is None else (shared if variance is None else variance) / count
        for variance, count in zip(variances, counts)
    ]
    a, b = reference.stack(names), test.stack(names)
    if space == "XYZ":
        a, b = a @ _TO_XYZ.T, b @ _TO_XYZ.T
    with np.errstate(invalid="ignore", over="ignore"):
        z = z_scores(a, b, errors[0], errors[1])
    pixels = z.shape[0] * z.shape[1]
    critical = critical_z(pixels)
    share = float(np.count_nonzero(np.abs(z) < critical) / z.size)
    whose = " and ".join(who for who, v in zip(("reference", "test"), variances) if v is not None)
    used = ["exact" if count is None else f"{count:g} spp" for count in counts]
    note = f"variance of {whose}{' in XYZ' if space == 'XYZ' else ''}; {used[0]} against {used[1]}"
    return ZTest(z, share, critical, note)
