"""File formats, one module each; `load` and `save` choose by suffix.

A reader returns a `Model`: nets grouped by degree, and a `Report` that counts every face of the
file, those that were refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from os import PathLike
from pathlib import Path

from ..errors import FileFormatError
from ..geometry.triangles import BezierTriangles
from .report import FormatWarning, Model, Refusal, Report

__all__ = [
    "FormatWarning",
    "Model",
    "Refusal",
    "Report",
    "known_suffixes",
    "load",
    "load_groups",
    "read",
    "save",
]

#: Suffix to the module that reads it; modules are imported when they are needed.
_READERS = {".vtu": "vtu"}
_WRITERS = {".vtu": "vtu"}


def known_suffixes() -> tuple[list[str], list[str]]:
    """Return the suffixes that can be read and those that can be written."""
    return sorted(_READERS), sorted(_WRITERS)


def _module(path: str | PathLike[str], table: dict[str, str], verb: str):
    try:
        suffix = Path(path).suffix.lower()
    except TypeError:
        raise FileFormatError.expected("path", "the name of a file", repr(path)) from None
    if suffix not in table:
        raise FileFormatError.expected(
            "path",
            f"a file that can be {verb} ({', '.join(sorted(table))})",
            f"suffix {suffix!r} of {str(path)!r}",
        )
    return import_module(f".{table[suffix]}", __name__)


def read(path: str | PathLike[str]) -> Model:
    """Read a file and the account of its faces; no warnings are issued.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, the file is missing or damaged, or no face of it can be
        converted.
    """
    reader: Callable[..., Model] = _module(path, _READERS, "read").read
    return reader(path)


def load(path: str | PathLike[str]) -> BezierTriangles:
    """Read a file as patches of one degree: lower degrees are elevated to the highest.

    Faces that cannot be converted are named in a `FormatWarning`.

    Raises
    ------
    FileFormatError
        As `read`.
    """
    model = read(path)
    model.report.warn()
    return model.triangles()


def load_groups(path: str | PathLike[str]) -> list[BezierTriangles]:
    """Read a file as one `BezierTriangles` for each degree, lowest first.

    Warnings and errors are those of `load`.
    """
    model = read(path)
    model.report.warn()
    return model.groups


def save(triangles: BezierTriangles, path: str | PathLike[str]) -> None:
    """Write patches to a file; an existing file is replaced in one step.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, the folder does not exist or the format cannot hold the nets.
    """
    writer: Callable[..., None] = _module(path, _WRITERS, "written").write
    writer(triangles, path)
