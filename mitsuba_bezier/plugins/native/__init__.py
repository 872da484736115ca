"""What lets Mitsuba's own names see Bézier shapes: integrators, scenes, sensors, dictionaries."""

from __future__ import annotations

__all__ = ["install", "register"]


def register(jit: bool) -> None:
    """Take names of Mitsuba's plugins in the variant that is set, which compiles if `jit`."""
    from . import counterparts, dictionaries, groups, sensors

    dictionaries.install()
    if jit:
        for module in (counterparts, sensors, groups):
            module.register()


def install() -> None:
    """Replace methods of Mitsuba's classes, once there is a Bézier shape in the variant."""
    from . import counterparts, scene_methods, sensors

    for module in (scene_methods, counterparts, sensors):
        module.install()
