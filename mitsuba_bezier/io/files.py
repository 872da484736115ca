"""Opening and writing files: one place for missing files, folders and half-written output."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from .._files import write_file
from ..errors import FileFormatError

__all__ = ["damaged", "read_bytes", "read_text", "write_bytes"]


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
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        got = f"{str(path)!r}, which does not exist"
    except IsADirectoryError:
        got = f"{str(path)!r}, which is a folder"
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        got = f"{str(path)!r} ({error})"
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
