"""Images as named channels of one size: reading EXR and PNG, writing EXR with header attributes.

Channels are grouped into *layers*, what stands before the last dot of their names: ``R, G, B``
(or ``Y``) are the unnamed layer, ``nn.X, nn.Y, nn.Z`` the layer ``nn``; a lone ``A`` or ``Z`` is
a layer of its own. Channels that describe another one's statistics (``variance.R``, see
`ztest`; ``sum1.R``, see `merge`) are not layers to be compared.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from .._files import encoded, write_file
from ..errors import FileFormatError
from . import png
from .image_size import check_size

__all__ = [
    "SUFFIXES",
    "Image",
    "encode_exr",
    "group_layers",
    "read_image",
    "refuse_denoised",
    "write_exr",
]

SUFFIXES = (".exr", ".png")
_COLOR = ("R", "G", "B", "Y", "RY", "BY")
_ORDER = {name: at for at, name in enumerate("RGBXYZUVWA")}
_STRUCTURE = ("chunkCount", "name")  # belong to the layout of one file
_PNG_CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}


@dataclass(frozen=True)
class Image:
    """Channels of one size, with the attributes of the file's header.

    Attributes
    ----------
    channels : dict of str to (H, W) array
        By full name, in the type of the file (float16, float32, uint32; PNG: float64 in 0..1).
    attributes : dict
        Header attributes that are numbers, text or lists of text.
    encoding : str
        ``"linear"`` (EXR) or ``"srgb"`` (PNG: sample values as they are, no gamma removed).
    path : Path or None
        Where it was read.
    offset : (int, int)
        Column and row of the first pixel in the full image (data window), for crops.
    full_size : (int, int) or None
        Width and height of the full image (display window).
    """

    channels: dict[str, np.ndarray]
    attributes: dict[str, Any] = field(default_factory=dict)
    encoding: str = "linear"
    path: Path | None = None
    offset: tuple[int, int] = (0, 0)
    full_size: tuple[int, int] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        height, width = next(iter(self.channels.values())).shape
        return height, width

    def stack(self, names: Iterable[str]) -> np.ndarray:
        """Return channels as ``(H, W, C)`` float64."""
        return np.stack([self.channels[name] for name in names], axis=-1).astype(np.float64)


def _split(name: str) -> tuple[str, str]:
    layer, dot, last = name.rpartition(".")
    if not dot and name not in _COLOR:
        return name, name
    return layer, last


def group_layers(names: Iterable[str]) -> dict[str, list[str]]:
    """Group channel names by layer, each in the usual order (RGB, XYZ, UV), colour first."""
    layers: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda n: (_split(n)[0], _ORDER.get(_split(n)[1], 99), n)):
        layers.setdefault(_split(name)[0], []).append(name)
    return layers


def read_image(path: str | os.PathLike[str]) -> Image:
    """Read an EXR or PNG file.

    Channels of further parts of a multi-part EXR get the part's name in front (``depth.Z``),
    unless they already begin with it.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, deep, of another kind, or its channels differ in size.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise FileFormatError.expected(str(path), "an image, .exr or .png", f"suffix '{suffix}'")
    if not path.is_file():
        raise FileFormatError.expected(
            str(path), "an image file", "a folder" if path.is_dir() else "nothing there"
        )
    if suffix == ".png":
        pixels = png.decode(path.read_bytes(), str(path))
        values = pixels / float(np.iinfo(pixels.dtype).max)
        names = _PNG_CHANNELS[values.shape[-1]]
        return Image({n: values[..., i] for i, n in enumerate(names)}, {}, "srgb", path)
    return _read_exr(path)


@contextlib.contextmanager
def _captured() -> Iterator[list[str]]:
    """Keep what OpenEXR prints (on descriptor 2, and on Python's stdout) off the terminal.

    It prints what is wrong with a file besides raising, dozens of times. Gives a list that
    holds the lines afterwards.
    """
    lines: list[str] = []
    with contextlib.redirect_stdout(io.StringIO()), tempfile.TemporaryFile() as file:
        if sys.stderr is not None:
            sys.stderr.flush()
        saved = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            file.seek(0)
            lines += file.read().decode(errors="replace").splitlines()


def _read_exr(path: Path) -> Image:
    lines: list[str] = []
    try:
        with _captured() as lines, OpenEXR.File(str(path), header_only=True) as file:
            numbers = 0
            for part in file.parts:
                (left, top), (right, bottom) = np.array(part.header["dataWindow"], dtype=float)
                area = (right - left + 1) * (bottom - top + 1)
                numbers += int(area) * len(part.header.get("channels", ()))
        check_size(str(path), numbers, path.stat().st_size)
        with _captured() as lines, OpenEXR.File(str(path), separate_channels=True) as file:
            return _from_parts(file.parts, path)
    except FileFormatError:
        raise
    except Exception as error:  # RuntimeError, ValueError, MemoryError, by the kind of damage
        reason = lines[0].removeprefix(f"{path}: ") if lines else str(error)
        raise FileFormatError.expected(str(path), "an intact EXR file", reason) from None


def _from_parts(parts: Sequence[Any], path: Path) -> Image:
    channels: dict[str, np.ndarray] = {}
    attributes: dict[str, Any] = {}
    for index, part in enumerate(parts):
        if part.type() in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise FileFormatError.expected(str(path), "a flat EXR file", "deep pixels")
        for name, channel in part.channels.items():
            if index and not name.startswith(f"{part.name()}."):
                name = f"{part.name()}.{name}"
            if name in channels:
                raise FileFormatError.expected(str(path), "channels of distinct names", name)
            channels[name] = channel.pixels
        for key, value in part.header.items():
            text = isinstance(value, list) and all(isinstance(v, str) for v in value)
            if (text or isinstance(value, (str, int, float))) and key not in _STRUCTURE:
                attributes.setdefault(key, value)
    if not channels:
        raise ValueError("no channel can be read")
    sizes = {name: pixels.shape for name, pixels in channels.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {h}x{w}" for name, (h, w) in sizes.items())
        raise FileFormatError.expected(str(path), "channels of one size", listed)
    header = parts[0].header
    (x, y), _ = header["dataWindow"]
    (left, top), (right, bottom) = header["displayWindow"]
    offset = int(x) - int(left), int(y) - int(top)
    full = int(right) - int(left) + 1, int(bottom) - int(top) + 1
    return Image(channels, attributes, "linear", path, offset, full)


def refuse_denoised(image: Image) -> None:
    """Raise an error for a picture that a denoiser has made: it is a guess, no measurement.

    Raises
    ------
    FileFormatError
        If its header says so.
    """
    made_by = image.attributes.get("denoised")
    if made_by:
        raise FileFormatError.expected(
            str(image.path), "a picture as it was rendered", f"one that was denoised ({made_by})"
        )


def write_exr(
    path: str | os.PathLike[str],
    channels: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any] | None = None,
    offset: tuple[int, int] = (0, 0),
    full_size: tuple[int, int] | None = None,
) -> None:
    """Write an EXR file without loss (ZIP), whole or not at all.

    Parameters
    ----------
    path : path-like
        Folders on the way are made.
    channels : mapping of str to (H, W) array
        float16 and uint32 stay, all else becomes float32.
    attributes : mapping, optional
        Header attributes: text, int, float, or lists of text. An int beyond 32 bits is
        written as text, for EXR has no larger one.
    offset, full_size : pairs of int, optional
        See `Image`; without them the image is no crop.

    Raises
    ------
    FileFormatError
        If a channel or attribute cannot be stored, or the file not be written.
    """
    write_file(path, encode_exr(channels, attributes, offset, full_size), make_folders=True)


def encode_exr(
    channels: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any] | None = None,
    offset: tuple[int, int] = (0, 0),
    full_size: tuple[int, int] | None = None,
    compress: bool = True,
    lossy: bool = False,
) -> bytes:
    """Return the contents of the file that `write_exr` writes; `compress` by ZIP.

    `lossy`: by DWAA instead, whose errors the eye hardly sees.
    """
    pixels: dict[str, np.ndarray] = {}
    for name, values in channels.items():
        values = np.asarray(values)
        if values.ndim != 2 or not values.size:
            raise FileFormatError.expected(f"channel {name}", "shape (H, W)", f"{values.shape}")
        kept = values.dtype in (np.float16, np.uint32)
        pixels[name] = np.ascontiguousarray(values if kept else values.astype(np.float32))
    if len({p.shape for p in pixels.values()}) != 1:
        raise FileFormatError.expected(
            "channels", "at least one, all of one size", f"{[p.shape for p in pixels.values()]}"
        )
    height, width = next(iter(pixels.values())).shape

    def window(x: int, y: int, w: int, h: int) -> tuple[np.ndarray, np.ndarray]:
        return np.array([x, y], np.int32), np.array([x + w - 1, y + h - 1], np.int32)

    # and lines of a chunk
    kind, lines = (OpenEXR.ZIP_COMPRESSION, 16) if compress else (OpenEXR.NO_COMPRESSION, 1)
    if lossy:
        kind, lines = OpenEXR.DWAA_COMPRESSION, 32
    header: dict[str, Any] = {
        "compression": kind,
        "type": OpenEXR.scanlineimage,
        "dataWindow": window(*offset, width, height),
        "displayWindow": window(0, 0, *(full_size or (width, height))),
    }
    for key, value in (attributes or {}).items():
        if isinstance(value, (bool, int, np.integer)):
            value = int(value) if abs(int(value)) < 2**31 else str(int(value))
        elif isinstance(value, (float, np.floating)):
            value = float(value)
        elif isinstance(value, os.PathLike):
            value = str(value)
        elif isinstance(value, (list, tuple)) and all(isinstance(v, str) for v in value):
            value = [_utf8(v) for v in value]
        elif not isinstance(value, str):
            raise FileFormatError.expected(f"attribute {key}", "text or a number", f"{value!r}")
        header[key] = _utf8(value) if isinstance(value, str) else value
    try:
        data = encoded(OpenEXR.File(header, pixels).write)
    except RuntimeError as error:
        raise FileFormatError.expected("image", "one that OpenEXR can write", error) from None
    _check_whole(data, -(-height // lines))
    return data


def _utf8(text: str) -> str:
    """Return text for a header; file names may hold bytes that are no text."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _check_whole(data: bytes, count: int) -> None:
    """Walk over the chunks of an EXR file of scanlines: OpenEXR tells no error at its end.

    Every entry of the table of offsets must point to the chunk of its lines, each chunk begin
    where the one before ends, and the last end with the file.
    """
    at = 8  # magic number and version
    try:
        while data[at]:  # attributes: name, type, size, value; an empty name ends them
            at = data.index(0, data.index(0, at) + 1) + 1
            at += 4 + struct.unpack_from("<i", data, at)[0]
        at += 1
        offsets = struct.unpack_from(f"<{count}Q", data, at)
        at += 8 * count
        for offset in offsets:
            if offset != at:
                raise ValueError
            at += 8 + struct.unpack_from("<ii", data, at)[1]
        if at != len(data):
            raise ValueError
    except (IndexError, ValueError, struct.error):
        raise FileFormatError.expected(
            "image", "room for an EXR file in memory", f"only {len(data)} bytes of it"
        ) from None
