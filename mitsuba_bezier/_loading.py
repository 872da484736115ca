"""Scenes as Mitsuba loads them, with the shapes in the order in which they are written.

Mitsuba merges meshes, by default, into one shape for each BSDF, in the order of the addresses that
the objects happen to have. Shapes, and so emitters, then come in another order from load to load,
and with it equal seeds give other images. Everything of ours loads scenes through here.

Mitsuba's OpenEXR hands the rows of a file to Dr.Jit's pool of threads, and waits for them. Where
that has one thread, the one that waits, it waits for ever: so there are two.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = [
    "give_thread",
    "load_dict",
    "load_file",
    "parser_config",
    "relative_to",
    "thread_for_files",
]


def give_thread() -> None:
    """Let Dr.Jit have a second thread on a machine of one core, for files of EXR."""
    allowed = getattr(os, "sched_getaffinity", None)
    cores = len(allowed(0)) if allowed else os.cpu_count()
    dr: Any = import_module("drjit")
    if cores == 1 and dr.thread_count() == 1:
        dr.set_thread_count(2)


_lock = threading.Lock()
#: loads under way, and whether the first of them found one thread
_loads, _lent = 0, False


@contextmanager
def thread_for_files() -> Iterator[None]:
    """Let Dr.Jit have a second thread, if it is to have one only, while files are read.

    Loads may overlap, within one another or in several threads: the last takes it back.
    """
    global _loads, _lent
    dr: Any = import_module("drjit")
    with _lock:
        if _loads == 0 and dr.thread_count() == 1:
            dr.set_thread_count(2)
            _lent = True
        _loads += 1
    try:
        yield
    finally:
        with _lock:
            _loads -= 1
            if _loads == 0 and _lent:
                _lent = False
                dr.set_thread_count(1)


def parser_config(mi: Any, variant: str) -> Any:
    """Return how scenes are parsed for a variant: with no meshes merged."""
    config = mi.parser.ParserConfig(variant)
    config.merge_meshes = False
    return config


@contextmanager
def relative_to(mi: Any, path: Path, search_paths: Sequence[str | Path] = ()) -> Iterator[None]:
    """Let files be looked for in the folder of a scene file, last, after `search_paths`."""
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    for folder in (path.resolve().parent, *reversed(search_paths)):
        resolver.prepend(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def load_file(mi: Any, path: str | Path, defines: Mapping[str, str] | None = None) -> Any:
    """Return what `mi.load_file` does, in the order of the file."""
    with relative_to(mi, Path(path)):
        return _load(mi, mi.parser.parse_file, str(path), **(defines or {}))


def load_dict(mi: Any, scene: Mapping[str, Any]) -> Any:
    """Return what `mi.load_dict` does, in the order of the dictionary."""
    return _load(mi, mi.parser.parse_dict, scene)


def _load(mi: Any, parse: Callable[..., Any], source: Any, **defines: str) -> Any:
    config = parser_config(mi, mi.variant())
    state = parse(config, source, **defines)
    mi.parser.transform_all(config, state)
    with thread_for_files():
        built = mi.parser.instantiate(config, state)
    return built[0] if isinstance(built, list) and len(built) == 1 else built
