"""Mitsuba's own methods, reachable where ours have taken their place (see `scene_methods`).

Whatever of ours asks Mitsuba about its own shapes and emitters asks here: the public methods of a
scene answer for Bézier shapes, too, and would ask us back.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["of_class", "original", "replace"]

_originals: dict[tuple[type, str], Any] = {}


def replace(owner: type, name: str, method: Callable[..., Any]) -> None:
    """Put `method` in the place of a method of a class; once, the first original is kept."""
    if (owner, name) not in _originals:
        _originals[owner, name] = getattr(owner, name)
        setattr(owner, name, method)


def original(instance: Any, name: str) -> Callable[..., Any]:
    """Return Mitsuba's own method of an object, bound to it.

    Examples
    --------
    >>> scene = mi.load_dict({"type": "scene", "ball": mb.shape(mb.sphere())})
    >>> ray = mi.Ray3f([0, -5, 0], [0, 1, 0])
    >>> scene.ray_test(ray), original(scene, "ray_test")(ray)
    ([True], [False])
    """
    for owner in type(instance).__mro__:
        method = _originals.get((owner, name))
        if method is not None:
            return method.__get__(instance, type(instance))
    return getattr(instance, name)


def of_class(owner: type, name: str) -> Callable[..., Any]:
    """Return the function that `replace` took away from a class."""
    return _originals[owner, name]
