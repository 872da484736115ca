"""Exact rational Bézier triangles for Mitsuba 3.

Importing this package, before or after ``mi.set_variant``, registers the shape
``beziertriangle`` and the integrators that see it. It never sets a variant itself.
"""

from __future__ import annotations

from typing import Any

from . import _runtime
from ._version import __version__
from .errors import (
    BezierError,
    FileFormatError,
    GeometryError,
    NetError,
    RuntimeSetupError,
    VariantError,
)

_runtime.prepare()  # before anything imports Dr.Jit, which looks for LLVM at once

from .geometry.covers import sphere  # noqa: E402
from .geometry.quadrics import fit_quadric, quadric_patch  # noqa: E402
from .geometry.triangles import BezierTriangles  # noqa: E402
from .io import load  # noqa: E402

__all__ = [
    "BezierError",
    "BezierTriangles",
    "FileFormatError",
    "GeometryError",
    "NetError",
    "RuntimeSetupError",
    "VariantError",
    "__version__",
    "fit_quadric",
    "load",
    "quadric_patch",
    "ray_intersect",
    "ray_test",
    "register",
    "sphere",
]


def register() -> None:
    """Register the plugins with Mitsuba; done at import wherever Mitsuba can be loaded.

    Raises
    ------
    RuntimeSetupError
        If Mitsuba cannot be imported; the message says what is missing.
    """
    _runtime.import_mitsuba()
    from .plugins import register as register_plugins

    register_plugins()


def __getattr__(name: str) -> Any:
    if name in ("ray_intersect", "ray_test"):
        register()
        from .plugins import scene

        return getattr(scene, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


try:
    register()
except RuntimeSetupError:
    # the geometry works without Mitsuba; whoever needs more meets the error there
    pass
