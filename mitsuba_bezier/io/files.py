"""Open and write files: one place for missing files, folders and half-written output."""

from __future__ import annotations

import codecs
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from .._files import temporary_folder, write_file
from ..errors import FileFormatError

__all__ = [
    "check_regular",
    "damaged",
    "decode_text",
    "has_mark",
    "plain_copy",
    "read_bytes",
    "read_text",
    "write_bytes",
]


def damaged(
    path: str | PathLike[str],
    expected: str,
    got: object,
    *,
    line: int | None = None,
    offset: int | None = None,
) -> FileFormatError:
    """Return the error for a file with wrong contents, naming the place in it.

    Parameters
    ----------
    path : path
        The file.
    expected, got
        What should stand there, and what does.
    line : int, optional
        Line number, from 1.
    offset : int, optional
        Byte offset, from 0.
    """
    where = str(path)
    if line is not None:
        where += f", line {line}"
    if offset is not None:
        where += f", byte {offset}"
    return FileFormatError(f"{where}: expected {expected}, got {got}")


def read_bytes(path: str | PathLike[str]) -> bytes:
    """Return the contents of a file.

    Raises
    ------
    FileFormatError
        If there is no such file, or it cannot be read.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        # not blocking: to open a pipe that nobody writes to would wait for ever
        with open(os.open(path, flags), "rb") as file:
            check_regular(path, os.fstat(file.fileno()).st_mode)
            return file.read()
    except FileNotFoundError:
        got = f"{str(path)!r}, which does not exist"
    except IsADirectoryError:
        got = f"{str(path)!r}, which is a folder"
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        if isinstance(error, FileFormatError):
            raise
        got = f"{str(path)!r} ({error})"
    raise FileFormatError.expected("path", "a file that can be read", got)


#: What is no regular file, by its type.
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def check_regular(path: str | PathLike[str], mode: int | None = None) -> None:
    """Raise `FileFormatError` if a path is a folder, a pipe, a device or a socket.

    Reading those may wait for ever, or never end. A path that does not exist passes: who opens
    it tells that.

    Parameters
    ----------
    path : path
        The file.
    mode : int, optional
        Its mode, if that is known.
    """
    if mode is None:
        try:
            mode = os.stat(path).st_mode
        except (OSError, ValueError):
            return
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "no regular file")
        got = f"{str(path)!r}, which is {kind}"
        raise FileFormatError.expected("path", "a file that can be read", got)


#: What files of editors begin with, and the encoding it tells; the longer ones come first.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


def has_mark(data: bytes) -> bool:
    """Return whether data begin with a byte order mark: then they are text."""
    return any(data.startswith(mark) for mark, _encoding in _MARKS)


def decode_text(path: str | PathLike[str], data: bytes) -> str:
    """Return data as text whose lines end in newlines.

    Formats here are ASCII, names may be UTF-8; editors of some systems write a byte order mark,
    UTF-16, or lines that end in carriage returns.

    Parameters
    ----------
    path : path
        The file, for errors.
    data : bytes
        Its contents.

    Raises
    ------
    FileFormatError
        If there are null bytes: it is no text then.
    """
    mark, encoding = next((m for m in _MARKS if data.startswith(m[0])), (b"", "utf-8"))
    text = data[len(mark) :].decode(encoding, errors="replace")
    if "\0" in text:
        at = data.find(b"\0") if encoding == "utf-8" else text.find("\0")
        raise damaged(path, "a text file", "a null byte", offset=at)
    # a mark within: files that were put together; 26: the end of a file of CP/M and DOS
    text = text.replace("\ufeff", "").replace("\r\n", "\n").replace("\r", "\n")
    return text.rstrip("\x1a")


def read_text(path: str | PathLike[str]) -> str:
    """Return the contents of a text file; see `decode_text`.

    Raises
    ------
    FileFormatError
        If the file cannot be read, or holds null bytes (it is no text then).
    """
    return decode_text(path, read_bytes(path))


@contextmanager
def plain_copy(path: str | PathLike[str]) -> Iterator[Path]:
    """Give the path of a text file that foreign readers take: a copy, if an editor marked it.

    Within the ``with`` block the path stands for the same text without byte order mark, in UTF-8,
    with lines that end in newlines. Most often that is the file itself.
    """
    data = read_bytes(path)
    lone = b"\r" in data and b"\r" in data.replace(b"\r\n", b"")
    if not has_mark(data) and not lone:
        yield Path(path)
        return
    with temporary_folder() as folder:
        copy = Path(folder) / f"model{Path(path).suffix.lower()}"
        write_file(copy, decode_text(path, data).encode())
        yield copy


def write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write a file in one step: under a temporary name first, then renamed.

    An interrupted run leaves the old file, or none, never half of the new one.

    Raises
    ------
    FileFormatError
        If the folder does not exist or cannot be written to.
    """
    if not Path(path).parent.is_dir():
        raise FileFormatError.expected(
            "path",
            "a file in a folder that exists",
            f"{str(path)!r}: no folder {Path(path).parent}",
        )
    write_file(path, data, "path")
