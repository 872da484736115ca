"""Check a scene file before Mitsuba reads it.

Mitsuba reads nested elements by calling itself: 60 000 of them end the process, and with it Python.
A pipe or a device among the files of a scene keeps it waiting for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.parsers import expat

from ..errors import FileFormatError
from ..io.files import check_regular, read_bytes

__all__ = ["check_xml"]

#: Elements within each other; scenes have ten or so.
MAX_DEPTH = 200


def check_xml(path: Path, folders: Sequence[Path]) -> None:
    """Check a scene file, and those that it includes.

    Parameters
    ----------
    path : Path
        The scene.
    folders : sequence of Path
        Where files named by the scene are looked for.

    Raises
    ------
    FileFormatError
        If elements lie too deep, or a file that it names is a pipe, a device or a socket.
    """
    todo, seen = [path], set()
    while todo:
        file = todo.pop()
        key = file.resolve()
        if key in seen:
            continue
        seen.add(key)
        for name, is_scene in _files(file):
            found = next((f / name for f in folders if (f / name).exists()), None)
            if found is None or found.is_dir():
                continue  # Mitsuba tells it, or it is a name of something else
            check_regular(found)
            if is_scene:
                todo.append(found)


def _files(path: Path) -> list[tuple[str, bool]]:
    """Return the files that a scene file names, and which of them are scenes."""
    out: list[tuple[str, bool]] = []
    depth = 0
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise FileFormatError.expected(
                "SCENE",
                f"at most {MAX_DEPTH} elements within each other",
                f"more in {path}, line {parser.CurrentLineNumber}",
            )
        if tag == "include":
            out.append((attributes.get("filename", ""), True))
        elif tag in ("string", "path") and "filename" in attributes.get("name", ""):
            out.append((attributes.get("value", ""), False))

    def end(_tag: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(read_bytes(path), True)
    except expat.ExpatError:
        pass  # Mitsuba tells what is wrong
    return [(name, is_scene) for name, is_scene in out if name and "\0" not in name]
