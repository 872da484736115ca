"""File formats, one module each; `load` and `save` choose by suffix.

A reader returns a `Model`: nets grouped by degree, and a `Report` that counts every face of the
file, those that were refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from .limits import too_large
from .parts import Part
from .report import FormatWarning, Model, Refusal, Report

__all__ = [
    "FormatWarning",
    "Model",
    "Part",
    "Refusal",
    "Report",
    "known_suffixes",
    "load",
    "load_attributes",
    "load_groups",
    "load_trimmed",
    "read",
    "save",
    "writer_options",
]

#: Suffix to the module and function that read it; modules are imported when they are needed.
_READERS = {
    ".3dm": "cad.rhino.read",
    ".bbp": "geomview.read",
    ".bdf": "meshes.read",
    ".bez": "geomview.read",
    ".brep": "cad.opencascade.read",
    ".bv": "bezierview.read",
    ".iges": "cad.opencascade.read",
    ".igs": "cad.opencascade.read",
    ".inp": "meshes.read",
    ".mesh": "mfem.read_any",
    ".msh": "gmsh.read",
    ".nas": "meshes.read",
    ".obj": "obj.read",
    ".off": "geomview.read_off",
    ".step": "cad.opencascade.read",
    ".stp": "cad.opencascade.read",
    ".csv": "bsf.read",
    ".json": "bsf.read",
    ".pvtu": "vtk.parallel.read_pvtu",
    ".tsv": "bsf.read",
    ".vtk": "vtk.legacy.read",
    ".vtp": "vtk.parallel.read_polygons",
    ".vtu": "vtk.reader.read",
    ".yaml": "bsf.read",
    ".yml": "bsf.read",
}
#: Options of the writers, by suffix.
_OPTIONS = {
    ".ply": ("chord_error",),
    ".vtu": ("encoding", "trims", "attributes", "fields", "edges"),
}
#: Suffixes of the formats whose patches can have trims.
_TRIMMED = (".3dm", ".brep", ".iges", ".igs", ".obj", ".step", ".stp", ".vtu", ".pvtu")
#: Suffixes of the formats that have fields.
_WITH_FIELDS = (".mesh", ".msh", ".pvtu", ".vtk", ".vtp", ".vtu")
_WRITERS = {".bv": "bezierview.write", ".ply": "ply.write", ".vtu": "vtk.writer.write"}


def known_suffixes() -> tuple[list[str], list[str]]:
    """Return the suffixes that can be read and those that can be written."""
    return sorted(_READERS), sorted(_WRITERS)


def _function(path: str | PathLike[str], table: dict[str, str], verb: str) -> Callable[..., Any]:
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
    module, _, name = table[suffix].rpartition(".")
    return getattr(import_module(f".{module}", __name__), name)


def read(
    path: str | PathLike[str],
    trims: bool = False,
    fields: bool | Sequence[str | PathLike[str]] = True,
) -> Model:
    """Read a file and the account of its faces; no warnings are issued.

    Parameters
    ----------
    path : path
        The file.
    trims : bool
        Whether patches may have trims. If not, faces that are trimmed by curves are restricted to
        them, or refused where that fails; trimmed patches of ``.vtu`` files are returned whole,
        with a note.
    fields : bool or sequence of path
        Whether what the file tells of its points and cells is read, into ``Model.fields``; of a
        mesh of MFEM, files of grid functions (``.gf``).

    Raises
    ------
    FileFormatError
        If the suffix is unknown, the file is missing or damaged, or no face of it can be
        converted.
    """
    reader = _function(path, _READERS, "read")
    suffix = Path(path).suffix.lower()
    options: dict[str, Any] = {}
    if trims and suffix in _TRIMMED:
        options["trims"] = True
    if fields and suffix in _WITH_FIELDS:
        options["fields"] = fields
    elif not isinstance(fields, bool):
        raise FileFormatError.expected("fields", "True or False for such a file", repr(fields))
    try:
        return reader(path, **options)
    except MemoryError:
        raise too_large(path) from None


def load(path: str | PathLike[str]) -> BezierTriangles:
    """Read a file as patches of one degree: lower degrees are elevated to the highest.

    Faces that cannot be converted are named in a `FormatWarning`.

    Raises
    ------
    FileFormatError
        As `read`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     mb.save(mb.torus(), f"{folder}/ring.vtu")
    ...     ring = mb.load(f"{folder}/ring.vtu")
    >>> len(ring), ring.degree
    (32, 4)
    """
    model = read(path, fields=False)
    model.report.warn()
    return model.triangles()


def load_groups(path: str | PathLike[str]) -> list[BezierTriangles]:
    """Read a file as one `BezierTriangles` for each degree, lowest first.

    Warnings and errors are those of `load`.
    """
    model = read(path, fields=False)
    model.report.warn()
    return model.groups


def load_attributes(path: str | PathLike[str]) -> dict[str, np.ndarray]:
    """Read texture coordinates and attributes of the patches that `load` returns.

    Returns
    -------
    dict
        ``texcoords`` ``(P, 3, 2)``, ``face_...`` ``(P, C)``, ``vertex_...`` ``(P, K, C)``, as far
        as the file has them. Only ``.vtu`` files can.

    Raises
    ------
    FileFormatError
        If the file is missing or damaged.
    """
    if Path(path).suffix.lower() != ".vtu":
        return {}
    from .vtk.attributes import read_attributes

    return read_attributes(path)


def load_trimmed(path: str | PathLike[str]) -> tuple[BezierTriangles, Trims | None]:
    """Read a file as `load` does, but with trims where its faces have any.

    Returns
    -------
    pair of BezierTriangles and Trims or None
        Patches of one degree, and which parts of their parameters are there; None: all of it.
    """
    model = read(path, trims=True, fields=False)
    model.report.warn()
    return model.trimmed()


def writer_options(path: str | PathLike[str], options: dict[str, Any]) -> None:
    """Raise `FileFormatError` if a file cannot be written because of its name or an option."""
    _function(path, _WRITERS, "written")
    known = _OPTIONS.get(Path(path).suffix.lower(), ())
    for name in options:
        if name not in known:
            suffix, names = Path(path).suffix, " or ".join(known) or "none"
            raise FileFormatError.expected(
                name, f"no such option for {suffix} files ({names})", repr(options[name])
            )
    folder = Path(path).parent
    if not folder.is_dir():
        raise FileFormatError.expected(
            "path", "a file in a folder that exists", f"{str(path)!r}: no folder {folder}"
        )


def save(
    triangles: BezierTriangles | list[BezierTriangles], path: str | PathLike[str], **options: Any
) -> None:
    """Write patches to a file; an existing file is replaced in one step.

    Parameters
    ----------
    triangles : BezierTriangles or list of BezierTriangles
        The patches; a list may mix degrees.
    path : path
        The file; its suffix tells the format.
    **options
        Those of the format: ``encoding``, ``trims``, ``attributes``, ``fields`` and ``edges`` for
        ``.vtu``, ``chord_error`` for ``.ply``.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, the folder does not exist, an option does not fit the format
        or the format cannot hold the nets.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     mb.save([mb.sphere(), mb.torus()], f"{folder}/both.vtu")
    ...     len(mb.load(f"{folder}/both.vtu"))
    40
    """
    writer_options(path, options)
    _function(path, _WRITERS, "written")(triangles, path, **options)
