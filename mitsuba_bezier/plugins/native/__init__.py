"""What lets Mitsuba's own names see Bézier shapes: integrators, scenes, sensors, dictionaries."""

from __future__ import annotations

__all__ = ["install", "register"]

_seen = False  # whether there ever was a Bézier shape


def register(jit: bool) -> None:
    """Take names of Mitsuba's plugins in the variant that is set, which compiles if `jit`."""
    from . import counterparts, dictionaries, groups, scene_methods, sensors

    dictionaries.install()
    if _seen:  # a scene of another variant may still be there
        scene_methods.watch_renders()
    if jit:
        for module in (counterparts, sensors, groups):
            module.register()


def install() -> None:
    """Replace methods of Mitsuba's classes, once there is a Bézier shape in the variant."""
    global _seen
    from . import counterparts, scene_methods, sensors

    _seen = True
    scene_methods.watch_renders()
    for module in (scene_methods, counterparts, sensors):
        module.install()
