"""Write renders: OpenEXR with a header that tells how it was made, and a PNG preview.

Files are written under a temporary name in the same folder and then renamed: whatever happens
meanwhile, there is the old file or the new one, never half of one.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError, FileFormatError

__all__ = ["atomic", "check_output", "write_exr", "write_preview"]


def check_output(path: Path, parameter: str = "--output") -> None:
    """Make sure, before any work, that an EXR and its preview can be written at `path`.

    Raises
    ------
    FileFormatError
        If the suffix is not ``.exr``.
    BezierError
        If the folder does not exist or cannot be written to, or a folder has that name.
    """
    if path.suffix.lower() != ".exr":
        raise FileFormatError.expected(
            parameter, "a name that ends in .exr (a .png preview is written beside it)", f"{path}"
        )
    folder = path.parent
    if not folder.is_dir():
        raise BezierError.expected(parameter, "a folder that exists", f"{folder}")
    if not os.access(folder, os.W_OK):
        raise BezierError.expected(parameter, "a folder that can be written to", f"{folder}")
    for file in (path, path.with_suffix(".png")):
        if file.is_dir():
            raise BezierError.expected(parameter, "the name of a file", f"the folder {file}")


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary path with the suffix of `path`; rename it to `path` if all went well."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_exr(
    path: Path,
    bitmap: Any,
    attributes: Mapping[str, str | int | float],
    *,
    half: bool,
    size: tuple[int, int] | None = None,
    offset: tuple[int, int] = (0, 0),
) -> None:
    """Write all channels of a bitmap, losslessly compressed.

    Parameters
    ----------
    path : Path
        The file.
    bitmap : mi.Bitmap
        The image, with any number of channels.
    attributes : mapping
        Entries of the header: text, integers below 2^31, numbers.
    half : bool
        Write 16-bit floats, as Mitsuba's films do by default, instead of 32-bit ones.
    size, offset : pairs of int, optional
        Size of the full image and where the bitmap lies in it, if it is a crop.
    """
    import OpenEXR

    pixels = np.array(bitmap)
    height, width = pixels.shape[:2]
    pixels = pixels.reshape(height, width, -1)
    if half:
        # beyond the largest half a pixel would become infinite
        limit = np.finfo(np.float16).max
        pixels = np.clip(pixels, -limit, limit).astype(np.float16)
    else:
        pixels = pixels.astype(np.float32)
    names = [field.name for field in bitmap.struct_()]
    channels = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}

    def window(x: int, y: int, w: int, h: int) -> tuple[np.ndarray, np.ndarray]:
        return np.array([x, y], np.int32), np.array([x + w - 1, y + h - 1], np.int32)

    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": window(*offset, width, height),
        "displayWindow": window(0, 0, *(size or (width, height))),
        **attributes,
    }
    with atomic(path) as temporary, OpenEXR.File(header, channels) as file:
        file.write(str(temporary))


def write_preview(path: Path, bitmap: Any, exposure: float = 0.0) -> bool:
    """Write an 8-bit sRGB PNG of the colour channels; return False if there are none.

    Parameters
    ----------
    path : Path
        The file.
    bitmap : mi.Bitmap
        The image; of a multi-channel image the first colour layer is shown.
    exposure : float
        In stops: colours are multiplied by ``2**exposure``, then clipped to 0..1.
    """
    mi = import_mitsuba()
    formats = mi.Bitmap.PixelFormat
    if bitmap.pixel_format() == formats.MultiChannel:
        bitmap = bitmap.split()[0][1]
        if bitmap.pixel_format() == formats.MultiChannel:
            return False
    colour = bitmap.convert(formats.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    pixels = np.nan_to_num(np.array(colour)) * np.float32(2.0**exposure)
    shown = mi.Bitmap(pixels).convert(formats.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    with atomic(path) as temporary:
        shown.write(str(temporary))
    return True
