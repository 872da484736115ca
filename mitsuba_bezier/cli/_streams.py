"""Make standard streams safe: any text can be written, and a reader may leave at any time.

What cannot be said on standard error is dropped: a render goes on if whoever read its progress
is gone. What cannot be printed to standard output is an error like any other.
"""

from __future__ import annotations

import io
import os
import sys

from ..errors import BezierError

__all__ = ["prepare", "printable"]


def printable(text: str) -> str:
    """Return text for one line of a terminal: names may hold line ends and control characters."""
    return "".join(
        c if c.isprintable() or c == " " else c.encode("unicode_escape").decode() for c in text
    )


class _Descriptor(io.RawIOBase):
    """One of the standard streams, by its number."""

    def __init__(self, number: int, name: str) -> None:
        self._number, self._name, self._failed = number, name, False

    @property
    def name(self) -> str:
        return f"<{self._name}>"

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._number

    def isatty(self) -> bool:
        return os.isatty(self._number)

    def write(self, data: object) -> int:
        view = memoryview(data).cast("B")  # type: ignore[arg-type]
        if not self._failed:
            try:
                return os.write(self._number, view)
            except OSError as error:
                self._failed = True  # told once; the rest of the text would fail again at the end
                if self._number == 1:
                    raise BezierError.expected(
                        "standard output", "a stream that can be written to", error.strerror
                    ) from None
        return len(view)


def prepare() -> None:
    """Replace ``sys.stdout`` and ``sys.stderr`` of this process."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        old = getattr(sys, name)
        encoding = getattr(old, "encoding", None) or "utf-8"
        if os.name == "nt":  # its terminals are written to in another way
            if hasattr(old, "reconfigure"):
                old.reconfigure(errors="backslashreplace")
            continue
        raw = _Descriptor(number, name)
        new = io.TextIOWrapper(
            io.BufferedWriter(raw),
            encoding,
            errors="backslashreplace",
            line_buffering=number == 2 or raw.isatty(),
        )
        if old is not None:
            old.flush()
        setattr(sys, name, new)
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
