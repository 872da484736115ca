"""Keep a render while it is made: when to write what is there, and what to do at its end.

What is there is written after the first pass, and then as often as costs no more than a hundredth
of the time, but not more often than every two seconds. A signal or an error that ends the command
lets it be written once more. What cannot be written, as the disk is full, is tried again the next
time: the render goes on.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .. import _signals
from .._files import Files, free_space, write_files
from ..errors import BezierError
from .picture import Picture

__all__ = ["Keeper"]

#: Seconds between two writes, and the time of a write in that of rendering, at the most.
EVERY, SHARE = 2.0, 0.01
#: Seconds that the end by a signal may take; Slurm gives 30 before it kills.
AT_END = 25.0

_FAILED = "what is there could not be written, the render goes on"

Encode = Callable[[Picture], Files]


class Keeper:
    """Writes a picture and its sums now and then.

    Parameters
    ----------
    encode_sums : callable
        Gives the file of sums; it takes a `Picture` and calls neither Mitsuba nor Dr.Jit.
    encode_picture : callable
        Gives the picture, likewise.
    encode_preview : callable
        Gives what may be written besides, from the main thread only.
    note : callable
        Tells the user something.
    words : callable
        Tells what is kept, in the line of the end by a signal.
    every : float, optional
        Seconds between two writes, whatever they cost.
    """

    def __init__(
        self,
        encode_sums: Encode,
        encode_picture: Encode,
        encode_preview: Encode,
        note: Callable[[str], None],
        words: Callable[[Picture], str],
        every: float | None = None,
    ) -> None:
        self._encode = encode_sums, encode_picture, encode_preview
        self._note, self._words = note, words
        self._every = every
        self._last: float | None = None
        self._cost = 0.0
        self._state: Picture | None = None  # replaced as a whole
        self._saved: Picture | None = None
        self._told: set[str] = set()

    def offer(self, picture: Picture, last: bool = False) -> None:
        """Write what is there, if it is time; not the `last` state, as its end is to follow."""
        self._state = picture.copy()
        if last:
            return
        wait = self._every
        if wait is None:
            wait = max(EVERY, self._cost / SHARE)
        now = time.perf_counter()
        if self._last is None or now - self._last >= wait:
            self._write(self._state, preview=True)
            self._last = time.perf_counter()
            self._cost = self._last - now

    @contextmanager
    def at_end(self) -> Iterator[None]:
        """Write what is there if a signal or an error ends the block."""
        with _signals.at_end(self._end, AT_END):
            try:
                yield
            except BaseException:
                if words := self._end():
                    self._note(words.lstrip(", "))
                raise

    def _end(self) -> str:
        """Write what is there, and tell it.

        The main thread may be about to write the same: then it is held before its next step, and
        what it has not yet renamed is discarded.
        """
        state = self._state
        if state is not None and state is not self._saved:
            self._write(state, preview=False)
        return "" if self._saved is None else f", {self._words(self._saved)}"

    def _write(self, picture: Picture, preview: bool) -> None:
        sums, shown, beside = self._encode
        try:
            files = dict(shown(picture))
            if preview:
                files |= beside(picture)
        except (BezierError, MemoryError) as error:
            self._tell(_FAILED, error)
            return
        try:
            if self._write_sums(dict(sums(picture)), sum(map(len, files.values()))):
                self._saved = picture
        except (BezierError, MemoryError) as error:
            self._tell(_FAILED, error)
        try:
            write_files(files)
        except (BezierError, MemoryError) as error:
            self._tell(_FAILED, error)

    def _write_sums(self, files: Files, reserve: int) -> bool:
        """Write the sums, if there is room for the picture besides; twice, as it is replaced."""
        for path, data in files.items():
            free = free_space(os.path.dirname(path) or ".")
            if free is not None and free < len(data) + 2 * reserve:
                self._tell(
                    f"the disk has no room for {os.path.basename(path)}, without which this "
                    "render cannot be continued",
                    f"{len(data) + 2 * reserve} bytes, of which {free} are free",
                )
                return False
        write_files(files)
        return True

    def _tell(self, words: str, reason: object) -> None:
        if words not in self._told:  # once
            self._told.add(words)
            self._note(f"note: {words}: {reason}")
