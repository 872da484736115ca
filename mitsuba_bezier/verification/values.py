"""The numbers of a pair of images for the page of a report, which shows them under the cursor.

Half precision, reference and *difference*: so small differences of large values keep three digits,
and equal images cost next to nothing.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

__all__ = ["Values", "pack"]


@dataclass(frozen=True)
class Values:
    """Packed numbers of one layer.

    Attributes
    ----------
    data : bytes
        Deflated (zlib): for the reference, then the difference, for each channel, the high bytes of
        all half floats, row by row, then the low ones. Sorted so they pack better.
    channels : list of str
    scales : (float, float)
        What the halves of reference and difference are to be multiplied by.
    shown : (str, float, float)
        How pictures are made of them: ``"srgb"`` (linear values and an exposure in stops, 0),
        ``"display"`` or ``"linear"`` with black and white.
    """

    data: bytes
    channels: list[str]
    scales: tuple[float, float]
    shown: tuple[str, float, float]


def pack(
    reference: np.ndarray,
    difference: np.ndarray,
    channels: list[str],
    shown: tuple[str, float, float],
) -> Values:
    """Pack ``(H, W, C)`` arrays."""
    parts, scales = [], []
    for values in (reference, difference):
        finite = np.abs(values[np.isfinite(values)])
        top = float(finite.max()) if finite.size else 0.0
        # so that the largest is 1024, and what is 1e-10 of it no longer zero
        scale = 2.0 ** np.ceil(np.log2(top) - 10) if top > 0 else 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            half = (values / scale).astype(np.float16)
        for k in range(half.shape[-1]):
            planes = np.ascontiguousarray(half[..., k].ravel()).view(np.uint8).reshape(-1, 2)
            parts += [planes[:, 1].tobytes(), planes[:, 0].tobytes()]
        scales.append(float(scale))
    data = zlib.compress(b"".join(parts), 6)
    return Values(data, channels, (scales[0], scales[1]), shown)
