"""Prevent libraries beside a scene from being loaded as plugins.

Mitsuba looks for ``plugins/NAME.so`` in the scene's folder, in those that the scene names, and in
the current one, before its own: a foreign scene could bring code along, even under a name of
Mitsuba's. A plugin that is loaded is not looked for again, so Mitsuba's own are loaded first; any
other library has to be allowed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import FileFormatError

__all__ = ["check", "load_own"]

_SUFFIXES = (".so", ".dylib", ".dll")


def load_own(mi: Any) -> None:
    """Load all plugins of Mitsuba's own folder, in some 50 ms; a variant must be set."""
    root = _root(mi)
    before = mi.file_resolver()
    resolver = mi.FileResolver()
    resolver.clear()
    resolver.append(str(root))
    mi.set_file_resolver(resolver)
    try:
        manager = mi.PluginManager.instance()
        for name in sorted(_own(root)):
            manager.plugin_type(name)
    finally:
        mi.set_file_resolver(before)


def check(mi: Any, names: Iterable[str], scene: Path) -> None:
    """Refuse plugins that would be loaded from elsewhere than Mitsuba's folder.

    Parameters
    ----------
    mi : module
        Mitsuba, with the file resolver that the scene is loaded with.
    names : iterable of str
        The plugins of the scene.
    scene : path
        The scene file, for the message.

    Raises
    ------
    FileFormatError
        If a name is a path, or there is a library of that name.
    """
    from ..plugins import PLUGINS  # registered from Python, so never looked for in a file

    own = _own(_root(mi)) | set(PLUGINS)
    resolver = mi.file_resolver()
    folders = [*(str(resolver[k]) for k in range(len(resolver))), os.getcwd()]
    for name in sorted(set(names) - own):
        if "/" in name or "\\" in name:
            raise FileFormatError.expected(
                "SCENE", "plugins named by words", f"{scene}: the path {name!r}"
            )
        for folder in folders:
            for suffix in _SUFFIXES:
                library = os.path.join(folder, "plugins", name + suffix)
                if os.path.lexists(library):
                    raise FileFormatError.expected(
                        "SCENE",
                        "plugins of Mitsuba and of this package",
                        f"{scene}: {name!r}, for which {library} would be loaded and run; "
                        "--allow-plugins allows it",
                    )


def _root(mi: Any) -> Path:
    return Path(mi.__file__).resolve().parent


def _own(root: Path) -> set[str]:
    return {path.stem for path in (root / "plugins").glob("*") if path.suffix in _SUFFIXES}
