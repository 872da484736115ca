"""Mitsuba plugins, registered for each variant; the classes are made when first used."""

from __future__ import annotations

import threading
import warnings
from functools import partial
from importlib import import_module
from typing import Any

import mitsuba as mi

from .. import _runtime
from .._threads import give_thread
from . import native

__all__ = ["PLUGINS", "register"]

_classes: dict[tuple[str, str], type] = {}

#: Mitsuba makes the parts of a dictionary on several threads: the first one makes the class.
_making = threading.RLock()

#: Our plugins: their kind, and the module and function that make their classes.
PLUGINS = {
    "beziertriangle": ("shape", "shape.beziertriangle.make_shape_class"),
    "asphere": ("shape", "shape.asphere.make_asphere_class"),
    "lens": ("sensor", "lens.sensor.make_lens_class"),
    "dispersive": ("bsdf", "dispersive.make_dispersive_class"),
    "bezierfield": ("texture", "field_texture.make_field_class"),
    "bezieraov": ("integrator", "integrators.bezieraov.make_aov_class"),
    "bezierpath": ("integrator", "integrators.bezierpath.make_path_class"),
    "bezierdepth": ("integrator", "integrators.direct.make_depth_class"),
    "bezierdirect": ("integrator", "integrators.direct.make_direct_class"),
    "beziermoment": ("integrator", "integrators.nested.make_moment_class"),
    "bezierptracer": ("integrator", "integrators.ptracer.make_ptracer_class"),
    "bezierstokes": ("integrator", "integrators.nested.make_stokes_class"),
    "beziervolpath": ("integrator", "integrators.beziervolpath.make_volpath_class"),
    "bezier_direct_projective": (
        "integrator",
        "integrators.bezier_projective.make_direct_projective_class",
    ),
    "bezier_prb_projective": (
        "integrator",
        "integrators.bezier_projective.make_prb_projective_class",
    ),
}


def _instantiate(name: str, props: Any) -> Any:
    """Make a plugin; a scalar variant ends here, in an error that names the usable ones."""
    _runtime.check(mi.variant())
    from .spelling import check_known, check_read

    key = (name, mi.variant())
    with _making:
        if key not in _classes:
            kind, path = PLUGINS[name]
            module, _, function = path.rpartition(".")
            _classes[key] = getattr(import_module(f".{module}", __name__), function)()
            if kind == "shape":  # from now on there may be a scene with something to see
                native.install()
    check_known(name, props)
    plugin = _classes[key](props)
    check_read(name, props)
    return plugin


def _on_variant(_old: str | None, new: str | None) -> None:
    supported = _runtime.version_problem() is None
    if supported:
        from .scene_data import clear_cache

        clear_cache()
    _classes.clear()  # Mitsuba remakes its Python base classes, so ours are remade too
    if new is None:
        return
    for name, (kind, _path) in PLUGINS.items():
        getattr(mi, f"register_{kind}")(name, partial(_instantiate, name))
    give_thread()
    if not supported:  # then a plugin is an error that says so, and the rest of Mitsuba is as it is
        return
    native.register(not new.startswith("scalar"))


_registered = False


def register() -> None:
    """Register the plugins for the variant that is set, and for every later one."""
    global _registered
    if _registered:
        return
    _registered = True
    problem = _runtime.version_problem()
    if problem is not None:
        warnings.warn(problem, RuntimeWarning, stacklevel=4)  # the line that imports us
    mi.detail.add_variant_callback(_on_variant)
    if mi.variant() is not None:
        _on_variant(None, mi.variant())
