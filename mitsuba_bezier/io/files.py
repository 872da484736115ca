"""Opening and writing files: one place for missing files, folders and half-written output."""

from __future__ import annotations

import os
import stat
from os import PathLike
from pathlib import Path

from .._files import write_file
from ..errors import FileFormatError

__all__ = ["check_regular", "damaged", "read_bytes", "read_text", "write_bytes"]


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


def read_text(path: str | PathLike[str]) -> str:
    """Return the contents of a text file; text formats here are ASCII, names may be UTF-8.

    Raises
    ------
    FileFormatError
        If the file cannot be read, or holds null bytes (it is no text then).
    """
    data = read_bytes(path)
    at = data.find(b"\0")
    if at >= 0:
        raise damaged(path, "a text file", "a null byte", offset=at)
    return data.decode("utf-8", errors="replace")


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
