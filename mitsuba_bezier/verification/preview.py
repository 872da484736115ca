"""Pictures for the eye: tone mapping, false colours, histograms and thumbnails, as 8-bit arrays."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np

from .. import _runtime
from .images import Image
from .ztest import comparable_layers

__all__ = [
    "COLORMAPS",
    "Histogram",
    "auto_exposure",
    "difference_histogram",
    "false_color",
    "gradient",
    "jpeg",
    "mapping",
    "show",
    "thumbnail",
    "thumbnail_jpeg",
    "to_srgb8",
]

#: Colours at equal steps, interpolated linearly between.
COLORMAPS = {
    # magma by S. van der Walt and N. Smith (CC0): zero is black
    "magma": "#000004 #0a0822 #1d1147 #36106b #51127c #6a1c81 #832681 #9c2e7f #b73779 "
    "#d0416f #e75263 #f56b5c #fc8961 #fea772 #fec488 #fde2a3 #fcfdbf",
    # blue below, orange above; zero is black too
    "diverging": "#d6ecff #7db9f2 #2f7ccb #173f70 #0d0d12 #74300f #cc5f1e #f6a35c #ffe9cf",
}
#: What is no number: in pictures and in false colours. Neither hue occurs in the maps.
_NAN_PICTURE = (255, 0, 255)
_NAN_MAP = (0, 255, 140)


@dataclass(frozen=True)
class Histogram:
    """Counts of the differences of each channel in equal bins over ``-limit .. limit``.

    What lies beyond is counted in the outermost bins.
    """

    limit: float
    channels: list[str]
    counts: list[list[int]]


def _table(colormap: str) -> np.ndarray:
    knots = [[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in COLORMAPS[colormap].split()]
    at = np.linspace(0, 1, len(knots))
    fine = np.linspace(0, 1, 256)
    columns = [np.interp(fine, at, column) for column in np.transpose(knots)]
    return np.round(np.stack(columns, axis=-1)).astype(np.uint8)


def gradient(colormap: str) -> str:
    """Return the colour map as a list of CSS colours, low to high."""
    return ", ".join(COLORMAPS[colormap].split())


def false_color(values: np.ndarray, low: float, high: float, colormap: str) -> np.ndarray:
    """Return ``(H, W, 3)`` uint8 for values ``(H, W)``, clipped to ``low .. high``."""
    scale = 255 / (high - low) if high > low else 0.0
    bad = np.isnan(values)
    index = np.clip(np.rint((np.where(bad, low, values) - low) * scale), 0, 255).astype(np.uint8)
    out = _table(colormap)[index]
    out[bad] = _NAN_MAP
    return out


def auto_exposure(reference: np.ndarray) -> float:
    """Return the exposure in stops that suits an HDR image.

    0 if its 95th percentile of luminance over the pixels that are not black already lies
    between 0.05 and 2; else what brings that percentile near 0.8, in whole stops.
    """
    luminance = reference.mean(axis=-1)
    lit = luminance[np.isfinite(luminance) & (luminance > 0)]
    if not lit.size:
        return 0.0
    bright = float(np.percentile(lit, 95))
    return 0.0 if 0.05 <= bright <= 2 else float(-np.round(np.log2(bright / 0.8)))


def to_srgb8(linear: np.ndarray) -> np.ndarray:
    """Return linear values 0..1 with the sRGB curve (IEC 61966-2-1), in 8 bits."""
    x = np.clip(linear, 0, 1)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)
    return np.rint(curve * 255).astype(np.uint8)


def mapping(
    reference: np.ndarray, encoding: str, is_color: bool, exposure: float | None = None
) -> tuple[str, float, float]:
    """Return how the values of a layer become a picture.

    ``"display"``: as they are; ``"srgb"``: times two to the power of the second, then the sRGB
    curve; ``"linear"``: from black, the second, to white, the third.
    """
    if is_color and encoding == "srgb":
        return "display", 0.0, 1.0
    if is_color:
        return "srgb", auto_exposure(reference) if exposure is None else exposure, 0.0
    finite = reference[np.isfinite(reference)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return "linear", low, high


def show(
    reference: np.ndarray,
    test: np.ndarray,
    encoding: str,
    is_color: bool,
    exposure: float | None = None,
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return both images as RGB of 8 bits, mapped alike, and a caption that tells how.

    The mapping is that of `mapping`.

    Parameters
    ----------
    reference, test : (H, W, C) array
        One layer. More than three channels: the first three are shown.
    encoding : str
        ``"linear"`` or ``"srgb"``.
    is_color : bool
        Whether it is radiance; else the range of the reference is spread over black to white.
    exposure : float, optional
        In stops, for HDR colours; by default `auto_exposure`.
    """
    images = [image[..., :3] for image in (reference, test)]
    kind, low, high = mapping(images[0], encoding, is_color, exposure)
    if kind == "display":
        caption = "display values"
        pictures = [np.rint(np.clip(np.nan_to_num(i), 0, 1) * 255).astype(np.uint8) for i in images]
    elif kind == "srgb":
        caption = f"sRGB, exposure {low:+g} EV"
        pictures = [to_srgb8(np.nan_to_num(image * 2.0**low)) for image in images]
    else:
        caption = f"linear, black {low:.4g}, white {high:.4g}"
        scale = 1 / (high - low) if high > low else 1.0
        pictures = [
            np.rint(np.clip(np.nan_to_num((i - low) * scale), 0, 1) * 255).astype(np.uint8)
            for i in images
        ]
    out = []
    for image, picture in zip(images, pictures):
        count = picture.shape[-1]
        if count == 1:
            picture = np.repeat(picture, 3, axis=-1)
        elif count == 2:  # such as uv: red and green
            picture = np.concatenate([picture, np.zeros_like(picture[..., :1])], axis=-1)
        picture[np.isnan(image).any(axis=-1)] = _NAN_PICTURE
        out.append(picture)
    return out[0], out[1], caption


def difference_histogram(
    difference: np.ndarray, channels: list[str], bins: int = 61
) -> Histogram | None:
    """Count signed differences ``(H, W, C)``; None if there is nothing but zeros.

    The range is that of 99.8 % of the differences, so that a firefly does not squeeze it.
    """
    size = np.abs(difference[np.isfinite(difference)])
    if not size.size or not size.any():
        return None
    limit = float(np.percentile(size, 99.8)) or float(size.max())
    edges = np.linspace(-limit, limit, bins + 1)
    counts = []
    for channel in range(difference.shape[-1]):
        values = difference[..., channel]
        inside = np.clip(values[np.isfinite(values)], -limit, limit)
        counts.append([int(n) for n in np.histogram(inside, edges)[0]])
    return Histogram(limit, channels, counts)


def thumbnail(picture: np.ndarray, largest: int = 96) -> np.ndarray:
    """Return an ``(H, W, 3)`` uint8 picture averaged down to at most `largest` pixels a side."""
    step = -(-max(picture.shape[:2]) // largest)
    if step == 1:
        return picture
    rows, columns = (np.arange(0, n, step) for n in picture.shape[:2])
    total = np.add.reduceat(np.add.reduceat(picture.astype(np.float64), rows, 0), columns, 1)
    ones = np.ones(picture.shape[:2])
    count = np.add.reduceat(np.add.reduceat(ones, rows, 0), columns, 1)
    return np.rint(total / count[..., None]).astype(np.uint8)


def jpeg(picture: np.ndarray, quality: int = 80) -> bytes:
    """Return an ``(H, W, 3)`` uint8 picture as a JPEG file, a tenth of a PNG of a noisy one."""
    mi = _runtime.import_mitsuba()
    stream = mi.MemoryStream()
    bitmap = mi.Bitmap(np.ascontiguousarray(picture))
    bitmap.write(stream, mi.Bitmap.FileFormat.JPEG, quality)
    return bytes(stream.raw_buffer())


def thumbnail_jpeg(image: Image, largest: int = 240) -> str:
    """Return a small picture of an image's first layer, a JPEG file in base64."""
    name, channels = next(iter(comparable_layers(image).items()))
    pixels = image.stack(channels)
    picture, _, _ = show(pixels, pixels, image.encoding, name == "")
    return base64.b64encode(jpeg(thumbnail(picture, largest))).decode()
