"""VTK's XML files: the element tree and every encoding of a ``DataArray``.

Source: "VTK XML Formats", https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
Inline and appended data, raw or base64, with 32 or 64 bit headers, either byte order, and the
compressors zlib, lzma and lz4.
"""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike
from xml.parsers import expat

import numpy as np

from ...errors import FileFormatError
from ..files import damaged, decode_text, has_mark, read_bytes
from ..limits import check_memory
from .lz4 import decompress_block

__all__ = ["Element", "VtkXml", "decode_bytes"]

#: Largest ratio of decoded to stored size each compressor can reach; more is a forged header.
_MAX_RATIO = {"zlib": 1040, "lz4": 256, "lzma": 8000}

#: Bytes a value of an array takes: as it was decoded, as it is read, as it is converted.
_VALUE = 24

_COMPRESSORS = {
    "": "",
    "vtkZLibDataCompressor": "zlib",
    "vtkLZMADataCompressor": "lzma",
    "vtkLZ4DataCompressor": "lz4",
}

_TYPES = {f"{'U' * (k == 'u')}Int{8 * n}": f"{k}{n}" for k in "iu" for n in (1, 2, 4, 8)}
_TYPES |= {"Float32": "f4", "Float64": "f8"}


@dataclass
class Element:
    """An XML element with the line it starts on."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Iterate over the children of one tag."""
        return (c for c in self.children if c.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child of one tag, or None."""
        return next(self.all(tag), None)


def _parse(path: str | PathLike[str], xml: bytes) -> Element:
    """Return the root element; character data is kept for ``DataArray`` only."""
    root: list[Element] = []
    stack: list[Element] = []
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, parser.CurrentLineNumber)
        (stack[-1].children if stack else root).append(element)
        stack.append(element)

    def end(_tag: str) -> None:
        stack.pop()

    def text(data: str) -> None:
        if stack and stack[-1].tag in ("DataArray", "InformationKey"):
            stack[-1].texts.append(data)

    def doctype(*_args: object) -> None:
        # VTK writes none; entities defined there could expand without bound
        raise damaged(path, "a VTK XML file", "a DOCTYPE", line=parser.CurrentLineNumber)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise damaged(
            path, "a well-formed VTK XML file", reason, line=error.lineno, offset=_tell(parser)
        ) from None
    return root[0]


def _tell(parser: expat.XMLParserType) -> int:
    return max(parser.CurrentByteIndex, 0)


def decode_bytes(data: bytes, count: int) -> tuple[bytes, int]:
    """Decode `count` bytes from the start of base64 text.

    The text may consist of several padded runs, as VTK writes the header of compressed data.

    Returns
    -------
    decoded : bytes
        `count` bytes, or fewer where the text ends.
    used : int
        Number of characters up to the end of the last group of four that was needed.

    Raises
    ------
    binascii.Error
        If the text holds a character that is not base64.
    """
    parts: list[bytes] = []
    at, missing = 0, count
    while missing > 0 and at < len(data):
        stop = min(at + -(-missing // 3) * 4, len(data))
        pad = data.find(b"=", at, stop)
        if pad >= 0:  # the run ends with the group of four this padding belongs to
            stop = min(at + ((pad - at) // 4 + 1) * 4, len(data))
        parts.append(base64.b64decode(data[at:stop], validate=True))
        missing -= len(parts[-1])
        at = stop
    return b"".join(parts)[:count], at


class VtkXml:
    """A parsed VTK XML file.

    Parameters
    ----------
    path : path
        The file.

    Attributes
    ----------
    root : Element
        The ``VTKFile`` element.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, or no VTK XML file.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path
        data = read_bytes(path)
        if has_mark(data):  # an editor wrote it: then all of it is text
            data = decode_text(path, data).encode()
        self.size = len(data)
        self._taken = 0  # bytes for arrays so far
        tag = re.search(rb"<AppendedData\b[^>]*>", data)
        self._appended = b""
        self._appended_at = 0
        self._appended_base64 = False
        if tag:  # raw bytes are not XML: cut them out
            mark = data.find(b"_", tag.end())
            if mark < 0 or data[tag.end() : mark].strip():
                raise damaged(path, "'_' before the appended data", "none", offset=tag.end())
            if mark == len(data) - 1:
                raise damaged(path, "appended data", "the end of the file", offset=len(data))
            self._appended_at = mark + 1
            stop = data.rfind(b"</AppendedData", mark)
            self._appended = data[mark + 1 : stop if stop >= 0 else len(data)]
            xml = data[: tag.end()] + b"</AppendedData></VTKFile>"
        else:
            xml = data
        self.root = _parse(path, xml)
        if self.root.tag != "VTKFile":
            raise damaged(path, "a <VTKFile> element", f"<{self.root.tag}>", line=self.root.line)
        self._byte_order = self._choice(
            "byte_order", {"LittleEndian": "<", "BigEndian": ">"}, "LittleEndian"
        )
        self._header = np.dtype(
            self._byte_order
            + self._choice("header_type", {"UInt32": "u4", "UInt64": "u8"}, "UInt32")
        )
        self._compressor = self._choice("compressor", _COMPRESSORS, "")
        appended = self.root.first("AppendedData")
        if appended is not None:
            encoding = appended.attributes.get("encoding", "base64")
            if encoding not in ("raw", "base64"):
                raise damaged(
                    path, "encoding 'raw' or 'base64'", repr(encoding), line=appended.line
                )
            self._appended_base64 = encoding == "base64"

    def _choice(self, name: str, values: dict[str, str], default: str) -> str:
        given = self.root.attributes.get(name, default)
        if given not in values:
            known = ", ".join(v for v in values if v)
            raise damaged(
                self.path, f"{name} to be one of {known}", repr(given), line=self.root.line
            )
        return values[given]

    def count(self, element: Element, name: str) -> int:
        """Return an attribute that counts something, checked against the size of the file."""
        text = element.attributes.get(name, "")
        # isdecimal and the length: int() of a forged number of a million digits is slow
        if not text.strip().isdecimal() or len(text) > 40:
            raise damaged(self.path, f"{name} to be a number", repr(text[:40]), line=element.line)
        count = int(text)
        ratio = _MAX_RATIO.get(self._compressor, 1)
        if count > self.size * ratio:
            raise damaged(
                self.path,
                f"{name} that fits the {self.size} bytes of the file",
                count,
                line=element.line,
            )
        check_memory(self.path, count * _VALUE, f"{count} as {name}")
        return count

    def array(self, element: Element, count: int, kind: str = "number") -> np.ndarray:
        """Decode a ``DataArray``.

        Parameters
        ----------
        element : Element
            The ``DataArray``.
        count : int
            How many values it must hold.
        kind : str
            ``"integer"`` refuses a floating point type.

        Returns
        -------
        (count,) array
            float64, or int64 for integer types.

        Raises
        ------
        FileFormatError
            If the array is damaged or of another length.
        """
        label = element.attributes.get("Name", "")
        typename = element.attributes.get("type", "")
        dtype = _TYPES.get(typename)
        if dtype is None or (kind == "integer" and dtype[0] == "f"):
            wanted = "an integer type" if kind == "integer" else "a number type"
            raise damaged(
                self.path, f"{wanted} of DataArray {label!r}", repr(typename), line=element.line
            )
        self._taken += count * _VALUE
        check_memory(self.path, self._taken, f"{count} values in DataArray {label!r}")
        form = element.attributes.get("format", "ascii")
        if form == "ascii":
            out = self._ascii(element, dtype, count)
        elif form in ("binary", "appended"):
            raw = self._binary(element, form, count * np.dtype(dtype).itemsize)
            out = np.frombuffer(raw, dtype=self._byte_order + dtype)
        else:
            raise damaged(
                self.path, "format 'ascii', 'binary' or 'appended'", repr(form), line=element.line
            )
        if len(out) != count:
            raise damaged(
                self.path,
                f"{count} values in DataArray {label!r}",
                len(out),
                line=element.line,
            )
        if dtype == "u8" and len(out) and out.max() > np.iinfo(np.int64).max:
            raise damaged(
                self.path, f"values below 2**63 in {label!r}", out.max(), line=element.line
            )
        return out.astype(np.float64 if dtype[0] == "f" else np.int64)

    def _ascii(self, element: Element, dtype: str, count: int) -> np.ndarray:
        text = "".join(element.texts)
        if not text.strip():
            return np.zeros(0, dtype)
        wide = np.float64 if dtype[0] == "f" else np.int64
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # NumPy's way to say "garbage"
            try:
                return np.fromstring(text, dtype=wide, sep=" ")
            except (ValueError, DeprecationWarning, OverflowError):
                pass
        for number, line in enumerate(text.split("\n")):
            for token in line.split():
                try:
                    wide(token)
                except (ValueError, OverflowError):
                    raise damaged(
                        self.path,
                        f"numbers in DataArray {element.attributes.get('Name', '')!r}",
                        repr(token[:40]),
                        line=element.line + number,
                    ) from None
        raise damaged(self.path, f"{count} numbers", "other text", line=element.line)

    def _binary(self, element: Element, form: str, size: int) -> bytes:
        """Return the decoded bytes, at most a few more than `size`."""
        if form == "appended":
            text = element.attributes.get("offset", "").strip()
            if not text.isdecimal() or len(text) > 40:
                raise damaged(
                    self.path, "an offset into the appended data", repr(text), line=element.line
                )
            offset = int(text)
            if offset >= len(self._appended):
                raise damaged(
                    self.path,
                    f"an offset below the {len(self._appended)} bytes of appended data",
                    offset,
                    line=element.line,
                )
            stored = memoryview(self._appended)[offset:]
            at = self._appended_at + offset
            is_base64 = self._appended_base64
            where: dict[str, int] = {"offset": at}
        else:
            stored = memoryview("".join("".join(element.texts).split()).encode())
            is_base64 = True
            where = {"line": element.line}
        try:
            return self._blocks(_Cursor(stored, is_base64), size)
        except FileFormatError as error:
            place = ", ".join(f"{'byte' if k == 'offset' else k} {v}" for k, v in where.items())
            label = element.attributes.get("Name", "")
            raise FileFormatError(f"{self.path}, {place}: DataArray {label!r}: {error}") from None

    def _blocks(self, cursor: _Cursor, size: int) -> bytes:
        width = self._header.itemsize

        def numbers(count: int) -> list[int]:
            return np.frombuffer(cursor.take(count * width), dtype=self._header).tolist()

        if not self._compressor:
            (stored,) = numbers(1)
            if stored != size:
                raise FileFormatError(f"expected {size} bytes, got a header that says {stored}")
            return cursor.take(size)
        head = numbers(1)
        count = head[0]
        if count == 0:
            return b""
        cursor.expect((2 + count) * width)  # before the list of sizes is made
        block, last, *stored_sizes = numbers(2 + count)
        sizes = [block] * (count - 1) + [last or block]
        if sum(sizes) != size:
            raise FileFormatError(f"expected {size} bytes, got blocks of {sum(sizes)}")
        cursor.end_header()
        cursor.expect(sum(stored_sizes))
        if size > sum(stored_sizes) * _MAX_RATIO[self._compressor] + 1024:
            raise FileFormatError(
                f"expected {size} bytes, got {sum(stored_sizes)} compressed ones: "
                "more than the compressor can save"
            )
        data = cursor.take(sum(stored_sizes))
        out = []
        at = 0
        for stored, plain in zip(stored_sizes, sizes):
            out.append(self._inflate(data[at : at + stored], plain))
            at += stored
        return b"".join(out)

    def _inflate(self, data: bytes, size: int) -> bytes:
        try:
            if self._compressor == "zlib":
                out = zlib.decompressobj().decompress(data, size + 1)
            elif self._compressor == "lzma":
                # 256 MiB is above what the highest preset of xz needs to decode
                out = lzma.LZMADecompressor(memlimit=1 << 28).decompress(data, size + 1)
            else:
                out = decompress_block(data, size)
        except (zlib.error, lzma.LZMAError, EOFError, ValueError) as error:
            raise FileFormatError(f"expected a {self._compressor} block, got {error}") from None
        if len(out) != size:
            raise FileFormatError(f"expected a block of {size} bytes, got {len(out)}")
        return out


class _Cursor:
    """Reads bytes one after the other from raw or base64 data."""

    def __init__(self, stored: memoryview, is_base64: bool) -> None:
        self._stored = stored
        self._base64 = is_base64
        self._at = 0  # in stored bytes
        self._taken = 0  # decoded bytes since the start of the current run
        self._run = 0  # where the current base64 run starts

    def expect(self, size: int) -> None:
        """Raise if fewer than `size` bytes can follow."""
        left = len(self._stored) - self._at
        if self._base64:
            left = left // 4 * 3 + 3
        if size > left:
            raise FileFormatError(f"expected {size} bytes, got {left} to the end of the data")

    def end_header(self) -> None:
        """Start a new base64 run: after the header of compressed data."""
        if self._base64:
            self._run += -(-self._taken // 3) * 4
            self._taken = 0

    def take(self, size: int) -> bytes:
        """Return the next `size` bytes, or raise if there are fewer."""
        self.expect(size)
        if not self._base64:
            out = bytes(self._stored[self._at : self._at + size])
            self._at += size
        else:
            try:
                # the whole run so far is decoded again: only headers are short takes
                span = bytes(self._stored[self._run : self._run + self._span(size)])
                decoded, _used = decode_bytes(span, self._taken + size)
            except binascii.Error as error:
                raise FileFormatError(f"expected base64, got {error}") from None
            out = decoded[self._taken :]
            self._taken += len(out)
            self._at = self._run + -(-self._taken // 3) * 4
        if len(out) != size:
            raise FileFormatError(f"expected {size} bytes, got {len(out)}")
        return out

    def _span(self, size: int) -> int:
        # 8: room for one more padded run, as some programs write the header on its own
        return -(-(self._taken + size) // 3) * 4 + 8
