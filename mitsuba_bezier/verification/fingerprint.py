"""The fingerprint of a scene: a number that tells it from others, whatever folder it lies in.

Headers of renders hold it, so that what does not belong together is seen: parts that are to be
merged, a render that is to be continued, a reference of another scene. It is made of the contents
of all files that a scene file names, or of the values of a scene that is built in Python. What a
file says counts, not what it means: a comment makes another scene.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import _loading
from .._runtime import import_mitsuba
from ..errors import BezierError

__all__ = ["files_fingerprint", "scene_files", "scene_fingerprint"]

_DIGITS = 32


def scene_fingerprint(
    scene: Any,
    defines: Mapping[str, str] | None = None,
    search_paths: Sequence[str | Path] = (),
) -> str:
    """Return the fingerprint of a scene, 32 hexadecimal digits; a variant must be set.

    Parameters
    ----------
    scene : path, mapping or mi.Scene
        A scene file, whose fingerprint is that in the headers of ``mitsuba-bezier render``; what
        `mi.load_dict` takes; or a scene, told by all values that `mi.traverse` finds. The three
        differ for the same scene.
    defines : mapping, optional
        Values of the ``$parameters`` of a scene file.
    search_paths : sequence of paths, optional
        More folders in which files named by a scene file are looked for.

    Raises
    ------
    BezierError
        If the scene is of another kind, or a dictionary holds what has no fingerprint.
    """
    mi = import_mitsuba()
    if isinstance(scene, (str, os.PathLike)):
        path = Path(scene)
        config = _loading.parser_config(mi, mi.variant())
        with _loading.relative_to(mi, path, search_paths):
            state = mi.parser.parse_file(config, str(path), **(defines or {}))
            return files_fingerprint(scene_files(mi, state), defines)
    total = hashlib.sha256()
    _add(total, mi, "scene", scene)
    return total.hexdigest()[:_DIGITS]


def scene_files(mi: Any, state: Any) -> tuple[Path, ...]:
    """Return the files of a parsed scene: XML, and what parameters of its objects name.

    Parameters
    ----------
    mi : module
        Mitsuba, with the file resolver of the scene.
    state : mi.parser.ParserState
        The parsed scene.
    """
    resolver = mi.file_resolver()
    files = [Path(str(file)) for file in state.files]
    names = []
    for node in state.nodes:
        for key in node.props.keys():  # noqa: SIM118 (Properties is no dict)
            seen = node.props.was_queried(key)
            if isinstance(value := node.props[key], str):
                names.append(value)
            node.props.mark_queried(key, seen)  # Mitsuba tells of parameters that nothing reads
    for file in files:  # spectra are read while the XML is
        names += re.findall(r"""filename\s*=\s*["']([^"']*)["']""", _text(file))
    for name in dict.fromkeys(names):
        found = _found(resolver, name)
        if found is not None:
            files.append(found)
    return tuple(dict.fromkeys(files))


def files_fingerprint(files: Sequence[Path], defines: Mapping[str, str] | None = None) -> str:
    """Return the fingerprint of the contents of files, whatever their folders, and of parameters.

    Parameters
    ----------
    files : sequence of Path
        In the order in which the scene names them, see `scene_files`.
    defines : mapping, optional
        Values of the ``$parameters`` of the scene.
    """
    total = hashlib.sha256(repr(sorted((defines or {}).items())).encode())
    for file in files:
        total.update(_contents(file))
    return total.hexdigest()[:_DIGITS]


def _contents(file: Path) -> bytes:
    own = hashlib.sha256()
    with open(file, "rb") as data:
        while block := data.read(1 << 20):
            # a scene that has been through another system is the same
            own.update(block.replace(b"\r", b"") if file.suffix.lower() == ".xml" else block)
    return own.digest()


def _found(resolver: Any, name: str) -> Path | None:
    """Return the file that a text names, if it is a name of one."""
    try:
        found = Path(str(resolver.resolve(name)))
        return found if name and found.is_file() else None
    except (OSError, RuntimeError, TypeError, ValueError):
        return None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _add(total: Any, mi: Any, name: str, value: Any) -> None:
    """Add a named value; what stands before it says how far it reaches."""

    def put(kind: str, data: bytes) -> None:
        total.update(f"{name}\0{kind}\0{len(data)}\0".encode("utf-8", "backslashreplace") + data)

    if isinstance(value, Mapping):
        put("mapping", str(len(value)).encode())
        for key, item in value.items():  # the order of shapes is that of the image, to the bit
            _add(total, mi, str(key), item)
    elif isinstance(value, (str, os.PathLike)):
        file = _found(mi.file_resolver(), os.fspath(value))
        text = os.fspath(value).encode("utf-8", "backslashreplace")
        put("text", text) if file is None else put("file", _contents(file))
    elif isinstance(value, mi.Object):
        put("object", value.class_name().encode())
        parameters = mi.traverse(value)
        for key in sorted(parameters.keys()):
            _add(total, mi, key, parameters[key])
    elif isinstance(value, (bool, int, float, np.number)):  # 1, 1.0 and True are one parameter
        put("number", repr(float(value)).encode())
    else:
        array = _array(value)
        if array is None:
            raise BezierError.expected(
                "scene", "numbers, text, arrays, transforms and objects of Mitsuba", type(value)
            )
        put(f"array {array.shape}", array.tobytes())


def _array(value: Any) -> np.ndarray | None:
    """Return the numbers of an array, a tensor, a transform or a colour as float64."""
    for inner in (getattr(value, "matrix", None), value):
        try:
            array = np.asarray(inner, dtype=np.float64)
        except (TypeError, ValueError):
            continue
        if inner is not None:
            return np.ascontiguousarray(array)
    return None
