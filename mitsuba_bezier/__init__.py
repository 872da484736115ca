"""Exact rational Bézier triangles for Mitsuba 3.

Importing this package, before or after ``mi.set_variant``, registers the shape
``beziertriangle`` and the integrators that see it. It never sets a variant itself.
"""

from __future__ import annotations

from . import _children

_children.leave_current_folder()  # before anything else is imported

from . import _signals  # noqa: E402

_signals.begin_if_command()  # what follows takes a second, in which one can press Ctrl-C

from importlib import import_module  # noqa: E402
from typing import Any  # noqa: E402

from . import _runtime  # noqa: E402
from ._version import __version__  # noqa: E402
from .errors import (  # noqa: E402
    BezierError,
    DerivativeWarning,
    FileFormatError,
    GeometryError,
    NetError,
    RuntimeSetupError,
    VariantError,
)

if not _children.reads():
    _runtime.prepare()  # before anything imports Dr.Jit, which looks for LLVM at once

from .geometry.camera import Camera  # noqa: E402
from .geometry.covers import quadric_cover, ruled_cover, sphere  # noqa: E402
from .geometry.curves import BezierCurve  # noqa: E402
from .geometry.quadric_patches import characterize  # noqa: E402
from .geometry.quadric_types import (  # noqa: E402
    classify_quadric,
    collineation_to_paraboloid,
    projective_type,
)
from .geometry.quadrics import fit_quadric, fit_quadrics, quadric_patch  # noqa: E402
from .geometry.shapes import (  # noqa: E402
    cone,
    cylinder,
    disk,
    ellipsoid,
    elliptic_paraboloid,
    half_plane,
    hyperbolic_paraboloid,
    hyperboloid_one_sheet,
    hyperboloid_two_sheets,
    plane,
    quarter_plane,
    torus,
)
from .geometry.tensor import tensor_to_triangles  # noqa: E402
from .geometry.triangles import BezierTriangles  # noqa: E402
from .geometry.triangulations import triangulated  # noqa: E402
from .io import Model, load, save  # noqa: E402

__all__ = [
    "BSplineCurve",
    "BSplineSurface",
    "BasicCurve",
    "BezierCurve",
    "BezierError",
    "BezierTriangles",
    "Camera",
    "DerivativeWarning",
    "DualBezierCurve",
    "FileFormatError",
    "GeometryError",
    "NetError",
    "Perspectivity",
    "Polarity",
    "RuntimeSetupError",
    "StereographicProjection",
    "VariantError",
    "__version__",
    "arrow",
    "boundary_curves",
    "characterize",
    "classify_quadric",
    "collineation_to_paraboloid",
    "cone",
    "conic_elements",
    "cylinder",
    "denoise",
    "disk",
    "ellipsoid",
    "elliptic_paraboloid",
    "figures",
    "fit",
    "fit_quadric",
    "fit_quadrics",
    "float64",
    "half_plane",
    "hyperbolic_paraboloid",
    "hyperboloid_one_sheet",
    "hyperboloid_two_sheets",
    "isoparametric_lines",
    "label",
    "load",
    "native",
    "net_shapes",
    "patchwork",
    "plane",
    "projective_type",
    "quadric_cover",
    "quadric_patch",
    "quarter_plane",
    "ray_intersect",
    "ray_test",
    "register",
    "ruled_cover",
    "save",
    "scene",
    "set_float64",
    "shape",
    "show",
    "sphere",
    "tensor_to_triangles",
    "torus",
    "triangulated",
]


def register() -> None:
    """Register the plugins with Mitsuba; done at import wherever Mitsuba can be loaded.

    Raises
    ------
    RuntimeSetupError
        If Mitsuba cannot be imported; the message says what is missing.

    Examples
    --------
    >>> mb.register()  # once more does no harm
    """
    _runtime.import_mitsuba()
    from .plugins import register as register_plugins

    register_plugins()


#: Names of the lecture that few scenes need: loaded when they are asked for.
_WHEN_ASKED = {
    "BSplineCurve": "geometry.splines",
    "BSplineSurface": "geometry.spline_surfaces",
    "BasicCurve": "geometry.basic_curve",
    "DualBezierCurve": "geometry.duality",
    "Perspectivity": "geometry.ideal_elements",
    "Polarity": "geometry.polarity",
    "StereographicProjection": "geometry.stereographic",
    "conic_elements": "geometry.conic_elements",
    "denoise": "rendering.denoise",
    "float64": "kernels.float64_use",
    "patchwork": "geometry.four_sided",
    "set_float64": "kernels.float64_use",
}

#: Names that need Mitsuba, and where they are.
_WITH_MITSUBA = {
    "arrow": "plugins.pieces.nets",
    "boundary_curves": "plugins.pieces.curves",
    "isoparametric_lines": "plugins.pieces.curves",
    "label": "plugins.pieces.labels",
    "net_shapes": "plugins.pieces.nets",
    "native": "plugins.native.scene_methods",
    "ray_intersect": "plugins.scene",
    "ray_test": "plugins.scene",
    "scene": "models.scene",
    "shape": "plugins.native.dictionaries",
    "show": "models.notebook",
}


def _draw(model: Any) -> bytes | None:
    """Return the picture of a net or a model for notebooks."""
    from .models.notebook import quick_png

    return quick_png(model)


# nets and models stand below what draws them
BezierTriangles.draw = staticmethod(_draw)
Model.draw = staticmethod(_draw)


def __getattr__(name: str) -> Any:
    if name in ("figures", "fit"):
        return import_module(f".{name}", __name__)
    if name in _WHEN_ASKED:
        return getattr(import_module(f".{_WHEN_ASKED[name]}", __name__), name)
    if name in _WITH_MITSUBA:
        register()
        return getattr(import_module(f".{_WITH_MITSUBA[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if not _children.reads():
    try:
        register()
    except RuntimeSetupError:
        # the geometry works without Mitsuba; whoever needs more meets the error there
        pass
