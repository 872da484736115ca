"""Read the text of a prescription file in whatever encoding a program on Windows wrote it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from ..errors import FileFormatError
from ..io.files import damaged, decode_text, has_mark, read_bytes

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
        raise damaged(path, "a prescription as text", "binary data")
    try:
        return decode_text(path, data)
    except FileFormatError:
        return decode_text(path, data.decode("latin-1").encode())


@dataclass(frozen=True)
class Statement:
    """A keyword of a prescription and the words behind it, with the place where they stand."""

    path: str | PathLike[str]
    line: int
    words: Sequence[str]

    @property
    def key(self) -> str:
        """The keyword, as written."""
        return self.words[0]

    def number(self, at: int, default: float | None = None) -> float:
        """Return word `at` as a number; `default`, if there is one, where the word is missing.

        Raises
        ------
        FileFormatError
            If the word is missing or no number.
        """
        if at >= len(self.words) and default is not None:
            return default
        try:
            value = float(self.words[at])
            if value != value:
                raise ValueError
            return value
        except (IndexError, ValueError):
            got = self.words[at] if at < len(self.words) else "nothing"
            expected = f"a number as word {at + 1} of {self.key}"
            raise damaged(self.path, expected, got, line=self.line) from None

    def whole(self, at: int, default: int | None = None) -> int:
        """Return word `at` as a whole number, as `number` does."""
        value = self.number(at, default)
        if not np.isfinite(value):
            expected = f"a whole number as word {at + 1} of {self.key}"
            raise damaged(self.path, expected, self.words[at], line=self.line)
        return int(value)

    def numbers(self) -> list[float]:
        """Return all words behind the keyword as numbers."""
        return [self.number(at) for at in range(1, len(self.words))]


def columns(head: Mapping[str, Statement], names: Sequence[str], count: int) -> list[list[float]]:
    """Return `count` numbers of each of the statements `names`, zeros where they are missing."""
    rows = (head[name].numbers() if name in head else [] for name in names)
    return [(row + [0.0] * count)[:count] for row in rows]
