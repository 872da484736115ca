"""Read words and numbers of a text file, with the line of each."""

from __future__ import annotations

import re
from os import PathLike

import numpy as np

from ..errors import FileFormatError
from .files import damaged, read_text

__all__ = ["Tokens", "numbers", "plain_exponents"]

_INTEGER = re.compile(r"[+-]?\d+", re.ASCII)
_NUMBERS = re.compile(r"[0-9eE+\-. ]*")
_FORTRAN = re.compile(r"(?<=[0-9.])[dD](?=[+-]?[0-9])")


def plain_exponents(text: str) -> str:
    """Return text with Fortran's exponents, as in ``1.5d-3``, written with an ``e``."""
    return _FORTRAN.sub("e", text) if "d" in text or "D" in text else text


def numbers(words: list[str]) -> np.ndarray | None:
    """Return words as finite numbers ``(N,)``, None if one of them is none.

    Exponents may be Fortran's. What only Python takes for a number (``1_000``, digits of other
    scripts, ``nan``) is none.
    """
    text = plain_exponents(" ".join(words))
    if not _NUMBERS.fullmatch(text):
        return None
    try:
        out = np.array(text.split(" ") if words else [], dtype=np.float64)
    except (ValueError, OverflowError):
        return None
    return out if np.isfinite(out).all() else None


class Tokens:
    """The words of a text file, read one after the other.

    Parameters
    ----------
    path : path
        The file.
    comment : str
        What starts a comment, which runs to the end of the line.
    apart : str
        Characters that are words of their own, whatever stands next to them.

    Raises
    ------
    FileFormatError
        If the file cannot be read.
    """

    def __init__(self, path: str | PathLike[str], comment: str = "#", apart: str = "") -> None:
        self.path = path
        self._comment = comment
        text = read_text(path)
        for character in apart:
            text = text.replace(character, f" {character} ")
        self._text = text
        if comment in text:
            text = re.sub(re.escape(comment) + r"[^\n]*", "", text)
        self._words = text.split()
        self._at = 0
        self._lines: np.ndarray | None = None

    def __len__(self) -> int:
        """Return how many words are left."""
        return len(self._words) - self._at

    def line(self, back: int = 0) -> int:
        """Return the line of the word `back` words before the next one."""
        if self._lines is None:  # only errors and formats that depend on lines need it
            rows = self._text.split("\n")
            counts = [len(row.split(self._comment)[0].split()) for row in rows]
            self._lines = np.repeat(np.arange(1, len(rows) + 1), counts)
        at = self._at - back
        if at < len(self._lines):
            return int(self._lines[at])
        return self._text.count("\n") + 1

    def error(self, expected: str, got: object, back: int = 0) -> FileFormatError:
        """Return an error about the word `back` words before the next one."""
        return damaged(self.path, expected, got, line=self.line(back))

    def peek(self) -> str:
        """Return the next word without taking it, or the empty string at the end."""
        return self._words[self._at] if self._at < len(self._words) else ""

    def word(self, expected: str) -> str:
        """Take the next word."""
        if self._at >= len(self._words):
            raise self.error(expected, "the end of the file")
        self._at += 1
        return self._words[self._at - 1]

    def integer(self, name: str, low: int, high: int) -> int:
        """Take an integer within bounds."""
        word = self.word(name)
        if len(word) > 18 or not _INTEGER.fullmatch(word) or not low <= int(word) <= high:
            raise self.error(f"{name} from {low} to {high}", repr(word[:40]), back=1)
        return int(word)

    def numbers(self, count: int, name: str) -> np.ndarray:
        """Take `count` finite numbers."""
        if count > len(self):
            self._at = len(self._words)
            raise self.error(f"{count} numbers for {name}", "the end of the file")
        words = self._words[self._at : self._at + count]
        out = numbers(words)
        if out is None:
            for word in words:
                self._at += 1
                if numbers([word]) is None:
                    raise self.error(f"a finite number for {name}", repr(word[:40]), back=1)
            raise self.error(f"{count} numbers for {name}", "other text")
        self._at += count
        return out

    def integers(self, count: int, name: str) -> np.ndarray:
        """Take `count` integers."""
        if count > len(self):
            self._at = len(self._words)
            raise self.error(f"{count} integers for {name}", "the end of the file")
        words = self._words[self._at : self._at + count]
        # the length: int() of a number of a million digits is slow
        good = [len(word) < 19 and bool(_INTEGER.fullmatch(word)) for word in words]
        if not all(good):
            self._at += good.index(False)
            raise self.error(f"an integer for {name}", repr(self.peek()[:40]))
        self._at += count
        return np.array(list(map(int, words)), dtype=np.int64)

    def numbers_ahead(self) -> int:
        """Return how many words there are before the next one that begins with a letter."""
        for k in range(self._at, len(self._words)):
            if self._words[k][0].isalpha():
                return k - self._at
        return len(self)

    def skip_to(self, word: str) -> bool:
        """Skip the words before the next `word`; return whether there is one."""
        try:
            self._at = self._words.index(word, self._at)
        except ValueError:
            return False
        return True

    def skip_line(self, number: int) -> None:
        """Skip the words that are left on line `number`."""
        while len(self) and self.line() == number:
            self._at += 1
