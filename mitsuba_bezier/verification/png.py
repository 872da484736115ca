"""PNG in memory, through Mitsuba's bitmaps, with a check for damage.

Mitsuba is there anyway, and its libpng keeps all 16 bits of a colour (Pillow cuts them to 8).
``mi.Bitmap`` needs no variant and no LLVM. It only warns of some damage, so the checksums are
looked at here first.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from .. import _runtime
from ..errors import FileFormatError
from .image_size import check_size

__all__ = ["decode", "encode"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def _check(data: bytes, name: str) -> None:
    """Walk over the chunks: signature, lengths, checksums and the end chunk must be right."""
    if not data.startswith(_SIGNATURE):
        raise FileFormatError.expected(name, "a PNG file", "other contents")
    at = len(_SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            break
        (crc,) = struct.unpack_from(">I", data, end)
        if zlib.crc32(data[at + 4 : end]) != crc:
            raise FileFormatError.expected(name, "an intact PNG file", "a wrong checksum")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end + 4
    raise FileFormatError.expected(name, "an intact PNG file", "one that ends too early")


def decode(data: bytes, name: str) -> np.ndarray:
    """Return the pixels of a PNG file.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    name : str
        What error messages call it.

    Returns
    -------
    numpy.ndarray
        ``(H, W, C)`` of uint8 or uint16; C = 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA.

    Raises
    ------
    FileFormatError
        If the data are damaged or no PNG.
    """
    _check(data, name)
    if data[12:16] == b"IHDR":
        width, height = struct.unpack_from(">II", data, 16)
        check_size(name, width * height * {0: 1, 4: 2, 6: 4}.get(data[25], 3), len(data))
    mi = _runtime.import_mitsuba()
    stream = mi.MemoryStream()
    stream.write(data)
    stream.seek(0)
    try:
        pixels = np.array(mi.Bitmap(stream, mi.Bitmap.FileFormat.PNG))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise FileFormatError.expected(name, "an intact PNG file", reason) from None
    return pixels.reshape(*pixels.shape[:2], -1)


def encode(pixels: np.ndarray) -> bytes:
    """Return a PNG file with the pixels ``(H, W)`` or ``(H, W, C)``, uint8 or uint16."""
    mi = _runtime.import_mitsuba()
    stream = mi.MemoryStream()
    mi.Bitmap(np.ascontiguousarray(pixels)).write(stream, mi.Bitmap.FileFormat.PNG)
    return stream.raw_buffer()
