"""Take over a name of Mitsuba's plugins, and still make Mitsuba's own objects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi

__all__ = ["take_name"]


def take_name(kind: str, name: str, make: Callable[[Any, Callable[[Any], Any]], Any]) -> None:
    """Register `make` as the factory of Mitsuba's plugin `name`, in the variant that is set.

    Parameters
    ----------
    kind : str
        ``"integrator"``, ``"sensor"`` or ``"shape"``.
    name : str
    make : callable
        Called with the properties and a function that makes Mitsuba's own object of them.
    """
    spelling = f"./{name}"  # another name of the same file, of which Mitsuba registers its own
    manager = mi.PluginManager.instance()
    # Loaded now: a plugin loaded later would put Mitsuba's factory in the place of ours, and one
    # of the same name that lies beside a scene would be found first.
    before = mi.file_resolver()
    resolver = mi.FileResolver()
    resolver.clear()
    resolver.append(str(Path(mi.__file__).resolve().parent))
    mi.set_file_resolver(resolver)
    try:
        manager.plugin_type(name)
        manager.plugin_type(spelling)
    finally:
        mi.set_file_resolver(before)

    def own(props: Any) -> Any:
        props.set_plugin_name(spelling)
        try:
            made = manager.create_object(props)
        finally:
            props.set_plugin_name(name)
        return (made.expand() or [made])[0]  # some stand for an object that they make later

    getattr(mi, f"register_{kind}")(name, lambda props: make(props, own))
