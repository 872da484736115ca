"""Lenses and mirrors by prescription: readers, glass, paraxial data, ray traces, drawings.

This layer stands above geometry; it needs no Mitsuba. Glass by name needs the extra ``[optics]``.
"""

from __future__ import annotations

from .barrel import barrel_shapes, camera_frame
from .beams import Spot, beam, distortion, pupil_grid, spot, used_semi_diameters
from .coatings import coating, reflectance
from .derivatives import SpotDerivatives, spot_derivatives
from .drawing import draw_section, draw_spots, save_figure
from .glass import AIR, Abbe, Catalogue, Constant, Medium, absorbing, glass
from .lens import Lens, Surface
from .paraxial import FirstOrder, first_order
from .patches import lens_shapes, surface_patches, surface_shape
from .readers import load
from .report import report
from .scaling import focused, stopped_down
from .trace import Trace, trace

__all__ = [
    "AIR",
    "Abbe",
    "Catalogue",
    "Constant",
    "FirstOrder",
    "Lens",
    "Medium",
    "Spot",
    "SpotDerivatives",
    "Surface",
    "Trace",
    "absorbing",
    "barrel_shapes",
    "beam",
    "camera_frame",
    "coating",
    "distortion",
    "draw_section",
    "draw_spots",
    "first_order",
    "focused",
    "glass",
    "lens_shapes",
    "load",
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
