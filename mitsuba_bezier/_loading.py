"""Scenes as Mitsuba loads them, with the shapes in the order in which they are written.

Mitsuba merges meshes, by default, into one shape for each BSDF, in the order of the addresses that
the objects happen to have. Shapes, and so emitters, then come in another order from load to load,
and with it equal seeds give other images. Everything of ours loads scenes through here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ._threads import thread_for_files

__all__ = ["load_dict", "load_file", "parser_config", "relative_to"]


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
