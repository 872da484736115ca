"""Limits on the processor time and memory of a reader, and how users raise them.

A file of a few kilobytes can ask for gigabytes or hours, by a forged count as well as by honest
numbers: 60 000 spans of degree 30. Readers in a process of their own (`isolated`) are stopped by
the system at these limits; all others count what they are about to make, and refuse it first.

Both limits grow with the file. They are counted beyond what importing the libraries takes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike

from ..errors import FileFormatError
from .files import damaged

__all__ = [
    "MEMORY_VARIABLE",
    "SECONDS_VARIABLE",
    "check_control_points",
    "check_memory",
    "chosen",
    "memory_limit",
    "seconds_limit",
    "too_large",
    "too_slow",
]

#: Environment variables that replace the limits: processor seconds, and GiB of memory.
SECONDS_VARIABLE = "MITSUBA_BEZIER_READ_SECONDS"
MEMORY_VARIABLE = "MITSUBA_BEZIER_READ_MEMORY"

#: Processor seconds for any file, and for each byte more. CAD files of 0.1 to 2 MB take 0.1 to
#: 2 s (Zen 5), Rhino files up to 10 s a MB.
_SECONDS, _SECONDS_A_BYTE = 10.0, 1e-4

#: Bytes for any file, and for each byte more. A B-spline surface of degree (5, 5) makes some 700
#: bytes of triangles from a byte of text, but files of many megabytes hold no bicubic in each line.
_MEMORY, _MEMORY_A_BYTE = 512 << 20, 256

#: Bytes a control point takes while a model is put together: its 32, six times over.
_POINT = 200

_own: dict[str, float] = {}  # what `chosen` replaces


@contextmanager
def chosen(seconds: float | None = None, memory: float | None = None) -> Iterator[None]:
    """Replace limits within a ``with`` block, whatever the environment says.

    Parameters
    ----------
    seconds : float, optional
        Of processor time.
    memory : float, optional
        In GiB.
    """
    before = dict(_own)
    given = {SECONDS_VARIABLE: seconds, MEMORY_VARIABLE: memory}
    _own.update({name: value for name, value in given.items() if value is not None})
    try:
        yield
    finally:
        _own.clear()
        _own.update(before)


def _given(name: str) -> float | None:
    """Return what the user chose, None if nothing."""
    if name in _own:
        return _own[name]
    text = os.environ.get(name, "").strip()
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e9:
        raise FileFormatError.expected(name, "a number above 0 and below 1e9", repr(text[:40]))
    return value


def seconds_limit(size: int) -> float:
    """Return the limit of processor seconds for a file of `size` bytes."""
    own = _given(SECONDS_VARIABLE)
    return _SECONDS + _SECONDS_A_BYTE * size if own is None else own


def memory_limit(size: int) -> int:
    """Return the limit of memory in bytes for a file of `size` bytes."""
    own = _given(MEMORY_VARIABLE)
    return _MEMORY + _MEMORY_A_BYTE * size if own is None else int(own * (1 << 30))


def _size(path: str | PathLike[str]) -> int:
    try:
        return os.stat(path).st_size
    except (OSError, ValueError):
        return 0


def too_slow(path: str | PathLike[str], seconds: float) -> FileFormatError:
    """Return the error for a file that takes longer than `seconds`."""
    return damaged(
        path,
        f"a file that can be read in {seconds:.4g} s of processor time "
        f"(--read-seconds or {SECONDS_VARIABLE} sets this limit)",
        "one that takes longer",
    )


def too_large(path: str | PathLike[str], got: str = "one that takes more") -> FileFormatError:
    """Return the error for a file that takes more memory than its limit."""
    gib = memory_limit(_size(path)) / (1 << 30)
    return damaged(
        path,
        f"a file that can be read in {gib:.3g} GiB of memory "
        f"(--read-memory or {MEMORY_VARIABLE} sets this limit)",
        got,
    )


def check_memory(path: str | PathLike[str], count: int, what: str, more: int = 0) -> None:
    """Raise `FileFormatError` if `count` bytes for `what` are more than the limit.

    Of a file with others of `more` bytes it is that of all.
    """
    if count > memory_limit(_size(path) + more):
        raise too_large(path, f"{what}, which take {count / (1 << 30):.3g} GiB")


def check_control_points(
    path: str | PathLike[str], count: int, what: str = "", more: int = 0
) -> None:
    """Raise `FileFormatError` if a model of `count` control points takes more than the limit."""
    check_memory(path, count * _POINT, what or f"{count} control points", more)
