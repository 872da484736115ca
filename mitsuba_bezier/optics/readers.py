"""Choose the reader of a prescription by the suffix of its file."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path

from ..errors import FileFormatError, PrescriptionError
from .checks import check_body
from .codev import read_codev
from .lens import Lens
from .tables import read_csv, read_pbrt
from .zemax import read_zemax

#: Readers by suffix.
READERS: dict[str, Callable[[str | PathLike[str]], Lens]] = {
    ".zmx": read_zemax,
    ".seq": read_codev,
    ".csv": read_csv,
    ".dat": read_pbrt,
}


def load(path: str | PathLike[str]) -> Lens:
    """Return the lens of a prescription file.

    Parameters
    ----------
    path : path
        A ``.zmx``, ``.seq``, ``.csv`` (see `tables.read_csv`) or pbrt ``.dat`` file.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, or the file is missing or damaged.
    PrescriptionError
        If the lens has what is not followed, a glass that is not known, or is impossible.

    Examples
    --------
    >>> from pathlib import Path
    >>> from mitsuba_bezier.optics import first_order, load
    >>> table = "radius,thickness,nd,vd\\n10,20,1.5,60\\n-10,5,,\\n"
    >>> _ = Path("ball.csv").write_text(table)
    >>> round(first_order(load("ball.csv")).focal_length, 9)
    15.0
    """
    suffix = Path(path).suffix.lower() if isinstance(path, (str, PathLike)) else ""
    if suffix not in READERS:
        raise FileFormatError.expected(
            "path", f"a prescription ({', '.join(READERS)})", f"{str(path)!r}"
        )
    try:
        lens = READERS[suffix](path)
        check_body(lens)
    except PrescriptionError as error:
        told = str(error)
        if told.startswith(str(path)):
            raise
        raise PrescriptionError(f"{path}: {told}") from None
    return lens
