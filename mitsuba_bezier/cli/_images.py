"""Image files of a render: allowed paths, channels, and the preview."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from .._files import check_target, is_utf8
from .._runtime import import_mitsuba
from ..errors import BezierError, FileFormatError
from ..rendering.passes import channels_of
from ..verification import png

__all__ = ["check_memory", "check_output", "encode_preview"]

#: Memory of a pixel, at the least: Mitsuba's film and its bitmap in float32, exact sums in float64.
BYTES_PER_PIXEL = 64


def check_output(path: str | Path, parameter: str = "--output", preview: bool = True) -> Path:
    """Make sure, before any work, that an EXR and its preview can be written at `path`.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    FileFormatError
        If the suffix is not ``.exr``, or a file cannot be written there (see `check_target`).
    """
    name = os.fspath(path)
    if not name:
        raise FileFormatError.expected(parameter, "the name of a file", "an empty one")
    if not is_utf8(name):
        raise FileFormatError.expected(parameter, "a name in UTF-8", repr(name))
    path = Path(path)
    if path.suffix.lower() != ".exr":
        beside = " (a .png preview is written beside it)" if preview else ""
        raise FileFormatError.expected(parameter, f"a name that ends in .exr{beside}", f"{path}")
    for file in (path, path.with_suffix(".png")) if preview else (path,):
        check_target(file, parameter)
    return path


def check_memory(width: int, height: int) -> None:
    """Make sure that a film has a chance to fit the memory; libraries crash where it does not.

    Raises
    ------
    BezierError
        If it is larger than the memory of this machine, or than this process may have.
    """
    limits = []
    try:
        import resource

        soft, _hard = resource.getrlimit(resource.RLIMIT_AS)
        limits = [] if soft == resource.RLIM_INFINITY else [soft]
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (ImportError, AttributeError, ValueError, OSError):
        pass  # not every system tells
    needed = BYTES_PER_PIXEL * width * height
    if any(needed > limit for limit in limits):
        raise BezierError.expected(
            "film",
            f"a size whose {BYTES_PER_PIXEL} bytes a pixel fit the memory, {min(limits) >> 20} MiB",
            f"{width} x {height}",
        )


def encode_preview(bitmap: Any, exposure: float = 0.0) -> bytes | None:
    """Return an 8-bit sRGB PNG of the colour channels, or None if there are none.

    Parameters
    ----------
    bitmap : mi.Bitmap
        The image; of a multi-channel image the first colour layer is shown.
    exposure : float
        In stops: colours are multiplied by ``2**exposure``, then clipped to 0..1.
    """
    mi = import_mitsuba()
    formats = mi.Bitmap.PixelFormat
    if bitmap.pixel_format() == formats.MultiChannel:
        channels = channels_of(bitmap)
        if {"R", "G", "B"} <= set(channels):  # maybe beside others that are in no layer
            bitmap = mi.Bitmap(np.stack([channels[c] for c in "RGB"], axis=-1))
        else:
            bitmap = bitmap.split()[0][1]
        if bitmap.pixel_format() == formats.MultiChannel:
            return None
    colour = bitmap.convert(formats.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    pixels = np.nan_to_num(np.array(colour)) * np.float32(2.0**exposure)
    shown = mi.Bitmap(pixels).convert(formats.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    return png.encode(np.array(shown))
