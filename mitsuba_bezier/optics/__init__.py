"""Lenses and mirrors by prescription: readers, glass, paraxial data, ray traces, drawings.

This layer stands above geometry; it needs no Mitsuba. Glass by name needs the extra ``[optics]``.
"""

from __future__ import annotations

from .barrel import barrel_shapes, camera_frame
from .beams import Spot, beam, distortion, pupil_grid, spot, used_semi_diameters
from .charts import draw_distortion, draw_field_curvature, draw_focus, draw_mtf
from .coatings import coating, reflectance
from .derivatives import SpotDerivatives, spot_derivatives
from .drawing import draw_section, draw_spots, save_figure
from .field_curvature import Foci, field_curvature
from .glass import AIR, Abbe, Catalogue, Constant, Medium, absorbing, glass
from .lens import Lens, Surface
from .mtf import Arrivals, Modulation, arrivals, diffraction_limit, mtf
from .paraxial import FirstOrder, first_order
from .patches import lens_shapes, surface_patches, surface_shape
from .readers import load
from .report import report
from .scaling import focused, stopped_down
from .trace import Trace, trace

__all__ = [
    "AIR",
    "Abbe",
    "Arrivals",
    "Catalogue",
    "Constant",
    "FirstOrder",
    "Foci",
    "Lens",
    "Medium",
    "Modulation",
    "Spot",
    "SpotDerivatives",
    "Surface",
    "Trace",
    "absorbing",
    "arrivals",
    "barrel_shapes",
    "beam",
    "camera_frame",
    "coating",
    "diffraction_limit",
    "distortion",
    "draw_distortion",
    "draw_field_curvature",
    "draw_focus",
    "draw_mtf",
    "draw_section",
    "draw_spots",
    "field_curvature",
    "first_order",
    "focused",
    "glass",
    "lens_shapes",
    "load",
    "mtf",
    "pupil_grid",
    "reflectance",
    "report",
    "save_figure",
    "spot",
    "spot_derivatives",
    "stopped_down",
    "surface_patches",
    "surface_shape",
    "trace",
    "used_semi_diameters",
]
