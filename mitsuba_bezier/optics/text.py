"""Read the text of a prescription file in whatever encoding a program on Windows wrote it."""

from __future__ import annotations

from os import PathLike

from ..errors import FileFormatError
from ..io.files import decode_text, has_mark, read_bytes

#: Prescriptions are small; a larger file is none.
_MAX_BYTES = 16 << 20


def read_prescription_text(path: str | PathLike[str]) -> str:
    """Return the text of a file in UTF-8, UTF-16 with or without a mark, or Latin-1.

    Raises
    ------
    FileFormatError
        If there is no such file, it is larger than 16 MiB, or it is no text.
    """
    data = read_bytes(path)
    if len(data) > _MAX_BYTES:
        raise FileFormatError.expected(
            "path", f"a prescription of at most {_MAX_BYTES >> 20} MiB", f"{len(data) >> 20} MiB"
        )
    if has_mark(data):
        return decode_text(path, data)
    head = data[:4096]
    # UTF-16 without a mark: every second byte of ASCII text is null
    if head[1::2].count(0) > 0.4 * len(head) / 2:
        return decode_text(path, b"\xff\xfe" + data)
    if head[0::2].count(0) > 0.4 * len(head) / 2:
        return decode_text(path, b"\xfe\xff" + data)
    if b"\0" in data:
        raise FileFormatError(f"{path}: expected a prescription as text, got binary data")
    try:
        return decode_text(path, data)
    except FileFormatError:
        return decode_text(path, data.decode("latin-1").encode())
