"""Refuse images that unpack to far more than the file: a small one could fill the memory."""

from __future__ import annotations

from ..errors import FileFormatError

__all__ = ["check_size"]

#: Numbers (width x height x channels) that any file may have: 4K with eight channels.
ALWAYS = 1 << 26

#: Numbers a byte beyond that. Black pixels reach 1000; noisy renders have less than 1.
DENSEST = 100


def check_size(name: str, numbers: int, size: int) -> None:
    """Check what the header of an image says against the size of its file.

    Raises
    ------
    FileFormatError
        If an image is larger than `ALWAYS`, and has more than `DENSEST` numbers a byte.
    """
    if numbers > max(ALWAYS, DENSEST * size):
        raise FileFormatError.expected(
            name,
            f"at most {max(ALWAYS, DENSEST * size)} numbers in a file of {size} bytes",
            f"{numbers} (width x height x channels)",
        )
