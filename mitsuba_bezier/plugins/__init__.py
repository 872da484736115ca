"""Mitsuba plugins, registered for each variant; the classes are made when first used."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from .. import _runtime

__all__ = ["register"]

_classes: dict[tuple[str, str], type] = {}


def _maker(name: str) -> Any:
    from .bezieraov import make_aov_class
    from .bezierpath import make_path_class
    from .beziervolpath import make_volpath_class
    from .projective import make_direct_projective_class, make_prb_projective_class
    from .shape import make_shape_class

    return {
        "beziertriangle": make_shape_class,
        "bezieraov": make_aov_class,
        "bezierpath": make_path_class,
        "bezier_direct_projective": make_direct_projective_class,
        "bezier_prb_projective": make_prb_projective_class,
        "beziervolpath": make_volpath_class,
    }[name]


def _instantiate(name: str, props: Any) -> Any:
    """Make a plugin; a scalar variant ends here, in an error that names the usable ones."""
    _runtime.check(mi.variant())
    from .spelling import check_known, check_read

    key = (name, mi.variant())
    if key not in _classes:
        _classes[key] = _maker(name)()
    check_known(name, props)
    plugin = _classes[key](props)
    check_read(name, props)
    return plugin


def _on_variant(_old: str | None, new: str | None) -> None:
    from .scene_data import clear_cache

    clear_cache()
    _classes.clear()  # Mitsuba remakes its Python base classes, so ours are remade too
    if new is None:
        return
    mi.register_shape("beziertriangle", lambda props: _instantiate("beziertriangle", props))
    mi.register_integrator("bezieraov", lambda props: _instantiate("bezieraov", props))
    mi.register_integrator("bezierpath", lambda props: _instantiate("bezierpath", props))
    mi.register_integrator("beziervolpath", lambda props: _instantiate("beziervolpath", props))
    mi.register_integrator(
        "bezier_prb_projective", lambda props: _instantiate("bezier_prb_projective", props)
    )
    mi.register_integrator(
        "bezier_direct_projective", lambda props: _instantiate("bezier_direct_projective", props)
    )


_registered = False


def register() -> None:
    """Register the plugins for the variant that is set, and for every later one."""
    global _registered
    if _registered:
        return
    _registered = True
    mi.detail.add_variant_callback(_on_variant)
    if mi.variant() is not None:
        _on_variant(None, mi.variant())
